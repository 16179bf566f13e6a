"""Where shapes lie in one pass, and a ball and a box around each, outside which no particle meets it (``Extent``).

How much float32 may err, in the pass and when hulls are made and asked, is counted in units of 2^-24. The pass and
``place_shapes`` make the same transform of a shape: a product of quaternions, 8 in length, and a rotation and a sum, 42
of the lengths that enter. A rotation is 20 on an axis; a particle is turned into the shape's axes by one, the axes of
the hull are three, 24 with the difference and the products. If a compiler fuses the two kernels in different ways,
their quaternions differ by 16, which turns by 96; and a quaternion counts as a rotation only if its squared length is
within 1e-6 of 1, and those of its factors are. With the signed distance's own, 8, and the ball's, all are under 256 of
the particle's coordinates and of the place's (``IN_WORLD``), for which the larger is taken of the place in the world or
seen from the shape and of the places that it is made of.
"""

import newton
import warp as wp

from warp_bounding.rounding import UNIT32

# --- Primitives -------------------------------------------------------------------------------------------------------
#
# Newton's primitive shapes in closed form: where the signed distance that its pass computes may be small.
#
# The pass makes a contact where a signed distance d of the particle, computed in float32 in the shape's own axes, is
# under ``gap + margin + radius``, which is at most a ``way`` that is at least 0. ``extent_of`` tells a box around each
# primitive, how fast it must grow for d to be at least ``way`` outside, and a ball likewise. On axis k, with half width
# h_k and growth g_k: ``|x_k| > h_k + g_k way`` implies ``d >= way``:
#
# * sphere, box, capsule, cylinder, cone: d is a distance to points of the shape, or less inside, and never under
#   ``|x_k| - h_k``; so g is 1. A box with half diagonal R holds them, so a ball of radius ``R + way`` is as good.
# * barrel, a cylinder of radius r whose side is an arc of radius b: the arc stands out by ``b - sqrt(b^2 - h^2) <= h^2
#   / b``, h being half its height. What float32 makes of the root is that of an ``h^2`` larger by ``3 b^2`` units of
#   2^-24, which is ``3 b`` units in the width; and a point of the arc is taken for one between its ends with an error
#   of 4 units of ``2 b + r``, so that it stands over the end by ``(3 b^2 + 8 b (2 b + r)) / 2 h`` units at most.
#   ``_ARC_ROUNDING`` is more than both.
# * ellipsoid with radii r: Newton's d is ``k0 (k0 - 1) / k1`` with ``k0 = |x / r|`` and ``k1 = |x / r^2| <= k0 /
#   r_min``. So ``d >= r_min (k0 - 1)``, and ``|x_k| <= r_k k0``; so g_k is ``r_k / r_min``, and that of the ball
#   ``r_max / r_min``. Radii are 1e-8 at least; where ``k1`` is at most 1e-8 the pass takes another formula, which no
#   particle outside meets while ``r_max <= 1e7``. Larger ellipsoids are not tested. Far away ``|x / r^2|`` overflows,
#   and d is 0: so of an ellipsoid nothing is said where the way is over ``2^46 r_min^2``. A way is at least 2^-16 of
#   ``|x|`` (``placing.IN_WORLD``), so that below ``|x_k / r_k^2|`` is at most 2^62, and its square is a number.
# * plane, infinite: d is ``z``; so only above it particles are denied.
# * plane, finite: d is ``max(|x| - w, |y| - l, |z|)``, which is not a Euclidean distance; so there is no ball.
#
# What float32 makes of all that, in the pass and here, ``placing.place_shapes`` adds, for which ``reach`` is the
# largest length that enters. Height fields are not tested.
#
# Source: ``create_soft_contacts`` in Newton's ``geometry/kernels.py``, whose formulas for these shapes are the same
# from 1.5 to 1.8 (barrels are new in 1.8).

_KINDS = ("PLANE", "SPHERE", "BOX", "CAPSULE", "CYLINDER", "CONE", "ELLIPSOID")
PRIMITIVES = frozenset(int(newton.GeoType[name]) for name in _KINDS)
_PLANE, _SPHERE, _BOX, _CAPSULE, _CYLINDER, _CONE, _ELLIPSOID = (
    wp.constant(int(newton.GeoType[name])) for name in _KINDS
)
_LEAST_RADIUS = wp.constant(1.0e-8)  # of an ellipsoid: Newton's
_LARGEST_RADIUS = wp.constant(1.0e7)
# Of a shape in closed form nothing is said where the way is longer: every intermediate number is then far from
# overflow.
_MOST_WAY = wp.constant(2.0**100)
_MOST_OF_ELLIPSOIDS = wp.constant(2.0**46)  # over the square of its least radius, see module
_ARC_ROUNDING = wp.constant(32.0 * UNIT32)  # of a barrel, see module


