"""How far in space are points from a dilated motion at their time? Certified bounds from both sides.

At a single time a triangle that moves stands still, so the walk and the proofs are those of ``triangles/points.py``. Vertices may be
elsewhere by the motion's rounding, which widens what is known of them.
"""

import warp as wp

from warp_bounding.indicators.moving.answers import Motion
from warp_bounding.indicators.moving.hierarchy import Span, Ways, moving_at, span_between
from warp_bounding.indicators.moving.sides import side_in
from warp_bounding.indicators.triangles.answers import is_box
from warp_bounding.indicators.triangles.arithmetic import rounding_slack
from warp_bounding.indicators.triangles.distances import SHORTER
from warp_bounding.indicators.triangles.hierarchy import floats_above, floats_below, squared_reach
from warp_bounding.indicators.triangles.points import LONGER, Stack, closest, gap_of_box, proven_distance
from warp_bounding.indicators.triangles.sides import ENCLOSED, OUTSIDE

__all__ = ["find_distances_then"]

_SHORTER, _LONGER = wp.constant(wp.float64(SHORTER)), wp.constant(wp.float64(LONGER))
_INFINITY = wp.constant(wp.float64(float("inf")))
_OUTSIDE, _ENCLOSED = wp.constant(OUTSIDE), wp.constant(ENCLOSED)


@wp.func
def _leaf(ways: Ways, span: Span, leaf: int, x: wp.vec3d, known: wp.vec2d) -> wp.vec2d:
    """The least lower and the least upper bound: the known ones, or those of a leaf's triangles."""
    least, found, zero = known[0], known[1], wp.vec3d()
    link = ways.links[leaf]
    for i in range(link[0], link[1]):
        t = moving_at(ways, span, i, x)
        slack = rounding_slack(t.a, t.b, t.c, zero, wp.float64(0.0))
        if gap_of_box(t.a, t.b, t.c) < found * found:
            q = closest(t.a, t.b, t.c)
            distance = wp.length(q)
            if distance * _SHORTER - slack < found:
                least = wp.min(least, proven_distance(q, distance, t.a, t.b, t.c, slack))
                found = wp.min(found, distance * _LONGER + slack)
    return wp.vec2d(least, found)


@wp.func
def _gap(ways: Ways, span: Span, node: int, lower: wp.vec3, upper: wp.vec3) -> float:
    """The squared distance of a node's box at the span's time."""
    share = float(span.begin)
    low = ways.lower[span.key, node] * (1.0 - share) + ways.lower[span.key + 1, node] * share
    high = ways.upper[span.key, node] * (1.0 - share) + ways.upper[span.key + 1, node] * share
    room = wp.vec3(ways.room, ways.room, ways.room)
    gap = wp.max(wp.max(low - upper, lower - high) - room, wp.vec3())
    return wp.dot(gap, gap)


@wp.func
def _nearest(ways: Ways, span: Span, x: wp.vec3d) -> wp.vec2d:
    """Lower and upper bound of the distance to all triangles at the span's time."""
    lower, upper = floats_below(x), floats_above(x)
    known, reach = wp.vec2d(_INFINITY, _INFINITY), float(wp.inf)
    stack, depth, node = Stack(), wp.int32(0), wp.int32(0)
    while node >= 0:
        if _gap(ways, span, node, lower, upper) <= reach:
            while ways.links[node][1] == 0:
                near = node + 1
                other = ways.links[near][2]
                if _gap(ways, span, other, lower, upper) < _gap(ways, span, near, lower, upper):
                    near, other = other, near
                stack[depth] = other
                depth += 1
                node = near
            known = _leaf(ways, span, node, x, known)
            reach = squared_reach(known[1])
        node = wp.int32(-1)
        if depth > 0:
            depth -= 1
            node = stack[depth]
    return wp.vec2d(wp.min(known[0], known[1] * _SHORTER), known[1])


@wp.kernel(enable_backward=False)
def find_distances_then(
    first: int,
    # inputs
    m: Motion,
    keys: wp.array(dtype=wp.int32),
    x: wp.array(dtype=wp.vec4d),
    # outputs
    bounds: wp.array(dtype=wp.vec2d),
):
    """Lower and upper bound of a point's distance to the object at its time; 0 and infinity where nothing is known."""
    i, _ = wp.tid()
    i += first
    p, time, zero = wp.vec3d(x[i][1], x[i][2], x[i][3]), x[i][0], wp.float64(0.0)
    low, high = zero, _INFINITY
    if keys[i] >= 0 and is_box(p, p):  # numbers that can be computed with
        span = span_between(m.faces.times, keys[i], time, time)
        side = side_in(m.closed, m.pieces, span, p)
        found = _nearest(m.faces, span, p)
        high = wp.max(found[1] - m.hold, zero) * _LONGER
        if side == _ENCLOSED and found[0] > m.rounding:  # nearer to a face the side is not certain
            high = zero
        if side == _OUTSIDE:
            low = wp.max(found[0] * _SHORTER - m.reach, zero) * _SHORTER
    bounds[i] = wp.vec2d(low, high)
