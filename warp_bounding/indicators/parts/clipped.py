"""The part of a shape in a closed box: what a bounder among others has to hold."""

import hashlib

import numpy as np

from warp_bounding.errors import IndicatorError
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.shape import OUT, Shape

__all__ = ["Clipped", "part_of"]


class Clipped(Shape):
    """The points of a shape that lie in a box, its border included.

    Args:
        shape: The whole.
        lower: ``(n,)``, lower corner of the box; minus infinity where there is none.
        upper: ``(n,)``, upper corner of the box.
    """

    def __init__(self, shape: Shape, lower: np.ndarray, upper: np.ndarray):
        self.whole = shape
        self.box = (np.asarray(lower, dtype=np.float64), np.asarray(upper, dtype=np.float64))
        self._lower, self._upper = np.maximum(self.box[0], shape.lower), np.minimum(self.box[1], shape.upper)
        if not (self._lower <= self._upper).all():
            raise IndicatorError(f"{shape.name}: a part outside the box of the whole, from {lower} to {upper}")
        self.name, self.note, self.time, self.margin = shape.name, shape.note, shape.time, shape.margin
        self.certified, self.joints = shape.certified, shape.joints

    @property
    def restriction(self) -> str:
        return self.whole.restriction

    @property
    def ndim(self) -> int:
        return self.whole.ndim

    @property
    def lower(self) -> np.ndarray:
        return self._lower

    @property
    def upper(self) -> np.ndarray:
        return self._upper

    @property
    def known_times(self) -> tuple[float, float]:
        return self.whole.known_times  # at times beyond the box the part is known to be empty

    @property
    def geometry(self) -> str:
        box = np.stack([self._lower, self._upper]).astype("<f8").tobytes()
        return hashlib.sha256(f"part of {self.whole.geometry} ".encode() + box).hexdigest()

    def decide(self, x: np.ndarray) -> np.ndarray:
        x = np.asarray(x)
        found = np.full(len(x), OUT, dtype=np.uint8)
        inside = np.flatnonzero(((x >= self._lower) & (x <= self._upper)).all(axis=1))
        found[inside] = self.whole.decide(x[inside])
        return found

    def empty(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        low, high = np.maximum(lower, self._lower), np.minimum(upper, self._upper)
        apart = ((lower > self._upper) | (upper < self._lower)).any(axis=1)
        found = apart & (lower <= upper).all(axis=1)
        asked = np.flatnonzero((low <= high).all(axis=1))
        found[asked] = self.whole.empty(low[asked], high[asked])
        return found

    def inside(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        held = ((lower >= self._lower) & (upper <= self._upper)).all(axis=1)
        return held & self.whole.inside(lower, upper)

    def distance(self, x: np.ndarray) -> np.ndarray | None:
        return self.whole.distance(x)

    def clearance(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray | None:
        return self.whole.clearance(lower, upper)

    def landmarks(self) -> np.ndarray:
        return self._held(self.whole.landmarks())

    def points(self, count: int, rng: np.random.Generator) -> np.ndarray:
        found = self._held(self.whole.points(count, rng))
        return found[rng.integers(len(found), size=count)] if len(found) else found

    def check(self) -> None:
        self.whole.check()

    def dilated(self, margin: float) -> "Shape":
        """The part of the dilated whole in the same box."""
        return self if self._new_margin(margin) is None else Clipped(self.whole.dilated(margin), *self.box)

    def to_grid(self, *, resolution: int | None = None, margin: float = 0.0) -> IndicatorGrid:
        raise IndicatorError(f"{self.name}: no cells are laid over a part of a shape")

    def _held(self, x: np.ndarray) -> np.ndarray:
        return x[((x >= self._lower) & (x <= self._upper)).all(axis=1)]


def part_of(shape: Shape, box: tuple[np.ndarray, np.ndarray]) -> Shape:
    """The part of a shape in a box; the shape itself where the box has no end.

    The box is one float64 step wider on each side, so that the parts in two boxes of which one begins at the next number
    behind the other leave no real number between them.
    """
    return shape if np.isinf(box).all() else Clipped(shape, np.nextafter(box[0], -np.inf), np.nextafter(box[1], np.inf))
