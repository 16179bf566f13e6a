"""The C text of ``f`` for points, rays and boxes against free half-spaces; planes are tested as against slabs."""

from warp_bounding.bounders.slabs.native import CORNERS
from warp_bounding.coordinates.base import GUARD, PARALLEL

__all__ = ["TEXTS"]

_POINT = """
{
    constexpr int N = $n, K = $half_spaces;
    const V none = {};
    f = none + 3.0e38f;
#pragma unroll
    for (int i = 0; i < K; ++i) {
        const float* a = w + K + i * N;
        V height = v[0] * a[0];
#pragma unroll
        for (int j = 1; j < N; ++j) height = height + v[j] * a[j];
        const V y = w[i] - height;
        f = y < f ? y : f;
    }
}
"""

# A face along which a ray may run is ``ROOM`` away, so there is no division by zero.
_RAY = f"""
{{
    constexpr int N = $n, K = $half_spaces;
    const V none = {{}};
    V come = none, gone = none + 1.0f;
#pragma unroll
    for (int i = 0; i < K; ++i) {{
        const float* a = w + K + i * N;
        V y = v[0] * a[0], s = v[N] * a[0];
#pragma unroll
        for (int j = 1; j < N; ++j) {{
            y = y + v[j] * a[j];
            s = s + v[N + j] * a[j];
        }}
        const V speed = s < none ? -s : s;
        const V cross = speed > {PARALLEL.hex()}f ? s : none + {PARALLEL.hex()}f;
        const V at = over(w[i] - y, cross);
        const V first = cross < none ? at : none, last = cross < none ? none + 1.0f : at;
        come = first > come ? first : come;
        gone = last < gone ? last : gone;
    }}
    f = come <= gone + {GUARD.hex()}f ? none : none - 1.0f;
}}
"""

_BOX = """
{
    constexpr int N = $n, K = $half_spaces;
    const V none = {};
    f = none + 3.0e38f;
#pragma unroll
    for (int i = 0; i < K; ++i) {
        const float* a = w + K + i * N;
        V corner = (a[0] < 0.0f ? v[N] : v[0]) * a[0];
#pragma unroll
        for (int j = 1; j < N; ++j) corner = corner + (a[j] < 0.0f ? v[N + j] : v[j]) * a[j];
        const V y = w[i] - corner;
        f = y < f ? y : f;
    }
}
"""

TEXTS = {"point": _POINT, "ray": _RAY, "plane": CORNERS, "box": _BOX}
