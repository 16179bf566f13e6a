"""Newton's primitive shapes in closed form: where the signed distance that its pass computes may be small.

The pass makes a contact where a signed distance d of the particle, computed in float32 in the shape's own axes, is under ``gap + margin + radius``, which is
at most a ``way`` that is at least 0. ``extent_of`` tells a box around each primitive, how fast it must grow for d to be at least ``way`` outside, and a ball
likewise. On axis k, with half width h_k and growth g_k: ``|x_k| > h_k + g_k way`` implies ``d >= way``:

* sphere, box, capsule, cylinder, cone: d is a distance to points of the shape, or less inside, and never under ``|x_k| - h_k``; so g is 1. A box with half diagonal
  R holds them, so a ball of radius ``R + way`` is as good.
* barrel, a cylinder of radius r whose side is an arc of radius b: the arc stands out by ``b - sqrt(b^2 - h^2) <= h^2 / b``, h being half its height. What float32 makes
  of the root is that of an ``h^2`` larger by ``3 b^2`` units of 2^-24, which is ``3 b`` units in the width; and a point of the arc is taken for one between its ends with an
  error of 4 units of ``2 b + r``, so that it stands over the end by ``(3 b^2 + 8 b (2 b + r)) / 2 h`` units at most. ``_ARC_ROUNDING`` is more than both.
* ellipsoid with radii r: Newton's d is ``k0 (k0 - 1) / k1`` with ``k0 = |x / r|`` and ``k1 = |x / r^2| <= k0 / r_min``. So ``d >= r_min (k0 - 1)``, and
  ``|x_k| <= r_k k0``; so g_k is ``r_k / r_min``, and that of the ball ``r_max / r_min``. Radii are 1e-8 at least; where ``k1`` is at most 1e-8 the pass takes another
  formula, which no particle outside meets while ``r_max <= 1e7``. Larger ellipsoids are not tested. Far away ``|x / r^2|`` overflows, and d is 0: so of an
  ellipsoid nothing is said where the way is over ``2^46 r_min^2``. A way is at least 2^-16 of ``|x|`` (``placing.IN_WORLD``), so that below ``|x_k / r_k^2|`` is
  at most 2^62, and its square is a number.
* plane, infinite: d is ``z``; so only above it particles are denied.
* plane, finite: d is ``max(|x| - w, |y| - l, |z|)``, which is not a Euclidean distance; so there is no ball.

What float32 makes of all that, in the pass and here, ``placing.place_shapes`` adds, for which ``size`` is the largest length that enters. Height fields are not tested.

Source: ``create_soft_contacts`` in Newton's ``geometry/kernels.py``, whose formulas for these shapes are the same from 1.5 to 1.8 (barrels are new in 1.8).
"""

import warp as wp

from warp_bounding.arithmetic import UNIT32
from warp_bounding.newton.library import newton

__all__ = ["PRIMITIVES", "Extent", "extent_of"]

_KINDS = ("PLANE", "SPHERE", "BOX", "CAPSULE", "CYLINDER", "CONE", "ELLIPSOID")
PRIMITIVES = frozenset(int(newton.GeoType[name]) for name in _KINDS)
_PLANE, _SPHERE, _BOX, _CAPSULE, _CYLINDER, _CONE, _ELLIPSOID = (
    wp.constant(int(newton.GeoType[name])) for name in _KINDS
)
_LEAST_RADIUS = wp.constant(1.0e-8)  # of an ellipsoid: Newton's
_LARGEST_RADIUS = wp.constant(1.0e7)
# Of a shape in closed form nothing is said where the way is longer: every intermediate number is then far from overflow.
_MOST_WAY = wp.constant(2.0**100)
_MOST_OF_ELLIPSOIDS = wp.constant(2.0**46)  # over the square of its least radius, see module
_ARC_ROUNDING = wp.constant(32.0 * UNIT32)  # of a barrel, see module


@wp.struct
class Extent:
    """A box and a ball around a primitive, in its own axes; see module."""

    half: wp.vec3  # half widths
    grow: wp.vec3  # by which they grow for each unit of way
    below: float  # by how much the box is longer on the negative side of its third axis
    radius: float  # of the ball
    grow_radius: float
    size: float
    most_way: float  # nothing is said where the way is longer
    tested: bool


@wp.func
def _finite(half: wp.vec3) -> Extent:
    e = Extent()
    e.half = half
    e.grow = wp.vec3(1.0, 1.0, 1.0)
    e.below = 0.0
    e.radius = wp.length(half)
    e.grow_radius = 1.0
    e.most_way = _MOST_WAY
    e.size = e.radius
    e.tested = True
    return e


@wp.func
def _sphere(scale: wp.vec3) -> Extent:
    r = wp.abs(scale[0])
    e = _finite(wp.vec3(r, r, r))
    e.radius = r
    return e


@wp.func
def _cylinder(scale: wp.vec3) -> Extent:
    r, h, b = wp.abs(scale[0]), wp.abs(scale[1]), wp.abs(scale[2])
    e = _finite(wp.vec3(r, r, h))
    if b > 0.0:
        out = wp.min(h * h / b, h) + _ARC_ROUNDING * b
        e = _finite(wp.vec3(r + out, r + out, h + _ARC_ROUNDING * b * (b + r) / h))
        e.size = e.size + b
    return e


@wp.func
def _ellipsoid(scale: wp.vec3) -> Extent:
    r = wp.max(wp.vec3(_LEAST_RADIUS), wp.abs(scale))
    least, most = wp.min(r), wp.max(r)
    e = _finite(r)
    e.grow = r / least
    e.radius = most
    e.grow_radius = most / least
    e.most_way = wp.min(_MOST_WAY, _MOST_OF_ELLIPSOIDS * least * least)
    e.tested = most <= _LARGEST_RADIUS
    return e


@wp.func
def _plane(scale: wp.vec3) -> Extent:
    width, length = 0.5 * scale[0], 0.5 * scale[1]
    if width > 0.0 and length > 0.0:
        e = _finite(wp.vec3(width, length, 0.0))
        e.radius = wp.inf
        e.grow_radius = 0.0
        return e
    e = _finite(wp.vec3(0.0, 0.0, 0.0))
    e.half = wp.vec3(wp.inf, wp.inf, 0.0)
    e.radius = wp.inf
    e.grow_radius = 0.0
    e.below = wp.inf
    return e


@wp.func
def extent_of(kind: int, scale: wp.vec3) -> Extent:
    """The box and the ball around a primitive; ``tested`` is false for a shape of another kind.

    Args:
        kind: A ``newton.GeoType``.
        scale: The shape's, whose meaning is the kind's.

    Returns:
        The extent, world units.
    """
    if kind == _PLANE:
        return _plane(scale)
    if kind == _SPHERE:
        return _sphere(scale)
    if kind == _BOX:
        return _finite(wp.abs(scale))
    if kind == _CAPSULE:
        return _finite(wp.vec3(wp.abs(scale[0]), wp.abs(scale[0]), wp.abs(scale[0]) + wp.abs(scale[1])))
    if kind == _CYLINDER:
        return _cylinder(scale)
    if kind == _CONE:
        return _finite(wp.vec3(wp.abs(scale[0]), wp.abs(scale[0]), wp.abs(scale[1])))
    if kind == _ELLIPSOID:
        return _ellipsoid(scale)
    return Extent()  # all zeros, hence not tested
