"""Kernels of the cull on a CPU: which pairs a bounder lets through, and their list; those of a GPU are in ``lists``.

Most pairs are far apart. So a loop over a block of pairs asks first whether the particle lies outside a ball around the
shape, or outside its box as it lies in the world (``placing``), and lists the others (``query_hulls``); only those go
to the bounder. A bounder of distances is asked about many of them at a time (``query_distances_in_lanes``).
"""

from functools import cache

import numpy as np
import warp as wp

from warp_bounding.kernels.distances import DistanceSource
from warp_bounding.kernels.functions import Words, lanes_of
from warp_bounding.kernels.source import Lanes, fill
from warp_bounding.newton.placing import IN_SUM, Extent, Placed
from warp_bounding.runtime.native import Numbers, literal, named, unique_name

SUM_ROUNDING = wp.constant(IN_SUM)

CPU_BLOCK = 1024  # pairs that one thread of a kernel goes through on a CPU


@wp.kernel(enable_backward=False)
def split_balls(
    # inputs
    first: int,
    points: wp.array(dtype=wp.vec3),
    radii: wp.array(dtype=float),
    count: int,
    # outputs
    rows: wp.array(dtype=float),
):
    """The balls' x, one after another, then all their y, z and radii: so that neighbours are read together."""
    p = first + wp.tid()
    q = points[p]
    for k in range(3):
        rows[k * count + p] = q[k]
    rows[3 * count + p] = radii[p]


@wp.kernel(enable_backward=False)
def gather_or_repeat(
    # inputs
    pairs: wp.array(dtype=wp.vec2i),
    indices: wp.array(dtype=wp.int32),
    count: wp.array(dtype=wp.int32),
    # outputs
    kept: wp.array(dtype=wp.vec2i),
):
    """The pairs that are left, in their order; and behind them, up to the number of all pairs, one that was denied.

    The pass makes no contact of it, however often it comes. It is the first one: indices ascend, so that it is where
    they run ahead of their own places.
    """
    i = wp.tid()
    left = count[0]
    if i < left:
        kept[i] = pairs[indices[i]]
    else:
        denied, most = wp.int32(0), int(left)
        while denied < most:
            middle = (denied + most) // 2
            if indices[middle] == middle:
                denied = middle + 1
            else:
                most = middle
        kept[i] = pairs[denied]


# --- Hulls ------------------------------------------------------------------------------------------------------------
#
# Which pairs need no bounder: the particle lies outside the ball or the box around the shape (``placing.Extent``).
#
# Newton lists its pairs shape by shape, and of each shape particle by particle. So ``PAIRS_AT_ONCE`` pairs in a row are
# nearly always one shape and particles that follow each other, and are decided together; where they are not, it is one
# pair at a time, by the same operations.

PAIRS_AT_ONCE = 16  # pairs that are decided together; divides ``kernels.CPU_BLOCK``

# Of one pair: the hull ``b``, and the particle's ``x``, ``y``, ``z`` and radius ``r``.
ONE_PAIR = """
    const float size_ = fabsf(x) + fabsf(y) + fabsf(z);
    const float way = b.reach + b.per_radius * fabsf(r) + b.per_coordinate * size_;
    const float dx = x - b.center[0], dy = y - b.center[1], dz = z - b.center[2];
    const bool known = way <= b.margin;
    const float radius_ = b.radius + b.grow_radius * way;
    bool maybe = known && !(dx * dx + dy * dy + dz * dz > radius_ * radius_);
    if (maybe) for (int k = 0; k < 3; ++k) {
        const float* const u = b.axes.data[k];
        const float t = u[0] * dx + u[1] * dy + u[2] * dz, bound = b.half[k] + b.grow[k] * way;
        maybe = maybe && !(t > bound || -t > bound + (k == 2 ? b.below : 0.0f));
    }
"""
_TEXT = """
const int begin = block * size, end = begin + size < count ? begin + size : count;
const int particles = rows.shape[0] / 4;
const int* const pair = (const int*)pairs.data;
const float *const px = rows.data, *const py = px + particles, *const pz = py + particles, *const pr = pz + particles;
int found = 0;
const auto ask_one = [&](int i) {
    const int p = pair[2 * i];
    const auto& b = hulls.data[pair[2 * i + 1]];
    const float x = px[p], y = py[p], z = pz[p], r = pr[p];
    $one
    keep.data[i] = !known || (maybe && b.stays);
    asked.data[begin + found] = i;
    found += maybe && !b.stays;
};
int i = begin;
#if !defined(__CUDA_ARCH__)
constexpr int L = $lanes;
typedef float V __attribute__((vector_size(4 * L), aligned(4), may_alias));
typedef int I __attribute__((vector_size(4 * L)));
typedef int J __attribute__((vector_size(4 * L), aligned(4), may_alias));
typedef unsigned char B __attribute__((vector_size(L), aligned(1), may_alias));
const V zero = {};
const auto size_of = [](V x) { return __builtin_elementwise_abs(x); };
for (; i + L <= end; i += L) {
    if (!runs.data[i / L]) {
        for (int l = 0; l < L; ++l) ask_one(i + l);
        continue;
    }
    const int p = pair[2 * i];
    const auto& b = hulls.data[pair[2 * i + 1]];
    const V x = *(const V*)(px + p), y = *(const V*)(py + p), z = *(const V*)(pz + p);
    const V way = size_of(*(const V*)(pr + p)) * b.per_radius + (size_of(x) + size_of(y) + size_of(z)) * b.per_coordinate + b.reach;
    const V dx = x - b.center[0], dy = y - b.center[1], dz = z - b.center[2];
    const I known = way <= zero + b.margin;
    const V radius = way * b.grow_radius + b.radius;
    I maybe = known & ~(dx * dx + dy * dy + dz * dz > radius * radius);
    *(B*)(keep.data + i) = __builtin_convertvector(~known & 1, B);
    if (!__builtin_reduce_or(maybe)) continue;
    for (int k = 0; k < 3; ++k) {
        const float* const u = b.axes.data[k];
        const V t = dx * u[0] + dy * u[1] + dz * u[2], bound = way * b.grow[k] + b.half[k];
        maybe &= ~(t > bound | -t > bound + (k == 2 ? b.below : 0.0f));
    }
    if (!__builtin_reduce_or(maybe)) continue;
    if (b.stays) {
        *(B*)(keep.data + i) = __builtin_convertvector((~known | maybe) & 1, B);
        continue;
    }
    int each[L];
    *(J*)each = maybe;
    for (int l = 0; l < L; ++l) { asked.data[begin + found] = i + l; found += each[l] & 1; }
}
#endif
for (; i < end; ++i) ask_one(i);
left.data[block] = found;
"""  # noqa: E501


