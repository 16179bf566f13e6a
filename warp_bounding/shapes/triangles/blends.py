"""What a mesh of blend shapes answers, in float64 kernels: about points and closed boxes of place and pose.

A vertex is at ``v + sum_k p_k d_k``. For any direction u of length 1, ``u . (x - vertex)`` is a linear function of
place and pose, so that its least value over a box is known exactly, and the least of the three of a triangle's vertices
tells how far the triangle stays from the place, all over the box, along u. Whatever u is, that is a lower bound of the
distance; the best is the way from the triangle's nearest point, at the box's centre. Where it is above the margin for
every triangle, no place of the box is within the margin of the surface at any of its poses, and either all of them are
inside or none is, since the surface never passes between two of them. The winding number at the centre tells which: how
often a connected part of the surface passes a ray along x, one way less the other; where the ray comes so near an edge
that rounding could decide, it is the sum of the angles under which its triangles are seen. Parts count one by one, so
that two that overlap do not cancel where they wind in opposite directions. Triangles lie in patches, and those of a
patch whose box at these poses is far away, or beside the ray, need no look.

*Half-spaces* hold what there is of the object in boxes of place and pose that are not certified to be empty.

With n of length 1 and rates ``r``, ``n . (vertex - place) - r . pose`` is linear in place and pose. Its largest value
over the box and over all vertices of a triangle near it is a level that no point of the triangle passes in the box,
and that and the margin none that no point within the margin passes. Beyond it lies a convex part of the box, in place
and pose together, that meets no triangle: the surface winds around all of it as often as around its farthest corner.
Where that is outside, all of it is.

Of a triangle with the normal m only what is near the box counts: there ``n . p = (n - s m) . p + s m . p`` for any s,
of which the first is bounded by the box and the second is linear in place and pose again. n is the way from the
nearest triangle to the place at the box's centre, or the other way, and r is how that triangle moves along it.
"""

from functools import cache
from typing import NamedTuple

import warp as wp

from warp_bounding.runtime.native import named
from warp_bounding.shapes.shape import IN, OUT, UNDECIDED
from warp_bounding.shapes.triangles.distances import SHORTEST
from warp_bounding.shapes.triangles.hierarchy import closest_on_triangle

OPEN, FREE, FULL = 0, 1, 2  # answers about boxes: nothing is known, nothing of the object is there, all is object
OUTWARD, INWARD = 1 + 2.0**-40, 1 - 2.0**-40  # outweigh what sums of a few products round, relative to their size
BLUR = 2.0**-50  # of a coordinate: by how much the centre of a box and its half may be off

_OPEN, _FREE, _FULL = wp.constant(OPEN), wp.constant(FREE), wp.constant(FULL)
_IN, _OUT, _UNDECIDED = wp.constant(IN), wp.constant(OUT), wp.constant(UNDECIDED)
_OUTWARD, _INWARD, _BLUR = (wp.constant(wp.float64(value)) for value in (OUTWARD, INWARD, BLUR))
_ZERO, _HALF, _ONE, _TWO, _EIGHT = (wp.constant(wp.float64(value)) for value in (0.0, 0.5, 1.0, 2.0, 8.0))
# Of a triangle's seen angle: sine and cosine, times the product of the corners' distances, err by less than 2^-48 of
# this product.
VAGUE, NOISE = 2.0**-28, 2.0**-45
_VAGUE, _NOISE = wp.constant(wp.float64(VAGUE)), wp.constant(wp.float64(NOISE))
_QUARTER = wp.constant(wp.float64(0.25))
_TURN = wp.constant(wp.float64(12.566370614359172))  # of a winding number: the angle of all directions
_INFINITY = wp.constant(wp.float64(float("inf")))


