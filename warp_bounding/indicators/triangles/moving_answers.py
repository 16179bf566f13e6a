"""What a dilated motion answers, in kernels: points and boxes of time and space, distances, and half-spaces."""

from functools import cached_property

import numpy as np
import warp as wp

from warp_bounding.indicators.shape import IN, OUT, UNDECIDED, HalfSpaces
from warp_bounding.indicators.surfaces import cycles_of
from warp_bounding.indicators.triangles.answers import (
    LIMIT,
    LONGER,
    OUTWARD,
    ROOM,
    SHORTER,
    SHORTEST,
    AskedSolid,
    Stack,
    closest,
    gap_of_box,
    half_of,
    is_box,
    proven_distance,
)
from warp_bounding.indicators.triangles.cells import ENCLOSED, OUTSIDE
from warp_bounding.indicators.triangles.hierarchy import (
    floats_above,
    floats_below,
    largest,
    rounding_slack,
    squared_reach,
    wide,
)
from warp_bounding.indicators.triangles.moving import (
    Moving,
    MovingSides,
    MovingTriangles,
    Pieces,
    Span,
    Ways,
    moving_at,
    moving_box_is_free,
    moving_holds,
    next_moving_leaf,
    outside_in,
    side_in,
    span_between,
    span_of,
)
from warp_bounding.runtime.launch import launch_on_cores

# --- Points, and boxes that are empty or inside -----------------------------------------------------------------------

_LIMIT = wp.constant(wp.float64(LIMIT))
_OUTWARD = wp.constant(wp.float64(OUTWARD))
_HALF = wp.constant(wp.float64(0.5))
_IN, _OUT, _UNDECIDED = wp.constant(IN), wp.constant(OUT), wp.constant(UNDECIDED)
_ENCLOSED, _OUTSIDE = wp.constant(ENCLOSED), wp.constant(OUTSIDE)


@wp.struct
class Motion:
    """A motion that is dilated. Faces may be elsewhere by the rounding."""

    lower: wp.vec4d  # the box that holds the dilated object, time first
    upper: wp.vec4d
    rounding: wp.float64
    reach: wp.float64  # the margin and the rounding: what is farther from a face is not within the margin of it
    hold: wp.float64  # the margin less the rounding, maybe below 0: what is nearer is within the margin
    faces: Ways  # all of them
    closed: Ways  # those of closed parts
    pieces: Pieces


@wp.func
def place_of(x: wp.vec4d) -> wp.vec3d:
    """All but the time."""
    return wp.vec3d(x[1], x[2], x[3])


@wp.func
def key_at(times: wp.array(dtype=wp.float64), time: wp.float64) -> int:
    """The last keyframe but one, or the last one before that which is not after a time."""
    low, high = wp.int32(0), times.shape[0] - 1
    while high - low > 1:
        middle = (low + high) // 2
        if times[middle] <= time:
            low = middle
        else:
            high = middle
    return low


@wp.func
def _point(m: Motion, x: wp.vec4d) -> int:
    for k in range(4):
        if not (x[k] >= m.lower[k] and x[k] <= m.upper[k]):  # NaN is nowhere
            return _OUT
    place, zero = place_of(x), wp.vec3d()
    if not largest(place) < _LIMIT:
        return _UNDECIDED
    span = span_between(m.faces.times, key_at(m.faces.times, x[0]), x[0], x[0])
    if moving_box_is_free(m.faces, span, place, zero, m.reach):
        side = side_in(m.closed, m.pieces, span, place)
        if side == _OUTSIDE:
            return _OUT
        if side == _ENCLOSED:
            return _IN
        return _UNDECIDED
    if moving_holds(m.faces, span, place, wp.float64(0.0), m.hold):
        return _IN
    if moving_box_is_free(m.closed, span, place, zero, m.rounding):  # noqa: SIM102 (a kernel's ``and`` would not wait)
        if side_in(m.closed, m.pieces, span, place) == _ENCLOSED:
            return _IN
    return _UNDECIDED


@wp.kernel(enable_backward=False, module="warp_bounding.indicators.triangles.moving")
def decide_moments(
    first: int,
    # inputs
    m: Motion,
    x: wp.array(dtype=wp.vec4d),
    # outputs
    answers: wp.array(dtype=wp.uint8),
):
    """Is a point in the object at its time?"""
    i, _ = wp.tid()
    i += first
    answers[i] = wp.uint8(_point(m, x[i]))


