"""Triangles at rest or moving, in float64 with error bounds: one against a box or a segment, a hierarchy, its walks."""

from typing import Any

import numpy as np
import warp as wp

from warp_bounding.runtime.native import STRICT

# --- One triangle -----------------------------------------------------------------------------------------------------
#
# One triangle against one box, in float64: axes that prove them apart, and the closest point, up to rounding.
#
# A triangle is at rest, or each of its corners goes straight from ``a - u`` to ``a + u`` in a span of time. All that it
# is in between lies in the convex hull of the three corners, or of the six ends. A box is certified to be free of a
# triangle for one reason only: there is an axis on which this hull and the box, grown by a ball of the margin's radius,
# do not overlap. That is a proof for *any* axis, however it was computed, and for the whole span, so the search for one
# may be as careless as it likes and only ``separated`` has to be right. The axes tried are those of the separating axis
# theorem for a box and a triangle, of a moving one in the middle of its way (three face normals, the triangle's normal,
# nine products of edges; complete for a margin of 0 and a triangle at rest) and the directions between the closest
# points of box and triangle that alternating projections find (they are missing from the 13 where a corner is closest);
# for a moving triangle also those between box and hull, step by step (Frank and Wolfe's method). A degenerate triangle
# needs no case of its own: its null axes separate nothing.
#
# The box is always |x_k| <= half_k, and corners are relative to its centre. Who asks knows how large they are, and
# gives the ``slack``: a length that outweighs all rounding that begins with the corners and ways as they are given
# (``triangles.cells.SLACK`` for cells, ``rounding_margin`` for boxes of any size).
#
# Sources: Akenine-Moeller, "Fast 3D triangle-box overlap testing" (2001) for the axes; Frank and Wolfe, "An algorithm
# for quadratic programming" (1956).

# Axes shorter than this are not used: the squares of their components may underflow.
_SHORTEST = wp.constant(wp.float64(2.0**-400))
PROJECTIONS = 16  # alternating projections; what is neither near nor proven far by then is left to the axes
MOVING_PROJECTIONS = 3  # of a moving triangle in the middle of its way
STEPS = 12  # and of its hull
# Relative to the largest absolute coordinate M of corners and box and to the margin: with u = 2^-53, for an axis d with
# the sum |d| of its absolute components, float64 errs by less than
#   a corner relative to the centre (one rounding)                              u M |d|
#   its dot product with d, three products and two sums                         3 u M |d|
#   half * |d|, margin * length(d) and their sum                                6 u 2 M |d|
# together less than 2^-49 M |d|; this is 4 times that.
ROUNDING = 2.0**-47
# Outweighs the rounding of a length and of a division by it, four units.
_SHORTER = wp.constant(wp.float64(1.0 - 2.0**-50))
# Largest coordinate under which its cube might underflow: that a triangle crosses a box or a segment is not certain
# there.
SMALLEST = 2.0**-300
# Slack that outweighs underflow: times an axis of SHORTEST it is far above 2^-1074.
_LEAST = wp.constant(wp.float64(2.0**-500))

_PROJECTIONS = wp.constant(PROJECTIONS)
_MOVING_PROJECTIONS, _TRIES = wp.constant(MOVING_PROJECTIONS), wp.constant(MOVING_PROJECTIONS + STEPS)
_ROUNDING = wp.constant(wp.float64(ROUNDING))
_HALF = wp.constant(wp.float64(0.5))
_NEAR, _FREE, _UNDECIDED = wp.constant(0), wp.constant(1), wp.constant(2)


@wp.struct
class Triangle:
    """A triangle at rest."""

    a: wp.vec3d
    b: wp.vec3d
    c: wp.vec3d


@wp.struct
class MovingTriangle:
    """A triangle in the middle of its way, and half the way of each corner."""

    a: wp.vec3d
    b: wp.vec3d
    c: wp.vec3d
    u: wp.vec3d  # of a
    v: wp.vec3d  # of b
    w: wp.vec3d  # of c


@wp.func
def triangle_of(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d) -> Triangle:
    """The triangle of these corners."""
    t = Triangle()
    t.a = a
    t.b = b
    t.c = c
    return t


@wp.func_native(STRICT + "return size;")
def _by_ieee(size: wp.float64) -> wp.float64:  # a kernel that asks for this does not compile without IEEE arithmetic
    ...


@wp.func
def largest(x: wp.vec3d) -> wp.float64:
    """The largest absolute coordinate."""
    return wp.max(wp.abs(x[0]), wp.max(wp.abs(x[1]), wp.abs(x[2])))


