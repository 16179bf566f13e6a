"""One triangle against one box, in float64: axes that prove them apart, and the closest point, up to rounding.

A box is certified to be free of a triangle for one reason only: there is an axis on which the triangle and the box,
grown by a ball of the margin's radius, do not overlap. That is a proof for *any* axis, however it was computed, so the
search for one may be as careless as it likes and only ``separated`` has to be right. The axes tried are those of the
separating axis theorem for a box and a triangle (three face normals, the triangle's normal, nine products of edges;
complete for a margin of 0) and, for a margin, the directions between the closest points of box and triangle that
alternating projections find (they are missing from the 13 where a corner is closest). A degenerate triangle needs no
case of its own: its null axes separate nothing.

The box is always |x_k| <= half_k, and the corners a, b, c are relative to its centre. Who asks knows how large they
are, and gives the ``slack``: a length that outweighs all rounding (``voxelization.SLACK`` for cells,
``rounding_slack`` for boxes of any size).

Source: Akenine-Moeller, "Fast 3D triangle-box overlap testing" (2001) for the axes.
"""

import warp as wp

from warp_bounding.runtime.native import STRICT

__all__ = [
    "PROJECTIONS",
    "ROUNDING",
    "SHORTEST",
    "SMALLEST",
    "apart",
    "closest_on_segment",
    "closest_on_triangle",
    "distance_along",
    "free",
    "largest",
    "rounding_slack",
    "segment_free",
    "segment_separated",
    "separated",
]

SHORTEST = 2.0**-400  # axes shorter than this are not used: the squares of their components may underflow
PROJECTIONS = 16  # alternating projections; what is neither near nor proven far by then is left to the axes
# Relative to the largest absolute coordinate M of corners and box and to the margin: with u = 2^-53, for an axis d with
# the sum |d| of its absolute components, float64 errs by less than
#   a corner relative to the centre (one rounding)                              u M |d|
#   its dot product with d, three products and two sums                         3 u M |d|
#   half * |d|, margin * length(d) and their sum                                6 u 2 M |d|
# together less than 2^-49 M |d|; this is 4 times that.
ROUNDING = 2.0**-47
SHORTER = 1.0 - 2.0**-50  # outweighs the rounding of a length and of a division by it, four units
# Largest coordinate under which its cube might underflow: that a triangle crosses a box or a segment is not certain there.
SMALLEST = 2.0**-300
LEAST = 2.0**-500  # slack that outweighs underflow: times an axis of SHORTEST it is far above 2^-1074

_SHORTEST = wp.constant(wp.float64(SHORTEST))
_PROJECTIONS = wp.constant(PROJECTIONS)
_ROUNDING = wp.constant(wp.float64(ROUNDING))
_SHORTER = wp.constant(wp.float64(SHORTER))
_LEAST = wp.constant(wp.float64(LEAST))
_NEAR, _FREE, _UNDECIDED = wp.constant(0), wp.constant(1), wp.constant(2)


@wp.func_native(STRICT + "return size;")
def _by_ieee(size: wp.float64) -> wp.float64:  # a kernel that asks for this does not compile without IEEE arithmetic
    ...


@wp.func
def largest(x: wp.vec3d) -> wp.float64:
    """The largest absolute coordinate."""
    return wp.max(wp.abs(x[0]), wp.max(wp.abs(x[1]), wp.abs(x[2])))


@wp.func
def rounding_slack(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, half: wp.vec3d, margin: wp.float64) -> wp.float64:
    """A length that outweighs the rounding of ``separated`` for these numbers, each rounded once."""
    size = wp.max(wp.max(largest(a), largest(b)), wp.max(largest(c), largest(half)))
    return _ROUNDING * wp.max(_by_ieee(size), margin) + _LEAST


@wp.func
def separated(
    d: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, half: wp.vec3d, margin: wp.float64, slack: wp.float64
) -> bool:
    """Is the triangle further than ``margin`` from the box |x_k| <= half_k, as axis d can tell? NaN cannot."""
    size = _by_ieee(wp.abs(d[0]) + wp.abs(d[1]) + wp.abs(d[2]))
    if not size > _SHORTEST:
        return False
    pa, pb, pc = wp.dot(d, a), wp.dot(d, b), wp.dot(d, c)
    reach = wp.dot(half, wp.abs(d)) + slack * size + margin * wp.length(d)
    return wp.min(pa, wp.min(pb, pc)) > reach or wp.max(pa, wp.max(pb, pc)) < -reach


@wp.func
def _edge_separated(
    e: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, half: wp.vec3d, margin: wp.float64, slack: wp.float64
) -> bool:
    """Try the three axes that are products of a triangle's edge with the box's edges."""
    zero = wp.float64(0.0)
    if separated(wp.vec3d(zero, -e[2], e[1]), a, b, c, half, margin, slack):
        return True
    if separated(wp.vec3d(e[2], zero, -e[0]), a, b, c, half, margin, slack):
        return True
    return separated(wp.vec3d(-e[1], e[0], zero), a, b, c, half, margin, slack)


@wp.func
def apart(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, half: wp.vec3d, margin: wp.float64, slack: wp.float64) -> bool:
    """Does one of the 13 axes separate the triangle from the box around 0, grown by the margin?"""
    zero, one = wp.float64(0.0), wp.float64(1.0)
    if separated(wp.vec3d(one, zero, zero), a, b, c, half, margin, slack):
        return True
    if separated(wp.vec3d(zero, one, zero), a, b, c, half, margin, slack):
        return True
    if separated(wp.vec3d(zero, zero, one), a, b, c, half, margin, slack):
        return True
    if separated(wp.cross(b - a, c - a), a, b, c, half, margin, slack):
        return True
    if _edge_separated(b - a, a, b, c, half, margin, slack):
        return True
    if _edge_separated(c - b, a, b, c, half, margin, slack):
        return True
    return _edge_separated(a - c, a, b, c, half, margin, slack)