@wp.func
def is_empty(m: Motion, lower: wp.vec4d, upper: wp.vec4d) -> bool:
    """Is it certain that a closed box of time and space holds no point of the object?"""
    for k in range(4):
        if not lower[k] <= upper[k]:
            return False
    for k in range(4):
        if upper[k] < m.lower[k] or lower[k] > m.upper[k]:
            return True
    low, high = place_of(lower), place_of(upper)
    if not is_box(low, high):
        return False
    begin, end = wp.max(lower[0], m.lower[0]), wp.min(upper[0], m.upper[0])
    centre = low * _HALF + high * _HALF
    half = half_of(low, high, centre)
    key = key_at(m.faces.times, begin)
    while key < m.faces.times.shape[0] - 1 and m.faces.times[key] <= end:
        span = span_between(m.faces.times, key, begin, end)
        if not moving_box_is_free(m.faces, span, centre, half, m.reach):
            return False
        if not outside_in(m.closed, m.pieces, span, centre):
            return False
        key += 1
    return True


@wp.kernel(enable_backward=False, module="warp_bounding.indicators.triangles.moving")
def find_empty_spans(
    first: int,
    # inputs
    m: Motion,
    lower: wp.array(dtype=wp.vec4d),
    upper: wp.array(dtype=wp.vec4d),
    # outputs
    answers: wp.array(dtype=wp.uint8),
):
    """Is it certain that a closed box of time and space holds no point of the object?"""
    i, _ = wp.tid()
    i += first
    answers[i] = wp.uint8(is_empty(m, lower[i], upper[i]))


@wp.func
def _inside(m: Motion, lower: wp.vec4d, upper: wp.vec4d) -> bool:
    low, high = place_of(lower), place_of(upper)
    begin, end = lower[0], upper[0]
    if not (is_box(low, high) and begin <= end and begin >= m.lower[0] and end <= m.upper[0]):
        return False
    centre = low * _HALF + high * _HALF
    half = half_of(low, high, centre)
    radius = wp.length(half) * _OUTWARD
    key = key_at(m.faces.times, begin)
    while key < m.faces.times.shape[0] - 1 and m.faces.times[key] <= end:
        span = span_between(m.faces.times, key, begin, end)
        if not moving_holds(m.faces, span, centre, radius, m.hold):
            instant = span_of(key, span.begin, span.begin)
            if not (
                moving_box_is_free(m.closed, span, centre, half, m.rounding)
                and side_in(m.closed, m.pieces, instant, centre) == _ENCLOSED
            ):
                return False
        key += 1
    return True


@wp.kernel(enable_backward=False, module="warp_bounding.indicators.triangles.moving")
def find_inside_spans(
    first: int,
    # inputs
    m: Motion,
    lower: wp.array(dtype=wp.vec4d),
    upper: wp.array(dtype=wp.vec4d),
    # outputs
    answers: wp.array(dtype=wp.uint8),
):
    """Is it certain that a closed box of time and space lies in the object whole?"""
    i, _ = wp.tid()
    i += first
    answers[i] = wp.uint8(_inside(m, lower[i], upper[i]))


# --- Distances --------------------------------------------------------------------------------------------------------
#
# How far in space are points from a dilated motion at their time? Certified bounds from both sides.
#
# At a single time a triangle that moves stands still, so the walk and the proofs are those of ``triangles/answers.py``.
# Vertices may be elsewhere by the motion's rounding, which widens what is known of them.

_SHORTER, _LONGER = wp.constant(wp.float64(SHORTER)), wp.constant(wp.float64(LONGER))
_INFINITY = wp.constant(wp.float64(float("inf")))


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


@wp.kernel(enable_backward=False, module="warp_bounding.indicators.triangles.moving_distances")
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


# --- Overestimates ----------------------------------------------------------------------------------------------------
#
# By how much can a function exceed the distance to a dilated motion, in a box of time and space? Certified upper
# bounds, as of ``triangles/answers.py``.
#
# Between two keyframes corners go straight. For a unit vector n, the support of a triangle along n at a time is the
# largest of three linear functions of it, and that of a node's box is linear: convex in time, both. So the function,
# which is multilinear between the numbers at the box's corners, less ``n . x`` and plus the support is largest at a
# corner of the box of time and space, and the supports at its first and its last time are enough. As any multiple of
# the plane, from 0 to 1, is under the distance, too, the function's own slope is taken as well as 1
# (``box_distances.py``).
#
# Where the box may hold a point of a face, or an enclosed one, all that is known is the function's largest value.

