"""What rays and planes share: a point given from any distance, and a direction that has no length of its own.

Where a ray or a plane is moved from the world, so are its point and its direction; the numbers ``drift`` of a placement
say what the move rounds per distance, and widen the domain for one from farther away than ``FAR``.
"""

from functools import cache

import numpy as np
import warp as wp

from warp_bounding.arithmetic import gamma
from warp_bounding.coordinates.base import FAR, LARGEST, SMALLEST, Numbers, literal, vector_type
from warp_bounding.coordinates.domain import Domain, input_rounding
from warp_bounding.runtime.native import named

__all__ = [
    "FAR_POINT",
    "MOVING",
    "UNIT",
    "origin_rounding",
    "plain_local",
    "plain_move_pair",
    "plain_sized",
    "plain_unit",
]

# The largest entry of a direction, and whether it has a size that directions may have.
POSSIBLE = f"""
const auto largest = [&](const V* e) {{
    V most = zero;
    for (int k = 0; k < AXES; ++k) {{
        const V size = e[k] < zero ? -e[k] : e[k];
        most = size > most ? size : most;
    }}
    return most;
}};
const auto possible = [&](V most) {{ return (most >= zero + {literal(SMALLEST)}) & (most <= zero + {literal(LARGEST)}); }};
"""

# The point at q + POINT in local space: a, |a|, and the sum of these; how far that is where a placed one is beyond FAR.
FAR_POINT = f"""
V a[AXES], size[AXES], far = zero;
for (int k = 0; k < AXES; ++k) {{
    a[k] = (q[POINT + k] - center[k]) * scale[k];
    size[k] = a[k] < zero ? -a[k] : a[k];
    far = far + size[k];
}}
const V wide = far > {literal(FAR)} ? far : zero;
"""

# u, the direction at q + TURN with Euclidean length 1; it is none where it is too short or too long.
UNIT = (
    POSSIBLE
    + """
V longest = largest(q + TURN), u[AXES];
finite = finite & possible(longest);
longest = longest > zero ? longest : zero + 1.0f;  // no division by zero in lanes that are maybe
for (int k = 0; k < AXES; ++k) u[k] = over(q[TURN + k], longest);
V squares = u[0] * u[0];
for (int k = 1; k < AXES; ++k) squares = squares + u[k] * u[k];
const V norm = root(squares);
for (int k = 0; k < AXES; ++k) u[k] = over(u[k], norm);
"""
)

# The point by the matrix at place + AXES, the direction by the one at place + TURNED; a direction that is nearly as short as
# rounding is answered with maybe.
MOVING = (
    POSSIBLE
    + """
V d[AXES], e[AXES];
for (int k = 0; k < AXES; ++k) d[k] = q[POINT + k] - place[k], e[k] = q[TURN + k];
finite = finite & possible(largest(e));
for (int k = 0; k < AXES; ++k) {
    V moved = d[0] * place[AXES + AXES * k], turned = e[0] * place[TURNED + AXES * k];
    for (int j = 1; j < AXES; ++j) {
        moved = moved + d[j] * place[AXES + AXES * k + j];
        turned = turned + e[j] * place[TURNED + AXES * k + j];
    }
    q[POINT + k] = moved, q[TURN + k] = turned;
}
finite = finite & possible(largest(q + TURN));
for (int k = 0; k < 2 * AXES; ++k) finite = finite & ((q[k] - q[k]) == zero);  // an overflow
"""
)


def origin_rounding(base: Domain) -> np.ndarray:
    """``(n,)``: error of a point within FAR half-widths, given in float64, in local space."""
    extent = np.full(base.ndim, FAR * (1 + gamma(4)))
    around = extent / base.scale.astype(np.float64)
    return input_rounding(base.center, base.scale, extent, base.center - around, base.center + around)


@cache
def plain_sized(n: int) -> wp.Function:
    """The twin of ``POSSIBLE``, of the direction at an index of q."""
    pair = vector_type(2 * n)

    @named(f"wb_plain_sized_{n}").func
    def sized(q: pair, first: int) -> bool:
        """Whether the direction at ``q[first]`` has a size that directions may have."""
        longest = wp.float32(0.0)
        for k in range(n):
            longest = wp.max(longest, wp.abs(q[first + k]))
        return longest >= SMALLEST and longest <= LARGEST

    return sized


@cache
def plain_unit(n: int) -> wp.Function:
    """The twin of ``UNIT``."""
    pair, vector = vector_type(2 * n), vector_type(n)

    @named(f"wb_plain_unit_{n}").func
    def unit(q: pair, first: int) -> vector:
        """The direction at ``q[first]`` with Euclidean length 1."""
        u, longest, norm = vector(), wp.float32(0.0), wp.float32(0.0)
        for k in range(n):
            longest = wp.max(longest, wp.abs(q[first + k]))
        for k in range(n):
            u[k] = q[first + k] / longest
            norm += u[k] * u[k]
        for k in range(n):
            u[k] = u[k] / wp.sqrt(norm)
        return u

    return unit


@cache
def plain_local(n: int, front: int) -> wp.Function:
    """The twin of ``FAR_POINT``."""
    pair, vector = vector_type(2 * n), vector_type(n)

    @named(f"wb_plain_local_{n}_{front}").func
    def local(p: Numbers, q: pair, first: int):
        """The point at ``q[first]`` in local space, and the sum of its absolute values."""
        a, far = vector(), wp.float32(0.0)
        for k in range(n):
            a[k] = (q[first + k] - p[front + k]) * p[front + n + k]
            far += wp.abs(a[k])
        return a, far

    return local


@cache
def plain_move_pair(n: int, point: int, turn: int, matrix: int) -> wp.Function:
    """The twin of ``MOVING``: where the point and the direction stand in q, and the direction's matrix in place."""
    pair, sized = vector_type(2 * n), plain_sized(n)

    @named(f"wb_plain_move_{point}_{n}").func
    def move(place: Numbers, q: pair):
        """The point at ``q[point]``, and the direction at ``q[turn]`` by the matrix at ``place[matrix]``."""
        x, finite = pair(), wp.bool(True)
        for k in range(n):
            for j in range(n):
                x[point + k] += (q[point + j] - place[j]) * place[n + n * k + j]
                x[turn + k] += q[turn + j] * place[matrix + n * k + j]
        for k in range(2 * n):
            finite = finite and wp.isfinite(x[k])
        return x, finite and sized(q, turn) and sized(x, turn)

    return move