@wp.struct
class Placed:
    """A shape as it lies in the world in one pass."""

    to_shape: wp.transform
    scale: wp.vec3


@wp.struct
class Extent:
    """A ball and a box in the world, outside which the pass makes no contact of a particle with the shape.

    How far the pass looks for a particle q of radius r, ``gap + (margin of the shape + r) / least scale``, and rounding
    take ``way = reach + per_radius r + per_coordinate (|q_x| + |q_y| + |q_z|)`` in the mesh's units; of a primitive,
    whose scale is its lengths, in the world's. A bounder of points may deny the particle only where ``way <= margin``,
    its own; its domain does not grow. In every other case the ball and the box grow by the way. The box is open below
    its third axis by ``below``, for a plane.
    """

    center: wp.vec3  # of ball and box, world
    axes: wp.mat33  # rows: directions of the box
    half: wp.vec3  # its half widths
    grow: wp.vec3  # world units by which each half width grows per unit of way: 0 for a bounder of points
    below: float  # by how much the box is longer on the negative side of its third axis
    grow_radius: float  # by how much the ball's radius grows
    radius: float  # of the ball
    reach: float
    per_radius: float
    per_coordinate: float
    # infinite for a mesh whose hull grows, minus infinity for a shape without a hull, or one whose quaternion is far
    # from a rotation
    margin: float
    stays: int  # 1 where no bounder is queried: a pair that the hull does not deny stays


@wp.func
def _finite(half: wp.vec3) -> Extent:
    """The hull of a box that grows by the way alike on all sides, in a primitive's own axes; ``reach`` is its size."""
    hull = Extent()
    hull.half = half
    hull.grow = wp.vec3(1.0, 1.0, 1.0)
    hull.below = 0.0
    hull.radius = wp.length(half)
    hull.grow_radius = 1.0
    hull.margin = _MOST_WAY
    hull.reach = hull.radius
    return hull


@wp.func
def _cylinder(scale: wp.vec3) -> Extent:
    r, h, b = wp.abs(scale[0]), wp.abs(scale[1]), wp.abs(scale[2])
    hull = _finite(wp.vec3(r, r, h))
    if b > 0.0:
        out = wp.min(h * h / b, h) + _ARC_ROUNDING * b
        hull = _finite(wp.vec3(r + out, r + out, h + _ARC_ROUNDING * b * (b + r) / h))
        hull.reach += b
    return hull


@wp.func
def _ellipsoid(scale: wp.vec3) -> Extent:
    r = wp.max(wp.vec3(_LEAST_RADIUS), wp.abs(scale))
    least, most = wp.min(r), wp.max(r)
    hull = _finite(r)
    hull.grow = r / least
    hull.radius = most
    hull.grow_radius = most / least
    hull.margin = wp.where(most <= _LARGEST_RADIUS, wp.min(_MOST_WAY, _MOST_OF_ELLIPSOIDS * least * least), -wp.inf)
    return hull


@wp.func
def _plane(scale: wp.vec3) -> Extent:
    width, length = 0.5 * scale[0], 0.5 * scale[1]
    if width > 0.0 and length > 0.0:
        hull = _finite(wp.vec3(width, length, 0.0))
        hull.radius = wp.inf
        hull.grow_radius = 0.0
        return hull
    hull = _finite(wp.vec3(0.0, 0.0, 0.0))
    hull.half = wp.vec3(wp.inf, wp.inf, 0.0)
    hull.radius = wp.inf
    hull.grow_radius = 0.0
    hull.below = wp.inf
    return hull


@wp.func
def extent_of(kind: int, scale: wp.vec3) -> Extent:
    """The box and the ball around a primitive in its own axes, world units, and in ``reach`` the largest length."""
    if kind == _PLANE:
        return _plane(scale)
    if kind == _SPHERE:
        hull = _finite(wp.vec3(wp.abs(scale[0])))
        hull.radius = wp.abs(scale[0])
        return hull
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
    hull = _finite(scale)
    hull.margin = -wp.inf  # not tested
    return hull


# --- Places -----------------------------------------------------------------------------------------------------------

