"""The algebra of solids: primitives, unions, intersections, differences, dilations, transforms and extrusions."""

import math
from functools import reduce

import numpy as np

from warp_bounding.errors import ShapeError
from warp_bounding.shapes.formula import Foreign, Interval, Solid, norm, widened
from warp_bounding.shapes.shape import Shape, checked_corners, checked_margin, checked_number, checked_vector

# --- The algebra ------------------------------------------------------------------------------------------------------
#
# The algebra: unions, intersections, differences and dilations of shapes, and the operators that make them.
#
# Minimum and maximum, a change of sign and of level keep the properties of a gap (``formula``): that of a union is the
# least gap of its parts, that of an intersection the largest, that of a difference ``max(a, -b)``. Every shape can be a
# part: one that is no solid counts with its own answers about points and boxes (``Foreign``).


class Combinable:
    """What has the operators ``|``, ``&`` and ``-``, on either side of any shape."""

    def __or__(self, other: Shape) -> "Union":
        return Union(self, other) if isinstance(other, Shape) else NotImplemented

    def __ror__(self, other: Shape) -> "Union":
        return Union(other, self) if isinstance(other, Shape) else NotImplemented

    def __and__(self, other: Shape) -> "Intersection":
        return Intersection(self, other) if isinstance(other, Shape) else NotImplemented

    def __rand__(self, other: Shape) -> "Intersection":
        return Intersection(other, self) if isinstance(other, Shape) else NotImplemented

    def __sub__(self, other: Shape) -> "Difference":
        return Difference(self, other) if isinstance(other, Shape) else NotImplemented

    def __rsub__(self, other: Shape) -> "Difference":
        return Difference(other, self) if isinstance(other, Shape) else NotImplemented


class Combination(Combinable, Solid):
    """A solid that is made of others, which carry its level.

    Args:
        parts: At least one shape, all of the same coordinates.
        lower: ``(n,)``, lower corner of a box that holds the object; that of the parts where it is ``None``.
        upper: ``(n,)``, upper corner.
        numbers: What else makes this solid differ from others of its class.
        name: For people.

    Attributes:
        parts: The shapes that it is made of.

    Raises:
        ShapeError: For parts that are no shapes, or do not have the same coordinates.
    """

    signs: tuple[int, ...] | None = None  # of the parts' levels; all 1 for None

    def __init__(self, parts: tuple[Shape, ...], lower: np.ndarray, upper: np.ndarray, numbers: list, name: str):
        self.parts, self.time = parts, parts[0].time
        self._solids = tuple(part if isinstance(part, Solid) else Foreign(part) for part in parts)
        own = [text for part in parts for text in (part.geometry, repr(part.margin))]
        super().__init__(lower, upper, [*numbers, *own], name)

    @property
    def restriction(self) -> str:
        """Its own, and those of its parts, by their names."""
        parts = [f"{part.name}: {part.restriction}" for part in self.parts if part.restriction]
        return "; ".join(dict.fromkeys(filter(None, [self.note, *parts])))

    def _signed_distances(self, box: list[Interval]) -> list[Interval]:
        return [solid._lowered(box) for solid in self._solids]

    def _at_level(self, level: float) -> "Combination":
        found, signs = super()._at_level(level), self.signs or (1,) * len(self._solids)
        found._solids = tuple(solid._at_level(sign * level) for solid, sign in zip(self._solids, signs, strict=True))
        found._taken = len(found.levels)
        return found

    def landmarks(self) -> np.ndarray:
        found = np.concatenate([part.landmarks() for part in self.parts])
        return found[self.contains(found)]


class Union(Combination):
    """All points of any of several shapes.

    Args:
        parts: At least one shape, all of the same coordinates.
        name: For people.

    Raises:
        ShapeError: For parts that are no shapes, or do not have the same coordinates.

    Example:
        >>> both = wb.shapes.Sphere([0, 0, 0], 1) | wb.shapes.Sphere([1, 0, 0], 1)
        >>> both.contains(np.array([[1.5, 0, 0], [0.5, 1, 0]]))
        array([ True, False])
    """

    def __init__(self, *parts: Shape, name: str = "union"):
        lower, upper = _corners(parts, name)
        super().__init__(parts, lower.min(axis=0), upper.max(axis=0), [], name)
        self.certified = all(part.certified for part in parts)
        self.exact = all(solid.exact for solid in self._solids)

    def _signed_distance(self, box: list[Interval]) -> Interval:
        return reduce(Interval.minimum, self._signed_distances(box))


