"""The plain twin of a distance: the function in Warp's own Python, for any source; see ``kernels.plain``."""

from functools import cache

import warp as wp

from warp_bounding.coordinates.base import Numbers, vector_type
from warp_bounding.kernels.distances.source import TINIEST, DistanceSource
from warp_bounding.kernels.functions import Data, Words
from warp_bounding.kernels.plain import plain_value, twin
from warp_bounding.kernels.source import LABEL

__all__ = ["plain_distance"]


@cache
def plain_distance(source: DistanceSource) -> wp.Function:
    """``distance(data: Data, x: vec_n) -> float32``, as ``functions.distance_func`` has it."""
    n, start, whole, time, f_of = source.ndim, source.start, source.whole, int(source.time), plain_value(source)
    vector = vector_type(n)
    first, second = (wp.uint32(bits) for bits in source.tag)
    limit, numbers = LABEL + n, LABEL + 2 * n

    @twin(source, "distance_of")
    def distance_of(w: Numbers, words: Words, x: vector) -> float:
        v, away, beyond = vector(), wp.float32(0.0), wp.float32(0.0)
        for k in range(n):
            v[k] = (x[k] - w[LABEL + k]) * (w[numbers + 4] if k < time else w[numbers])
            away += wp.abs(v[k])
            if not whole and k >= time:
                p = wp.clamp(v[k], -w[limit + k], w[limit + k])
                beyond += (v[k] - p) * (v[k] - p)
                v[k] = p
        f = f_of(w, words, start, v)
        g = f + w[numbers + 2]
        if whole:
            g = g - w[numbers + 3] * (away + wp.abs(f))
        else:
            h = wp.max(g, 0.0)
            g = wp.sqrt(beyond + h * h)
            g = g - w[numbers + 3] * (away + g)
        if time and wp.abs(v[0]) > w[limit]:
            g = 0.0
        return wp.where(g > TINIEST, g * w[numbers + 1], 0.0)

    @twin(source, "distance")
    def distance(data: Data, x: vector) -> float:
        w = data.parameters
        if w.shape[0] < LABEL:
            return 0.0
        if wp.cast(w[0], wp.uint32) != first or wp.cast(w[1], wp.uint32) != second:  # another function's data
            return 0.0
        if w.shape[0] < wp.cast(w[2], wp.int32) or data.words.shape[0] < wp.cast(w[3], wp.int32):
            return 0.0
        return distance_of(w, data.words, x)

    return distance
