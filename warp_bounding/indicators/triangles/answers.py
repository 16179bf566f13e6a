"""What a dilated mesh answers, in kernels: points, boxes, segments, planes, distances, and excess over these."""

from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import warp as wp

from warp_bounding.indicators.shape import IN, OUT, UNDECIDED
from warp_bounding.indicators.surfaces import cycles_of
from warp_bounding.indicators.triangles.cells import ENCLOSED, MODULE, OUTSIDE, Sides, SidesGrid, build_sides, side_of
from warp_bounding.indicators.triangles.hierarchy import (
    FAR,
    NEAR,
    PROJECTIONS,
    ROUNDING,
    SMALLEST,
    UNSURE,
    Triangles,
    apart,
    box_is_free,
    build,
    closest_on_segment,
    closest_on_triangle,
    corner,
    distance_along,
    floats_above,
    floats_below,
    largest,
    near_leaf,
    nearness,
    next_leaf,
    rounding_slack,
    segment_free,
    segment_separated,
    separated,
    squared_reach,
    wide,
)
from warp_bounding.runtime.launch import launch_on_cores
from warp_bounding.runtime.native import module_options

# Kernels that are asked apart are compiled apart.
for _name in ("boxes", "clearances", "distances"):  # the others are slower with less inlining
    wp.set_module_options(module_options(), wp.get_module(f"{MODULE}.{_name}"))

# --- Points, and boxes that are empty or inside -----------------------------------------------------------------------

LIMIT = 2.0**200  # coordinates beyond it are not computed with: their products might overflow
OUTWARD = 1.0 + 2.0**-50  # a half side times this outweighs its rounding

_LIMIT = wp.constant(wp.float64(LIMIT))
_OUTWARD = wp.constant(wp.float64(OUTWARD))
_HALF = wp.constant(wp.float64(0.5))
_IN, _OUT, _UNDECIDED = wp.constant(IN), wp.constant(OUT), wp.constant(UNDECIDED)
_ENCLOSED, _OUTSIDE = wp.constant(ENCLOSED), wp.constant(OUTSIDE)


@wp.struct
class Mesh:
    """A mesh that is dilated."""

    lower: wp.vec3d  # the box that holds the dilated object
    upper: wp.vec3d
    margin: wp.float64
    faces: Triangles  # all of them
    closed: Triangles  # those of closed parts
    sides: Sides


@wp.func
def _point(m: Mesh, x: wp.vec3d) -> int:
    for k in range(3):
        if not (x[k] >= m.lower[k] and x[k] <= m.upper[k]):  # NaN is nowhere
            return _OUT
    if not largest(x) < _LIMIT:
        return _UNDECIDED
    near = nearness(m.faces, x, m.margin)
    if near == NEAR:
        return _IN
    side = side_of(m.closed, m.sides, x)
    if side == _ENCLOSED:
        return _IN
    if side == _OUTSIDE and near == FAR:
        return _OUT
    return _UNDECIDED


@wp.kernel(enable_backward=False, module=MODULE)
def decide_points(
    first: int,
    # inputs
    m: Mesh,
    x: wp.array(dtype=wp.vec3d),
    # outputs
    answers: wp.array(dtype=wp.uint8),
):
    """Is a point in the object?"""
    i, _ = wp.tid()
    i += first
    answers[i] = wp.uint8(_point(m, x[i]))


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
def _empty(m: Mesh, lower: wp.vec3d, upper: wp.vec3d) -> bool:
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


@wp.kernel(enable_backward=False, module=MODULE)
def find_empty(
    first: int,
    # inputs
    m: Mesh,
    lower: wp.array(dtype=wp.vec3d),
    upper: wp.array(dtype=wp.vec3d),
    # outputs
    answers: wp.array(dtype=wp.uint8),
):
    """Is it certain that a closed box holds no point of the object?"""
    i, _ = wp.tid()
    i += first
    answers[i] = wp.uint8(_empty(m, lower[i], upper[i]))


