"""Where shapes lie in one pass, and a ball and a box around each, outside which no particle meets it (``Hull``).

How much float32 may err, in the pass and when hulls are made and asked, is counted in units of 2^-24. The pass and ``place_shapes`` make the same
transform of a shape: a product of quaternions, 8 in length, and a rotation and a sum, 42 of the lengths that enter. A rotation is 20 on an axis; a particle is turned
into the shape's axes by one, the axes of the hull are three, 24 with the difference and the products. If a compiler fuses the two kernels in different ways, their
quaternions differ by 16, which turns by 96; and a quaternion counts as a rotation only if its squared length is within 1e-6 of 1, and those of its factors are. With the signed distance's own, 8, and
the ball's, all are under 256 of the particle's coordinates and of the place's (``IN_WORLD``), for which the larger is taken of the place in the world or seen from the
shape and of the places that it is made of.
"""

import warp as wp

from warp_bounding.arithmetic import UNIT32
from warp_bounding.newton.library import newton
from warp_bounding.newton.primitives import extent_of

__all__ = [
    "BOUNDED",
    "HULL",
    "IN_MESH",
    "IN_SUM",
    "IN_WORLD",
    "PRIMITIVE",
    "UNTESTED",
    "Hull",
    "Placed",
    "place_shapes",
]

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
# A quaternion whose squared length is farther from 1 than this, more than float32 rounding makes it, does not only
# rotate.
_UNIT_ROTATION = wp.constant(1.0e-6)
_LONGEST_ROTATION = wp.constant(2.0)
# What the way around a shape in closed form is at least, since the squares of lengths under 2^-63 are lost.
_LEAST_WAY = wp.constant(2.0**-60)
# Of a mesh: the largest sizes of gap and margin together, and of a radius; Newton's distance of what it does not find is 1e6.
_MOST_OF_GAPS, _MOST_OF_RADII = wp.constant(5.0e5), wp.constant(4.0e5)
_COLLIDES = wp.constant(int(newton.ShapeFlags.COLLIDE_PARTICLES))
# What is done with a shape: nothing, its hull in closed form, the hull of its mesh, or that and its bounder.
UNTESTED, PRIMITIVE, HULL, BOUNDED = 0, 1, 2, 3
_MESH, _CONVEX_MESH = wp.constant(int(newton.GeoType.MESH)), wp.constant(int(newton.GeoType.CONVEX_MESH))
_UNTESTED, _PRIMITIVE, _BOUNDED = wp.constant(UNTESTED), wp.constant(PRIMITIVE), wp.constant(BOUNDED)


@wp.struct
class Placed:
    """A shape as it lies in the world in one pass."""

    to_shape: wp.transform
    scale: wp.vec3


@wp.struct
class Hull:
    """A ball and a box in the world, outside which the pass makes no contact of a particle with the shape.

    How far the pass looks for a particle q of radius r, ``gap + (margin of the shape + r) / least scale``, and rounding take
    ``way = reach + per_radius r + per_coordinate (|q_x| + |q_y| + |q_z|)`` in the mesh's units; of a primitive, whose scale is its lengths, in the world's.
    A bounder of points may deny the particle only where ``way <= margin``, its own; its domain does not grow. In every other case the ball and
    the box grow by the way. The box is open below its third axis by ``below``, for a plane.
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
    margin: float  # infinite for a mesh whose hull grows, minus infinity for a shape without a hull, or one whose quaternion is far from a rotation
    stays: int  # 1 where no bounder is asked: a pair that the hull does not deny stays


@wp.func
def _size(v: wp.vec3) -> float:
    return wp.abs(v[0]) + wp.abs(v[1]) + wp.abs(v[2])


@wp.func
def _off_unit(q: wp.quat) -> float:
    """How far the squared length of a quaternion is from 1."""
    return wp.abs(wp.dot(q, q) - 1.0)


@wp.func
def _around_mesh(
    hull: Hull, half: wp.vec3, grow: float, size: float, scale: wp.vec3, gap: float, margin: float, world: float
) -> Hull:
    """The hull of a domain, or of a mesh, given in the mesh's units."""
    hull.half = wp.abs(wp.cw_mul(half, scale))
    hull.radius = wp.length(wp.cw_mul(half, scale))
    grown = grow * (1.0 + _HULL_ROUNDING)
    hull.grow = grown * wp.abs(scale)
    hull.grow_radius = wp.max(hull.grow)
    hull.below = 0.0
    inverse = 1.0 / wp.min(wp.abs(scale))
    reach = wp.abs(gap) + wp.abs(
        margin * inverse
    )  # the search squares how far it looks, so that a negative number counts as its size
    moved = _MESH_ROUNDING * (size + reach) + _WORLD_ROUNDING * world * inverse
    hull.reach = reach + moved + _SUM_ROUNDING * reach
    hull.per_radius = inverse * (1.0 + _MESH_ROUNDING + _SUM_ROUNDING)
    hull.per_coordinate = inverse * _WORLD_ROUNDING
    # Where the search finds nothing the pass takes the distance for 1e6, and makes a contact if that is near enough: then nothing is said. Else a radius is
    # over half of it, and so is the way over half of it divided by the scale.
    hull.margin = wp.min(hull.margin, _MOST_OF_RADII * inverse)
    if not wp.abs(gap) + wp.abs(margin) <= _MOST_OF_GAPS:
        hull.margin = -wp.inf
    return hull


