"""Half-spaces that hold a mesh of blend shapes in boxes of place and pose, where a box is not certified to be empty.

With n of length 1 and rates ``r``, ``n . (vertex - place) - r . pose`` is linear in place and pose. Its largest value over the box and over all
vertices of a triangle near it is a level that no point of the triangle passes in the box, and that and the margin none that no point within the
margin passes. Beyond it lies a convex part of the box, in place and pose together, that meets no triangle: the surface winds around all of it
as often as around its farthest corner. Where that is outside, all of it is.

Of a triangle with the normal m only what is near the box counts: there ``n . p = (n - s m) . p + s m . p`` for any s, of which the first is
bounded by the box and the second is linear in place and pose again. n is the way from the nearest triangle to the place at the box's centre, or
the other way, and r is how that triangle moves along it.
"""

from functools import cache

import warp as wp

from warp_bounding.indicators.blends.answers import Blends, functions_of, half_side
from warp_bounding.indicators.triangles.arithmetic import closest_on_triangle
from warp_bounding.indicators.triangles.excess import SHORTEST
from warp_bounding.runtime.native import named

__all__ = ["half_spaces_kernel"]

_ZERO, _ONE, _HALF, _QUARTER = (wp.constant(wp.float64(value)) for value in (0.0, 1.0, 0.5, 0.25))
_THIRD, _FOUR = wp.constant(wp.float64(1.0 / 3.0)), wp.constant(wp.float64(4.0))
_INFINITY, _SHORTEST = wp.constant(wp.float64(float("inf"))), wp.constant(wp.float64(SHORTEST))