@wp.func
def _held_by_a_face(t: Triangles, centre: wp.vec3d, radius: wp.float64, margin: wp.float64) -> bool:
    """Does the ball around the centre lie within the margin of a single triangle, for certain?"""
    if not radius < margin:
        return False
    zero = wp.vec3d()
    lower, upper, reach = floats_below(centre), floats_above(centre), squared_reach(margin - radius)
    leaf = next_leaf(t, 0, lower, upper, reach)
    while leaf < t.count:
        link = t.links[leaf]
        for i in range(link[0], link[1]):
            a, b, c = corner(t, i, 0, centre), corner(t, i, 1, centre), corner(t, i, 2, centre)
            far = wp.length(closest_on_triangle(zero, a, b, c)) + radius
            if far + rounding_slack(a, b, c, zero, margin) <= margin:
                return True
        leaf = next_leaf(t, leaf + 1, lower, upper, reach)
    return False


@wp.func
def _inside(m: Mesh, lower: wp.vec3d, upper: wp.vec3d) -> bool:
    if not is_box(lower, upper):
        return False
    centre = lower * _HALF + upper * _HALF
    half = half_of(lower, upper, centre)
    if side_of(m.closed, m.sides, centre) == _ENCLOSED and box_is_free(m.closed, centre, half, wp.float64(0.0)):
        return True
    return _held_by_a_face(m.faces, centre, wp.length(half) * _OUTWARD, m.margin)


@wp.kernel(enable_backward=False, module=MODULE)
def find_inside(
    first: int,
    # inputs
    m: Mesh,
    lower: wp.array(dtype=wp.vec3d),
    upper: wp.array(dtype=wp.vec3d),
    # outputs
    answers: wp.array(dtype=wp.uint8),
):
    """Is it certain that a closed box lies in the object whole?"""
    i, _ = wp.tid()
    i += first
    answers[i] = wp.uint8(_inside(m, lower[i], upper[i]))


# --- Boxes that meet the object ---------------------------------------------------------------------------------------
#
# Do closed boxes meet a dilated mesh? For certain, or undecided where rounding could have made the difference.

# Of an axis that is computed from rounded corners, relative to the largest coordinate M: with u = 2^-53, the product of
# an edge and a side of the box errs by less than 3 u M, the triangle's normal by less than 36 u M^2, so all products
# with them and the rounding of ``separated`` err by less than 400 u M^2 and 1100 u M^3.
EDGE_ROOM = 2.0**-44
NORMAL_ROOM = 2.0**-42

_PROJECTIONS = wp.constant(PROJECTIONS)
_EDGE_ROOM = wp.constant(wp.float64(EDGE_ROOM))
_NORMAL_ROOM = wp.constant(wp.float64(NORMAL_ROOM))
_PER_SLACK = wp.constant(wp.float64(1.0 / ROUNDING))
_SMALLEST = wp.constant(wp.float64(SMALLEST))


@wp.func
def _laps(d: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, half: wp.vec3d, room: wp.float64) -> bool:
    """Do triangle and box overlap on an axis by more than its rounding?"""
    pa, pb, pc = wp.dot(d, a), wp.dot(d, b), wp.dot(d, c)
    reach = wp.dot(half, wp.abs(d)) - room
    return wp.min(pa, wp.min(pb, pc)) <= reach and wp.max(pa, wp.max(pb, pc)) >= -reach


@wp.func
def _axis_laps(d: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, half: wp.vec3d, room: wp.float64) -> bool:
    """``_laps`` for the product of an edge and an axis: each number is rounded once, zeros are exact, no axis."""
    return largest(d) == wp.float64(0.0) or _laps(d, a, b, c, half, room)


@wp.func
def _edge_laps(e: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, half: wp.vec3d, room: wp.float64) -> bool:
    zero = wp.float64(0.0)
    return (
        _axis_laps(wp.vec3d(zero, -e[2], e[1]), a, b, c, half, room)
        and _axis_laps(wp.vec3d(e[2], zero, -e[0]), a, b, c, half, room)
        and _axis_laps(wp.vec3d(-e[1], e[0], zero), a, b, c, half, room)
    )


