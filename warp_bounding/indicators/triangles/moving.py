"""Triangles that move linearly between keyframes: one against a box, a hierarchy, walks, and a surface's sides."""

import math
from itertools import pairwise

import numpy as np
import warp as wp

from warp_bounding.indicators.triangles.cells import BORDER, ENCLOSED, INNER, OUTSIDE, UNKNOWN
from warp_bounding.indicators.triangles.hierarchy import (
    SHORTEST,
    closest_on_triangle,
    crossing,
    floats_above,
    floats_below,
    nodes_of,
    rounding_slack,
    sorted_order,
    squared_reach,
    wide,
)
from warp_bounding.runtime.launch import launch_on_cores

# --- One triangle -----------------------------------------------------------------------------------------------------
#
# One triangle that moves against one box or segment, in float64: axes that prove them apart for a whole span of time.
#
# Each corner goes straight from ``a - u`` to ``a + u``. So all that the triangle is in between lies in the convex hull
# of the six ends, and an axis on which these do not overlap the box, grown by the margin, is a proof for the whole
# span, for *any* axis, however it was computed. The first axes that are tried are directions between closest points of
# the box and the triangle in the middle of its way; the next ones come from the hull, step by step (Frank and Wolfe's
# method); the last ones are the 13 axes of ``triangles/hierarchy.py``, of the triangle in the middle.
#
# The box is |x_k| <= half_k, and corners are relative to its centre. The slack outweighs all rounding that begins with
# the corners and ways as they are given; how well these are known themselves is for the margin to cover.
#
# Source: Frank and Wolfe, "An algorithm for quadratic programming" (1956).

PROJECTIONS = 3  # alternating projections of the triangle in the middle
STEPS = 12  # and of the hull

_SHORTEST = wp.constant(wp.float64(SHORTEST))
_PROJECTIONS, _TRIES = wp.constant(PROJECTIONS), wp.constant(PROJECTIONS + STEPS)


@wp.struct
class Moving:
    """A triangle in the middle of its way, and half the way of each corner."""

    a: wp.vec3d
    b: wp.vec3d
    c: wp.vec3d
    u: wp.vec3d  # of a
    v: wp.vec3d  # of b
    w: wp.vec3d  # of c


@wp.func
def moving_slack(t: Moving, half: wp.vec3d, margin: wp.float64) -> wp.float64:
    """A length that outweighs the rounding of an axis for these numbers: ``rounding_slack`` for bounds of the ends.

    A corner's product and that of its way err together as much as one of their sum, and by one more rounding.
    """
    return rounding_slack(wp.abs(t.a) + wp.abs(t.u), wp.abs(t.b) + wp.abs(t.v), wp.abs(t.c) + wp.abs(t.w), half, margin)


@wp.func
def _range_along(d: wp.vec3d, t: Moving) -> wp.vec2d:
    """Where the six ends lie on an axis."""
    pa, pb, pc = wp.dot(d, t.a), wp.dot(d, t.b), wp.dot(d, t.c)
    pu, pv, pw = wp.abs(wp.dot(d, t.u)), wp.abs(wp.dot(d, t.v)), wp.abs(wp.dot(d, t.w))
    return wp.vec2d(wp.min(pa - pu, wp.min(pb - pv, pc - pw)), wp.max(pa + pu, wp.max(pb + pv, pc + pw)))


@wp.func
def _separated(d: wp.vec3d, t: Moving, half: wp.vec3d, margin: wp.float64, slack: wp.float64) -> bool:
    """Is the hull further than ``margin`` from the box, as axis d can tell? NaN cannot."""
    size = wp.abs(d[0]) + wp.abs(d[1]) + wp.abs(d[2])
    if not size > _SHORTEST:
        return False
    reach = wp.dot(half, wp.abs(d)) + slack * size + margin * wp.length(d)
    found = _range_along(d, t)
    return found[0] > reach or found[1] < -reach


@wp.func
def _edge_separated(e: wp.vec3d, t: Moving, half: wp.vec3d, margin: wp.float64, slack: wp.float64) -> bool:
    zero = wp.float64(0.0)
    if _separated(wp.vec3d(zero, -e[2], e[1]), t, half, margin, slack):
        return True
    if _separated(wp.vec3d(e[2], zero, -e[0]), t, half, margin, slack):
        return True
    return _separated(wp.vec3d(-e[1], e[0], zero), t, half, margin, slack)


