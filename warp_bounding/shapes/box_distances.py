"""How far are points from a union of closed boxes, in any dimension? Certified bounds from both sides.

A hierarchy of boxes around the boxes (``triangles/hierarchy.py``) is walked nearer child first. Where coordinate 0 is
time, only boxes that exist at a point's time count, and the distance is that in space.
"""

from collections.abc import Sequence
from functools import cache

import numpy as np
import warp as wp

from warp_bounding.rounding import UNIT64, round_down, round_up
from warp_bounding.runtime.launch import launch_on_cores
from warp_bounding.shapes.triangles.distances import SHORTEST, SUM_ROUNDING
from warp_bounding.shapes.triangles.hierarchy import nodes_of, sorted_order

DEEPEST = 32  # levels of a hierarchy: there are never more than 2^31 boxes
SHORTER = 1.0 - 2.0**-48  # outweighs what a sum of some 16 squares and its root round
LONGER = 1.0 + 2.0**-48
CORNER_ROUNDING = 8 * UNIT64  # relative to the largest coordinate: of corners that are given after a sum and a quotient


class Asked:
    """What kernels answer of an object that they are ``given`` as a struct or arrays; each gets its own numbers, too.

    Attributes:
        point: Warp's type of a point.
        corners: Warp's type of a function's numbers at the corners of a box.
        overestimates: The kernel for ``overestimate``.
        sizes: Of the object, which this kernel takes last.
    """

    point: type
    corners: type
    overestimates: wp.Kernel
    sizes: Sequence = ()

    def __init__(self, given: Sequence):
        self._given = given

    def overestimate(
        self, lower: np.ndarray, upper: np.ndarray, values: np.ndarray, least: float, enough: np.ndarray | float
    ) -> np.ndarray:
        """See ``Shape.overestimate``."""
        numbers = wp.array(np.ascontiguousarray(values, dtype=np.float64), dtype=self.corners, device="cpu")
        bars = wp.array(np.broadcast_to(enough, len(values)).astype(np.float64), dtype=wp.float64, device="cpu")
        more = [numbers, wp.float64(least), bars, *self.sizes]
        return self._answer(self.overestimates, lower, upper, dtype=wp.float64, more=more)

    def _answer(self, kernel: wp.Kernel, *queries: np.ndarray, dtype: type = wp.uint8, more: Sequence = ()):
        """``(N,)``, a kernel's answers to queries ``(N, n)``, and ``more`` inputs; of a type of vectors, ``(N, k)``."""
        rows = [np.ascontiguousarray(q, dtype=np.float64) for q in queries]
        shape = len(rows[0]), *getattr(dtype, "_shape_", ())
        out = np.empty(shape, dtype=wp.dtype_to_numpy(getattr(dtype, "_wp_scalar_type_", dtype)))
        if len(out):
            self._launch(kernel, rows, [wp.array(out, dtype=dtype, device="cpu", copy=False)], more)
        return out

    def _launch(self, kernel: wp.Kernel, rows: list[np.ndarray], outputs: list[wp.array], more: Sequence = ()) -> None:
        self._know(rows[0], rows[-1])
        inputs = [*self._given, *(wp.array(q, dtype=self.point, device="cpu", copy=False) for q in rows), *more]
        launch_on_cores(kernel, len(rows[0]), inputs, outputs, "cpu")

    def _know(self, lower: np.ndarray, upper: np.ndarray) -> None:
        """Make what is needed for queries, points or boxes ``(N, n)``; here all of it is there."""


