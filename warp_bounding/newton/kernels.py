"""Kernels of the cull: where shapes lie in one pass, which pairs a bounder lets through, and their list."""

from functools import cache

import warp as wp

from warp_bounding.arithmetic import UNIT32
from warp_bounding.bounders import Data
from warp_bounding.bounders.functions import point_func
from warp_bounding.bounders.source import Source
from warp_bounding.native import named, unique_name

__all__ = ["IN_MESH", "IN_WORLD", "Placed", "gather_pairs", "mark_pairs", "place_shapes"]

# What float32 does between a particle's place and the closest point, in units of 2^-24: of the coordinates in the mesh (the closest
# point 16, the division by the scale 1, the search's own products 8) and of the way; and of the coordinates in the world: two
# transforms, once in the pass and once here, each a rotation by a quaternion and a sum: under 64 all told.
IN_MESH, IN_WORLD = 32.0, 256.0
_WORLD_ROUNDING = wp.constant(IN_WORLD * UNIT32)
_MESH_ROUNDING = wp.constant(IN_MESH * UNIT32)
# Of the ball around a domain in the world, and of a distance from its middle: under 64 units in all.
_BALL_ROUNDING = wp.constant(IN_WORLD * UNIT32)
# Off which a quaternion's square may be, as floats leave it; other ones do not only rotate.
_UNIT_ROTATION = wp.constant(1.0e-6)


@wp.struct
class Placed:
    """A shape as it lies in the world in one pass."""

    to_shape: wp.transform
    scale: wp.vec3
    center: wp.vec3  # of a ball, world: beyond it the bounder denies everything
    square: float  # of its radius
    smallest: float  # scale
    size: float  # largest coordinate of the mesh
    away: float  # sum of the coordinates of to_shape's translation
    shape_margin: float
    margin: float  # of the bounder


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
    sizes: wp.array(dtype=float),
    # outputs
    placed: wp.array(dtype=Placed),
):
    """World to shape, by the operations of Newton's own pass; and the ball around the bounder's domain."""
    s = wp.tid()
    place = wp.transform_identity()
    if shape_body[s] >= 0:
        place = body_q[shape_body[s]]
    to_world = wp.transform_multiply(place, shape_transform[s])
    scale = shape_scale[s]
    center = wp.transform_point(to_world, wp.cw_mul(domains[s, 0], scale))
    radius = wp.length(wp.cw_mul(domains[s, 1], scale))
    radius = radius + _BALL_ROUNDING * (radius + _size(center) + _size(wp.transform_get_translation(to_world)))
    p = Placed()
    p.to_shape = wp.transform_inverse(to_world)
    p.scale = scale
    p.center = center
    p.square = radius * radius
    turn = wp.transform_get_rotation(to_world)
    if not wp.abs(wp.dot(turn, turn) - 1.0) <= _UNIT_ROTATION:
        p.square = wp.inf  # the bounder itself is asked, in the coordinates of Newton's pass
    p.smallest = wp.min(wp.min(wp.abs(scale[0]), wp.abs(scale[1])), wp.abs(scale[2]))
    p.size = sizes[s]
    p.away = _size(wp.transform_get_translation(p.to_shape))
    p.shape_margin = shape_margin[s]
    p.margin = margins[s]
    placed[s] = p


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
def mark_pairs(source: Source) -> wp.Kernel:
    """The kernel that asks bounders of one source about pairs."""
    test = point_func(source)

    @named(unique_name(source, "newton")).kernel
    def ask(
        # inputs
        first: int,
        data: Data,
        members: wp.array(dtype=wp.int32),
        pairs: wp.array(dtype=wp.vec2i),
        particle_q: wp.array(dtype=wp.vec3),
        particle_radius: wp.array(dtype=float),
        placed: wp.array(dtype=Placed),
        gap: float,
        # outputs
        keep: wp.array(dtype=wp.uint8),
    ):
        i = members[first + wp.tid()]
        pair = pairs[i]
        q, s = particle_q[pair[0]], pair[1]
        # What a bounder must be dilated by for this pair: as far as the pass looks, and what rounding does, twice over.
        reach = gap + (placed[s].shape_margin + particle_radius[pair[0]]) / placed[s].smallest
        world = (_size(q) + placed[s].away) / placed[s].smallest
        needed = reach + _MESH_ROUNDING * (placed[s].size + reach) + _WORLD_ROUNDING * world
        answer = wp.uint8(1)
        if needed <= placed[s].margin:
            away = q - placed[s].center
            if wp.dot(away, away) > placed[s].square:
                answer = wp.uint8(0)
            else:
                x = wp.cw_div(wp.transform_point(placed[s].to_shape, q), placed[s].scale)
                if not test(data, x):
                    answer = wp.uint8(0)
        keep[i] = answer

    return ask
