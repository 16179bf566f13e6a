"""Kernels of the cull: which pairs a bounder lets through, and their list.

Most pairs are far apart. So a loop over a block of pairs asks first whether the particle lies outside a ball around the
shape, or outside its box as it lies in the world (``placing``), and lists the others (``hulls``); only those go
to the bounder. A bounder of distances is asked about many of them at a time on a CPU (``distances``), else about one.
"""

from functools import cache

import warp as wp

from warp_bounding.bounders import Data
from warp_bounding.kernels.distances.functions import distance_func
from warp_bounding.kernels.distances.source import DistanceSource
from warp_bounding.kernels.functions import point_func
from warp_bounding.kernels.source import Source
from warp_bounding.newton.placing import IN_SUM, Hull, Placed
from warp_bounding.runtime.native import named, unique_name

__all__ = [
    "ask_bounders",
    "ask_distances",
    "block_size",
    "find_far",
    "gather_or_repeat",
    "gather_pairs",
    "replace_denied",
    "split_particles",
]

_SUM_ROUNDING = wp.constant(IN_SUM)

CPU_BLOCK = 1024  # pairs that one thread of a kernel goes through on a CPU


def block_size(device: wp.Device) -> int:
    """Pairs that one thread of a kernel goes through."""
    return CPU_BLOCK if device.is_cpu else 1


@wp.func
def _size(v: wp.vec3) -> float:
    return wp.abs(v[0]) + wp.abs(v[1]) + wp.abs(v[2])


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


@wp.kernel(enable_backward=False)
def find_far(
    # inputs
    pairs: wp.array(dtype=wp.vec2i),
    keep: wp.array(dtype=wp.uint8),
    particle_q: wp.array(dtype=wp.vec3),
    hulls: wp.array(dtype=Hull),
    # outputs
    far: wp.array(dtype=wp.int32),
):
    """Some denied pair whose particle is so far away that Newton's pass sees it by the shape's box; any that is written last."""
    i = wp.tid()
    if keep[i] == wp.uint8(0):
        pair = pairs[i]
        hull, q = hulls[pair[1]], particle_q[pair[0]]
        if wp.max(wp.abs(q - hull.center)) > 2.0 * (hull.radius + hull.grow_radius * hull.reach):
            far[0] = i


@wp.kernel(enable_backward=False)
def gather_or_repeat(
    # inputs
    pairs: wp.array(dtype=wp.vec2i),
    indices: wp.array(dtype=wp.int32),
    count: wp.array(dtype=wp.int32),
    far: wp.array(dtype=wp.int32),
    # outputs
    kept: wp.array(dtype=wp.vec2i),
):
    """The pairs that are left, in their order; and behind them, up to the number of all pairs, one that was denied.

    The pass makes no contact of it, however often it comes. It is the one that ``far`` names, or the first: indices ascend, so that
    it is where they run ahead of their own places.
    """
    i = wp.tid()
    left = count[0]
    if i < left:
        kept[i] = pairs[indices[i]]
    else:
        denied = int(far[0])
        if denied < 0:
            denied = wp.int32(0)
            most = int(left)
            while denied < most:
                middle = (denied + most) // 2
                if indices[middle] == middle:
                    denied = middle + 1
                else:
                    most = middle
        kept[i] = pairs[denied]


@wp.kernel(enable_backward=False)
def replace_denied(
    # inputs
    pairs: wp.array(dtype=wp.vec2i),
    keep: wp.array(dtype=wp.uint8),
    far: wp.array(dtype=wp.int32),
    # outputs
    kept: wp.array(dtype=wp.vec2i),
    count: wp.array(dtype=wp.int32),
):
    """The pairs that are left, where they are, and in the places of the others the one that ``far`` names, if there is one."""
    i = wp.tid()
    which = wp.int32(i)
    if keep[i] != wp.uint8(0):
        wp.atomic_add(count, 0, 1)
    elif far[0] >= 0:
        which = far[0]
    kept[i] = pairs[which]


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
                way = hull.reach + hull.per_radius * wp.abs(particle_radius[pair[0]]) + hull.per_coordinate * _size(q)
                x = wp.cw_div(wp.transform_point(shape.to_shape, q), shape.scale)
                beyond = wp.max(way - dilated, 0.0) + _SUM_ROUNDING * (wp.abs(way) + dilated)
                if distance(data, x) > beyond:
                    keep[i] = wp.uint8(0)
                else:
                    keep[i] = wp.uint8(1)

    return ask
