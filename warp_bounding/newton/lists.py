"""The pairs that may touch, listed on a GPU: a launch for the hulls, one for each bounder, and one for the layout.

``query_listed`` serves the blocks of a CPU, too.

A pair takes its place in a list from a counter, so the order is by chance, as that of Newton's contacts is there. A
bounder is asked about the listed pairs alone, one after another, so that no thread of a warp idles.

Nothing is read back, so Newton launches a thread for each of all pairs, and ``arrange`` decides which threads get the
survivors. Threads of a warp that search a mesh from different places wait for each other: 32 of them take about three
times as long as three do (measured, an H200). So there are as many survivors in each warp as let all of them run at
once on the card, from one to 32; the other threads get a pair that was denied and is far away, at which they end at
their first comparison.
"""

from functools import cache

import warp as wp

from warp_bounding.bounders import Data
from warp_bounding.kernels.distances import DistanceSource, distance_func
from warp_bounding.kernels.functions import point_func
from warp_bounding.kernels.source import Source
from warp_bounding.newton.kernels import SUM_ROUNDING, text
from warp_bounding.newton.placing import Extent, Placed, coordinates_of
from warp_bounding.runtime.native import named, unique_name

WARP = wp.constant(32)
# Places in ``counts``: how many pairs stay, and how many a bounder is asked about; and the index, plus one, of a
# denied pair that is far away, and of any denied one.
STAYING, UNDECIDED, FAR, DENIED = (wp.constant(k) for k in range(4))
OUT, STAYS, ASK = (wp.constant(k) for k in range(3))  # what a hull says of a pair
CELLS = 32**3  # of survivors that are sorted by place: 5 bits along each axis of a hull


@named("wb_claim").func_native(text.CLAIM)
def _claim(counts: wp.array(dtype=wp.int32), which: int) -> int: ...


@named("wb_ask_hull").func_native(
    "const auto& b = hulls.data[shape]; const float x = q[0], y = q[1], z = q[2], r = radius;"
    + text.ONE_PAIR
    + "return known && !maybe ? 0 : known && !b.stays ? 2 : 1;"
)
def _ask_hull(hulls: wp.array(dtype=Extent), shape: int, q: wp.vec3, radius: float) -> int: ...


@wp.kernel(enable_backward=False)
def sift(
    # inputs
    first: int,
    pairs: wp.array(dtype=wp.vec2i),
    particle_q: wp.array(dtype=wp.vec3),
    particle_radius: wp.array(dtype=float),
    hulls: wp.array(dtype=Extent),
    # outputs
    keep: wp.array(dtype=wp.bool),
    undecided: wp.array(dtype=wp.int32),
    listed: wp.array(dtype=wp.vec2i),
    counts: wp.array(dtype=wp.int32),
):
    """List the pairs that stay by their hull, and those that a bounder is asked about.

    Which count as denied so far.
    """
    i = first + wp.tid()
    pair = pairs[i]
    q = particle_q[pair[0]]
    reported = _ask_hull(hulls, pair[1], q, particle_radius[pair[0]])
    keep[i] = reported == STAYS
    if reported == STAYS:
        listed[_claim(counts, STAYING)] = pair
    elif reported == ASK:
        undecided[_claim(counts, UNDECIDED)] = i
    elif counts[FAR] == 0:  # whoever is last is as good
        hull = hulls[pair[1]]
        if wp.max(wp.abs(q - hull.center)) > 2.0 * (hull.radius + hull.grow_radius * hull.reach):
            counts[FAR] = i + 1
        else:
            counts[DENIED] = i + 1


@cache
def maybe_func(source: Source | DistanceSource) -> wp.Function:
    """``(data, x, way, dilated)``: whether the mesh may be no farther from ``x`` than ``way``.

    A bounder of distances bounds the mesh dilated by ``dilated``, so where its g is above 0 the mesh is farther than
    ``g + dilated``; the difference below and the comparison round by less than is added.
    """
    if isinstance(source, DistanceSource):
        distance = distance_func(source)

        def maybe(data: Data, x: wp.vec3, way: float, dilated: float) -> bool:
            beyond = wp.max(way - dilated, 0.0) + SUM_ROUNDING * (wp.abs(way) + dilated)
            return not distance(data, x) > beyond
    else:
        test = point_func(source)

        def maybe(data: Data, x: wp.vec3, way: float, dilated: float) -> bool:
            return test(data, x)

    return named(unique_name(source, "newton_maybe")).func(maybe)


