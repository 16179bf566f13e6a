"""What a dilated mesh answers, in kernels, at rest or moving: about points, boxes, segments and planes."""

import warp as wp

from warp_bounding.runtime.native import module_options
from warp_bounding.shapes.shape import IN, OUT, UNDECIDED
from warp_bounding.shapes.triangles.cells import ENCLOSED, MODULE, OUTSIDE, MeshArrays, kernel_of, side_of
from warp_bounding.shapes.triangles.hierarchy import (
    PROJECTIONS,
    ROUNDING,
    SMALLEST,
    Triangle,
    Triangles,
    Ways,
    apart,
    box_is_free,
    closest_on_segment,
    closest_on_triangle,
    corner,
    during,
    floats_above,
    floats_below,
    holds,
    largest,
    next_leaf,
    range_along,
    rounding_margin,
    segment_free,
    segment_separated,
    separated,
    slack_of,
    span_between,
    span_of,
    squared_reach,
    triangle_at,
    wide,
)
from warp_bounding.shapes.triangles.moving import Pieces, outside_in, side_in

# Kernels that are asked apart are compiled apart.
wp.set_module_options(module_options(), wp.get_module(f"{MODULE}.boxes"))  # the others are slower with less inlining

# --- Points, and boxes that are empty or inside -----------------------------------------------------------------------

_LIMIT = wp.constant(wp.float64(2.0**200))  # coordinates beyond it are not computed with: their products might overflow
_OUTWARD = wp.constant(wp.float64(1.0 + 2.0**-50))  # a half side times this outweighs its rounding

_HALF = wp.constant(wp.float64(0.5))
_IN, _OUT, _UNDECIDED = wp.constant(IN), wp.constant(OUT), wp.constant(UNDECIDED)
_ENCLOSED, _OUTSIDE = wp.constant(ENCLOSED), wp.constant(OUTSIDE)


@wp.struct
class Motion:
    """A motion that is dilated. Faces may be elsewhere by the rounding."""

    lower: wp.vec4d  # the box that holds the dilated object, time first
    upper: wp.vec4d
    rounding: wp.float64
    speed: wp.float64  # of the fastest point at most
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
def _point(m: Motion, x: wp.vec4d) -> int:
    """Is a point in the object at its time?"""
    for k in range(4):
        if not (x[k] >= m.lower[k] and x[k] <= m.upper[k]):  # NaN is nowhere
            return _OUT
    place, zero = place_of(x), wp.vec3d()
    if not largest(place) < _LIMIT:
        return _UNDECIDED
    span = span_between(m.faces.times, key_at(m.faces.times, x[0]), x[0], x[0])
    faces, closed = during(m.faces, span), during(m.closed, span)
    if box_is_free(faces, place, zero, m.reach):
        side = side_in(closed, m.pieces, place)
        if side == _OUTSIDE:
            return _OUT
        if side == _ENCLOSED:
            return _IN
        return _UNDECIDED
    if holds(faces, place, wp.float64(0.0), m.hold):
        return _IN
    if box_is_free(closed, place, zero, m.rounding):  # noqa: SIM102 (a kernel's ``and`` would not wait)
        if side_in(closed, m.pieces, place) == _ENCLOSED:
            return _IN
    return _UNDECIDED


@wp.func
def is_empty(m: MeshArrays, lower: wp.vec3d, upper: wp.vec3d) -> bool:
    """Is it certain that a closed box holds no point of the object?"""
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
        if not box_is_free(during(m.faces, span), centre, half, m.reach):
            return False
        if not outside_in(during(m.closed, span), m.pieces, centre):
            return False
        key += 1
    return True


@wp.func
def _inside(m: MeshArrays, lower: wp.vec3d, upper: wp.vec3d) -> bool:
    """Is it certain that a closed box lies in the object whole?"""
    if not is_box(lower, upper):
        return False
    centre = lower * _HALF + upper * _HALF
    half = half_of(lower, upper, centre)
    if side_of(m.closed, m.sides, centre) == _ENCLOSED and box_is_free(m.closed, centre, half, wp.float64(0.0)):
        return True
    return holds(m.faces, centre, wp.length(half) * _OUTWARD, m.margin)


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
        if not holds(during(m.faces, span), centre, radius, m.hold):
            instant = span_of(key, span.begin, span.begin)
            if not (
                box_is_free(during(m.closed, span), centre, half, m.rounding)
                and side_in(during(m.closed, instant), m.pieces, centre) == _ENCLOSED
            ):
                return False
        key += 1
    return True


AT_REST = tuple(kernel_of(answer, MeshArrays, wp.vec3d, MODULE) for answer in (is_empty, _inside))
MOVING = tuple(kernel_of(answer, Motion, wp.vec4d, f"{MODULE}.moving") for answer in (is_empty, _inside))
decide_then = kernel_of(_point, Motion, wp.vec4d, f"{MODULE}.moving", rows=1)


