"""The bounds of ``Network.bound`` as one fused native kernel: float64, one box per SIMD lane."""

from functools import cache

import numpy as np
import warp as wp

from warp_bounding.networks.bound_source import BLOCK, NetworkShape, snippet
from warp_bounding.networks.box_bounds import BoxBounds
from warp_bounding.runtime.launch import launch_blocks
from warp_bounding.runtime.native import named, unique_name

__all__ = ["bound_boxes", "double_array"]


@cache
def _kernel(shape: NetworkShape) -> wp.Kernel:
    name = named(unique_name(shape, "boxes"))

    @name.block_kernel(snippet(shape))
    def bound_all(
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

    return bound_all


def double_array(values: np.ndarray, device: wp.Device) -> wp.array:
    """Float64 numbers on a device; a CPU's array shares memory with ``values``, which the caller keeps alive."""
    return wp.array(values.reshape(-1), dtype=wp.float64, device=device, copy=not device.is_cpu)


def bound_boxes(
    shape: NetworkShape,
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
        shape: The network's shape, and the chart.
        weights: ``Network.packed``: float64, per hidden layer biases ``(H,)``, weights ``(H, K)`` in row order and
            their absolute values, then the output's bias and weights.
        padding: ``Network.padding``: float64, a bound of what each layer's float64 arithmetic rounds, the output's
            last.
        lower: ``(N, Z)`` float64, lower corners in the chart's numbers.
        upper: ``(N, Z)`` float64, upper corners.
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
        wp.empty(count * shape.ndim, dtype=wp.float64, device=device),
        wp.empty(count, dtype=wp.float64, device=device),
    ]
    boxes, *parameters = (double_array(a, device) for a in held)
    if count:
        words = wp.array(np.zeros(1, np.int32) if table is None else table, dtype=wp.int32, device=device)
        inputs = [boxes, count, 0, *parameters, words]
        launch_blocks(_kernel(shape), count, inputs, outputs, device, first_index=2, block=BLOCK)
    least, value, axes, point, slope, level = (o.numpy() for o in outputs)
    shapes = [(2, count), (count, size), (count,), (count, shape.ndim), (count,)]
    numbers = (axes, point, value, slope, level)
    (axis, next_axis), point, value, *linear = (part.reshape(s) for part, s in zip(numbers, shapes, strict=True))
    return BoxBounds(least, axis, point, value, next_axis, *linear, boxes.numpy().reshape(count, 2, size))
