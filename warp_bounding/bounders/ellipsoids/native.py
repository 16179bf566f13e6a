"""The C text of ``f`` of ellipsoids, for points and for each kind of region."""

from warp_bounding.kernels.source import Source

__all__ = ["SMALLEST", "SWEEPS", "TEXTS"]

SMALLEST = 2.0**-80  # of |A w|^2: a segment as short as that counts as its origin
SWEEPS = 2  # of coordinate descent over a box

_CONSTANTS = """
    constexpr int N = $n;
    constexpr bool DIAGONAL = $diagonal;
    const V none = {};
"""


def _row(y: str, at: str) -> str:
    """C text of ``y``, the product of row i of A (numbers at ``a``) with the vector at ``v[at]``."""
    return f"""
        V {y} = DIAGONAL ? v[{at} + i] * w[N + i] : v[{at}] * a[0];
#pragma unroll
        for (int j = 1; j < N && !DIAGONAL; ++j) {y} = {y} + v[{at} + j] * a[j];
"""


_POINT = f"""
{{
    {_CONSTANTS}
    f = v[0] * 0.0f;
#pragma unroll
    for (int i = 0; i < N; ++i) {{
        const float* a = w + N + i * N;
        {_row("y", "0")}
        y = y + w[i];
        f = f - y * y;
    }}
}}
"""

_RAY = f"""
{{
    {_CONSTANTS}
    V origin[N], speed[N];
#pragma unroll
    for (int i = 0; i < N; ++i) {{
        const float* a = w + N + i * N;
        {_row("y", "0")}
        {_row("s", "N")}
        origin[i] = y + w[i];
        speed[i] = s;
    }}
    V towards = origin[0] * speed[0], length = speed[0] * speed[0];
#pragma unroll
    for (int i = 1; i < N; ++i) towards = towards + origin[i] * speed[i];
#pragma unroll
    for (int i = 1; i < N; ++i) length = length + speed[i] * speed[i];
    const V along = -towards;
    V t = over(along, length > {SMALLEST.hex()}f ? length : none + 1.0f);
    t = t < none ? none : t;
    t = t > 1.0f ? none + 1.0f : t;
    t = length > {SMALLEST.hex()}f ? t : none;
    f = none;
#pragma unroll
    for (int i = 0; i < N; ++i) {{
        const V z = origin[i] + t * speed[i];
        f = f - z * z;
    }}
}}
"""

_PLANE = f"""
{{
    {_CONSTANTS}
    V foot = v[0] * w[0];
#pragma unroll
    for (int j = 1; j < N; ++j) foot = foot + v[j] * w[j];
    const V off = v[N] - foot;
    V length = none;
#pragma unroll
    for (int i = 0; i < N; ++i) {{
        const float* a = w + N + i * N;
        {_row("g", "0")}
        length = length + g * g;
    }}
    f = over(-(off * off), length);
}}
"""

_INTERVALS = """
{
    constexpr int N = $n;
    const V none = {};
    f = none;
#pragma unroll
    for (int i = 0; i < N; ++i) {
        const V a = v[i] * w[N + i] + w[i], b = v[N + i] * w[N + i] + w[i];
        const V low = a < b ? a : b, high = a < b ? -b : -a;
        V z = low > high ? low : high;
        z = z < none ? none : z;
        f = f - z * z;
    }
}
"""

_DESCENT = f"""
{{
    constexpr int N = $n;
    const V none = {{}};
    const float* a = w + N;
    const float *step = a + N * N, *start = step + N;
    V y[N], z[N];
#pragma unroll
    for (int j = 0; j < N; ++j) {{
        y[j] = v[j] > start[j] ? v[j] : none + start[j];
        y[j] = y[j] > v[N + j] ? v[N + j] : y[j];
    }}
#pragma unroll
    for (int i = 0; i < N; ++i) {{
        z[i] = y[0] * a[i * N];
#pragma unroll
        for (int j = 1; j < N; ++j) z[i] = z[i] + y[j] * a[i * N + j];
        z[i] = z[i] + w[i];
    }}
#pragma unroll
    for (int sweep = 0; sweep < {SWEEPS}; ++sweep) {{
#pragma unroll
        for (int j = 0; j < N; ++j) {{
            V slope = z[0] * a[j];
#pragma unroll
            for (int i = 1; i < N; ++i) slope = slope + z[i] * a[i * N + j];
            V to = y[j] - slope * step[j];
            to = to < v[j] ? v[j] : to;
            to = to > v[N + j] ? v[N + j] : to;
            const V by = to - y[j];
            y[j] = to;
#pragma unroll
            for (int i = 0; i < N; ++i) z[i] = z[i] + by * a[i * N + j];
        }}
    }}
    V length = z[0] * z[0], least = z[0] * w[0];
#pragma unroll
    for (int i = 1; i < N; ++i) length = length + z[i] * z[i];
#pragma unroll
    for (int i = 1; i < N; ++i) least = least + z[i] * w[i];
#pragma unroll
    for (int j = 0; j < N; ++j) {{
        V m = z[0] * a[j];
#pragma unroll
        for (int i = 1; i < N; ++i) m = m + z[i] * a[i * N + j];
        const V low = m * v[j], high = m * v[N + j];
        least = least + (low < high ? low : high);
    }}
    least = least < none ? none : least;
    least = length > {SMALLEST.hex()}f ? least : none;
    f = over(-(least * least), length > {SMALLEST.hex()}f ? length : none + 1.0f);
}}
"""


def _box(source: Source) -> str:
    """Row by row where A is diagonal, else by coordinate descent."""
    return _INTERVALS if source.diagonal else _DESCENT


TEXTS = {"point": _POINT, "ray": _RAY, "plane": _PLANE, "box": _box}
