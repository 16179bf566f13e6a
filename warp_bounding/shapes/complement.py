"""Everything outside a shape: what a bounder holds that says where a point is certainly *inside* it.

A bounder of the complement answers *no* only where no point of the complement is, that is, in the object. It has no
end: beyond the box of the shape a query is *maybe* in it. The complement of a motion is its complement at each of its
times; beyond these there is nothing, and every bounder answers *maybe*.
"""

import hashlib
from operator import attrgetter

import numpy as np

from warp_bounding.errors import ShapeError
from warp_bounding.shapes.shape import IN, OUT, Derived, Shape

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

    def reaches_beyond(self, lower: np.ndarray, upper: np.ndarray) -> bool:
        return False  # proofs search all of the domain, and outside it the answer is maybe

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