@wp.func
def rounding_margin(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, half: wp.vec3d, margin: wp.float64) -> wp.float64:
    """A length that outweighs the rounding of ``separated`` for these numbers, each rounded once."""
    size = wp.max(wp.max(largest(a), largest(b)), wp.max(largest(c), largest(half)))
    return _ROUNDING * wp.max(_by_ieee(size), margin) + _LEAST


@wp.func
def slack_of(t: Triangle, half: wp.vec3d, margin: wp.float64) -> wp.float64:
    """``rounding_margin`` of a triangle."""
    return rounding_margin(t.a, t.b, t.c, half, margin)


@wp.func
def slack_of(t: MovingTriangle, half: wp.vec3d, margin: wp.float64) -> wp.float64:
    """``rounding_margin`` for bounds of the ends.

    A corner's product and that of its way err together as much as one of their sum, and by one more rounding.
    """
    return rounding_margin(
        wp.abs(t.a) + wp.abs(t.u), wp.abs(t.b) + wp.abs(t.v), wp.abs(t.c) + wp.abs(t.w), half, margin
    )


@wp.func
def range_along(d: wp.vec3d, t: Triangle) -> wp.vec2d:
    """The least and the largest product of corners with an axis."""
    pa, pb, pc = wp.dot(d, t.a), wp.dot(d, t.b), wp.dot(d, t.c)
    return wp.vec2d(wp.min(pa, wp.min(pb, pc)), wp.max(pa, wp.max(pb, pc)))


@wp.func
def range_along(d: wp.vec3d, t: MovingTriangle) -> wp.vec2d:
    """The same of the six ends."""
    pa, pb, pc = wp.dot(d, t.a), wp.dot(d, t.b), wp.dot(d, t.c)
    pu, pv, pw = wp.abs(wp.dot(d, t.u)), wp.abs(wp.dot(d, t.v)), wp.abs(wp.dot(d, t.w))
    return wp.vec2d(wp.min(pa - pu, wp.min(pb - pv, pc - pw)), wp.max(pa + pu, wp.max(pb + pv, pc + pw)))


@wp.func
def separated(d: wp.vec3d, t: Any, half: wp.vec3d, margin: wp.float64, slack: wp.float64) -> bool:
    """Is the triangle further than ``margin`` from the box |x_k| <= half_k, as axis d can tell? NaN cannot."""
    size = _by_ieee(wp.abs(d[0]) + wp.abs(d[1]) + wp.abs(d[2]))
    if not size > _SHORTEST:
        return False
    reach = wp.dot(half, wp.abs(d)) + slack * size + margin * wp.length(d)
    found = range_along(d, t)
    return found[0] > reach or found[1] < -reach


@wp.func
def _edge_separated(e: wp.vec3d, t: Any, half: wp.vec3d, margin: wp.float64, slack: wp.float64) -> bool:
    """Try the three axes that are products of a triangle's edge with the box's edges."""
    zero = wp.float64(0.0)
    if separated(wp.vec3d(zero, -e[2], e[1]), t, half, margin, slack):
        return True
    if separated(wp.vec3d(e[2], zero, -e[0]), t, half, margin, slack):
        return True
    return separated(wp.vec3d(-e[1], e[0], zero), t, half, margin, slack)


@wp.func
def apart(t: Any, half: wp.vec3d, margin: wp.float64, slack: wp.float64) -> bool:
    """Does one of the 13 axes separate the triangle from the box around 0, grown by the margin?"""
    zero, one = wp.float64(0.0), wp.float64(1.0)
    if separated(wp.vec3d(one, zero, zero), t, half, margin, slack):
        return True
    if separated(wp.vec3d(zero, one, zero), t, half, margin, slack):
        return True
    if separated(wp.vec3d(zero, zero, one), t, half, margin, slack):
        return True
    if separated(wp.cross(t.b - t.a, t.c - t.a), t, half, margin, slack):
        return True
    if _edge_separated(t.b - t.a, t, half, margin, slack):
        return True
    if _edge_separated(t.c - t.b, t, half, margin, slack):
        return True
    return _edge_separated(t.a - t.c, t, half, margin, slack)


@wp.func
def closest_on_segment(p: wp.vec3d, a: wp.vec3d, b: wp.vec3d) -> wp.vec3d:
    """Find a point of the segment nearest to p up to rounding."""
    length2 = wp.dot(b - a, b - a)
    if not length2 > wp.float64(0.0):
        return a
    return a + (b - a) * wp.clamp(wp.dot(p - a, b - a) / length2, wp.float64(0.0), wp.float64(1.0))


