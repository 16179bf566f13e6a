"""From an array to a grid: which of its values are occupied, and where its cells lie.

Truth values are clear, and so are 0 and 1. Whatever else an array holds may mean one thing or its opposite: a map
whose white is free, signed distances, the vertices of a mesh. It is refused, with the lines that say what is meant,
unless a threshold does.

Cells lie as in the paper's data set, the centres of the first and the last on 0 and 1 of every axis, unless spacing
and origin place them.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from warp_bounding.errors import IndicatorError
from warp_bounding.indicators.grid import IndicatorGrid

__all__ = ["Placement", "Threshold", "grid_of"]

TIME_NDIM = 4  # arrays of this many dimensions are animations unless the caller says otherwise
ON_HALF = 1e-6  # cells: how far an origin may be from a multiple of half a cell, as decimal fractions are not exact
_COMPARISONS = MappingProxyType({"<=": np.less_equal, "<": np.less, ">=": np.greater_equal, ">": np.greater})
_THRESHOLD = re.compile(r"\s*(<=|<|>=|>)?\s*(\S+)\s*")


@dataclass(frozen=True)
class Threshold:
    """Which values are occupied: those on one side of a number.

    Attributes:
        comparison: ``"<"``, ``"<="``, ``">"`` or ``">="``.
        value: What values are compared with.
    """

    comparison: str
    value: float

    @classmethod
    def of(cls, given: object) -> "Threshold":
        """From a number, from which on values are occupied, or a text such as ``"<128"``.

        Raises:
            IndicatorError: For anything else.
        """
        found = _THRESHOLD.fullmatch(
            str(float(given)) if _is_number(given) else given if isinstance(given, str) else ""
        )
        try:
            value = float(found[2]) if found else math.nan
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise IndicatorError(f"threshold must be a number or a text such as '<128' or '>=128', got {given!r}")
        return cls(found[1] or ">=", value)

    def __call__(self, array: np.ndarray) -> np.ndarray:
        """``array`` compared, bool."""
        with np.errstate(over="ignore"):  # a value beyond the array's type compares as infinity
            return _COMPARISONS[self.comparison](array, self.value)


@dataclass(frozen=True)
class Placement:
    """Where the cells of an array lie in object space.

    Attributes:
        spacing: Size of a cell, one number or one for each axis; ``None``: the cells' centres span 0 to 1.
        origin: Where the centre of the first cell is, one number for each axis; ``None``: at 0.
    """

    spacing: float | Sequence[float] | None = None
    origin: Sequence[float] | None = None

    def map_of(self, shape: tuple[int, ...], time: bool, name: str) -> dict[str, np.ndarray]:
        """``cells_per_unit`` and ``offset`` of a grid; empty for the unit cube.

        The scale is rounded to float32, so a cell is as large as asked for to seven digits.

        Raises:
            IndicatorError: For numbers that are none, or an origin that is no multiple of half a cell.
        """
        if self.spacing is None and self.origin is None:
            return {}
        if self.spacing is None:
            scale = np.maximum(np.array(shape, dtype=np.float64) - 1, 1)
        else:
            spacing = _numbers("spacing", self.spacing, len(shape), one_for_all=not time)
            if not (spacing > 0).all():
                raise IndicatorError(f"{name}: spacing must be positive, got {spacing.tolist()}")
            with np.errstate(over="ignore"):  # the grid refuses what is infinite
                scale = (1 / spacing).astype(np.float32).astype(np.float64)
        origin = np.zeros(len(shape)) if self.origin is None else _numbers("origin", self.origin, len(shape))
        cells = origin * scale if self.spacing is None else origin / spacing
        offset = np.rint(2 * cells) / 2
        if not (np.abs(offset - cells) <= ON_HALF).all():
            nearest = [float(f"{v:.6g}") for v in offset / scale]
            raise IndicatorError(
                f"{name}: origin must be whole or half cells away from 0, such as {nearest}, got {origin.tolist()}; "
                "queries can be moved by xform="
            )
        return {"cells_per_unit": scale, "offset": offset}


def grid_of(
    array: np.ndarray, name: str, time: bool | None, threshold: Threshold | None, placement: Placement
) -> IndicatorGrid:
    """The indicator of an array of truth values or numbers.

    Args:
        array: n-D.
        name: For messages.
        time: Whether coordinate 0 is time; ``None``: it is in 4-D.
        threshold: Which values are occupied; ``None``: they are truth values, or 0 and 1.
        placement: Of the cells.

    Raises:
        IndicatorError: For an array that cannot be bounded, or of which it is not clear what is occupied.
    """
    if isinstance(array, np.ma.MaskedArray):
        raise IndicatorError(f"{name}: expected a plain array, got a masked one; fill it first")
    if array.dtype.kind not in "biuf":
        raise IndicatorError(f"{name}: expected an array of bool or real numbers, got dtype {array.dtype}")
    if array.dtype.kind == "f" and np.isnan(array).any():
        count = int(np.isnan(array).sum())
        raise IndicatorError(f"{name}: expected numbers, got NaN in {count} of {array.size} cells")
    if threshold is not None and array.dtype.kind == "b":
        raise IndicatorError(f"{name}: a threshold needs numbers, got truth values")
    if threshold is None and array.size and not _is_clear(array):
        raise IndicatorError(f"{name}: {_what_to_say(array)}")
    occupancy = array.astype(bool) if threshold is None else threshold(array)
    time = array.ndim == TIME_NDIM if time is None else bool(time)
    return IndicatorGrid(occupancy, name=name, time=time, **placement.map_of(array.shape, time, name))


def _is_clear(array: np.ndarray) -> bool:
    if array.dtype.kind == "b":
        return True
    return bool(((array == 0) | (array == 1)).all()) and not _may_be_vertices(array)


def _may_be_vertices(array: np.ndarray) -> bool:
    return array.ndim == 2 and array.shape[1] == 3 and array.dtype.kind == "f"


def _what_to_say(array: np.ndarray) -> str:
    """In one line, what came and the two calls that would be clear."""
    low, high = array.min(), array.max()
    got = f"got {array.dtype} from {low:g} to {high:g}"
    if _may_be_vertices(array):
        return (
            f"expected truth values, {got} of shape {array.shape}; write load_indicator((vertices, faces)) if these are a "
            "mesh's vertices, load_indicator(a >= 0.5) if they are cells, occupied from 0.5 on"
        )
    if low < 0:
        return (
            f"expected truth values, or 0 and 1, {got}; write load_indicator(a <= 0) for signed distances, negative inside, "
            "load_indicator(a > 0) if the object is where they are positive; for a file threshold='<=0' or '>0'"
        )
    top = high if np.isfinite(high) else array[np.isfinite(array)].max(initial=0)
    middle = 128 if array.dtype == np.uint8 else 0.5 if top <= 1 else float(f"{low / 2 + top / 2:.3g}")
    grey = ", a being the grey of a picture, such as rgb.mean(axis=2)" * (array.ndim == 3 and array.shape[2] in (3, 4))
    return (
        f"expected truth values, or 0 and 1, {got}; write load_indicator(a < {middle:g}) if low values, the dark of a "
        f"map, are occupied, load_indicator(a >= {middle:g}) if high ones are{grey}; for a file threshold='<{middle:g}' "
        f"or '>={middle:g}'"
    )


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


def _numbers(what: str, given: object, count: int, *, one_for_all: bool = False) -> np.ndarray:
    """What was given as ``(count,)`` float64; raises ``IndicatorError`` where it is not that many finite numbers."""
    try:
        values = np.array(given)
        values = values.astype(np.float64) if values.dtype.kind in "iuf" else np.array(np.nan)
    except (TypeError, ValueError):
        values = np.array(np.nan)
    if one_for_all and values.ndim == 0:
        values = np.full(count, values)
    if values.shape != (count,) or not np.isfinite(values).all():
        wanted = f"{count} numbers" + (" or one for all" if one_for_all else ", one for each axis")
        raise IndicatorError(f"{what} must be {wanted}, got {given!r}")
    return values
