"""Is a point enclosed by triangles for certain? Rays along the axes count what they cross (``cycles.py``).

Where faces are turned alike, so that each edge is run through as often one way as the other, the crossings with their signs add up to the
winding number of the surface around the point, the same along every ray.

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

__all__ = ["UNWOUND", "crossing", "is_enclosed", "winding"]

UNWOUND = 2**30  # instead of a winding number that is not certain

# With u = 2^-53. A difference of two products of coordinates, each rounded once, errs by less than 4 u (|left| +
# |right|). A determinant n a, where n is the product of two edges as computed from coordinates up to M, errs by less than
# 80 u M^2 (|e| + |f|), where |e| and |f| are the edges' largest components. Of coordinates that are known up to a length
# L only, the difference errs by another L (sum of their absolute values + 2 L), and the determinant, the edges of which
# err by 2 L, by less than 18 L (M + L) (|e| + |f| + 8 L). What is added for that is more than 3 times as much.
TURN = 2.0**-50
HEIGHT = 2.0**-46
UNDERFLOW = 2.0**-1000  # outweighs products that are subnormal

_TURN = wp.constant(wp.float64(TURN))
_HEIGHT = wp.constant(wp.float64(HEIGHT))
_UNDERFLOW = wp.constant(wp.float64(UNDERFLOW))
_MORE, _LOOSE = wp.constant(wp.float64(8.0)), wp.constant(wp.float64(64.0))
_INFINITY = wp.constant(float("inf"))
_UNWOUND = wp.constant(UNWOUND)


@wp.func
def _turn(ax: wp.float64, ay: wp.float64, bx: wp.float64, by: wp.float64, loose: wp.float64) -> int:
    """On which side of the line from a to b is 0: 1, -1, or 0 where rounding could have decided?"""
    left, right = ax * by, ay * bx
    size = wp.abs(ax) + wp.abs(ay) + wp.abs(bx) + wp.abs(by)
    room = _TURN * (wp.abs(left) + wp.abs(right)) + _MORE * loose * (size + _MORE * loose) + _UNDERFLOW
    if left - right > room:
        return 1
    if left - right < -room:
        return -1
    return 0


@wp.func
def _above(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, axis: int, turn: int, loose: wp.float64) -> int:
    """Where a line through 0 along an axis crosses a triangle of this turn: above 0 (1), below it (-1), or unknown (0)?"""
    if wp.min(a[axis], wp.min(b[axis], c[axis])) > loose:
        return 1
    if wp.max(a[axis], wp.max(b[axis], c[axis])) < -loose:
        return -1
    e, f = b - a, c - a
    height = wp.dot(wp.cross(e, f), a)  # the plane's height over 0, times the triangle's turn
    size = wp.max(largest(a), wp.max(largest(b), largest(c))) + loose
    edges = largest(e) + largest(f)
    room = _HEIGHT * size * size * edges + _LOOSE * loose * size * (edges + _MORE * loose) + _UNDERFLOW
    if height > room:
        return turn
    if height < -room:
        return -turn
    return 0


@wp.func
def crossing(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, axis: int, loose: wp.float64) -> int:
    """Does the ray from 0 along an axis cross the triangle in its inside (1), does it miss it (0), or unknown (-1)?

    Args:
        a: A corner, each coordinate rounded once.
        b: Another one.
        c: Another one.
        axis: 0, 1 or 2; the ray goes upwards.
        loose: By how much each coordinate may be wrong beyond that; the answer holds for all that they may be.
    """
    i, j = (axis + 1) % 3, (axis + 2) % 3
    ab = _turn(a[i], a[j], b[i], b[j], loose)
    bc = _turn(b[i], b[j], c[i], c[j], loose)
    ca = _turn(c[i], c[j], a[i], a[j], loose)
    least, most = wp.min(ab, wp.min(bc, ca)), wp.max(ab, wp.max(bc, ca))
    if least < 0 and most > 0:
        return 0
    if least == 0 or most == 0:
        return -1
    side = _above(a, b, c, axis, ab, loose)
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
                a, b, c = corner(t, i, 0, x), corner(t, i, 1, x), corner(t, i, 2, x)
                crosses = crossing(a, b, c, axis, wp.float64(0.0))
                if crosses < 0:
                    return wp.uint64(0)
                if crosses > 0:
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


@wp.func
def _winding_along(t: Triangles, x: wp.vec3d, axis: int) -> int:
    lower, upper, reach = floats_below(x), floats_above(x), squared_reach(wp.float64(0.0))
    upper[axis] = _INFINITY
    i, j, found = (axis + 1) % 3, (axis + 2) % 3, wp.int32(0)
    leaf = next_leaf(t, 0, lower, upper, reach)
    while leaf < t.count:
        link = t.links[leaf]
        for face in range(link[0], link[1]):
            a, b, c = corner(t, face, 0, x), corner(t, face, 1, x), corner(t, face, 2, x)
            crosses = crossing(a, b, c, axis, wp.float64(0.0))
            if crosses < 0:
                return _UNWOUND
            if crosses > 0:
                found += _turn(a[i], a[j], b[i], b[j], wp.float64(0.0))
        leaf = next_leaf(t, leaf + 1, lower, upper, reach)
    return found


@wp.func
def winding(t: Triangles, x: wp.vec3d) -> int:
    """How often triangles that are turned alike go around x, for certain; else UNWOUND."""
    for axis in range(3):
        found = _winding_along(t, x, axis)
        if found != _UNWOUND:
            return found
    return _UNWOUND
