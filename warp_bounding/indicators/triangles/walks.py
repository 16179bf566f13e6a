"""Walks over a hierarchy of triangles: is a box, a segment or a point proven to be far from all of them?"""

import warp as wp

from warp_bounding.indicators.triangles.arithmetic import (
    closest_on_triangle,
    free,
    rounding_slack,
    segment_free,
    separated,
)
from warp_bounding.indicators.triangles.hierarchy import (
    Triangles,
    corner,
    floats_above,
    floats_below,
    near_leaf,
    next_leaf,
    squared_reach,
)

__all__ = ["FAR", "NEAR", "UNSURE", "box_is_free", "nearness", "segment_is_free"]

FAR, NEAR, UNSURE = wp.constant(0), wp.constant(1), wp.constant(2)  # answers of ``nearness``


@wp.func
def _leaf_is_free(t: Triangles, leaf: int, centre: wp.vec3d, half: wp.vec3d, margin: wp.float64) -> bool:
    link = t.links[leaf]
    for i in range(link[0], link[1]):
        a, b, c = corner(t, i, 0, centre), corner(t, i, 1, centre), corner(t, i, 2, centre)
        if not free(a, b, c, half, margin, rounding_slack(a, b, c, half, margin)):
            return False
    return True


@wp.func
def box_is_free(t: Triangles, centre: wp.vec3d, half: wp.vec3d, margin: wp.float64) -> bool:
    """Is every triangle proven to be further than the margin from the closed box around the centre?"""
    lower, upper, reach = floats_below(centre - half), floats_above(centre + half), squared_reach(margin)
    leaf = next_leaf(t, 0, lower, upper, reach)
    near = leaf
    if leaf < t.count and margin > wp.float64(0.0):  # a near triangle tells most boxes that are not free at once
        near = near_leaf(t, lower, upper)
    if near < t.count and not _leaf_is_free(t, near, centre, half, margin):
        return False
    while leaf < t.count:
        if not _leaf_is_free(t, leaf, centre, half, margin):
            return False
        leaf = next_leaf(t, leaf + 1, lower, upper, reach)
    return True


@wp.func
def segment_is_free(t: Triangles, start: wp.vec3d, end: wp.vec3d, margin: wp.float64) -> bool:
    """Is every triangle proven to be further than the margin from the closed segment?"""
    lower, upper = floats_below(wp.min(start, end)), floats_above(wp.max(start, end))
    reach, s = squared_reach(margin), end - start
    leaf = next_leaf(t, 0, lower, upper, reach)
    while leaf < t.count:
        link = t.links[leaf]
        for i in range(link[0], link[1]):
            a, b, c = corner(t, i, 0, start), corner(t, i, 1, start), corner(t, i, 2, start)
            if not segment_free(a, b, c, s, margin, rounding_slack(a, b, c, s, margin)):
                return False
        leaf = next_leaf(t, leaf + 1, lower, upper, reach)
    return True


@wp.func
def _leaf_nearness(t: Triangles, leaf: int, x: wp.vec3d, margin: wp.float64) -> int:
    zero = wp.vec3d()
    answer = wp.int32(FAR)
    link = t.links[leaf]
    for i in range(link[0], link[1]):
        a, b, c = corner(t, i, 0, x), corner(t, i, 1, x), corner(t, i, 2, x)
        slack = rounding_slack(a, b, c, zero, margin)
        d = closest_on_triangle(zero, a, b, c)
        if not separated(d, a, b, c, zero, margin, slack):
            if wp.length(d) + slack <= margin:
                return NEAR
            if not free(a, b, c, zero, margin, slack):
                answer = UNSURE
    return answer


@wp.func
def nearness(t: Triangles, x: wp.vec3d, margin: wp.float64) -> int:
    """Is a triangle within the margin of x for certain (NEAR), is each of them proven to be further (FAR), or neither?"""
    lower, upper, reach = floats_below(x), floats_above(x), squared_reach(margin)
    answer = wp.int32(FAR)
    leaf = next_leaf(t, 0, lower, upper, reach)
    if leaf < t.count and margin > wp.float64(0.0):
        near = _leaf_nearness(t, near_leaf(t, lower, upper), x, margin)
        if near == NEAR:
            return NEAR
    while leaf < t.count:
        told = _leaf_nearness(t, leaf, x, margin)
        if told == NEAR:
            return NEAR
        answer = wp.max(answer, told)
        leaf = next_leaf(t, leaf + 1, lower, upper, reach)
    return answer
