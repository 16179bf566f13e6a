"""How far an object reaches in a direction, certified from above: its support, widened by what rounds on the way to v."""

import numpy as np

from warp_bounding.arithmetic import UNIT64, gamma
from warp_bounding.coordinates.domain import Domain
from warp_bounding.geometry.farthest_point import farthest
from warp_bounding.geometry.hull import Hull, hull_of
from warp_bounding.indicators.shape import Shape
from warp_bounding.queries.boundary import outline

__all__ = ["CHUNK", "ObjectSupport"]

CHUNK = 1 << 22  # float64 numbers in an intermediate array: 32 MiB


class ObjectSupport:
    """The support of an object widened by ``delta``, from above; of a shape without a known hull that of its outline.

    Args:
        grid: The object.
        base: Its domain of points.
        hull: A convex set that holds it; ``hull_of(grid)`` if ``None``, which is found once and has few points.

    Attributes:
        points: ``(C, n)`` float64, local space: every vertex of the object's hull, and some more.
        ball: ``(n,)``, local units: half axes of the ellipsoid by which the points' hull is dilated.
        delta: ``(n,)``, the object is widened by this on every axis.
        certified: Whether the hull is known, so that all that is said of the support holds.
    """

    def __init__(self, grid: Shape, base: Domain, hull: Hull | None = None):
        hull = hull or hull_of(grid)
        self.certified = hull is not None
        hull = hull or Hull(outline(grid), 0.0)
        lower, upper = base.widened(hull.points, hull.points)
        self.points, self.delta = (lower + upper) / 2, base.delta * (1 + 1e-6) + 1e-14
        self.ball = hull.radius * base.scale.astype(np.float64) * (np.arange(base.ndim) >= int(grid.time))

    def __call__(self, m: np.ndarray) -> np.ndarray:
        """``h(m)`` of vectors ``(..., n)``, in local space; the rounding of this evaluation is included."""
        flat = m.reshape(-1, m.shape[-1])
        best = np.empty(len(flat))
        size = max(1, CHUNK // len(self.points))
        for start in range(0, len(flat), size):
            best[start : start + size] = (flat[start : start + size] @ self.points.T).max(axis=1)
        largest = np.abs(flat) @ (np.abs(self.points).max(axis=0) + self.ball + self.delta)
        best += np.linalg.norm(flat * self.ball, axis=1) + np.abs(flat) @ self.delta
        best += gamma(2 * flat.shape[1] + 8, UNIT64) * largest
        return best.reshape(m.shape[:-1])

    def square(self, matrix: np.ndarray, offset: np.ndarray) -> float:
        """Upper bound of ``|A p + b|^2`` over the widened object, A ``(r, n)`` and b ``(r,)``, rounding included."""
        most = farthest(self.points @ matrix.T + offset, matrix * self.ball)
        most += np.linalg.norm(np.abs(matrix) @ self.delta)
        reach = np.abs(matrix) @ (np.abs(self.points).max(axis=0) + self.ball + self.delta) + np.abs(offset)
        return float((most + gamma(8 * len(self.delta) + 64, UNIT64) * reach.sum()) ** 2 * (1 + 1e-12))