_ROOM, _SHORTEST = wp.constant(wp.float64(ROOM)), wp.constant(wp.float64(SHORTEST))
_ZERO, _ONE = wp.constant(wp.float64(0.0)), wp.constant(wp.float64(1.0))
CornersThen = wp.types.vector(length=16, dtype=wp.float64)  # bit 0 is time


@wp.struct
class AskedFunction:
    """A box of time and space, and the function's numbers at its corners."""

    span: Span
    centre: wp.vec3d
    half: wp.vec3d
    values: CornersThen
    room: wp.float64
    highest: wp.float64


@wp.func
def _along(half: wp.vec3d, n: wp.vec3d, corner: int) -> wp.float64:
    x = wp.vec3d(
        wp.where(corner & 2, half[0], -half[0]),
        wp.where(corner & 4, half[1], -half[1]),
        wp.where(corner & 8, half[2], -half[2]),
    )
    return wp.dot(n, x)


@wp.func
def _number(box: AskedFunction, n: wp.vec3d, begin: wp.float64, end: wp.float64) -> wp.float64:
    """The largest value less the plane under the distance, whole or as steep as the function.

    Supports are at both times, from the centre.
    """
    rise, run = _ZERO, _ZERO
    for i in range(16):
        along = _along(box.half, n, i)
        rise += box.values[i] * along
        run += along * along
    share = _ONE
    if run > _ZERO:
        share = wp.clamp(rise / run, _ZERO, _ONE)
    whole, part = -_INFINITY, -_INFINITY
    for i in range(16):
        plane = wp.where(i & 1, end, begin) - _along(box.half, n, i)
        whole = wp.max(whole, box.values[i] + plane)
        part = wp.max(part, box.values[i] + share * plane)
    return wp.min(whole, part) + box.room


@wp.func
def _box_at(ways: Ways, span: Span, node: int, share: float, centre: wp.vec3d):
    """A node's box when a share of the way to the next keyframe is over, from a point."""
    room = wp.vec3(ways.room, ways.room, ways.room)
    low = ways.lower[span.key, node] * (1.0 - share) + ways.lower[span.key + 1, node] * share - room
    high = ways.upper[span.key, node] * (1.0 - share) + ways.upper[span.key + 1, node] * share + room
    return wide(low) - centre, wide(high) - centre


@wp.func
def _support(n: wp.vec3d, low: wp.vec3d, high: wp.vec3d) -> wp.float64:
    support = _ZERO
    for k in range(3):
        support += wp.max(n[k] * low[k], n[k] * high[k])
    return support


@wp.func
def _node_excess(ways: Ways, box: AskedFunction, node: int) -> wp.vec2d:
    """The number of a node, infinite where it has no direction, and its distance."""
    begin, end = float(box.span.begin), float(box.span.end)
    low, high = _box_at(ways, box.span, node, begin, box.centre)
    low_then, high_then = _box_at(ways, box.span, node, end, box.centre)
    q = wp.max((low + low_then) * _HALF, wp.min((high + high_then) * _HALF, wp.vec3d()))
    away = wp.length(q)
    if not away > _SHORTEST:
        return wp.vec2d(_INFINITY, _ZERO)
    n = q / -away
    return wp.vec2d(_number(box, n, _support(n, low, high), _support(n, low_then, high_then)), away)


@wp.func
def _leaf_excess(ways: Ways, box: AskedFunction, leaf: int, known: wp.float64) -> wp.float64:
    """The largest number of a leaf's triangles, and of what is known."""
    link = ways.links[leaf]
    for i in range(link[0], link[1]):
        t = moving_at(ways, box.span, i, box.centre)
        q = closest(t.a, t.b, t.c)
        away = wp.length(q)
        if away > _SHORTEST:
            n = q / -away
            begin = wp.max(wp.dot(n, t.a - t.u), wp.max(wp.dot(n, t.b - t.v), wp.dot(n, t.c - t.w)))
            end = wp.max(wp.dot(n, t.a + t.u), wp.max(wp.dot(n, t.b + t.v), wp.dot(n, t.c + t.w)))
            known = wp.max(known, wp.min(box.highest, _number(box, n, begin, end)))
        else:
            known = wp.max(known, box.highest)
    return known