# --- Boxes that meet the object ---------------------------------------------------------------------------------------
#
# Do closed boxes, and points, which are boxes of no size, meet a dilated mesh? For certain, or undecided where rounding
# could have made the difference.

# Of a triangle: beyond the margin, within it, or not certainly either.
FAR, NEAR, UNSURE = wp.constant(0), wp.constant(1), wp.constant(2)

# Of an axis that is computed from rounded corners, relative to the largest coordinate M: with u = 2^-53, the product of
# an edge and a side of the box errs by less than 3 u M, the triangle's normal by less than 36 u M^2, so all products
# with them and the rounding of ``separated`` err by less than 400 u M^2 and 1100 u M^3.
_EDGE_ROOM = wp.constant(wp.float64(2.0**-44))
_NORMAL_ROOM = wp.constant(wp.float64(2.0**-42))

_PROJECTIONS = wp.constant(PROJECTIONS)
_PER_SLACK = wp.constant(wp.float64(1.0 / ROUNDING))
_SMALLEST = wp.constant(wp.float64(SMALLEST))


@wp.func
def _laps(d: wp.vec3d, t: Triangle, half: wp.vec3d, room: wp.float64) -> bool:
    """Do triangle and box overlap on an axis by more than its rounding?"""
    found, reach = range_along(d, t), wp.dot(half, wp.abs(d)) - room
    return found[0] <= reach and found[1] >= -reach


@wp.func
def _axis_laps(d: wp.vec3d, t: Triangle, half: wp.vec3d, room: wp.float64) -> bool:
    """``_laps`` for the product of an edge and an axis: each number is rounded once, zeros are exact, no axis."""
    return largest(d) == wp.float64(0.0) or _laps(d, t, half, room)


@wp.func
def _edge_laps(e: wp.vec3d, t: Triangle, half: wp.vec3d, room: wp.float64) -> bool:
    zero = wp.float64(0.0)
    return (
        _axis_laps(wp.vec3d(zero, -e[2], e[1]), t, half, room)
        and _axis_laps(wp.vec3d(e[2], zero, -e[0]), t, half, room)
        and _axis_laps(wp.vec3d(-e[1], e[0], zero), t, half, room)
    )


@wp.func
def _meets(faces: Triangles, i: int, t: Triangle, centre: wp.vec3d, half: wp.vec3d, slack: wp.float64) -> bool:
    """Is it proven that triangle i, ``t`` from the centre, meets the box, as none of the 13 axes separates them?"""
    zero, one = wp.float64(0.0), wp.float64(1.0)
    first = corner(faces, i, 0, wp.vec3d())
    e, f = corner(faces, i, 1, first), corner(faces, i, 2, first)
    g = corner(faces, i, 2, corner(faces, i, 1, wp.vec3d()))
    size = slack * _PER_SLACK
    if size < _SMALLEST:
        return False
    if not (
        _laps(wp.vec3d(one, zero, zero), t, half, slack)
        and _laps(wp.vec3d(zero, one, zero), t, half, slack)
        and _laps(wp.vec3d(zero, zero, one), t, half, slack)
        and _laps(wp.cross(e, f), t, half, _NORMAL_ROOM * size * size * size)
    ):
        return False
    room = _EDGE_ROOM * size * size
    return _edge_laps(e, t, half, room) and _edge_laps(f, t, half, room) and _edge_laps(g, t, half, room)


@wp.func
def _box_nearness(faces: Triangles, i: int, centre: wp.vec3d, half: wp.vec3d, margin: wp.float64) -> int:
    """Is triangle i within the margin of the box around the centre (NEAR), further (FAR), or not certainly either?"""
    t = triangle_at(faces, i, centre)
    slack = slack_of(t, half, margin)
    q = closest_on_triangle(wp.vec3d(), t.a, t.b, t.c)
    inner = half - wp.vec3d(slack, slack, slack)
    if wp.abs(q[0]) <= inner[0] and wp.abs(q[1]) <= inner[1] and wp.abs(q[2]) <= inner[2]:
        return NEAR
    for _ in range(_PROJECTIONS):
        p = wp.min(wp.max(q, -half), half)
        if wp.length(q - p) + slack <= margin:
            return NEAR
        if separated(q - p, t, half, margin, slack):
            return FAR
        if margin == wp.float64(0.0):
            break
        q = closest_on_triangle(p, t.a, t.b, t.c)
    if apart(t, half, margin, slack):
        return FAR
    if _meets(faces, i, t, centre, half, slack):
        return NEAR
    return UNSURE


