// Around a distance: the batch kernel, and the function for other kernels. Names behind $ are filled in by
// kernels/distances.py.

/// PARTS
const float* center = parameters.data + $label;
const float* limit = center + N;
const float scale = center[2 * N], unit = center[2 * N + 1], threshold = center[2 * N + 2], share = center[2 * N + 3];
const float* w = parameters.data + $start;
(void)limit; (void)w;
$clock

/// BEFORE_WHOLE
V away = zero;
#pragma unroll
for (int k = 0; k < N; ++k) {
    v[k] = (q[k] - center[k]) * scale;
    away = away + size_of(v[k]);
}

/// BEFORE_NEAREST
V away = zero, beyond = zero;
#pragma unroll
for (int k = 0; k < N; ++k) {
    v[k] = (q[k] - center[k]) * $scale;
    away = away + size_of(v[k]);
    if ($free) continue;
    const V p = least(most(v[k], zero - limit[k]), zero + limit[k]), r = v[k] - p;
    beyond = beyond + r * r;
    v[k] = p;
}

/// AFTER_WHOLE
V g = f + threshold;
g = g - share * (away + size_of(f));
g = g > zero + $tiniest ? g * unit : zero;

/// AFTER_NEAREST
const V h = most(f + threshold, zero);
V g = root(beyond + h * h);
g = g - share * (away + g);
g = g > zero + $tiniest ? g * unit : zero;
$then

/// LANES
#if defined(__AVX512F__)
constexpr int L = $avx512;
#else
constexpr int L = $other;
#endif
typedef float V __attribute__((vector_size(4 * L), aligned(4), may_alias));
typedef int I __attribute__((vector_size(4 * L)));
typedef int J __attribute__((vector_size(4 * L), aligned(4), may_alias));
typedef unsigned char B __attribute__((vector_size(L), aligned(1), may_alias));
const V zero = {};

/// BATCH
#if !defined(__CUDA_ARCH__)
#pragma clang fp contract(fast)
#endif
constexpr int N = $n, M = N;
$parts
$tools
#if !defined(__CUDA_ARCH__)  // a block of queries, one in each lane
$lanes
const int begin = block * $block, end = begin + $block < count ? begin + $block : count;
for (int i = begin; i < end; i += L) {
    const int m = end - i < L ? end - i : L;
    $read
    $before
    V f;
    $body
    $after
    $store
}
#else  // one query
typedef float V;
const float zero = 0.0f;
const int i = block;
if (i >= count) return;
V q[N], v[N];
#pragma unroll
for (int k = 0; k < N; ++k) q[k] = x.data[(long long)i * N + k];
$before
V f;
$scalar_body
$after
$store_one
#endif

/// WARP:
/// 32 queries and again 32 by the lanes of a warp together: lane 4 g + t has query 8 t + g. CUDA only, whole blocks of
/// threads.
#if defined(__CUDA_ARCH__)
typedef float V;
constexpr int N = $n, M = N;
const float zero = 0.0f;
$parts
$tools
const float* tensor = numbers.data;
for (int from = block / 32 * 32; from < count; from += gridDim.x * blockDim.x) {
    const int i = from + 8 * (block & 3) + (block & 31) / 4;
    const bool own = i < count;
    V q[N], v[N];
#pragma unroll
    for (int k = 0; k < N; ++k) q[k] = x.data[(long long)(own ? i : count - 1) * N + k];
    $before
    V f;
    $body
    const float threshold = tensor[0];
    $after
    if (own) $store_one
}
#endif

/// STORE_ANSWERS
    V r = zero + radius.data[0];
    if (many) for (int l = 0; l < m; ++l) r[l] = radius.data[i + l];
    const I maybe = ~(g > r);
    const B bytes = __builtin_convertvector(maybe & 1, B);
    if (m == L) *(B*)(out.data + i) = bytes;
    else for (int l = 0; l < m; ++l) out.data[i + l] = bytes[l];

/// FUNCTION
#if !defined(__CUDA_ARCH__)
#pragma clang fp contract(fast)
#endif
constexpr int N = $n;
$tools
auto bits = [](float x) { union { float f; unsigned int i; } u; u.f = x; return u.i; };
const float* label = parameters.data;
const unsigned int numbers = parameters.shape[0], fields = words.shape[0];
if (numbers < $label || parameters.strides[0] != sizeof(float) || words.strides[0] != sizeof(unsigned int)) return 0.0f;
if (bits(label[0]) != ${first}u || bits(label[1]) != ${second}u) return 0.0f;  // another function's data
if (numbers < bits(label[2]) || fields < bits(label[3])) return 0.0f;
$parts
float v[N];
const float zero = 0.0f;
#define V float
$before
#undef V
#if !defined(__CUDA_ARCH__)
$function_body
#else
typedef float V;
V f;
$scalar_body
#endif
{
    typedef float V;
    $after
    return g;
}