@wp.func
def closest_on_triangle(p: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d) -> wp.vec3d:
    """Find a point of the triangle, also of a degenerate one, nearest to p up to rounding.

    It is a sum of corners whose weights are at least 0 and sum up to 1, so it lies in the triangle whatever the
    rounding made of the weights, but for a few roundings of the largest coordinate.
    """
    zero = wp.float64(0.0)
    n = wp.cross(b - a, c - a)
    n2 = wp.dot(n, n)
    if n2 > zero:
        u = wp.dot(wp.cross(b - a, p - a), n)
        v = wp.dot(wp.cross(c - b, p - b), n)
        w = wp.dot(wp.cross(a - c, p - c), n)
        area = u + v + w
        if u >= zero and v >= zero and w >= zero and area > zero:
            return a * (v / area) + b * (w / area) + c * (u / area)
    best = closest_on_segment(p, a, b)
    q = closest_on_segment(p, b, c)
    if wp.length_sq(q - p) < wp.length_sq(best - p):
        best = q
    q = closest_on_segment(p, c, a)
    if wp.length_sq(q - p) < wp.length_sq(best - p):
        best = q
    return best


@wp.func
def _side(t: Triangle, half: wp.vec3d, margin: wp.float64, slack: wp.float64) -> int:
    """Alternating projections: the points tell that the box is near, or their direction proves that it is free."""
    q = closest_on_triangle(wp.vec3d(), t.a, t.b, t.c)
    for _ in range(_PROJECTIONS):
        d = q - wp.vec3d(
            wp.clamp(q[0], -half[0], half[0]), wp.clamp(q[1], -half[1], half[1]), wp.clamp(q[2], -half[2], half[2])
        )
        if wp.length_sq(d) <= margin * margin:
            return _NEAR
        if separated(d, t, half, margin, slack):
            return _FREE
        q = closest_on_triangle(q - d, t.a, t.b, t.c)
    return _UNDECIDED


@wp.func
def free(t: Triangle, half: wp.vec3d, margin: wp.float64, slack: wp.float64) -> bool:
    """Is it proven that the triangle is further than the margin from the box around 0?"""
    if margin > wp.float64(0.0):  # the direction decides most boxes at once, the 13 axes those that it leaves
        side = _side(t, half, margin, slack)
        if side != _UNDECIDED:
            return side == _FREE
    return apart(t, half, margin, slack)


@wp.func
def _towards(d: wp.vec3d, corner: wp.vec3d, way: wp.vec3d) -> wp.vec3d:
    """The end of a way that lies lower on an axis."""
    if wp.dot(d, way) > wp.float64(0.0):
        return corner - way
    return corner + way


@wp.func
def _lowest(d: wp.vec3d, t: MovingTriangle) -> wp.vec3d:
    """The end of the six that lies lowest on an axis."""
    best, other = _towards(d, t.a, t.u), _towards(d, t.b, t.v)
    if wp.dot(d, other) < wp.dot(d, best):
        best = other
    other = _towards(d, t.c, t.w)
    if wp.dot(d, other) < wp.dot(d, best):
        best = other
    return best


@wp.func
def free(t: MovingTriangle, half: wp.vec3d, margin: wp.float64, slack: wp.float64) -> bool:
    """Is it proven that the triangle is, on all its way, further than the margin from the box around 0?"""
    zero, one = wp.float64(0.0), wp.float64(1.0)
    q = closest_on_triangle(wp.vec3d(), t.a, t.b, t.c)
    for turn in range(_TRIES):
        d = q - wp.min(wp.max(q, -half), half)
        if wp.length_sq(d) <= margin * margin:
            return False
        if separated(d, t, half, margin, slack):
            return True
        if turn < _MOVING_PROJECTIONS:
            q = closest_on_triangle(q - d, t.a, t.b, t.c)
        else:
            step = _lowest(d, t) - q
            length2 = wp.length_sq(step)
            if not length2 > zero:
                break
            q += step * wp.clamp(-wp.dot(d, step) / length2, zero, one)
    return apart(t, half, margin, slack)


@wp.func
def segment_separated(d: wp.vec3d, t: Any, s: wp.vec3d, margin: wp.float64, slack: wp.float64) -> bool:
    """Is the triangle further than ``margin`` from the segment from 0 to s, as axis d can tell? NaN cannot."""
    size = wp.abs(d[0]) + wp.abs(d[1]) + wp.abs(d[2])
    if not size > _SHORTEST:
        return False
    zero, ps = wp.float64(0.0), wp.dot(d, s)
    reach = slack * size + margin * wp.length(d)
    found = range_along(d, t)
    return found[0] > wp.max(ps, zero) + reach or found[1] < wp.min(ps, zero) - reach