@wp.func
def _box_walk(t: Triangles, centre: wp.vec3d, half: wp.vec3d, margin: wp.float64) -> int:
    lower, upper, reach = floats_below(centre - half), floats_above(centre + half), squared_reach(margin)
    answer = wp.int32(FAR)
    leaf = next_leaf(t, 0, lower, upper, reach)
    while leaf < t.count:
        link = t.links[leaf]
        for i in range(link[0], link[1]):
            reported = _box_nearness(t, i, centre, half, margin)
            if reported == NEAR:
                return NEAR
            answer = wp.max(answer, reported)
        leaf = next_leaf(t, leaf + 1, lower, upper, reach)
    return answer


@wp.func
def _decide_box(m: MeshArrays, lower: wp.vec3d, upper: wp.vec3d) -> int:
    """Does a closed box meet the object?"""
    whole = wp.bool(True)
    for k in range(3):
        if not (lower[k] <= upper[k] and lower[k] <= m.upper[k] and upper[k] >= m.lower[k]):
            return _OUT  # no box, or beyond the object
        whole = whole and lower[k] <= m.lower[k] and upper[k] >= m.upper[k]
    if whole:
        return _IN
    if not is_box(lower, upper):
        return _UNDECIDED
    centre = lower * _HALF + upper * _HALF
    near = _box_walk(m.faces, centre, half_of(lower, upper, centre), m.margin)
    if near == NEAR:
        return _IN
    side = side_of(m.closed, m.sides, centre)
    if side == _ENCLOSED:
        return _IN
    if side == _OUTSIDE and near == FAR:
        return _OUT
    return _UNDECIDED


decide_boxes = kernel_of(_decide_box, MeshArrays, wp.vec3d, f"{MODULE}.boxes")


# --- Segments ---------------------------------------------------------------------------------------------------------
#
# Do closed segments meet a dilated mesh? For certain, or undecided where rounding could have made the difference.

# Relative to M^3: a determinant of three rounded vectors up to 2 M errs by less than 400 u M^3.
_VOLUME_ROOM = wp.constant(wp.float64(2.0**-44))
# Relative: far more than the rounding of a node's axes, which may be careless.
_NODE_ROOM = wp.constant(wp.float64(2.0**-40))
_THIRD = wp.constant(wp.float64(1.0 / 3.0))


@wp.func
def _crosses(t: Triangle, s: wp.vec3d, slack: wp.float64) -> bool:
    """Is it proven that the segment from 0 to s crosses the triangle in its inside?"""
    size = slack * _PER_SLACK
    if size < _SMALLEST:
        return False
    room, a, b, c = _VOLUME_ROOM * size * size * size, t.a, t.b, t.c
    n = wp.cross(b - a, c - a)
    start, end = wp.dot(n, a), wp.dot(n, a - s)
    if not (wp.min(start, end) < -room and wp.max(start, end) > room):
        return False
    u, v, w = wp.dot(s, wp.cross(a, b)), wp.dot(s, wp.cross(b, c)), wp.dot(s, wp.cross(c, a))
    return wp.min(u, wp.min(v, w)) > room or wp.max(u, wp.max(v, w)) < -room


@wp.func
def _segment_nearness(t: Triangle, s: wp.vec3d, margin: wp.float64, slack: wp.float64) -> int:
    """Is the triangle within the margin of the segment from 0 to s (NEAR), further (FAR), or not certainly either?"""
    if margin > wp.float64(0.0):
        q = (t.a + t.b + t.c) * _THIRD
        for _ in range(_PROJECTIONS):
            p = closest_on_segment(q, wp.vec3d(), s)
            q = closest_on_triangle(p, t.a, t.b, t.c)
            if wp.length(q - p) + slack <= margin:
                return NEAR
            if segment_separated(q - p, t, s, margin, slack):
                return FAR
    if segment_free(t, s, margin, slack):
        return FAR
    if _crosses(t, s, slack):
        return NEAR
    return UNSURE


@wp.func
def _segment_passes(t: Triangles, node: int, middle: wp.vec3d, s: wp.vec3d, margin: wp.float64) -> bool:
    """Could the segment, whose half is s, come within the margin of a node's box?"""
    low, high = wide(t.lower[node]), wide(t.upper[node])
    c, h = (low + high) * _HALF - middle, (high - low) * _HALF + wp.vec3d(margin, margin, margin)
    d = wp.abs(s)
    room = _NODE_ROOM * (largest(middle) + largest(c) + largest(h) + largest(d))
    h += wp.vec3d(room, room, room)
    if wp.abs(c[0]) > h[0] + d[0] or wp.abs(c[1]) > h[1] + d[1] or wp.abs(c[2]) > h[2] + d[2]:
        return False
    across = wp.abs(wp.cross(s, c))
    if across[0] > h[1] * d[2] + h[2] * d[1] or across[1] > h[2] * d[0] + h[0] * d[2]:
        return False
    return not across[2] > h[0] * d[1] + h[1] * d[0]


