"""The search for points that contradict what is said of a function: its box, its ``empty`` and its distance.

What lies about boxes is found where it matters. Points of the object at its very border are found by bisection
between points inside and outside; every box around such a point must not be empty, however small it is and on
whichever of its faces the point lies. What lies about distances is found between such points and all others, and by
steps of all sizes along the steepest slope.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from warp_bounding.indicators.functions.answers import shown
from warp_bounding.indicators.shape import Shape

__all__ = ["Counterexample", "Distance", "refute"]

HALVINGS = 40  # bisections from a point inside and one outside to a point at the border
NEAREST, FARTHEST = -9.0, 0.5  # powers of ten: sizes of boxes and steps, in units of the longest side
SLOPE_STEPS = 0.1  # of other steps: those from which the steepest direction is told
BEYOND = 1.0  # longest sides: how far outside of the box that holds the object points of it are looked for


class Counterexample(NamedTuple):
    """What contradicts a function.

    Attributes:
        broken: What does not hold: ``"bounds"``, ``"empty"``, ``"sign"`` (of the distance) or ``"lipschitz"``.
        message: One sentence with the points.
        points: ``(P, n)`` float64: a point; for ``"empty"`` a point and the box's two corners; for ``"lipschitz"`` two
            points.
    """

    broken: str
    message: str
    points: np.ndarray


class Distance(NamedTuple):
    """What is said of a distance.

    Attributes:
        value: Of ``(N, n)`` finite points, ``(N,)``.
        lipschitz: L.
        allowance: Of ``(N,)`` largest absolute coordinates: by how much the values may be off.
    """

    value: Callable[[np.ndarray], np.ndarray]
    lipschitz: float
    allowance: Callable[[np.ndarray], np.ndarray]


def refute(shape: Shape, distance: Distance | None, count: int, seed: int) -> Counterexample | None:
    """What contradicts a shape; ``None`` where nothing was found, which proves nothing.

    Args:
        shape: Not dilated.
        distance: What its answers rest on; ``None`` if that is no distance.
        count: Random points of each kind.
        seed: Of the random numbers.
    """
    with np.errstate(invalid="ignore", over="ignore"):  # infinite distances
        return _Search(shape, distance, count, np.random.default_rng(seed)).run()


class _Search:
    def __init__(self, shape: Shape, distance: Distance | None, count: int, rng: np.random.Generator):
        self.shape, self.distance, self.count, self.rng = shape, distance, count, rng
        self.n, self.longest = shape.ndim, float(shape.extent.max())

    def run(self) -> Counterexample | None:
        shape, lower, upper = self.shape, self.shape.lower, self.shape.upper
        within, around = self._uniform(lower, upper), self._uniform(shape.sample_lower, shape.sample_upper)
        x = np.concatenate([within, around, self._outside(), self._shell()])
        held = shape.contains(x)
        beyond = held & ((x < lower) | (x > upper)).any(axis=1)
        if beyond.any():
            at = x[beyond][0]
            return Counterexample(
                "bounds", f"the point {shown(at)} is in the object, but not between lower and upper", at[None]
            )
        inside = np.concatenate([x[held][: self.count], self._border(x[held], x[~held])])
        if shape.certified:
            for boxes in (self._boxes_around(inside), self._boxes_at_random()):
                if (found := self._in_empty_box(*boxes)) is not None:
                    return found
        return None if self.distance is None else self._wrong_distance(x, inside)

    # --- points and boxes --------------------------------------------------------------------------------------------

    def _uniform(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        return self.rng.uniform(lower, upper, (self.count, self.n))

    def _sizes(self, count: int) -> np.ndarray:
        """``(count, 1)`` lengths of all sizes."""
        return self.longest * 10.0 ** self.rng.uniform(NEAREST, FARTHEST, (count, 1))

    def _outside(self) -> np.ndarray:
        x = self._uniform(self.shape.lower - BEYOND * self.longest, self.shape.upper + BEYOND * self.longest)
        return x if not self.shape.time else self._in_time(x)

    def _shell(self) -> np.ndarray:
        """Points just outside of the faces of the box."""
        x, axis = self._uniform(self.shape.lower, self.shape.upper), self.rng.integers(0, self.n, self.count)
        side, step = self.rng.random(self.count) < 0.5, self._sizes(self.count)[:, 0] * 0.1
        rows = np.arange(self.count)
        x[rows, axis] = np.where(side, self.shape.lower[axis] - step, self.shape.upper[axis] + step)
        return x if not self.shape.time else self._in_time(x)

    def _in_time(self, x: np.ndarray) -> np.ndarray:
        x[:, 0] = np.clip(x[:, 0], self.shape.lower[0], self.shape.upper[0])
        return x

    def _border(self, held: np.ndarray, free: np.ndarray) -> np.ndarray:
        """Points of the object beside which there are others."""
        if not len(held) or not len(free):
            return np.empty((0, self.n))
        a = held[self.rng.integers(0, len(held), self.count)]
        b = free[self.rng.integers(0, len(free), self.count)]
        for _ in range(HALVINGS):
            middle = a + (b - a) / 2
            found = self.shape.contains(middle)[:, None]
            a, b = np.where(found, middle, a), np.where(found, b, middle)
        return a

    def _boxes_around(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points of the object with boxes that they lie in, half of them on faces, and some boxes that are points."""
        points = np.repeat(points, 4, axis=0)
        shares = self.rng.random(points.shape)
        shares = np.where(self.rng.random(points.shape) < 0.5, np.round(shares), shares)
        sides = self._sizes(len(points)) * self.rng.random(points.shape)
        sides[self.rng.random(len(points)) < 0.1] = 0.0
        return points, points - shares * sides, points + (1 - shares) * sides

    def _boxes_at_random(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Boxes that are certified empty, with points of the object that were found in them or at their corners."""
        lower = self._uniform(self.shape.sample_lower, self.shape.sample_upper)
        upper = lower + self._sizes(self.count) * self.rng.random(lower.shape)
        empty = self.shape.empty(lower, upper)
        lower, upper = (np.repeat(corner[empty], 8, axis=0) for corner in (lower, upper))
        shares = self.rng.random(lower.shape)
        shares = np.where(self.rng.random((len(lower), 1)) < 0.5, np.round(shares), shares)
        points = np.clip(lower + shares * (upper - lower), lower, upper)
        held = self.shape.contains(points) if len(points) else np.zeros(0, dtype=bool)
        return points[held], lower[held], upper[held]

    # --- contradictions ----------------------------------------------------------------------------------------------

    def _in_empty_box(self, points: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> Counterexample | None:
        """Of points of the object, one that lies in a box that is certified empty."""
        wrong = self.shape.empty(lower, upper) if len(points) else np.zeros(0, dtype=bool)
        if not wrong.any():
            return None
        found = np.stack([points, lower, upper], axis=1)[wrong][0]
        x, a, b = map(shown, found)
        message = f"the point {x} is in the object, but the box from {a} to {b}, which holds it, is called empty"
        return Counterexample("empty", message, found)

    def _wrong_distance(self, x: np.ndarray, inside: np.ndarray) -> Counterexample | None:
        value, lipschitz = self.distance.value, self.distance.lipschitz
        above = value(inside) > self._allowed(inside)
        if above.any():
            at = inside[above][0]
            message = f"the point {shown(at)} is in the object, but its distance is {value(at[None])[0]:g}, above 0"
            return Counterexample("sign", message, at[None])
        others = x[self.rng.permutation(len(x))]
        pairs = [(x, others), (x, x + self._steps(x)), (x, x + self._steps(x, steepest=True))]
        if len(inside):
            pairs.append((x, inside[self.rng.integers(0, len(inside), len(x))]))
            pairs.append((x, _nearest(inside, x)))
        for a, b in pairs:
            apart = np.linalg.norm(a - b, axis=1) * (1 + 1e-12)  # what the length rounds, and more
            change = np.abs(value(a) - value(b))
            steep = change > lipschitz * apart + self._allowed(a) + self._allowed(b)
            if steep.any():
                row = int(np.argmax(np.where(steep, change / np.maximum(apart, 1e-300), 0.0)))
                message = (
                    f"the distance changes by {change[row]:g} between {shown(a[row])} and {shown(b[row])}, which are "
                    f"{apart[row]:g} apart, so lipschitz={lipschitz:g} is too little"
                )
                return Counterexample("lipschitz", message, np.stack([a[row], b[row]]))
        return None

    def _allowed(self, x: np.ndarray) -> np.ndarray:
        return self.distance.allowance(np.abs(x).max(axis=1, initial=0.0))

    def _steps(self, x: np.ndarray, steepest: bool = False) -> np.ndarray:
        """Steps of all sizes, in random directions or along the slope."""
        direction = self.rng.normal(size=x.shape)
        if steepest:
            value, step = self.distance.value, SLOPE_STEPS * self._sizes(len(x))
            at = value(x)
            slope = np.stack([value(x + step * axis) - at for axis in np.eye(self.n)], axis=1)
            known = np.isfinite(slope).all(axis=1) & slope.any(axis=1)
            direction = np.where(known[:, None], np.where(np.isfinite(slope), slope, 0.0), direction)
        direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-300)
        return direction * self._sizes(len(x))


def _nearest(points: np.ndarray, x: np.ndarray) -> np.ndarray:
    """The nearest one of some points to each of others."""
    from scipy.spatial import cKDTree

    return points[cKDTree(points).query(x)[1]]
