"""Upper bounds of functions of a box's numbers ``(low, high)`` over all boxes that meet an object.

``low_k`` and ``high_k`` only have to leave a point p of the object between them, so the maximum is linear in p: ``g =
(x, y)`` gives ``h(x+ - y-) + (x- + y+) . limit``, exactly.
"""

import numpy as np

from warp_bounding.support_functions.base import RegionSupport

__all__ = ["BoxSupport"]


class BoxSupport(RegionSupport):
    """See module and ``RegionSupport``."""

    name = "box"

    def linear(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """See ``RegionSupport``."""
        rise, fall = np.maximum(x, 0), np.maximum(-y, 0)  # of low upwards, of high downwards
        free = np.maximum(-x, 0) + np.maximum(y, 0)
        # low <= p + delta and p - delta <= high
        return (
            self.support(rise - fall)
            - np.abs(rise - fall) @ self.support.delta
            + (rise + fall) @ self.support.delta
            + free @ self.limit
        )

    def square(self, matrix: np.ndarray, offset: np.ndarray) -> float:
        """See ``RegionSupport``."""
        n, most = self.ndim, 0.0
        for choice in np.ndindex((2,) * (2 * n)):
            near = np.array(choice, dtype=bool)
            low = np.where(near[:n], self.support.points + self.support.delta, -self.limit)
            high = np.where(near[n:], self.support.points - self.support.delta, self.limit)
            y = np.concatenate([low, high], axis=1) @ matrix.T + offset
            most = max(most, float((y * y).sum(axis=1).max()))
        return most