@wp.func
def _segment_walk(t: Triangles, start: wp.vec3d, end: wp.vec3d, margin: wp.float64) -> int:
    s = end - start
    middle, half = start * _HALF + end * _HALF, s * _HALF
    answer, node = wp.int32(FAR), wp.int32(0)
    while node < t.count:
        if _segment_passes(t, node, middle, half, margin):
            link = t.links[node]
            for i in range(link[0], link[1]):
                face = triangle_at(t, i, start)
                reported = _segment_nearness(face, s, margin, slack_of(face, s, margin))
                if reported == NEAR:
                    return NEAR
                answer = wp.max(answer, reported)
            node += 1
        else:
            node = t.links[node][2]
    return answer


@wp.func
def _decide_segment(m: MeshArrays, start: wp.vec3d, end: wp.vec3d) -> int:
    """Does a closed segment meet the object? One with a NaN does not."""
    if wp.isnan(start) or wp.isnan(end):
        return _OUT
    for k in range(3):
        if not (wp.min(start[k], end[k]) <= m.upper[k] and wp.max(start[k], end[k]) >= m.lower[k]):
            return _OUT
    if not (largest(start) < _LIMIT and largest(end) < _LIMIT):
        return _UNDECIDED
    near = _segment_walk(m.faces, start, end, m.margin)
    if near == NEAR:
        return _IN
    side = side_of(m.closed, m.sides, start)
    if side == _ENCLOSED:
        return _IN
    if near == FAR and side == _OUTSIDE:
        return _OUT
    if near == UNSURE and side_of(m.closed, m.sides, end) == _ENCLOSED:
        return _IN
    return _UNDECIDED


decide_segments = kernel_of(_decide_segment, MeshArrays, wp.vec3d, f"{MODULE}.segments")


# --- Planes -----------------------------------------------------------------------------------------------------------
#
# Do planes meet a dilated mesh? For certain, or undecided where rounding could have made the difference.
#
# A plane meets the object exactly if it comes within the margin of a face: it is unbounded, so it does not lie inside
# without a crossing of the surface. Of a face only the least and the greatest height of its corners over the plane
# count.

# Of a normal that is computed with.
_SHORTEST_NORMAL, _LONGEST_NORMAL = wp.constant(wp.float64(2.0**-200)), wp.constant(wp.float64(2.0**200))


@wp.func
def _plane_passes(t: Triangles, node: int, normal: wp.vec3d, point: wp.vec3d, margin: wp.float64) -> bool:
    """Could the plane come within the margin of a node's box?"""
    low, high = wide(t.lower[node]) - point, wide(t.upper[node]) - point
    slack = rounding_margin(low, high, high, high, margin)
    height = wp.dot(normal, low * _HALF + high * _HALF)
    reach = wp.dot(wp.abs(normal), (high - low) * _HALF + wp.vec3d(slack, slack, slack)) + margin * wp.length(normal)
    return wp.abs(height) <= reach


@wp.func
def _plane_walk(t: Triangles, normal: wp.vec3d, point: wp.vec3d, margin: wp.float64) -> int:
    reach = margin * wp.length(normal)
    size = wp.abs(normal[0]) + wp.abs(normal[1]) + wp.abs(normal[2])
    answer, node = wp.int32(_OUT), wp.int32(0)
    while node < t.count:
        if _plane_passes(t, node, normal, point, margin):
            link = t.links[node]
            for i in range(link[0], link[1]):
                face = triangle_at(t, i, point)
                room, found = slack_of(face, face.a, margin) * size, range_along(normal, face)
                if found[0] <= reach - room and found[1] >= room - reach:
                    return _IN
                if found[0] <= reach + room and found[1] >= -(reach + room):
                    answer = _UNDECIDED
            node += 1
        else:
            node = t.links[node][2]
    return answer


@wp.func
def _decide_plane(m: MeshArrays, normal: wp.vec3d, point: wp.vec3d) -> int:
    """Does a plane meet the object? One without a normal, or with numbers that are not finite, does not."""
    length = largest(normal)
    if length > _SHORTEST_NORMAL and length < _LONGEST_NORMAL and largest(point) < _LIMIT:
        return _plane_walk(m.faces, normal, point, m.margin)
    if wp.isfinite(normal) and wp.isfinite(point) and length > wp.float64(0.0):
        return _UNDECIDED
    return _OUT


decide_planes = kernel_of(_decide_plane, MeshArrays, wp.vec3d, f"{MODULE}.planes")