@wp.func
def _excess(ways: Ways, box: AskedFunction, least: wp.float64, enough: wp.float64) -> wp.float64:
    """The largest number of all pieces; see ``triangles/answers.py``."""
    known = wp.min(least, box.highest)
    stack, depth, node = Stack(), wp.int32(0), wp.int32(0)
    if ways.count == 0:
        node = wp.int32(-1)
    while node >= 0 and known < box.highest and known <= enough:
        own = _node_excess(ways, box, node)
        while own[0] > known and ways.links[node][1] == 0:
            near = node + 1
            other = ways.links[near][2]
            nearer = _node_excess(ways, box, near)
            farther = _node_excess(ways, box, other)
            if farther[1] < nearer[1]:
                near, other = other, near
                nearer, farther = farther, nearer
            if farther[0] > known:
                stack[depth] = other
                depth += 1
            node = near
            own = nearer
        if own[0] > known:
            known = _leaf_excess(ways, box, node, known)
        node = wp.int32(-1)
        if depth > 0:
            depth -= 1
            node = stack[depth]
    if known > enough:
        return box.highest  # the walk has not seen all pieces
    return known


@wp.kernel(enable_backward=False, module="warp_bounding.indicators.triangles.moving_excesses")
def find_excesses_then(
    first: int,
    # inputs
    m: Motion,
    keys: wp.array(dtype=wp.int32),
    beyond: wp.array(dtype=wp.float64),
    lower: wp.array(dtype=wp.vec4d),
    upper: wp.array(dtype=wp.vec4d),
    values: wp.array(dtype=CornersThen),
    least: wp.float64,
    enough: wp.array(dtype=wp.float64),
    # outputs
    excesses: wp.array(dtype=wp.float64),
):
    """Upper bound of a function's excess over the distance, in a box between two keyframes, up to ``beyond``."""
    i, _ = wp.tid()
    i += first
    low, high = (
        wp.vec3d(lower[i][1], lower[i][2], lower[i][3]),
        wp.vec3d(upper[i][1], upper[i][2], upper[i][3]),
    )
    box = AskedFunction()
    box.values = values[i]
    box.highest = box.values[0]
    size = wp.abs(box.values[0])
    for k in range(1, 16):
        box.highest = wp.max(box.highest, box.values[k])
        size = wp.max(size, wp.abs(box.values[k]))
    answer = box.highest
    if keys[i] >= 0 and is_box(low, high) and box.highest > least:
        box.centre = low * _HALF + high * _HALF
        box.half = half_of(low, high, box.centre)
        box.span = span_between(m.faces.times, keys[i], lower[i][0], upper[i][0])
        if moving_box_is_free(m.faces, box.span, box.centre, box.half, m.rounding + beyond[i]):  # noqa: SIM102
            # a kernel's ``and`` would not wait
            if outside_in(m.closed, m.pieces, box.span, box.centre):
                for k in range(4):
                    size += wp.abs(m.lower[k]) + wp.abs(m.upper[k])
                size += largest(box.centre) + largest(box.half)
                box.room = _ROOM * size + m.reach + beyond[i]
                answer = _excess(m.faces, box, least, enough[i])
    excesses[i] = wp.max(answer, least)


# --- Half-spaces ------------------------------------------------------------------------------------------------------
#
# A half-space that holds a dilated motion's points in a box of time and space, where the box is not certified to be
# empty.
#
# Along a unit vector n, no point of a face near the box lies beyond the largest support of these faces, and no point of
# the object within the margin of one lies beyond that and the margin. Between two keyframes corners go straight, so
# supports are convex in time, and a linear function of time that is above them at both ends of each span is above them
# in between. What lies beyond it in the box is convex at each time and meets no face: it is outside, or all of it is
# enclosed, and a single point of it that is outside at all times tells (``sides.outside_in``). That is the corner of
# the box that lies farthest along n. In a span where it is not outside, the linear function must be so high that
# nothing of the box lies beyond.
#
# The support of a face is that of its corners, or of its part near the box: with m the face's normal, a point of it has
# ``n . p = (n - s m) . p + s m . p``, of which the first is bounded by the box for any s, and the second by the
# corners. The vector n is the direction from the nearest point of a face to the box's middle, or the other way, where
# that is enclosed.

