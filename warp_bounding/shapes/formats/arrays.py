"""From an array to a grid: which of its values are occupied, and where its cells lie.

Truth values are clear, and so are 0 and 1. Whatever else an array holds may mean one thing or its opposite: a map
whose white is free, signed distances, the vertices of a mesh. It is refused, with the lines that say what is meant,
unless a level does.

Cells lie as in the paper's data set, the centres of the first and the last on 0 and 1 of every axis, unless spacing
and origin place them.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from warp_bounding.errors import ShapeError
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.recentred import Frame, Recentred
from warp_bounding.shapes.shape import MAX_CELLS, MAX_OFFSET

TIME_NDIM = 4  # arrays of this many dimensions are animations unless the caller says otherwise
# Of the largest coordinate: how far cells may be from where they were requested, as decimal fractions are not exact. It
# is within what ``queries.domain.POSITIONS_ROUNDING`` leaves for the rounding of positions.
ON_LATTICE = Fraction(1, 2**48)
UNKNOWN = ("occupied", "free")
_COMPARISONS = MappingProxyType({"<=": np.less_equal, "<": np.less, ">=": np.greater_equal, ">": np.greater})
_LEVEL = re.compile(r"\s*(<=|<|>=|>)?\s*(\S+)\s*")


def level_of(given: object) -> tuple[str, float]:
    """A comparison and a number from a text such as ``"<128"``, or from a number: values from it on are occupied."""
    number = isinstance(given, int | float | np.integer | np.floating) and not isinstance(given, bool)
    found = _LEVEL.fullmatch(str(float(given)) if number else given if isinstance(given, str) else "")
    try:
        value = float(found[2]) if found and "_" not in found[2] else math.nan
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ShapeError(f"level must be a number or a text such as '<128' or '>=128', got {given!r}")
    return found[1] or ">=", value


def _compared(array: np.ndarray, comparison: str, value: float) -> np.ndarray:
    if array.dtype.kind in "iu":  # whole numbers, however large, with a whole number: float64 would round them
        value = math.ceil(value) if comparison in ("<", ">=") else math.floor(value)
        return _COMPARISONS[comparison](array, value)
    # float32 would round the value
    return _COMPARISONS[comparison](array.astype(np.promote_types(array.dtype, np.float64)), value)


def check_cells(shape: Sequence[int]) -> int:
    """The number of cells of such an array; raises ``ValueError`` if there is none, or more than a grid may have."""
    count = math.prod(shape)
    if not 0 < count <= MAX_CELLS:
        raise ValueError(f"expected 1 to {MAX_CELLS} cells, got {' x '.join(map(str, shape))}")
    return count


class Wanted(NamedTuple):
    """What a caller says of the values of an array, image or map.

    Attributes:
        level: Which are occupied: a comparison, and what values are compared with.
        unknown: What cells of a map are that nobody has seen: ``"occupied"``, ``"free"``, or ``None``, not told.
    """

    level: tuple[str, float] | None = None
    unknown: str | None = None

    def count(self, unknown: int) -> list[str]:
        """What is said of so many unknown cells."""
        return [f"{unknown:,} unknown cells count as {self.unknown or UNKNOWN[0]}"] if unknown else []


@dataclass(frozen=True)
class Placement:
    """Where the cells of an array lie in object space.

    Attributes:
        spacing: Size of a cell, one number or one for each axis; ``None``: the cells' centres span 0 to 1.
        origin: Where the centre of the first cell is, one number for each axis; ``None``: at 0.
        corner: The origin is the first cell's lower corner instead.
    """

    spacing: float | Sequence[float] | None = None
    origin: Sequence[float] | None = None
    corner: bool = False

    def map_of(self, shape: tuple[int, ...], time: bool, name: str) -> tuple[dict[str, np.ndarray], Frame | None]:
        """``cells_per_unit`` and ``offset`` of a grid, empty for the unit cube; the origin of its coordinates, if any.

        The scale is rounded to float32, so without an origin a cell is as large as asked for to seven digits. With one,
        cells lie where they were requested, but for what float64 rounds: on the lattice of multiples of half a cell, or
        else relative to the origin, with what the scale's rounding moves them by as ``Frame.blur``.

        Raises:
            ShapeError: For numbers that are none.
        """
        if self.spacing is None and self.origin is None:
            return {}, None
        if self.spacing is None:
            scale = np.maximum(np.array(shape, dtype=np.float64) - 1, 1)
            sizes = [1 / Fraction(s) for s in scale]
        else:
            spacing = _numbers("spacing", self.spacing, len(shape), one_for_all=not time)
            if not (spacing > 0).all():
                raise ShapeError(f"{name}: spacing must be positive, got {spacing.tolist()}")
            with np.errstate(over="ignore", divide="ignore"):  # the grid refuses what is infinite
                scale = (1 / spacing).astype(np.float32).astype(np.float64)
            sizes = [Fraction(s) for s in spacing]
        if self.origin is None or not (np.isfinite(scale) & (scale > 0)).all():
            return {"cells_per_unit": scale, "offset": np.zeros(len(shape))}, None
        origin, half = _numbers("origin", self.origin, len(shape)), Fraction(1, 2)
        begin = half if self.corner else Fraction(0)  # of the first cell's centre, in cells from the origin
        first = [Fraction(o) / size + begin for o, size in zip(origin, sizes, strict=True)]
        offset = [Fraction(round(2 * f), 2) for f in first]
        near = True
        for size, s, f, o, cells in zip(sizes, scale, first, offset, shape, strict=True):
            own = [((o + k) / Fraction(s), (f + k) * size) for k in (-half, cells - half)]
            stray, end = max(abs(here - there) for here, there in own), max(abs(there) for _, there in own)
            near = near and stray <= end * ON_LATTICE and abs(o) < MAX_OFFSET
        if near:
            return {"cells_per_unit": scale, "offset": np.array(offset, dtype=np.float64)}, None
        blur = [
            (cells - half + begin) * abs(1 / Fraction(s) - size)
            for size, s, cells in zip(sizes, scale, shape, strict=True)
        ]
        frame = Frame(tuple(origin.tolist()), tuple(float(np.nextafter(float(b), np.inf)) if b else 0.0 for b in blur))
        return {"cells_per_unit": scale, "offset": np.full(len(shape), float(begin))}, frame


class Cells(NamedTuple):
    """What a reader found: values that a level and a placement make a grid of.

    Attributes:
        values: n-D.
        name: For messages.
        remark: See ``Shape``.
        placement: Of the cells, where the file tells it; nothing else places them then.
    """

    values: np.ndarray
    name: str
    remark: str = ""
    placement: Placement | None = None


def grid_of(
    array: np.ndarray, name: str, time: bool | None, wanted: Wanted, placement: Placement, remark: str = ""
) -> Grid | Recentred:
    """The shape of an array of truth values or numbers; time comes first in 4-D if ``time`` is ``None``.

    Raises ``ShapeError`` for an array that cannot be bounded, or of which it is not clear what is occupied.
    """
    if isinstance(array, np.ma.MaskedArray):
        raise ShapeError(f"{name}: expected a plain array, got a masked one; fill it first")
    if array.dtype.kind not in "biuf":
        raise ShapeError(f"{name}: expected an array of bool or real numbers, got dtype {array.dtype}")
    if array.dtype.kind == "f" and np.isnan(array).any():
        count = int(np.isnan(array).sum())
        raise ShapeError(f"{name}: expected numbers, got NaN in {count} of {array.size} cells")
    level = wanted.level
    if level is not None and array.dtype.kind == "b":
        raise ShapeError(f"{name}: a level needs numbers, got truth values")
    clear = array.dtype.kind == "b" or (((array == 0) | (array == 1)).all() and not _may_be_vertices(array))
    if level is None and array.size and not clear:
        raise ShapeError(f"{name}: {_what_to_say(array)}")
    occupancy = array.astype(bool) if level is None else _compared(array, *level)
    above = level is not None and level[0][0] == ">" and array.dtype.kind in "if"
    unknown = array == -1 if above else np.zeros(array.shape, dtype=bool)
    seen = above and bool((unknown | (array >= 0)).all())
    if seen and unknown.any():
        occupancy = occupancy & ~unknown if wanted.unknown == UNKNOWN[1] else occupancy | unknown
        remark = "; ".join(filter(None, [remark, *wanted.count(int(unknown.sum()))]))
    elif wanted.unknown is not None and not seen:
        raise ShapeError(f"{name}: unknown is for maps of cells that have -1 or 0 and more, and a level such as '>=65'")
    time = array.ndim == TIME_NDIM if time is None else bool(time)
    where, frame = placement.map_of(array.shape, time, name)
    grid = Grid(occupancy, name=name, time=time, remark=remark, **where)
    return grid if frame is None else Recentred(grid, frame)


def _may_be_vertices(array: np.ndarray) -> bool:
    return array.ndim == 2 and array.shape[1] == 3 and array.dtype.kind == "f"


def _what_to_say(array: np.ndarray) -> str:
    """In one line, what came and the calls that would be clear."""
    low, high = array.min(), array.max()
    got = f"expected truth values, or 0 and 1, got {array.dtype} from {low:g} to {high:g}"
    if _may_be_vertices(array):
        return f"{got} of shape {array.shape}; of vertices write (vertices, faces), of cells a >= 0.5"
    if low < 0:
        maps = "; of an OccupancyGrid (-1, 0 to 100) level='>=65', and unknown='free' if cells of -1 are free"
        return f"{got}; give level='<=0' for signed distances, negative inside, or '>0'{maps if low == -1 else ''}"
    middle = 128 if array.dtype == np.uint8 else float(f"{high / 2:.3g}") if np.isfinite(high) else 0.5
    grey = "; of colours take a grey first" * (array.ndim == 3 and array.shape[2] in (3, 4))
    return f"{got}; give level='<{middle:g}' if low values, the dark of a map, are occupied, or '>={middle:g}'{grey}"


def _numbers(what: str, given: object, count: int, *, one_for_all: bool = False) -> np.ndarray:
    """What was given as ``(count,)`` float64; raises ``ShapeError`` where it is not that many finite numbers."""
    try:
        values = np.array(given)
        values = values.astype(np.float64) if values.dtype.kind in "iuf" else np.array(np.nan)
    except (TypeError, ValueError):
        values = np.array(np.nan)
    if one_for_all and values.ndim == 0:
        values = np.full(count, values)
    if values.shape != (count,) or not np.isfinite(values).all():
        wanted = f"{count} numbers" + (" or one for all" if one_for_all else ", one for each axis")
        raise ShapeError(f"{what} must be {wanted}, got {given!r}")
    return values
