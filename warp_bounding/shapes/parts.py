"""Shapes that are made of another one: its part in a box, and everything outside of it."""

import hashlib
from operator import attrgetter

import numpy as np

from warp_bounding.errors import ShapeError
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.shape import IN, OUT, Derived, Shape

# --- The part in a box ------------------------------------------------------------------------------------------------


class Clipped(Derived):
    """The points of a shape that lie in a box, its border included.

    Args:
        shape: The whole.
        lower: ``(n,)``, lower corner of the box; minus infinity where there is none.
        upper: ``(n,)``, upper corner of the box.
    """

    lower = upper = np.empty(0)  # of each its own

    def __init__(self, shape: Shape, lower: np.ndarray, upper: np.ndarray):
        super().__init__(shape)
        self.box = (np.asarray(lower, dtype=np.float64), np.asarray(upper, dtype=np.float64))
        self.lower, self.upper = np.maximum(self.box[0], shape.lower), np.minimum(self.box[1], shape.upper)
        if not (self.lower <= self.upper).all():
            raise ShapeError(f"{shape.name}: a part outside the box of the whole, from {lower} to {upper}")

    @property
    def known_times(self) -> tuple[float, float]:
        return self.whole.known_times  # at times beyond the box the part is known to be empty

    @property
    def geometry(self) -> str:
        box = np.stack([self.lower, self.upper]).astype("<f8").tobytes()
        return hashlib.sha256(f"part of {self.whole.geometry} ".encode() + box).hexdigest()

    def decide(self, x: np.ndarray) -> np.ndarray:
        x = np.asarray(x)
        found = np.full(len(x), OUT, dtype=np.uint8)
        inside = np.flatnonzero(((x >= self.lower) & (x <= self.upper)).all(axis=1))
        found[inside] = self.whole.decide(x[inside])
        return found

    def empty(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        low, high = np.maximum(lower, self.lower), np.minimum(upper, self.upper)
        apart = ((lower > self.upper) | (upper < self.lower)).any(axis=1)
        found = apart & (lower <= upper).all(axis=1)
        queried = np.flatnonzero((low <= high).all(axis=1))
        found[queried] = self.whole.empty(low[queried], high[queried])
        return found

    def inside(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        held = ((lower >= self.lower) & (upper <= self.upper)).all(axis=1)
        return held & self.whole.inside(lower, upper)

    def distance(self, x: np.ndarray) -> np.ndarray | None:
        return self.whole.distance(x)

    def landmarks(self) -> np.ndarray:
        return self._held(self.whole.landmarks())

    def points(self, count: int, rng: np.random.Generator) -> np.ndarray:
        found = self._held(self.whole.points(count, rng))
        return found[rng.integers(len(found), size=count)] if len(found) else found

    def dilated(self, margin: float) -> "Shape":
        """The part of the dilated whole in the same box."""
        return self if self._new_margin(margin) is None else Clipped(self.whole.dilated(margin), *self.box)

    def to_grid(self, *, resolution: int | None = None, margin: float = 0.0) -> Grid:
        raise ShapeError(f"{self.name}: no cells are laid over a part of a shape")

    def _held(self, x: np.ndarray) -> np.ndarray:
        return x[((x >= self.lower) & (x <= self.upper)).all(axis=1)]


def part_of(shape: Shape, box: tuple[np.ndarray, np.ndarray]) -> Shape:
    """The part of a shape in a box; the shape itself where the box has no end.

    The box is one float64 step wider on each side, so that the parts in two boxes of which one begins at the next
    number behind the other leave no real number between them.
    """
    return shape if np.isinf(box).all() else Clipped(shape, np.nextafter(box[0], -np.inf), np.nextafter(box[1], np.inf))


# --- The complement ---------------------------------------------------------------------------------------------------
#
# Everything outside a shape: what a bounder holds that says where a point is certainly *inside* it.
#
# A bounder of the complement answers *no* only where no point of the complement is, that is, in the object. It has no
# end: beyond the box of the shape a query is *maybe* in it. The complement of a motion is its complement at each of its
# times; beyond these there is nothing, and every bounder answers *maybe*.

SIDES = ("outside", "inside")  # from which a bounder may hold a shape: where "no" is certain to be
# Points of the object around which boxes are tried; their sides, of the shape's longest.
TRIED, TINY_BOX = 4096, 2.0**-10


class Complement(Derived):
    """All points that are not certainly in a shape; the shape that ``fit(..., side="inside")`` bounds.

    Args:
        shape: The whole; closed, so that its border is not in its complement.

    Raises:
        ShapeError: For a complement.

    Example:
        >>> middle = (grid.lower + grid.upper) / 2
        >>> wb.shapes.Complement(grid).contains(np.array([middle, grid.lower])).tolist()
        [False, True]
    """

    unbounded = True

    def __init__(self, shape: Shape):
        if shape.unbounded:
            raise ShapeError(f"{shape.name}: a complement has no complement here")
        super().__init__(shape)
        self.name, self.largest_delta = f"outside of {shape.name}", shape.largest_delta

    @property
    def lower(self) -> np.ndarray:
        """A detail outside the box that holds the whole, so that its border there is seen from outside, too."""
        return self.whole.lower - self._ring

    @property
    def upper(self) -> np.ndarray:
        """See ``lower``."""
        return self.whole.upper + self._ring

    @property
    def _ring(self) -> np.ndarray:
        joints = self.joints is not None
        return np.where((np.arange(self.ndim) >= int(self.time)) & ~joints, 1 / self.details_per_unit, 0.0)

    sample_lower, sample_upper, details_per_unit = (
        property(attrgetter(f"whole.{name}")) for name in ("sample_lower", "sample_upper", "details_per_unit")
    )

    @property
    def geometry(self) -> str:
        return outside_of(self.whole.geometry)

    def decide(self, x: np.ndarray) -> np.ndarray:
        found = self.whole.decide(x)
        turned = np.choose(found, [IN, OUT, found]).astype(np.uint8)
        return np.where(np.isfinite(x).all(axis=1) & self._timely(x, x), turned, OUT).astype(np.uint8)

    def empty(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Beyond what is known of the whole there is nothing: only the part of a box before that is asked about."""
        lower, upper = (np.array(corner, dtype=np.float64) for corner in (lower, upper))
        boxes, (first, last) = (lower <= upper).all(axis=1), self.whole.known
        np.maximum(lower, first, out=lower, where=boxes[:, None])
        np.minimum(upper, last, out=upper, where=boxes[:, None])
        beyond = boxes & (lower > upper).any(axis=1)
        return beyond | (self.whole.inside(lower, upper) & ~beyond)

    def inside(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        return self.whole.empty(lower, upper) & self._timely(lower, upper)

    def _timely(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """``(N,)`` bool: whether boxes lie in what is known of the whole."""
        first, last = self.whole.known
        return ((lower >= first) & (upper <= last)).all(axis=1)

    def check_contents(self) -> None:
        """See ``Shape``; also refuses a shape that certifies no box to lie in it."""
        self.whole.check_contents()
        rng = np.random.default_rng(0)
        x = self.lower + rng.random((TRIED, self.ndim)) * (self.upper - self.lower)
        x = x[self.whole.decide(x) == IN]
        reach = TINY_BOX * (self.upper - self.lower) / 2
        if not len(x):
            raise ShapeError(f"{self.whole.name}: nothing lies inside it, of {TRIED:,} points of its box none")
        if self.certified and not self.whole.inside(x - reach, x + reach).any():
            raise ShapeError(
                f"{self.whole.name}: certifies no box to lie inside it, so nothing can be proven of its inside"
            )

    def dilated(self, margin: float) -> "Complement":
        """The outside of the dilated whole."""
        return self if self._new_margin(margin) is None else Complement(self.whole.dilated(margin))

    def to_grid(self, *, resolution: int | None = None, margin: float = 0.0):
        raise ShapeError(
            f"{self.name}: no cells are laid over the outside of a shape; give another method, and no resolution"
        )


def outside_of(digest: str) -> str:
    """The digest of the complement of the shape with this one."""
    return hashlib.sha256(f"outside of {digest}".encode()).hexdigest()