MOST_FACES = 96  # near a box in one span: where there are more, no half-space is looked for
MOST_SPANS = 8  # that a box reaches into: likewise
_MOST_FACES = wp.constant(MOST_FACES)
_MOST_SPANS = wp.constant(MOST_SPANS)
_Heights = wp.types.vector(length=2 * MOST_SPANS, dtype=wp.float64)
_FLAT = wp.constant(wp.float64(1e-6))  # of the box's half diagonal: nearer to a face its normal tells the direction


@wp.struct
class Near:
    """What is found about the faces near a box."""

    count: int
    away: wp.float64  # squared distance of the nearest one from the middle, at the span's middle
    q: wp.vec3d  # its point there
    n: wp.vec3d  # its normal, not a unit vector
    way: wp.vec3d  # of a corner, in half the span


@wp.func
def _nearest_face(ways: Ways, span: Span, lower: wp.vec3, upper: wp.vec3, reach: float, centre: wp.vec3d) -> Near:
    near = Near()
    near.away = _INFINITY
    leaf = next_moving_leaf(ways, span, 0, lower, upper, reach)
    while leaf < ways.count and near.count <= _MOST_FACES:
        link = ways.links[leaf]
        for i in range(link[0], link[1]):
            t = moving_at(ways, span, i, centre)
            q = closest(t.a, t.b, t.c)
            away = wp.length_sq(q)
            if away < near.away:
                near.away = away
                near.q = q
                near.n = wp.cross(t.b - t.a, t.c - t.a)
                near.way = t.u
        near.count += link[1] - link[0]
        leaf = next_moving_leaf(ways, span, leaf + 1, lower, upper, reach)
    return near


@wp.func
def _ends(t: Moving, d: wp.vec3d) -> wp.vec4d:
    """The least and the largest product of corners with a vector, at the begin and at the end of the span."""
    pa, pb, pc = wp.dot(d, t.a), wp.dot(d, t.b), wp.dot(d, t.c)
    pu, pv, pw = wp.dot(d, t.u), wp.dot(d, t.v), wp.dot(d, t.w)
    a, b, c = pa - pu, pb - pv, pc - pw
    e, f, g = pa + pu, pb + pv, pc + pw
    return wp.vec4d(wp.min(a, wp.min(b, c)), wp.max(a, wp.max(b, c)), wp.min(e, wp.min(f, g)), wp.max(e, wp.max(f, g)))


@wp.func
def _face_supports(t: Moving, n: wp.vec3d, grown: wp.vec3d) -> wp.vec4d:
    """Along -n and n, at begin and end: largest products of a face's points in a box around 0.

    All are -infinite where there are none.
    """
    m = wp.cross(t.b - t.a, t.c - t.a)
    size = wp.length(m)
    own = _ends(t, n)
    found = wp.vec4d(-own[0], own[1], -own[2], own[3])
    if size > _SHORTEST:
        m = m / size
        plane, within = _ends(t, m), wp.dot(wp.abs(m), grown)
        if wp.min(plane[0], plane[2]) > within or wp.max(plane[1], plane[3]) < -within:
            return wp.vec4d(-_INFINITY, -_INFINITY, -_INFINITY, -_INFINITY)
        s = wp.dot(n, m)
        across = wp.dot(wp.abs(n - m * s), grown)
        low = wp.vec2d(wp.min(s * plane[0], s * plane[1]), wp.min(s * plane[2], s * plane[3]))
        high = wp.vec2d(wp.max(s * plane[0], s * plane[1]), wp.max(s * plane[2], s * plane[3]))
        if across + across - low[0] - low[1] < found[0] + found[2]:
            found[0] = across - low[0]
            found[2] = across - low[1]
        if across + across + high[0] + high[1] < found[1] + found[3]:
            found[1] = across + high[0]
            found[3] = across + high[1]
    return found


@wp.func
def _supports(
    ways: Ways, span: Span, lower: wp.vec3, upper: wp.vec3, reach: float, centre: wp.vec3d, n: wp.vec3d, grown: wp.vec3d
) -> wp.vec4d:
    """``_face_supports`` of all faces near a box."""
    found = wp.vec4d(-_INFINITY, -_INFINITY, -_INFINITY, -_INFINITY)
    leaf = next_moving_leaf(ways, span, 0, lower, upper, reach)
    while leaf < ways.count:
        link = ways.links[leaf]
        for i in range(link[0], link[1]):
            found = wp.max(found, _face_supports(moving_at(ways, span, i, centre), n, grown))
        leaf = next_moving_leaf(ways, span, leaf + 1, lower, upper, reach)
    return found