@cache
def query_listed(source: Source | DistanceSource) -> wp.Kernel:
    """The kernel that asks a bounder of this source about the undecided pairs of its shapes.

    They are in lists, list l from place ``l size`` on and ``left[l]`` long; as many ``threads`` share each.
    """
    maybe = maybe_func(source)

    @named(unique_name(source, "newton_listed")).kernel
    def query(
        # inputs
        first: int,
        threads: int,
        size: int,
        data: Data,
        number: int,
        dilated: float,
        numbers: wp.array(dtype=wp.int32),
        pairs: wp.array(dtype=wp.vec2i),
        particle_q: wp.array(dtype=wp.vec3),
        particle_radius: wp.array(dtype=float),
        placed: wp.array(dtype=Placed),
        hulls: wp.array(dtype=Extent),
        undecided: wp.array(dtype=wp.int32),
        left: wp.array(dtype=wp.int32),
        # outputs
        keep: wp.array(dtype=wp.bool),
        listed: wp.array(dtype=wp.vec2i),
        counts: wp.array(dtype=wp.int32),
    ):
        t = first + wp.tid()
        each = t // threads
        for k in range(t % threads, left[each], threads):
            i = undecided[each * size + k]
            pair = pairs[i]
            if numbers[pair[1]] == number:
                shape, hull, q = placed[pair[1]], hulls[pair[1]], particle_q[pair[0]]
                way = (
                    hull.reach
                    + hull.per_radius * wp.abs(particle_radius[pair[0]])
                    + hull.per_coordinate * coordinates_of(q)
                )
                x = wp.cw_div(wp.transform_point(shape.to_shape, q), shape.scale)
                stays = maybe(data, x, way, dilated)
                keep[i] = stays
                if counts:
                    if stays:
                        listed[_claim(counts, STAYING)] = pair
                    elif counts[DENIED] == 0:
                        counts[DENIED] = i + 1

    return query


@wp.kernel(enable_backward=False)
def arrange(
    # inputs
    pairs: wp.array(dtype=wp.vec2i),
    listed: wp.array(dtype=wp.vec2i),
    counts: wp.array(dtype=wp.int32),
    warps: int,
    # outputs
    kept: wp.array(dtype=wp.vec2i),
):
    """The pairs that stay, as many in each of ``warps`` warps, and in all other places one that was denied.

    There are at least 32 ``warps`` pairs, or ``warps`` is 1. More than 31 in a warp are 32, in as many as it takes.
    """
    t = wp.tid()
    left, place = counts[STAYING], int(t)
    each = (left + warps - 1) // warps
    if each < WARP:
        place = t // WARP * each + t % WARP
        if t % WARP >= each:
            place = left
    if place < left:
        kept[t] = listed[place]
    elif counts[FAR] > 0:
        kept[t] = pairs[counts[FAR] - 1]
    else:
        kept[t] = pairs[counts[DENIED] - 1]  # there is one, since not all stay


# --- Survivors by their place -----------------------------------------------------------------------------------------
#
# A counting sort by cells of the hulls, along a Morton curve, so that threads of a warp search the mesh from places
# close to each other.


@wp.func
def _spread_bits(x: int) -> int:
    """Five bits, two places apart."""
    x = (x | (x << 8)) & 0x100F
    x = (x | (x << 4)) & 0x10C3
    return (x | (x << 2)) & 0x1249


@wp.kernel(enable_backward=False)
def count_cells(
    # inputs
    threads: int,
    listed: wp.array(dtype=wp.vec2i),
    counts: wp.array(dtype=wp.int32),
    particle_q: wp.array(dtype=wp.vec3),
    hulls: wp.array(dtype=Extent),
    # outputs
    cells: wp.array(dtype=wp.vec2i),
    sizes: wp.array(dtype=wp.int32),
):
    """The cell of each survivor, and its number there."""
    for k in range(wp.tid(), counts[STAYING], threads):
        pair = listed[k]
        hull = hulls[pair[1]]
        at, cell = hull.axes * (particle_q[pair[0]] - hull.center), wp.int32(0)
        for c in range(3):
            width = hull.half[c] + hull.grow[c] * hull.reach
            along = int(wp.clamp(16.0 * (at[c] / width + 1.0), 0.0, 31.0))  # of a NaN any cell
            cell += _spread_bits(wp.clamp(along, 0, 31)) << c
        cells[k] = wp.vec2i(cell, wp.atomic_add(sizes, cell, 1))


@wp.kernel(enable_backward=False)
def sort_by_cells(
    # inputs
    threads: int,
    listed: wp.array(dtype=wp.vec2i),
    counts: wp.array(dtype=wp.int32),
    cells: wp.array(dtype=wp.vec2i),
    ends: wp.array(dtype=wp.int32),
    sizes: wp.array(dtype=wp.int32),
    # outputs
    ordered: wp.array(dtype=wp.vec2i),
):
    """The survivors, cell by cell."""
    for k in range(wp.tid(), counts[STAYING], threads):
        at = cells[k]
        ordered[ends[at[0]] - sizes[at[0]] + at[1]] = listed[k]