@wp.func
def _meets(t: Triangles, i: int, centre: wp.vec3d, half: wp.vec3d, slack: wp.float64) -> bool:
    """Is it proven that triangle i meets the box around the centre? It does if none of the 13 axes separates them."""
    zero, one = wp.float64(0.0), wp.float64(1.0)
    a, b, c = corner(t, i, 0, centre), corner(t, i, 1, centre), corner(t, i, 2, centre)
    first = corner(t, i, 0, wp.vec3d())
    e, f = corner(t, i, 1, first), corner(t, i, 2, first)
    g = corner(t, i, 2, corner(t, i, 1, wp.vec3d()))
    size = slack * _PER_SLACK
    if size < _SMALLEST:
        return False
    if not (
        _laps(wp.vec3d(one, zero, zero), a, b, c, half, slack)
        and _laps(wp.vec3d(zero, one, zero), a, b, c, half, slack)
        and _laps(wp.vec3d(zero, zero, one), a, b, c, half, slack)
        and _laps(wp.cross(e, f), a, b, c, half, _NORMAL_ROOM * size * size * size)
    ):
        return False
    room = _EDGE_ROOM * size * size
    return (
        _edge_laps(e, a, b, c, half, room) and _edge_laps(f, a, b, c, half, room) and _edge_laps(g, a, b, c, half, room)
    )


@wp.func
def _box_nearness(t: Triangles, i: int, centre: wp.vec3d, half: wp.vec3d, margin: wp.float64) -> int:
    """Is triangle i within the margin of the box around the centre (NEAR), further (FAR), or not certainly either?"""
    a, b, c = corner(t, i, 0, centre), corner(t, i, 1, centre), corner(t, i, 2, centre)
    slack = rounding_slack(a, b, c, half, margin)
    q = closest_on_triangle(wp.vec3d(), a, b, c)
    inner = half - wp.vec3d(slack, slack, slack)
    if wp.abs(q[0]) <= inner[0] and wp.abs(q[1]) <= inner[1] and wp.abs(q[2]) <= inner[2]:
        return NEAR
    for _ in range(_PROJECTIONS):
        p = wp.min(wp.max(q, -half), half)
        if wp.length(q - p) + slack <= margin:
            return NEAR
        if separated(q - p, a, b, c, half, margin, slack):
            return FAR
        if margin == wp.float64(0.0):
            break
        q = closest_on_triangle(p, a, b, c)
    if apart(a, b, c, half, margin, slack):
        return FAR
    if _meets(t, i, centre, half, slack):
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
            told = _box_nearness(t, i, centre, half, margin)
            if told == NEAR:
                return NEAR
            answer = wp.max(answer, told)
        leaf = next_leaf(t, leaf + 1, lower, upper, reach)
    return answer


@wp.func
def _decide_box(m: Mesh, lower: wp.vec3d, upper: wp.vec3d) -> int:
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


@wp.kernel(enable_backward=False, module=f"{MODULE}.boxes")
def decide_boxes(
    first: int,
    # inputs
    m: Mesh,
    lower: wp.array(dtype=wp.vec3d),
    upper: wp.array(dtype=wp.vec3d),
    # outputs
    answers: wp.array(dtype=wp.uint8),
):
    """Does a closed box meet the object?"""
    i, _ = wp.tid()
    i += first
    answers[i] = wp.uint8(_decide_box(m, lower[i], upper[i]))


# --- Segments ---------------------------------------------------------------------------------------------------------
#
# Do closed segments meet a dilated mesh? For certain, or undecided where rounding could have made the difference.

VOLUME_ROOM = 2.0**-44  # relative to M^3: a determinant of three rounded vectors up to 2 M errs by less than 400 u M^3
NODE_ROOM = 2.0**-40  # relative: far more than the rounding of a node's axes, which may be careless
_VOLUME_ROOM = wp.constant(wp.float64(VOLUME_ROOM))
_NODE_ROOM = wp.constant(wp.float64(NODE_ROOM))
_THIRD = wp.constant(wp.float64(1.0 / 3.0))


@wp.func
def _crosses(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, s: wp.vec3d, slack: wp.float64) -> bool:
    """Is it proven that the segment from 0 to s crosses the triangle in its inside?"""
    size = slack * _PER_SLACK
    if size < _SMALLEST:
        return False
    room = _VOLUME_ROOM * size * size * size
    n = wp.cross(b - a, c - a)
    start, end = wp.dot(n, a), wp.dot(n, a - s)
    if not (wp.min(start, end) < -room and wp.max(start, end) > room):
        return False
    u, v, w = wp.dot(s, wp.cross(a, b)), wp.dot(s, wp.cross(b, c)), wp.dot(s, wp.cross(c, a))
    return wp.min(u, wp.min(v, w)) > room or wp.max(u, wp.max(v, w)) < -room


