"""The rectified linear unit, ``max(z, 0)``: exact in float32.

Its relaxation is the chord of an interval, moved down by half of the corner's distance from it, with a band of that
half-width.
"""

from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from warp_bounding.activations.base import Activation
from warp_bounding.kernels.source import Lanes

if TYPE_CHECKING:
    import torch

__all__ = ["RELU"]


@wp.func
def _plain(z: float):
    return wp.max(z, 0.0)


class _Relu(Activation):
    name = "relu"
    plain = _plain
    falling, mean = 0.5, 0.3  # half of a monotone network's neurons fall: those are concave, the others convex

    def statement(self, lanes: Lanes, target: str, z: str) -> str:
        if lanes.vector:
            return f"{{ V z_ = {z}; const V o_ = {{}}; {target} = z_ > o_ ? z_ : o_; }}"
        return f"{{ V z_ = {z}; {target} = z_ > 0.0f ? z_ : z_ * 0.0f; }}"

    def value32(self, z: np.ndarray) -> np.ndarray:
        return np.maximum(z, np.float32(0))

    def error(self, limit: float) -> float:
        return 0.0

    def value(self, z: np.ndarray) -> np.ndarray:
        return np.maximum(z, 0.0)

    def relax(self, z: np.ndarray, near: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, ...]:
        width = near + noise
        low, high = z - width, z + width
        slope = np.clip(high / (2 * width), 0.0, 1.0)
        spread = np.where((low < 0) & (high > 0), -slope * low / 2, 0.0)
        return slope, slope * z + spread, np.zeros_like(z), spread

    def relaxation(self) -> str:
        return """
auto act_relu = [&](V z) { return z > zero ? z : zero; };
auto relax_relu = [&](V z, V near, V noise, V& slope, V& mean, V& bend, V& spread) {
    const V d = near + noise; const V low = z - d; const V high = z + d; V s = high / (d + d);
    s = s < zero ? zero : s; s = s > zero + 1.0 ? zero + 1.0 : s;
    V e = s * low * -0.5; e = low < zero ? e : zero; e = high > zero ? e : zero;
    slope = s; mean = s * z + e; bend = zero; spread = e;
};
"""

    def torch_value(self, z: "torch.Tensor", out: "torch.Tensor | None" = None) -> "torch.Tensor":
        import torch

        return torch.clamp(z, min=0, out=out)

    def torch_slope(self, z: "torch.Tensor", h: "torch.Tensor", out: "torch.Tensor") -> None:
        import torch

        torch.gt(z, 0, out=out)


RELU = _Relu()
