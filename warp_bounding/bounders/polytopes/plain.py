"""The plain twins of free half-spaces: ``f`` of points, rays and boxes; planes are tested as against slabs."""

import warp as wp

from warp_bounding.bounders.slabs.plain import plain_corners, plain_row
from warp_bounding.coordinates.base import GUARD, PARALLEL
from warp_bounding.kernels.plain import Numbers, Words, twin, vector_type
from warp_bounding.kernels.source import Source

__all__ = ["PLAIN"]


def plain_point(source: Source) -> wp.Function:
    """The least distance to a face."""
    faces, vector, row = source.half_spaces, vector_type(source.coordinates), plain_row(source)

    @twin(source)
    def f(w: Numbers, words: Words, at: int, v: vector) -> float:
        least = wp.float32(3.0e38)
        for i in range(faces):
            least = wp.min(least, w[at + i] - row(w, at + faces, i, v, 0))
        return least

    return f


def plain_ray(source: Source) -> wp.Function:
    """0 where something of the segment is left on the inner side of all faces, else -1."""
    n, faces, vector, row = source.ndim, source.half_spaces, vector_type(source.coordinates), plain_row(source)

    @twin(source)
    def f(w: Numbers, words: Words, at: int, v: vector) -> float:
        come, gone = wp.float32(0.0), wp.float32(1.0)
        for i in range(faces):
            y, s = row(w, at + faces, i, v, 0), row(w, at + faces, i, v, n)
            cross = wp.where(wp.abs(s) > PARALLEL, s, PARALLEL)
            t = (w[at + i] - y) / cross
            if cross < 0.0:
                come = wp.max(come, t)
            else:
                gone = wp.min(gone, t)
        return wp.where(come <= gone + GUARD, 0.0, -1.0)

    return f


def plain_box(source: Source) -> wp.Function:
    """The least distance of a nearest corner to its face."""
    n, faces, vector = source.ndim, source.half_spaces, vector_type(source.coordinates)

    @twin(source)
    def f(w: Numbers, words: Words, at: int, v: vector) -> float:
        least = wp.float32(3.0e38)
        for i in range(at, at + faces):
            y = wp.float32(0.0)
            for j in range(n):
                a = w[at + faces + (i - at) * n + j]
                y += wp.where(a < 0.0, v[n + j], v[j]) * a
            least = wp.min(least, w[i] - y)
        return least

    return f


PLAIN = {"point": plain_point, "ray": plain_ray, "plane": plain_corners, "box": plain_box}
