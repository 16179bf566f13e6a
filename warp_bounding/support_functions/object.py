"""The support function of an object widened by delta: how far it reaches in a direction, certified from above."""

import numpy as np

from warp_bounding.arithmetic import UNIT64, gamma
from warp_bounding.coordinates.domain import Domain
from warp_bounding.geometry.hull import hull_points
from warp_bounding.indicators.grid import IndicatorGrid

__all__ = ["ObjectSupport"]

CHUNK = 1 << 22  # float64 numbers in an intermediate array: 32 MiB


class ObjectSupport:
    """The support of an object widened by ``delta``, from above.

    Args:
        grid: The object.
        base: Its domain of points.

    Attributes:
        points: ``(C, n)`` float64, local space: every vertex of the object's hull, and some more.
        delta: ``(n,)``, the object is widened by this on every axis.
    """

    def __init__(self, grid: IndicatorGrid, base: Domain):
        corners = hull_points(grid)
        lower, upper = base.widened(corners, corners)
        self.points, self.delta = (lower + upper) / 2, base.delta * (1 + 1e-6) + 1e-14

    def __call__(self, m: np.ndarray) -> np.ndarray:
        """``h(m)`` of vectors ``(..., n)``, in local space; the rounding of this evaluation is included."""
        flat = m.reshape(-1, m.shape[-1])
        best = np.empty(len(flat))
        size = max(1, CHUNK // len(self.points))
        for start in range(0, len(flat), size):
            best[start : start + size] = (flat[start : start + size] @ self.points.T).max(axis=1)
        largest = np.abs(flat) @ (np.abs(self.points).max(axis=0) + self.delta)
        best += np.abs(flat) @ self.delta + gamma(2 * flat.shape[1] + 8, UNIT64) * largest
        return best.reshape(m.shape[:-1])
