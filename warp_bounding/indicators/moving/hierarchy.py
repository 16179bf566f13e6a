"""A hierarchy of boxes over triangles that move: one tree for all times, with a box of each node at each keyframe.

Between two keyframes each coordinate of a corner goes straight, so the box of a node at a time lies within what is
interpolated between its boxes at both. The tree is that of ``triangles/hierarchy.py``, and it is walked in the same
way; only which triangles stand together is told by where they are at several keyframes. Boxes of a keyframe are made
when they are first needed.
"""

import numpy as np
import warp as wp

from warp_bounding.indicators.moving.arithmetic import Moving
from warp_bounding.indicators.triangles.hierarchy import nodes_of, sorted_order, wide

__all__ = [
    "MovingTriangles",
    "Span",
    "Ways",
    "moving_at",
    "near_moving_leaf",
    "next_moving_leaf",
    "span_between",
    "span_of",
]

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
        cycles: ``(F,)`` uint64 (``triangles/cycles.py``); zeros if ``None``.
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
