"""Kernels of the cull: where shapes lie in one pass, which pairs a bounder lets through, and their list.

Most pairs are far apart. So a loop over a block of pairs asks first whether the particle lies outside a ball around the
bounder's domain, or outside the domain's box as it lies in the world, and lists the others (``hulls``); only those go
to the bounder. A bounder of distances is asked about many of them at a time on a CPU (``distances``), else about one.
"""

from functools import cache

import warp as wp

from warp_bounding.arithmetic import UNIT32
from warp_bounding.bounders import Data
from warp_bounding.kernels.distances.functions import distance_func
from warp_bounding.kernels.distances.source import DistanceSource
from warp_bounding.kernels.functions import point_func
from warp_bounding.kernels.source import Source
from warp_bounding.runtime.native import named, unique_name

__all__ = [
    "IN_MESH",
    "IN_SUM",
    "IN_WORLD",
    "Hull",
    "Placed",
    "ask_bounders",
    "ask_distances",
    "block_size",
    "gather_pairs",
    "place_shapes",
    "split_particles",
]

# What float32 does between a particle's place and the closest point, in units of 2^-24: of the coordinates in the mesh
# (the closest point 16, the division by the scale 1, the search's own products 8) and of the way; and of the
# coordinates in the world: two transforms, once in the pass and once here, each a rotation by a quaternion and a sum:
# under 64 all told.
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


CPU_BLOCK = 1024  # pairs that one thread of a kernel goes through on a CPU


def block_size(device: wp.Device) -> int:
    """Pairs that one thread of a kernel goes through."""
    return CPU_BLOCK if device.is_cpu else 1


@wp.struct
class Placed:
    """A shape as it lies in the world in one pass."""

    to_shape: wp.transform
    scale: wp.vec3


@wp.struct
class Hull:
    """A ball and a box in the world, outside which a shape's bounder denies every particle.

    How far the pass looks for a particle q of radius r, ``gap + (margin of the shape + r) / least scale``, and rounding take
    ``way = reach + per_radius r + per_coordinate (|q_x| + |q_y| + |q_z|)`` in the mesh's units. A bounder of points may deny the particle only
    where ``way <= margin``, its own. A bounder of distances may always, and the ball and the box grow by the way.
    """

    center: wp.vec3  # of ball and box, world
    axes: wp.mat33  # rows: directions of the box
    half: wp.vec3  # its half widths
    grow: wp.vec3  # world units by which each half width grows per unit of way: 0 for a bounder of points
    grow_radius: float  # and the ball's radius
    radius: float  # of the ball
    reach: float
    per_radius: float
    per_coordinate: float
    margin: float  # infinite for a bounder of distances, minus infinity for a shape without a bounder, or one whose quaternion is far from a rotation


@wp.func
def _size(v: wp.vec3) -> float:
    return wp.abs(v[0]) + wp.abs(v[1]) + wp.abs(v[2])


@wp.kernel(enable_backward=False)
def place_shapes(
    # inputs
    body_q: wp.array(dtype=wp.transform),
    shape_transform: wp.array(dtype=wp.transform),
    shape_body: wp.array(dtype=int),
    shape_scale: wp.array(dtype=wp.vec3),
    shape_margin: wp.array(dtype=float),
    domains: wp.array2d(dtype=wp.vec3),
    margins: wp.array(dtype=float),
    grows: wp.array(dtype=float),
    sizes: wp.array(dtype=float),
    gap: float,
    # outputs
    placed: wp.array(dtype=Placed),
    hulls: wp.array(dtype=Hull),
):
    """World to shape, by the operations of Newton's own pass; and the hull of each shape.

    Rounding, when a hull is made and when it is asked, is within what is added: 256 units of 2^-24 of all lengths that
    enter, of which a rotation, a difference and a product take under 64.
    """
    s = wp.tid()
    place = wp.transform_identity()
    if shape_body[s] >= 0:
        place = body_q[shape_body[s]]
    to_world = wp.transform_multiply(place, shape_transform[s])
    scale = shape_scale[s]
    center = wp.transform_point(to_world, wp.cw_mul(domains[s, 0], scale))
    bare = wp.length(wp.cw_mul(domains[s, 1], scale))
    rounding = _HULL_ROUNDING * (bare + _size(center) + _size(wp.transform_get_translation(to_world)))
    radius = bare + rounding
    p = Placed()
    p.to_shape = wp.transform_inverse(to_world)
    p.scale = scale
    placed[s] = p
    turn = wp.transform_get_rotation(to_world)
    length = wp.dot(turn, turn)
    beyond = 0.0
    if not wp.abs(length - 1.0) <= _UNIT_ROTATION:
        beyond = wp.inf  # the bounder itself is asked, in the coordinates of Newton's pass
    hull = Hull()
    hull.center = center
    hull.radius = radius + beyond
    grow = grows[s] * (1.0 + _HULL_ROUNDING)
    hull.grow_radius = grow * wp.max(wp.max(wp.abs(scale[0]), wp.abs(scale[1])), wp.abs(scale[2]))
    axes, half, widths = wp.mat33(), wp.vec3(), wp.vec3()
    for k in range(3):
        axis = wp.vec3(0.0, 0.0, 0.0)
        axis[k] = 1.0
        axes[k] = wp.quat_rotate(turn, axis)
        half[k] = wp.abs(domains[s, 1][k] * scale[k]) + rounding + beyond
        widths[k] = grow * wp.abs(scale[k])
    hull.axes = axes
    hull.half = half
    hull.grow = widths
    inverse = 1.0 / wp.min(wp.min(wp.abs(scale[0]), wp.abs(scale[1])), wp.abs(scale[2]))
    widened = shape_margin[s] * inverse
    reach = gap + widened
    world = _size(wp.transform_get_translation(p.to_shape)) * inverse
    moved = _MESH_ROUNDING * (sizes[s] + wp.abs(reach)) + _WORLD_ROUNDING * world
    hull.reach = reach + moved + _SUM_ROUNDING * (wp.abs(gap) + wp.abs(widened))
    hull.per_radius = inverse * (1.0 + _MESH_ROUNDING + _SUM_ROUNDING)
    hull.per_coordinate = inverse * _WORLD_ROUNDING
    hull.margin = margins[s]
    if not length <= _LONGEST_ROTATION:
        hull.margin = -wp.inf  # no bounder is asked: rounding is more than what is added
    hulls[s] = hull


