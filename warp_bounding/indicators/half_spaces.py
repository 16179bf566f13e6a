"""What a shape may know of its part in a box beyond whether there is any: a half-space that holds it.

Where f falls towards the object and the object ends before f has fallen far, a box may meet both: neither the bound of
f nor ``Shape.empty`` closes it. The least f over the part of the box in the half-space is what counts, and two linear
bounds tell it together.
"""

from typing import NamedTuple

import numpy as np
import warp as wp

__all__ = ["HalfSpaces"]


class HalfSpaces(NamedTuple):
    """Of N closed boxes in n dimensions: certified half-spaces that hold the object's points in them.

    Attributes:
        empty: ``(N,)`` bool, certified as in ``Shape.empty``; the half-spaces of empty boxes mean nothing.
        center: ``(N, n)`` float64, object space.
        level: ``(N,)`` float64.
        slope: ``(N, n)`` float64: a point x of the object in the box has ``level + slope . (x - center) >= 0``.
        axis: ``(N,)`` int, the axis along which halving the box helps the half-space most.
        loss: ``(N,)`` float64, about by how much the linear function exceeds the one that it bounds.
    """

    empty: np.ndarray
    center: np.ndarray
    level: np.ndarray
    slope: np.ndarray
    axis: np.ndarray
    loss: np.ndarray

    @classmethod
    def blank(cls, lower: np.ndarray, upper: np.ndarray) -> "HalfSpaces":
        """Of boxes between ``(N, n)`` float64 corners: nothing is known, and each half-space holds everything."""
        count, n = lower.shape
        center = lower * 0.5 + upper * 0.5
        return cls(
            np.zeros(count, dtype=bool),
            center,
            np.ones(count),
            np.zeros((count, n)),
            np.zeros(count, dtype=np.int32),
            np.zeros(count),
        )

    def arrays(self) -> list[wp.array]:
        """All but ``center`` as Warp arrays over the same memory, which kernels fill."""
        vector = wp.types.vector(length=self.slope.shape[1], dtype=wp.float64)
        parts = (
            (self.empty, wp.uint8),
            (self.level, wp.float64),
            (self.slope, vector),
            (self.axis, wp.int32),
            (self.loss, wp.float64),
        )
        return [
            wp.array(x.view(np.uint8) if x.dtype == bool else x, dtype=dtype, device="cpu", copy=False)
            for x, dtype in parts
        ]
