"""The bounds of ``Network.bound`` as one fused native kernel, float64, one box per SIMD lane; its plain twin is there."""

from functools import cache

import numpy as np
import warp as wp

from warp_bounding.networks.bound_source import BLOCK, NetworkSizes, snippet
from warp_bounding.networks.box_bounds import BoxBounds
from warp_bounding.runtime.launch import launch_blocks
from warp_bounding.runtime.native import named, unique_name

__all__ = ["bound_boxes", "double_array"]


@cache
def _kernel(sizes: NetworkSizes) -> wp.Kernel:
    name = named(unique_name(sizes, "boxes"))

    @name.func_native(snippet(sizes))
    def bound_block(
        boxes: wp.array(dtype=wp.float64),
        count: int,
        block: int,
        weights: wp.array(dtype=wp.float64),
        paddings: wp.array(dtype=wp.float64),
        numbers: wp.array(dtype=wp.float64),
        table: wp.array(dtype=wp.int32),
        least_out: wp.array(dtype=wp.float64),
        value_out: wp.array(dtype=wp.float64),
        axes: wp.array(dtype=wp.int32),
        point: wp.array(dtype=wp.float64),
        gradient_out: wp.array(dtype=wp.float64),
        level_out: wp.array(dtype=wp.float64),
    ): ...

    @name.kernel
    def bound_all(
        # inputs
        boxes: wp.array(dtype=wp.float64),
        count: int,
        first: int,
        weights: wp.array(dtype=wp.float64),
        paddings: wp.array(dtype=wp.float64),
        numbers: wp.array(dtype=wp.float64),
        table: wp.array(dtype=wp.int32),
        # outputs
        least_out: wp.array(dtype=wp.float64),
        value_out: wp.array(dtype=wp.float64),
        axes: wp.array(dtype=wp.int32),
        point: wp.array(dtype=wp.float64),
        gradient_out: wp.array(dtype=wp.float64),
        level_out: wp.array(dtype=wp.float64),
    ):
        bound_block(
            boxes,
            count,
            first + wp.tid(),
            weights,
            paddings,
            numbers,
            table,
            least_out,
            value_out,
            axes,
            point,
            gradient_out,
            level_out,
        )

    return bound_all


def double_array(values: np.ndarray, device: wp.Device) -> wp.array:
    """Float64 numbers on a device; a CPU's array shares memory with ``values``, which the caller keeps alive."""
    return wp.array(values.reshape(-1), dtype=wp.float64, device=device, copy=not device.is_cpu)


def bound_boxes(
    sizes: NetworkSizes,
    weights: np.ndarray,
    padding: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    numbers: np.ndarray | None = None,
    table: np.ndarray | None = None,
    device="cpu",
) -> BoxBounds:
    """Bounds of a network over boxes.

    Args:
        sizes: Of the hidden layers, and the chart.
        weights: float64: per hidden layer biases ``(H,)``, weights ``(H, K)`` in row order and their absolute values, then the output's
            bias and weights.
        padding: float64, one number a layer, the output last: rounding that is set aside there.
        lower: ``(N, Z)`` float64, numbers of the chart.
        upper: ``(N, Z)`` float64.
        numbers: float64 parameters of the chart.
        table: int32 parameters of the chart.
        device: Warp device.
    """
    count, size = lower.shape
    device = wp.get_device(device)
    held = [
        np.ascontiguousarray(a, dtype=np.float64) for a in (np.concatenate([lower, upper], axis=1), weights, padding)
    ]
    held.append(np.zeros(1) if numbers is None else np.ascontiguousarray(numbers, dtype=np.float64))
    outputs = [wp.empty(count, dtype=wp.float64, device=device) for _ in range(2)]
    outputs += [
        wp.empty(2 * count, dtype=wp.int32, device=device),
        wp.empty(count * size, dtype=wp.float64, device=device),
        wp.empty(count * sizes.ndim, dtype=wp.float64, device=device),
        wp.empty(count, dtype=wp.float64, device=device),
    ]
    boxes, *parameters = (double_array(a, device) for a in held)
    if count:
        words = wp.array(np.zeros(1, np.int32) if table is None else table, dtype=wp.int32, device=device)
        inputs = [boxes, count, 0, *parameters, words]
        launch_blocks(_kernel(sizes), count, inputs, outputs, device, first_index=2, block=BLOCK)
    least, value, axes, point, slope, level = (o.numpy() for o in outputs)
    shapes = [(2, count), (count, size), (count,), (count, sizes.ndim), (count,)]
    numbers = (axes, point, value, slope, level)
    (axis, next_axis), point, value, *linear = (part.reshape(s) for part, s in zip(numbers, shapes, strict=True))
    return BoxBounds(least, axis, point, value, next_axis, *linear, boxes.numpy().reshape(count, 2, size))
