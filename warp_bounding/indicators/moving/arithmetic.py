"""One triangle that moves against one box or segment, in float64: axes that prove them apart for a whole span of time.

Each corner goes straight from ``a - u`` to ``a + u``. So all that the triangle is in between lies in the convex hull of
the six ends, and an axis on which these do not overlap the box, grown by the margin, is a proof for the whole span, for
*any* axis, however it was computed. The first axes that are tried are directions between closest points of the box
and the triangle in the middle of its way; the next ones come from the hull, step by step (Frank and Wolfe's method);
the last ones are the 13 axes of ``triangles/arithmetic.py``, of the triangle in the middle.

The box is |x_k| <= half_k, and corners are relative to its centre. The slack outweighs all rounding that begins with
the corners and ways as they are given; how well these are known themselves is for the margin to cover.

Source: Frank and Wolfe, "An algorithm for quadratic programming" (1956).
"""

import warp as wp

from warp_bounding.indicators.triangles.arithmetic import SHORTEST, closest_on_triangle, rounding_slack

__all__ = ["Moving", "moving_free", "moving_segment_free", "moving_slack"]

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
    """Is it proven, by axes of the triangle in the middle, that it is far from the segment from 0 to s on all its way?"""
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
