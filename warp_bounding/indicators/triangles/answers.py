"""What a dilated mesh answers, in kernels: about points, and about closed boxes."""

import warp as wp

from warp_bounding.indicators.shape import IN, OUT, UNDECIDED
from warp_bounding.indicators.triangles.arithmetic import closest_on_triangle, largest, rounding_slack
from warp_bounding.indicators.triangles.hierarchy import (
    Triangles,
    corner,
    floats_above,
    floats_below,
    next_leaf,
    squared_reach,
)
from warp_bounding.indicators.triangles.sides import ENCLOSED, MODULE, OUTSIDE, Sides, side_of
from warp_bounding.indicators.triangles.walks import FAR, NEAR, box_is_free, nearness

__all__ = ["LIMIT", "Mesh", "decide_points", "find_empty", "find_inside", "half_of", "is_box"]

LIMIT = 2.0**200  # coordinates beyond it are not computed with: their products might overflow
OUTWARD = 1.0 + 2.0**-50  # a half side times this outweighs its rounding

_LIMIT = wp.constant(wp.float64(LIMIT))
_OUTWARD = wp.constant(wp.float64(OUTWARD))
_HALF = wp.constant(wp.float64(0.5))
_IN, _OUT, _UNDECIDED = wp.constant(IN), wp.constant(OUT), wp.constant(UNDECIDED)
_ENCLOSED, _OUTSIDE = wp.constant(ENCLOSED), wp.constant(OUTSIDE)


@wp.struct
class Mesh:
    """A mesh that is dilated."""

    lower: wp.vec3d  # the box that holds the dilated object
    upper: wp.vec3d
    margin: wp.float64
    faces: Triangles  # all of them
    closed: Triangles  # those of closed parts
    sides: Sides


@wp.func
def _point(m: Mesh, x: wp.vec3d) -> int:
    for k in range(3):
        if not (x[k] >= m.lower[k] and x[k] <= m.upper[k]):  # NaN is nowhere
            return _OUT
    if not largest(x) < _LIMIT:
        return _UNDECIDED
    near = nearness(m.faces, x, m.margin)
    if near == NEAR:
        return _IN
    side = side_of(m.closed, m.sides, x)
    if side == _ENCLOSED:
        return _IN
    if side == _OUTSIDE and near == FAR:
        return _OUT
    return _UNDECIDED


@wp.kernel(enable_backward=False, module=MODULE)
def decide_points(
    first: int,
    # inputs
    m: Mesh,
    x: wp.array(dtype=wp.vec3d),
    # outputs
    answers: wp.array(dtype=wp.uint8),
):
    """Is a point in the object?"""
    i = first + wp.tid()
    answers[i] = wp.uint8(_point(m, x[i]))


@wp.func
def is_box(lower: wp.vec3d, upper: wp.vec3d) -> bool:
    """Is it a box of numbers that can be computed with?"""
    for k in range(3):  # noqa: SIM110 (a kernel has no ``all``)
        if not (lower[k] <= upper[k] and lower[k] > -_LIMIT and upper[k] < _LIMIT):
            return False
    return True


@wp.func
def half_of(lower: wp.vec3d, upper: wp.vec3d, centre: wp.vec3d) -> wp.vec3d:
    """Half the sides of a box around the centre that holds the given one."""
    return wp.max(upper - centre, centre - lower) * _OUTWARD


@wp.func
def _empty(m: Mesh, lower: wp.vec3d, upper: wp.vec3d) -> bool:
    for k in range(3):
        if not lower[k] <= upper[k]:
            return False
    for k in range(3):
        if upper[k] < m.lower[k] or lower[k] > m.upper[k]:
            return True
    if not is_box(lower, upper):
        return False
    centre = lower * _HALF + upper * _HALF
    if not box_is_free(m.faces, centre, half_of(lower, upper, centre), m.margin):
        return False
    return side_of(m.closed, m.sides, centre) == _OUTSIDE


@wp.kernel(enable_backward=False, module=MODULE)
def find_empty(
    first: int,
    # inputs
    m: Mesh,
    lower: wp.array(dtype=wp.vec3d),
    upper: wp.array(dtype=wp.vec3d),
    # outputs
    answers: wp.array(dtype=wp.uint8),
):
    """Is it certain that a closed box holds no point of the object?"""
    i = first + wp.tid()
    answers[i] = wp.uint8(_empty(m, lower[i], upper[i]))


@wp.func
def _held_by_a_face(t: Triangles, centre: wp.vec3d, radius: wp.float64, margin: wp.float64) -> bool:
    """Does the ball around the centre lie within the margin of a single triangle, for certain?"""
    if not radius < margin:
        return False
    zero = wp.vec3d()
    lower, upper, reach = floats_below(centre), floats_above(centre), squared_reach(margin - radius)
    leaf = next_leaf(t, 0, lower, upper, reach)
    while leaf < t.count:
        link = t.links[leaf]
        for i in range(link[0], link[1]):
            a, b, c = corner(t, i, 0, centre), corner(t, i, 1, centre), corner(t, i, 2, centre)
            far = wp.length(closest_on_triangle(zero, a, b, c)) + radius
            if far + rounding_slack(a, b, c, zero, margin) <= margin:
                return True
        leaf = next_leaf(t, leaf + 1, lower, upper, reach)
    return False


@wp.func
def _inside(m: Mesh, lower: wp.vec3d, upper: wp.vec3d) -> bool:
    if not is_box(lower, upper):
        return False
    centre = lower * _HALF + upper * _HALF
    half = half_of(lower, upper, centre)
    if side_of(m.closed, m.sides, centre) == _ENCLOSED and box_is_free(m.closed, centre, half, wp.float64(0.0)):
        return True
    return _held_by_a_face(m.faces, centre, wp.length(half) * _OUTWARD, m.margin)


@wp.kernel(enable_backward=False, module=MODULE)
def find_inside(
    first: int,
    # inputs
    m: Mesh,
    lower: wp.array(dtype=wp.vec3d),
    upper: wp.array(dtype=wp.vec3d),
    # outputs
    answers: wp.array(dtype=wp.uint8),
):
    """Is it certain that a closed box lies in the object whole?"""
    i = first + wp.tid()
    answers[i] = wp.uint8(_inside(m, lower[i], upper[i]))
