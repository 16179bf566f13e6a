"""Half-spaces that hold a dilated motion's points in boxes of time and space that are not certified to be empty.

Along a unit vector n, no point of a face near the box lies beyond the largest support of these faces, and no point of
the object within the margin of one lies beyond that and the margin. Between two keyframes corners go straight, so
supports are convex in time, and a linear function of time that is above them at both ends of each span is above them in
between. What lies beyond it in the box is convex at each time and meets no face: it is outside, or all of it is
enclosed, and a single point of it that is outside at all times tells (``outside_in``). That is the corner of the box
that lies farthest along n. In a span where it is not outside, the linear function must be so high that nothing of the
box lies beyond.

The support of a face is that of its corners, or of its part near the box: with m the face's normal, a point of it has
``n . p = (n - s m) . p + s m . p``, of which the first is bounded by the box for any s, and the second by the corners.
The vector n is the direction from the nearest point of a face to the box's middle, or the other way, where that is
enclosed.
"""

import warp as wp

from warp_bounding.shapes.triangles.answers import Motion, half_of, is_box, is_empty, key_at, place_of
from warp_bounding.shapes.triangles.cells import MODULE
from warp_bounding.shapes.triangles.distances import SHORTEST, SUM_ROUNDING, closest
from warp_bounding.shapes.triangles.hierarchy import (
    MovingTriangle,
    Ways,
    during,
    floats_above,
    floats_below,
    largest,
    next_leaf,
    span_between,
    squared_reach,
    triangle_at,
)
from warp_bounding.shapes.triangles.moving import outside_in

_MOST_FACES = wp.constant(96)  # near a box in one span: where there are more, no half-space is looked for
MOST_SPANS = 8  # that a box reaches into: likewise
_MOST_SPANS = wp.constant(MOST_SPANS)
_Heights = wp.types.vector(length=2 * MOST_SPANS, dtype=wp.float64)
_INFINITY, _HALF = wp.constant(wp.float64(float("inf"))), wp.constant(wp.float64(0.5))
_SUM_ROUNDING, _SHORTEST = wp.constant(wp.float64(SUM_ROUNDING)), wp.constant(wp.float64(SHORTEST))
_ZERO, _ONE = wp.constant(wp.float64(0.0)), wp.constant(wp.float64(1.0))
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
def _nearest_face(t: Ways, lower: wp.vec3, upper: wp.vec3, reach: float, centre: wp.vec3d) -> Near:
    near = Near()
    near.away = _INFINITY
    leaf = next_leaf(t, 0, lower, upper, reach)
    while leaf < t.count and near.count <= _MOST_FACES:
        link = t.links[leaf]
        for i in range(link[0], link[1]):
            face = triangle_at(t, i, centre)
            q = closest(face.a, face.b, face.c)
            away = wp.length_sq(q)
            if away < near.away:
                near.away = away
                near.q = q
                near.n = wp.cross(face.b - face.a, face.c - face.a)
                near.way = face.u
        near.count += link[1] - link[0]
        leaf = next_leaf(t, leaf + 1, lower, upper, reach)
    return near


@wp.func
def _ends(t: MovingTriangle, d: wp.vec3d) -> wp.vec4d:
    """The least and the largest product of corners with a vector, at the begin and at the end of the span."""
    pa, pb, pc = wp.dot(d, t.a), wp.dot(d, t.b), wp.dot(d, t.c)
    pu, pv, pw = wp.dot(d, t.u), wp.dot(d, t.v), wp.dot(d, t.w)
    a, b, c = pa - pu, pb - pv, pc - pw
    e, f, g = pa + pu, pb + pv, pc + pw
    return wp.vec4d(wp.min(a, wp.min(b, c)), wp.max(a, wp.max(b, c)), wp.min(e, wp.min(f, g)), wp.max(e, wp.max(f, g)))


@wp.func
def _face_supports(t: MovingTriangle, n: wp.vec3d, grown: wp.vec3d) -> wp.vec4d:
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
    t: Ways, lower: wp.vec3, upper: wp.vec3, reach: float, centre: wp.vec3d, n: wp.vec3d, grown: wp.vec3d
) -> wp.vec4d:
    """``_face_supports`` of all faces near a box."""
    found = wp.vec4d(-_INFINITY, -_INFINITY, -_INFINITY, -_INFINITY)
    leaf = next_leaf(t, 0, lower, upper, reach)
    while leaf < t.count:
        link = t.links[leaf]
        for i in range(link[0], link[1]):
            found = wp.max(found, _face_supports(triangle_at(t, i, centre), n, grown))
        leaf = next_leaf(t, leaf + 1, lower, upper, reach)
    return found


@wp.struct
class QueriedBox:
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
    overestimate: wp.float64  # at the middle, over what it is above


@wp.func
def _line_above(
    m: Motion, a: QueriedBox, key: int, supports: _Heights, count: int, towards: wp.vec3d, top: wp.float64
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
            span = span_between(m.faces.times, key + s, a.begin, a.end)
            whole = not outside_in(during(m.closed, span), m.pieces, corner)
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
            line.overestimate = heights[2 * s] + (heights[2 * s + 1] - heights[2 * s]) * (
                (a.middle - first) / (last - first)
            )
    line.overestimate = line.level - line.overestimate
    line.level += _SUM_ROUNDING * (wp.abs(line.rate) * (wp.abs(a.begin) + wp.abs(a.end) + wp.abs(a.middle)) + top)
    return line


@wp.kernel(enable_backward=False, module=f"{MODULE}.moving_half_spaces")
def find_half_spaces(
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
    a = QueriedBox()
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
    a.room = _SUM_ROUNDING * size
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
        faces = during(m.faces, span_between(times, key + s, a.begin, a.end))
        own = _nearest_face(faces, a.lower, a.upper, reach, a.centre)
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
        faces = during(m.faces, span_between(times, key + s, a.begin, a.end))
        found = _supports(faces, a.lower, a.upper, reach, a.centre, n, grown)
        back[2 * s] = found[0]
        back[2 * s + 1] = found[2]
        forth[2 * s] = found[1]
        forth[2 * s + 1] = found[3]
    top = wp.dot(wp.abs(n), a.half) * (_ONE + _SUM_ROUNDING)
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
            if line.overestimate + line.overestimate < loss[i]:
                most, across = wp.length(near.way - n * wp.dot(n, near.way)), wp.int32(0)
                for k in range(3):
                    reach_k = a.half[k] * (_ONE - wp.abs(n[k]))
                    if reach_k > most:
                        most = reach_k
                        across = k + 1
                axis[i] = across
            return
