"""Solids: shapes whose gap is known over whole boxes.

The gap of a solid is a function g of points with two properties: the object is where ``g <= 0``, and g is 1-Lipschitz
in space. So outside the object g is at most the distance to it, and within it ``-g`` is at most the distance to its
border. A solid encloses its gap over closed boxes in an ``Interval``, and everything else follows: a box over which the
gap stays above 0 is empty, one over which it does not pass 0 lies in the object whole. A dilation lowers the gap by
the margin; what else keeps both properties is the algebra (``solids``). Where the gap is less than the distance,
a lowered one holds more than what lies within the margin, next to edges; beyond the solid's box, wider by the margin,
it holds nothing.
"""

import hashlib
import math
from abc import abstractmethod
from collections.abc import Iterable
from copy import copy
from functools import reduce

import numpy as np

from warp_bounding.errors import ShapeError
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.shape import (
    IN,
    OUT,
    UNDECIDED,
    Shape,
    cells_around,
    cells_per_unit,
    check_memory,
    checked_margin,
    checked_resolution,
    time_axis,
)

# --- Intervals --------------------------------------------------------------------------------------------------------
#
# Interval arithmetic in float64, rounded outwards: what a formula can be over whole boxes, as certified bounds.
#
# IEEE 754 rounds sums, products, quotients and square roots correctly, so the exact result lies strictly between the
# neighbours of the computed one, and each operation here gives these neighbours. A sum that is computed as 0 is
# exactly
# 0, because float64 keeps subnormal numbers, so the sign of a difference is always known: a point on the face of a box
# is known to be on it.


def lower_of(value: np.ndarray) -> np.ndarray:
    """The float64 below each number: a lower bound of what was rounded to it."""
    return np.nextafter(value, -np.inf)


def upper_of(value: np.ndarray) -> np.ndarray:
    """The float64 above each number: an upper bound of what was rounded to it."""
    return np.nextafter(value, np.inf)


def widened(corner: np.ndarray, step: np.ndarray, sign: int) -> np.ndarray:
    """``corner + sign * step``, exactly where float64 holds it, else the neighbour on the far side."""
    step = sign * step
    with np.errstate(over="ignore", invalid="ignore"):
        moved = corner + step
        back = moved - corner
        lost = (corner - (moved - back)) + (step - back)  # what rounding took off, exactly (Knuth's two-sum)
        return np.where(lost == 0, moved, np.nextafter(moved, sign * np.inf))


class Interval:
    """Closed intervals ``[low, high]``, ``(N,)`` float64, one a box; one argument is both ends, and numbers are exact.

    Overflow makes a bound infinite or the largest number, which is sound; a NaN bounds nothing, and every comparison
    with it is false. The caller silences the warnings of NumPy (``np.errstate``).
    """

    __slots__ = ("high", "low")

    def __init__(self, low, high=None):
        self.low = np.asarray(low, dtype=np.float64)
        self.high = self.low if high is None else np.asarray(high, dtype=np.float64)

    def __neg__(self) -> "Interval":
        return Interval(-self.high, -self.low)

    def __add__(self, other) -> "Interval":
        other = _interval(other)
        low, high = self.low + other.low, self.high + other.high
        return Interval(np.where(low == 0, low, lower_of(low)), np.where(high == 0, high, upper_of(high)))

    def __sub__(self, other) -> "Interval":
        return self + -_interval(other)

    def __rsub__(self, other) -> "Interval":
        return -self + other

    def __mul__(self, other) -> "Interval":
        other = _interval(other)
        products = [_product(a, b) for a in self._ends() for b in other._ends()]
        return Interval(reduce(np.minimum, (p[0] for p in products)), reduce(np.maximum, (p[1] for p in products)))

    def _ends(self) -> tuple[np.ndarray, ...]:
        return (self.low,) if self.low is self.high else (self.low, self.high)

    def __truediv__(self, other) -> "Interval":
        """By an interval of positive numbers."""
        other = _interval(other)
        low = self.low / np.where(self.low > 0, other.high, other.low)
        high = self.high / np.where(self.high > 0, other.low, other.high)
        return Interval(np.where(self.low == 0, 0.0, lower_of(low)), np.where(self.high == 0, 0.0, upper_of(high)))

    def magnitude(self) -> "Interval":
        """The absolute value."""
        least = np.maximum(np.maximum(self.low, -self.high), 0.0)
        return Interval(least, np.maximum(-self.low, self.high))

    def square(self) -> "Interval":
        """The square."""
        size = self.magnitude()
        low, high = size.low * size.low, size.high * size.high
        return Interval(np.maximum(lower_of(low), 0.0), np.where(size.high == 0, 0.0, upper_of(high)))

    def root(self) -> "Interval":
        """The square root of what is at least 0."""
        low, high = np.sqrt(np.maximum(self.low, 0.0)), np.sqrt(np.maximum(self.high, 0.0))
        return Interval(np.maximum(lower_of(low), 0.0), np.where(high == 0, 0.0, upper_of(high)))

    def maximum(self, other) -> "Interval":
        """The larger one of two."""
        other = _interval(other)
        return Interval(np.maximum(self.low, other.low), np.maximum(self.high, other.high))

    def minimum(self, other) -> "Interval":
        """The smaller one of two."""
        other = _interval(other)
        return Interval(np.minimum(self.low, other.low), np.minimum(self.high, other.high))

    def both(self, other: "Interval") -> "Interval":
        """What lies in both of two enclosures of the same numbers."""
        return Interval(np.maximum(self.low, other.low), np.minimum(self.high, other.high))


