"""The C text around the ``body`` of a distance: the batch kernel, and the function for other kernels (see ``source``).

V is a vector of queries, one in each lane, or a float.
"""

from warp_bounding.coordinates.base import literal
from warp_bounding.kernels.assemble import TOOLS, read_rows
from warp_bounding.kernels.distances.source import TINIEST, DistanceSource
from warp_bounding.kernels.source import LABEL, Lanes, fill

__all__ = [
    "AFTER",
    "BEFORE",
    "LANES",
    "PARTS",
    "TOOLS_TOO",
    "batch_snippet",
    "function_snippet",
    "texts_of",
    "warp_snippet",
]

TOOLS_TOO = (
    TOOLS
    + """
#if !defined(__CUDA_ARCH__)
auto size_of = [](auto x) { return __builtin_elementwise_abs(x); };
auto most = [](auto a, auto b) { return __builtin_elementwise_max(a, b); };
auto least = [](auto a, auto b) { return __builtin_elementwise_min(a, b); };
#else
auto size_of = [](float x) { return fabsf(x); };
auto most = [](float a, float b) { return fmaxf(a, b); };
auto least = [](float a, float b) { return fminf(a, b); };
#endif
"""
)

PARTS = """
const float* center = parameters.data + $label;
const float* limit = center + N;
const float scale = center[2 * N], unit = center[2 * N + 1], threshold = center[2 * N + 2], share = center[2 * N + 3];
const float* w = parameters.data + $start;
(void)limit; (void)w;
$clock
"""
CLOCK = {False: "", True: "const float time_scale = center[2 * N + 4];"}

# From q to v, which f is asked of; ``away`` is |v|_1, ``beyond`` the squared way to the domain.
BEFORE = {
    True: """
V away = zero;
#pragma unroll
for (int k = 0; k < N; ++k) {
    v[k] = (q[k] - center[k]) * scale;
    away = away + size_of(v[k]);
}
""",
    False: """
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
""",
}

# From f to g.
AFTER = {
    True: """
V g = f + threshold;
g = g - share * (away + size_of(f));
g = g > zero + $tiniest ? g * unit : zero;
""",
    False: """
const V h = most(f + threshold, zero);
V g = root(beyond + h * h);
g = g - share * (away + g);
g = g > zero + $tiniest ? g * unit : zero;
$then
""",
}
THEN = {False: "", True: "g = size_of(v[0]) > zero + limit[0] ? zero : g;"}

LANES = """
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
"""

_BATCH = """
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
"""

# 32 queries and again 32 by the lanes of a warp together: lane 4 g + t has query 8 t + g. CUDA only, whole blocks of threads.
_WARP = """
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
"""

_STORE = {
    True: "if (m == L) *(V*)(out.data + i) = g; else for (int l = 0; l < m; ++l) out.data[i + l] = g[l];",
    False: """
    V r = zero + radius.data[0];
    if (many) for (int l = 0; l < m; ++l) r[l] = radius.data[i + l];
    const I maybe = ~(g > r);
    const B bytes = __builtin_convertvector(maybe & 1, B);
    if (m == L) *(B*)(out.data + i) = bytes;
    else for (int l = 0; l < m; ++l) out.data[i + l] = bytes[l];
""",
}
_STORE_ONE = {True: "out.data[i] = g;", False: "out.data[i] = !(g > radius.data[many * i]);"}

_FUNCTION = """
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
"""


_AXES = {
    False: {"scale": "scale", "free": "false"},
    True: {"scale": "(k == 0 ? time_scale : scale)", "free": "k == 0"},
}


def texts_of(source: DistanceSource) -> dict[str, object]:
    """What the batch kernel and the function have in common."""
    return {
        "n": source.ndim,
        "label": LABEL,
        "parts": fill(PARTS, label=LABEL, start=source.start, clock=CLOCK[source.time]),
        "tools": TOOLS_TOO,
        "before": fill(BEFORE[source.whole], **_AXES[source.time]),
        "after": fill(AFTER[source.whole], tiniest=literal(TINIEST), then=THEN[source.time]),
        "scalar_body": source.body(Lanes(vector=False)),
    }


def batch_snippet(source: DistanceSource, values: bool) -> str:
    """The body of a batch kernel: distances where ``values``, else 1 where they are not proven to exceed a radius."""
    texts = texts_of(source) | {
        "block": source.block,
        "lanes": fill(LANES, **source.width),
        "read": read_rows(source.ndim, source.width),
        "body": source.body(Lanes(vector=True)),
        "store": _STORE[values],
        "store_one": _STORE_ONE[values],
    }
    return fill(_BATCH, **texts)


def warp_snippet(source: DistanceSource, values: bool, body: str) -> str:
    """The body of a ``warp_kernel``, around C statements from ``V v[]`` to ``V f`` that all lanes of a warp run together."""
    return fill(_WARP, **texts_of(source), store_one=_STORE_ONE[values], body=body)


def function_snippet(source: DistanceSource) -> str:
    """The body of the function for other kernels: a point ``q``; returns g, and 0 for the data of another source."""
    first, second = source.tag
    texts = texts_of(source) | {"function_body": source.function_body(), "first": first, "second": second}
    return fill(_FUNCTION, **texts)
