"""Certified bounds, in kernels, of distances to a dilated mesh at rest or moving, and of overestimate over them."""

from typing import Any

import warp as wp

from warp_bounding.runtime.native import module_options
from warp_bounding.shapes.triangles.answers import Motion, half_of, is_box, key_at, place_of
from warp_bounding.shapes.triangles.cells import ENCLOSED, MODULE, OUTSIDE, MeshArrays, kernel_of, side_of
from warp_bounding.shapes.triangles.hierarchy import (
    MovingTriangle,
    Triangle,
    Triangles,
    Ways,
    box_is_free,
    distance_along,
    during,
    floats_above,
    floats_below,
    gap,
    largest,
    slack_of,
    span_between,
    squared_reach,
    triangle_at,
    wide,
)
from warp_bounding.shapes.triangles.moving import outside_in, side_in

# The others are slower with less inlining.
wp.set_module_options(module_options(), wp.get_module(f"{MODULE}.distances"))

_HALF = wp.constant(wp.float64(0.5))
_ENCLOSED, _OUTSIDE = wp.constant(ENCLOSED), wp.constant(OUTSIDE)

# --- Distances of points ----------------------------------------------------------------------------------------------
#
# How far are points from a dilated mesh, in space at their time? Certified bounds from both sides, within a few
# roundings of each other.
#
# The lower bound of each triangle is what the direction from the point to its nearest point proves
# (``distance_along``), the upper one is the distance to that point, which lies in the triangle. A walk goes to the
# nearer child first and keeps the other one on a stack, so that it soon knows how near the nearest triangle is; what is
# farther than that, box or triangle, is left out. At a single time a triangle that moves stands still; its vertices may
# be elsewhere by the motion's rounding, which widens what is known of them.

# Outweigh the rounding of a length and of a sum.
_SHORTER, _LONGER = wp.constant(wp.float64(1.0 - 2.0**-50)), wp.constant(wp.float64(1.0 + 2.0**-50))
_GOOD = wp.constant(wp.float64(1.0 - 2.0**-40))  # a bound that is this share of the distance found is good enough
DEEPEST = 32  # levels of a hierarchy: there are never more than 2^31 triangles
_INFINITY = wp.constant(wp.float64(float("inf")))
Stack = wp.types.vector(length=DEEPEST, dtype=wp.int32)


@wp.func
def _across(d: wp.vec3d, edge: wp.vec3d) -> wp.vec3d:
    """The part of a direction that is perpendicular to an edge, up to rounding."""
    return d - edge * (wp.dot(d, edge) / wp.dot(edge, edge))


@wp.func
def _proven_distance(q: wp.vec3d, distance: wp.float64, t: Any, slack: wp.float64) -> wp.float64:
    """Lower bound of the distance from 0 to a triangle whose nearest point is q, up to rounding."""
    bound = distance_along(q, t, slack)
    if bound < distance * _GOOD:  # close to the triangle a direction between points is inexact
        bound = wp.max(bound, distance_along(wp.cross(t.b - t.a, t.c - t.a), t, slack))
        bound = wp.max(bound, distance_along(_across(q, t.b - t.a), t, slack))
        bound = wp.max(bound, distance_along(_across(q, t.c - t.b), t, slack))
        bound = wp.max(bound, distance_along(_across(q, t.a - t.c), t, slack))
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

    It is a corner, or a corner moved by shares of two sides that add up to 1 at most, so it lies in the triangle
    whatever the rounding made of the shares, but for a few roundings of the largest coordinate. In a sliver it may be a
    farther point than the nearest one: the lower bound does not rest on it.
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
def _leaf(t: Any, leaf: int, x: wp.vec3d, known: wp.vec2d) -> wp.vec2d:
    """The least lower and the least upper bound: the known ones, or those of a leaf's triangles."""
    least, found = known[0], known[1]
    link = t.links[leaf]
    for i in range(link[0], link[1]):
        face = triangle_at(t, i, x)
        slack = slack_of(face, wp.vec3d(), wp.float64(0.0))
        away = wp.max(
            wp.max(wp.min(face.a, wp.min(face.b, face.c)), -wp.max(face.a, wp.max(face.b, face.c))), wp.vec3d()
        )
        reach = found + slack
        if wp.dot(away, away) * _SHORTER < reach * reach:  # most are farther
            q = closest(face.a, face.b, face.c)
            distance = wp.length(q)
            if distance * _SHORTER - slack < found:
                least = wp.min(least, _proven_distance(q, distance, face, slack))
                found = wp.min(found, distance * _LONGER + slack)
    return wp.vec2d(least, found)