@wp.func
def _segment_nearness(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, s: wp.vec3d, margin: wp.float64, slack: wp.float64) -> int:
    """Is the triangle within the margin of the segment from 0 to s (NEAR), further (FAR), or not certainly either?"""
    if margin > wp.float64(0.0):
        q = (a + b + c) * _THIRD
        for _ in range(_PROJECTIONS):
            p = closest_on_segment(q, wp.vec3d(), s)
            q = closest_on_triangle(p, a, b, c)
            if wp.length(q - p) + slack <= margin:
                return NEAR
            if segment_separated(q - p, a, b, c, s, margin, slack):
                return FAR
    if segment_free(a, b, c, s, margin, slack):
        return FAR
    if _crosses(a, b, c, s, slack):
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
                a, b, c = corner(t, i, 0, start), corner(t, i, 1, start), corner(t, i, 2, start)
                told = _segment_nearness(a, b, c, s, margin, rounding_slack(a, b, c, s, margin))
                if told == NEAR:
                    return NEAR
                answer = wp.max(answer, told)
            node += 1
        else:
            node = t.links[node][2]
    return answer


@wp.func
def _decide_segment(m: Mesh, start: wp.vec3d, end: wp.vec3d) -> int:
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


@wp.kernel(enable_backward=False, module=f"{MODULE}.segments")
def decide_segments(
    first: int,
    # inputs
    m: Mesh,
    starts: wp.array(dtype=wp.vec3d),
    ends: wp.array(dtype=wp.vec3d),
    # outputs
    answers: wp.array(dtype=wp.uint8),
):
    """Does a closed segment meet the object? One with a NaN does not."""
    i, _ = wp.tid()
    i += first
    start, end = starts[i], ends[i]
    answer = _OUT
    if not (wp.isnan(start) or wp.isnan(end)):
        answer = _decide_segment(m, start, end)
    answers[i] = wp.uint8(answer)


# --- Planes -----------------------------------------------------------------------------------------------------------
#
# Do planes meet a dilated mesh? For certain, or undecided where rounding could have made the difference.
#
# A plane meets the object exactly if it comes within the margin of a face: it is unbounded, so it does not lie inside
# without a crossing of the surface. Of a face only the least and the greatest height of its corners over the plane
# count.

SHORTEST_NORMAL, LONGEST_NORMAL = 2.0**-200, 2.0**200  # of a normal that is computed with

_SHORTEST_NORMAL, _LONGEST_NORMAL = wp.constant(wp.float64(SHORTEST_NORMAL)), wp.constant(wp.float64(LONGEST_NORMAL))


@wp.func
def _plane_passes(t: Triangles, node: int, normal: wp.vec3d, point: wp.vec3d, margin: wp.float64) -> bool:
    """Could the plane come within the margin of a node's box?"""
    low, high = wide(t.lower[node]) - point, wide(t.upper[node]) - point
    slack = rounding_slack(low, high, high, high, margin)
    height = wp.dot(normal, low * _HALF + high * _HALF)
    reach = wp.dot(wp.abs(normal), (high - low) * _HALF + wp.vec3d(slack, slack, slack)) + margin * wp.length(normal)
    return wp.abs(height) <= reach


@wp.func
def _decide_plane(t: Triangles, normal: wp.vec3d, point: wp.vec3d, margin: wp.float64) -> int:
    reach = margin * wp.length(normal)
    size = wp.abs(normal[0]) + wp.abs(normal[1]) + wp.abs(normal[2])
    answer, node = wp.int32(_OUT), wp.int32(0)
    while node < t.count:
        if _plane_passes(t, node, normal, point, margin):
            link = t.links[node]
            for i in range(link[0], link[1]):
                a, b, c = corner(t, i, 0, point), corner(t, i, 1, point), corner(t, i, 2, point)
                room = rounding_slack(a, b, c, a, margin) * size
                pa, pb, pc = wp.dot(normal, a), wp.dot(normal, b), wp.dot(normal, c)
                least, most = wp.min(pa, wp.min(pb, pc)), wp.max(pa, wp.max(pb, pc))
                if least <= reach - room and most >= room - reach:
                    return _IN
                if least <= reach + room and most >= -(reach + room):
                    answer = _UNDECIDED
            node += 1
        else:
            node = t.links[node][2]
    return answer