class Intersection(Combination):
    """The points that several shapes have in common; its gap is not the distance where an edge is next.

    Args:
        parts: At least one shape, all of the same coordinates.
        name: For people.

    Raises:
        ShapeError: For parts that are no shapes, do not have the same coordinates, or lie apart.

    Example:
        >>> lens = wb.shapes.Sphere([0, 0], 1) & wb.shapes.Sphere([1, 0], 1)
        >>> lens.lower, lens.upper
        (array([ 0., -1.]), array([1., 1.]))
    """

    exact = False

    def __init__(self, *parts: Shape, name: str = "intersection"):
        lower, upper = _corners(parts, name)
        lower, upper = lower.max(axis=0), upper.min(axis=0)
        if (lower > upper).any():
            raise ShapeError(f"{name}: there is nothing to bound, the parts lie apart from each other")
        super().__init__(parts, lower, upper, [], name)
        self.certified = any(part.certified for part in parts)

    def _signed_distance(self, box: list[Interval]) -> Interval:
        return reduce(Interval.maximum, self._signed_distances(box))


class Difference(Combination):
    """The points of a shape that do not lie inside of another one: the border of what is taken away stays.

    Of a shape that is no solid the border goes too, as its answers do not tell it from the inside.

    Args:
        shape: What something is taken away from.
        removed: What is taken away; where the difference is dilated, what is taken away shrinks.
        name: For people.

    Raises:
        ShapeError: For parts that are no shapes, or do not have the same coordinates.

    Example:
        >>> shell = wb.shapes.Sphere([0, 0], 1) - wb.shapes.Sphere([0, 0], 0.5)
        >>> shell.contains(np.array([[0.0, 0.0], [0.75, 0.0]]))
        array([False,  True])
    """

    exact = False
    signs = (1, -1)

    def __init__(self, shape: Shape, removed: Shape, *, name: str = "difference"):
        lower, upper = _corners((shape, removed), name)
        super().__init__((shape, removed), lower[0], upper[0], [], name)
        self.certified = shape.certified

    def _signed_distance(self, box: list[Interval]) -> Interval:
        gap, removed = self._signed_distances(box)
        return gap.maximum(-removed)


class Dilation(Combination):
    """A shape and all points within a radius of it, as a solid that may be dilated once more.

    Args:
        shape: What is dilated. What ``dilated`` says of it holds here.
        radius: Object units, at least 0.
        name: For people.

    Raises:
        ShapeError: For no shape, a shape that cannot be dilated, or a radius that is negative or not finite.

    Example:
        >>> rounded = wb.shapes.Dilation(wb.shapes.Box([0, 0], [1, 1]), 0.5)
        >>> rounded.contains(np.array([[1.5, 0.5], [1.4, 1.4]]))
        array([ True, False])
    """

    def __init__(self, shape: Shape, radius: float, *, name: str = "dilation"):
        (lower,), (upper,) = _corners((shape,), name)
        radius = checked_margin(radius)
        super().__init__((shape,), lower, upper, [radius], name)
        self.certified, self.exact = shape.certified, self._solids[0].exact
        self._solids = (self._solids[0]._at_level(radius),)
        self._bounds = np.array([self._solids[0].lower, self._solids[0].upper])

    def _signed_distance(self, box: list[Interval]) -> Interval:
        return self._signed_distances(box)[0]


def check_parts(parts: tuple[Shape, ...], name: str) -> None:
    """Refuse to combine what is no shape, and shapes that do not have the same coordinates.

    Raises:
        ShapeError: Naming what came.
    """
    if not parts or not all(isinstance(part, Shape) for part in parts):
        got = ", ".join(type(part).__name__ for part in parts) or "none"
        raise ShapeError(f"{name}: expected at least one shape, and nothing but shapes, got {got}")
    if len({(part.ndim, part.time) for part in parts}) > 1:
        got = ", ".join(f"{part.name} ({part.ndim}D{', time first' if part.time else ''})" for part in parts)
        raise ShapeError(f"{name}: expected shapes of the same coordinates, got {got}")