@cache
def half_spaces_kernel(n: int) -> wp.Kernel:
    """The kernel for points of n coordinates."""
    values, poses = wp.types.vector(length=n, dtype=wp.float64), n - 3
    seen, apart, gap, winding = functions_of(n)

    @named(f"blend_passes_{n}").func
    def passes(b: Blends, i: int, along: wp.vec3d, at: wp.vec3d, rates: values, half: values) -> wp.float64:
        """The largest ``along . (vertex - place of the centre) - rates . pose`` of vertex i over a box, ``at`` the vertex less the place at its centre."""
        most = wp.dot(along, at)
        for k in range(poses):
            most += wp.abs(wp.dot(along, b.deltas[k, i]) - rates[3 + k]) * half[3 + k]
        return most

    @named(f"blend_support_{n}").func
    def support(
        b: Blends, face: wp.vec3i, corners: wp.mat33d, along: wp.vec3d, rates: values, half: values
    ) -> wp.float64:
        """The level that no point of a triangle passes where it is within the margin of the box."""
        p, q, r = corners[0], corners[1], corners[2]
        own = wp.max(
            wp.max(passes(b, face[0], along, p, rates, half), passes(b, face[1], along, q, rates, half)),
            passes(b, face[2], along, r, rates, half),
        )
        across = wp.cross(q - p, r - p)
        size = wp.length(across)
        if size > _SHORTEST:
            m = across / size
            s = wp.dot(along, m)
            rest, tilted = along - m * s, m * s
            near = wp.float64(0.0)
            for k in range(3):
                near += wp.abs(rest[k]) * (half[k] + b.margin + b.allowance)
            clipped = wp.max(
                wp.max(passes(b, face[0], tilted, p, rates, half), passes(b, face[1], tilted, q, rates, half)),
                passes(b, face[2], tilted, r, rates, half),
            )
            own = wp.min(own, near + clipped)
        if own < _INFINITY:
            return own
        return _INFINITY  # also for NaN, which max would drop

    @named(f"blend_half_spaces_{n}").kernel
    def half_spaces(
        first: int,
        # inputs
        b: Blends,
        lower: wp.array(dtype=values),
        upper: wp.array(dtype=values),
        # outputs
        empty: wp.array(dtype=wp.uint8),
        level: wp.array(dtype=wp.float64),
        slope: wp.array(dtype=values),
        axis: wp.array(dtype=wp.int32),
        loss: wp.array(dtype=wp.float64),
    ):
        """Is a closed box certain to be empty? Else a half-space of the object's points in it, around its centre; what is there stays where none is found."""
        t, _ = wp.tid()
        t += first
        low, high = lower[t], upper[t]
        center, half = values(), values()
        for i in range(n):
            if not (low[i] <= high[i] and wp.abs(low[i]) < _INFINITY and wp.abs(high[i]) < _INFINITY):
                return
            center[i] = low[i] * _HALF + high[i] * _HALF
            half[i] = half_side(low[i], high[i])
        close, nearest, away = wp.int32(0), wp.int32(0), wp.float64(wp.inf)
        way = wp.vec3d(center[0], center[1], center[2])
        for patch in range(b.low.shape[0]):
            if not apart(b, patch, center, half) > b.margin:
                for i in range(b.first[patch], b.first[patch + 1]):
                    corners = seen(b, b.faces[i], center)
                    p, q, r = corners[0], corners[1], corners[2]
                    if not gap(b, b.faces[i], p, q, r, half) > b.margin:
                        close += 1
                        near = closest_on_triangle(wp.vec3d(), p, q, r)
                        length = wp.length(near)
                        if length < away:
                            away = length
                            nearest = i
                            way = near
        if close == 0:
            if winding(b, center) < _QUARTER:
                empty[t] = wp.uint8(1)
            return
        if not away < _INFINITY:
            return
        face = b.faces[nearest]
        if not away > _FOUR * b.allowance:  # so near that the triangle's normal tells the way
            corners = seen(b, face, center)
            p, q, r = corners[0], corners[1], corners[2]
            way = wp.cross(q - p, r - p)
        length = wp.length(way)
        if not (length > _SHORTEST and length < _INFINITY):
            return
        along, rates = way / -length, values()
        for k in range(poses):
            moved = b.deltas[k, face[0]] + b.deltas[k, face[1]] + b.deltas[k, face[2]]
            rates[3 + k] = wp.dot(along, moved) * _THIRD
        forth, back, bends = wp.float64(-wp.inf), wp.float64(-wp.inf), values()
        for patch in range(b.low.shape[0]):
            if not apart(b, patch, center, half) > b.margin:
                for i in range(b.first[patch], b.first[patch + 1]):
                    corners = seen(b, b.faces[i], center)
                    p, q, r = corners[0], corners[1], corners[2]
                    if not gap(b, b.faces[i], p, q, r, half) > b.margin:
                        forth = wp.max(forth, support(b, b.faces[i], corners, along, rates, half))
                        back = wp.max(back, support(b, b.faces[i], corners, -along, -rates, half))
                        for k in range(poses):
                            for j in range(3):
                                rate = wp.dot(along, b.deltas[k, b.faces[i][j]])
                                bends[3 + k] = wp.max(bends[3 + k], wp.abs(rate - rates[3 + k]) * half[3 + k])
        top = wp.float64(0.0)
        for k in range(n):
            top += wp.where(k < 3, wp.abs(along[k % 3]), wp.abs(rates[k])) * half[k]
        for side in range(2):
            sign = wp.where(side == 0, _ONE, -_ONE)
            above = wp.where(side == 0, forth, back) + b.margin + _FOUR * b.allowance
            if above < top:
                corner = values()
                for k in range(n):
                    rate = sign * wp.where(k < 3, along[k % 3], -rates[k])
                    corner[k] = center[k] + wp.where(rate < _ZERO, -half[k], half[k])
                if winding(b, corner) < _QUARTER:
                    level[t] = above
                    own, most = values(), _ZERO
                    for k in range(n):
                        own[k] = sign * wp.where(k < 3, -along[k % 3], rates[k])
                        bend = wp.where(k < 3, half[k] * (_ONE - wp.abs(along[k % 3])), bends[k])
                        if bend > most:
                            most = bend
                            axis[t] = k
                    slope[t] = own
                    loss[t] = above - b.margin - sign * wp.dot(along, way)
                    return

    return half_spaces
