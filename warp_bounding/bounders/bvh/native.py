"""The C text of the walk through the hierarchy: of lanes together, or of one query alone; and what each kind of query asks of a node."""

from warp_bounding.bounders.slabs.native import CLIP
from warp_bounding.coordinates.base import GUARD

__all__ = ["ALONE", "TOGETHER", "TOUCHES"]

_NODE = """
        const float* b = w + $leading + i * (2 * N + 1);  // low, high, past
        const int past = (int)b[2 * N];
        $touches
"""

ALONE = f"""
{{
    constexpr int N = $n;
    const V none = 0.0f;
    $prepare
    const int count = (int)w[0];
    int i = 0;
    f = -1.0f;
    while (i < count) {{
        {_NODE}
        if (hit && past == i + 1) {{ f = 0.0f; break; }}  // a leaf
        i = hit ? i + 1 : past;
    }}
}}
"""

# A lane waits until the walk is at its next node; it is done where that is the end.
TOGETHER = f"""
{{
    constexpr int N = $n;
    const V none = {{}};
    $prepare
    const int count = (int)w[0];
    int i = 0;
    I next = {{}}, found = {{}};
    while (i < count) {{
        {_NODE}
        hit = hit & (next <= i);
        if (past == i + 1) {{  // a leaf
            found = found | hit;
            next = hit ? (next & 0) + count : next;
            i = past;
            if (__builtin_reduce_and(found)) break;
        }} else {{
            next = ((next <= i) & ~hit) ? (next & 0) + past : next;
            i = __builtin_reduce_or(hit) ? i + 1 : past;
        }}
    }}
    f = found ? none : none - 1.0f;
}}
"""

_POINT = "(v[{k}] >= b[{k}]) & (v[{k}] <= b[N + {k}])"  # of axis k
_BOX = "(v[N + {k}] >= b[{k}]) & (v[{k}] <= b[N + {k}])"

_SIGNS = """
    V plus[N], minus[N];
#pragma unroll
    for (int k = 0; k < N; ++k) {
        plus[k] = v[k] > none ? v[k] : none;
        minus[k] = v[k] - plus[k];
    }
    const V under = v[N] - w[1], above = v[N] + w[1];
"""

_PLANE = """
        V most = plus[0] * b[N] + minus[0] * b[0], least = plus[0] * b[0] + minus[0] * b[N];
#pragma unroll
        for (int k = 1; k < N; ++k) {
            most = most + (plus[k] * b[N + k]) + (minus[k] * b[k]);
            least = least + (plus[k] * b[k]) + (minus[k] * b[N + k]);
        }
        auto hit = (under <= most) & (above >= least);
"""

_SPEEDS = f"""
    {CLIP}
    V slow[N];
#pragma unroll
    for (int k = 0; k < N; ++k) slow[k] = slow_of(v[N + k]);
"""

_RAY = f"""
        enter = none;
        leave = none + 1.0f;
#pragma unroll
        for (int k = 0; k < N; ++k) clip(b[k], b[N + k], v[k], slow[k]);
        auto hit = enter <= leave + {GUARD.hex()}f;
"""


def _along(n: int, axis: str) -> str:
    """C text of a test of all axes in one expression, which compiles to less than a loop does."""
    return f"auto hit = {' & '.join(axis.format(k=k) for k in range(n))};"


# What is done before the walk, and at a node, in n dimensions.
TOUCHES = {
    "point": lambda n: ("", _along(n, _POINT)),
    "ray": lambda n: (_SPEEDS, _RAY),
    "plane": lambda n: (_SIGNS, _PLANE),
    "box": lambda n: ("", _along(n, _BOX)),
}