@wp.func
def _nearest(t: Any, x: wp.vec3d) -> wp.vec2d:
    """Lower and upper bound of the distance to all triangles; a span is a single time.

    What was left out is not nearer than the lower one.
    """
    lower, upper = floats_below(x), floats_above(x)
    known, reach = wp.vec2d(_INFINITY, _INFINITY), float(wp.inf)
    stack, depth, node = Stack(), wp.int32(0), wp.int32(0)
    while node >= 0:
        if gap(t, node, lower, upper) <= reach:
            while t.links[node][1] == 0:
                near = node + 1
                other = t.links[near][2]
                if gap(t, other, lower, upper) < gap(t, near, lower, upper):
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


@wp.func
def _distances(m: MeshArrays, p: wp.vec3d) -> wp.vec2d:
    """Lower and upper bound of a point's distance to the object; 0 and infinity where nothing is known."""
    zero = wp.float64(0.0)
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
    return wp.vec2d(low, high)


@wp.func
def _distances(m: Motion, x: wp.vec4d) -> wp.vec2d:
    """The same at the point's time."""
    p, time, zero = place_of(x), x[0], wp.float64(0.0)
    low, high = zero, _INFINITY
    if time >= m.lower[0] and time <= m.upper[0] and is_box(p, p):  # numbers that can be computed with
        span = span_between(m.faces.times, key_at(m.faces.times, time), time, time)
        side = side_in(during(m.closed, span), m.pieces, p)
        found = _nearest(during(m.faces, span), p)
        high = wp.max(found[1] - m.hold, zero) * _LONGER
        if side == _ENCLOSED and found[0] > m.rounding:  # nearer to a face the side is not certain
            high = zero
        if side == _OUTSIDE:
            low = wp.max(found[0] * _SHORTER - m.reach, zero) * _SHORTER
    return wp.vec2d(low, high)


find_distances = kernel_of(_distances, MeshArrays, wp.vec3d, f"{MODULE}.distances", wp.vec2d, rows=1)
find_distances_then = kernel_of(_distances, Motion, wp.vec4d, f"{MODULE}.moving_distances", wp.vec2d, rows=1)


# --- Overestimates ----------------------------------------------------------------------------------------------------
#
# By how much can a function exceed the distance to a dilated mesh in a box, of time and space if it moves? Certified
# upper bounds, for functions that are bounded by their corners.
#
# The function is known by numbers at the box's corners, so that what is multilinear in between, less anything linear,
# is largest at a corner. The distance to a convex piece (a triangle, or a node's box with all that is in it) is at
# least ``n . x - h`` for any unit vector n, with h the piece's support along n. With n the direction from the piece's
# nearest point to the box's centre that is its tangent, so that slopes cancel. The function less this is largest at a
# corner; the largest of these numbers over all pieces bounds the overestimate over the distance to all of them. A node
# whose number is not above what is known already is left out, with all pieces below it.
#
# Between two keyframes corners go straight. The support of a triangle along n at a time is the largest of three linear
# functions of it, and that of a node's box is linear: convex in time, both. So the function less ``n . x`` and plus the
# support is largest at a corner of the box of time and space, and the supports at its first and its last time are
# enough. As any multiple of the plane, from 0 to 1, is under the distance, too, the function's own slope is taken as
# well as 1 (``box_distances.py``).
#
# Where a box may hold enclosed points, whose distance is 0, or a point of a moving face, all that is known is the
# function's largest value.

# Relative to all coordinates and values: some hundred times what float64 rounds in these few sums and products.
SUM_ROUNDING = 2.0**-44
SHORTEST = 2.0**-300  # a piece that is nearer to the centre has no direction

_SUM_ROUNDING, _SHORTEST = wp.constant(wp.float64(SUM_ROUNDING)), wp.constant(wp.float64(SHORTEST))
_ZERO, _ONE = wp.constant(wp.float64(0.0)), wp.constant(wp.float64(1.0))
Corners = wp.types.vector(length=8, dtype=wp.float64)  # corner i is the upper one on axis k where bit k of i is set
CornersThen = wp.types.vector(length=16, dtype=wp.float64)  # bit 0 is time


@wp.struct
class Function:
    """A box, and a function's numbers at its corners."""

    centre: wp.vec3d
    half: wp.vec3d
    values: Corners
    room: wp.float64
    highest: wp.float64


@wp.struct
class FunctionThen:
    """The same for a box of time and space."""

    centre: wp.vec3d
    half: wp.vec3d
    values: CornersThen
    room: wp.float64
    highest: wp.float64


@wp.func
def _along(half: wp.vec3d, n: wp.vec3d, corner: int) -> wp.float64:
    """``n . x``, x a corner of a box around 0."""
    x = wp.vec3d(
        wp.where(corner & 1, half[0], -half[0]),
        wp.where(corner & 2, half[1], -half[1]),
        wp.where(corner & 4, half[2], -half[2]),
    )
    return wp.dot(n, x)