def _interval(value) -> Interval:
    return value if isinstance(value, Interval) else Interval(value)


def _product(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of products, which are exactly 0 where a factor is."""
    product, nothing = a * b, (a == 0) | (b == 0)
    return np.where(nothing, 0.0, lower_of(product)), np.where(nothing, 0.0, upper_of(product))


def norm(parts: Iterable[Interval]) -> Interval:
    """The Euclidean length of a vector, whose coordinates vary independently of each other."""
    first, *others = parts
    if not others:
        return first.magnitude()
    total = first.square()
    for part in others:
        total = total + part.square()
    return total.root()


def columns(lower: np.ndarray, upper: np.ndarray) -> list[Interval]:
    """The coordinates of ``(N, n)`` boxes."""
    return [Interval(lower[:, k], upper[:, k]) for k in range(lower.shape[1])]


# --- Cells ------------------------------------------------------------------------------------------------------------
#
# Closed cells that hold a shape, found by dividing blocks of cells until the shape certifies them empty.
#
# A block that the shape certifies to lie in it whole is not divided either, so the work goes to the shape's border. The
# corners of each block are rounded outwards, so a block that is left out holds no point of the object, its border
# included.

MOST_AXES = 4  # coordinates; a grid of more has too many cells to be of use
CELL_BYTES = 2  # bytes a cell: the grid, and its copy in the ``Grid``
BLOCK_BYTES = 200  # bytes a block of the finest level while it is requested: index, corners, and what the shape needs
CHUNK = 2**18  # blocks that are asked for at a time
TIMES = 32  # cells of time


def cells_of(shape: Shape, resolution: int | None, margin: float) -> Grid:
    """The cells that a certified shape of ``MOST_AXES`` axes at most and its margin may meet (``Shape.to_grid``)."""
    resolution, margin = checked_resolution(resolution), checked_margin(margin)
    if not shape.certified:
        raise ShapeError(f"{shape.name}: cells need a shape that certifies boxes empty, and this one cannot")
    if shape.ndim > MOST_AXES:
        raise ShapeError(f"{shape.name}: a grid has at most {MOST_AXES} coordinates, got {shape.ndim}")
    shape = shape.dilated(margin)
    scale, first, counts = _axes(shape, resolution)
    what = f"{shape.name}: dividing it into {' x '.join(map(str, counts))} cells"
    surface = math.prod(counts) / min(counts)
    check_memory(math.prod(counts) * CELL_BYTES + surface * BLOCK_BYTES, what, "give a coarser resolution")
    return Grid(
        _divide(shape, scale, first, counts),
        cells_per_unit=scale,
        offset=first,
        name=shape.name,
        time=shape.time,
        margin=margin,
        resolution=resolution,
        note=shape.restriction,
        shape_digest=shape.geometry,
        joints=shape.joints,
    )


def _axes(shape: Shape, resolution: int) -> tuple[np.ndarray, np.ndarray, tuple[int, ...]]:
    """Cells per unit, the offset, and the number of cells of each axis."""
    space = slice(1 if shape.time else 0, None)
    rate = cells_per_unit(float(shape.extent.max()), resolution, shape.name)
    first, last = cells_around(shape.lower[space] * rate, shape.upper[space] * rate, 0.0, shape.name)
    scale, offset, counts = np.full(len(first), rate), first.astype(np.float64), last - first + 1
    if shape.time:
        often, begin, count = time_axis(float(shape.lower[0]), float(shape.upper[0]), TIMES, shape.name)
        scale, offset, counts = np.r_[often, scale], np.r_[begin + 0.5, offset], np.r_[count, counts]
    return scale, offset, tuple(counts.tolist())


def _divide(shape: Shape, scale: np.ndarray, offset: np.ndarray, counts: tuple[int, ...]) -> np.ndarray:
    occupancy, limits = np.zeros(counts, dtype=bool), np.array(counts)
    halves = np.stack(np.meshgrid(*[[0, 1]] * len(counts), indexing="ij"), axis=-1).reshape(-1, len(counts))
    waiting = [(np.zeros((1, len(counts)), dtype=np.int64), 1 << (max(counts) - 1).bit_length())]
    while waiting:  # depth first, so that few blocks wait
        blocks, size = waiting.pop()
        if len(blocks) > CHUNK:
            waiting += [(part, size) for part in np.array_split(blocks, -(-len(blocks) // CHUNK))]
            continue
        ends = np.minimum(blocks + size, limits)
        lower, upper = (lower_of((blocks - 0.5 + offset) / scale), upper_of((ends - 0.5 + offset) / scale))
        left = ~shape.empty(lower, upper)
        blocks, ends, lower, upper = blocks[left], ends[left], lower[left], upper[left]
        if size == 1:
            occupancy[tuple(blocks.T)] = True
            continue
        whole = shape.inside(lower, upper)
        for block, end in zip(blocks[whole].tolist(), ends[whole].tolist(), strict=True):
            occupancy[tuple(slice(a, b) for a, b in zip(block, end, strict=True))] = True
        size //= 2
        blocks = (blocks[~whole][:, None] + halves * size).reshape(-1, len(counts))
        waiting.append((blocks[(blocks < limits).all(axis=1)], size))
    return occupancy


# --- Solids -----------------------------------------------------------------------------------------------------------

LEAST = 5e-324  # the least positive float64: by how much a foreign shape's gap is known to differ from 0

SEARCH = 20  # halvings of each side in a search for points of the object


class Formula(Shape):
    """A shape that is not made of cells or faces; cells can be laid over it."""

    def __repr__(self) -> str:
        words = [f"{self.ndim}D", f"extent {' x '.join(f'{side:.4g}' for side in self.extent)}"]
        words += ["time first"] if self.time else []
        words += [f"margin {self.margin:g}"] if self.margin else []
        return f"<{type(self).__name__} {self.name}: {', '.join(words + [self.restriction] * bool(self.restriction))}>"

    def to_grid(self, *, resolution: int | None = None, margin: float = 0.0) -> Grid:
        return cells_of(self, resolution, margin)

    def check_contents(self, *, count: int = 4096, seed: int = 0) -> None:
        x = np.random.default_rng(seed).uniform(self.sample_lower, self.sample_upper, (count, self.ndim))
        held = self.contains(x)
        if held.all():
            raise ShapeError(f"{self.name}: there is nothing to leave out, {count} random points are in the object")
        if not held.any() and not self._found(count):
            raise ShapeError(f"{self.name}: there is nothing to bound, a search found no point in the object")

    def _found(self, most: int) -> bool:
        """Whether the centre of a box is in the object, of boxes that are halved where they are not certified empty."""
        lower, upper, space = self.lower[None], self.upper[None], np.arange(self.ndim)
        for depth in range(SEARCH * self.ndim if self.certified else 0):
            left = ~self.empty(lower, upper)
            lower, upper = lower[left][:most], upper[left][:most]
            middle = lower + (upper - lower) / 2
            if self.contains(middle).any():
                return True
            half = space == depth % self.ndim
            lower, upper = (
                np.concatenate([lower, np.where(half, middle, lower)]),
                np.concatenate([np.where(half, middle, upper), upper]),
            )
        return False


class Solid(Formula):
    """A shape with a gap; a subclass gives ``_signed_distance`` and passes its box and its numbers on to this class.

    Args:
        lower: ``(n,)``, lower corner of a box that holds the object.
        upper: ``(n,)``, upper corner.
        numbers: What makes this solid differ from others of its class, for the digest.
        name: For people.

    Attributes:
        exact: Whether the gap outside is the very distance; then the dilated object is exactly what lies within the
            margin, and else it holds that and a little more near edges.
        levels: By how much the gap is lowered, one level after the other; negative where a dilated solid is taken away.
    """

    exact: bool = True
    levels: tuple[float, ...] = ()
    _taken: int = 0  # how many of the levels its parts have taken off already

    def __init__(self, lower: np.ndarray, upper: np.ndarray, numbers: list, name: str):
        self.name = name
        self._bounds = np.array([lower, upper], dtype=np.float64)
        if not np.isfinite(self._bounds).all():
            raise ShapeError(f"{name}: expected a solid of finite size, got {lower} to {upper}")
        self._bounds.setflags(write=False)
        sha = hashlib.sha256(f"warp-bounding solid 1 {type(self).__name__}".encode())
        for number in numbers:
            sha.update(number.encode() if isinstance(number, str) else np.asarray(number, dtype="<f8").tobytes())
            sha.update(b";")
        self._digest = sha.hexdigest()

    @abstractmethod
    def _signed_distance(self, box: list[Interval]) -> Interval:
        """Encloses the gap over boxes, given as one interval for each coordinate, before it is lowered."""

    def gap(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Certified bounds of the gap over closed boxes of corners ``(N, n)`` float64.

        ``(N,)`` lower and ``(N,)`` upper bounds, float64, object units: above 0 outside the object, and there at most
        the distance to it. NaN where a corner is NaN.
        """
        with np.errstate(all="ignore"):
            gap = self._lowered(columns(lower, upper))
        return gap.low, gap.high

    def _lowered(self, box: list[Interval]) -> Interval:
        gap, (lower, upper), beyond = self._signed_distance(box), self._bounds, []
        for number, level in enumerate(self.levels):
            gap = gap if number < self._taken else gap - level
            lower, upper = self._moved(lower, level, -1), self._moved(upper, level, 1)
            beyond = [side - level for side in beyond]
            if level > 0:
                sides = list(zip(box, lower, upper, strict=True))[int(self.time) :]
                beyond += [side for x, low, high in sides for side in (-x + low, x - high)]
        return reduce(Interval.maximum, beyond, gap)

    # --- what a shape answers ----------------------------------------------------------------------------------------

    @property
    def ndim(self) -> int:
        return self._bounds.shape[1]

    @property
    def lower(self) -> np.ndarray:
        return self._widened(self._bounds[0], -1)

    @property
    def upper(self) -> np.ndarray:
        return self._widened(self._bounds[1], 1)

    def _widened(self, corner: np.ndarray, sign: int) -> np.ndarray:
        return reduce(lambda moved, level: self._moved(moved, level, sign), self.levels, corner.copy())

    def _moved(self, corner: np.ndarray, level: float, sign: int) -> np.ndarray:
        corner = corner.copy()
        space = corner[1 if self.time else 0 :]
        space[:] = widened(space, level, sign)
        return corner

    @property
    def geometry(self) -> str:
        return self._digest

    def decide(self, x: np.ndarray) -> np.ndarray:
        x = np.asarray(x, dtype=np.float64)
        low, high = self.gap(x, x)
        known = np.isfinite(x).all(axis=1)
        return np.where(known & (high <= 0), IN, np.where(known & ~(low > 0), UNDECIDED, OUT)).astype(np.uint8)

    def empty(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        return (self.gap(lower, upper)[0] > 0) & _are_boxes(lower, upper)

    def inside(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        return (self.gap(lower, upper)[1] <= 0) & _are_boxes(lower, upper)

    def clearance(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        low = self.gap(lower, upper)[0]
        return np.where((low > 0) & (low < np.inf) & _are_boxes(lower, upper), low, 0.0)

    def dilated(self, margin: float) -> "Solid":
        """The solid and all points within ``margin`` of it; where ``exact`` is False, a little more near edges."""
        margin = self._new_margin(margin)
        if margin is None:
            return self
        found = self._at_level(margin)
        found.margin = margin
        return found

    def _at_level(self, level: float) -> "Solid":
        """This solid with its gap lowered by ``level`` more."""
        found = copy(self)
        found.levels = (*self.levels, level)
        return found


class Foreign(Solid):
    """Any shape as a part of a solid; its gap is the distance, and in the object that to the border, which is unknown.

    A difference takes away the whole of it, with its border: in the object the gap is under 0 by ``LEAST`` or more.
    """

    def __init__(self, shape: Shape):
        if shape.joints is not None:
            raise ShapeError(f"{shape.name}: configurations of joints are not combined with other shapes")
        self.shape, self.time, self.certified = shape, shape.time, shape.certified
        super().__init__(shape.lower, shape.upper, [], shape.name)

    def _signed_distance(self, box: list[Interval]) -> Interval:
        lower, upper = (np.stack(side, axis=1) for side in ([x.low for x in box], [x.high for x in box]))
        empty, inside, away = self.shape.empty(lower, upper), self.shape.inside(lower, upper), None
        if empty.any():
            away = self.shape.clearance(lower, upper)
        away = np.zeros(len(lower)) if away is None else np.array(away)
        points = (lower == upper).all(axis=1)
        if points.any():
            answer, distance = self.shape.decide(lower[points]), self.shape.distance(lower[points])
            empty[points], inside[points] = answer == OUT, answer == IN
            away[points] = 0.0 if distance is None else distance
        return Interval(np.where(empty, np.maximum(away, LEAST), -np.inf), np.where(inside, -LEAST, np.inf))

    def _at_level(self, level: float) -> "Foreign":
        if level > 0 and not self.shape.margin and not self.levels:
            return Foreign(self.shape.dilated(level))
        return super()._at_level(level)


def _are_boxes(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Which boxes are finite, with their lower corner not above the upper one."""
    return (np.isfinite(lower) & np.isfinite(upper) & (lower <= upper)).all(axis=1)
