"""Kernels of the cull on a CPU: which pairs a bounder lets through, and their list; those of a GPU are in ``lists``.

Most pairs are far apart. So a loop over a block of pairs asks first whether the particle lies outside a ball around the
shape, or outside its box as it lies in the world (``placing``), and lists the others (``query_hulls``); only those go
to the bounder. A bounder of distances is asked about many of them at a time (``query_distances_in_lanes``).
"""

from functools import cache

import numpy as np
import warp as wp

from warp_bounding.kernels.distances import DistanceSource
from warp_bounding.kernels.functions import Words, lanes_of
from warp_bounding.kernels.source import Lanes, fill
from warp_bounding.newton.placing import IN_SUM, Extent, Placed
from warp_bounding.runtime.native import Numbers, literal, named, native_text, unique_name

text = native_text("cull.h")
SUM_ROUNDING = wp.constant(IN_SUM)

CPU_BLOCK = 1024  # pairs that one thread of a kernel goes through on a CPU


@wp.kernel(enable_backward=False)
def split_balls(
    # inputs
    first: int,
    points: wp.array(dtype=wp.vec3),
    radii: wp.array(dtype=float),
    count: int,
    # outputs
    rows: wp.array(dtype=float),
):
    """The balls' x, one after another, then all their y, z and radii: so that neighbours are read together."""
    p = first + wp.tid()
    q = points[p]
    for k in range(3):
        rows[k * count + p] = q[k]
    rows[3 * count + p] = radii[p]


@wp.kernel(enable_backward=False)
def gather_or_repeat(
    # inputs
    pairs: wp.array(dtype=wp.vec2i),
    indices: wp.array(dtype=wp.int32),
    count: wp.array(dtype=wp.int32),
    # outputs
    kept: wp.array(dtype=wp.vec2i),
):
    """The pairs that are left, in their order; and behind them, up to the number of all pairs, one that was denied.

    The pass makes no contact of it, however often it comes. It is the first one: indices ascend, so that it is where
    they run ahead of their own places.
    """
    i = wp.tid()
    left = count[0]
    if i < left:
        kept[i] = pairs[indices[i]]
    else:
        denied, most = wp.int32(0), int(left)
        while denied < most:
            middle = (denied + most) // 2
            if indices[middle] == middle:
                denied = middle + 1
            else:
                most = middle
        kept[i] = pairs[denied]


# --- Hulls ------------------------------------------------------------------------------------------------------------
#
# Which pairs need no bounder: the particle lies outside the ball or the box around the shape (``placing.Extent``).
#
# Newton lists its pairs shape by shape, and of each shape particle by particle. So ``PAIRS_AT_ONCE`` pairs in a row are
# nearly always one shape and particles that follow each other, and are decided together; where they are not, it is one
# pair at a time, by the same operations.

PAIRS_AT_ONCE = 16  # pairs that are decided together; divides ``kernels.CPU_BLOCK``


@named("wb_ask_hulls").block_kernel(fill(text.HULLS, lanes=PAIRS_AT_ONCE, one=text.ONE_PAIR))
def query_hulls(
    pairs: wp.array(dtype=wp.vec2i),
    count: int,
    size: int,
    block: int,
    runs: wp.array(dtype=wp.bool),
    rows: wp.array(dtype=float),
    hulls: wp.array(dtype=Extent),
    asked: wp.array(dtype=wp.int32),
    left: wp.array(dtype=wp.int32),
    keep: wp.array(dtype=wp.bool),
):
    """Decide the pairs of each block that need no bounder, and list the others in ``asked``, block by block."""


def runs_of(pairs: np.ndarray) -> np.ndarray:
    """Which ``LANES`` of the pairs ``(N, 2)`` in a row are of one shape and particles that follow each other.

    ``(N // LANES,)`` bool, one at least.
    """
    rows = pairs[: len(pairs) // PAIRS_AT_ONCE * PAIRS_AT_ONCE].reshape(-1, PAIRS_AT_ONCE, 2)
    same = (np.diff(rows, axis=1) == (1, 0)).all(axis=(1, 2))
    return same if len(same) else np.zeros(1, bool)


# --- Distances, many at a time ----------------------------------------------------------------------------------------
#
# Asking a bounder of distances about the pairs that ``query_hulls`` has listed, on a CPU: one pair in each lane of a
# vector.
#
# Few pairs of a block are listed, so a thread goes through ``BLOCKS`` blocks, and asks whenever its lanes are full.
# What it asks, and how that rounds, is what ``lists.query_listed`` does for one pair, on CUDA.

BLOCKS = 16  # blocks of pairs that a thread of the kernel goes through


@cache
def query_distances_in_lanes(source: DistanceSource) -> wp.Kernel:
    """The kernel of a bounder of this source; see module, and ``lists.query_listed``."""
    texts = source.around(placed=False, values=True) | {
        "lanes": lanes_of(source),
        "body": source.body(Lanes(vector=True)),
        "rounding": literal(IN_SUM),
        "blocks": BLOCKS,
    }

    @named(unique_name(source, "newton_lanes")).block_kernel(fill(text.DISTANCES, **texts))
    def ask(
        parameters: Numbers,
        count: int,
        size: int,
        block: int,
        words: Words,
        number: int,
        dilated: float,
        numbers: wp.array(dtype=wp.int32),
        pairs: wp.array(dtype=wp.vec2i),
        rows: wp.array(dtype=float),
        placed: wp.array(dtype=Placed),
        hulls: wp.array(dtype=Extent),
        asked: wp.array(dtype=wp.int32),
        left: wp.array(dtype=wp.int32),
        keep: wp.array(dtype=wp.bool),
    ): ...

    return ask