@wp.kernel(enable_backward=False, module=f"{MODULE}.planes")
def decide_planes(
    first: int,
    # inputs
    m: Mesh,
    normals: wp.array(dtype=wp.vec3d),
    points: wp.array(dtype=wp.vec3d),
    # outputs
    answers: wp.array(dtype=wp.uint8),
):
    """Does a plane meet the object? One without a normal, or with numbers that are not finite, does not."""
    i, _ = wp.tid()
    i += first
    normal, point = normals[i], points[i]
    length = largest(normal)
    answer = _OUT
    if length > _SHORTEST_NORMAL and length < _LONGEST_NORMAL and largest(point) < _LIMIT:
        answer = _decide_plane(m.faces, normal, point, m.margin)
    elif wp.isfinite(normal) and wp.isfinite(point) and length > wp.float64(0.0):
        answer = _UNDECIDED
    answers[i] = wp.uint8(answer)


# --- Distances of boxes -----------------------------------------------------------------------------------------------
#
# How far are points and closed boxes from a dilated mesh? Lower bounds, within a few roundings for points.
#
# The closest points of a box and a triangle are found by alternating projections, up to rounding; the bound is what
# their direction proves, whatever they are. A walk leaves out what is farther than the nearest triangle so far.

MOST_PROJECTIONS = 24  # alternating projections at most
CLOSE = 1.0 - 2.0**-40  # a bound that is this share of the distance found is good enough
SHORTER = 1.0 - 2.0**-50  # outweighs the rounding of a difference

_MOST_PROJECTIONS = wp.constant(MOST_PROJECTIONS)
_CLOSE = wp.constant(wp.float64(CLOSE))
_SHORTER = wp.constant(wp.float64(SHORTER))
_INFINITY = wp.constant(wp.float64(float("inf")))


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
        for _ in range(_MOST_PROJECTIONS):
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


@wp.kernel(enable_backward=False, module=f"{MODULE}.clearances")
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
    i, _ = wp.tid()
    i += first
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


# --- Distances of points ----------------------------------------------------------------------------------------------
#
# How far are points from a dilated mesh? Certified bounds from both sides, within a few roundings of each other.
#
# The lower bound of each triangle is what the direction from the point to its nearest point proves
# (``distance_along``), the upper one is the distance to that point, which lies in the triangle. A walk goes to the
# nearer child first and keeps the other one on a stack, so that it soon knows how near the nearest triangle is; what is
# farther than that, box or triangle, is left out.

LONGER = 1.0 + 2.0**-50  # outweighs the rounding of a length and of a sum
GOOD = 1.0 - 2.0**-40  # a bound that is this share of the distance found is good enough
DEEPEST = 32  # levels of a hierarchy: there are never more than 2^31 triangles
_LONGER = wp.constant(wp.float64(LONGER))
_GOOD = wp.constant(wp.float64(GOOD))
Stack = wp.types.vector(length=DEEPEST, dtype=wp.int32)


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


@wp.kernel(enable_backward=False, module=f"{MODULE}.distances")
def find_distances(
    first: int,
    # inputs
    m: Mesh,
    x: wp.array(dtype=wp.vec3d),
    # outputs
    bounds: wp.array(dtype=wp.vec2d),
):
    """Lower and upper bound of a point's distance to the object; 0 and infinity where nothing is known."""
    i, _ = wp.tid()
    i += first
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


# --- Overestimates ----------------------------------------------------------------------------------------------------
#
# By how much can a function exceed the distance to a dilated mesh in a box? Certified upper bounds, for functions that
# are bounded by their corners.
#
# The function is known by numbers at the box's corners, so that what is multilinear in between, less anything linear,
# is largest at a corner. The distance to a convex piece (a triangle, or a node's box with all that is in it) is at
# least ``n . x - h`` for any unit vector n, with h the piece's support along n. With n the direction from the piece's
# nearest point to the box's centre that is its tangent, so that slopes cancel. The function less this is largest at a
# corner; the largest of these numbers over all pieces bounds the excess over the distance to all of them. A node whose
# number is not above what is known already is left out, with all pieces below it.
#
# Where a box may hold enclosed points, whose distance is 0, all that is known is the function's largest value.

