"""By how much can a function exceed the distance to a dilated motion, in a box of time and space? Certified upper bounds, as of ``triangles/excess.py``.

Between two keyframes corners go straight. For a unit vector n, the support of a triangle along n at a time is the largest of three linear functions of it, and that
of a node's box is linear: convex in time, both. So the function, which is multilinear between the numbers at the box's corners, less ``n . x`` and plus the support is largest at
a corner of the box of time and space, and the supports at its first and its last time are enough. As any multiple of the plane, from 0 to 1, is under the distance, too, the
function's own slope is taken as well as 1 (``box_excess.py``).

Where the box may hold a point of a face, or an enclosed one, all that is known is the function's largest value.
"""

import warp as wp

from warp_bounding.indicators.moving.answers import Motion
from warp_bounding.indicators.moving.hierarchy import Span, Ways, moving_at, span_between
from warp_bounding.indicators.moving.sides import outside_in
from warp_bounding.indicators.moving.walks import moving_box_is_free
from warp_bounding.indicators.triangles.answers import half_of, is_box
from warp_bounding.indicators.triangles.arithmetic import largest
from warp_bounding.indicators.triangles.excess import ROOM, SHORTEST
from warp_bounding.indicators.triangles.hierarchy import wide
from warp_bounding.indicators.triangles.points import Stack, closest

__all__ = ["CornersThen", "find_excesses_then"]

_ROOM, _SHORTEST = wp.constant(wp.float64(ROOM)), wp.constant(wp.float64(SHORTEST))
_ZERO, _HALF, _ONE = wp.constant(wp.float64(0.0)), wp.constant(wp.float64(0.5)), wp.constant(wp.float64(1.0))
_INFINITY = wp.constant(wp.float64(float("inf")))
CornersThen = wp.types.vector(length=16, dtype=wp.float64)  # bit 0 is time


@wp.struct
class Asked:
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
def _number(box: Asked, n: wp.vec3d, begin: wp.float64, end: wp.float64) -> wp.float64:
    """The largest value less the plane under the distance, whole or as steep as the function; supports at both times, from the centre."""
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
def _node_excess(ways: Ways, box: Asked, node: int) -> wp.vec2d:
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
def _leaf_excess(ways: Ways, box: Asked, leaf: int, known: wp.float64) -> wp.float64:
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
def _excess(ways: Ways, box: Asked, least: wp.float64, enough: wp.float64) -> wp.float64:
    """The largest number of all pieces; see ``triangles/excess.py``."""
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


@wp.kernel(enable_backward=False)
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
    """Upper bound of a function's excess over the distance, in a box that lies between two keyframes but for what ``beyond`` allows for."""
    i, _ = wp.tid()
    i += first
    low, high = (
        wp.vec3d(lower[i][1], lower[i][2], lower[i][3]),
        wp.vec3d(upper[i][1], upper[i][2], upper[i][3]),
    )
    box = Asked()
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
        if moving_box_is_free(m.faces, box.span, box.centre, box.half, m.rounding + beyond[i]):  # noqa: SIM102 (a kernel's ``and`` would not wait)
            if outside_in(m.closed, m.pieces, box.span, box.centre):
                for k in range(4):
                    size += wp.abs(m.lower[k]) + wp.abs(m.upper[k])
                size += largest(box.centre) + largest(box.half)
                box.room = _ROOM * size + m.reach + beyond[i]
                answer = _excess(m.faces, box, least, enough[i])
    excesses[i] = wp.max(answer, least)
