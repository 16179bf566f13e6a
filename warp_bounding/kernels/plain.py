"""Points tested by ``mlp`` and ``kdop`` as plain Warp kernels: a readable form of the native text, and its oracle.

They are slow, a query a thread and without lanes (a network takes some 50 times as long), and nothing is claimed about
their rounding.
"""

from functools import cache

import warp as wp

from warp_bounding.activations import ACTIVATIONS
from warp_bounding.runtime.native import Numbers


@wp.func
def local(x: wp.float32, center: wp.float32, scale: wp.float32):
    """A coordinate in local space, where the domain is about [-1, 1]."""
    return (x - center) * scale


@cache
def mlp_kernel(widest: int, activation: str) -> wp.Kernel:
    """``f`` of points by a network, no layer wider than ``widest``; minus infinity outside the domain.

    Arguments: points ``x``, n numbers each; ``center``, ``scale`` and ``limit`` (n); ``sizes`` of all layers, the first
    n and the last 1; ``numbers``, of each layer the biases, then the weights row by row; ``f``.
    """
    layer, act = wp.types.vector(length=widest, dtype=wp.float32), ACTIVATIONS[activation].plain

    @wp.kernel(module="unique", enable_backward=False)
    def mlp(
        # inputs
        x: Numbers,
        center: Numbers,
        scale: Numbers,
        limit: Numbers,
        sizes: wp.array(dtype=wp.int32),
        numbers: Numbers,
        # outputs
        f: Numbers,
    ):
        i, n, last = wp.tid(), sizes[0], sizes.shape[0] - 1
        h, z, inside, at = layer(), layer(), wp.bool(True), wp.int32(0)
        for k in range(n):
            h[k] = local(x[i * n + k], center[k], scale[k])
            inside = inside and wp.abs(h[k]) <= limit[k]
        for number in range(last):
            below, above = sizes[number], sizes[number + 1]
            for j in range(above):
                z[j] = numbers[at + j]
                for k in range(below):
                    z[j] += numbers[at + above + j * below + k] * h[k]
            for j in range(above):
                h[j] = wp.where(number + 1 < last, act(z[j]), z[j])
            at += above * (below + 1)
        f[i] = wp.where(inside, h[0], -wp.inf)

    return mlp


@wp.kernel(enable_backward=False)
def kdop_kernel(
    # inputs
    x: Numbers,
    center: Numbers,
    scale: Numbers,
    limit: Numbers,
    directions: Numbers,
    low: Numbers,
    high: Numbers,
    # outputs
    f: Numbers,
):
    """``f`` of points by slabs ``low_k <= d_k . v <= high_k``: the least face distance; -infinity outside the domain.

    ``directions`` are row by row; the others are as of ``mlp_kernel``.
    """
    i, n = wp.tid(), center.shape[0]
    least, inside = wp.float32(wp.inf), wp.bool(True)
    for k in range(n):
        inside = inside and wp.abs(local(x[i * n + k], center[k], scale[k])) <= limit[k]
    for slab in range(low.shape[0]):
        y = wp.float32(0.0)
        for k in range(n):
            y += directions[slab * n + k] * local(x[i * n + k], center[k], scale[k])
        least = wp.min(least, wp.min(y - low[slab], high[slab] - y))
    f[i] = wp.where(inside, least, -wp.inf)