@wp.func
def segment_free(t: Any, s: wp.vec3d, margin: wp.float64, slack: wp.float64) -> bool:
    """Is it proven, by the axes that are complete in general position, that the segment from 0 to s is far enough?"""
    zero, one = wp.float64(0.0), wp.float64(1.0)
    if segment_separated(wp.cross(t.b - t.a, t.c - t.a), t, s, margin, slack):
        return True
    if segment_separated(wp.cross(t.b - t.a, s), t, s, margin, slack):
        return True
    if segment_separated(wp.cross(t.c - t.b, s), t, s, margin, slack):
        return True
    if segment_separated(wp.cross(t.a - t.c, s), t, s, margin, slack):
        return True
    if segment_separated(wp.vec3d(one, zero, zero), t, s, margin, slack):
        return True
    if segment_separated(wp.vec3d(zero, one, zero), t, s, margin, slack):
        return True
    return segment_separated(wp.vec3d(zero, zero, one), t, s, margin, slack)


@wp.func
def distance_along(d: wp.vec3d, t: Any, slack: wp.float64) -> wp.float64:
    """Lower bound of the distance from 0 to the triangle by axis d; 0 where it cannot tell."""
    size = wp.abs(d[0]) + wp.abs(d[1]) + wp.abs(d[2])
    if not size > _SHORTEST:
        return wp.float64(0.0)
    found = range_along(d, t)
    gap = wp.max(found[0], -found[1]) - slack * size
    return wp.max(gap / wp.length(d) * _SHORTER, wp.float64(0.0))


# --- The hierarchy ----------------------------------------------------------------------------------------------------
#
# A hierarchy of boxes over triangles: a balanced binary tree, walked in one direction and without a stack.
#
# Triangles are sorted so that every node of level l holds a stretch of them, halved at the median along the longest
# side of the box around its triangles' centres, those of several keyframes if they move. Nodes lie in the order in
# which a walk meets them: a node's first child comes right after it, and each node tells where a walk goes on that
# leaves its children out. So a walk is a loop over one number, the same on a CPU and on CUDA. Boxes are those of
# float32 vertices, so they are exact.
#
# Of triangles that move there is one tree for all times, with a box of each node at each keyframe. Between two
# keyframes each coordinate of a corner goes straight, so the box of a node at a time lies within what is interpolated
# between its boxes at both. Boxes of a keyframe are made when they are first needed.
#
# A kernel asks both kinds for ``triangle_at``, ``gap``, ``way_of`` and ``looseness``; all else is one.

LEAF = 4  # triangles of a leaf at most; 2 and 8 were slower for boxes near a bunny
_STEP = wp.constant(2.0**-22)  # relative: twice what rounding a float64 number to float32 may change
_TINIEST = wp.constant(2.0**-140)  # and where that is subnormal
_WIDER = wp.constant(1.0 + 2.0**-18)  # relative: far more than a squared gap's rounding in float32, 2^-21
SORTED_BY = 8  # keyframes at most that triangles are sorted by
# Relative to the largest coordinate M: with u = 2^-24, float32 rounds a share (1 u of a way of up to 2 M) and an
# interpolation (4 u M); this is more than twice as much.
BOX_ROOM = 2.0**-20
# Relative to the largest coordinate M: with u = 2^-53, a corner that is interpolated at a share errs by less than
#   the share, 4 u of a way of up to 2 M          8 u M
#   the way, its product and the sum              7 u M
# together less than 2^-49 M; this is twice as much.
LOOSE = 2.0**-48

_FAR = wp.constant(wp.float64(2.0**127))
_LOOSE_OF_ROOM = wp.constant(wp.float64(LOOSE / BOX_ROOM))


@wp.struct
class Triangles:
    """What a kernel walks over. An empty hierarchy has a count of 0."""

    count: int  # nodes
    lower: wp.array(dtype=wp.vec3)  # of the nodes' boxes
    upper: wp.array(dtype=wp.vec3)
    # Of a node: the first triangle, one past the last (none but in leaves), and the node after the subtree.
    links: wp.array(dtype=wp.vec3i)
    corners: wp.array(dtype=wp.vec3)  # three a triangle
    cycles: wp.array(dtype=wp.uint64)  # of a triangle: see ``surfaces.py``


@wp.struct
class Span:
    """A closed span of time between two neighbouring keyframes."""

    key: int  # the first keyframe
    begin: wp.float64  # as a share of the way to the next one
    end: wp.float64


