"""What ``fit`` refuses before any time is spent, each in one line."""

import math
import sys
import warnings
from typing import Any

import numpy as np

from warp_bounding.errors import BounderError, BoundingWarning
from warp_bounding.indicators import IndicatorGrid, IndicatorMesh, IndicatorMotion
from warp_bounding.indicators.parts import SIDES
from warp_bounding.indicators.shape import MAX_RESOLUTION, Shape
from warp_bounding.queries import QUERIES

__all__ = [
    "check_distance",
    "check_extent",
    "check_numbers",
    "check_regions",
    "is_number",
    "warn_of_coarse_cells",
    "warn_of_restriction",
]


PACKAGE = __name__.split(".")[0]
CLOSE = ". If its inside counts, close it first: docs/guide/shapes.md has two ways, for small holes and for scans"


def check_numbers(budget: float, seed: int, margin: float) -> None:
    """Refuse a budget, a seed or a margin that makes no sense, with ``BounderError``."""
    if not is_number(budget) or budget <= 0:
        raise BounderError(f"budget must be a positive number of seconds, got {budget!r}")
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or not 0 <= seed < 2**63:
        raise BounderError(f"seed must be a whole number from 0 to 2^63 - 1, got {seed!r}")
    if not is_number(margin) or margin < 0:
        raise BounderError(f"margin must be a length of at least 0, got {margin!r}")


def is_number(value: Any) -> bool:
    """Whether it is a finite number, and no truth value."""
    return isinstance(value, (int, float, np.number)) and not isinstance(value, bool) and bool(np.isfinite(value))


def check_extent(shape: IndicatorGrid | IndicatorMesh | IndicatorMotion, margin: float, force: bool) -> None:
    """Refuse a margin that leaves nothing of the object's form, before any time is spent on it."""
    extent = float(shape.extent.max())
    if margin > extent and not force:
        raise BounderError(
            f"margin must be at most the object's extent, {extent:.4g}, got {margin:g}; force=True (--force) takes it all "
            "the same"
        )


def warn_of_coarse_cells(grid: IndicatorGrid) -> None:
    """Warn where cells reach farther beyond the object than the margin: that costs false positives."""
    size = 1 / float(grid.cells_per_unit[-1])
    if 0 < grid.margin < size:
        finer = math.ceil(grid.resolution * size / grid.margin)
        advice = (
            f"resolution={finer} has cells of the margin's size"
            if finer <= MAX_RESOLUTION
            else "give a finer resolution"
        )
        text = (
            f"margin {grid.margin:g} is under the size of a cell, {size:.3g}: the object's cells at resolution "
            f"{grid.resolution} are bounded, and they are wider than the margin; {advice}"
        )
        _warn(text)


def warn_of_restriction(shape: Shape) -> None:
    """Warn where not all of what a user may mean is bounded, such as the inside of an open mesh."""
    if text := getattr(shape, "restriction", ""):  # what only has a ``to_grid`` of its own says nothing of it
        _warn(f"{shape.name}: {text}{'' if getattr(shape, 'watertight', True) else CLOSE}")


def _warn(text: str) -> None:
    """Warn whoever has called the package, so that what one call says twice is shown once."""
    level, frame = 2, sys._getframe(1)
    while frame.f_back and frame.f_globals.get("__name__", "").split(".")[0] == PACKAGE:
        level, frame = level + 1, frame.f_back
    warnings.warn(text, BoundingWarning, stacklevel=level)


def check_distance(method: str, length, side: str, last, queries) -> None:
    """Refuse what only other queries have."""
    if not isinstance(method, str):
        raise BounderError(f"method must be a name, got {method!r}")
    for name, given, default in (
        ("length", length, None),
        ("last", last, None),
        ("side", side, SIDES[0]),
    ):
        if given != default:
            raise BounderError(f"{name} is not for distances, got {name}={given!r}")
    if queries is not None:
        raise BounderError("queries are not for distances, which have no false positives of their own")


def check_regions(query: str, method: str, length: float | None, side: str) -> None:
    """Refuse what other kinds of query have, or none."""
    if not isinstance(method, str):
        raise BounderError(f"method must be a name, or several joined by +, got {method!r}")
    if side not in SIDES:
        raise BounderError(f"side must be one of {', '.join(SIDES)}, got {side!r}")
    if side == SIDES[1] and QUERIES[query].is_region:
        raise BounderError(f"side={side} is for point queries, got {query} queries")
    if length is not None and not QUERIES[query].has_length:
        raise BounderError(f"length is for ray queries, got length={length} for {query} queries")
    if length is not None and (not is_number(length) or length <= 0):
        raise BounderError(f"length must be a positive number, got {length!r}")