@named("wb_ask_hulls").block_kernel(fill(_TEXT, lanes=PAIRS_AT_ONCE, one=ONE_PAIR))
def query_hulls(
    pairs: wp.array(dtype=wp.vec2i),
    count: int,
    size: int,
    block: int,
    runs: wp.array(dtype=wp.bool),
    rows: wp.array(dtype=float),
    hulls: wp.array(dtype=Extent),
    asked: wp.array(dtype=wp.int32),
    left: wp.array(dtype=wp.int32),
    keep: wp.array(dtype=wp.bool),
):
    """Decide the pairs of each block that need no bounder, and list the others in ``asked``, block by block."""


def runs_of(pairs: np.ndarray) -> np.ndarray:
    """Which ``LANES`` of the pairs ``(N, 2)`` in a row are of one shape and particles that follow each other.

    ``(N // LANES,)`` bool, one at least.
    """
    rows = pairs[: len(pairs) // PAIRS_AT_ONCE * PAIRS_AT_ONCE].reshape(-1, PAIRS_AT_ONCE, 2)
    same = (np.diff(rows, axis=1) == (1, 0)).all(axis=(1, 2))
    return same if len(same) else np.zeros(1, bool)


# --- Distances, many at a time ----------------------------------------------------------------------------------------
#
# Asking a bounder of distances about the pairs that ``query_hulls`` has listed, on a CPU: one pair in each lane of a
# vector.
#
# Few pairs of a block are listed, so a thread goes through ``BLOCKS`` blocks, and asks whenever its lanes are full.
# What it asks, and how that rounds, is what ``lists.query_listed`` does for one pair, on CUDA.

BLOCKS = 16  # blocks of pairs that a thread of the kernel goes through

_ASK = """
#if !defined(__CUDA_ARCH__)
#pragma clang fp contract(fast)
constexpr int N = 3;
$parts
$tools
$lanes
const V zero = {};
const int* const pair = (const int*)pairs.data;
const int particles = rows.shape[0] / 4, last = (block + 1) * $blocks < count ? (block + 1) * $blocks : count;
float at[N][L] = {}, ways[L] = {};
int who[L], m = 0;
const auto ask = [&]() {
    V q[N], v[N];
#pragma unroll
    for (int k = 0; k < N; ++k) q[k] = *(const V*)at[k];
    $locate
    V f;
    $body
    $after
    int far_[L];
    *(J*)far_ = g > *(const V*)ways;
    for (int l = 0; l < m; ++l) keep.data[who[l]] = far_[l] ? 0 : 1;
    m = 0;
};
for (int b = block * $blocks; b < last; ++b) {
    for (int k = 0; k < left.data[b]; ++k) {
        const int i = asked.data[b * size + k], p = pair[2 * i], s = pair[2 * i + 1];
        if (numbers.data[s] != number) continue;
        const auto& hull = hulls.data[s];
        const auto& shape = placed.data[s];
        const wp::vec3 x(rows.data[p], rows.data[particles + p], rows.data[2 * particles + p]);
        const wp::vec3 y = wp::transform_point(shape.to_shape, x);
#pragma unroll
        for (int c = 0; c < N; ++c) at[c][m] = y[c] / shape.scale[c];
        const float size_ = fabsf(x[0]) + fabsf(x[1]) + fabsf(x[2]);
        const float way = hull.reach + hull.per_radius * fabsf(rows.data[3 * particles + p]) + hull.per_coordinate * size_;
        ways[m] = (way > dilated ? way - dilated : 0.0f) + $rounding * (fabsf(way) + dilated);
        who[m++] = i;
        if (m == L) ask();
    }
}
if (m > 0) ask();
#endif
"""  # noqa: E501


@cache
def query_distances_in_lanes(source: DistanceSource) -> wp.Kernel:
    """The kernel of a bounder of this source; see module, and ``lists.query_listed``."""
    texts = source.around(placed=False, values=True) | {
        "lanes": lanes_of(source),
        "body": source.body(Lanes(vector=True)),
        "rounding": literal(IN_SUM),
        "blocks": BLOCKS,
    }

    @named(unique_name(source, "newton_lanes")).block_kernel(fill(_ASK, **texts))
    def ask(
        parameters: Numbers,
        count: int,
        size: int,
        block: int,
        words: Words,
        number: int,
        dilated: float,
        numbers: wp.array(dtype=wp.int32),
        pairs: wp.array(dtype=wp.vec2i),
        rows: wp.array(dtype=float),
        placed: wp.array(dtype=Placed),
        hulls: wp.array(dtype=Extent),
        asked: wp.array(dtype=wp.int32),
        left: wp.array(dtype=wp.int32),
        keep: wp.array(dtype=wp.bool),
    ): ...

    return ask