# What float32 does between a particle's place and the closest point, in units of 2^-24: of the coordinates in the mesh
# (the closest point 16, the division by the scale 1, the search's own products 8) and of the way; and of the
# coordinates in the world: two transforms, once in the pass and once here, each a rotation by a quaternion and a sum
# (module).
IN_MESH, IN_WORLD = 32.0, 256.0
_WORLD_ROUNDING = wp.constant(IN_WORLD * UNIT32)
_MESH_ROUNDING = wp.constant(IN_MESH * UNIT32)
# Of the ball and the box around a domain in the world, and of a distance from its middle: under 64 units in all.
_HULL_ROUNDING = wp.constant(IN_WORLD * UNIT32)
# Of the sum that a bounder's margin is compared with: eight roundings.
IN_SUM = 8.0 * UNIT32
_SUM_ROUNDING = wp.constant(IN_SUM)
# Times that: the passes over surfaces take corners of meshes to the world and back, and closest points of edges and
# faces there, 48 units of what a mesh reaches and 64 of the world.
_OF_SURFACES = wp.constant(4.0)
# A quaternion whose squared length is farther from 1 than this, more than float32 rounding makes it, does not only
# rotate.
_UNIT_ROTATION = wp.constant(1.0e-6)
_LONGEST_ROTATION = wp.constant(2.0)
# What the way around a shape in closed form is at least, since the squares of lengths under 2^-63 are lost.
_LEAST_WAY = wp.constant(2.0**-60)
# Of a mesh: the largest sizes of gap and margin together, and of a radius; Newton's distance of what it does not find
# is 1e6.
_MOST_OF_GAPS, _MOST_OF_RADII = wp.constant(5.0e5), wp.constant(4.0e5)
_COLLIDES = wp.constant(int(newton.ShapeFlags.COLLIDE_PARTICLES))
# What is done with a shape: nothing, its hull in closed form, the hull of its mesh, or that and its bounder.
UNTESTED, PRIMITIVE, HULL, BOUNDED = 0, 1, 2, 3
_MESH, _CONVEX_MESH = wp.constant(int(newton.GeoType.MESH)), wp.constant(int(newton.GeoType.CONVEX_MESH))
_UNTESTED, _PRIMITIVE, _BOUNDED = wp.constant(UNTESTED), wp.constant(PRIMITIVE), wp.constant(BOUNDED)


@wp.func
def coordinates_of(v: wp.vec3) -> float:
    """The sum of their sizes."""
    return wp.abs(v[0]) + wp.abs(v[1]) + wp.abs(v[2])


@wp.func
def _off_unit(q: wp.quat) -> float:
    """How far the squared length of a quaternion is from 1."""
    return wp.abs(wp.dot(q, q) - 1.0)


@wp.func
def _around_mesh(
    hull: Extent,
    half: wp.vec3,
    grow: float,
    size: float,
    scale: wp.vec3,
    gap: float,
    margin: float,
    world: float,
    rounding: float,
) -> Extent:
    """The hull of a domain, or of a mesh, given in the mesh's units; ``rounding`` is a multiple of what is added."""
    hull.half = wp.abs(wp.cw_mul(half, scale))
    hull.radius = wp.length(wp.cw_mul(half, scale))
    grown = grow * (1.0 + _HULL_ROUNDING)
    hull.grow = grown * wp.abs(scale)
    hull.grow_radius = wp.max(hull.grow)
    hull.below = 0.0
    inverse = 1.0 / wp.min(wp.abs(scale))
    # The search squares how far it looks, so that a negative number counts as its size.
    reach = wp.abs(gap) + wp.abs(margin * inverse)
    moved = rounding * (_MESH_ROUNDING * (size + reach) + _WORLD_ROUNDING * world * inverse)
    hull.reach = reach + moved + _SUM_ROUNDING * reach
    hull.per_radius = inverse * (1.0 + _MESH_ROUNDING + _SUM_ROUNDING)
    hull.per_coordinate = rounding * inverse * _WORLD_ROUNDING
    # Where the search finds nothing the pass takes the distance for 1e6, and makes a contact if that is near enough:
    # then nothing is said. Else a radius is over half of it, and so is the way over half of it divided by the scale.
    hull.margin = wp.min(hull.margin, _MOST_OF_RADII * inverse)
    if not wp.abs(gap) + wp.abs(margin) <= _MOST_OF_GAPS:
        hull.margin = -wp.inf
    return hull


@wp.func
def _around_primitive(kind: int, scale: wp.vec3, gap: float, margin: float, world: float) -> Extent:
    """The hull of a primitive in closed form; its margin is minus infinity where there is none."""
    hull = extent_of(kind, scale)
    hull.grow = hull.grow * (1.0 + _HULL_ROUNDING)
    hull.grow_radius = hull.grow_radius * (1.0 + _HULL_ROUNDING)
    rounding = _WORLD_ROUNDING * (world + hull.reach) + _SUM_ROUNDING * (wp.abs(gap) + wp.abs(margin))
    hull.reach = wp.max(gap + margin, 0.0) + rounding + _LEAST_WAY
    hull.per_radius = 1.0 + _MESH_ROUNDING + _SUM_ROUNDING
    hull.per_coordinate = _WORLD_ROUNDING
    return hull


