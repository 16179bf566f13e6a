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
from warp_bounding.runtime.native import Numbers, literal, named, unique_name, vector_type

# Marching in lanes: segments and rays of a batch, one in each lane of a vector, and a new one in a lane whenever one
# has ended.
#
# A first kernel, in Warp's own Python, makes of each query what a march needs (``functions.line_func``): a, w, its
# length, the room that rounding needs with the radius, and from when to when contact is possible (``clipping``): a
# query that passes the object's box takes no lane at all. The second one, native, marches: the same steps as
# ``functions.march_func`` with the same rounding, but for what sums in another order round, which the room covers.
# Lanes ask g together; those that have ended are written out and filled again, so that a vector is full until the
# block runs out of queries. On CUDA it is a query a thread.

_STEP = """
V q[N], v[N];
#pragma unroll
for (int k = 0; k < N; ++k) q[k] = a[k] + w_[k] * t;
$before
V f;
$body
$after
const V free_ = g - room;
const V later = (t + over(free_ * $shorter, length)) * $shorter;
"""

_MARCH = """
#if !defined(__CUDA_ARCH__)
#pragma clang fp contract(fast)
#endif
constexpr int N = $n, ROW = 2 * N + 4;
$parts
$tools
#if !defined(__CUDA_ARCH__)
$lanes
const int begin = block * $block, end = begin + $block < count ? begin + $block : count;
V a[N], w_[N], length = zero + 1.0f, room = zero + INFINITY, t = zero, last = zero + 1.0f;
#pragma unroll
for (int k = 0; k < N; ++k) { a[k] = zero; w_[k] = zero; }
int who[L], left[L], next = begin, active = 0;
const auto fill_lane = [&](int l) {
    who[l] = -1;
    room[l] = INFINITY;
    const float* row = lines.data + (long long)next * ROW;
    for (; next < end && row[ROW - 2] > row[ROW - 1]; row += ROW) {  // it passes the object's box
        maybe.data[next] = 0;
        times.data[next++] = 1.0f;
    }
    if (next >= end) return;
#pragma unroll
    for (int k = 0; k < N; ++k) { a[k][l] = row[k]; w_[k][l] = row[N + k]; }
    length[l] = row[2 * N];
    room[l] = row[2 * N + 1];
    t[l] = row[ROW - 2];
    last[l] = row[ROW - 1];
    left[l] = steps;
    who[l] = next++;
    ++active;
};
for (int l = 0; l < L; ++l) fill_lane(l);
while (active > 0) {
    $step
    const I on = (free_ > zero) & (later > most(t, zero + $least));
    const I clear = on & (later >= last);
    t = on ? later : t;
    int on_[L], clear_[L];  // in memory: lanes of a vector are dear one by one
    *(J*)on_ = on;
    *(J*)clear_ = clear;
    for (int l = 0; l < L; ++l) {
        if (who[l] < 0) continue;
        if (on_[l] && !clear_[l] && --left[l] > 0) continue;
        maybe.data[who[l]] = clear_[l] ? 0 : 1;
        times.data[who[l]] = clear_[l] ? 1.0f : t[l];
        --active;
        fill_lane(l);
    }
}
#else
typedef float V;
const float zero = 0.0f;
const int i = block;
if (i >= count) return;
const float* row = lines.data + (long long)i * ROW;
V a[N], w_[N], t = row[ROW - 2];
#pragma unroll
for (int k = 0; k < N; ++k) { a[k] = row[k]; w_[k] = row[N + k]; }
const V length = row[2 * N], room = row[2 * N + 1], last = row[ROW - 1];
bool clear = t > last;
for (int step = 0; step < steps && !clear; ++step) {
    $scalar_step
    if (!(free_ > 0.0f && later > most(t, $least))) break;
    t = later;
    clear = later >= last;
}
maybe.data[i] = clear ? 0 : 1;
times.data[i] = clear ? 1.0f : t;
#endif
"""


# The same by the lanes of a warp together, each with a march of its own, and the next one when that has ended. CUDA only.
_TOGETHER = """
#if defined(__CUDA_ARCH__)
typedef float V;
constexpr int N = $n, ROW = 2 * N + 4;
const float zero = 0.0f;
$parts
$tools
const float* tensor = numbers.data;
const unsigned int all = 0xffffffffu, before = (1u << (block & 31)) - 1u;
const int warps = gridDim.x * blockDim.x / 32, each = (count + warps - 1) / warps;
int next = block / 32 * each, who = -1, left = 0;
const int end = next + each < count ? next + each : count;
V a[N], w_[N], length = 1.0f, room = INFINITY, t = zero, last = 1.0f;
#pragma unroll
for (int k = 0; k < N; ++k) { a[k] = zero; w_[k] = zero; }
while (true) {
    for (unsigned int empty = __ballot_sync(all, who < 0); empty && next < end; empty = __ballot_sync(all, who < 0)) {
        const int own = next + __popc(empty & before);
        if (who < 0 && own < end) {
            const float* row = lines.data + (long long)own * ROW;
            t = row[ROW - 2];
            last = row[ROW - 1];
            if (t > last) {  // it passes the object's box
                maybe.data[own] = 0;
                times.data[own] = 1.0f;
            } else {
#pragma unroll
                for (int k = 0; k < N; ++k) { a[k] = row[k]; w_[k] = row[N + k]; }
                length = row[2 * N];
                room = row[2 * N + 1];
                left = steps;
                who = own;
            }
        }
        next += __popc(empty);
    }
    if (!__any_sync(all, who >= 0)) break;
    $step
    const bool on = (free_ > zero) & (later > most(t, zero + $least));
    const bool clear = on & (later >= last);
    t = on ? later : t;
    if (who >= 0 && (!on || clear || --left <= 0)) {
        maybe.data[who] = clear ? 0 : 1;
        times.data[who] = clear ? 1.0f : t;
        who = -1;
    }
}
#endif
"""


def _snippet(source: DistanceSource) -> str:
    texts = texts_of(source)
    constants = {"shorter": literal(SHORTER), "least": literal(LEAST)}
    step = fill(_STEP, **texts, **constants, body=source.body(Lanes(vector=True)))
    scalar = fill(_STEP, **texts, **constants, body=texts["scalar_body"])
    lanes = fill(LANES, **source.width)
    return fill(_MARCH, **texts, **constants, lanes=lanes, block=source.block, step=step, scalar_step=scalar)


@cache
def warp_lanes_kernel(source: DistanceSource, body: str) -> wp.Kernel:
    """A ``lanes_kernel`` for CUDA whose ``body`` the 32 threads of a warp run together.

    Besides it takes ``numbers``, those that the body reads, the threshold first. It is launched with whole blocks of threads.
    """
    constants = {"shorter": literal(SHORTER), "least": literal(LEAST)}
    texts = texts_of(source)
    step = fill(
        _STEP, **texts | {"after": f"const float threshold = tensor[0]; {texts['after']}"}, **constants, body=body
    )
    snippet = fill(_TOGETHER, **texts, **constants, step=step)

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
    """``(lines, count, block, parameters, words, steps, maybe, times)``, one block of lines ``(count, 2 n + 2)`` a thread."""
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
