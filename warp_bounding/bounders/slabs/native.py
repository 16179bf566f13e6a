"""The C text of ``f`` of slabs, for points and for each kind of region."""

from warp_bounding.coordinates.base import GUARD, PARALLEL
from warp_bounding.kernels.source import Source

__all__ = ["CLIP", "CORNERS", "TEXTS"]


def _row(y: str, at: str) -> str:
    """C text of ``y``, the product of direction i (numbers at ``d``) with the point at ``v[at]``."""
    return f"""
        V {y} = DIAGONAL ? v[{at} + i % N] : v[{at}] * d[0];
#pragma unroll
        for (int j = 1; j < N && !DIAGONAL; ++j) {y} = {y} + v[{at} + j] * d[j];
"""


# Slab clipping without a division by zero: a face that may be met is at least ``ROOM / 2`` away from a ray that runs along it, so the
# parameters at which a speed of ``PARALLEL`` meets the faces lie outside [0, 1] as they should.
CLIP = f"""
auto slow_of = [&](V s) {{  // one over the speed
    const V none = {{}};
    const V speed = s < none ? -s : s;
    const V cross = speed > {PARALLEL.hex()}f ? s : none + {PARALLEL.hex()}f;
    return over(none + 1.0f, cross);
}};
V enter = {{}}, leave = enter + 1.0f;
auto clip = [&](float low, float high, V y, V slow) {{  // y + t s lies in [low, high] between two parameters
    const V one = (low - y) * slow, two = (high - y) * slow;
    const V near = one < two ? one : two, away = one < two ? two : one;
    enter = near > enter ? near : enter;
    leave = away < leave ? away : leave;
}};
"""

_CONSTANTS = """
    constexpr int N = $n, K = $slabs;
    constexpr bool DIAGONAL = $diagonal;
    const V none = {};
"""

_POINT = f"""
{{
    {_CONSTANTS}
    f = none + 3.0e38f;
#pragma unroll
    for (int i = 0; i < K; ++i) {{
        const float* d = w + 2 * K + i * N;
        {_row("y", "0")}
        const V a = y - w[i], b = w[K + i] - y, c = a < b ? a : b;
        f = c < f ? c : f;
    }}
}}
"""

_RAY = f"""
{{
    {_CONSTANTS}
    {CLIP}
#pragma unroll
    for (int i = 0; i < K; ++i) {{
        const float* d = w + 2 * K + i * N;
        {_row("y", "0")}
        {_row("s", "N")}
        clip(w[i], w[K + i], y, slow_of(s));
    }}
    f = enter <= leave + {GUARD.hex()}f ? none : none - 1.0f;
}}
"""

_EDGES = f"""
{{
    {_CONSTANTS}
    V foot = v[0] * w[0];
#pragma unroll
    for (int j = 1; j < N; ++j) foot = foot + v[j] * w[j];
    V off = v[N] - foot;
    off = off < none ? -off : off;
    V reach = none;
#pragma unroll
    for (int i = 0; i < N; ++i) {{
        const float* d = w + N + i * N;
        V y = DIAGONAL ? v[i] * w[N + i] : v[0] * d[0];
#pragma unroll
        for (int j = 1; j < N && !DIAGONAL; ++j) y = y + v[j] * d[j];
        reach = reach + (y < none ? -y : y);
    }}
    f = reach - off;
}}
"""

CORNERS = """
{
    constexpr int N = $n;
    const V none = {};
    const int corners = (int)w[0];
    V most = none - 3.0e38f, least = none + 3.0e38f;
    for (int i = 0; i < corners; ++i) {
        const float* at = w + 1 + i * N;
        V y = v[0] * at[0];
#pragma unroll
        for (int j = 1; j < N; ++j) y = y + v[j] * at[j];
        most = y > most ? y : most;
        least = y < least ? y : least;
    }
    most = most - v[N];
    least = v[N] - least;
    f = most < least ? most : least;
}
"""

_BOX = f"""
{{
    {_CONSTANTS}
    f = none + 3.0e38f;
    V middle[N], half[N];
#pragma unroll
    for (int j = 0; j < N; ++j) {{
        middle[j] = (v[j] + v[N + j]) * 0.5f;
        half[j] = (v[N + j] - v[j]) * 0.5f;
    }}
#pragma unroll
    for (int i = 0; i < K; ++i) {{
        V a = v[i % N], b = v[N + i % N];
        if (!DIAGONAL) {{
            const float* d = w + 2 * K + i * N;
            V y = middle[0] * d[0], r = half[0] * (d[0] < 0.0f ? -d[0] : d[0]);
#pragma unroll
            for (int j = 1; j < N; ++j) {{
                y = y + middle[j] * d[j];
                r = r + half[j] * (d[j] < 0.0f ? -d[j] : d[j]);
            }}
            a = y - r;
            b = y + r;
        }}
        const V c = b - w[i], e = w[K + i] - a, overlap = c < e ? c : e;
        f = overlap < f ? overlap : f;
    }}
}}
"""


def _plane(source: Source) -> str:
    """Of a parallelepiped by its edges, of other polytopes by their vertices."""
    return CORNERS if source.slabs > source.ndim else _EDGES


TEXTS = {"point": _POINT, "ray": _RAY, "plane": _plane, "box": _BOX}