@wp.func
def _nowhere(hull: Extent) -> Extent:
    """The hull of a shape with which particles do not collide: every finite particle is outside."""
    hull.half = wp.vec3(-wp.inf)
    hull.grow = wp.vec3(0.0)
    hull.below = 0.0
    hull.radius = wp.inf
    hull.grow_radius = 0.0
    hull.reach = 0.0
    hull.per_radius = 0.0
    hull.per_coordinate = 0.0
    hull.margin = wp.inf
    return hull


@wp.kernel(enable_backward=False)
def place_shapes(
    # inputs
    first: int,
    body_q: wp.array(dtype=wp.transform),
    shape_transform: wp.array(dtype=wp.transform),
    shape_body: wp.array(dtype=int),
    shape_scale: wp.array(dtype=wp.vec3),
    shape_margin: wp.array(dtype=float),
    shape_flags: wp.array(dtype=int),
    shape_type: wp.array(dtype=int),
    shape_mesh: wp.array(dtype=wp.uint64),
    gap: float,
    surfaces: int,
    roles: wp.array(dtype=int),
    meshes: wp.array(dtype=wp.uint64),
    domains: wp.array2d(dtype=wp.vec3),
    margins: wp.array(dtype=float),
    grows: wp.array(dtype=float),
    sizes: wp.array(dtype=float),
    # outputs
    placed: wp.array(dtype=Placed),
    hulls: wp.array(dtype=Extent),
):
    """World to shape, by the operations of Newton's own pass; and the hull of each shape; for rounding see module.

    The passes over ``surfaces`` measure a mesh's gap in the world, that over particles in the mesh: the larger counts.
    """
    s = first + wp.tid()
    place = wp.transform_identity()
    if shape_body[s] >= 0:
        place = body_q[shape_body[s]]
    to_world = wp.transform_multiply(place, shape_transform[s])
    scale = shape_scale[s]
    p = Placed()
    p.to_shape = wp.transform_inverse(to_world)
    p.scale = scale
    placed[s] = p
    parts = coordinates_of(wp.transform_get_translation(place))
    parts += coordinates_of(wp.transform_get_translation(shape_transform[s]))
    world = wp.max(coordinates_of(wp.transform_get_translation(p.to_shape)), parts)
    margin = 0.0
    if shape_margin.shape[0] > 0:
        margin = shape_margin[s]

    hull = Extent()
    hull.margin = margins[s]
    role = roles[s]
    if role == _PRIMITIVE:
        hull = _around_primitive(shape_type[s], scale, gap, margin, world)
    else:
        far, rounding = gap, 1.0
        if surfaces == 1:
            far = gap * wp.max(1.0, 1.0 / wp.min(wp.abs(scale)))
            rounding = _OF_SURFACES
        hull = _around_mesh(hull, domains[s, 1], grows[s], sizes[s], scale, far, margin, world, rounding)
        if shape_mesh[s] != meshes[s] or (shape_type[s] != _MESH and shape_type[s] != _CONVEX_MESH):
            hull.margin = -wp.inf  # another shape than the one that is known
    hull.center = wp.transform_point(to_world, wp.cw_mul(domains[s, 0], scale))
    bare = hull.radius
    if bare == wp.inf:
        bare = 0.0  # of a plane; its width and length are in the reach
    turn = wp.transform_get_rotation(to_world)
    length = wp.dot(turn, turn)
    beyond = _HULL_ROUNDING * (bare + coordinates_of(hull.center) + world)
    parts_off = wp.max(
        _off_unit(wp.transform_get_rotation(place)), _off_unit(wp.transform_get_rotation(shape_transform[s]))
    )
    if not wp.max(wp.abs(length - 1.0), parts_off) <= _UNIT_ROTATION:
        beyond = wp.inf  # the bounder itself is queried, in the coordinates of Newton's pass
        if surfaces == 1:
            hull.margin = -wp.inf  # which has others there
    hull.radius += beyond
    hull.half += wp.vec3(beyond)
    axes = wp.mat33()
    for k in range(3):
        axis = wp.vec3(0.0, 0.0, 0.0)
        axis[k] = 1.0
        axes[k] = wp.quat_rotate(turn, axis)
    hull.axes = axes
    if not wp.max(length, 1.0 + parts_off) <= _LONGEST_ROTATION:
        hull.margin = -wp.inf  # no bounder is queried: rounding is more than what is added
    if role == _UNTESTED:
        hull.margin = -wp.inf
    hull.stays = wp.where(role == _BOUNDED, 0, 1)
    if (shape_flags[s] & _COLLIDES) == 0:
        hull = _nowhere(hull)
    hulls[s] = hull