@wp.struct
class Blends:
    """A mesh, and how its vertices move with each pose number."""

    vertices: wp.array(dtype=wp.vec3d)
    deltas: wp.array(dtype=wp.vec3d, ndim=2)  # of each pose number, each vertex
    faces: wp.array(dtype=wp.vec3i)
    first: wp.array(dtype=int)  # faces of patch i: from the i-th number on, up to the next
    low: wp.array(dtype=wp.vec3d)  # corners of each patch's box, at pose 0
    high: wp.array(dtype=wp.vec3d)
    low_deltas: wp.array(dtype=wp.vec3d, ndim=2)  # and least and largest deltas in it, of each pose number
    high_deltas: wp.array(dtype=wp.vec3d, ndim=2)
    part: wp.array(dtype=int)  # of the surface, that a patch belongs to; ascending
    margin: wp.float64
    allowance: wp.float64  # by how much a gap may be off


@wp.func
def half_side(low: wp.float64, high: wp.float64) -> wp.float64:
    """Half a box's side, and what its centre may be off."""
    return ((high * _HALF - low * _HALF) + wp.max(wp.abs(low), wp.abs(high)) * _BLUR) * _OUTWARD


_THIRD, _FOUR = wp.constant(wp.float64(1.0 / 3.0)), wp.constant(wp.float64(4.0))
_SHORTEST = wp.constant(wp.float64(SHORTEST))


class Kernels(NamedTuple):
    """For one number of coordinates, of which three are the place."""

    points: wp.Kernel  # truth of points
    boxes: wp.Kernel  # whether closed boxes are free, or full
    half_spaces: wp.Kernel  # that hold the points of boxes