ROOM = (
    2.0**-44
)  # relative to all coordinates and values: some hundred times what float64 rounds in these few sums and products
SHORTEST = 2.0**-300  # a piece that is nearer to the centre has no direction

_ROOM, _SHORTEST = wp.constant(wp.float64(ROOM)), wp.constant(wp.float64(SHORTEST))
Corners = wp.types.vector(length=8, dtype=wp.float64)  # corner i is the upper one on axis k where bit k of i is set


@wp.func
def _above_plane(values: Corners, half: wp.vec3d, n: wp.vec3d) -> wp.float64:
    """The largest value less ``n . x``, x the corners of a box around 0."""
    most = -_INFINITY
    for i in range(8):
        x = wp.vec3d(
            wp.where(i & 1, half[0], -half[0]), wp.where(i & 2, half[1], -half[1]), wp.where(i & 4, half[2], -half[2])
        )
        most = wp.max(most, values[i] - wp.dot(n, x))
    return most


@wp.func
def _node_excess(
    t: Triangles, node: int, centre: wp.vec3d, half: wp.vec3d, values: Corners, room: wp.float64
) -> wp.vec2d:
    """The number of a node, infinite where it has no direction, and its squared distance."""
    low, high = wide(t.lower[node]) - centre, wide(t.upper[node]) - centre
    q = wp.max(low, wp.min(high, wp.vec3d()))
    away = wp.length(q)
    if not away > _SHORTEST:
        return wp.vec2d(_INFINITY, wp.float64(0.0))
    n = q / -away
    support = wp.float64(0.0)
    for k in range(3):
        support += wp.max(n[k] * low[k], n[k] * high[k])
    return wp.vec2d(_above_plane(values, half, n) + support + room, away)


@wp.func
def _leaf_excess(
    t: Triangles,
    leaf: int,
    centre: wp.vec3d,
    half: wp.vec3d,
    values: Corners,
    room: wp.float64,
    highest: wp.float64,
    known: wp.float64,
) -> wp.float64:
    """The largest number of a leaf's triangles, and of what is known."""
    link = t.links[leaf]
    for i in range(link[0], link[1]):
        a, b, c = corner(t, i, 0, centre), corner(t, i, 1, centre), corner(t, i, 2, centre)
        q = closest(a, b, c)
        away = wp.length(q)
        if away > _SHORTEST:
            n = q / -away
            support = wp.max(wp.dot(n, a), wp.max(wp.dot(n, b), wp.dot(n, c)))
            known = wp.max(known, wp.min(highest, _above_plane(values, half, n) + support + room))
        else:
            known = wp.max(known, highest)
    return known


@wp.func
def _excess(
    t: Triangles,
    centre: wp.vec3d,
    half: wp.vec3d,
    values: Corners,
    room: wp.float64,
    highest: wp.float64,
    least: wp.float64,
    enough: wp.float64,
) -> wp.float64:
    """The largest number of all pieces, from ``least`` to ``highest``; the latter where it is above ``enough``."""
    known = wp.min(least, highest)
    stack, depth, node = Stack(), wp.int32(0), wp.int32(0)
    if t.count == 0:
        node = wp.int32(-1)
    while node >= 0 and known < highest and known <= enough:
        own = _node_excess(t, node, centre, half, values, room)
        while own[0] > known and t.links[node][1] == 0:
            near = node + 1
            other = t.links[near][2]
            nearer = _node_excess(t, near, centre, half, values, room)
            farther = _node_excess(t, other, centre, half, values, room)
            if farther[1] < nearer[1]:
                near, other = other, near
                nearer, farther = farther, nearer
            if farther[0] > known:
                stack[depth] = other
                depth += 1
            node = near
            own = nearer
        if own[0] > known:
            known = _leaf_excess(t, node, centre, half, values, room, highest, known)
        node = wp.int32(-1)
        if depth > 0:
            depth -= 1
            node = stack[depth]
    if known > enough:
        return highest  # the walk has not seen all pieces
    return known