@wp.struct
class Ways:
    """The same for triangles that move, in a span of time (``during``)."""

    span: Span
    count: int
    room: float  # outweighs the rounding of a node's box
    times: wp.array(dtype=wp.float64)  # (K,), of the keyframes
    vertices: wp.array2d(dtype=wp.vec3)  # (K, V)
    lower: wp.array2d(dtype=wp.vec3)  # (K, nodes)
    upper: wp.array2d(dtype=wp.vec3)
    links: wp.array(dtype=wp.vec3i)
    faces: wp.array(dtype=wp.vec3i)  # vertices of the triangles, in the order of leaves
    cycles: wp.array(dtype=wp.uint64)


@wp.func
def span_of(key: int, begin: wp.float64, end: wp.float64) -> Span:
    """The span of these numbers."""
    span = Span()
    span.key = key
    span.begin = begin
    span.end = end
    return span


@wp.func
def span_between(times: wp.array(dtype=wp.float64), key: int, begin: wp.float64, end: wp.float64) -> Span:
    """What the times from ``begin`` to ``end`` have in common with the way from a keyframe to the next, if anything."""
    zero, one = wp.float64(0.0), wp.float64(1.0)
    first, last = times[key], times[key + 1]
    return span_of(
        key, wp.clamp((begin - first) / (last - first), zero, one), wp.clamp((end - first) / (last - first), zero, one)
    )


@wp.func
def during(ways: Ways, span: Span) -> Ways:
    """The triangles in a span of time."""
    t = Ways()
    t.span = span
    t.count = ways.count
    t.room = ways.room
    t.times = ways.times
    t.vertices = ways.vertices
    t.lower = ways.lower
    t.upper = ways.upper
    t.links = ways.links
    t.faces = ways.faces
    t.cycles = ways.cycles
    return t


@wp.func
def float_below(x: wp.float64) -> float:
    """A float32 number, or minus infinity, that is not above x, and near it, where x is under 2^127."""
    y = float(wp.min(x, _FAR))
    return y - (wp.abs(y) * _STEP + _TINIEST)


@wp.func
def float_above(x: wp.float64) -> float:
    """A float32 number, or infinity, that is not below x, and near it, where x is above -2^127."""
    y = float(wp.max(x, -_FAR))
    return y + (wp.abs(y) * _STEP + _TINIEST)


@wp.func
def floats_below(x: wp.vec3d) -> wp.vec3:
    """``float_below`` of each coordinate."""
    return wp.vec3(float_below(x[0]), float_below(x[1]), float_below(x[2]))


@wp.func
def floats_above(x: wp.vec3d) -> wp.vec3:
    """``float_above`` of each coordinate."""
    return wp.vec3(float_above(x[0]), float_above(x[1]), float_above(x[2]))


@wp.func
def squared_reach(margin: wp.float64) -> float:
    """A float32 number above the square of the margin, by more than what float32 makes of a squared gap."""
    return float_above(margin * margin) * _WIDER


@wp.func
def beyond(x: wp.vec3d, lower: wp.vec3d, upper: wp.vec3d) -> bool:
    """Is a point outside of a box?"""
    for k in range(3):  # noqa: SIM110 (a kernel has no ``any``)
        if x[k] < lower[k] or x[k] > upper[k]:
            return True
    return False


@wp.func
def wide(x: wp.vec3) -> wp.vec3d:
    """The same numbers in float64."""
    return wp.vec3d(wp.float64(x[0]), wp.float64(x[1]), wp.float64(x[2]))


@wp.func
def corner(t: Triangles, triangle: int, k: int, origin: wp.vec3d) -> wp.vec3d:
    """A triangle's corner, relative to a point: each coordinate is rounded once."""
    return wide(t.corners[3 * triangle + k]) - origin


@wp.func
def _triangle_of(corners: wp.array(dtype=wp.vec3), i: int, origin: wp.vec3d) -> Triangle:
    a, b, c = wide(corners[3 * i]), wide(corners[3 * i + 1]), wide(corners[3 * i + 2])
    return triangle_of(a - origin, b - origin, c - origin)


@wp.func
def triangle_at(t: Triangles, i: int, origin: wp.vec3d) -> Triangle:
    """A triangle, relative to a point: each coordinate is rounded once."""
    return _triangle_of(t.corners, i, origin)  # so short that the compiler makes no copy of t