def _corners(parts: tuple[Shape, ...], name: str) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corners of the parts, each ``(P, n)``, after ``check_parts``."""
    check_parts(parts, name)
    return np.array([part.lower for part in parts]), np.array([part.upper for part in parts])


# --- Primitives -------------------------------------------------------------------------------------------------------
#
# The solids that others are made of: sphere, box, capsule, half-space and torus, in any number of dimensions.
#
# Their numbers are float64 and mean exactly what they are; what is computed with them is enclosed in intervals. Of a
# sphere, box or torus the gap over a box is exact but for rounding, because it depends on each coordinate on its own or
# through sums of squares.

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
        ShapeError: For numbers that are not finite, or a radius that is not above 0.

    Example:
        >>> ball4 = wb.shapes.Sphere([0, 0, 0, 0], 1.5)
        >>> ball4.empty(np.full((1, 4), 0.8), np.full((1, 4), 2.0))
        array([ True])
    """

    def __init__(self, center, radius: float, *, name: str = "sphere"):
        self.center, self.radius = checked_vector(center, "center", name), checked_number(radius, "radius", name)
        corners = widened(self.center, self.radius, -1), widened(self.center, self.radius, 1)
        super().__init__(*corners, [self.center, self.radius], name)

    def _signed_distance(self, box: list[Interval]) -> Interval:
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
        ShapeError: For numbers that are not finite, or corners that are none.

    Example:
        >>> wb.shapes.Box([0, 0], [2, 1]).contains(np.array([[2.0, 1.0], [2.0, 1.1]]))
        array([ True, False])
    """

    def __init__(self, lower, upper, *, name: str = "box"):
        lower, upper = checked_corners(lower, upper, name)
        super().__init__(lower, upper, [lower, upper], name)

    def _signed_distance(self, box: list[Interval]) -> Interval:
        return signed_distance_of_box(box, *self._bounds)

    def landmarks(self) -> np.ndarray:
        corners = np.stack(np.meshgrid(*self._bounds.T, indexing="ij"), axis=-1)
        return corners.reshape(-1, self.ndim) if self.ndim <= MOST_CORNERS else np.empty((0, self.ndim))


def signed_distance_of_box(box: list[Interval], lower: np.ndarray, upper: np.ndarray) -> Interval:
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
        ShapeError: For numbers that are not finite, ends of different length, or a radius that is not above 0.

    Example:
        >>> arm = wb.shapes.Capsule([0, 0, 0], [1, 1, 0], 0.25)
        >>> arm.distance(np.array([[0.0, 0.0, 2.25]])).round(3)
        array([2.])
    """

    def __init__(self, start, end, radius: float, *, name: str = "capsule"):
        self.start, self.end = checked_vector(start, "start", name), checked_vector(end, "end", name)
        if self.start.shape != self.end.shape:
            raise ShapeError(f"{name}: expected two ends of one length, got {len(self.start)} and {len(self.end)}")
        self.radius = checked_number(radius, "radius", name)
        least, most = np.minimum(self.start, self.end), np.maximum(self.start, self.end)
        corners = widened(least, self.radius, -1), widened(most, self.radius, 1)
        super().__init__(*corners, [self.start, self.end, self.radius], name)
        self._way = [Interval(b) - a for a, b in zip(self.start, self.end, strict=True)]

    def _signed_distance(self, box: list[Interval]) -> Interval:
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
        ShapeError: For numbers that are not finite, a normal that is 0, or corners that are none.

    Example:
        >>> below = wb.shapes.HalfSpace([0, 0, 2], 1.0, lower=[-1, -1, -1], upper=[1, 1, 1])
        >>> below.contains(np.array([[0, 0, 0.5], [0, 0, 0.6], [0, 2, 0]]))
        array([ True, False, False])
    """

    exact = False

    def __init__(self, normal, offset: float, lower, upper, *, name: str = "half-space"):
        self.normal = checked_vector(normal, "normal", name)
        self.offset = checked_number(offset, "offset", name, least=-math.inf)
        lower, upper = checked_corners(lower, upper, name)
        if self.normal.shape != lower.shape or not np.linalg.norm(self.normal) > TINY_LENGTH:
            raise ShapeError(f"{name}: expected a normal of {len(lower)} numbers, not all 0, got {normal}")
        self._length = norm(Interval(each) for each in self.normal)
        super().__init__(lower, upper, [self.normal, self.offset, lower, upper], name)

    def _signed_distance(self, box: list[Interval]) -> Interval:
        beyond = Interval(-self.offset)
        for x, each in zip(box, self.normal, strict=True):
            beyond = beyond + (x * each if each else Interval(0.0))
        return (beyond / self._length).maximum(signed_distance_of_box(box, *self._bounds))

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
        ShapeError: For numbers that are not finite, radii that are not above 0, or an axis that is none.

    Example:
        >>> ring = wb.shapes.Torus([0, 0, 0], 1.0, 0.25)
        >>> ring.contains(np.array([[0, 0, 0], [1, 0, 0.2]]))
        array([False,  True])
    """

    def __init__(self, center, major: float, minor: float, *, axis: int = -1, name: str = "torus"):
        self.center = checked_vector(center, "center", name)
        self.major, self.minor = checked_number(major, "major", name), checked_number(minor, "minor", name)
        n = len(self.center)
        if n < 2 or isinstance(axis, bool) or not isinstance(axis, (int, np.integer)) or not -n <= axis < n:
            raise ShapeError(f"{name}: expected 2 coordinates or more, and one of them as axis, got {n}, {axis!r}")
        self.axis = int(axis) % n
        reach = np.full(n, widened(self.major, self.minor, 1))
        reach[self.axis] = self.minor
        corners = widened(self.center, reach, -1), widened(self.center, reach, 1)
        super().__init__(*corners, [self.center, self.major, self.minor, self.axis], name)

    def _signed_distance(self, box: list[Interval]) -> Interval:
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


