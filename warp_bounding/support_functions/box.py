"""Upper bounds of functions of a box's numbers ``(low, high)`` over all boxes that meet an object.

``low_k`` and ``high_k`` only have to leave a point p of the object S between them, up to delta each. With ``x+ =
max(x, 0)``, ``x- = max(-x, 0)`` and h_S the support of S itself, the maximum of ``x . low + y . high`` is exactly
``h_S(x+ - y-) + (x+ + y-) . delta + (x- + y+) . limit``.
"""

import numpy as np

from warp_bounding.support_functions.base import RegionSupport

__all__ = ["BoxSupport"]


class BoxSupport(RegionSupport):
    """Boxes; see the module."""

    name = "box"

    def linear(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        rise, fall = np.maximum(x, 0), np.maximum(-y, 0)  # low pushed up to p + delta, high pushed down to p - delta
        free = np.maximum(-x, 0) + np.maximum(y, 0)  # each pulled to the domain's border
        # the support of the widened object has |rise - fall| . delta already, which is taken out
        return (
            self.support(rise - fall)
            - np.abs(rise - fall) @ self.support.delta
            + (rise + fall) @ self.support.delta
            + free @ self.limit
        )

    def square(self, matrix: np.ndarray, offset: np.ndarray) -> float:
        n, most = self.ndim, 0.0
        for choice in np.ndindex((2,) * (2 * n)):
            near = np.array(choice, dtype=bool)
            low = np.where(near[:n], self.support.points + self.support.delta, -self.limit)
            high = np.where(near[n:], self.support.points - self.support.delta, self.limit)
            y = np.concatenate([low, high], axis=1) @ matrix.T + offset
            most = max(most, float((y * y).sum(axis=1).max()))
        return most
