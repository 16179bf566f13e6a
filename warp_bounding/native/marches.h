// Marches along segments and rays. Names behind $ are filled in by kernels/distance_batch.py.

/// STEP
V q[N], v[N];
#pragma unroll
for (int k = 0; k < N; ++k) q[k] = a[k] + w_[k] * t;
$before
V f;
$body
$after
const V free_ = g - room;
const V later = (t + over(free_ * $shorter, length)) * $shorter;

/// MARCH
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

/// TOGETHER:
/// The same by the lanes of a warp together, each with a march of its own, and the next one when that has ended. CUDA
/// only.
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
