"""What may be asked for: resolutions, margins, cells that float32 can divide an object into, and steps that this machine can hold.

An error before a step is begun is better than a process that is killed in it.
"""

import math
import operator
import os

import numpy as np

from warp_bounding.errors import IndicatorError

__all__ = [
    "MAX_CELLS",
    "MAX_RESOLUTION",
    "SCALE_BITS",
    "cells_around",
    "cells_per_unit",
    "check_memory",
    "checked_margin",
    "checked_resolution",
]

MAX_CELLS = 2**31 - 1  # cells of a grid: their indices are 32-bit integers
MAX_OFFSET = 2**22  # cells: what ``IndicatorGrid`` allows for an offset
SCALE_BITS = 16  # significant bits of cells_per_unit: cell coordinates of float32 points are then exact in float64
DEFAULT_RESOLUTION, MAX_RESOLUTION = 64, 1024  # cells along the longest axis of a mesh


def check_memory(needed: float, what: str, advice: str) -> None:
    """Refuse a step that needs more than all of the machine's memory.

    Args:
        needed: Bytes that the step holds at a time, about.
        what: What needs them, for the message.
        advice: What would need less.

    Raises:
        IndicatorError: With both numbers.
    """
    there = _memory()
    if there is not None and needed > there:
        raise IndicatorError(
            f"{what} needs about {needed / 1e9:.3g} GB of memory, this machine has {there / 1e9:.3g}; {advice}"
        )


def _memory() -> int | None:
    """Bytes of memory of this machine; ``None`` where it does not tell."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):
        return None


def checked_resolution(resolution: int | None) -> int:
    """The resolution, or the default one for ``None``; raises ``IndicatorError`` for an impossible one."""
    if resolution is None:
        return DEFAULT_RESOLUTION
    try:
        value = operator.index(resolution)
    except TypeError:
        value = -1
    if isinstance(resolution, bool | np.bool_) or not 2 <= value <= MAX_RESOLUTION:
        raise IndicatorError(f"resolution must be an integer from 2 to {MAX_RESOLUTION}, got {resolution!r}")
    return value


def checked_margin(margin: float) -> float:
    """The margin as a float; raises ``IndicatorError`` for one that is negative or not finite."""
    try:
        value = float(margin)
    except (TypeError, ValueError):
        value = math.nan
    if not (math.isfinite(value) and value >= 0):
        raise IndicatorError(f"margin must be finite and non-negative, got {margin!r}")
    return value


def cells_per_unit(extent: float, resolution: int, name: str) -> float:
    """Cubic cells along an extent, rounded to few significant bits: they are never smaller than asked for.

    Args:
        extent: Object units.
        resolution: Cells along it.
        name: For messages.

    Raises:
        IndicatorError: If float32 cells cannot divide it.
    """
    mantissa, exponent = math.frexp(resolution / extent)
    scale = math.ldexp(math.floor(math.ldexp(mantissa, SCALE_BITS)), exponent - SCALE_BITS)
    limits = np.finfo(np.float32)
    if not float(limits.tiny) <= scale <= float(limits.max):  # of float32, NumPy would make scale one
        raise IndicatorError(f"{name}: expected an object that float32 cells can divide, got extent {extent:g}")
    return scale


def cells_around(lower: np.ndarray, upper: np.ndarray, reach: float, name: str) -> tuple[np.ndarray, np.ndarray]:
    """First and last cell of a grid around an object: all cells that it may meet, and one more on every side.

    Args:
        lower: ``(3,)``, in cells from the origin.
        upper: ``(3,)``, in cells from the origin.
        reach: By how much the object is dilated, in cells.
        name: For messages.

    Raises:
        IndicatorError: If that is too far from the origin.
    """
    from warp_bounding.indicators.voxelization import SLACK

    reach = reach + 0.5 + 2 * SLACK  # all rounding included: 2 * SLACK > SLACK
    first = np.ceil(lower - reach).astype(np.int64) - 1
    last = np.floor(upper + reach).astype(np.int64) + 1
    if np.abs(first).max() >= MAX_OFFSET:
        raise IndicatorError(
            f"{name}: expected a mesh within {MAX_OFFSET} cells of the origin, got {int(np.abs(first).max())} cells; move it there"
        )
    return first, last
