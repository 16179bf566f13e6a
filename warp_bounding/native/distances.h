// Around a distance: from a query to v, and from f to g; and marches along segments and rays. Names behind $ are filled
// in by kernels/distances.py.

/// TOOLS
#if !defined(__CUDA_ARCH__)
auto wb_size_of = [](auto x) { return __builtin_elementwise_abs(x); };
auto wb_most = [](auto a, auto b) { return __builtin_elementwise_max(a, b); };
auto wb_least = [](auto a, auto b) { return __builtin_elementwise_min(a, b); };
#else
auto wb_size_of = [](float x) { return fabsf(x); };
auto wb_most = [](float a, float b) { return fmaxf(a, b); };
auto wb_least = [](float a, float b) { return fminf(a, b); };
#endif

/// PARTS
const float* center = parameters.data + $label;
const float* limit = center + $n;
const float scale = center[2 * $n], unit = center[2 * $n + 1], threshold = center[2 * $n + 2], share = center[2 * $n + 3];
const float* w = parameters.data + $start;
(void)limit; (void)w;
$clock

/// CLOCK
const float time_scale = center[2 * $n + 4];

/// BEFORE_WHOLE
V away = zero;
#pragma unroll
for (int k = 0; k < N; ++k) {
    v[k] = (q[k] - center[k]) * scale;
    away = away + wb_size_of(v[k]);
}

/// BEFORE_NEAREST
V away = zero, beyond = zero;
#pragma unroll
for (int k = 0; k < N; ++k) {
    v[k] = (q[k] - center[k]) * $scale;
    away = away + wb_size_of(v[k]);
    if ($free) continue;
    const V p = wb_least(wb_most(v[k], zero - limit[k]), zero + limit[k]), r = v[k] - p;
    beyond = beyond + r * r;
    v[k] = p;
}

/// AFTER_WHOLE
V g = f + threshold;
g = g - share * (away + wb_size_of(f));
g = g > zero + $tiniest ? g * unit : zero;

/// AFTER_NEAREST
const V h = wb_most(f + threshold, zero);
V g = wb_root(beyond + h * h);
g = g - share * (away + g);
g = g > zero + $tiniest ? g * unit : zero;
$then

/// RADIUS:
/// One for all queries, or one for each.
const float* radius = placement.data;
const int many = placement.shape[0] > 1;

/// STORE_DISTANCES
    if (m == L) *(V*)(out.data + i) = g;
    else for (int l = 0; l < m; ++l) out.data[i + l] = g[l];

/// STORE_ANSWERS
    V r = zero + radius[0];
    if (many) for (int l = 0; l < m; ++l) r[l] = radius[i + l];
    const I maybe = ~(g > r);
    const B bytes = __builtin_convertvector(maybe & 1, B);
    if (m == L) *(B*)(out.data + i) = bytes;
    else for (int l = 0; l < m; ++l) out.data[i + l] = bytes[l];

/// LOCATED
constexpr int N = $n;
const float zero = 0.0f;
float v[N];
#define V float
$locate
#undef V

/// WAY:
/// From the ends a and b of a segment to its way w_ and its length, rounded up.
float w_[$n], square = 0.0f;
for (int k = 0; k < $n; ++k) {
    w_[k] = b[k] - a[k];
    if (k >= $first) square += w_[k] * w_[k];
}
float length = wb_root(square) * $longer + $shortest;
$clocked

/// WAY_OF_TIME:
/// The object moves, too; nothing is known beyond the range of time.
const float speed = center[2 * $n + 5], middle = center[0], half = wb_over(limit[0], time_scale);
length = (length + speed * wb_size_of(w_[0]) * $longer) * $longer;
if (!(wb_size_of(a[0] - middle) <= half && wb_size_of(b[0] - middle) <= half)) length = INFINITY;