# --- Transforms -------------------------------------------------------------------------------------------------------
#
# A shape that is turned, scaled and moved, with the error of a rotation that is not quite one counted.

ORTHOGONAL = 1e-5  # how far R^T R may be from the identity (Frobenius norm); of float32 rotations it is about 1e-7


class Transform(Combination):
    """A shape in another place: a point x is in it where ``R^T (x - translation) / scale`` is in the shape.

    That is what it means for the very numbers that are given, although R is only nearly a rotation: R^T stretches
    lengths by at most ``sqrt(1 + e)``, where e bounds the norm of ``R^T R - 1``, and distances are divided by that.

    Args:
        shape: Any shape of n coordinates, none of them time.
        rotation: ``(n, n)``, R, whose columns are the shape's axes after it was turned; the identity for ``None``. It
            may mirror.
        translation: ``(n,)``, where the shape's origin goes, object space; 0 for ``None``.
        scale: Uniform, above 0.
        name: For people.

    Raises:
        ShapeError: For no shape, or one of time; a matrix that is no rotation to within ``ORTHOGONAL``; numbers
            that are not finite, or a scale that is not above 0.

    Example:
        >>> quarter = wb.shapes.Transform(wb.shapes.Box([0, 0], [2, 1]), [[0, -1], [1, 0]], scale=2.0)
        >>> quarter.lower, quarter.upper
        (array([-2.,  0.]), array([0., 4.]))
    """

    def __init__(self, shape: Shape, rotation=None, translation=None, scale: float = 1.0, *, name: str = "transform"):
        check_parts((shape,), name)
        n = shape.ndim
        if shape.time:
            raise ShapeError(f"{name}: a shape of time cannot be turned or scaled; place it before it is moved")
        self.translation = checked_vector(np.zeros(n) if translation is None else translation, "translation", name)
        if len(self.translation) != n:
            raise ShapeError(f"{name}: translation must have {n} numbers, got {len(self.translation)}")
        self.scale = checked_number(scale, "scale", name)
        self.rotation, self.error = _checked_rotation(rotation, n, name)
        self._stretch = (Interval(self.error) + 1.0).root() if self.error else Interval(1.0)
        self._tilted = np.count_nonzero(self.rotation) > n
        numbers = [self.rotation, self.translation, self.scale]
        super().__init__((shape,), *self._corners(shape), numbers, name)
        self.certified, self.exact = shape.certified, self._solids[0].exact

    def _corners(self, shape: Shape) -> tuple[np.ndarray, np.ndarray]:
        """A box around the shape's own box in its new place: that of R, wider by what R^-T differs from it."""
        box = [Interval(a, b) * self.scale for a, b in zip(shape.lower, shape.upper, strict=True)]
        if self.error:
            wider = norm(box) * self.error * 2.0  # |R^-T - R| <= sqrt(1 + e) e / (1 - e) < 2 e
            room = Interval(-wider.high, wider.high)
        placed = []
        for row, t in zip(self.rotation, self.translation, strict=True):
            total = _dot(box, row)
            placed.append((total + room if self.error else total) + t)
        return np.array([side.low for side in placed]), np.array([side.high for side in placed])

    def _signed_distance(self, box: list[Interval]) -> Interval:
        gap = self._placed_signed_distance(box)
        if not self._tilted:
            return gap
        # A box that is turned has a larger box around it: where that costs more than the ball around the box does,
        # the gap at the centre, from which it changes by the half-diagonal at most, bounds it better.
        center = [x.low / 2 + x.high / 2 for x in box]
        reach = norm((x - c).magnitude() for x, c in zip(box, center, strict=True)).high
        return gap.both(self._placed_signed_distance([Interval(c) for c in center]) + Interval(-reach, reach))

    def _placed_signed_distance(self, box: list[Interval]) -> Interval:
        moved = [x - t if t else x for x, t in zip(box, self.translation, strict=True)]
        own = [_dot(moved, column) for column in self.rotation.T]
        if self.scale != 1.0:
            own = [x / self.scale for x in own]
        gap = self._signed_distances(own)[0]
        gap = gap * self.scale if self.scale != 1.0 else gap
        return gap / self._stretch if self.error else gap

    def _at_level(self, level: float) -> "Transform":
        found = Solid._at_level(self, level)
        if level > 0 and not self.levels and isinstance(self._solids[0], Foreign):
            # A shape that is no solid dilates itself; so that nothing is lost, by a little more than was requested.
            own = Interval(level) * self._stretch / self.scale
            found._solids, found._taken = (self._solids[0]._at_level(float(own.high)),), 1
        return found

    def landmarks(self) -> np.ndarray:
        return self.parts[0].landmarks() @ self.rotation.T * self.scale + self.translation