@wp.func
def _number(f: Function, n: wp.vec3d, support: wp.float64) -> wp.float64:
    """The largest value less the plane under the distance."""
    most = -_INFINITY
    for i in range(8):
        most = wp.max(most, f.values[i] - _along(f.half, n, i))
    return most + support + f.room


@wp.func
def _number(f: FunctionThen, n: wp.vec3d, supports: wp.vec2d) -> wp.float64:
    """The same, the plane whole or as steep as the function; supports at both times."""
    rise, run = _ZERO, _ZERO
    for i in range(16):
        along = _along(f.half, n, i >> 1)
        rise += f.values[i] * along
        run += along * along
    share = _ONE
    if run > _ZERO:
        share = wp.clamp(rise / run, _ZERO, _ONE)
    whole, part = -_INFINITY, -_INFINITY
    for i in range(16):
        plane = wp.where(i & 1, supports[1], supports[0]) - _along(f.half, n, i >> 1)
        whole = wp.max(whole, f.values[i] + plane)
        part = wp.max(part, f.values[i] + share * plane)
    return wp.min(whole, part) + f.room


@wp.func
def _support(n: wp.vec3d, t: Triangle) -> wp.float64:
    return wp.max(wp.dot(n, t.a), wp.max(wp.dot(n, t.b), wp.dot(n, t.c)))


@wp.func
def _support(n: wp.vec3d, t: MovingTriangle) -> wp.vec2d:
    begin = wp.max(wp.dot(n, t.a - t.u), wp.max(wp.dot(n, t.b - t.v), wp.dot(n, t.c - t.w)))
    end = wp.max(wp.dot(n, t.a + t.u), wp.max(wp.dot(n, t.b + t.v), wp.dot(n, t.c + t.w)))
    return wp.vec2d(begin, end)


@wp.func
def _support_of_box(n: wp.vec3d, low: wp.vec3d, high: wp.vec3d) -> wp.float64:
    support = _ZERO
    for k in range(3):
        support += wp.max(n[k] * low[k], n[k] * high[k])
    return support


@wp.func
def _node_overestimate(t: Triangles, f: Function, node: int) -> wp.vec2d:
    """The number of a node, infinite where it has no direction, and its distance."""
    low, high = wide(t.lower[node]) - f.centre, wide(t.upper[node]) - f.centre
    q = wp.max(low, wp.min(high, wp.vec3d()))
    away = wp.length(q)
    if not away > _SHORTEST:
        return wp.vec2d(_INFINITY, _ZERO)
    n = q / -away
    return wp.vec2d(_number(f, n, _support_of_box(n, low, high)), away)


@wp.func
def _box_at(t: Ways, node: int, share: float, centre: wp.vec3d):
    """A node's box when a share of the way to the next keyframe is over, from a point."""
    room, key = wp.vec3(t.room, t.room, t.room), t.span.key
    low = t.lower[key, node] * (1.0 - share) + t.lower[key + 1, node] * share - room
    high = t.upper[key, node] * (1.0 - share) + t.upper[key + 1, node] * share + room
    return wide(low) - centre, wide(high) - centre


@wp.func
def _node_overestimate(t: Ways, f: FunctionThen, node: int) -> wp.vec2d:
    """The same in a span of time."""
    low, high = _box_at(t, node, float(t.span.begin), f.centre)
    low_then, high_then = _box_at(t, node, float(t.span.end), f.centre)
    q = wp.max((low + low_then) * _HALF, wp.min((high + high_then) * _HALF, wp.vec3d()))
    away = wp.length(q)
    if not away > _SHORTEST:
        return wp.vec2d(_INFINITY, _ZERO)
    n = q / -away
    supports = wp.vec2d(_support_of_box(n, low, high), _support_of_box(n, low_then, high_then))
    return wp.vec2d(_number(f, n, supports), away)


@wp.func
def _leaf_overestimate(t: Any, f: Any, leaf: int, known: wp.float64) -> wp.float64:
    """The largest number of a leaf's triangles, and of what is known."""
    link = t.links[leaf]
    for i in range(link[0], link[1]):
        face = triangle_at(t, i, f.centre)
        q = closest(face.a, face.b, face.c)
        away = wp.length(q)
        if away > _SHORTEST:
            n = q / -away
            known = wp.max(known, wp.min(f.highest, _number(f, n, _support(n, face))))
        else:
            known = wp.max(known, f.highest)
    return known


