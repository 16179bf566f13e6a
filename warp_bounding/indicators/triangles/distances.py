"""How far are points and closed boxes from a dilated mesh? Lower bounds, within a few roundings for points.

The closest points of a box and a triangle are found by alternating projections, up to rounding; the bound is what
their direction proves, whatever they are. A walk leaves out what is farther than the nearest triangle so far.
"""

import warp as wp

from warp_bounding.indicators.triangles.answers import Mesh, half_of, is_box
from warp_bounding.indicators.triangles.arithmetic import closest_on_triangle, distance_along, rounding_slack
from warp_bounding.indicators.triangles.hierarchy import (
    Triangles,
    corner,
    floats_above,
    floats_below,
    near_leaf,
    next_leaf,
    squared_reach,
)
from warp_bounding.indicators.triangles.sides import OUTSIDE, side_of
from warp_bounding.runtime.native import module_options

__all__ = ["find_clearances"]

PROJECTIONS = 24  # alternating projections at most
CLOSE = 1.0 - 2.0**-40  # a bound that is this share of the distance found is good enough
SHORTER = 1.0 - 2.0**-50  # outweighs the rounding of a difference

_PROJECTIONS = wp.constant(PROJECTIONS)
_CLOSE = wp.constant(wp.float64(CLOSE))
_SHORTER = wp.constant(wp.float64(SHORTER))
_INFINITY = wp.constant(wp.float64(float("inf")))
_HALF = wp.constant(wp.float64(0.5))
_OUTSIDE = wp.constant(OUTSIDE)
wp.set_module_options(module_options())


@wp.func
def _across(d: wp.vec3d, edge: wp.vec3d) -> wp.vec3d:
    """The part of a direction that is perpendicular to an edge, up to rounding."""
    return d - edge * (wp.dot(d, edge) / wp.dot(edge, edge))


@wp.func
def _leaf_distances(t: Triangles, leaf: int, centre: wp.vec3d, half: wp.vec3d, known: wp.vec2d) -> wp.vec2d:
    """The least lower bound and the least distance that was found: the known ones, or those of a leaf's triangles."""
    least, found = known[0], known[1]
    link = t.links[leaf]
    for i in range(link[0], link[1]):
        a, b, c = corner(t, i, 0, centre), corner(t, i, 1, centre), corner(t, i, 2, centre)
        slack = rounding_slack(a, b, c, half, wp.float64(0.0))
        bound, distance, p = wp.float64(0.0), wp.float64(0.0), wp.vec3d()
        q = closest_on_triangle(wp.vec3d(), a, b, c)
        for _ in range(_PROJECTIONS):
            p = wp.min(wp.max(q, -half), half)
            distance = wp.length(q - p)
            found = wp.min(found, distance)
            bound = wp.max(bound, distance_along(q - p, a, b, c, half, slack))
            if bound >= distance * _CLOSE or bound > least:
                break
            q = closest_on_triangle(p, a, b, c)
        if bound < distance * _CLOSE and bound < least:  # close to the triangle a direction between points is inexact
            bound = wp.max(bound, distance_along(wp.cross(b - a, c - a), a, b, c, half, slack))
            bound = wp.max(bound, distance_along(_across(q - p, b - a), a, b, c, half, slack))
            bound = wp.max(bound, distance_along(_across(q - p, c - b), a, b, c, half, slack))
            bound = wp.max(bound, distance_along(_across(q - p, a - c), a, b, c, half, slack))
        least = wp.min(least, bound)
    return wp.vec2d(least, found)


@wp.func
def _clearance(t: Triangles, centre: wp.vec3d, half: wp.vec3d) -> wp.float64:
    """Lower bound of the distance from a box to all triangles."""
    lower, upper = floats_below(centre - half), floats_above(centre + half)
    known = _leaf_distances(t, near_leaf(t, lower, upper), centre, half, wp.vec2d(_INFINITY, _INFINITY))
    leaf = next_leaf(t, 0, lower, upper, squared_reach(known[1]))
    while leaf < t.count:
        known = _leaf_distances(t, leaf, centre, half, known)
        leaf = next_leaf(t, leaf + 1, lower, upper, squared_reach(known[1]))
    return wp.min(known[0], known[1])  # what was left out is farther than the distance that was found


@wp.kernel(enable_backward=False)
def find_clearances(
    first: int,
    # inputs
    m: Mesh,
    lower: wp.array(dtype=wp.vec3d),
    upper: wp.array(dtype=wp.vec3d),
    # outputs
    clearances: wp.array(dtype=wp.float64),
):
    """Lower bound of the distance from a closed box to the object; 0 where the box is not known to be outside."""
    i = first + wp.tid()
    low, high = lower[i], upper[i]
    answer = wp.float64(0.0)
    if is_box(low, high):
        centre = low * _HALF + high * _HALF
        if side_of(m.closed, m.sides, centre) == _OUTSIDE:
            answer = _clearance(m.faces, centre, half_of(low, high, centre))
            answer = wp.max(answer * _SHORTER - m.margin, wp.float64(0.0)) * _SHORTER
    else:  # too far to be computed with, or no box
        for k in range(3):
            answer = wp.max(answer, wp.max(m.lower[k] - high[k], low[k] - m.upper[k]) * _SHORTER)
        for k in range(3):
            if not low[k] <= high[k]:
                answer = wp.float64(0.0)
    clearances[i] = answer