@wp.func
def closest_on_segment(p: wp.vec3d, a: wp.vec3d, b: wp.vec3d) -> wp.vec3d:
    """Find a point of the segment nearest to p up to rounding."""
    length2 = wp.dot(b - a, b - a)
    if not length2 > wp.float64(0.0):
        return a
    return a + (b - a) * wp.clamp(wp.dot(p - a, b - a) / length2, wp.float64(0.0), wp.float64(1.0))


@wp.func
def closest_on_triangle(p: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d) -> wp.vec3d:
    """Find a point of the triangle, also of a degenerate one, nearest to p up to rounding.

    It is a sum of corners whose weights are at least 0 and sum up to 1, so it lies in the triangle whatever the rounding
    made of the weights, but for a few roundings of the largest coordinate.
    """
    zero = wp.float64(0.0)
    n = wp.cross(b - a, c - a)
    n2 = wp.dot(n, n)
    if n2 > zero:
        u = wp.dot(wp.cross(b - a, p - a), n)
        v = wp.dot(wp.cross(c - b, p - b), n)
        w = wp.dot(wp.cross(a - c, p - c), n)
        area = u + v + w
        if u >= zero and v >= zero and w >= zero and area > zero:
            return a * (v / area) + b * (w / area) + c * (u / area)
    best = closest_on_segment(p, a, b)
    q = closest_on_segment(p, b, c)
    if wp.length_sq(q - p) < wp.length_sq(best - p):
        best = q
    q = closest_on_segment(p, c, a)
    if wp.length_sq(q - p) < wp.length_sq(best - p):
        best = q
    return best


@wp.func
def _side(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, half: wp.vec3d, margin: wp.float64, slack: wp.float64) -> int:
    """Alternating projections: the points tell that the box is near, or their direction proves that it is free."""
    q = closest_on_triangle(wp.vec3d(), a, b, c)
    for _ in range(_PROJECTIONS):
        d = q - wp.vec3d(
            wp.clamp(q[0], -half[0], half[0]), wp.clamp(q[1], -half[1], half[1]), wp.clamp(q[2], -half[2], half[2])
        )
        if wp.length_sq(d) <= margin * margin:
            return _NEAR
        if separated(d, a, b, c, half, margin, slack):
            return _FREE
        q = closest_on_triangle(q - d, a, b, c)
    return _UNDECIDED


@wp.func
def free(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, half: wp.vec3d, margin: wp.float64, slack: wp.float64) -> bool:
    """Is it proven that the triangle is further than the margin from the box around 0?"""
    if margin > wp.float64(0.0):  # the direction decides most boxes at once, the 13 axes those that it leaves
        side = _side(a, b, c, half, margin, slack)
        if side != _UNDECIDED:
            return side == _FREE
    return apart(a, b, c, half, margin, slack)


@wp.func
def segment_separated(
    d: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, s: wp.vec3d, margin: wp.float64, slack: wp.float64
) -> bool:
    """Is the triangle further than ``margin`` from the segment from 0 to s, as axis d can tell? NaN cannot."""
    size = wp.abs(d[0]) + wp.abs(d[1]) + wp.abs(d[2])
    if not size > _SHORTEST:
        return False
    pa, pb, pc, ps = wp.dot(d, a), wp.dot(d, b), wp.dot(d, c), wp.dot(d, s)
    reach = slack * size + margin * wp.length(d)
    zero = wp.float64(0.0)
    return (
        wp.min(pa, wp.min(pb, pc)) > wp.max(ps, zero) + reach or wp.max(pa, wp.max(pb, pc)) < wp.min(ps, zero) - reach
    )


@wp.func
def segment_free(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, s: wp.vec3d, margin: wp.float64, slack: wp.float64) -> bool:
    """Is it proven, by the axes that are complete in general position, that the segment from 0 to s is far enough?"""
    zero, one = wp.float64(0.0), wp.float64(1.0)
    if segment_separated(wp.cross(b - a, c - a), a, b, c, s, margin, slack):
        return True
    if segment_separated(wp.cross(b - a, s), a, b, c, s, margin, slack):
        return True
    if segment_separated(wp.cross(c - b, s), a, b, c, s, margin, slack):
        return True
    if segment_separated(wp.cross(a - c, s), a, b, c, s, margin, slack):
        return True
    if segment_separated(wp.vec3d(one, zero, zero), a, b, c, s, margin, slack):
        return True
    if segment_separated(wp.vec3d(zero, one, zero), a, b, c, s, margin, slack):
        return True
    return segment_separated(wp.vec3d(zero, zero, one), a, b, c, s, margin, slack)


@wp.func
def distance_along(d: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, half: wp.vec3d, slack: wp.float64) -> wp.float64:
    """Lower bound of the distance from the box |x_k| <= half_k to the triangle, as axis d can tell; 0 where it cannot."""
    size = wp.abs(d[0]) + wp.abs(d[1]) + wp.abs(d[2])
    if not size > _SHORTEST:
        return wp.float64(0.0)
    pa, pb, pc = wp.dot(d, a), wp.dot(d, b), wp.dot(d, c)
    gap = wp.max(wp.min(pa, wp.min(pb, pc)), -wp.max(pa, wp.max(pb, pc)))
    gap -= wp.dot(half, wp.abs(d)) + slack * size
    return wp.max(gap / wp.length(d) * _SHORTER, wp.float64(0.0))