@wp.func
def triangle_at(t: Ways, i: int, origin: wp.vec3d) -> MovingTriangle:
    """A triangle's way in the span, relative to a point, up to a few roundings of the largest coordinates."""
    share, half = (t.span.begin + t.span.end) * _HALF, (t.span.end - t.span.begin) * _HALF
    face, key = t.faces[i], t.span.key
    a, b, c = wide(t.vertices[key, face[0]]), wide(t.vertices[key, face[1]]), wide(t.vertices[key, face[2]])
    u = wide(t.vertices[key + 1, face[0]]) - a
    v = wide(t.vertices[key + 1, face[1]]) - b
    w = wide(t.vertices[key + 1, face[2]]) - c
    moving = MovingTriangle()
    moving.a = a + u * share - origin
    moving.b = b + v * share - origin
    moving.c = c + w * share - origin
    moving.u = u * half
    moving.v = v * half
    moving.w = w * half
    return moving


@wp.func
def way_of(t: Triangle) -> wp.float64:
    """How far a corner goes from the middle of its way."""
    return wp.float64(0.0)


@wp.func
def way_of(t: MovingTriangle) -> wp.float64:
    """How far a corner goes from the middle of its way."""
    return wp.max(wp.length(t.u), wp.max(wp.length(t.v), wp.length(t.w)))


@wp.func
def looseness(t: Triangles) -> wp.float64:
    """By how much the corners of ``triangle_at`` may be wrong, but for the rounding of each."""
    return wp.float64(0.0)


@wp.func
def looseness(t: Ways) -> wp.float64:
    """The same; ``room`` is ``BOX_ROOM`` of the largest coordinate."""
    return _LOOSE_OF_ROOM * wp.float64(t.room)


@wp.func
def gap(t: Triangles, node: int, lower: wp.vec3, upper: wp.vec3) -> float:
    """The squared distance of a box to that of a node."""
    gap = wp.max(wp.max(t.lower[node] - upper, lower - t.upper[node]), wp.vec3())
    return wp.dot(gap, gap)


@wp.func
def gap(t: Ways, node: int, lower: wp.vec3, upper: wp.vec3) -> float:
    """The squared distance of a box to that of a node in the span."""
    begin, end, key = float(t.span.begin), float(t.span.end), t.span.key
    a, b, c, d = t.lower[key, node], t.lower[key + 1, node], t.upper[key, node], t.upper[key + 1, node]
    low, high = a * (1.0 - begin) + b * begin, c * (1.0 - begin) + d * begin
    if end > begin:
        low = wp.min(low, a * (1.0 - end) + b * end)
        high = wp.max(high, c * (1.0 - end) + d * end)
    room = wp.vec3(t.room, t.room, t.room)
    gap = wp.max(wp.max(low - upper, lower - high) - room, wp.vec3())
    return wp.dot(gap, gap)


@wp.func
def next_leaf(t: Any, start: int, lower: wp.vec3, upper: wp.vec3, reach: float) -> int:
    """Go on with a walk: the first leaf from a node whose box is near enough, or the number of nodes.

    The box that is asked about is rounded outwards; ``reach`` is the ``squared_reach`` of the margin.
    """
    node = wp.int32(start)
    while node < t.count:
        if gap(t, node, lower, upper) <= reach:
            if t.links[node][1] > 0:
                return node
            node += 1
        else:
            node = t.links[node][2]
    return node


def build(corners: np.ndarray, cycles: np.ndarray | None = None) -> Triangles:
    """A hierarchy, on the CPU, of triangles at rest ``(F, 3, 3)`` float32, with ``cycles`` ``(F,)`` uint64 or zeros."""
    cycles = np.zeros(len(corners), dtype=np.uint64) if cycles is None else cycles
    low, high = _boxes(corners)
    order = _order([(low, high)])
    lower, upper, links = nodes_of(low[order], high[order])
    made = Triangles()
    made.count = len(links)
    made.lower, made.upper, made.corners = (
        wp.array(x.reshape(-1, 3), dtype=wp.vec3, device="cpu") for x in (lower, upper, corners[order])
    )
    made.links = wp.array(links, dtype=wp.vec3i, device="cpu")
    made.cycles = wp.array(cycles[order], dtype=wp.uint64, device="cpu")
    return made