@wp.kernel(enable_backward=False)
def split_particles(
    # inputs
    first: int,
    particle_q: wp.array(dtype=wp.vec3),
    particle_radius: wp.array(dtype=float),
    count: int,
    # outputs
    rows: wp.array(dtype=float),
):
    """The particles' x, one after another, then all their y, z and radii: so that neighbours are read together."""
    p = first + wp.tid()
    q = particle_q[p]
    for k in range(3):
        rows[k * count + p] = q[k]
    rows[3 * count + p] = particle_radius[p]


@wp.kernel(enable_backward=False)
def gather_pairs(
    # inputs
    pairs: wp.array(dtype=wp.vec2i),
    indices: wp.array(dtype=wp.int32),
    # outputs
    kept: wp.array(dtype=wp.vec2i),
):
    """The pairs that are left, in their order."""
    i = wp.tid()
    kept[i] = pairs[indices[i]]


@cache
def ask_bounders(source: Source) -> wp.Kernel:
    """The kernel that asks a bounder of this source about the pairs of its shapes that ``ask_hulls`` has listed."""
    test = point_func(source)

    @named(unique_name(source, "newton")).kernel
    def ask(
        # inputs
        first: int,
        size: int,
        data: Data,
        number: int,
        numbers: wp.array(dtype=wp.int32),
        pairs: wp.array(dtype=wp.vec2i),
        particle_q: wp.array(dtype=wp.vec3),
        placed: wp.array(dtype=Placed),
        asked: wp.array(dtype=wp.int32),
        left: wp.array(dtype=wp.int32),
        # outputs
        keep: wp.array(dtype=wp.uint8),
    ):
        block = first + wp.tid()
        for k in range(left[block]):
            i = asked[block * size + k]
            pair = pairs[i]
            if numbers[pair[1]] == number:
                shape = placed[pair[1]]
                x = wp.cw_div(wp.transform_point(shape.to_shape, particle_q[pair[0]]), shape.scale)
                if test(data, x):
                    keep[i] = wp.uint8(1)
                else:
                    keep[i] = wp.uint8(0)

    return ask


@cache
def ask_distances(source: DistanceSource) -> wp.Kernel:
    """The kernel that asks a bounder of distances about the pairs of its shapes that ``ask_hulls`` has listed.

    It bounds the mesh dilated by ``dilated``, so where its g is above 0 the mesh is farther than ``g + dilated``; the difference below and the
    comparison round by less than is added.
    """
    distance = distance_func(source)

    @named(unique_name(source, "newton_distance")).kernel
    def ask(
        # inputs
        first: int,
        size: int,
        data: Data,
        number: int,
        dilated: float,
        numbers: wp.array(dtype=wp.int32),
        pairs: wp.array(dtype=wp.vec2i),
        particle_q: wp.array(dtype=wp.vec3),
        particle_radius: wp.array(dtype=float),
        placed: wp.array(dtype=Placed),
        hulls: wp.array(dtype=Hull),
        asked: wp.array(dtype=wp.int32),
        left: wp.array(dtype=wp.int32),
        # outputs
        keep: wp.array(dtype=wp.uint8),
    ):
        block = first + wp.tid()
        for k in range(left[block]):
            i = asked[block * size + k]
            pair = pairs[i]
            if numbers[pair[1]] == number:
                shape, hull, q = placed[pair[1]], hulls[pair[1]], particle_q[pair[0]]
                way = hull.reach + hull.per_radius * particle_radius[pair[0]] + hull.per_coordinate * _size(q)
                x = wp.cw_div(wp.transform_point(shape.to_shape, q), shape.scale)
                beyond = wp.max(way - dilated, 0.0) + _SUM_ROUNDING * (wp.abs(way) + dilated)
                if distance(data, x) > beyond:
                    keep[i] = wp.uint8(0)
                else:
                    keep[i] = wp.uint8(1)

    return ask