/// SPAN:
/// What g must exceed, and from when to when contact is possible.
float size = 0.0f, begins = 0.0f, ends = 1.0f;
for (int k = 0; k < $n; ++k) size += (k < $first ? $speed : 1.0f) * (wb_size_of(a[k]) + wb_size_of(w_[k]));
const int usable = radius >= 0.0f && size < $finite && length < $finite;
const float room = usable ? (radius + size * $blur + $least) * $longer : INFINITY;
for (int k = $first; k < $n && room < $finite; ++k) {
    const float at = center[k], side = limit[k] * unit;
    const float far_ = side + room + ((wb_size_of(at) + side + room) * $sums + $least);
    const float low = at - far_ - a[k], high = at + far_ - a[k];
    if (w_[k] == 0.0f) {
        if (low > 0.0f || high < 0.0f) begins = 2.0f;
        continue;
    }
    const float enter = wb_over(w_[k] < 0.0f ? high : low, w_[k]) * $shorter;
    const float leave = wb_over(w_[k] < 0.0f ? low : high, w_[k]) * $longer;
    begins = enter > begins ? enter : begins;
    ends = leave < ends ? leave : ends;
}

/// WAY_FUNCTION:
/// The proof holds fused or not; not fused, so that a CPU's answers are those of earlier releases.
#if !defined(__CUDA_ARCH__)
#pragma clang fp contract(off)
#endif
$parts
$tools
$way
wp::vec_t<$n + 1, float> line;
for (int k = 0; k < $n; ++k) line[k] = w_[k];
line[$n] = length;
return line;

/// SPAN_FUNCTION
#if !defined(__CUDA_ARCH__)
#pragma clang fp contract(off)
#endif
$parts
$tools
$span
return wp::vec3(room, begins, ends);

/// VALUE:
/// g at q.
V v[N];
$locate
V f;
$body
$after

/// STEP
V q[N];
#pragma unroll
for (int k = 0; k < N; ++k) q[k] = a[k] + w_[k] * t;
$value
const V free_ = g - room;
const V later = (t + wb_over(free_ * $shorter, length)) * $shorter;

/// MARCH
#if !defined(__CUDA_ARCH__)
#pragma clang fp contract(fast)
#endif
constexpr int N = $n, ROW = 2 * N + 4;
$parts
$tools
#if !defined(__CUDA_ARCH__)
$lanes
const V zero = {};
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
    const I on = (free_ > zero) & (later > wb_most(t, zero + $least));
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
typedef float V; typedef int Mask;
const float zero = 0.0f;
const int i = block;
if (i >= count) return;
const float* row = lines.data + (long long)i * ROW;
V a[N], w_[N], t = row[ROW - 2];
#pragma unroll
for (int k = 0; k < N; ++k) { a[k] = row[k]; w_[k] = row[N + k]; }
const V length = row[2 * N], room = row[2 * N + 1], last = row[ROW - 1];
$march_alone
maybe.data[i] = clear ? 0 : 1;
times.data[i] = clear ? 1.0f : t;
#endif

/// MARCH_ALONE:
/// One segment or ray, from t to last.
int clear = t > last;
for (int step = 0; step < steps && !clear; ++step) {
    $scalar_step
    if (!(free_ > 0.0f && later > wb_most(t, $least))) break;
    t = later;
    clear = later >= last;
}

/// TOGETHER:
/// The same by the lanes of a warp together, each with a march of its own, and the next one when that has ended. CUDA only.
#if defined(__CUDA_ARCH__)
typedef float V; typedef int Mask;
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
    const float threshold = tensor[0];  // lowered
    $step
    const bool on = (free_ > zero) & (later > wb_most(t, zero + $least));
    const bool clear = on & (later >= last);
    t = on ? later : t;
    if (who >= 0 && (!on || clear || --left <= 0)) {
        maybe.data[who] = clear ? 0 : 1;
        times.data[who] = clear ? 1.0f : t;
        who = -1;
    }
}
#endif
