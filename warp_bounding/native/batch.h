// Around a method: the batch kernel, and the function for other kernels. Names behind $ are filled in by
// kernels/functions.py and by ``Source.around``. A part begins behind a line with three slashes and its name.

/// TOOLS:
/// Square roots and quotients as IEEE 754 has them, of floats and of vectors. What ``sqrtf`` and ``/`` are on CUDA is
/// up to the module: they are approximations under its option ``fast_math``, which leaves nothing else in a source to
/// approximate.
#if !defined(__CUDA_ARCH__)
auto wb_root = [](auto x) { return __builtin_elementwise_sqrt(x); };
auto wb_over = [](auto a, auto b) { return a / b; };
#else
auto wb_root = [](float x) { return __fsqrt_rn(x); };
auto wb_over = [](float a, float b) { return __fdiv_rn(a, b); };
#endif

/// PARTS:
/// The parts of ``parameters``.
const float* center = parameters.data + $label;
const float* scale = center + $n;
const float* limit = center + 2 * $n;
const float threshold = center[3 * $n];
const float* extra = center + 3 * $n + 1;
const float* w = parameters.data + $start;
(void)extra; (void)w;

/// LANES:
/// V is a vector of queries, one in each lane.
#if defined(__AVX512F__)
constexpr int L = $avx512;
#else
constexpr int L = $other;
#endif
typedef float V __attribute__((vector_size(4 * L), aligned(4), may_alias));
typedef int I __attribute__((vector_size(4 * L)));
typedef I Mask;
typedef int J __attribute__((vector_size(4 * L), aligned(4), may_alias));
typedef unsigned char B __attribute__((vector_size(L), aligned(1), may_alias));

/// BATCH
#if !defined(__CUDA_ARCH__)  // a block of queries, one in each lane
#pragma clang fp contract(fast)
$lanes
constexpr int N = $columns, M = $coordinates;  // numbers of a query, and those that f takes
const V zero = {};
$parts
$place
$tools
const int begin = block * $block, end = begin + $block < count ? begin + $block : count;
$loop
#else
$on_cuda
#endif

/// ONE:
/// One query, on CUDA.
typedef float V; typedef int Mask;
constexpr int N = $columns, M = $coordinates;
const float zero = 0.0f;
$parts
$place
$tools
const int i = block;
if (i >= count) return;
auto& answer = out.data[i];
V q[N], v[M];
#pragma unroll
for (int k = 0; k < N; ++k) q[k] = x.data[(long long)i * N + k];
$locate
$outside
V f;
$scalar_body
$answer

/// SEVERAL:
/// L queries of a thread, on CUDA: each number that the body loads serves all of them. Neighbouring threads take
/// neighbouring queries, and each its next one 32 queries on; whole warps.
constexpr int N = $columns, M = $coordinates, L = $several;
const float zero = 0.0f;
$parts
$place
$tools
struct Floats {
    float lane[L];
    __device__ float& operator[](int l) { return lane[l]; }
    __device__ void operator+=(Floats x) { for (int l = 0; l < L; ++l) lane[l] += x[l]; }
    __device__ Floats operator+(float x) const { Floats y; for (int l = 0; l < L; ++l) y[l] = lane[l] + x; return y; }
    __device__ Floats operator*(float x) const { Floats y; for (int l = 0; l < L; ++l) y[l] = lane[l] * x; return y; }
};
const int first = block / 32 * 32 * L + block % 32;
Floats together[M], found = {};  // read below even where nothing is asked
bool any = false;
#pragma unroll
for (int l = 0; l < L; ++l) {
    $query
    any |= $asked;
#pragma unroll
    for (int k = 0; k < M; ++k) together[k][l] = v[k];
}
if (any) {
    typedef Floats V;
    V* v = together;
    V f;
    $several_body
    found = f;
}
decltype(+out.data[0]) answers[L];  // stored behind the loop, so that nothing need be loaded again in it
#pragma unroll
for (int l = 0; l < L; ++l) {
    $query
    const V f = found[l];
    auto& answer = answers[l];
    $own_answer
}
#pragma unroll
for (int l = 0; l < L; ++l) if (first + 32 * l < count) out.data[first + 32 * l] = answers[l];

/// QUERY
const int i = first + 32 * l;
const bool own = i < count;
typedef float V; typedef int Mask;
V q[N], v[M];
#pragma unroll
for (int k = 0; k < N; ++k) q[k] = x.data[(long long)(own ? i : count - 1) * N + k];
$locate

/// WARP:
/// 32 queries and again 32, by the lanes of a warp together: lane 4 g + t has query 8 t + g. CUDA, whole blocks of
/// threads.
#if defined(__CUDA_ARCH__)
typedef float V; typedef int Mask;
constexpr int N = $columns, M = $coordinates;
const float zero = 0.0f;
$parts
$place
$tools
for (int from = block / 32 * 32; from < count; from += gridDim.x * blockDim.x) {
    const int i = from + 8 * (block & 3) + (block & 31) / 4;
    const bool own = i < count;
    V q[N], v[M];
#pragma unroll
    for (int k = 0; k < N; ++k) q[k] = x.data[(long long)(own ? i : count - 1) * N + k];
    $locate
    const bool asked = $asked;
    const float* tensor = numbers.data;
    const float threshold = tensor[0];  // lowered
    V f = zero;
    if (__any_sync(0xffffffffu, asked)) {
        $body
    }
    auto& answer = out.data[own ? i : 0];
    $own_answer
}
#endif

