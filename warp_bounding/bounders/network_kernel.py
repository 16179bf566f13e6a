"""The bounds of ``Network.bound`` as one fused native kernel, float64, one box per SIMD lane; its plain twin is there."""

from functools import cache

import numpy as np
import warp as wp

from warp_bounding.bounders.network_source import BLOCK, NetworkSizes, snippet
from warp_bounding.launch import launch_blocks
from warp_bounding.native import named, unique_name

__all__ = ["bound_boxes"]


@cache
def _kernel(sizes: NetworkSizes) -> wp.Kernel:
    name = named(unique_name(sizes, "boxes"))

    @name.func_native(snippet(sizes))
    def bound_block(
        lower: wp.array(dtype=wp.float64),
        upper: wp.array(dtype=wp.float64),
        count: int,
        block: int,
        weights: wp.array(dtype=wp.float64),
        paddings: wp.array(dtype=wp.float64),
        least_out: wp.array(dtype=wp.float64),
        value_out: wp.array(dtype=wp.float64),
        axis: wp.array(dtype=wp.int32),
        point: wp.array(dtype=wp.float64),
        gradient_out: wp.array(dtype=wp.float64),
    ): ...

    @name.kernel
    def boxes(
        # inputs
        lower: wp.array(dtype=wp.float64),
        upper: wp.array(dtype=wp.float64),
        count: int,
        first: int,
        weights: wp.array(dtype=wp.float64),
        paddings: wp.array(dtype=wp.float64),
        # outputs
        least_out: wp.array(dtype=wp.float64),
        value_out: wp.array(dtype=wp.float64),
        axis: wp.array(dtype=wp.int32),
        point: wp.array(dtype=wp.float64),
        gradient_out: wp.array(dtype=wp.float64),
    ):
        bound_block(
            lower, upper, count, first + wp.tid(), weights, paddings, least_out, value_out, axis, point, gradient_out
        )

    return boxes


def bound_boxes(
    sizes: NetworkSizes, weights: np.ndarray, padding: np.ndarray, lower: np.ndarray, upper: np.ndarray, device="cpu"
):
    """Bounds of a network over boxes.

    Args:
        sizes: Of the hidden layers.
        weights: float64: per hidden layer biases ``(H,)``, weights ``(H, K)`` in row order and their absolute values, then the output's
            bias and weights.
        padding: float64, one number a layer, the output last: rounding that is set aside there.
        lower: ``(N, n)`` float64.
        upper: ``(N, n)`` float64.
        device: Warp device.

    Returns:
        Lower bounds ``(N,)``, axes ``(2, N)`` int32 (to halve, and to halve next), points ``(N, n)``, f there ``(N,)``, and the
        slopes ``(N, n)`` of the linear function that the bound is the least value of.
    """
    count, n = lower.shape
    device = wp.get_device(device)

    def give(values: np.ndarray) -> wp.array:
        return wp.array(
            np.ascontiguousarray(values, dtype=np.float64).reshape(-1),
            dtype=wp.float64,
            device=device,
            copy=not device.is_cpu,
        )

    held = [np.ascontiguousarray(a, dtype=np.float64) for a in (lower, upper)]  # kept alive until the results are here
    outputs = [wp.empty(count, dtype=wp.float64, device=device) for _ in range(2)]
    outputs += [
        wp.empty(2 * count, dtype=wp.int32, device=device),
        wp.empty(count * n, dtype=wp.float64, device=device),
        wp.empty(count * n, dtype=wp.float64, device=device),
    ]
    if count:
        inputs = [give(held[0]), give(held[1]), count, 0, give(weights), give(padding)]
        launch_blocks(_kernel(sizes), count, inputs, outputs, device, first_index=3, block=BLOCK)
    least, value, axis, point, gradient = (o.numpy() for o in outputs)
    return least, axis.reshape(2, count), point.reshape(count, n), value, gradient.reshape(count, n)
