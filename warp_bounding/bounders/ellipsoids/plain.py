"""The plain twins of ellipsoids: ``f`` of points, rays, planes and boxes. Numbers are those of ``ellipsoids.base`` and ``ellipsoids.regions``."""

import warp as wp

from warp_bounding.bounders.ellipsoids.native import SMALLEST, SWEEPS
from warp_bounding.kernels.plain import Numbers, Words, twin, vector_type
from warp_bounding.kernels.source import Source

__all__ = ["PLAIN"]


def plain_rows(source: Source, size: int) -> wp.Function:
    """``rows(w, at, v, first)``: the matrix at ``w[at]`` times the vector at ``v[first]``."""
    diagonal, numbers, vector = source.diagonal, vector_type(source.coordinates), vector_type(size)

    @twin(source, "rows")
    def rows(w: Numbers, at: int, v: numbers, first: int) -> vector:
        z = vector()
        for i in range(size):
            if diagonal:
                z[i] = v[first + i] * w[at + i]
            else:
                for j in range(size):
                    z[i] += v[first + j] * w[at + i * size + j]
        return z

    return rows


def plain_point(source: Source) -> wp.Function:
    """``-|A v + b|^2``."""
    n = source.coordinates
    vector, rows = vector_type(n), plain_rows(source, n)

    @twin(source)
    def f(w: Numbers, words: Words, at: int, v: vector) -> float:
        z, value = rows(w, at + n, v, 0), wp.float32(0.0)
        for i in range(n):
            y = z[i] + w[at + i]
            value -= y * y
        return value

    return f


def plain_ray(source: Source) -> wp.Function:
    """The segment's point nearest to the centre, where the ellipsoid is a ball."""
    n, numbers, rows = source.ndim, vector_type(source.coordinates), plain_rows(source, source.ndim)

    @twin(source)
    def f(w: Numbers, words: Words, at: int, v: numbers) -> float:
        y, s = rows(w, at + n, v, 0), rows(w, at + n, v, n)
        along, length, t, value = wp.float32(0.0), wp.float32(0.0), wp.float32(0.0), wp.float32(0.0)
        for i in range(n):
            y[i] += w[at + i]
            along -= y[i] * s[i]
            length += s[i] * s[i]
        if length > SMALLEST:
            t = wp.clamp(along / length, 0.0, 1.0)
        for i in range(n):
            z = y[i] + t * s[i]
            value -= z * z
        return value

    return f


def plain_plane(source: Source) -> wp.Function:
    """The distance of the plane from the centre, where the ellipsoid is a ball."""
    n, numbers, rows = source.ndim, vector_type(source.coordinates), plain_rows(source, source.ndim)

    @twin(source)
    def f(w: Numbers, words: Words, at: int, v: numbers) -> float:
        g, length = rows(w, at + n, v, 0), wp.float32(0.0)
        off = v[n]
        for i in range(n):
            off -= v[i] * w[at + i]
            length += g[i] * g[i]
        return -(off * off) / length

    return f


def plain_box(source: Source) -> wp.Function:
    """The distance of the box: row by row where A is diagonal, else by a plane between the centre and a point near it."""
    n, diagonal, numbers = source.ndim, source.diagonal, vector_type(source.coordinates)
    vector, steps = vector_type(n), n + n * n
    start = steps + n

    @twin(source)
    def intervals(w: Numbers, words: Words, at: int, v: numbers) -> float:
        value = wp.float32(0.0)
        for i in range(n):
            a, b = v[i] * w[at + n + i] + w[at + i], v[n + i] * w[at + n + i] + w[at + i]
            z = wp.max(wp.max(wp.min(a, b), -wp.max(a, b)), 0.0)
            value -= z * z
        return value

    @twin(source, "descent")
    def descent(w: Numbers, words: Words, at: int, v: numbers) -> float:
        y, z = vector(), vector()
        for j in range(n):
            y[j] = wp.clamp(w[at + start + j], v[j], v[n + j])
        for i in range(n):
            for j in range(n):
                z[i] += y[j] * w[at + n + i * n + j]
            z[i] += w[at + i]
        for _sweep in range(SWEEPS):
            for j in range(n):
                slope = wp.float32(0.0)
                for i in range(n):
                    slope += z[i] * w[at + n + i * n + j]
                to = wp.clamp(y[j] - slope * w[at + steps + j], v[j], v[n + j])
                for i in range(n):
                    z[i] += (to - y[j]) * w[at + n + i * n + j]
                y[j] = to
        length, least = wp.float32(0.0), wp.float32(0.0)
        for i in range(n):
            length += z[i] * z[i]
            least += z[i] * w[at + i]
        for j in range(n):
            m = wp.float32(0.0)
            for i in range(n):
                m += z[i] * w[at + n + i * n + j]
            least += wp.min(m * v[j], m * v[n + j])
        if length > SMALLEST:
            return -wp.max(least, 0.0) * wp.max(least, 0.0) / length
        return 0.0

    return intervals if diagonal else descent


PLAIN = {"point": plain_point, "ray": plain_ray, "plane": plain_plane, "box": plain_box}
