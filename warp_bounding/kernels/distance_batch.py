"""Batch kernels of a distance: points in lanes, native; and one query a thread for all that marches or halves."""

from functools import cache

import warp as wp

from warp_bounding.kernels.distance_functions import (
    LEAST,
    SHORTER,
    box_func,
    clip_func,
    ray_line,
    room_func,
    segment_line,
)
from warp_bounding.kernels.distances import LANES, DistanceSource, batch_snippet, texts_of, warp_snippet
from warp_bounding.kernels.functions import Data, Words
from warp_bounding.kernels.source import Lanes, fill
from warp_bounding.runtime.native import Numbers, literal, named, native_text, unique_name, vector_type

text = native_text("marches.h")

# Marching in lanes: segments and rays of a batch, one in each lane of a vector, and a new one in a lane whenever one
# has ended.
#
# A first kernel, in Warp's own Python, makes of each query what a march needs (``functions.line_func``): a, w, its
# length, the room that rounding needs with the radius, and from when to when contact is possible (``clipping``): a
# query that passes the object's box takes no lane at all. The second one, native, marches: the same steps as
# ``functions.march_func`` with the same rounding, but for what sums in another order round, which the room covers.
# Lanes ask g together; those that have ended are written out and filled again, so that a vector is full until the
# block runs out of queries. On CUDA it is a query a thread.


def _snippet(source: DistanceSource) -> str:
    texts = texts_of(source)
    constants = {"shorter": literal(SHORTER), "least": literal(LEAST)}
    step = fill(text.STEP, **texts, **constants, body=source.body(Lanes(vector=True)))
    scalar = fill(text.STEP, **texts, **constants, body=texts["scalar_body"])
    lanes = fill(LANES, **source.width)
    return fill(text.MARCH, **texts, **constants, lanes=lanes, block=source.block, step=step, scalar_step=scalar)


@cache
def warp_lanes_kernel(source: DistanceSource, body: str) -> wp.Kernel:
    """A ``lanes_kernel`` for CUDA whose ``body`` the 32 threads of a warp run together.

    Besides it takes ``numbers``, those that the body reads, the threshold first. It is launched with whole blocks of
    threads.
    """
    constants = {"shorter": literal(SHORTER), "least": literal(LEAST)}
    texts = texts_of(source)
    step = fill(
        text.STEP, **texts | {"after": f"const float threshold = tensor[0]; {texts['after']}"}, **constants, body=body
    )
    snippet = fill(text.TOGETHER, **texts, **constants, step=step)

    @named(unique_name(source, "warp_lines")).block_kernel(snippet)
    def march(
        lines: Numbers,
        count: int,
        block: int,
        parameters: Numbers,
        words: Words,
        steps: int,
        numbers: Numbers,
        maybe: wp.array(dtype=wp.uint8),
        times: wp.array(dtype=wp.float32),
    ): ...

    return march


@cache
def lanes_kernel(source: DistanceSource) -> wp.Kernel:
    """``(lines, count, block, parameters, words, steps, maybe, times)``.

    Each thread takes a block of lines ``(count, 2 n + 2)``.
    """
    name = named(unique_name(source, "lines"))

    @name.block_kernel(_snippet(source))
    def march(
        lines: Numbers,
        count: int,
        block: int,
        parameters: Numbers,
        words: Words,
        steps: int,
        maybe: wp.array(dtype=wp.uint8),
        times: wp.array(dtype=wp.float32),
    ): ...

    return march


def _name(source: DistanceSource, role: str) -> named:
    return named(unique_name(source, role))


@cache
def distance_kernel(source: DistanceSource, values: bool) -> wp.Kernel:
    """``(x, count, block, parameters, words, radius, many, out)``, a block a thread.

    Writes distances where ``values``, else 0 and 1.
    """
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

    Besides it takes ``numbers``, those that the body reads, the threshold first. It is launched with whole blocks of
    threads.
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
    """``(first, data, a, b, length, lengths, radius, radii, clock, lines)``.

    Writes what ``lanes_kernel`` marches along: a row of 2 n + 4 numbers a query.
    """
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
        i, _ = wp.tid()
        i += first
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
        i, _ = wp.tid()
        i += first
        low, high = vector(), vector()
        for k in range(n):
            low[k] = lower[i * n + k]
            high[k] = upper[i * n + k]
        maybe[i] = wp.uint8(box(data, low, high, steps))

    return _name(source, "boxes").kernel(boxes)
