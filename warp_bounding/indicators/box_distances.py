"""How far are points from a union of closed boxes, in any dimension? Certified bounds from both sides.

A hierarchy of boxes around the boxes (``triangles/hierarchy.py``) is walked nearer child first. Where coordinate 0 is time,
only boxes that exist at a point's time count, and the distance is that in space.
"""

from functools import cache

import numpy as np
import warp as wp

from warp_bounding.arithmetic import UNIT64, round_down, round_up
from warp_bounding.indicators.box_excess import excess_kernel
from warp_bounding.indicators.triangles.hierarchy import nodes_of, sorted_order
from warp_bounding.runtime.launch import launch_on_cores

__all__ = ["BoxDistances"]

DEEPEST = 32  # levels of a hierarchy: there are never more than 2^31 boxes
SHORTER = 1.0 - 2.0**-48  # outweighs what a sum of some 16 squares and its root round
LONGER = 1.0 + 2.0**-48
CORNER_ROUNDING = 8 * UNIT64  # relative to the largest coordinate: of corners that are given after a sum and a quotient


class BoxDistances:
    """Closed boxes, ready to be asked.

    Args:
        lower: ``(M, n)`` float64, lower corners.
        upper: ``(M, n)`` float64, upper corners.
        time: Coordinate 0 is time.
    """

    def __init__(self, lower: np.ndarray, upper: np.ndarray, *, time: bool = False):
        self.time, n = time, lower.shape[1]
        order = sorted_order(((lower + upper) / 2)[:, int(time) :])
        lower, upper = lower[order], upper[order]
        low, high, links = nodes_of(round_down(lower), round_up(upper))
        self._slack = CORNER_ROUNDING * max(np.abs(lower).max(), np.abs(upper).max())
        vector, narrow = wp.types.vector(n, wp.float64), wp.types.vector(n, wp.float32)
        self._inputs = [
            wp.array(values, dtype=dtype, device="cpu")
            for values, dtype in (
                (lower, vector),
                (upper, vector),
                (low, narrow),
                (high, narrow),
                (links, wp.vec3i),
            )
        ]
        self._vector, self._n = vector, n
        self._size = float(np.abs(lower).max() + np.abs(upper).max())

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """``(N, 2)`` float64: lower and upper bounds of the distance from points ``(N, n)``.

        They are 0 and infinity for NaN and infinity, and both infinite where no box exists at a point's time.
        """
        x = np.ascontiguousarray(x, dtype=np.float64)
        found = np.empty(len(x))
        if len(x):
            inputs = [*self._inputs, wp.array(x, dtype=self._vector, device="cpu", copy=False)]
            kernel, out = _kernel(self._n, self.time), wp.array(found, dtype=wp.float64, device="cpu", copy=False)
            launch_on_cores(kernel, len(x), inputs, [out], "cpu")
        known = np.isfinite(x).all(axis=1)
        low, high = np.maximum(found * SHORTER - self._slack, 0.0), found * LONGER + self._slack
        return np.stack([np.where(known, low, 0.0), np.where(known, high, np.inf)], axis=1)

    def excess(
        self, lower: np.ndarray, upper: np.ndarray, values: np.ndarray, least: float, enough: np.ndarray | float
    ) -> np.ndarray:
        """See ``Shape.excess``; boxes are all of them there, whatever coordinate 0 is."""
        out = np.empty(len(lower))
        if len(out):
            boxes = [
                wp.array(np.ascontiguousarray(side, dtype=np.float64), dtype=self._vector, device="cpu")
                for side in (lower, upper)
            ]
            corners = wp.types.vector(2**self._n, wp.float64)
            held = wp.array(np.ascontiguousarray(values, dtype=np.float64), dtype=corners, device="cpu")
            ends = wp.array(np.broadcast_to(enough, len(out)).astype(np.float64), dtype=wp.float64, device="cpu")
            inputs = [*self._inputs, wp.float64(self._size), *boxes, held, wp.float64(least), ends]
            made = wp.array(out, dtype=wp.float64, device="cpu", copy=False)
            launch_on_cores(excess_kernel(self._n), len(out), inputs, [made], "cpu")
        return out


@cache
def _kernel(n: int, time: bool) -> wp.Kernel:
    vector, narrow, first_axis = wp.types.vector(n, wp.float64), wp.types.vector(n, wp.float32), int(time)
    stack_of = wp.types.vector(DEEPEST, wp.int32)

    @wp.func
    def gap(lower: vector, upper: vector, x: vector) -> wp.float64:
        """The squared distance of a box in space; infinite at times at which it is not there."""
        total = wp.float64(0.0)
        for k in range(n):
            away = wp.max(wp.max(lower[k] - x[k], x[k] - upper[k]), wp.float64(0.0))
            if k < first_axis:
                if away > wp.float64(0.0):
                    total = wp.float64(wp.inf)
            else:
                total += away * away
        return total

    @wp.func
    def wide(x: narrow) -> vector:
        y = vector()
        for k in range(n):
            y[k] = wp.float64(x[k])
        return y

    @wp.kernel(enable_backward=False, module="unique")
    def find(
        first: int,
        # inputs
        lower: wp.array(dtype=vector),
        upper: wp.array(dtype=vector),
        node_lower: wp.array(dtype=narrow),
        node_upper: wp.array(dtype=narrow),
        links: wp.array(dtype=wp.vec3i),
        x: wp.array(dtype=vector),
        # outputs
        distance: wp.array(dtype=wp.float64),
    ):
        i = first + wp.tid()
        p, found = x[i], wp.float64(wp.inf)
        stack, depth, node = stack_of(), wp.int32(0), wp.int32(0)
        while node >= 0:
            near_gap = gap(wide(node_lower[node]), wide(node_upper[node]), p)
            while near_gap < found and links[node][1] == 0:
                left = node + 1
                right = links[left][2]
                left_gap = gap(wide(node_lower[left]), wide(node_upper[left]), p)
                right_gap = gap(wide(node_lower[right]), wide(node_upper[right]), p)
                node = wp.where(right_gap < left_gap, right, left)
                stack[depth] = wp.where(right_gap < left_gap, left, right)
                depth += 1
                near_gap = wp.min(left_gap, right_gap)
            if near_gap < found:
                for box in range(links[node][0], links[node][1]):
                    found = wp.min(found, gap(lower[box], upper[box], p))
            node = wp.int32(-1)
            if depth > 0:
                depth -= 1
                node = stack[depth]
        distance[i] = wp.sqrt(found)

    return find
