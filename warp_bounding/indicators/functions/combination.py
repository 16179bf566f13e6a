"""The algebra: unions, intersections, differences and dilations of shapes, and the operators that make them.

Minimum and maximum, a change of sign and of level keep the properties of a gap (``solid``): that of a union is the
least gap of its parts, that of an intersection the largest, that of a difference ``max(a, -b)``. Every shape can be a
part: one that is no solid counts with its own answers about points and boxes (``Foreign``).
"""

from functools import reduce

import numpy as np

from warp_bounding.errors import IndicatorError
from warp_bounding.indicators.functions.intervals import Interval
from warp_bounding.indicators.functions.solid import Foreign, Solid
from warp_bounding.indicators.limits import checked_margin
from warp_bounding.indicators.shape import Shape

__all__ = ["Combinable", "Combination", "Difference", "Dilation", "Intersection", "Union", "check_parts"]


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
        IndicatorError: For parts that are no shapes, or do not have the same coordinates.
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

    def _gaps(self, box: list[Interval]) -> list[Interval]:
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
        IndicatorError: For parts that are no shapes, or do not have the same coordinates.

    Example:
        >>> both = wb.solids.Sphere([0, 0, 0], 1) | wb.solids.Sphere([1, 0, 0], 1)
        >>> both.contains(np.array([[1.5, 0, 0], [0.5, 1, 0]]))
        array([ True, False])
    """

    def __init__(self, *parts: Shape, name: str = "union"):
        lower, upper = _corners(parts, name)
        super().__init__(parts, lower.min(axis=0), upper.max(axis=0), [], name)
        self.certified = all(part.certified for part in parts)
        self.exact = all(solid.exact for solid in self._solids)

    def _gap(self, box: list[Interval]) -> Interval:
        return reduce(Interval.minimum, self._gaps(box))


class Intersection(Combination):
    """The points that several shapes have in common; its gap is not the distance where an edge is next.

    Args:
        parts: At least one shape, all of the same coordinates.
        name: For people.

    Raises:
        IndicatorError: For parts that are no shapes, do not have the same coordinates, or lie apart.

    Example:
        >>> lens = wb.solids.Sphere([0, 0], 1) & wb.solids.Sphere([1, 0], 1)
        >>> lens.lower, lens.upper
        (array([ 0., -1.]), array([1., 1.]))
    """

    exact = False

    def __init__(self, *parts: Shape, name: str = "intersection"):
        lower, upper = _corners(parts, name)
        lower, upper = lower.max(axis=0), upper.min(axis=0)
        if (lower > upper).any():
            raise IndicatorError(f"{name}: there is nothing to bound, the parts lie apart from each other")
        super().__init__(parts, lower, upper, [], name)
        self.certified = any(part.certified for part in parts)

    def _gap(self, box: list[Interval]) -> Interval:
        return reduce(Interval.maximum, self._gaps(box))


class Difference(Combination):
    """The points of a shape that do not lie inside of another one: the border of what is taken away stays.

    Of a shape that is no solid the border goes too, as its answers do not tell it from the inside.

    Args:
        shape: What something is taken away from.
        removed: What is taken away; where the difference is dilated, what is taken away shrinks.
        name: For people.

    Raises:
        IndicatorError: For parts that are no shapes, or do not have the same coordinates.

    Example:
        >>> shell = wb.solids.Sphere([0, 0], 1) - wb.solids.Sphere([0, 0], 0.5)
        >>> shell.contains(np.array([[0.0, 0.0], [0.75, 0.0]]))
        array([False,  True])
    """

    exact = False
    signs = (1, -1)

    def __init__(self, shape: Shape, removed: Shape, *, name: str = "difference"):
        lower, upper = _corners((shape, removed), name)
        super().__init__((shape, removed), lower[0], upper[0], [], name)
        self.certified = shape.certified

    def _gap(self, box: list[Interval]) -> Interval:
        gap, removed = self._gaps(box)
        return gap.maximum(-removed)


class Dilation(Combination):
    """A shape and all points within a radius of it, as a solid that may be dilated once more.

    Args:
        shape: What is dilated. What ``dilated`` says of it holds here.
        radius: Object units, at least 0.
        name: For people.

    Raises:
        IndicatorError: For no shape, a shape that cannot be dilated, or a radius that is negative or not finite.

    Example:
        >>> rounded = wb.solids.Dilation(wb.solids.Box([0, 0], [1, 1]), 0.5)
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

    def _gap(self, box: list[Interval]) -> Interval:
        return self._gaps(box)[0]


def check_parts(parts: tuple[Shape, ...], name: str) -> None:
    """Refuse to combine what is no shape, and shapes that do not have the same coordinates.

    Raises:
        IndicatorError: Naming what came.
    """
    if not parts or not all(isinstance(part, Shape) for part in parts):
        got = ", ".join(type(part).__name__ for part in parts) or "none"
        raise IndicatorError(f"{name}: expected at least one shape, and nothing but shapes, got {got}")
    if len({(part.ndim, part.time) for part in parts}) > 1:
        got = ", ".join(f"{part.name} ({part.ndim}D{', time first' if part.time else ''})" for part in parts)
        raise IndicatorError(f"{name}: expected shapes of the same coordinates, got {got}")


def _corners(parts: tuple[Shape, ...], name: str) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corners of the parts, each ``(P, n)``, after ``check_parts``."""
    check_parts(parts, name)
    return np.array([part.lower for part in parts]), np.array([part.upper for part in parts])