@wp.struct
class AskedBox:
    """A queried box of time and space: its middle, its extent in space, and its times."""

    begin: wp.float64
    end: wp.float64
    middle: wp.float64  # of the times
    centre: wp.vec3d
    half: wp.vec3d
    lower: wp.vec3  # of space, rounded outwards
    upper: wp.vec3
    margin: wp.float64
    room: wp.float64


@wp.struct
class Line:
    """A linear function of time."""

    level: wp.float64  # at the middle
    rate: wp.float64
    excess: wp.float64  # at the middle, over what it is above


@wp.func
def _line_above(
    m: Motion, a: AskedBox, key: int, supports: _Heights, count: int, towards: wp.vec3d, top: wp.float64
) -> Line:
    """One that is above the heights of all spans, and above the whole box where the farthest corner is not outside."""
    corner, heights = wp.vec3d(), _Heights()
    for k in range(3):
        corner[k] = a.centre[k] + wp.where(towards[k] < _ZERO, -a.half[k], a.half[k])
    for s in range(count):
        # A support is convex in time, and so is the larger one of it and a constant; the smaller one is not.
        low = wp.max(supports[2 * s] + a.margin + a.room, -top)
        high = wp.max(supports[2 * s + 1] + a.margin + a.room, -top)
        whole = low >= top and high >= top
        if not whole:
            whole = not outside_in(m.closed, m.pieces, span_between(m.faces.times, key + s, a.begin, a.end), corner)
        if whole:
            low = top
            high = top
        heights[2 * s] = low
        heights[2 * s + 1] = high
    line = Line()
    if a.end > a.begin:
        line.rate = (heights[2 * count - 1] - heights[0]) / (a.end - a.begin)
    line.level = -_INFINITY
    for s in range(count):
        first, last = wp.max(m.faces.times[key + s], a.begin), wp.min(m.faces.times[key + s + 1], a.end)
        line.level = wp.max(line.level, heights[2 * s] - line.rate * (first - a.middle))
        line.level = wp.max(line.level, heights[2 * s + 1] - line.rate * (last - a.middle))
        if first <= a.middle and a.middle <= last and last > first:
            line.excess = heights[2 * s] + (heights[2 * s + 1] - heights[2 * s]) * ((a.middle - first) / (last - first))
    line.excess = line.level - line.excess
    line.level += _ROOM * (wp.abs(line.rate) * (wp.abs(a.begin) + wp.abs(a.end) + wp.abs(a.middle)) + top)
    return line