def _dot(box: list[Interval], numbers: np.ndarray) -> Interval:
    """Sum of products, without those with 0; those with 1 and -1 are exact."""
    own = [(x, float(r)) for x, r in zip(box, numbers, strict=True) if r]
    terms = [{1.0: x, -1.0: -x}.get(r) or x * r for x, r in own]
    return reduce(Interval.__add__, terms)


def _checked_rotation(rotation, n: int, name: str) -> tuple[np.ndarray, float]:
    """R, read-only, and a bound of the spectral norm of ``R^T R - 1``, 0 where it is the identity matrix exactly.

    Raises:
        ShapeError: For a matrix that is no rotation.
    """
    try:
        found = np.array(np.eye(n) if rotation is None else rotation, dtype=np.float64)
    except (TypeError, ValueError):
        found = np.empty(0)
    if found.shape != (n, n) or not np.isfinite(found).all():
        raise ShapeError(f"{name}: rotation must be finite numbers of shape ({n}, {n}), got {rotation!r}")
    error = 0.0
    if not ((found == np.rint(found)).all() and (found.T @ found == np.eye(n)).all()):  # whole numbers are exact
        products = [
            sum((Interval(a) * b for a, b in zip(found[:, i], found[:, j], strict=True)), Interval(-float(i == j)))
            for i in range(n)
            for j in range(n)
        ]
        error = float(norm(products).high)
    if not error <= ORTHOGONAL:
        raise ShapeError(f"{name}: rotation must be orthogonal, got a matrix R with |R^T R - 1| = {error:.3g}")
    found.setflags(write=False)
    return found, error


# --- Extrusions -------------------------------------------------------------------------------------------------------
#
# A shape that moves through time: from keyframe to keyframe on straight ways, certified in time and space at once.


