"""The plain twins of slabs: ``f`` of points, rays, planes and boxes. Numbers and room are those of ``slabs.base`` and ``slabs.regions``."""

import warp as wp

from warp_bounding.coordinates.base import GUARD, PARALLEL
from warp_bounding.kernels.plain import Numbers, Words, twin, vector_type
from warp_bounding.kernels.source import Source

__all__ = ["PLAIN", "clipped", "plain_corners", "plain_row"]


@wp.func
def clipped(low: wp.float32, high: wp.float32, y: wp.float32, speed: wp.float32):
    """The parameters between which ``y + t speed`` lies in [low, high]; a ray that runs along a face counts as ever so slow."""
    slow = 1.0 / wp.where(wp.abs(speed) > PARALLEL, speed, PARALLEL)
    one, two = (low - y) * slow, (high - y) * slow
    return wp.min(one, two), wp.max(one, two)


def plain_row(source: Source, diagonal: bool = False) -> wp.Function:
    """``row(w, at, i, v, first)``: direction i of those at ``w[at]`` times the point at ``v[first]``."""
    n, vector = source.tested_ndim, vector_type(source.coordinates)

    @twin(source, "row")
    def row(w: Numbers, at: int, i: int, v: vector, first: int) -> float:
        if diagonal:
            return v[first + i]
        y = wp.float32(0.0)
        for j in range(n):
            y += v[first + j] * w[at + i * n + j]
        return y

    return row


def plain_point(source: Source) -> wp.Function:
    """The least distance to a face."""
    slabs, vector, row = source.slabs, vector_type(source.coordinates), plain_row(source, source.diagonal)

    @twin(source)
    def f(w: Numbers, words: Words, at: int, v: vector) -> float:
        least = wp.float32(3.0e38)
        for i in range(slabs):
            y = row(w, at + 2 * slabs, i, v, 0)
            least = wp.min(least, wp.min(y - w[at + i], w[at + slabs + i] - y))
        return least

    return f


def plain_ray(source: Source) -> wp.Function:
    """0 where something of the segment is left between all faces, else -1."""
    n, slabs, vector, row = (
        source.ndim,
        source.slabs,
        vector_type(source.coordinates),
        plain_row(source, source.diagonal),
    )

    @twin(source)
    def f(w: Numbers, words: Words, at: int, v: vector) -> float:
        enter, leave = wp.float32(0.0), wp.float32(1.0)
        for i in range(slabs):
            y, speed = row(w, at + 2 * slabs, i, v, 0), row(w, at + 2 * slabs, i, v, n)
            near, away = clipped(w[at + i], w[at + slabs + i], y, speed)
            enter = wp.max(enter, near)
            leave = wp.min(leave, away)
        return wp.where(enter <= leave + GUARD, 0.0, -1.0)

    return f


def plain_plane(source: Source) -> wp.Function:
    """How far the plane is inside of the support: of a parallelepiped by its edges, of other polytopes by their vertices."""
    n, diagonal, vector, row = (
        source.ndim,
        source.diagonal,
        vector_type(source.coordinates),
        plain_row(source, source.diagonal),
    )
    if source.slabs > n:
        return plain_corners(source)

    @twin(source)
    def f(w: Numbers, words: Words, at: int, v: vector) -> float:
        off = v[n]
        reach = wp.float32(0.0)
        for j in range(n):
            off -= v[j] * w[at + j]
        for i in range(n):
            if diagonal:
                reach += wp.abs(v[i] * w[at + n + i])
            else:
                reach += wp.abs(row(w, at + n, i, v, 0))
        return reach - wp.abs(off)

    return f


def plain_corners(source: Source) -> wp.Function:
    """How far the plane is inside of the support of a polytope, by its vertices."""
    n, vector, row = source.ndim, vector_type(source.coordinates), plain_row(source)

    @twin(source)
    def f(w: Numbers, words: Words, at: int, v: vector) -> float:
        most, least = wp.float32(-3.0e38), wp.float32(3.0e38)
        for i in range(int(w[at])):
            y = row(w, at + 1, i, v, 0)
            most = wp.max(most, y)
            least = wp.min(least, y)
        return wp.min(most - v[n], v[n] - least)

    return f


def plain_box(source: Source) -> wp.Function:
    """The least overlap of intervals on the slabs' directions."""
    n, slabs, diagonal, vector = source.ndim, source.slabs, source.diagonal, vector_type(source.coordinates)

    @twin(source)
    def f(w: Numbers, words: Words, at: int, v: vector) -> float:
        least = wp.float32(3.0e38)
        for i in range(slabs):
            low, high = wp.float32(0.0), wp.float32(0.0)
            if diagonal:
                low = v[i]
                high = v[n + i]
            else:
                middle, half = wp.float32(0.0), wp.float32(0.0)
                for j in range(n):
                    d = w[at + 2 * slabs + i * n + j]
                    middle += (v[j] + v[n + j]) * 0.5 * d
                    half += (v[n + j] - v[j]) * 0.5 * wp.abs(d)
                low, high = middle - half, middle + half
            least = wp.min(least, wp.min(high - w[at + i], w[at + slabs + i] - low))
        return least

    return f


PLAIN = {"point": plain_point, "ray": plain_ray, "plane": plain_plane, "box": plain_box}