@wp.func
def _apart(t: Moving, half: wp.vec3d, margin: wp.float64, slack: wp.float64) -> bool:
    zero, one = wp.float64(0.0), wp.float64(1.0)
    if _separated(wp.vec3d(one, zero, zero), t, half, margin, slack):
        return True
    if _separated(wp.vec3d(zero, one, zero), t, half, margin, slack):
        return True
    if _separated(wp.vec3d(zero, zero, one), t, half, margin, slack):
        return True
    if _separated(wp.cross(t.b - t.a, t.c - t.a), t, half, margin, slack):
        return True
    if _edge_separated(t.b - t.a, t, half, margin, slack):
        return True
    if _edge_separated(t.c - t.b, t, half, margin, slack):
        return True
    return _edge_separated(t.a - t.c, t, half, margin, slack)


@wp.func
def _towards(d: wp.vec3d, corner: wp.vec3d, way: wp.vec3d) -> wp.vec3d:
    """The end of a way that lies lower on an axis."""
    if wp.dot(d, way) > wp.float64(0.0):
        return corner - way
    return corner + way


@wp.func
def _lowest(d: wp.vec3d, t: Moving) -> wp.vec3d:
    """The end of the six that lies lowest on an axis."""
    best, other = _towards(d, t.a, t.u), _towards(d, t.b, t.v)
    if wp.dot(d, other) < wp.dot(d, best):
        best = other
    other = _towards(d, t.c, t.w)
    if wp.dot(d, other) < wp.dot(d, best):
        best = other
    return best


@wp.func
def moving_free(t: Moving, half: wp.vec3d, margin: wp.float64, slack: wp.float64) -> bool:
    """Is it proven that the triangle is, on all its way, further than the margin from the box around 0?"""
    zero, one = wp.float64(0.0), wp.float64(1.0)
    q = closest_on_triangle(wp.vec3d(), t.a, t.b, t.c)
    for turn in range(_TRIES):
        d = q - wp.min(wp.max(q, -half), half)
        if wp.length_sq(d) <= margin * margin:
            return False
        if _separated(d, t, half, margin, slack):
            return True
        if turn < _PROJECTIONS:
            q = closest_on_triangle(q - d, t.a, t.b, t.c)
        else:
            step = _lowest(d, t) - q
            length2 = wp.length_sq(step)
            if not length2 > zero:
                break
            q += step * wp.clamp(-wp.dot(d, step) / length2, zero, one)
    return _apart(t, half, margin, slack)


@wp.func
def _segment_separated(d: wp.vec3d, t: Moving, s: wp.vec3d, margin: wp.float64, slack: wp.float64) -> bool:
    """Is the hull further than ``margin`` from the segment from 0 to s, as axis d can tell? NaN cannot."""
    size = wp.abs(d[0]) + wp.abs(d[1]) + wp.abs(d[2])
    if not size > _SHORTEST:
        return False
    zero, ps = wp.float64(0.0), wp.dot(d, s)
    reach = slack * size + margin * wp.length(d)
    found = _range_along(d, t)
    return found[0] > wp.max(ps, zero) + reach or found[1] < wp.min(ps, zero) - reach


@wp.func
def moving_segment_free(t: Moving, s: wp.vec3d, margin: wp.float64, slack: wp.float64) -> bool:
    """Do axes of the triangle at mid time prove it far from the segment from 0 to s on all its way?"""
    zero, one = wp.float64(0.0), wp.float64(1.0)
    if _segment_separated(wp.cross(t.b - t.a, t.c - t.a), t, s, margin, slack):
        return True
    if _segment_separated(wp.cross(t.b - t.a, s), t, s, margin, slack):
        return True
    if _segment_separated(wp.cross(t.c - t.b, s), t, s, margin, slack):
        return True
    if _segment_separated(wp.cross(t.a - t.c, s), t, s, margin, slack):
        return True
    if _segment_separated(wp.vec3d(one, zero, zero), t, s, margin, slack):
        return True
    if _segment_separated(wp.vec3d(zero, one, zero), t, s, margin, slack):
        return True
    return _segment_separated(wp.vec3d(zero, zero, one), t, s, margin, slack)


# --- The hierarchy ----------------------------------------------------------------------------------------------------
#
# A hierarchy of boxes over triangles that move: one tree for all times, with a box of each node at each keyframe.
#
# Between two keyframes each coordinate of a corner goes straight, so the box of a node at a time lies within what is
# interpolated between its boxes at both. The tree is that of ``triangles/hierarchy.py``, and it is walked in the same
# way; only which triangles stand together is told by where they are at several keyframes. Boxes of a keyframe are made
# when they are first needed.

