"""From when to when may a segment meet the object at all? Only while it is in the box that holds the object, dilated by the radius.

With the names of ``functions``: the exact point at a time t of [0, 1] is within ``room`` of ``a + t w`` in every coordinate, the radius contained. So where contact is possible,
``a_k + t w_k`` lies between ``center_k - far`` and ``center_k + far``, ``far = half_k + room`` and what these sums round, on every axis of space. A difference of
float32 numbers and a quotient round by one unit each, which ``SHORTER`` and ``LONGER`` outweigh; the sign of both is exact.
Numbers that are set to zero err by less than ``LEAST``, which is added to far once more.
"""

from functools import cache

import warp as wp

from warp_bounding.arithmetic import UNIT32
from warp_bounding.coordinates.base import Numbers, vector_type
from warp_bounding.kernels.distances.source import DistanceSource
from warp_bounding.kernels.functions import Data
from warp_bounding.kernels.source import LABEL
from warp_bounding.runtime.native import named, unique_name

__all__ = ["FINITE", "LEAST", "LONGER", "SHORTER", "clip_func", "owns_func"]

LEAST = 2.0**-100  # object units: above what results that are set to zero take
LONGER = 1.0 + 2.0**-19  # outweighs the rounding of a length of up to 64 numbers
SHORTER = 1.0 - 2.0**-21  # outweighs the rounding of a difference, a quotient and a sum
FINITE = 3.0e38
SUMS = 16.0 * UNIT32  # of all numbers that are added up: more than six roundings


@cache
def owns_func(source: DistanceSource) -> wp.Function:
    """``owns(w) -> bool``: are these data of this source? Of others nothing is told, and the domain that is read is another."""
    first, second = (wp.uint32(bits) for bits in source.tag)

    @named(unique_name(source, "owns")).func
    def owns(w: Numbers) -> bool:
        if w.shape[0] < LABEL:
            return False
        return (
            wp.cast(w[0], wp.uint32) == first
            and wp.cast(w[1], wp.uint32) == second
            and w.shape[0] >= wp.cast(w[2], wp.int32)
        )

    return owns


@cache
def clip_func(source: DistanceSource) -> wp.Function:
    """``vec2 = clip(data, a, w, room)``: contact is only possible from the first of these times to the second; never where that is less."""
    vector, n, time, owns = vector_type(source.ndim), source.ndim, int(source.time), owns_func(source)
    center, limit, unit = LABEL, LABEL + source.ndim, LABEL + 2 * source.ndim + 1

    @named(unique_name(source, "clip")).func
    def clip(data: Data, a: vector, w: vector, room: float) -> wp.vec2:
        span = wp.vec2(0.0, 1.0)
        if not owns(data.parameters) or not room < FINITE:
            return span
        for k in range(time, n):
            at = float(data.parameters[center + k])
            half = float(data.parameters[limit + k] * data.parameters[unit])
            far = half + room + ((wp.abs(at) + half + room) * SUMS + LEAST)
            low, high = at - far - a[k], at + far - a[k]
            if w[k] == 0.0:
                if low > 0.0 or high < 0.0:
                    span[0] = 2.0
            else:
                enter, leave = low / w[k], high / w[k]
                if w[k] < 0.0:
                    enter, leave = high / w[k], low / w[k]
                if enter * SHORTER > span[0]:
                    span[0] = enter * SHORTER
                if leave * LONGER < span[1]:
                    span[1] = leave * LONGER
        return span

    return clip