class BoxDistances(Asked):
    """Closed boxes, ready to be queried; for ``overestimate`` all of them are there, whatever coordinate 0 is.

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
        given = (lower, vector), (upper, vector), (low, narrow), (high, narrow), (links, wp.vec3i)
        super().__init__([wp.array(values, dtype=dtype, device="cpu") for values, dtype in given])
        self.point, self.corners, self._n = vector, wp.types.vector(2**n, wp.float64), n
        self.sizes = [wp.float64(np.abs(lower).max() + np.abs(upper).max())]

    @property
    def overestimates(self) -> wp.Kernel:
        return _overestimates(self._n)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """``(N, 2)`` float64: lower and upper bounds of the distance from points ``(N, n)``.

        They are 0 and infinity for NaN and infinity, and both infinite where no box exists at a point's time.
        """
        found = self._answer(_kernel(self._n, self.time), x, dtype=wp.float64)
        known = np.isfinite(x).all(axis=1)
        low, high = np.maximum(found * SHORTER - self._slack, 0.0), found * LONGER + self._slack
        return np.stack([np.where(known, low, 0.0), np.where(known, high, np.inf)], axis=1)


@cache
def _wide(n: int) -> wp.Function:
    """The same n numbers in float64."""
    vector, narrow = wp.types.vector(n, wp.float64), wp.types.vector(n, wp.float32)

    @wp.func
    def wide(x: narrow) -> vector:
        y = vector()
        for k in range(n):
            y[k] = wp.float64(x[k])
        return y

    return wide


@cache
def _kernel(n: int, time: bool) -> wp.Kernel:
    vector, narrow, first_axis = wp.types.vector(n, wp.float64), wp.types.vector(n, wp.float32), int(time)
    wide = _wide(n)
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
        i, _ = wp.tid()
        i += first
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


# --- Overestimates ----------------------------------------------------------------------------------------------------
#
# By how much can a function exceed the distance to a union of boxes, in a box? See ``triangles/distances.py``, whose
# argument this is, in any dimension.
#
# Here the pieces are solid, so that there is no side to ask for. The distance to a piece is at least ``m (n . x - h)``
# for any unit vector n, with h the piece's support along n, and any m from 0 to 1, since it is at least 0: so a box may
# reach into the piece, where the distance has a bend and a smooth function goes through with a slope between both.
# Taken are m = 1 and the function's own slope along n; n leads from the piece's nearest point to the centre of the box,
# or out of the piece's nearest face where the centre lies in it.


@cache
def _overestimates(n: int) -> wp.Kernel:
    """The kernel of overestimates over box distances in n dimensions."""
    vector, narrow = wp.types.vector(n, wp.float64), wp.types.vector(n, wp.float32)
    stack_of, corners, count = wp.types.vector(DEEPEST, wp.int32), wp.types.vector(2**n, wp.float64), 2**n
    wide = _wide(n)

    @wp.func
    def number(low: vector, high: vector, centre: vector, half: vector, values: corners, room: wp.float64):
        """The least bound of the values less multiples of the plane under the distance; the distance at the centre."""
        normal, length, support = vector(), wp.float64(0.0), wp.float64(0.0)
        for k in range(n):
            normal[k] = -wp.max(low[k] - centre[k], wp.min(high[k] - centre[k], wp.float64(0.0)))
            length += normal[k] * normal[k]
        length = wp.sqrt(length)
        if length > wp.float64(SHORTEST):
            for k in range(n):
                normal[k] = normal[k] / length
                support += wp.max(normal[k] * (low[k] - centre[k]), normal[k] * (high[k] - centre[k]))
        else:  # the plane of the face that is nearest
            nearest, side = wp.int32(0), wp.float64(1.0)
            support = wp.float64(wp.inf)
            for k in range(n):
                normal[k] = wp.float64(0.0)
                if high[k] - centre[k] < support:
                    nearest, side, support = k, wp.float64(1.0), high[k] - centre[k]
                if centre[k] - low[k] < support:
                    nearest, side, support = k, wp.float64(-1.0), centre[k] - low[k]
            normal[nearest] = side
        rise, run = wp.float64(0.0), wp.float64(0.0)
        for i in range(count):
            along = wp.float64(0.0)
            for k in range(n):
                along += wp.where((i >> k) & 1, half[k], -half[k]) * normal[k]
            rise += values[i] * along
            run += along * along
        share = wp.float64(1.0)
        if run > wp.float64(0.0):
            share = wp.clamp(rise / run, wp.float64(0.0), wp.float64(1.0))
        whole, part = -wp.float64(wp.inf), -wp.float64(wp.inf)
        for i in range(count):
            along = wp.float64(0.0)
            for k in range(n):
                along += wp.where((i >> k) & 1, half[k], -half[k]) * normal[k]
            whole = wp.max(whole, values[i] - along)
            part = wp.max(part, values[i] - share * along)
        return wp.min(whole + support, part + share * support) + room, length

    @wp.kernel(enable_backward=False, module="unique")
    def find(
        first: int,
        # inputs
        lower: wp.array(dtype=vector),
        upper: wp.array(dtype=vector),
        node_lower: wp.array(dtype=narrow),
        node_upper: wp.array(dtype=narrow),
        links: wp.array(dtype=wp.vec3i),
        box_lower: wp.array(dtype=vector),
        box_upper: wp.array(dtype=vector),
        values: wp.array(dtype=corners),
        least: wp.float64,
        enough: wp.array(dtype=wp.float64),
        slack: wp.float64,
        # outputs
        overestimate: wp.array(dtype=wp.float64),
    ):
        item, _ = wp.tid()
        item += first
        low, high, f = box_lower[item], box_upper[item], values[item]
        centre, half, size = vector(), vector(), slack
        for k in range(n):
            centre[k] = low[k] * wp.float64(0.5) + high[k] * wp.float64(0.5)
            half[k] = wp.max(high[k] - centre[k], centre[k] - low[k])
            size += wp.abs(centre[k]) + half[k]
        highest = f[0]
        for i in range(count):
            highest = wp.max(highest, f[i])
            size = wp.max(size, wp.abs(f[i]))
        room = size * wp.float64(SUM_ROUNDING)
        known = wp.min(least, highest)
        stack, depth, node = stack_of(), wp.int32(0), wp.int32(0)
        while node >= 0 and known < highest and known <= enough[item]:
            own, _at = number(wide(node_lower[node]), wide(node_upper[node]), centre, half, f, room)
            while own > known and links[node][1] == 0:
                near = node + 1
                other = links[near][2]
                near_own, near_at = number(wide(node_lower[near]), wide(node_upper[near]), centre, half, f, room)
                other_own, other_at = number(wide(node_lower[other]), wide(node_upper[other]), centre, half, f, room)
                swap = other_at < near_at
                node = wp.where(swap, other, near)
                own = wp.where(swap, other_own, near_own)
                if wp.where(swap, near_own, other_own) > known:
                    stack[depth] = wp.where(swap, near, other)
                    depth += 1
            if own > known:
                for box in range(links[node][0], links[node][1]):
                    reported, _away = number(lower[box], upper[box], centre, half, f, room)
                    known = wp.max(known, wp.min(highest, reported))
            node = wp.int32(-1)
            if depth > 0:
                depth -= 1
                node = stack[depth]
        if known > enough[item]:
            known = highest  # the walk has not seen all pieces
        overestimate[item] = wp.max(known, least)

    return find