SORTED_BY = 8  # keyframes at most that triangles are sorted by
# Relative to the largest coordinate M: with u = 2^-24, float32 rounds a share (1 u of a way of up to 2 M) and an
# interpolation (4 u M); this is more than twice as much.
BOX_ROOM = 2.0**-20

_HALF = wp.constant(wp.float64(0.5))


@wp.struct
class Ways:
    """What a kernel walks over. An empty hierarchy has a count of 0."""

    count: int  # nodes
    room: float  # outweighs the rounding of a node's box
    times: wp.array(dtype=wp.float64)  # (K,), of the keyframes
    vertices: wp.array2d(dtype=wp.vec3)  # (K, V)
    lower: wp.array2d(dtype=wp.vec3)  # (K, nodes), of the nodes' boxes
    upper: wp.array2d(dtype=wp.vec3)
    links: wp.array(dtype=wp.vec3i)  # as those of ``Triangles``
    faces: wp.array(dtype=wp.vec3i)  # vertices of the triangles, in the order of leaves
    cycles: wp.array(dtype=wp.uint64)


@wp.struct
class Span:
    """A closed span of time between two neighbouring keyframes."""

    key: int  # the first keyframe
    begin: wp.float64  # as a share of the way to the next one
    end: wp.float64


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
def moving_at(ways: Ways, span: Span, triangle: int, origin: wp.vec3d) -> Moving:
    """A triangle's way in a span, relative to a point, up to a few roundings of the largest coordinates."""
    share, half = (span.begin + span.end) * _HALF, (span.end - span.begin) * _HALF
    face = ways.faces[triangle]
    a, b, c = (
        wide(ways.vertices[span.key, face[0]]),
        wide(ways.vertices[span.key, face[1]]),
        wide(ways.vertices[span.key, face[2]]),
    )
    u = wide(ways.vertices[span.key + 1, face[0]]) - a
    v = wide(ways.vertices[span.key + 1, face[1]]) - b
    w = wide(ways.vertices[span.key + 1, face[2]]) - c
    moving = Moving()
    moving.a = a + u * share - origin
    moving.b = b + v * share - origin
    moving.c = c + w * share - origin
    moving.u = u * half
    moving.v = v * half
    moving.w = w * half
    return moving


@wp.func
def _gap(ways: Ways, span: Span, node: int, lower: wp.vec3, upper: wp.vec3) -> float:
    """The squared distance of a box to that of a node in the span."""
    begin, end = float(span.begin), float(span.end)
    a, b = ways.lower[span.key, node], ways.lower[span.key + 1, node]
    c, d = ways.upper[span.key, node], ways.upper[span.key + 1, node]
    low = wp.min(a * (1.0 - begin) + b * begin, a * (1.0 - end) + b * end)
    high = wp.max(c * (1.0 - begin) + d * begin, c * (1.0 - end) + d * end)
    room = wp.vec3(ways.room, ways.room, ways.room)
    gap = wp.max(wp.max(low - upper, lower - high) - room, wp.vec3())
    return wp.dot(gap, gap)


@wp.func
def next_moving_leaf(ways: Ways, span: Span, start: int, lower: wp.vec3, upper: wp.vec3, reach: float) -> int:
    """Go on with a walk: the first leaf from node ``start`` that comes near enough in the span, or the number of nodes.

    Args:
        ways: The hierarchy.
        span: Of time.
        start: Where the walk goes on.
        lower: Of the box that is asked about, rounded outwards.
        upper: Of that box.
        reach: ``squared_reach`` of the margin.
    """
    node = wp.int32(start)
    while node < ways.count:
        if _gap(ways, span, node, lower, upper) <= reach:
            if ways.links[node][1] > 0:
                return node
            node += 1
        else:
            node = ways.links[node][2]
    return node


@wp.func
def near_moving_leaf(ways: Ways, span: Span, lower: wp.vec3, upper: wp.vec3) -> int:
    """A leaf near a box: from the top, always the child that is nearer. There is at least one triangle."""
    node = wp.int32(0)
    while ways.links[node][1] == 0:
        left = node + 1
        right = ways.links[left][2]
        node = left
        if _gap(ways, span, right, lower, upper) < _gap(ways, span, left, lower, upper):
            node = right
    return node