@wp.kernel(enable_backward=False, module="warp_bounding.indicators.triangles.moving_half_spaces")
def find_half_spaces_then(
    first: int,
    # inputs
    m: Motion,
    lower: wp.array(dtype=wp.vec4d),
    upper: wp.array(dtype=wp.vec4d),
    # outputs
    empty: wp.array(dtype=wp.uint8),
    level: wp.array(dtype=wp.float64),
    slope: wp.array(dtype=wp.vec4d),
    axis: wp.array(dtype=wp.int32),
    loss: wp.array(dtype=wp.float64),
):
    """Is a closed box of time and space certain to be empty? Else a half-space of its points, where one is found.

    The half-space is around the box's middle.
    """
    i, _ = wp.tid()
    i += first
    if is_empty(m, lower[i], upper[i]):
        empty[i] = wp.uint8(1)
        return
    a = AskedBox()
    low, high = place_of(lower[i]), place_of(upper[i])
    a.begin = wp.max(lower[i][0], m.lower[0])
    a.end = wp.min(upper[i][0], m.upper[0])
    if not (is_box(low, high) and a.begin <= a.end) or m.faces.count == 0:
        return
    a.middle = lower[i][0] * _HALF + upper[i][0] * _HALF
    a.centre = low * _HALF + high * _HALF
    a.half = half_of(low, high, a.centre)
    size = largest(a.centre) + largest(a.half) + m.reach
    for k in range(4):
        size += wp.abs(m.lower[k]) + wp.abs(m.upper[k])
    a.room = _ROOM * size
    a.margin = m.reach + a.room
    a.lower = floats_below(a.centre - a.half)
    a.upper = floats_above(a.centre + a.half)
    reach = squared_reach(a.margin)
    times = m.faces.times
    key, count = key_at(times, a.begin), wp.int32(1)
    while key + count < times.shape[0] - 1 and times[key + count] <= a.end:
        count += 1
    if count > _MOST_SPANS:
        return
    near = Near()
    near.away = _INFINITY
    for s in range(count):
        own = _nearest_face(m.faces, span_between(times, key + s, a.begin, a.end), a.lower, a.upper, reach, a.centre)
        if own.count > _MOST_FACES:
            return
        if own.away < near.away:
            near = own
    n = wp.where(wp.sqrt(near.away) > _FLAT * wp.length(a.half), -near.q, near.n)
    length = wp.length(n)
    if not (near.away < _INFINITY and length > _SHORTEST):
        return
    n = n / length
    grown = a.half + wp.vec3d(a.margin, a.margin, a.margin)
    back, forth = _Heights(), _Heights()
    for s in range(count):
        span = span_between(times, key + s, a.begin, a.end)
        found = _supports(m.faces, span, a.lower, a.upper, reach, a.centre, n, grown)
        back[2 * s] = found[0]
        back[2 * s + 1] = found[2]
        forth[2 * s] = found[1]
        forth[2 * s + 1] = found[3]
    top = wp.dot(wp.abs(n), a.half) * (_ONE + _ROOM)
    for way in range(2):
        towards = wp.where(way == 0, n, -n)
        line = Line()
        if way == 0:
            line = _line_above(m, a, key, forth, count, towards, top)
        else:
            line = _line_above(m, a, key, back, count, towards, top)
        if line.level < top:
            level[i] = line.level
            slope[i] = wp.vec4d(line.rate, -towards[0], -towards[1], -towards[2])
            loss[i] = line.level - wp.dot(towards, near.q) - a.margin
            if line.excess + line.excess < loss[i]:
                most, across = wp.length(near.way - n * wp.dot(n, near.way)), wp.int32(0)
                for k in range(3):
                    reach_k = a.half[k] * (_ONE - wp.abs(n[k]))
                    if reach_k > most:
                        most = reach_k
                        across = k + 1
                axis[i] = across
            return


# --- The solid --------------------------------------------------------------------------------------------------------
#
# The faces of a motion, and the inside of its closed parts, as kernels ask for them; built when they are first needed.
#
# A motion and its dilated copies share one of these: the margin is told with each question.


class MovingSolid:
    """Triangles that move, and the side of each point, without a margin.

    Args:
        times: ``(K,)`` float32.
        frames: ``(K, V, 3)`` float32.
        faces: ``(F, 3)`` integers.
        closed: ``(F,)`` bool, the faces of closed parts.
        rounding: By which vertices may be elsewhere: more than what float64 makes of an interpolation.
    """

    def __init__(self, times: np.ndarray, frames: np.ndarray, faces: np.ndarray, closed: np.ndarray, rounding: float):
        self.times, self.rounding = times.astype(np.float64), rounding
        self._frames, self._faces, self._closed_faces = frames, faces, closed

    @cached_property
    def all(self) -> MovingTriangles:
        """The hierarchy of all faces."""
        if self._closed_faces.all():
            return self.closed
        return MovingTriangles(self.times, self._frames, self._faces)

    @cached_property
    def closed(self) -> MovingTriangles:
        """The hierarchy of closed parts' faces."""
        paths = np.ascontiguousarray(self._frames.transpose(1, 0, 2)).reshape(self._frames.shape[1], -1)
        cycles = cycles_of(paths, self._faces, self._closed_faces)
        kept = self._closed_faces
        return MovingTriangles(self.times, self._frames, self._faces[kept], cycles[kept])

    @cached_property
    def sides(self) -> MovingSides:
        """The grids of closed parts."""
        return MovingSides(self.closed, self._frames, self._faces[self._closed_faces], self.rounding)


