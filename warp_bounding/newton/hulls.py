"""Which pairs need no bounder: the particle lies outside the ball or the box around the shape (``placing.Hull``).

Newton lists its pairs shape by shape, and of each shape particle by particle. So on a CPU ``LANES`` pairs in a row are nearly always one shape and
particles that follow each other, and are decided together; where they are not, and on CUDA, it is one pair at a time, by the same operations.
"""

import numpy as np
import warp as wp

from warp_bounding.newton.placing import Hull
from warp_bounding.runtime.native import named

__all__ = ["LANES", "ask_hulls", "runs_of"]

LANES = 16  # pairs that are decided together; divides ``kernels.CPU_BLOCK``

_TEXT = """
const int begin = block * size, end = begin + size < count ? begin + size : count;
const int particles = rows.shape[0] / 4;
const int* const pair = (const int*)pairs.data;
const float *const px = rows.data, *const py = px + particles, *const pz = py + particles, *const pr = pz + particles;
int found = 0;
const auto ask_one = [&](int i) {
    const int p = pair[2 * i];
    const auto& b = hulls.data[pair[2 * i + 1]];
    const float x = px[p], y = py[p], z = pz[p];
    const float size_ = fabsf(x) + fabsf(y) + fabsf(z);
    const float way = b.reach + b.per_radius * fabsf(pr[p]) + b.per_coordinate * size_;
    const float dx = x - b.center[0], dy = y - b.center[1], dz = z - b.center[2];
    const bool known = way <= b.margin;
    const float radius = b.radius + b.grow_radius * way;
    bool maybe = known && !(dx * dx + dy * dy + dz * dz > radius * radius);
    if (maybe) for (int k = 0; k < 3; ++k) {
        const float* const u = b.axes.data[k];
        const float t = u[0] * dx + u[1] * dy + u[2] * dz, bound = b.half[k] + b.grow[k] * way;
        maybe = maybe && !(t > bound || -t > bound + (k == 2 ? b.below : 0.0f));
    }
    keep.data[i] = !known || (maybe && b.stays);
    asked.data[begin + found] = i;
    found += maybe && !b.stays;
};
int i = begin;
#if !defined(__CUDA_ARCH__)
constexpr int L = LANES;
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
"""


@named("wb_ask_hulls").block_kernel(_TEXT.replace("LANES", str(LANES)))
def ask_hulls(
    pairs: wp.array(dtype=wp.vec2i),
    count: int,
    size: int,
    block: int,
    runs: wp.array(dtype=wp.uint8),
    rows: wp.array(dtype=float),
    hulls: wp.array(dtype=Hull),
    asked: wp.array(dtype=wp.int32),
    left: wp.array(dtype=wp.int32),
    keep: wp.array(dtype=wp.uint8),
):
    """Decide the pairs of each block that need no bounder, and list the others from the block's first place in ``asked`` on."""


def runs_of(pairs: np.ndarray) -> np.ndarray:
    """Which ``LANES`` pairs in a row are of one shape and particles that follow each other.

    Args:
        pairs: ``(N, 2)`` int, particle and shape.

    Returns:
        ``(N // LANES,)`` uint8, one at least.
    """
    rows = pairs[: len(pairs) // LANES * LANES].reshape(-1, LANES, 2)
    same = (np.diff(rows, axis=1) == (1, 0)).all(axis=(1, 2))
    return same.astype(np.uint8) if len(same) else np.zeros(1, np.uint8)