class MovingTriangles:
    """A hierarchy, on the CPU.

    Args:
        times: ``(K,)``.
        frames: ``(K, V, 3)`` float32.
        faces: ``(F, 3)`` integers.
        cycles: ``(F,)`` uint64 (``surfaces.py``); zeros if ``None``.
    """

    def __init__(self, times: np.ndarray, frames: np.ndarray, faces: np.ndarray, cycles: np.ndarray | None = None):
        self._frames = frames
        cycles = np.zeros(len(faces), dtype=np.uint64) if cycles is None else cycles
        keys = np.unique(np.linspace(0, len(frames) - 1, SORTED_BY).astype(int))
        order = np.zeros(0, dtype=np.int64)
        if len(faces):
            boxes = [self._boxes(k, faces) for k in keys]
            order = sorted_order(np.concatenate([low / np.float32(2) + high / np.float32(2) for low, high in boxes], 1))
        self._faces = np.ascontiguousarray(faces[order], dtype=np.int32)
        links = nodes_of(*self._boxes(0, self._faces))[2] if len(faces) else np.zeros((0, 3), dtype=np.int32)
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
            if len(self._faces):
                self._lower[k], self._upper[k], _ = nodes_of(*self._boxes(k, self._faces))
            self._known[k] = True

    def _boxes(self, key: int, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """``(F, 3)`` and ``(F, 3)``, the boxes of triangles at a keyframe."""
        corners = self._frames[key][faces]
        return corners.min(axis=1), corners.max(axis=1)


# --- Walks ------------------------------------------------------------------------------------------------------------

# Relative to the largest coordinate M: with u = 2^-53, a corner that is interpolated at a share errs by less than
#   the share, 4 u of a way of up to 2 M          8 u M
#   the way, its product and the sum              7 u M
# together less than 2^-49 M; this is twice as much.
LOOSE = 2.0**-48

_LOOSE = wp.constant(wp.float64(LOOSE / 2.0**-20))  # of a hierarchy's room, which is 2^-20 of M
_INFINITY = wp.constant(float("inf"))


@wp.func
def _leaf_is_free(ways: Ways, span: Span, leaf: int, centre: wp.vec3d, half: wp.vec3d, margin: wp.float64) -> bool:
    link = ways.links[leaf]
    for i in range(link[0], link[1]):
        t = moving_at(ways, span, i, centre)
        if not moving_free(t, half, margin, moving_slack(t, half, margin)):
            return False
    return True


@wp.func
def moving_box_is_free(ways: Ways, span: Span, centre: wp.vec3d, half: wp.vec3d, margin: wp.float64) -> bool:
    """Is every triangle proven to be beyond the margin from the closed box around the centre, in all of the span?"""
    lower, upper, reach = floats_below(centre - half), floats_above(centre + half), squared_reach(margin)
    leaf = next_moving_leaf(ways, span, 0, lower, upper, reach)
    if leaf < ways.count:  # noqa: SIM102 (a near triangle tells most boxes that are not free; ``and`` would not wait)
        if not _leaf_is_free(ways, span, near_moving_leaf(ways, span, lower, upper), centre, half, margin):
            return False
    while leaf < ways.count:
        if not _leaf_is_free(ways, span, leaf, centre, half, margin):
            return False
        leaf = next_moving_leaf(ways, span, leaf + 1, lower, upper, reach)
    return True


@wp.func
def moving_segment_is_free(ways: Ways, span: Span, start: wp.vec3d, end: wp.vec3d, margin: wp.float64) -> bool:
    """Is every triangle proven to be further than the margin from the closed segment, in all of the span?"""
    lower, upper = floats_below(wp.min(start, end)), floats_above(wp.max(start, end))
    reach, s = squared_reach(margin), end - start
    leaf = next_moving_leaf(ways, span, 0, lower, upper, reach)
    while leaf < ways.count:
        link = ways.links[leaf]
        for i in range(link[0], link[1]):
            t = moving_at(ways, span, i, start)
            if not moving_segment_free(t, s, margin, moving_slack(t, wp.abs(s), margin)):
                return False
        leaf = next_moving_leaf(ways, span, leaf + 1, lower, upper, reach)
    return True


@wp.func
def _leaf_holds(ways: Ways, span: Span, leaf: int, centre: wp.vec3d, radius: wp.float64, margin: wp.float64) -> bool:
    zero = wp.vec3d()
    link = ways.links[leaf]
    for i in range(link[0], link[1]):
        t = moving_at(ways, span, i, centre)
        way = wp.max(wp.length(t.u), wp.max(wp.length(t.v), wp.length(t.w)))
        far = wp.length(closest_on_triangle(zero, t.a, t.b, t.c)) + way + radius
        if far + moving_slack(t, zero, margin) <= margin:
            return True
    return False


@wp.func
def moving_holds(ways: Ways, span: Span, centre: wp.vec3d, radius: wp.float64, margin: wp.float64) -> bool:
    """Does the ball around the centre lie within the margin of a single triangle for certain, in all of the span?"""
    if not radius < margin:
        return False
    lower, upper, reach = floats_below(centre), floats_above(centre), squared_reach(margin - radius)
    leaf = next_moving_leaf(ways, span, 0, lower, upper, reach)
    if leaf < ways.count:  # noqa: SIM102 (a kernel's ``and`` would not wait)
        if _leaf_holds(ways, span, near_moving_leaf(ways, span, lower, upper), centre, radius, margin):
            return True
    while leaf < ways.count:
        if _leaf_holds(ways, span, leaf, centre, radius, margin):
            return True
        leaf = next_moving_leaf(ways, span, leaf + 1, lower, upper, reach)
    return False


@wp.func
def _crossed_cycles(ways: Ways, span: Span, x: wp.vec3d, axis: int) -> wp.uint64:
    """As of triangles at rest (``triangles/hierarchy.py``), for a span that is a single time."""
    loose = _LOOSE * wp.float64(ways.room)
    lower, upper, reach = floats_below(x), floats_above(x), squared_reach(wp.float64(0.0))
    upper[axis] = _INFINITY
    crossed = wp.uint64(0)
    leaf = next_moving_leaf(ways, span, 0, lower, upper, reach)
    while leaf < ways.count:
        link = ways.links[leaf]
        for i in range(link[0], link[1]):
            if ways.cycles[i] != wp.uint64(0):
                t = moving_at(ways, span, i, x)
                crosses = crossing(t.a, t.b, t.c, axis, loose)
                if crosses < 0:
                    return wp.uint64(0)
                if crosses > 0:
                    crossed = crossed ^ ways.cycles[i]
        leaf = next_moving_leaf(ways, span, leaf + 1, lower, upper, reach)
    return crossed


@wp.func
def moving_encloses(ways: Ways, span: Span, x: wp.vec3d) -> bool:
    """Is it proven, by rays along the axes, that the triangles enclose x at the time of the span, a single one?"""
    for axis in range(3):  # noqa: SIM110 (a kernel has no ``any``)
        if _crossed_cycles(ways, span, x, axis) != wp.uint64(0):
            return True
    return False


# --- Sides ------------------------------------------------------------------------------------------------------------
#
# Is a point outside a closed surface that moves, at all times of a span? Grids over pieces of time know cells that
# are.
#
# What counts as inside at a time is what a flood from outside does not reach then. That may change where no face comes
# near: a vase that closes its neck makes its hollow part of the object. So it is not enough to be outside at one time,
# and each grid stands for a piece of time in which vertices go about a cell. A cell that meets no face at any time of
# the piece is free. What is connected with the grid's border through free cells is outside at all times of the piece;
# any other part of the free cells is enclosed at all of them if a ray proves it of one point at one time, because the
# number of faces that a way to infinity crosses, modulo 2, changes only where a face passes.
#
# A point is outside in a span if it is so in each piece: by its own cell, or by a cell nearby that is outside and to
# which a short segment is proven to meet no face at any time of the span in the piece.
#
# Grids are made when they are first asked for. All of a motion's together are small (``MOST_BYTES``).

RESOLUTIONS = (
    96,
    64,
    48,
    32,
    24,
    16,
    8,
)  # cells along the longest side of a grid; the first that is cheap enough counts
WAY = 1.0  # cells that a vertex goes in a piece, at most
MOST_BYTES = 2**26  # of all grids of a motion
MOST_PIECES = 1024  # between two keyframes: in pieces of a longer way vertices go farther
MOST_CELLS = 2 * RESOLUTIONS[0]  # along a side of a grid: where vertices go far in a piece, its cells are larger
FARTHEST = 5  # cells: how far a segment to a cell may reach
MOST_REGIONS, ASKED = 32, 8  # parts of the free cells that may be enclosed, and cells of each that rays are sent from
MOST_SEGMENTS = 14  # segments that are tried in a piece

_UNKNOWN, _OUTSIDE, _ENCLOSED = wp.constant(UNKNOWN), wp.constant(OUTSIDE), wp.constant(ENCLOSED)
_FARTHEST, _MOST_SEGMENTS = wp.constant(FARTHEST), wp.constant(MOST_SEGMENTS)
_INNER = wp.constant(wp.float64(INNER))


@wp.struct
class Pieces:
    """What kernels take. Without closed parts there are no pieces, and every point is outside."""

    count: int  # all of them
    rounding: wp.float64  # by which faces may be elsewhere
    first: wp.array(dtype=wp.int32)  # (K,), of the pieces after each keyframe
    known: wp.array(dtype=wp.uint8)  # whether a piece has its grid
    lower: wp.array(dtype=wp.vec3d)  # the box around the faces in a piece, rounding included
    upper: wp.array(dtype=wp.vec3d)
    origin: wp.array(dtype=wp.vec3d)  # centre of cell 0
    scale: wp.array(dtype=wp.float64)  # cells per unit
    shape: wp.array(dtype=wp.vec3i)
    begin: wp.array(dtype=wp.int64)  # of a piece's cells
    cells: wp.array(dtype=wp.uint8)  # UNKNOWN, OUTSIDE or ENCLOSED


@wp.func
def _cell(p: Pieces, piece: int, cell: wp.vec3i) -> int:
    shape = p.shape[piece]
    for k in range(3):
        if cell[k] < 0 or cell[k] >= shape[k]:
            return _OUTSIDE
    place = (wp.int64(cell[0]) * wp.int64(shape[1]) + wp.int64(cell[1])) * wp.int64(shape[2]) + wp.int64(cell[2])
    return int(p.cells[p.begin[piece] + place])


@wp.func
def _beyond(p: Pieces, piece: int, x: wp.vec3d) -> bool:
    for k in range(3):  # noqa: SIM110 (a kernel has no ``any``)
        if x[k] < p.lower[piece][k] or x[k] > p.upper[piece][k]:
            return True
    return False


@wp.func
def _own_cell(p: Pieces, piece: int, x: wp.vec3d) -> wp.vec3i:
    own, t = wp.vec3i(), (x - p.origin[piece]) * p.scale[piece]
    for k in range(3):
        own[k] = int(wp.floor(t[k] + _HALF))
    return own


@wp.func
def _known_side(p: Pieces, piece: int, x: wp.vec3d) -> int:
    """The side of a point at all times of a piece, as its cell tells."""
    if p.known[piece] == wp.uint8(0):
        return _UNKNOWN
    if _beyond(p, piece, x):
        return _OUTSIDE
    return _cell(p, piece, _own_cell(p, piece, x))


@wp.func
def _leads_to(ways: Ways, p: Pieces, piece: int, span: Span, x: wp.vec3d, side: int) -> bool:
    """Is it proven, by a segment to a cell of a side, that x is on this side at all times of a span in a piece?"""
    t = (x - p.origin[piece]) * p.scale[piece]
    own = _own_cell(p, piece, x)
    tried = wp.int32(0)
    for far in range(1, _FARTHEST + 1):
        for way in range(27):
            step = wp.vec3i(way // 9 - 1, (way // 3) % 3 - 1, way % 3 - 1) * far
            cell = own + step
            if way != 13 and _cell(p, piece, cell) == side:
                end = wp.vec3d()
                for k in range(3):
                    middle = wp.float64(cell[k])
                    end[k] = wp.clamp(t[k], middle - _INNER, middle + _INNER)
                if moving_segment_is_free(ways, span, x, p.origin[piece] + end / p.scale[piece], p.rounding):
                    return True
                tried += 1
                if tried >= _MOST_SEGMENTS:
                    return False
    return False


@wp.func
def _piece_at(p: Pieces, key: int, share: wp.float64) -> int:
    count = p.first[key + 1] - p.first[key]
    return p.first[key] + wp.min(int(share * wp.float64(count)), count - 1)


@wp.func
def outside_in(ways: Ways, p: Pieces, span: Span, x: wp.vec3d) -> bool:
    """Is it proven that x, finite numbers, is outside at all times of a span?"""
    if p.count == 0:
        return True
    begin, end = _piece_at(p, span.key, span.begin), _piece_at(p, span.key, span.end)
    for piece in range(begin, end + 1):
        if _known_side(p, piece, x) == _ENCLOSED:
            return False
    asked = wp.bool(False)
    for piece in range(begin, end + 1):
        if _known_side(p, piece, x) != _OUTSIDE:
            if p.known[piece] == wp.uint8(0):
                return False
            if not asked:
                if moving_encloses(ways, span_of(span.key, span.begin, span.begin), x):
                    return False
                asked = True
            count = wp.float64(p.first[span.key + 1] - p.first[span.key])
            number = piece - p.first[span.key]
            begins = wp.max(span.begin, wp.float64(number) / count)
            part = span_of(span.key, begins, wp.min(span.end, wp.float64(number + 1) / count))
            if not _leads_to(ways, p, piece, part, x, _OUTSIDE):
                return False
    return True


@wp.func
def side_in(ways: Ways, p: Pieces, span: Span, x: wp.vec3d) -> int:
    """The side of x at the time of the span, a single one, if x is farther than the rounding from all faces."""
    if p.count == 0:
        return _OUTSIDE
    piece = _piece_at(p, span.key, span.begin)
    side = _known_side(p, piece, x)
    if side != _UNKNOWN:
        return side
    if moving_encloses(ways, span, x):
        return _ENCLOSED
    if p.known[piece] == wp.uint8(0):
        return _UNKNOWN
    if _leads_to(ways, p, piece, span, x, _OUTSIDE):
        return _OUTSIDE
    if _leads_to(ways, p, piece, span, x, _ENCLOSED):
        return _ENCLOSED
    return _UNKNOWN


@wp.kernel(enable_backward=False)
def _enclose(
    first: int,
    # inputs
    ways: Ways,
    key: int,
    share: wp.float64,
    centres: wp.array(dtype=wp.vec3d),
    # outputs
    enclosed: wp.array(dtype=wp.uint8),
):
    """Is a centre proven to be enclosed?"""
    i, _ = wp.tid()
    i += first
    enclosed[i] = wp.uint8(moving_encloses(ways, span_of(key, share, share), centres[i]))


class MovingSides:
    """The grids of a motion, on the CPU.

    Args:
        triangles: The closed parts' faces.
        frames: ``(K, V, 3)`` float32.
        faces: ``(F, 3)`` integers, all of them of closed parts.
        rounding: By which vertices may be elsewhere.
    """

    def __init__(self, triangles: MovingTriangles, frames: np.ndarray, faces: np.ndarray, rounding: float):
        self._triangles, self._rounding = triangles, rounding
        used, faces = np.unique(faces, return_inverse=True)
        self._faces, self._used, self._frames = faces.reshape(-1, 3).astype(np.int32), used, frames
        self._size, self._counts, self._cell_bytes = 1.0, np.zeros(len(frames) - 1, dtype=np.int64), []
        if len(faces):
            self._plan()
        first = np.concatenate([[0], np.cumsum(self._counts)]).astype(np.int32)
        count = int(first[-1])
        room = int((self._counts * self._cell_bytes).sum()) if count else 0
        self._arrays = {
            "first": (first, wp.int32),
            "known": (np.zeros(count, dtype=np.uint8), wp.uint8),
            "lower": (np.zeros((count, 3)), wp.vec3d),
            "upper": (np.zeros((count, 3)), wp.vec3d),
            "origin": (np.zeros((count, 3)), wp.vec3d),
            "scale": (np.zeros(count), wp.float64),
            "shape": (np.zeros((count, 3), dtype=np.int32), wp.vec3i),
            "begin": (np.zeros(count, dtype=np.int64), wp.int64),
            "cells": (np.empty(room, dtype=np.uint8), wp.uint8),
        }
        self._next = 0  # cell that is free
        self.pieces = Pieces()
        self.pieces.count, self.pieces.rounding = count, wp.float64(rounding)
        for name, (array, dtype) in self._arrays.items():
            setattr(self.pieces, name, wp.array(array, dtype=dtype, device="cpu", copy=False))

    def _plan(self) -> None:
        """Choose how large cells are, and how many pieces there are between keyframes."""
        corners = [f[self._used].astype(np.float64) for f in self._frames]
        boxes = np.array([[f.min(axis=0), f.max(axis=0)] for f in corners])
        ways = np.array([np.linalg.norm(b - a, axis=1).max() for a, b in pairwise(corners)])
        sides = np.maximum((boxes[:-1, 1] - boxes[:-1, 0]), (boxes[1:, 1] - boxes[1:, 0]))
        self._size = float(sides.max())
        for resolution in RESOLUTIONS:
            cell = self._size / resolution
            self._counts = np.clip(np.ceil(ways / (WAY * cell)), 1, MOST_PIECES).astype(np.int64)
            # In a piece the box of the faces is larger than at its ends by the way of a piece at most.
            piece = sides + (ways / self._counts)[:, None] + 4 * self._rounding
            piece = np.ceil(np.minimum(piece / cell, MOST_CELLS)) + 5
            self._cell_bytes = np.prod(piece, axis=1).astype(np.int64)
            self._cell = cell
            if (self._counts * self._cell_bytes).sum() <= MOST_BYTES:
                break

    def know(self, spans: np.ndarray) -> None:
        """Make the grids of some spans.

        Args:
            spans: ``(N, 2)`` float64, keyframes plus shares, first and last times.
        """
        if not self.pieces.count:
            return
        first, known = self._arrays["first"][0], self._arrays["known"][0]
        k = np.clip(np.floor(spans).astype(int), 0, len(self._counts) - 1)
        place = np.clip((spans - k) * self._counts[k], 0, self._counts[k] - 1)
        begin, end = (first[k] + place).T
        # A piece more where rounding could tell them apart: a piece that is not known is no error, only no answer.
        begin = np.floor(begin - 1e-6).astype(int).clip(0)
        end = np.floor(end + 1e-6).astype(int).clip(None, len(known) - 1)
        asked = np.bincount(begin, minlength=len(known) + 1) - np.bincount(end + 1, minlength=len(known) + 1)
        for piece in np.flatnonzero((np.cumsum(asked)[:-1] > 0) & (known == 0)):
            self._make(int(piece))

    def _make(self, piece: int) -> None:
        from warp_bounding.indicators.triangles.cells import SLACK, surface_cells

        array = {name: a for name, (a, _) in self._arrays.items()}
        key = int(np.searchsorted(array["first"], piece, side="right")) - 1
        count = self._counts[key]
        shares = (piece - int(array["first"][key]) + np.array([0.0, 0.5, 1.0])) / count
        start, end = (self._frames[k][self._used].astype(np.float64) for k in (key, key + 1))
        low, middle, high = ((1 - s) * start + s * end for s in shares)
        lower = np.minimum(low, high).min(axis=0) - 2 * self._rounding
        upper = np.maximum(low, high).max(axis=0) + 2 * self._rounding
        cell = max(self._cell, float((upper - lower).max()) / MOST_CELLS)
        origin = lower - BORDER * cell
        half_way = np.linalg.norm(high - low, axis=1)[self._faces].max(axis=1) / 2
        shape = tuple((np.floor((upper - origin) / cell + 0.5).astype(int) + 3).tolist())
        dilation = (half_way + self._rounding) / cell * (1 + 1e-9) + SLACK
        surface = surface_cells((middle - origin) / cell, self._faces, shape, dilation)
        cells = self._sides(surface, key, shares[1], origin, cell)
        size = math.prod(shape)
        if self._next + size > len(array["cells"]):
            raise AssertionError("the room for cells was planned too small")
        array["cells"][self._next : self._next + size] = cells.ravel()
        array["begin"][piece], self._next = self._next, self._next + size
        array["lower"][piece], array["upper"][piece], array["origin"][piece] = lower, upper, origin
        array["scale"][piece], array["shape"][piece], array["known"][piece] = 1 / cell, shape, 1

    def _sides(self, surface: np.ndarray, key: int, share: float, origin: np.ndarray, cell: float) -> np.ndarray:
        from scipy import ndimage

        region, regions = ndimage.label(~surface)
        outside = region[0, 0, 0]
        numbers = [number for number in range(1, regions + 1) if number != outside][:MOST_REGIONS]
        cells = [np.flatnonzero(region == number) for number in numbers]
        asked = np.array([c[np.linspace(0, len(c) - 1, ASKED).astype(int)] for c in cells], dtype=int).ravel()
        centres = origin + np.stack(np.unravel_index(asked, surface.shape), axis=1) * cell
        enclosed = np.zeros(len(asked), dtype=np.uint8)
        self._triangles.know(np.array([key, key + 1]))
        inputs = [self._triangles.ways, key, wp.float64(share), wp.array(centres, dtype=wp.vec3d, device="cpu")]
        answers = wp.array(enclosed, dtype=wp.uint8, device="cpu", copy=False)
        launch_on_cores(_enclose, len(asked), inputs, [answers], "cpu")
        side = np.full(regions + 1, UNKNOWN, dtype=np.uint8)
        side[np.repeat(numbers, ASKED)[enclosed > 0].astype(int)] = ENCLOSED
        side[outside] = OUTSIDE
        return side[region]
