"""How far are points from a dilated mesh? Certified bounds from both sides, within a few roundings of each other.

The lower bound of each triangle is what the direction from the point to its nearest point proves (``distance_along``), the
upper one is the distance to that point, which lies in the triangle. A walk goes to the nearer child first and keeps the other
one on a stack, so that it soon knows how near the nearest triangle is; what is farther than that, box or triangle, is left out.
"""

import warp as wp

from warp_bounding.indicators.triangles.answers import Mesh, is_box
from warp_bounding.indicators.triangles.arithmetic import distance_along, rounding_slack
from warp_bounding.indicators.triangles.distances import SHORTER
from warp_bounding.indicators.triangles.hierarchy import Triangles, corner, floats_above, floats_below, squared_reach
from warp_bounding.indicators.triangles.sides import ENCLOSED, OUTSIDE, side_of
from warp_bounding.runtime.native import module_options

__all__ = ["DEEPEST", "LONGER", "Stack", "closest", "find_distances", "gap_of_box", "proven_distance"]

LONGER = 1.0 + 2.0**-50  # outweighs the rounding of a length and of a sum
GOOD = 1.0 - 2.0**-40  # a bound that is this share of the distance found is good enough
DEEPEST = 32  # levels of a hierarchy: there are never more than 2^31 triangles

_SHORTER, _LONGER = wp.constant(wp.float64(SHORTER)), wp.constant(wp.float64(LONGER))
_GOOD = wp.constant(wp.float64(GOOD))
_INFINITY = wp.constant(wp.float64(float("inf")))
_OUTSIDE, _ENCLOSED = wp.constant(OUTSIDE), wp.constant(ENCLOSED)
Stack = wp.types.vector(length=DEEPEST, dtype=wp.int32)
wp.set_module_options(module_options())


@wp.func
def _across(d: wp.vec3d, edge: wp.vec3d) -> wp.vec3d:
    """The part of a direction that is perpendicular to an edge, up to rounding."""
    return d - edge * (wp.dot(d, edge) / wp.dot(edge, edge))


@wp.func
def proven_distance(
    q: wp.vec3d, distance: wp.float64, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, slack: wp.float64
) -> wp.float64:
    """Lower bound of the distance from 0 to a triangle whose nearest point is q, up to rounding."""
    zero = wp.vec3d()
    bound = distance_along(q, a, b, c, zero, slack)
    if bound < distance * _GOOD:  # close to the triangle a direction between points is inexact
        bound = wp.max(bound, distance_along(wp.cross(b - a, c - a), a, b, c, zero, slack))
        bound = wp.max(bound, distance_along(_across(q, b - a), a, b, c, zero, slack))
        bound = wp.max(bound, distance_along(_across(q, c - b), a, b, c, zero, slack))
        bound = wp.max(bound, distance_along(_across(q, a - c), a, b, c, zero, slack))
    return bound


@wp.func
def _share(over: wp.float64, under: wp.float64) -> wp.float64:
    """``over / under`` of numbers of at least 0, from 0 to 1; 0 where both are 0."""
    if not under > wp.float64(0.0):
        return under * wp.float64(0.0)
    return wp.min(over / under, wp.float64(1.0))


@wp.func
def closest(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d) -> wp.vec3d:
    """Find a point of the triangle nearest to 0, up to rounding (Ericson, *Real-Time Collision Detection*, 5.1.5).

    It is a corner, or a corner moved by shares of two sides that add up to 1 at most, so it lies in the triangle whatever the rounding
    made of the shares, but for a few roundings of the largest coordinate. In a sliver it may be a farther point than the nearest one:
    the lower bound does not rest on it.
    """
    zero = wp.float64(0.0)
    u, v = b - a, c - a
    d1, d2 = -wp.dot(u, a), -wp.dot(v, a)
    if d1 <= zero and d2 <= zero:
        return a
    d3, d4 = -wp.dot(u, b), -wp.dot(v, b)
    if d3 >= zero and d4 <= d3:
        return b
    vc = d1 * d4 - d3 * d2
    if vc <= zero and d1 >= zero and d3 <= zero:
        return a + u * _share(d1, d1 - d3)
    d5, d6 = -wp.dot(u, c), -wp.dot(v, c)
    if d6 >= zero and d5 <= d6:
        return c
    vb = d5 * d2 - d1 * d6
    if vb <= zero and d2 >= zero and d6 <= zero:
        return a + v * _share(d2, d2 - d6)
    va = d3 * d6 - d5 * d4
    if va <= zero and d4 >= d3 and d5 >= d6:
        return b + (c - b) * _share(d4 - d3, (d4 - d3) + (d5 - d6))
    area = va + vb + vc
    if not area > zero:
        return a
    s, t = _share(vb, area), _share(vc, area)
    return a + u * s + v * wp.min(t, wp.float64(1.0) - s)