@wp.func
def _overestimate(t: Any, f: Any, least: wp.float64, enough: wp.float64) -> wp.float64:
    """The largest number of all pieces, from ``least`` to ``f.highest``; this where it is above ``enough``."""
    known = wp.min(least, f.highest)
    stack, depth, node = Stack(), wp.int32(0), wp.int32(0)
    if t.count == 0:
        node = wp.int32(-1)
    while node >= 0 and known < f.highest and known <= enough:
        own = _node_overestimate(t, f, node)
        while own[0] > known and t.links[node][1] == 0:
            near = node + 1
            other = t.links[near][2]
            nearer = _node_overestimate(t, f, near)
            farther = _node_overestimate(t, f, other)
            if farther[1] < nearer[1]:
                near, other = other, near
                nearer, farther = farther, nearer
            if farther[0] > known:
                stack[depth] = other
                depth += 1
            node = near
            own = nearer
        if own[0] > known:
            known = _leaf_overestimate(t, f, node, known)
        node = wp.int32(-1)
        if depth > 0:
            depth -= 1
            node = stack[depth]
    if known > enough:
        return f.highest  # the walk has not seen all pieces
    return known


@wp.func
def _limits(values: Any) -> wp.vec2d:
    """The largest of a function's numbers, and the largest absolute one."""
    highest = values[0]
    size = wp.abs(values[0])
    for k in range(1, values.length):
        highest = wp.max(highest, values[k])
        size = wp.max(size, wp.abs(values[k]))
    return wp.vec2d(highest, size)


@wp.func
def _largest_overestimate(
    m: MeshArrays,
    low: wp.vec3d,
    high: wp.vec3d,
    values: Corners,
    limits: wp.vec2d,
    least: wp.float64,
    enough: wp.float64,
) -> wp.float64:
    """Upper bound of a function's overestimate over the distance in a box, above ``least``."""
    if not is_box(low, high):
        return limits[0]
    f = Function()
    f.values = values
    f.highest = limits[0]
    f.centre = low * _HALF + high * _HALF
    f.half = half_of(low, high, f.centre)
    if side_of(m.closed, m.sides, f.centre) != _OUTSIDE:
        return f.highest
    if m.closed.count > 0:  # noqa: SIM102 (a kernel's ``and`` would not wait)
        if not box_is_free(m.closed, f.centre, f.half, _ZERO):
            return f.highest
    size = limits[1] + (largest(m.lower) + largest(m.upper) + largest(f.centre) + largest(f.half) + m.margin)
    f.room = _SUM_ROUNDING * size + m.margin
    return _overestimate(m.faces, f, least, enough)


@wp.func
def _largest_overestimate(
    m: Motion,
    lower: wp.vec4d,
    upper: wp.vec4d,
    values: CornersThen,
    limits: wp.vec2d,
    least: wp.float64,
    enough: wp.float64,
) -> wp.float64:
    """The same in a box that lies between two keyframes, but for as little as rounding makes of their times."""
    low, high, begin, end, times = place_of(lower), place_of(upper), lower[0], upper[0], m.faces.times
    if not (begin <= end and is_box(low, high)):
        return limits[0]
    f = FunctionThen()
    f.values = values
    f.highest = limits[0]
    f.centre = low * _HALF + high * _HALF
    f.half = half_of(low, high, f.centre)
    key = key_at(times, begin * _HALF + end * _HALF)
    span = span_between(times, key, begin, end)
    beyond = (m.speed + m.speed) * wp.max(wp.max(times[key] - begin, end - times[key + 1]), _ZERO)
    if not box_is_free(during(m.faces, span), f.centre, f.half, m.rounding + beyond):
        return f.highest
    if not outside_in(during(m.closed, span), m.pieces, f.centre):
        return f.highest
    size = limits[1]
    for k in range(4):
        size += wp.abs(m.lower[k]) + wp.abs(m.upper[k])
    f.room = _SUM_ROUNDING * (size + (largest(f.centre) + largest(f.half))) + m.reach + beyond
    return _overestimate(during(m.faces, span), f, least, enough)


def _overestimate_kernel(mesh: type, point: type, corners: type, module: str) -> wp.Kernel:
    """For ``overestimate``: ``least`` where the overestimate is less, and any bound where it is above ``enough``."""

    @wp.kernel(enable_backward=False, module=module)
    def find_overestimates(
        first: int,
        # inputs
        m: mesh,
        lower: wp.array(dtype=point),
        upper: wp.array(dtype=point),
        values: wp.array(dtype=corners),
        least: wp.float64,
        enough: wp.array(dtype=wp.float64),
        # outputs
        overestimates: wp.array(dtype=wp.float64),
    ):
        i, _ = wp.tid()
        i += first
        limits = _limits(values[i])
        answer = limits[0]
        if answer > least:
            answer = _largest_overestimate(m, lower[i], upper[i], values[i], limits, least, enough[i])
        overestimates[i] = wp.max(answer, least)

    return find_overestimates


find_overestimates = _overestimate_kernel(MeshArrays, wp.vec3d, Corners, f"{MODULE}.overestimates")
find_overestimates_then = _overestimate_kernel(Motion, wp.vec4d, CornersThen, f"{MODULE}.moving_overestimates")
