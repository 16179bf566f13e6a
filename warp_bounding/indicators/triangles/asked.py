"""What the dilated solids of meshes and of motions share: a struct that kernels answer about, a query at a time, on all cores."""

from typing import Any, ClassVar

import numpy as np
import warp as wp

from warp_bounding.runtime.launch import launch_on_cores

__all__ = ["AskedSolid"]


class AskedSolid:
    """A dilated solid. A class of them names its kernels.

    Args:
        struct: Of the type that the kernels take.
    """

    point: ClassVar[type]  # Warp's type of one
    kernels: ClassVar[tuple[wp.Kernel, wp.Kernel, wp.Kernel]]  # for ``decide``, ``empty`` and ``inside``

    def __init__(self, struct: Any):
        self._struct = struct

    def decide(self, x: np.ndarray) -> np.ndarray:
        """``OUT``, ``IN`` or ``UNDECIDED`` for points; see ``Shape.decide``."""
        return self._answer(self.kernels[0], x)

    def empty(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Which closed boxes hold no point of the object; see ``Shape.empty``."""
        return self._answer(self.kernels[1], lower, upper).view(bool)

    def inside(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Which closed boxes lie in the object whole; see ``Shape.inside``."""
        return self._answer(self.kernels[2], lower, upper).view(bool)

    def _answer(self, kernel: wp.Kernel, *queries: np.ndarray, dtype: type = wp.uint8) -> np.ndarray:
        """``(N,)``, what a kernel answers to queries, arrays ``(N, n)``; of a type of vectors, ``(N, k)``."""
        rows = [np.ascontiguousarray(q, dtype=np.float64) for q in queries]
        shape = len(rows[0]), *getattr(dtype, "_shape_", ())
        out = np.empty(shape, dtype=wp.dtype_to_numpy(getattr(dtype, "_wp_scalar_type_", dtype)))
        if len(out):
            self._know(rows[0], rows[-1])
            inputs = [self._struct, *(wp.array(q, dtype=self.point, device="cpu", copy=False) for q in rows)]
            launch_on_cores(kernel, len(out), inputs, [wp.array(out, dtype=dtype, device="cpu", copy=False)], "cpu")
        return out

    def _know(self, lower: np.ndarray, upper: np.ndarray) -> None:
        """Make what is needed for queries, points or boxes ``(N, n)``; here all of it is there."""