@wp.func
def gap_of_box(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d) -> wp.float64:
    """The squared distance from 0 to the box around a triangle."""
    gap = wp.max(wp.max(wp.min(a, wp.min(b, c)), -wp.max(a, wp.max(b, c))), wp.vec3d())
    return wp.dot(gap, gap) * _SHORTER


@wp.func
def _leaf(t: Triangles, leaf: int, x: wp.vec3d, known: wp.vec2d) -> wp.vec2d:
    """The least lower and the least upper bound: the known ones, or those of a leaf's triangles."""
    least, found, zero = known[0], known[1], wp.vec3d()
    link = t.links[leaf]
    for i in range(link[0], link[1]):
        a, b, c = corner(t, i, 0, x), corner(t, i, 1, x), corner(t, i, 2, x)
        if gap_of_box(a, b, c) < found * found:
            slack = rounding_slack(a, b, c, zero, wp.float64(0.0))
            q = closest(a, b, c)
            distance = wp.length(q)
            if distance * _SHORTER - slack < found:
                least = wp.min(least, proven_distance(q, distance, a, b, c, slack))
                found = wp.min(found, distance * _LONGER + slack)
    return wp.vec2d(least, found)


@wp.func
def _gap(t: Triangles, node: int, lower: wp.vec3, upper: wp.vec3) -> float:
    """The squared distance of a node's box."""
    gap = wp.max(wp.max(t.lower[node] - upper, lower - t.upper[node]), wp.vec3())
    return wp.dot(gap, gap)


@wp.func
def _nearest(t: Triangles, x: wp.vec3d) -> wp.vec2d:
    """Lower and upper bound of the distance to all triangles; what was left out is not nearer than the lower one."""
    lower, upper = floats_below(x), floats_above(x)
    known, reach = wp.vec2d(_INFINITY, _INFINITY), float(wp.inf)
    stack, depth, node = Stack(), wp.int32(0), wp.int32(0)
    while node >= 0:
        if _gap(t, node, lower, upper) <= reach:
            while t.links[node][1] == 0:
                near = node + 1
                other = t.links[near][2]
                if _gap(t, other, lower, upper) < _gap(t, near, lower, upper):
                    near, other = other, near
                stack[depth] = other
                depth += 1
                node = near
            known = _leaf(t, node, x, known)
            reach = squared_reach(known[1])
        node = wp.int32(-1)
        if depth > 0:
            depth -= 1
            node = stack[depth]
    return wp.vec2d(wp.min(known[0], known[1] * _SHORTER), known[1])


@wp.kernel(enable_backward=False)
def find_distances(
    first: int,
    # inputs
    m: Mesh,
    x: wp.array(dtype=wp.vec3d),
    # outputs
    bounds: wp.array(dtype=wp.vec2d),
):
    """Lower and upper bound of a point's distance to the object; 0 and infinity where nothing is known."""
    i = first + wp.tid()
    p, zero = x[i], wp.float64(0.0)
    low, high = zero, _INFINITY
    if is_box(p, p):  # numbers that can be computed with
        side = side_of(m.closed, m.sides, p)
        if side == _ENCLOSED:
            high = zero
        else:
            found = _nearest(m.faces, p)
            high = wp.max(found[1] - m.margin, zero) * _LONGER
            if side == _OUTSIDE:
                low = wp.max(found[0] * _SHORTER - m.margin, zero) * _SHORTER
    else:
        for k in range(3):
            low = wp.max(low, wp.max(m.lower[k] - p[k], p[k] - m.upper[k]) * _SHORTER)
        for k in range(3):
            if not (p[k] >= -_INFINITY and p[k] <= _INFINITY):
                low = zero
    bounds[i] = wp.vec2d(low, high)
