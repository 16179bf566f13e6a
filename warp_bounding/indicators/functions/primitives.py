"""The solids that others are made of: sphere, box, capsule, half-space and torus, in any number of dimensions.

Their numbers are float64 and mean exactly what they are; what is computed with them is enclosed in intervals. Of a
sphere, box or torus the gap over a box is exact but for rounding, because it depends on each coordinate on its own or
through sums of squares.
"""

import math

import numpy as np

from warp_bounding.errors import IndicatorError
from warp_bounding.indicators.functions.combination import Combinable
from warp_bounding.indicators.functions.intervals import Interval, norm, widened
from warp_bounding.indicators.functions.parameters import checked_corners, checked_number, checked_vector
from warp_bounding.indicators.functions.solid import Solid

__all__ = ["Box", "Capsule", "HalfSpace", "Sphere", "Torus"]

TINY_LENGTH = 1e-150  # object units; a shorter vector has no direction, because its square has lost its digits
MOST_CORNERS = 12  # coordinates up to which all 2^n corners of a box are landmarks
SHORTER = 1.0 - 2.0**-40  # makes a computed unit vector of fewer than 2^10 coordinates no longer than 1


class Sphere(Combinable, Solid):
    """All points within a radius of a centre.

    Args:
        center: ``(n,)``, object space.
        radius: Object units, above 0.
        name: For people.

    Raises:
        IndicatorError: For numbers that are not finite, or a radius that is not above 0.

    Example:
        >>> ball4 = wb.solids.Sphere([0, 0, 0, 0], 1.5)
        >>> ball4.empty(np.full((1, 4), 0.8), np.full((1, 4), 2.0))
        array([ True])
    """

    def __init__(self, center, radius: float, *, name: str = "sphere"):
        self.center, self.radius = checked_vector(center, "center", name), checked_number(radius, "radius", name)
        corners = widened(self.center, self.radius, -1), widened(self.center, self.radius, 1)
        super().__init__(*corners, [self.center, self.radius], name)

    def _gap(self, box: list[Interval]) -> Interval:
        return norm(x - c for x, c in zip(box, self.center, strict=True)) - self.radius

    def landmarks(self) -> np.ndarray:
        return self.center + self.radius * _directions(self.ndim)


class Box(Combinable, Solid):
    """A closed box with sides along the axes; which points lie in it is decided exactly.

    Args:
        lower: ``(n,)``, lower corner, object space.
        upper: ``(n,)``, upper corner, above the lower one in each coordinate.
        name: For people.

    Raises:
        IndicatorError: For numbers that are not finite, or corners that are none.

    Example:
        >>> wb.solids.Box([0, 0], [2, 1]).contains(np.array([[2.0, 1.0], [2.0, 1.1]]))
        array([ True, False])
    """

    def __init__(self, lower, upper, *, name: str = "box"):
        lower, upper = checked_corners(lower, upper, name)
        super().__init__(lower, upper, [lower, upper], name)

    def _gap(self, box: list[Interval]) -> Interval:
        return gap_of_box(box, *self._bounds)

    def landmarks(self) -> np.ndarray:
        corners = np.stack(np.meshgrid(*self._bounds.T, indexing="ij"), axis=-1)
        return corners.reshape(-1, self.ndim) if self.ndim <= MOST_CORNERS else np.empty((0, self.ndim))


def gap_of_box(box: list[Interval], lower: np.ndarray, upper: np.ndarray) -> Interval:
    """The signed distance to a box: how far outside, or within how near the nearest face, as a negative number."""
    beyond = [(Interval(a) - x).maximum(x - b) for x, a, b in zip(box, lower, upper, strict=True)]
    most = beyond[0]
    for each in beyond[1:]:
        most = most.maximum(each)
    away = norm(each.maximum(0.0) for each in beyond)
    low = np.where(most.low > 0, np.maximum(away.low, most.low), most.low)
    return Interval(low, np.where(most.high > 0, np.maximum(away.high, most.high), most.high))


class Capsule(Combinable, Solid):
    """All points within a radius of a segment.

    Args:
        start: ``(n,)``, where the segment begins, object space.
        end: ``(n,)``, where it ends.
        radius: Object units, above 0.
        name: For people.

    Raises:
        IndicatorError: For numbers that are not finite, ends of different length, or a radius that is not above 0.

    Example:
        >>> arm = wb.solids.Capsule([0, 0, 0], [1, 1, 0], 0.25)
        >>> arm.distance(np.array([[0.0, 0.0, 2.25]])).round(3)
        array([2.])
    """

    def __init__(self, start, end, radius: float, *, name: str = "capsule"):
        self.start, self.end = checked_vector(start, "start", name), checked_vector(end, "end", name)
        if self.start.shape != self.end.shape:
            raise IndicatorError(f"{name}: expected two ends of one length, got {len(self.start)} and {len(self.end)}")
        self.radius = checked_number(radius, "radius", name)
        least, most = np.minimum(self.start, self.end), np.maximum(self.start, self.end)
        corners = widened(least, self.radius, -1), widened(most, self.radius, 1)
        super().__init__(*corners, [self.start, self.end, self.radius], name)
        self._way = [Interval(b) - a for a, b in zip(self.start, self.end, strict=True)]

    def _gap(self, box: list[Interval]) -> Interval:
        """Bounds from a point of the segment near the box's centre, and from a direction that separates them.

        The farthest corner of the box from any point of the segment is at least as far as any of its points from the
        segment. And for any u of length 1 or less, a distance is at least the difference of the two in direction u.
        Which point and which u decide only how tight the bounds are.
        """
        middle = [(x.low + x.high) / 2 for x in box]
        way = np.array(self.end) - self.start
        along = sum((m - a) * w for m, a, w in zip(middle, self.start, way, strict=True))
        share = np.clip(np.nan_to_num(along / max(float(way @ way), TINY_LENGTH)), 0.0, 1.0)
        near = [w * Interval(share) + a for w, a in zip(self._way, self.start, strict=True)]
        high = norm(x - p for x, p in zip(box, near, strict=True)).high
        u = [m - (p.low + p.high) / 2 for m, p in zip(middle, near, strict=True)]
        length = np.sqrt(sum(each * each for each in u)) / SHORTER
        u = [np.where(length > TINY_LENGTH, each / length, 0.0) for each in u]
        beyond, onward = Interval(0.0), Interval(0.0)
        for x, a, w, each in zip(box, self.start, self._way, u, strict=True):
            beyond, onward = beyond + (x - a) * Interval(each), onward + w * Interval(each)
        apart = beyond - onward.maximum(0.0)
        return Interval(np.maximum(apart.low, 0.0), np.maximum(high, 0.0)) - self.radius

    def landmarks(self) -> np.ndarray:
        return np.concatenate([end + self.radius * _directions(self.ndim) for end in (self.start, self.end)])