class MovingTriangles:
    """A hierarchy, on the CPU, of triangles that move: times ``(K,)``, frames ``(K, V, 3)``, faces ``(F, 3)``."""

    def __init__(self, times: np.ndarray, frames: np.ndarray, faces: np.ndarray, cycles: np.ndarray | None = None):
        self._frames = frames
        cycles = np.zeros(len(faces), dtype=np.uint64) if cycles is None else cycles
        keys = np.unique(np.linspace(0, len(frames) - 1, SORTED_BY).astype(int))
        order = _order([_boxes(frames[k][faces]) for k in keys])
        self._faces = np.ascontiguousarray(faces[order], dtype=np.int32)
        links = nodes_of(*_boxes(frames[0][self._faces]))[2]
        self._lower, self._upper = (np.empty((len(frames), len(links), 3), dtype=np.float32) for _ in "lu")
        self._known = np.zeros(len(frames), dtype=bool)
        arrays = {
            "times": (np.asarray(times, dtype=np.float64), wp.float64),
            "vertices": (frames, wp.vec3),
            "lower": (self._lower, wp.vec3),
            "upper": (self._upper, wp.vec3),
            "links": (links, wp.vec3i),
            "faces": (self._faces, wp.vec3i),
            "cycles": (cycles[order], wp.uint64),
        }
        self.ways = Ways()
        self.ways.count = len(links)
        if len(faces):
            self.ways.room = float(np.abs(frames[:, np.unique(faces)]).max()) * BOX_ROOM
        self._arrays = {name: wp.array(a, dtype=d, device="cpu", copy=False) for name, (a, d) in arrays.items()}
        for name, array in self._arrays.items():
            setattr(self.ways, name, array)

    def know(self, keys: np.ndarray) -> None:
        """Make the boxes of keyframes, if there are none yet."""
        for k in np.asarray(keys)[~self._known[keys]]:
            self._lower[k], self._upper[k], _ = nodes_of(*_boxes(self._frames[k][self._faces]))
            self._known[k] = True


