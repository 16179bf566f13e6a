"""Asking a bounder of distances about the pairs that ``hulls`` has listed, on a CPU: one pair in each lane of a vector.

Few pairs of a block are listed, so a thread goes through ``BLOCKS`` blocks, and asks whenever its lanes are full. What it asks, and how that
rounds, is what ``kernels.ask_distances`` does for one pair, on CUDA.
"""

from functools import cache

import warp as wp

from warp_bounding.coordinates.base import Numbers, literal
from warp_bounding.kernels.distances.assemble import LANES, texts_of
from warp_bounding.kernels.distances.source import DistanceSource
from warp_bounding.kernels.functions import Words
from warp_bounding.kernels.source import Lanes, fill
from warp_bounding.newton.placing import IN_SUM, Hull, Placed
from warp_bounding.runtime.native import named, unique_name

__all__ = ["BLOCKS", "ask_distances_in_lanes"]

BLOCKS = 16  # blocks of pairs that a thread of the kernel goes through

_ASK = """
#if !defined(__CUDA_ARCH__)
#pragma clang fp contract(fast)
constexpr int N = 3;
$parts
$tools
$lanes
const int* const pair = (const int*)pairs.data;
const int particles = rows.shape[0] / 4, last = (block + 1) * $blocks < count ? (block + 1) * $blocks : count;
float at[N][L] = {}, ways[L] = {};
int who[L], m = 0;
const auto ask = [&]() {
    V q[N], v[N];
#pragma unroll
    for (int k = 0; k < N; ++k) q[k] = *(const V*)at[k];
    $before
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
"""


@cache
def ask_distances_in_lanes(source: DistanceSource) -> wp.Kernel:
    """The kernel of a bounder of this source; see module, and ``kernels.ask_distances``."""
    texts = texts_of(source) | {
        "lanes": fill(LANES, **source.width),
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
        hulls: wp.array(dtype=Hull),
        asked: wp.array(dtype=wp.int32),
        left: wp.array(dtype=wp.int32),
        keep: wp.array(dtype=wp.uint8),
    ): ...

    return ask