class HalfSpace(Combinable, Solid):
    """The points of a box on one side of a plane, ``normal . x <= offset``.

    Args:
        normal: ``(n,)``, points away from the object, of any length but 0.
        offset: Of the plane, in units of the normal's length times object units.
        lower: ``(n,)``, lower corner of the box that bounds it, object space.
        upper: ``(n,)``, upper corner.
        name: For people.

    Raises:
        IndicatorError: For numbers that are not finite, a normal that is 0, or corners that are none.

    Example:
        >>> below = wb.solids.HalfSpace([0, 0, 2], 1.0, lower=[-1, -1, -1], upper=[1, 1, 1])
        >>> below.contains(np.array([[0, 0, 0.5], [0, 0, 0.6], [0, 2, 0]]))
        array([ True, False, False])
    """

    exact = False

    def __init__(self, normal, offset: float, lower, upper, *, name: str = "half-space"):
        self.normal = checked_vector(normal, "normal", name)
        self.offset = checked_number(offset, "offset", name, least=-math.inf)
        lower, upper = checked_corners(lower, upper, name)
        if self.normal.shape != lower.shape or not np.linalg.norm(self.normal) > TINY_LENGTH:
            raise IndicatorError(f"{name}: expected a normal of {len(lower)} numbers, not all 0, got {normal}")
        self._length = norm(Interval(each) for each in self.normal)
        super().__init__(lower, upper, [self.normal, self.offset, lower, upper], name)

    def _gap(self, box: list[Interval]) -> Interval:
        beyond = Interval(-self.offset)
        for x, each in zip(box, self.normal, strict=True):
            beyond = beyond + (x * each if each else Interval(0.0))
        return (beyond / self._length).maximum(gap_of_box(box, *self._bounds))

    def landmarks(self) -> np.ndarray:
        corners = Box(*self._bounds).landmarks()
        return corners[self.contains(corners)]


class Torus(Combinable, Solid):
    """All points within ``minor`` of a circle with the radius ``major`` around an axis.

    In n dimensions the circle is a sphere: the points at the distance ``major`` from the centre whose coordinate along
    the axis is the centre's. In 2-D these are two points. ``Transform`` turns it elsewhere.

    Args:
        center: ``(n,)``, n at least 2, object space.
        major: Radius of the circle, object units, above 0.
        minor: Radius of the tube, object units, above 0.
        axis: Number of the coordinate that the axis is parallel to; the last one by default.
        name: For people.

    Raises:
        IndicatorError: For numbers that are not finite, radii that are not above 0, or an axis that is none.

    Example:
        >>> ring = wb.solids.Torus([0, 0, 0], 1.0, 0.25)
        >>> ring.contains(np.array([[0, 0, 0], [1, 0, 0.2]]))
        array([False,  True])
    """

    def __init__(self, center, major: float, minor: float, *, axis: int = -1, name: str = "torus"):
        self.center = checked_vector(center, "center", name)
        self.major, self.minor = checked_number(major, "major", name), checked_number(minor, "minor", name)
        n = len(self.center)
        if n < 2 or isinstance(axis, bool) or not isinstance(axis, (int, np.integer)) or not -n <= axis < n:
            raise IndicatorError(f"{name}: expected 2 coordinates or more, and one of them as axis, got {n}, {axis!r}")
        self.axis = int(axis) % n
        reach = np.full(n, widened(self.major, self.minor, 1))
        reach[self.axis] = self.minor
        corners = widened(self.center, reach, -1), widened(self.center, reach, 1)
        super().__init__(*corners, [self.center, self.major, self.minor, self.axis], name)

    def _gap(self, box: list[Interval]) -> Interval:
        about = [x - c for x, c in zip(box, self.center, strict=True)]
        along = about.pop(self.axis)
        return norm([norm(about) - self.major, along]) - self.minor

    def landmarks(self) -> np.ndarray:
        steps = _directions(self.ndim)
        steps = steps[steps[:, self.axis] == 0]
        rims = [steps * (self.major + self.minor)]
        for side in (-self.minor, self.minor):
            rims.append(steps * self.major + side * np.eye(self.ndim)[self.axis])
        return self.center + np.concatenate(rims)


def _directions(n: int) -> np.ndarray:
    """``(2 n, n)``, both ways along each axis."""
    return np.concatenate([np.eye(n), -np.eye(n)])
