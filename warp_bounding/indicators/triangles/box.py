"""Do closed boxes meet a dilated mesh? For certain, or undecided where rounding could have made the difference."""

import warp as wp

from warp_bounding.indicators.shape import IN, OUT, UNDECIDED
from warp_bounding.indicators.triangles.answers import Mesh, half_of, is_box
from warp_bounding.indicators.triangles.arithmetic import (
    PROJECTIONS,
    ROUNDING,
    SMALLEST,
    apart,
    closest_on_triangle,
    largest,
    rounding_slack,
    separated,
)
from warp_bounding.indicators.triangles.hierarchy import (
    Triangles,
    corner,
    floats_above,
    floats_below,
    next_leaf,
    squared_reach,
)
from warp_bounding.indicators.triangles.sides import ENCLOSED, OUTSIDE, side_of
from warp_bounding.indicators.triangles.walks import FAR, NEAR, UNSURE

__all__ = ["decide_boxes"]

# Of an axis that is computed from rounded corners, relative to the largest coordinate M: with u = 2^-53, the product of an
# edge and a side of the box errs by less than 3 u M, the triangle's normal by less than 36 u M^2, so all products with
# them and the rounding of ``separated`` err by less than 400 u M^2 and 1100 u M^3.
EDGE_ROOM = 2.0**-44
NORMAL_ROOM = 2.0**-42

_PROJECTIONS = wp.constant(PROJECTIONS)
_EDGE_ROOM = wp.constant(wp.float64(EDGE_ROOM))
_NORMAL_ROOM = wp.constant(wp.float64(NORMAL_ROOM))
_PER_SLACK = wp.constant(wp.float64(1.0 / ROUNDING))
_SMALLEST = wp.constant(wp.float64(SMALLEST))
_HALF = wp.constant(wp.float64(0.5))
_IN, _OUT, _UNDECIDED = wp.constant(IN), wp.constant(OUT), wp.constant(UNDECIDED)
_ENCLOSED, _OUTSIDE = wp.constant(ENCLOSED), wp.constant(OUTSIDE)


@wp.func
def _laps(d: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, half: wp.vec3d, room: wp.float64) -> bool:
    """Do triangle and box overlap on an axis by more than its rounding?"""
    pa, pb, pc = wp.dot(d, a), wp.dot(d, b), wp.dot(d, c)
    reach = wp.dot(half, wp.abs(d)) - room
    return wp.min(pa, wp.min(pb, pc)) <= reach and wp.max(pa, wp.max(pb, pc)) >= -reach


@wp.func
def _axis_laps(d: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, half: wp.vec3d, room: wp.float64) -> bool:
    """``_laps`` for the product of an edge and an axis, each number of which is rounded once: zeros are exact, no axis."""
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
def _nearness(t: Triangles, i: int, centre: wp.vec3d, half: wp.vec3d, margin: wp.float64) -> int:
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
def _walk(t: Triangles, centre: wp.vec3d, half: wp.vec3d, margin: wp.float64) -> int:
    lower, upper, reach = floats_below(centre - half), floats_above(centre + half), squared_reach(margin)
    answer = wp.int32(FAR)
    leaf = next_leaf(t, 0, lower, upper, reach)
    while leaf < t.count:
        link = t.links[leaf]
        for i in range(link[0], link[1]):
            told = _nearness(t, i, centre, half, margin)
            if told == NEAR:
                return NEAR
            answer = wp.max(answer, told)
        leaf = next_leaf(t, leaf + 1, lower, upper, reach)
    return answer


@wp.func
def _decide(m: Mesh, lower: wp.vec3d, upper: wp.vec3d) -> int:
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
    near = _walk(m.faces, centre, half_of(lower, upper, centre), m.margin)
    if near == NEAR:
        return _IN
    side = side_of(m.closed, m.sides, centre)
    if side == _ENCLOSED:
        return _IN
    if side == _OUTSIDE and near == FAR:
        return _OUT
    return _UNDECIDED


@wp.kernel(enable_backward=False)
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
    i = first + wp.tid()
    answers[i] = wp.uint8(_decide(m, lower[i], upper[i]))