@wp.kernel(enable_backward=False, module=f"{MODULE}.excesses")
def find_excesses(
    first: int,
    # inputs
    m: Mesh,
    lower: wp.array(dtype=wp.vec3d),
    upper: wp.array(dtype=wp.vec3d),
    values: wp.array(dtype=Corners),
    least: wp.float64,
    enough: wp.array(dtype=wp.float64),
    # outputs
    excesses: wp.array(dtype=wp.float64),
):
    """Upper bound of a function's excess over the distance in a box.

    It is ``least`` where it is less, and any bound where it is above ``enough``.
    """
    i, _ = wp.tid()
    i += first
    low, high, f = lower[i], upper[i], values[i]
    highest = f[0]
    size = wp.abs(f[0])
    for k in range(1, 8):
        highest = wp.max(highest, f[k])
        size = wp.max(size, wp.abs(f[k]))
    answer = highest
    if is_box(low, high) and highest > least:
        centre = low * _HALF + high * _HALF
        half = half_of(low, high, centre)
        outside = side_of(m.closed, m.sides, centre) == _OUTSIDE
        if outside and m.closed.count > 0:
            outside = box_is_free(m.closed, centre, half, wp.float64(0.0))
        if outside:
            size += largest(m.lower) + largest(m.upper) + largest(centre) + largest(half) + m.margin
            answer = _excess(m.faces, centre, half, f, _ROOM * size + m.margin, highest, least, enough[i])
    excesses[i] = wp.max(answer, least)


# --- Solids -----------------------------------------------------------------------------------------------------------


