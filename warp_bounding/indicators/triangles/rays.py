"""Is a point enclosed by triangles for certain? Rays along the axes count what they cross (``cycles.py``).

Every sign is that of the exact number, or it is unknown, and then so is the answer of the ray.
"""

import warp as wp

from warp_bounding.indicators.triangles.arithmetic import largest
from warp_bounding.indicators.triangles.hierarchy import (
    Triangles,
    corner,
    floats_above,
    floats_below,
    next_leaf,
    squared_reach,
)

__all__ = ["is_enclosed"]

# With u = 2^-53. A difference of two products of coordinates, each rounded once, errs by less than 4 u (|left| +
# |right|). A determinant n a, where n is the product of two edges as computed from coordinates up to M, errs by less than
# 80 u M^2 (|e| + |f|), where |e| and |f| are the edges' largest components.
TURN = 2.0**-50
HEIGHT = 2.0**-46
UNDERFLOW = 2.0**-1000  # outweighs products that are subnormal

_TURN = wp.constant(wp.float64(TURN))
_HEIGHT = wp.constant(wp.float64(HEIGHT))
_UNDERFLOW = wp.constant(wp.float64(UNDERFLOW))
_INFINITY = wp.constant(float("inf"))


@wp.func
def _turn(ax: wp.float64, ay: wp.float64, bx: wp.float64, by: wp.float64) -> int:
    """On which side of the line from a to b is 0: 1, -1, or 0 where rounding could have decided?"""
    left, right = ax * by, ay * bx
    room = _TURN * (wp.abs(left) + wp.abs(right)) + _UNDERFLOW
    if left - right > room:
        return 1
    if left - right < -room:
        return -1
    return 0


@wp.func
def _above(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, axis: int, turn: int) -> int:
    """Where a line through 0 along an axis crosses a triangle of this turn: above 0 (1), below it (-1), or unknown (0)?"""
    if wp.min(a[axis], wp.min(b[axis], c[axis])) > wp.float64(0.0):
        return 1
    if wp.max(a[axis], wp.max(b[axis], c[axis])) < wp.float64(0.0):
        return -1
    e, f = b - a, c - a
    height = wp.dot(wp.cross(e, f), a)  # the plane's height over 0, times the triangle's turn
    size = wp.max(largest(a), wp.max(largest(b), largest(c)))
    room = _HEIGHT * size * size * (largest(e) + largest(f)) + _UNDERFLOW
    if height > room:
        return turn
    if height < -room:
        return -turn
    return 0


@wp.func
def _crossing(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, axis: int) -> int:
    """Does the ray from 0 along an axis cross the triangle in its inside (1), does it miss it (0), or unknown (-1)?"""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    ab = _turn(a[i], a[j], b[i], b[j])
    bc = _turn(b[i], b[j], c[i], c[j])
    ca = _turn(c[i], c[j], a[i], a[j])
    least, most = wp.min(ab, wp.min(bc, ca)), wp.max(ab, wp.max(bc, ca))
    if least < 0 and most > 0:
        return 0
    if least == 0 or most == 0:
        return -1
    side = _above(a, b, c, axis, ab)
    if side == 0:
        return -1
    return wp.max(side, 0)


@wp.func
def _crossed_cycles(t: Triangles, x: wp.vec3d, axis: int) -> wp.uint64:
    """The exclusive or of the numbers of triangles that a ray from x along an axis crosses; 0 where that is not certain."""
    lower, upper, reach = floats_below(x), floats_above(x), squared_reach(wp.float64(0.0))
    upper[axis] = _INFINITY
    crossed = wp.uint64(0)
    leaf = next_leaf(t, 0, lower, upper, reach)
    while leaf < t.count:
        link = t.links[leaf]
        for i in range(link[0], link[1]):
            if t.cycles[i] != wp.uint64(0):
                crossing = _crossing(corner(t, i, 0, x), corner(t, i, 1, x), corner(t, i, 2, x), axis)
                if crossing < 0:
                    return wp.uint64(0)
                if crossing > 0:
                    crossed = crossed ^ t.cycles[i]
        leaf = next_leaf(t, leaf + 1, lower, upper, reach)
    return crossed


@wp.func
def is_enclosed(t: Triangles, x: wp.vec3d) -> bool:
    """Is it proven, by rays along the axes, that x is enclosed by the triangles?"""
    for axis in range(3):  # noqa: SIM110 (a kernel has no ``any``)
        if _crossed_cycles(t, x, axis) != wp.uint64(0):
            return True
    return False