/// ALL:
/// Every query is asked, also those outside the domain: for bodies that cost less than to look which those are.
for (int i = begin; i < end; i += L) {
    const int m = end - i < L ? end - i : L;
    $read
    $locate
    V f;
    $body
    $answers
}

/// STORE_ANSWERS
    const I answer = ~(testable & (~inside | (f < threshold)));
    const B bytes = __builtin_convertvector(answer & 1, B);
    if (m == L) *(B*)(out.data + i) = bytes;
    else for (int l = 0; l < m; ++l) out.data[i + l] = bytes[l];

/// GATHERED:
/// Those inside the domain are held together first, ``held[k]`` their coordinates and ``where`` their places; early
/// tests then take away what they decide, and the body is asked of the rest.
float held[M][$block + L];
int where[$block + L], kept = 0;
for (int i = begin; i < end; i += L) {
    const int m = end - i < L ? end - i : L;
    $read
    $locate
    const I go = inside & testable;
    int going = 0;
    $unasked
    if (going == L && m == L) {  // all inside: no need to look at them one by one
        for (int l = 0; l < L; ++l) where[kept + l] = i + l;
#pragma unroll
        for (int k = 0; k < M; ++k) *(V*)(held[k] + kept) = v[k];
        kept += L;
    } else if (going) {
        for (int l = 0; l < m; ++l) {
            where[kept] = i + l;
#pragma unroll
            for (int k = 0; k < M; ++k) held[k][kept] = v[k][l];
            kept -= go[l];
        }
    }
}
auto end_of_held = [&]() {  // lanes behind the last one ask something finite
    for (int l = kept; l < kept + L; ++l) for (int k = 0; k < M; ++k) held[k][l] = 0.0f;
};
end_of_held();
$early
for (int g = 0; g < kept; g += L) {
    V v[M];
#pragma unroll
    for (int k = 0; k < M; ++k) v[k] = *(const V*)(held[k] + g);
    V f;
    $body
    const int m = kept - g < L ? kept - g : L;
    for (int l = 0; l < m; ++l) out.data[where[g + l]] = $lane_decision;
}

/// UNASKED_ANSWERS:
/// Answers to queries that are not testable or not inside; the others' are overwritten.
    const B maybe = __builtin_convertvector(~testable & 1, B);
    for (int l = 0; l < L; ++l) going -= go[l];
    if (m == L) *(B*)(out.data + i) = maybe;
    else for (int l = 0; l < m; ++l) out.data[i + l] = maybe[l];

/// UNASKED_VALUES
    for (int l = 0; l < m; ++l) {
        out.data[i + l] = testable[l] ? -INFINITY : INFINITY;
        going -= go[l];
    }

/// EARLY
{
    int stay = 0;
    for (int g = 0; g < kept; g += L) {
        V v[M];
#pragma unroll
        for (int k = 0; k < M; ++k) v[k] = *(const V*)(held[k] + g);
        V f;
        $test
        const I no = f < $bar;
        const int m = kept - g < L ? kept - g : L;
        int passes[L], pick[L], n = 0;  // in memory: lanes of a vector are dear one by one
        *(J*)passes = no + 1;
        $answer
        for (int l = 0; l < m; ++l) { pick[n] = g + l; n += passes[l]; }
        for (int l = 0; l < n; ++l) {
            const int from = pick[l];
            where[stay + l] = where[from];
#pragma unroll
            for (int k = 0; k < M; ++k) held[k][stay + l] = held[k][from];
        }
        stay += n;
    }
    kept = stay;
    end_of_held();
}

/// READ:
/// Queries i .. i + L - 1, the last one again behind the end. Rows of N numbers become N vectors by shuffles: number k
/// of query l stands at ``l N + k``, in the vector of that over L.
V q[N], v[M];
if (m == L) {
    const float* rows = x.data + (long long)i * N;
    V r[N];
#pragma unroll
    for (int b = 0; b < N; ++b) r[b] = *(const V*)(rows + b * L);
#if defined(__AVX512F__)
    $avx512
#else
    $other
#endif
} else {
    for (int l = 0; l < L; ++l) {
        const int j = i + l < end ? i + l : end - 1;
#pragma unroll
        for (int k = 0; k < N; ++k) q[k][l] = x.data[(long long)j * N + k];
    }
}

/// LOCATED:
/// In a function: the coordinates, unless the answer is known without them.
float v[$coordinates];
int asked, held;
{
    typedef float V; typedef int Mask;
    const float zero = 0.0f;
    $numbers
    $locate
    asked = testable;
    held = inside;
}
if (!asked) return 1;
if (!held) return 0;

/// FUNCTION
#if !defined(__CUDA_ARCH__)
#pragma clang fp contract(fast)
#endif
$tools
auto bits = [](float x) { union { float f; unsigned int i; } u; u.f = x; return u.i; };
const float* label = parameters.data;
const unsigned int numbers = parameters.shape[0], fields = words.shape[0];
if (numbers < $label || parameters.strides[0] != sizeof(float) || words.strides[0] != sizeof(unsigned int)) return $unknown;
if (bits(label[0]) != ${first}u || bits(label[1]) != ${second}u) return $unknown;  // another function's data
if (numbers < bits(label[2]) || fields < bits(label[3])) return $unknown;
$parts
$located
#if !defined(__CUDA_ARCH__)
$function_body
$returned
#else
typedef float V; typedef int Mask;
V f;
$scalar_body
$returned
#endif