class AskedSolid:
    """A dilated solid. A class of them names its kernels.

    Args:
        struct: Of the type that the kernels take.
    """

    point: ClassVar[type]  # Warp's type of one
    kernels: ClassVar[tuple[wp.Kernel, wp.Kernel, wp.Kernel]]  # for ``decide``, ``empty`` and ``inside``

    def __init__(self, struct: Any):
        self._struct = struct

    def decide(self, x: np.ndarray) -> np.ndarray:
        """``OUT``, ``IN`` or ``UNDECIDED`` for points; see ``Shape.decide``."""
        return self._answer(self.kernels[0], x)

    def empty(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Which closed boxes hold no point of the object; see ``Shape.empty``."""
        return self._answer(self.kernels[1], lower, upper).view(bool)

    def inside(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Which closed boxes lie in the object whole; see ``Shape.inside``."""
        return self._answer(self.kernels[2], lower, upper).view(bool)

    def _answer(self, kernel: wp.Kernel, *queries: np.ndarray, dtype: type = wp.uint8) -> np.ndarray:
        """``(N,)``, what a kernel answers to queries, arrays ``(N, n)``; of a type of vectors, ``(N, k)``."""
        rows = [np.ascontiguousarray(q, dtype=np.float64) for q in queries]
        shape = len(rows[0]), *getattr(dtype, "_shape_", ())
        out = np.empty(shape, dtype=wp.dtype_to_numpy(getattr(dtype, "_wp_scalar_type_", dtype)))
        if len(out):
            self._know(rows[0], rows[-1])
            inputs = [self._struct, *(wp.array(q, dtype=self.point, device="cpu", copy=False) for q in rows)]
            launch_on_cores(kernel, len(out), inputs, [wp.array(out, dtype=dtype, device="cpu", copy=False)], "cpu")
        return out

    def _excess(
        self, kernel: wp.Kernel, corners: type, lower, upper, values, least, enough, *more: wp.array
    ) -> np.ndarray:
        """``Shape.excess`` by a kernel of numbers at ``corners``; its arguments ``more`` come before the boxes."""
        boxes = [
            wp.array(np.ascontiguousarray(side, np.float64), dtype=self.point, device="cpu") for side in (lower, upper)
        ]
        held = wp.array(np.ascontiguousarray(values, dtype=np.float64), dtype=corners, device="cpu")
        out = np.empty(len(lower))
        if len(out):
            ends = wp.array(np.broadcast_to(enough, len(out)).astype(np.float64), dtype=wp.float64, device="cpu")
            inputs = [self._struct, *more, *boxes, held, wp.float64(least), ends]
            made = wp.array(out, dtype=wp.float64, device="cpu", copy=False)
            launch_on_cores(kernel, len(out), inputs, [made], "cpu")
        return out

    def _know(self, lower: np.ndarray, upper: np.ndarray) -> None:
        """Make what is needed for queries, points or boxes ``(N, n)``; here all of it is there."""


class Solid:
    """Triangles and the side of each point, without a margin.

    Args:
        vertices: ``(V, 3)`` float32.
        faces: ``(F, 3)`` integers.
        closed: ``(F,)`` bool, the faces of closed parts.
        alike: Whether these are turned alike (``turns_of``).
        empty: Whether hollows are outside.
    """

    def __init__(
        self, vertices: np.ndarray, faces: np.ndarray, closed: np.ndarray, alike: bool = False, empty: bool = False
    ):
        self.vertices, self.faces, self.closed, self.alike, self.empty = vertices, faces, closed, alike, empty

    @cached_property
    def _all(self) -> Triangles:
        if self.closed.all():
            return self._closed
        return build(self.vertices[self.faces]).on("cpu")

    @cached_property
    def _closed(self) -> Triangles:
        cycles = cycles_of(self.vertices, self.faces, self.closed)
        return build(self.vertices[self.faces[self.closed]], cycles[self.closed]).on("cpu")

    @cached_property
    def _sides_grid(self) -> SidesGrid:
        return build_sides(self.vertices, self.faces[self.closed], self._closed, self.alike, self.empty)

    @cached_property
    def _sides(self) -> Sides:
        return self._sides_grid.on("cpu")

    @property
    def hollows(self) -> int:
        """Parts of space, wider than a cell of ``triangles/cells.py``, without a way out or a surface around them."""
        return self._sides_grid.hollows

    @property
    def both(self) -> bool:
        """Whether faces go around some points, wider than such a cell, one way, and around others the other."""
        return self._sides_grid.both

    def depth(self, x: np.ndarray, lower: np.ndarray, upper: np.ndarray, margin: float) -> np.ndarray:
        """Approximate depth of points in the object dilated by a margin; ``lower``, ``upper`` are without it."""
        faces = Solid(self.vertices, self.faces, np.zeros(len(self.faces), dtype=bool))
        away = faces.dilated(lower, upper, 0.0).distances(x)[:, 0]
        enclosed = self.dilated(lower, upper, 0.0).decide(x) == IN
        return (np.where(enclosed, away, -away) + margin).clip(0.0)

    def dilated(self, lower: np.ndarray, upper: np.ndarray, margin: float) -> "DilatedSolid":
        """The object dilated by a margin; ``lower`` and ``upper`` are the corners of a box that holds it."""
        mesh = Mesh()
        mesh.lower, mesh.upper, mesh.margin = wp.vec3d(*lower), wp.vec3d(*upper), wp.float64(margin)
        mesh.faces, mesh.closed, mesh.sides = self._all, self._closed, self._sides
        return DilatedSolid(mesh)


class DilatedSolid(AskedSolid):
    """A solid and its margin."""

    point = wp.vec3d
    kernels = (decide_points, find_empty, find_inside)

    def clearance(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Lower bounds of the distance from closed boxes to the object; see ``Shape.clearance``."""
        return self._answer(find_clearances, lower, upper, dtype=wp.float64)

    def distances(self, x: np.ndarray) -> np.ndarray:
        """``(N, 2)`` float64, bounds of the distance from points to the object; see ``Shape.distances``."""
        return self._answer(find_distances, x, dtype=wp.vec2d)

    def excess(
        self, lower: np.ndarray, upper: np.ndarray, values: np.ndarray, least: float, enough: np.ndarray | float
    ) -> np.ndarray:
        """See ``Shape.excess``."""
        return self._excess(find_excesses, Corners, lower, upper, values, least, enough)

    def decide_boxes(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Whether closed boxes meet the object."""
        return self._answer(decide_boxes, lower, upper)

    def decide_segments(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Whether closed segments meet the object."""
        return self._answer(decide_segments, start, end)

    def decide_planes(self, normal: np.ndarray, point: np.ndarray) -> np.ndarray:
        """Whether planes meet the object."""
        return self._answer(decide_planes, normal, point)
