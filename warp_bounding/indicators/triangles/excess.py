"""By how much can a function exceed the distance to a dilated mesh in a box? Certified upper bounds, for functions that are bounded by their corners.

The function is known by numbers at the box's corners, so that what is multilinear in between, less anything linear, is largest at a corner. The distance to
a convex piece (a triangle, or a node's box with all that is in it) is at least ``n . x - h`` for any unit vector n, with h the piece's support along n. With n the direction from the
piece's nearest point to the box's centre that is its tangent, so that slopes cancel. The function less this is largest at a corner; the largest of these numbers over all pieces bounds the excess
over the distance to all of them. A node whose number is not above what is known already is left out, with all pieces below it.

Where a box may hold enclosed points, whose distance is 0, all that is known is the function's largest value.
"""

import warp as wp

from warp_bounding.indicators.triangles.answers import Mesh, half_of, is_box
from warp_bounding.indicators.triangles.arithmetic import largest
from warp_bounding.indicators.triangles.hierarchy import Triangles, corner, wide
from warp_bounding.indicators.triangles.points import Stack, closest
from warp_bounding.indicators.triangles.sides import OUTSIDE, side_of
from warp_bounding.indicators.triangles.walks import box_is_free

__all__ = ["Corners", "find_excesses"]

ROOM = (
    2.0**-44
)  # relative to all coordinates and values: some hundred times what float64 rounds in these few sums and products
SHORTEST = 2.0**-300  # a piece that is nearer to the centre has no direction

_ROOM, _SHORTEST = wp.constant(wp.float64(ROOM)), wp.constant(wp.float64(SHORTEST))
_HALF, _INFINITY = wp.constant(wp.float64(0.5)), wp.constant(wp.float64(float("inf")))
_OUTSIDE = wp.constant(OUTSIDE)
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
    """The largest number of all pieces, or ``least`` where none is larger; never above ``highest``, and this where it is above ``enough``."""
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


@wp.kernel(enable_backward=False)
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
    """Upper bound of a function's excess over the distance, in a box; ``least`` where it is less, any bound where it is above ``enough``."""
    i = first + wp.tid()
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
