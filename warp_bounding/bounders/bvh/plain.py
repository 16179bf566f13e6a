"""The plain twin of the hierarchy: the walk through its nodes, and what a point, ray, plane or box asks of each."""

import warp as wp

from warp_bounding.bounders.slabs.plain import clipped
from warp_bounding.coordinates.base import GUARD
from warp_bounding.kernels.plain import Numbers, Words, twin, vector_type
from warp_bounding.kernels.source import Source

__all__ = ["box_touches", "plain_walk"]


def plain_walk(source: Source, leading: int) -> wp.Function:
    """0 where a leaf is met, else -1: after a node that is met the next one, after others the one behind the subtree."""
    size, vector, touches = 2 * source.ndim + 1, vector_type(source.coordinates), box_touches(source)
    both = vector_type(2 * source.ndim)

    @twin(source)
    def f(w: Numbers, words: Words, at: int, v: vector) -> float:
        count, i, value, box = int(w[at]), wp.int32(0), wp.float32(-1.0), both()
        while i < count:
            node = at + leading + i * size
            past = int(w[node + size - 1])
            for k in range(size - 1):
                box[k] = w[node + k]
            if touches(w[at + 1], box, v):
                i += 1
                if past == i:  # a leaf
                    value = wp.float32(0.0)
                    i = count
            else:
                i = past
        return value

    return f


def box_touches(source: Source) -> wp.Function:
    """``touches(room, box, v)``: whether a query meets a box, of which low and high are given; ``room`` is a plane's."""
    return _TOUCHES[source.query](source)


def _box(source: Source) -> wp.Function:
    """A box, or a point as both of its corners."""
    n, vector, last = source.ndim, vector_type(source.coordinates), source.coordinates - source.ndim
    both = vector_type(2 * n)

    @twin(source, "touches")
    def touches(room: float, box: both, v: vector) -> bool:
        met = wp.bool(True)
        for k in range(n):
            met = met and v[last + k] >= box[k] and v[k] <= box[n + k]
        return met

    return touches


def _plane(source: Source) -> wp.Function:
    """Whether a plane lies between the box's supports, which have room for rounding."""
    n, vector = source.ndim, vector_type(source.coordinates)
    both = vector_type(2 * n)

    @twin(source, "touches")
    def touches(room: float, box: both, v: vector) -> bool:
        most, least = wp.float32(0.0), wp.float32(0.0)
        for k in range(n):
            low, high = v[k] * box[k], v[k] * box[n + k]
            most += wp.max(low, high)
            least += wp.min(low, high)
        return v[n] - room <= most and v[n] + room >= least

    return touches


def _ray(source: Source) -> wp.Function:
    """Whether something of a segment is left in the box."""
    n, vector = source.ndim, vector_type(source.coordinates)
    both = vector_type(2 * n)

    @twin(source, "touches")
    def touches(room: float, box: both, v: vector) -> bool:
        enter, leave = wp.float32(0.0), wp.float32(1.0)
        for k in range(n):
            near, away = clipped(box[k], box[n + k], v[k], v[n + k])
            enter = wp.max(enter, near)
            leave = wp.min(leave, away)
        return enter <= leave + GUARD

    return touches


_TOUCHES = {"point": _box, "ray": _ray, "plane": _plane, "box": _box}