@wp.func
def _around_primitive(hull: Hull, kind: int, scale: wp.vec3, gap: float, margin: float, world: float) -> Hull:
    """The hull of a primitive in closed form; its margin is minus infinity where there is none."""
    e = extent_of(kind, scale)
    hull.half = e.half
    hull.radius = e.radius
    hull.below = e.below
    hull.grow = e.grow * (1.0 + _HULL_ROUNDING)
    hull.grow_radius = e.grow_radius * (1.0 + _HULL_ROUNDING)
    rounding = _WORLD_ROUNDING * (world + e.size) + _SUM_ROUNDING * (wp.abs(gap) + wp.abs(margin))
    hull.reach = wp.max(gap + margin, 0.0) + rounding + _LEAST_WAY
    hull.per_radius = 1.0 + _MESH_ROUNDING + _SUM_ROUNDING
    hull.per_coordinate = _WORLD_ROUNDING
    hull.margin = wp.where(e.tested, e.most_way, -wp.inf)
    return hull


@wp.func
def _nowhere(hull: Hull) -> Hull:
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
    roles: wp.array(dtype=int),
    meshes: wp.array(dtype=wp.uint64),
    domains: wp.array2d(dtype=wp.vec3),
    margins: wp.array(dtype=float),
    grows: wp.array(dtype=float),
    sizes: wp.array(dtype=float),
    # outputs
    placed: wp.array(dtype=Placed),
    hulls: wp.array(dtype=Hull),
):
    """World to shape, by the operations of Newton's own pass; and the hull of each shape; for rounding see module."""
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
    parts = _size(wp.transform_get_translation(place)) + _size(wp.transform_get_translation(shape_transform[s]))
    world = wp.max(_size(wp.transform_get_translation(p.to_shape)), parts)
    margin = 0.0
    if shape_margin.shape[0] > 0:
        margin = shape_margin[s]

    hull = Hull()
    hull.center = wp.transform_point(to_world, wp.cw_mul(domains[s, 0], scale))
    hull.margin = margins[s]
    role = roles[s]
    if role == _PRIMITIVE:
        hull = _around_primitive(hull, shape_type[s], scale, gap, margin, world)
    else:
        hull = _around_mesh(hull, domains[s, 1], grows[s], sizes[s], scale, gap, margin, world)
        if shape_mesh[s] != meshes[s] or (shape_type[s] != _MESH and shape_type[s] != _CONVEX_MESH):
            hull.margin = -wp.inf  # another shape than the one that is known
    bare = hull.radius
    if bare == wp.inf:
        bare = 0.0  # of a plane; its width and length are in the reach
    turn = wp.transform_get_rotation(to_world)
    length = wp.dot(turn, turn)
    beyond = _HULL_ROUNDING * (bare + _size(hull.center) + world)
    parts_off = wp.max(
        _off_unit(wp.transform_get_rotation(place)), _off_unit(wp.transform_get_rotation(shape_transform[s]))
    )
    if not wp.max(wp.abs(length - 1.0), parts_off) <= _UNIT_ROTATION:
        beyond = wp.inf  # the bounder itself is asked, in the coordinates of Newton's pass
    hull.radius += beyond
    hull.half += wp.vec3(beyond)
    axes = wp.mat33()
    for k in range(3):
        axis = wp.vec3(0.0, 0.0, 0.0)
        axis[k] = 1.0
        axes[k] = wp.quat_rotate(turn, axis)
    hull.axes = axes
    if not wp.max(length, 1.0 + parts_off) <= _LONGEST_ROTATION:
        hull.margin = -wp.inf  # no bounder is asked: rounding is more than what is added
    if role == _UNTESTED:
        hull.margin = -wp.inf
    hull.stays = wp.where(role == _BOUNDED, 0, 1)
    if (shape_flags[s] & _COLLIDES) == 0:
        hull = _nowhere(hull)
    hulls[s] = hull