class Extrusion(Combination):
    """A shape in space and time, time first: at time t it is the shape, moved by the offset at t.

    Offsets go straight from one keyframe to the next. Before the first and after the last one there is nothing, and
    nothing is known there: bounders answer with *maybe*. The margin and distances are those in space, at each time.

    Args:
        shape: Any shape of n coordinates, none of them time.
        times: ``(K,)``, ascending, at least two; rounded to float32, as those of ``MovingMesh``.
        offsets: ``(K, n)``, where the shape's origin is at each keyframe, object space.
        name: For people.

    Raises:
        ShapeError: For no shape, or one of time; for times that do not ascend, or numbers that are not finite.

    Example:
        >>> thrown = wb.shapes.Extrusion(wb.shapes.Sphere([0, 0], 0.5), [0, 1, 2], [[0, 0], [2, 1], [4, 0]])
        >>> thrown.contains(np.array([[1.0, 2.0, 1.0], [1.5, 3.0, 0.5], [1.5, 2.0, 1.0]]))
        array([ True,  True, False])
        >>> thrown.empty(np.array([[0.0, 1.5, -1.0]]), np.array([[0.25, 9.0, 9.0]]))
        array([ True])
    """

    def __init__(self, shape: Shape, times, offsets, *, name: str = "extrusion"):
        check_parts((shape,), name)
        if shape.time:
            raise ShapeError(f"{name}: expected a shape at rest, and {shape.name} moves already")
        with np.errstate(over="ignore"):
            self.times = np.array(times, dtype=np.float32).astype(np.float64)
        self.offsets = np.array(offsets, dtype=np.float64)
        if self.times.ndim != 1 or len(self.times) < 2 or not (np.diff(self.times) > 0).all():
            raise ShapeError(f"{name}: expected two or more ascending float32 times, got {times}")
        expected = len(self.times), shape.ndim
        if self.offsets.shape != expected or not (np.isfinite(self.offsets).all() and np.isfinite(self.times).all()):
            raise ShapeError(f"{name}: expected finite offsets of shape {expected}, got {offsets!r}")
        lower = widened(shape.lower, -self.offsets.min(axis=0), -1)
        upper = widened(shape.upper, self.offsets.max(axis=0), 1)
        corners = np.r_[self.times[0], lower], np.r_[self.times[-1], upper]
        super().__init__((shape,), *corners, [self.times, self.offsets], name)
        self.time, self.certified, self.exact = True, shape.certified, self._solids[0].exact

    def _signed_distance(self, box: list[Interval]) -> Interval:
        time, *space = box
        first, last = self.times[0], self.times[-1]
        away = (time.low > last) | (time.high < first)
        begin, end = (np.clip(each, first, last) for each in (time.low, time.high))
        gap = self._signed_distances([x - p for x, p in zip(space, self._offsets(begin, end), strict=True)])[0]
        partly = (time.low < first) | (time.high > last)
        return Interval(np.where(away, np.inf, gap.low), np.where(partly, np.inf, gap.high))

    def _offsets(self, begin: np.ndarray, end: np.ndarray) -> list[Interval]:
        """What each coordinate of the offset is between two times: what it is at both, and at keyframes between."""
        low, high = np.full((2, len(self.offsets[0]), len(begin)), np.inf)
        high = -high
        for time in (begin, end):
            for k, place in enumerate(self._offset(time)):
                low[k], high[k] = np.minimum(low[k], place.low), np.maximum(high[k], place.high)
        for time, offset in zip(self.times, self.offsets, strict=True):
            within = (begin <= time) & (time <= end)
            low[:, within] = np.minimum(low[:, within], offset[:, None])
            high[:, within] = np.maximum(high[:, within], offset[:, None])
        return [Interval(a, b) for a, b in zip(low, high, strict=True)]

    def _offset(self, time: np.ndarray) -> list[Interval]:
        """Each coordinate of the offset at a time within the range; at keyframes exactly."""
        k = np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, len(self.times) - 2)
        k = np.where(np.isnan(time), 0, k)
        start = self.times[k]
        share = (Interval(time) - start) / (Interval(self.times[k + 1]) - start)
        found = []
        for a, b in zip(self.offsets[k].T, self.offsets[k + 1].T, strict=True):
            between = (Interval(b) - a) * share + a
            found.append(between.both(Interval(np.minimum(a, b), np.maximum(a, b))))
        return found

    def landmarks(self) -> np.ndarray:
        own = self.parts[0].landmarks()
        placed = [
            np.insert(own + offset, 0, time, axis=1) for time, offset in zip(self.times, self.offsets, strict=True)
        ]
        return np.concatenate(placed)