class DilatedMovingSolid(AskedSolid):
    """A solid that moves, and its margin.

    Args:
        solid: Without a margin.
        lower: ``(4,)``, corner of a box that holds the dilated object, time first.
        upper: ``(4,)``, the other corner.
        margin: Object units.
    """

    point = wp.vec4d
    kernels = (decide_moments, find_empty_spans, find_inside_spans)

    def __init__(self, solid: MovingSolid, lower: np.ndarray, upper: np.ndarray, margin: float):
        self._solid = solid
        motion = Motion()
        motion.lower, motion.upper = wp.vec4d(*lower), wp.vec4d(*upper)
        motion.rounding = wp.float64(solid.rounding)
        motion.reach = wp.float64(np.nextafter(margin + solid.rounding, np.inf))
        motion.hold = wp.float64(np.nextafter(margin - solid.rounding, -np.inf))
        motion.faces, motion.closed, motion.pieces = solid.all.ways, solid.closed.ways, solid.sides.pieces
        super().__init__(motion)

    def distances(self, x: np.ndarray) -> np.ndarray:
        """``(N, 2)`` float64, bounds of the distance in space from points to the object at their time."""
        x = np.ascontiguousarray(x, dtype=np.float64)
        low, high = np.array(self._struct.lower), np.array(self._struct.upper)
        known = (x[:, 0] >= low[0]) & (x[:, 0] <= high[0])  # not so for NaN
        self._know(*[np.clip(np.nan_to_num(x[known]), low, high)] * 2)
        keys = np.where(known, self._keys(x[:, 0]), -1)
        found = np.empty((len(x), 2))
        if len(x):
            inputs = [
                self._struct,
                wp.array(keys, dtype=wp.int32, device="cpu"),
                wp.array(x, dtype=wp.vec4d, device="cpu", copy=False),
            ]
            out = wp.array(found, dtype=wp.vec2d, device="cpu", copy=False)
            launch_on_cores(find_distances_then, len(x), inputs, [out], "cpu")
        return found

    def half_spaces(self, lower: np.ndarray, upper: np.ndarray) -> HalfSpaces:
        """See ``Shape.half_spaces``."""
        lower, upper = (np.ascontiguousarray(side, dtype=np.float64) for side in (lower, upper))
        found = HalfSpaces.blank(lower, upper)
        if len(lower):
            self._know(lower, upper)
            boxes = [wp.array(side, dtype=wp.vec4d, device="cpu", copy=False) for side in (lower, upper)]
            launch_on_cores(find_half_spaces_then, len(lower), [self._struct, *boxes], found.arrays(), "cpu")
        return found

    def excess(
        self,
        lower: np.ndarray,
        upper: np.ndarray,
        values: np.ndarray,
        least: float,
        enough: np.ndarray | float,
        speed: float,
    ) -> np.ndarray:
        """See ``Shape.excess``: of boxes between two keyframes, up to the rounding of their times.

        ``speed`` is the motion's.
        """
        lower, upper = (np.ascontiguousarray(side, dtype=np.float64) for side in (lower, upper))
        if not len(lower):
            return np.empty(0)
        low, high, times = np.array(self._struct.lower), np.array(self._struct.upper), self._solid.times
        self._know(*(np.clip(np.nan_to_num(side), low, high) for side in (lower, upper)))
        keys = self._keys(lower[:, 0] / 2 + upper[:, 0] / 2)
        beyond = 2 * speed * np.maximum(np.maximum(times[keys] - lower[:, 0], upper[:, 0] - times[keys + 1]), 0.0)
        more = wp.array(keys, dtype=wp.int32, device="cpu"), wp.array(beyond, dtype=wp.float64, device="cpu")
        return self._excess(find_excesses_then, CornersThen, lower, upper, values, least, enough, *more)

    def _keys(self, time: np.ndarray) -> np.ndarray:
        """The keyframes that come before times, never the last one."""
        times = self._solid.times
        return np.clip(np.searchsorted(times, time, side="right") - 1, 0, len(times) - 2)

    def _know(self, lower: np.ndarray, upper: np.ndarray) -> None:
        """Make what is needed for the times of queries that meet the box around the object."""
        low, high = np.array(self._struct.lower), np.array(self._struct.upper)
        asked = ((lower <= upper) & (lower <= high) & (upper >= low)).all(axis=1)
        if not asked.any():
            return
        times = self._solid.times
        spans = np.clip(np.stack([lower[asked, 0], upper[asked, 0]], axis=1), times[0], times[-1])
        key = np.clip(np.searchsorted(times, spans, side="right") - 1, 0, len(times) - 2)
        places = key + (spans - times[key]) / (times[key + 1] - times[key])
        begun, ended = np.bincount(key[:, 0], minlength=len(times)), np.bincount(key[:, 1] + 2, minlength=len(times))
        keys = np.flatnonzero(np.cumsum(begun - ended[: len(times)]) > 0)
        for triangles in (self._solid.all, self._solid.closed):
            triangles.know(keys)
        self._solid.sides.know(places)
