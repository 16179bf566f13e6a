"""Do closed segments meet a dilated mesh? For certain, or undecided where rounding could have made the difference."""

import warp as wp

from warp_bounding.indicators.shape import IN, OUT, UNDECIDED
from warp_bounding.indicators.triangles.answers import LIMIT, Mesh
from warp_bounding.indicators.triangles.arithmetic import (
    PROJECTIONS,
    ROUNDING,
    SMALLEST,
    closest_on_segment,
    closest_on_triangle,
    largest,
    rounding_slack,
    segment_free,
    segment_separated,
)
from warp_bounding.indicators.triangles.hierarchy import Triangles, corner, wide
from warp_bounding.indicators.triangles.sides import ENCLOSED, OUTSIDE, side_of
from warp_bounding.indicators.triangles.walks import FAR, NEAR, UNSURE

__all__ = ["decide_segments"]

VOLUME_ROOM = 2.0**-44  # relative to M^3: a determinant of three rounded vectors up to 2 M errs by less than 400 u M^3
NODE_ROOM = 2.0**-40  # relative: far more than the rounding of a node's axes, which may be careless

_PROJECTIONS = wp.constant(PROJECTIONS)
_VOLUME_ROOM = wp.constant(wp.float64(VOLUME_ROOM))
_NODE_ROOM = wp.constant(wp.float64(NODE_ROOM))
_PER_SLACK = wp.constant(wp.float64(1.0 / ROUNDING))
_SMALLEST = wp.constant(wp.float64(SMALLEST))
_LIMIT = wp.constant(wp.float64(LIMIT))
_HALF, _THIRD = wp.constant(wp.float64(0.5)), wp.constant(wp.float64(1.0 / 3.0))
_IN, _OUT, _UNDECIDED = wp.constant(IN), wp.constant(OUT), wp.constant(UNDECIDED)
_ENCLOSED, _OUTSIDE = wp.constant(ENCLOSED), wp.constant(OUTSIDE)


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
def _nearness(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, s: wp.vec3d, margin: wp.float64, slack: wp.float64) -> int:
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
def _passes(t: Triangles, node: int, middle: wp.vec3d, s: wp.vec3d, margin: wp.float64) -> bool:
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
def _walk(t: Triangles, start: wp.vec3d, end: wp.vec3d, margin: wp.float64) -> int:
    s = end - start
    middle, half = start * _HALF + end * _HALF, s * _HALF
    answer, node = wp.int32(FAR), wp.int32(0)
    while node < t.count:
        if _passes(t, node, middle, half, margin):
            link = t.links[node]
            for i in range(link[0], link[1]):
                a, b, c = corner(t, i, 0, start), corner(t, i, 1, start), corner(t, i, 2, start)
                told = _nearness(a, b, c, s, margin, rounding_slack(a, b, c, s, margin))
                if told == NEAR:
                    return NEAR
                answer = wp.max(answer, told)
            node += 1
        else:
            node = t.links[node][2]
    return answer


@wp.func
def _decide(m: Mesh, start: wp.vec3d, end: wp.vec3d) -> int:
    for k in range(3):
        if not (wp.min(start[k], end[k]) <= m.upper[k] and wp.max(start[k], end[k]) >= m.lower[k]):
            return _OUT
    if not (largest(start) < _LIMIT and largest(end) < _LIMIT):
        return _UNDECIDED
    near = _walk(m.faces, start, end, m.margin)
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


@wp.kernel(enable_backward=False)
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
    i = first + wp.tid()
    start, end = starts[i], ends[i]
    answer = _OUT
    if not (wp.isnan(start) or wp.isnan(end)):
        answer = _decide(m, start, end)
    answers[i] = wp.uint8(answer)
