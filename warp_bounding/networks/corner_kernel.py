"""Multilinear bounds of a network over boxes of its inputs, as their values at the corners: one box per SIMD lane."""

from functools import cache

import numpy as np
import warp as wp

from warp_bounding.networks import polynomial_text
from warp_bounding.networks.bound_kernel import double_array
from warp_bounding.networks.bound_source import BLOCK, NetworkShape, body, stored
from warp_bounding.runtime.launch import launch_blocks
from warp_bounding.runtime.native import named, unique_name

__all__ = ["bound_corners"]

_STORE = """
const long long o = i + l;
for (int k = 0; k < 1 << C; ++k) corner_out.data[o * (1 << C) + k] = LANE(corner[k]);
"""


@cache
def _kernel(shape: NetworkShape) -> wp.Kernel:
    name = named(unique_name(shape, "corners"))
    bounds = body(shape, "false", multilinear=True) + polynomial_text.CORNERS

    @name.block_kernel(stored(shape, bounds, _STORE))
    def corners_of_all(
        boxes: wp.array(dtype=wp.float64),
        count: int,
        block: int,
        weights: wp.array(dtype=wp.float64),
        paddings: wp.array(dtype=wp.float64),
        corner_out: wp.array(dtype=wp.float64),
    ): ...

    return corners_of_all


def bound_corners(
    shape: NetworkShape, weights: np.ndarray, padding: np.ndarray, lower: np.ndarray, upper: np.ndarray, device="cpu"
) -> np.ndarray:
    """Numbers at the corners of boxes: f is at least what is multilinear between them, certified.

    Args:
        shape: The network's shape, and the plain chart.
        weights: ``Network.packed``.
        padding: ``Network.padding``.
        lower: ``(N, n)`` float64, lower corners.
        upper: ``(N, n)`` float64, upper corners.
        device: Warp device.

    Returns:
        ``(N, 2^n)`` float64; the corner at place i is the upper one on axis k where bit k of i is set.
    """
    count, size = lower.shape
    device = wp.get_device(device)
    held = (np.concatenate([lower, upper], axis=1), weights, padding)
    held = [np.ascontiguousarray(each, dtype=np.float64) for each in held]
    corner = wp.empty(count << size, dtype=wp.float64, device=device)
    if count:
        boxes, *parameters = (double_array(each, device) for each in held)
        launch_blocks(
            _kernel(shape), count, [boxes, count, 0, *parameters], [corner], device, first_index=2, block=BLOCK
        )
    return corner.numpy().reshape(count, 1 << size)
