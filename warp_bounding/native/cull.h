// Which pairs of Newton's broad phase need not be looked at (``newton/kernels.py``, ``newton/lists.py``). Names behind $ are
// filled in there. A part begins behind a line with three slashes and its name.

/// ONE_PAIR:
/// Of one pair: the hull ``b``, and the particle's ``x``, ``y``, ``z`` and radius ``r``.
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

/// HULLS:
/// A block of pairs on a CPU; those that a bounder is asked about are listed.
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

/// DISTANCES:
/// The listed pairs, one in each lane: a bounder of distances is asked whenever the lanes are full.
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

/// CLAIM:
/// The next place in a list.
#if defined(__CUDA_ARCH__)
const unsigned int together = __match_any_sync(__activemask(), which), lane = threadIdx.x & 31u;
const int leader = __ffs(together) - 1;
int base = 0;
if ((int)lane == leader) base = atomicAdd(counts.data + which, __popc(together));
return __shfl_sync(together, base, leader) + __popc(together & (1u << lane) - 1u);
#else
return counts.data[which]++;
#endif