def _boxes(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``(F, 3)`` and ``(F, 3)``, the boxes of triangles ``(F, 3, 3)``."""
    return corners.min(axis=1), corners.max(axis=1)


def _order(boxes: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """``sorted_order`` of triangles by the middles of their boxes, one or several of each."""
    return sorted_order(np.concatenate([low / np.float32(2) + high / np.float32(2) for low, high in boxes], axis=1))


def _depth(count: int) -> int:
    """Levels below the root, of a hierarchy of so many triangles."""
    return max(0, int(np.ceil(np.log2(max(count, 1) / LEAF))))


def _edges(count: int, level: int) -> np.ndarray:
    """Where the stretches of a level's nodes begin, and the end."""
    return (np.arange(2**level + 1) * count) >> level


def sorted_order(centres: np.ndarray) -> np.ndarray:
    """``(F,)`` int64: by levels, each node's range is sorted by centres ``(F, n)`` along its box's longest side."""
    order = np.arange(len(centres))
    for level in range(_depth(len(centres))):
        first = _edges(len(order), level)
        node = np.repeat(np.arange(2**level), np.diff(first))
        there = centres[order]
        low, high = np.minimum.reduceat(there, first[:-1]), np.maximum.reduceat(there, first[:-1])
        axis = np.argmax(high - low, axis=1)[node]
        order = order[np.lexsort((there[np.arange(len(order)), axis], node))]
    return order


def nodes_of(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Boxes and links of all nodes, in the order of a walk, for float32 boxes ``(F, n)`` of sorted triangles."""
    if not len(low):
        return low, high, np.zeros((0, 3), dtype=np.int32)
    depth = _depth(len(low))
    total = 2 ** (depth + 1) - 1
    lower, upper = (np.zeros((total, low.shape[1]), dtype=np.float32) for _ in "lu")
    links = np.zeros((total, 3), dtype=np.int32)
    place = np.zeros(1, dtype=np.int64)
    for level in range(depth + 1):
        first = _edges(len(low), level)
        subtree = 2 ** (depth - level + 1) - 1  # nodes of it
        lower[place] = np.minimum.reduceat(low, first[:-1])
        upper[place] = np.maximum.reduceat(high, first[:-1])
        links[place, 2] = place + subtree
        if level == depth:
            links[place, 0], links[place, 1] = first[:-1], first[1:]
        place = np.stack([place + 1, place + 1 + subtree // 2], axis=1).ravel()
    return lower, upper, links


# --- Walks ------------------------------------------------------------------------------------------------------------


@wp.func
def _leaf_is_free(t: Any, leaf: int, centre: wp.vec3d, half: wp.vec3d, margin: wp.float64) -> bool:
    link = t.links[leaf]
    for i in range(link[0], link[1]):
        face = triangle_at(t, i, centre)
        if not free(face, half, margin, slack_of(face, half, margin)):
            return False
    return True


@wp.func
def box_is_free(t: Any, centre: wp.vec3d, half: wp.vec3d, margin: wp.float64) -> bool:
    """Is every triangle proven to be beyond the margin from the closed box around the centre, in all of the span?"""
    lower, upper, reach = floats_below(centre - half), floats_above(centre + half), squared_reach(margin)
    leaf = next_leaf(t, 0, lower, upper, reach)
    while leaf < t.count:
        if not _leaf_is_free(t, leaf, centre, half, margin):
            return False
        leaf = next_leaf(t, leaf + 1, lower, upper, reach)
    return True


@wp.func
def segment_is_free(t: Any, start: wp.vec3d, end: wp.vec3d, margin: wp.float64) -> bool:
    """Is every triangle proven to be further than the margin from the closed segment, in all of the span?"""
    lower, upper = floats_below(wp.min(start, end)), floats_above(wp.max(start, end))
    reach, s = squared_reach(margin), end - start
    leaf = next_leaf(t, 0, lower, upper, reach)
    while leaf < t.count:
        link = t.links[leaf]
        for i in range(link[0], link[1]):
            face = triangle_at(t, i, start)
            if not segment_free(face, s, margin, slack_of(face, wp.abs(s), margin)):
                return False
        leaf = next_leaf(t, leaf + 1, lower, upper, reach)
    return True


@wp.func
def _leaf_holds(t: Any, leaf: int, centre: wp.vec3d, radius: wp.float64, margin: wp.float64) -> bool:
    zero = wp.vec3d()
    link = t.links[leaf]
    for i in range(link[0], link[1]):
        face = triangle_at(t, i, centre)
        far = wp.length(closest_on_triangle(zero, face.a, face.b, face.c)) + way_of(face) + radius
        if far + slack_of(face, zero, margin) <= margin:
            return True
    return False


@wp.func
def holds(t: Any, centre: wp.vec3d, radius: wp.float64, margin: wp.float64) -> bool:
    """Does the ball around the centre lie within the margin of a single triangle for certain, in all of the span?"""
    if not radius < margin:
        return False
    lower, upper, reach = floats_below(centre), floats_above(centre), squared_reach(margin - radius)
    leaf = next_leaf(t, 0, lower, upper, reach)
    while leaf < t.count:
        if _leaf_holds(t, leaf, centre, radius, margin):
            return True
        leaf = next_leaf(t, leaf + 1, lower, upper, reach)
    return False


# --- Rays -------------------------------------------------------------------------------------------------------------
#
# Is a point enclosed by triangles for certain? Rays along the axes count what they cross (``surfaces.py``).
#
# Where faces are turned alike, so that each edge is run through as often one way as the other, the crossings with their
# signs add up to the winding number of the surface around the point, the same along every ray.
#
# Every sign is that of the exact number, or it is unknown, and then so is the answer of the ray.

UNWOUND = 2**30  # instead of a winding number that is not certain

# With u = 2^-53. A difference of two products of coordinates, each rounded once, errs by less than 4 u (|left| +
# |right|). A determinant n a, where n is the product of two edges as computed from coordinates up to M, errs by less
# than 80 u M^2 (|e| + |f|), where |e| and |f| are the edges' largest components. Of coordinates that are known up to a
# length L only, the difference errs by another L (sum of their absolute values + 2 L), and the determinant, the edges
# of which err by 2 L, by less than 18 L (M + L) (|e| + |f| + 8 L). What is added for that is more than 3 times as much.
_TURN = wp.constant(wp.float64(2.0**-50))
_HEIGHT = wp.constant(wp.float64(2.0**-46))
_UNDERFLOW = wp.constant(wp.float64(2.0**-1000))  # outweighs products that are subnormal

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
    """Does a line through 0 along an axis cross a triangle of this turn: above 0 (1), below (-1), or unknown (0)?"""
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

    The ray goes upwards. Corners are rounded once, and may be wrong by ``loose`` beyond that: the answer holds for all
    that.
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
def _crossed_cycles(t: Any, x: wp.vec3d, axis: int) -> wp.uint64:
    """The exclusive or of the numbers of triangles that an axis ray from x crosses; 0 where that is uncertain."""
    loose = looseness(t)
    lower, upper, reach = floats_below(x), floats_above(x), squared_reach(wp.float64(0.0))
    upper[axis] = _INFINITY
    crossed = wp.uint64(0)
    leaf = next_leaf(t, 0, lower, upper, reach)
    while leaf < t.count:
        link = t.links[leaf]
        for i in range(link[0], link[1]):
            if t.cycles[i] != wp.uint64(0):
                face = triangle_at(t, i, x)
                crosses = crossing(face.a, face.b, face.c, axis, loose)
                if crosses < 0:
                    return wp.uint64(0)
                if crosses > 0:
                    crossed = crossed ^ t.cycles[i]
        leaf = next_leaf(t, leaf + 1, lower, upper, reach)
    return crossed


@wp.func
def is_enclosed(t: Any, x: wp.vec3d) -> bool:
    """Is it proven, by rays along the axes, that x is enclosed by the triangles, at the single time of the span?"""
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