@cache
def kernels_of(n: int) -> Kernels:
    """The kernels for points of n coordinates."""
    values, poses = wp.types.vector(length=n, dtype=wp.float64), n - 3

    @named(f"blend_vertex_{n}").func
    def vertex(b: Blends, i: int, x: values) -> wp.vec3d:
        """A vertex at a pose."""
        found = b.vertices[i]
        for k in range(poses):
            found += b.deltas[k, i] * x[3 + k]
        return found

    @named(f"blend_seen_{n}").func
    def seen(b: Blends, face: wp.vec3i, x: values) -> wp.mat33d:
        """A triangle's corners at a pose, less the place: rows."""
        place = wp.vec3d(x[0], x[1], x[2])
        return wp.matrix_from_rows(
            vertex(b, face[0], x) - place, vertex(b, face[1], x) - place, vertex(b, face[2], x) - place
        )

    @named(f"blend_above_{n}").func
    def above(b: Blends, i: int, at: wp.vec3d, direction: wp.vec3d, half: values) -> wp.float64:
        """``direction . (place - vertex)`` at least, over a box, for the place less the vertex at its centre."""
        least = wp.dot(direction, at)
        for k in range(3):
            least -= wp.abs(direction[k]) * half[k]
        for k in range(poses):
            least -= wp.abs(wp.dot(direction, b.deltas[k, i])) * half[3 + k]
        return least

    @named(f"blend_gap_{n}").func
    def gap(b: Blends, face: wp.vec3i, p: wp.vec3d, q: wp.vec3d, r: wp.vec3d, half: values) -> wp.float64:
        """Least distance of a triangle from the place over a box; p, q and r are its corners less the place."""
        near = closest_on_triangle(wp.vec3d(), p, q, r)
        length = wp.length(near)
        if not length > b.allowance:
            return -length
        direction = -near / length
        least = wp.min(
            wp.min(above(b, face[0], -p, direction, half), above(b, face[1], -q, direction, half)),
            above(b, face[2], -r, direction, half),
        )
        return least * wp.where(least > _ZERO, _INWARD, _OUTWARD) - b.allowance

    @named(f"blend_angle_{n}").func
    def angle(p: wp.vec3d, q: wp.vec3d, r: wp.vec3d) -> wp.float64:
        """The solid angle of a triangle seen from 0 (Van Oosterom and Strackee 1983).

        NaN where rounding could change it by more than 2^-20, or its sign.
        """
        a, b, c = wp.length(p), wp.length(q), wp.length(r)
        size = a * b * c
        across = wp.dot(p, wp.cross(q, r))
        below = size + wp.dot(p, q) * c + wp.dot(q, r) * a + wp.dot(r, p) * b
        side = wp.abs(across)
        if not wp.max(side, wp.abs(below)) > _VAGUE * size or (below < _ZERO and not side > _NOISE * size):
            return wp.float64(wp.nan)
        return _TWO * wp.atan2(across, below)

    @named(f"blend_corner_{n}").func
    def corner(b: Blends, patch: int, x: values, half: values, side: wp.float64) -> wp.vec3d:
        """A corner of a patch's box at all poses of a box: the lower one for side -1, the upper one for 1."""
        found = wp.where(side < _ZERO, b.low[patch], b.high[patch])
        for k in range(poses):
            least, most = x[3 + k] - half[3 + k], x[3 + k] + half[3 + k]
            for j in range(3):
                low, high = b.low_deltas[k, patch][j] * side, b.high_deltas[k, patch][j] * side
                found[j] += side * wp.max(wp.max(least * low, least * high), wp.max(most * low, most * high))
        return found

    @named(f"blend_apart_{n}").func
    def apart(b: Blends, patch: int, x: values, half: values) -> wp.float64:
        """How far a patch stays from the place all over a box, at least, along an axis."""
        low, high = corner(b, patch, x, half, -_ONE), corner(b, patch, x, half, _ONE)
        found = -_INFINITY
        for j in range(3):
            found = wp.max(found, wp.max(low[j] - x[j], x[j] - high[j]) - half[j])
        return found - b.allowance

    @named(f"blend_passed_{n}").func
    def passed(p: wp.vec3d, q: wp.vec3d, r: wp.vec3d, off: wp.float64) -> wp.float64:
        """1 or -1 if a triangle passes the ray from 0 along x, by its way, else 0.

        NaN where corners that are off by so much could change it.
        """
        a, b, c = p[1] * q[2] - p[2] * q[1], q[1] * r[2] - q[2] * r[1], r[1] * p[2] - r[2] * p[1]
        reach = wp.max(wp.abs(p[1]), wp.max(wp.abs(q[1]), wp.abs(r[1])))
        reach += wp.max(wp.abs(p[2]), wp.max(wp.abs(q[2]), wp.abs(r[2]))) + off
        vague = _EIGHT * off * reach
        least, most = wp.min(a, wp.min(b, c)), wp.max(a, wp.max(b, c))
        if least < -vague and most > vague:
            return wp.float64(0.0)
        if not (least > vague or most < -vague):
            return wp.float64(wp.nan)
        where = b * p[0] + c * q[0] + a * r[0]
        doubt = _TWO * vague * (wp.abs(p[0]) + wp.abs(q[0]) + wp.abs(r[0])) + _TWO * off * wp.abs(a + b + c)
        if not wp.abs(where) > doubt:
            return wp.float64(wp.nan)
        side = wp.where(least > _ZERO, _ONE, -_ONE)
        return wp.where(where * side > _ZERO, side, wp.float64(0.0))

    @named(f"blend_greater_{n}").func
    def greater(most: wp.float64, turns: wp.float64) -> wp.float64:
        """The larger one, NaN where either is."""
        if wp.isnan(most) or wp.isnan(turns):
            return wp.float64(wp.nan)
        return wp.max(most, wp.abs(turns))

    @named(f"blend_winding_{n}").func
    def winding(b: Blends, x: values) -> wp.float64:
        """How often a connected part of the surface winds around a place at a pose, at most, either way."""
        place, turns, most = wp.vec3d(x[0], x[1], x[2]), wp.float64(0.0), wp.float64(0.0)
        for patch in range(b.low.shape[0]):
            if patch > 0 and b.part[patch] != b.part[patch - 1]:
                most = greater(most, turns)
                turns = wp.float64(0.0)
            low, high = corner(b, patch, x, values(), -_ONE) - place, corner(b, patch, x, values(), _ONE) - place
            beside = wp.max(wp.max(low[1], -high[1]), wp.max(low[2], -high[2]))
            if wp.max(beside, -high[0]) <= b.allowance:
                for i in range(b.first[patch], b.first[patch + 1]):
                    face = b.faces[i]
                    corners = seen(b, face, x)
                    turns += passed(corners[0], corners[1], corners[2], b.allowance)
        most = greater(most, turns)
        if wp.isnan(most):
            turns, most = wp.float64(0.0), wp.float64(0.0)
            for patch in range(b.low.shape[0]):
                if patch > 0 and b.part[patch] != b.part[patch - 1]:
                    most = greater(most, turns)
                    turns = wp.float64(0.0)
                for i in range(b.first[patch], b.first[patch + 1]):
                    face = b.faces[i]
                    corners = seen(b, face, x)
                    turns += angle(corners[0], corners[1], corners[2]) / _TURN
            most = greater(most, turns)
        return most

    @named(f"blend_points_{n}").kernel
    def points(
        first: int,
        # inputs
        b: Blends,
        x: wp.array(dtype=values),
        # outputs
        answers: wp.array(dtype=wp.uint8),
    ):
        """Truth of points; the limits of poses are the caller's affair."""
        t, _ = wp.tid()
        t += first
        answers[t] = wp.uint8(_OUT)
        at, least, most = x[t], wp.float64(wp.inf), wp.float64(wp.inf)
        for i in range(n):
            if not wp.abs(at[i]) < _INFINITY:
                return
        for patch in range(b.low.shape[0]):
            if not apart(b, patch, at, values()) > b.margin:
                for i in range(b.first[patch], b.first[patch + 1]):
                    face = b.faces[i]
                    corners = seen(b, face, at)
                    p, q, r = corners[0], corners[1], corners[2]
                    least = wp.min(least, gap(b, face, p, q, r, values()))
                    most = wp.min(most, wp.length(closest_on_triangle(wp.vec3d(), p, q, r)) + b.allowance)
        around = winding(b, at)
        if most <= b.margin or (least > _ZERO and around > _HALF):
            answers[t] = wp.uint8(_IN)
        elif not (least > b.margin and around < _QUARTER):
            answers[t] = wp.uint8(_UNDECIDED)

    @named(f"blend_boxes_{n}").kernel
    def boxes(
        first: int,
        # inputs
        b: Blends,
        lower: wp.array(dtype=values),
        upper: wp.array(dtype=values),
        asked: int,
        # outputs
        answers: wp.array(dtype=wp.uint8),
    ):
        """Whether closed boxes are ``FREE``, or ``FULL``, whichever is queried."""
        t, _ = wp.tid()
        t += first
        answers[t] = wp.uint8(_OPEN)
        low, high = lower[t], upper[t]
        center, half = values(), values()
        for i in range(n):
            if not (low[i] <= high[i] and wp.abs(low[i]) < _INFINITY and wp.abs(high[i]) < _INFINITY):
                return
            center[i] = low[i] * _HALF + high[i] * _HALF
            half[i] = half_side(low[i], high[i])
        bar = wp.where(asked == _FULL, _ZERO, b.margin)
        for patch in range(b.low.shape[0]):
            if not apart(b, patch, center, half) > bar:
                for i in range(b.first[patch], b.first[patch + 1]):
                    face = b.faces[i]
                    corners = seen(b, face, center)
                    p, q, r = corners[0], corners[1], corners[2]
                    if not gap(b, face, p, q, r, half) > bar:
                        return
        around = winding(b, center)
        if asked == _FREE and around < _QUARTER:
            answers[t] = wp.uint8(_FREE)
        if asked == _FULL and around > _HALF:
            answers[t] = wp.uint8(_FULL)

    @named(f"blend_passes_{n}").func
    def passes(b: Blends, i: int, along: wp.vec3d, at: wp.vec3d, rates: values, half: values) -> wp.float64:
        """The largest ``along . (vertex - place of the centre) - rates . pose`` of vertex i over a box.

        ``at`` is the vertex less the place at its centre.
        """
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
        """Is a closed box certain to be empty? Else a half-space of its points, around its centre, if one is found."""
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

    return Kernels(points, boxes, half_spaces)
