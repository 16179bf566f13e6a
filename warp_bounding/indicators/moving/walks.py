"""Walks over a hierarchy of triangles that move: is a box or a segment proven to be far from all of them in a span of time?

And of a point at a time: is a triangle near, or is the point enclosed? There a span is a single time.
"""

import warp as wp

from warp_bounding.indicators.moving.arithmetic import moving_free, moving_segment_free, moving_slack
from warp_bounding.indicators.moving.hierarchy import (
    Span,
    Ways,
    moving_at,
    near_moving_leaf,
    next_moving_leaf,
)
from warp_bounding.indicators.triangles.arithmetic import closest_on_triangle
from warp_bounding.indicators.triangles.hierarchy import floats_above, floats_below, squared_reach
from warp_bounding.indicators.triangles.rays import crossing

__all__ = ["moving_box_is_free", "moving_encloses", "moving_holds", "moving_segment_is_free"]

# Relative to the largest coordinate M: with u = 2^-53, a corner that is interpolated at a share errs by less than
#   the share, 4 u of a way of up to 2 M          8 u M
#   the way, its product and the sum              7 u M
# together less than 2^-49 M; this is twice as much.
LOOSE = 2.0**-48

_LOOSE = wp.constant(wp.float64(LOOSE / 2.0**-20))  # of a hierarchy's room, which is 2^-20 of M
_INFINITY = wp.constant(float("inf"))


@wp.func
def _leaf_is_free(ways: Ways, span: Span, leaf: int, centre: wp.vec3d, half: wp.vec3d, margin: wp.float64) -> bool:
    link = ways.links[leaf]
    for i in range(link[0], link[1]):
        t = moving_at(ways, span, i, centre)
        if not moving_free(t, half, margin, moving_slack(t, half, margin)):
            return False
    return True


@wp.func
def moving_box_is_free(ways: Ways, span: Span, centre: wp.vec3d, half: wp.vec3d, margin: wp.float64) -> bool:
    """Is every triangle proven to be further than the margin from the closed box around the centre, in all of the span?"""
    lower, upper, reach = floats_below(centre - half), floats_above(centre + half), squared_reach(margin)
    leaf = next_moving_leaf(ways, span, 0, lower, upper, reach)
    if leaf < ways.count:  # noqa: SIM102 (a near triangle tells most boxes that are not free; ``and`` would not wait)
        if not _leaf_is_free(ways, span, near_moving_leaf(ways, span, lower, upper), centre, half, margin):
            return False
    while leaf < ways.count:
        if not _leaf_is_free(ways, span, leaf, centre, half, margin):
            return False
        leaf = next_moving_leaf(ways, span, leaf + 1, lower, upper, reach)
    return True


@wp.func
def moving_segment_is_free(ways: Ways, span: Span, start: wp.vec3d, end: wp.vec3d, margin: wp.float64) -> bool:
    """Is every triangle proven to be further than the margin from the closed segment, in all of the span?"""
    lower, upper = floats_below(wp.min(start, end)), floats_above(wp.max(start, end))
    reach, s = squared_reach(margin), end - start
    leaf = next_moving_leaf(ways, span, 0, lower, upper, reach)
    while leaf < ways.count:
        link = ways.links[leaf]
        for i in range(link[0], link[1]):
            t = moving_at(ways, span, i, start)
            if not moving_segment_free(t, s, margin, moving_slack(t, wp.abs(s), margin)):
                return False
        leaf = next_moving_leaf(ways, span, leaf + 1, lower, upper, reach)
    return True


@wp.func
def _leaf_holds(ways: Ways, span: Span, leaf: int, centre: wp.vec3d, radius: wp.float64, margin: wp.float64) -> bool:
    zero = wp.vec3d()
    link = ways.links[leaf]
    for i in range(link[0], link[1]):
        t = moving_at(ways, span, i, centre)
        way = wp.max(wp.length(t.u), wp.max(wp.length(t.v), wp.length(t.w)))
        far = wp.length(closest_on_triangle(zero, t.a, t.b, t.c)) + way + radius
        if far + moving_slack(t, zero, margin) <= margin:
            return True
    return False


@wp.func
def moving_holds(ways: Ways, span: Span, centre: wp.vec3d, radius: wp.float64, margin: wp.float64) -> bool:
    """Does the ball around the centre lie within the margin of a single triangle for certain, in all of the span?"""
    if not radius < margin:
        return False
    lower, upper, reach = floats_below(centre), floats_above(centre), squared_reach(margin - radius)
    leaf = next_moving_leaf(ways, span, 0, lower, upper, reach)
    if leaf < ways.count:  # noqa: SIM102 (a kernel's ``and`` would not wait)
        if _leaf_holds(ways, span, near_moving_leaf(ways, span, lower, upper), centre, radius, margin):
            return True
    while leaf < ways.count:
        if _leaf_holds(ways, span, leaf, centre, radius, margin):
            return True
        leaf = next_moving_leaf(ways, span, leaf + 1, lower, upper, reach)
    return False


@wp.func
def _crossed_cycles(ways: Ways, span: Span, x: wp.vec3d, axis: int) -> wp.uint64:
    """As of triangles at rest (``triangles/rays.py``), for a span that is a single time."""
    loose = _LOOSE * wp.float64(ways.room)
    lower, upper, reach = floats_below(x), floats_above(x), squared_reach(wp.float64(0.0))
    upper[axis] = _INFINITY
    crossed = wp.uint64(0)
    leaf = next_moving_leaf(ways, span, 0, lower, upper, reach)
    while leaf < ways.count:
        link = ways.links[leaf]
        for i in range(link[0], link[1]):
            if ways.cycles[i] != wp.uint64(0):
                t = moving_at(ways, span, i, x)
                crosses = crossing(t.a, t.b, t.c, axis, loose)
                if crosses < 0:
                    return wp.uint64(0)
                if crosses > 0:
                    crossed = crossed ^ ways.cycles[i]
        leaf = next_moving_leaf(ways, span, leaf + 1, lower, upper, reach)
    return crossed


@wp.func
def moving_encloses(ways: Ways, span: Span, x: wp.vec3d) -> bool:
    """Is it proven, by rays along the axes, that the triangles enclose x at the time of the span, a single one?"""
    for axis in range(3):  # noqa: SIM110 (a kernel has no ``any``)
        if _crossed_cycles(ways, span, x, axis) != wp.uint64(0):
            return True
    return False
