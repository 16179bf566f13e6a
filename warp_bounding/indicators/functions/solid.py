"""Solids: shapes whose gap is known over whole boxes.

The gap of a solid is a function g of points with two properties: the object is where ``g <= 0``, and g is 1-Lipschitz
in space. So outside the object g is at most the distance to it, and within it ``-g`` is at most the distance to its
border. A solid encloses its gap over closed boxes in ``intervals``, and everything else follows: a box over which the
gap stays above 0 is empty, one over which it does not pass 0 lies in the object whole. A dilation lowers the gap by
the margin; what else keeps both properties is the algebra (``combination``). Where the gap is less than the distance,
a lowered one holds more than what lies within the margin, next to edges; beyond the solid's box, wider by the margin,
it holds nothing.
"""

import hashlib
from abc import abstractmethod
from copy import copy
from functools import reduce

import numpy as np

from warp_bounding.errors import IndicatorError
from warp_bounding.indicators.functions.cells import cells_of
from warp_bounding.indicators.functions.intervals import Interval, columns, widened
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.shape import IN, OUT, UNDECIDED, Shape

__all__ = ["Foreign", "Formula", "Solid"]

LEAST = 5e-324  # the least positive float64: by how much a foreign shape's gap is known to differ from 0

SEARCH = 20  # halvings of each side in a search for points of the object


class Formula(Shape):
    """A shape that is not made of cells or faces; cells can be laid over it."""

    def __repr__(self) -> str:
        words = [f"{self.ndim}D", f"extent {' x '.join(f'{side:.4g}' for side in self.extent)}"]
        words += ["time first"] if self.time else []
        words += [f"margin {self.margin:g}"] if self.margin else []
        return f"<{type(self).__name__} {self.name}: {', '.join(words + [self.restriction] * bool(self.restriction))}>"

    def to_grid(self, *, resolution: int | None = None, margin: float = 0.0) -> IndicatorGrid:
        """An ``IndicatorGrid`` of closed cells that hold every point within ``margin`` of the shape, at most 4-D.

        Args:
            resolution: Cells along the longest side of the dilated object, 2 to 1024; 64 for ``None``.
            margin: Object units, at least 0.

        Raises:
            IndicatorError: For a shape without certificates or of more than 4 coordinates, an impossible resolution
                or margin, or more cells than this machine can hold.
        """
        return cells_of(self, resolution, margin)

    def check_contents(self, *, count: int = 4096, seed: int = 0) -> None:
        """Refuse a shape that holds nothing or everything, as far as a search tells.

        Args:
            count: Random points, and boxes of a search at a time for a shape that certifies boxes.
            seed: Of the random points.

        Raises:
            IndicatorError: If no point was found in the object, or of random points none outside.
        """
        x = np.random.default_rng(seed).uniform(self.sample_lower, self.sample_upper, (count, self.ndim))
        held = self.contains(x)
        if held.all():
            raise IndicatorError(f"{self.name}: there is nothing to leave out, {count} random points are in the object")
        if not held.any() and not self._found(count):
            raise IndicatorError(f"{self.name}: there is nothing to bound, a search found no point in the object")

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
    """A shape with a gap; a subclass gives ``_gap`` and passes its box and its numbers on to this class.

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
            raise IndicatorError(f"{name}: expected a solid of finite size, got {lower} to {upper}")
        self._bounds.setflags(write=False)
        sha = hashlib.sha256(f"warp-bounding solid 1 {type(self).__name__}".encode())
        for number in numbers:
            sha.update(number.encode() if isinstance(number, str) else np.asarray(number, dtype="<f8").tobytes())
            sha.update(b";")
        self._digest = sha.hexdigest()

    @abstractmethod
    def _gap(self, box: list[Interval]) -> Interval:
        """Encloses the gap over boxes, given as one interval for each coordinate, before it is lowered."""

    def gap(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Certified bounds of the gap over closed boxes.

        Args:
            lower: ``(N, n)`` float64, lower corners.
            upper: ``(N, n)`` float64, upper corners.

        Returns:
            ``(N,)`` lower and ``(N,)`` upper bounds, float64, object units: above 0 outside the object, and there at
            most the distance to it. NaN where a corner is NaN.
        """
        with np.errstate(all="ignore"):
            gap = self._lowered(columns(lower, upper))
        return gap.low, gap.high

    def _lowered(self, box: list[Interval]) -> Interval:
        gap, (lower, upper), beyond = self._gap(box), self._bounds, []
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
        """SHA-256 of the solid's kind and numbers, the margin not included; the name does not enter."""
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

    def distance(self, x: np.ndarray) -> np.ndarray:
        """Lower bounds ``(N,)`` of the distance from points to the object, in space; 0 out of its time."""
        x = np.asarray(x, dtype=np.float64)
        return self.clearance(x, x)

    def clearance(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Lower bounds ``(N,)`` of the distance from boxes to the object, in space; 0 out of its time."""
        low = self.gap(lower, upper)[0]
        return np.where((low > 0) & (low < np.inf) & _are_boxes(lower, upper), low, 0.0)

    def dilated(self, margin: float) -> "Solid":
        """The solid and all points within ``margin`` of it; where ``exact`` is False, a little more near edges.

        Raises:
            IndicatorError: For a margin that is negative or not finite, or a solid that is dilated already.
        """
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

    Args:
        shape: Any shape.
    """

    def __init__(self, shape: Shape):
        if shape.joints is not None:
            raise IndicatorError(f"{shape.name}: configurations of joints are not combined with other shapes")
        self.shape, self.time, self.certified = shape, shape.time, shape.certified
        super().__init__(shape.lower, shape.upper, [], shape.name)

    def _gap(self, box: list[Interval]) -> Interval:
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
