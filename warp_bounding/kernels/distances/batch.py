"""Batch kernels of a distance: points in lanes, native; and one query a thread for all that marches or halves."""

from functools import cache

import warp as wp

from warp_bounding.coordinates.base import Numbers, vector_type
from warp_bounding.kernels.distances.assemble import batch_snippet, warp_snippet
from warp_bounding.kernels.distances.clipping import clip_func
from warp_bounding.kernels.distances.functions import (
    box_func,
    ray_line,
    room_func,
    segment_line,
)
from warp_bounding.kernels.distances.source import DistanceSource
from warp_bounding.kernels.functions import Data, Words
from warp_bounding.runtime.native import named, unique_name

__all__ = ["box_kernel", "distance_kernel", "lines_kernel", "warp_kernel"]


def _name(source: DistanceSource, role: str) -> named:
    return named(unique_name(source, role))


@cache
def distance_kernel(source: DistanceSource, values: bool) -> wp.Kernel:
    """``(x, count, block, parameters, words, radius, many, out)``, one block a thread: distances where ``values``, else 0 and 1."""
    out_type = wp.float32 if values else wp.uint8

    @_name(source, f"distances{'_values' * values}").block_kernel(batch_snippet(source, values))
    def batch(
        x: Numbers,
        count: int,
        block: int,
        parameters: Numbers,
        words: Words,
        radius: Numbers,
        many: int,
        out: wp.array(dtype=out_type),
    ): ...

    return batch


@cache
def warp_kernel(source: DistanceSource, values: bool, body: str) -> wp.Kernel:
    """A ``distance_kernel`` for CUDA whose ``body`` the 32 threads of a warp run together.

    Besides it takes ``numbers``, those that the body reads, the threshold first. It is launched with whole blocks of threads.
    """
    out_type = wp.float32 if values else wp.uint8

    @_name(source, f"warp_distances{'_values' * values}").block_kernel(warp_snippet(source, values, body))
    def batch(
        x: Numbers,
        count: int,
        block: int,
        parameters: Numbers,
        words: Words,
        radius: Numbers,
        many: int,
        numbers: Numbers,
        out: wp.array(dtype=out_type),
    ): ...

    return batch


@cache
def lines_kernel(source: DistanceSource, ray: bool) -> wp.Kernel:
    """``(first, data, a, b, length, lengths, radius, radii, clock, lines)``: what ``lanes_kernel`` marches along, a row of 2 n + 4 numbers a query."""
    n, vector, room = source.ndim, vector_type(source.ndim), room_func(source)
    of_segment, of_ray, clip = segment_line(source), ray_line(source), clip_func(source)

    def lines_of(
        first: int,
        # inputs
        data: Data,
        a: Numbers,
        b: Numbers,
        length: Numbers,
        lengths: int,
        radius: Numbers,
        radii: int,
        clock: wp.vec3,
        # outputs
        lines: Numbers,
    ):
        i = first + wp.tid()
        start, end = vector(), vector()
        for k in range(n):
            if ray:
                start[k] = a[2 * n * i + k]
                end[k] = a[2 * n * i + n + k]
            else:
                start[k] = a[i * n + k]
                end[k] = b[i * n + k]
        w, long = vector(), wp.float32(0.0)
        if ray:
            w, long = of_ray(end, length[lengths * i])
        else:
            w, long = of_segment(start, end, clock)
        row, most = i * (2 * n + 4), room(start, w, long, radius[radii * i], clock)
        span = clip(data, start, w, most)
        for k in range(n):
            lines[row + k] = start[k]
            lines[row + n + k] = w[k]
        lines[row + 2 * n] = long
        lines[row + 2 * n + 1] = most
        lines[row + 2 * n + 2] = span[0]
        lines[row + 2 * n + 3] = span[1]

    return _name(source, "ray_lines" if ray else "segment_lines").kernel(lines_of)


@cache
def box_kernel(source: DistanceSource) -> wp.Kernel:
    """``(first, data, lower, upper, steps, maybe)``, one box a thread."""
    box, n, vector = box_func(source), source.ndim, vector_type(source.ndim)

    def boxes(
        first: int,
        # inputs
        data: Data,
        lower: Numbers,
        upper: Numbers,
        steps: int,
        # outputs
        maybe: wp.array(dtype=wp.uint8),
    ):
        i = first + wp.tid()
        low, high = vector(), vector()
        for k in range(n):
            low[k] = lower[i * n + k]
            high[k] = upper[i * n + k]
        maybe[i] = wp.uint8(box(data, low, high, steps))

    return _name(source, "boxes").kernel(boxes)
