"""Depth-first search over charted boxes: it proves ``f >= target``, or the highest target that time allows.

A box is *closed* when it is not halved any more: because its bound reaches the target (``CLOSE_ALL``, minus infinity,
is reached by any), or because it is too narrow to be halved. It is never opened again. The target is proven when no box
waits and the least bound of a closed box reaches it.

Which boxes must be halved depends on the target alone, not on the order, so a depth-first search with a few boxes a
thread does the same work as one that keeps them all in order, and needs no memory. The initial boxes come in random
order, so that the share of them that is done tells early what the rest will take. A search for the minimum goes for the
best target; where that is expected to take too long, it goes on with a lower one. No target above the least bound of a
closed box can be proven any more, so it is lowered to that bound too (``Pace.reach``), which is what is proven in the
end.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import warp as wp

from warp_bounding.networks.bounds import BoxBounds, Chart, bound_boxes, double_array
from warp_bounding.networks.network import Network
from warp_bounding.proof.search.best_first import Search, lowest
from warp_bounding.proof.search.depth_first_kernel import KEPT, STACK, depth_first_kernel
from warp_bounding.proof.search.pace import Pace
from warp_bounding.runtime.launch import launch_blocks, working_seconds

__all__ = ["ChartedPositives", "Descent", "charted_minimum", "divided", "prove_target"]

CPU_BLOCKS, CUDA_BLOCKS = 64, 2048  # blocks of a launch, each with a stack of its own
MOST = 1024  # boxes that a block bounds before it returns: some 50 ms a launch
HANDED_OUT = 64  # boxes that an idle block is given at a time
# Initial boxes of a search: INITIAL_SHARE of those that there is time for, but within these numbers. With fewer, the
# share that is done would not tell what the rest will take.
INITIAL, MOST_INITIAL = 4096, 131_072
INITIAL_SHARE = 0.02
CLOSE_ALL = -np.inf  # as a target: every box that waits is bounded once and closed
STATE = 3  # arrays of the blocks' state: stacks, heights, and how many boxes of each are initial ones


@dataclass(frozen=True)
class ChartedPositives:
    """The positives of an object as boxes of a chart's numbers z, and the network whose f is bounded over them."""

    network: Network  # of f
    chart: Chart  # how numbers z become a query
    lower: np.ndarray  # ``(N, Z)`` float64, corners of boxes that cover all positives, with what the pipeline rounds
    upper: np.ndarray  # ``(N, Z)`` float64
    numbers: np.ndarray  # float64 parameters of the chart
    limit: np.ndarray  # ``(K,)``, largest inputs of the network that boxes reach, noise included
    table: np.ndarray = field(default_factory=lambda: np.zeros(1, np.int32))  # int32 parameters of the chart
    terms: np.ndarray | None = None  # ``(K,)``, of the sum of an input's absolute terms over a box; ``None``: limit

    def bound(self, lower: np.ndarray, upper: np.ndarray, device="cpu") -> BoxBounds:
        """Certified bounds over boxes of z."""
        shape, padding = self.network.kernel_shape(self.chart), self.padding
        return bound_boxes(shape, self.network.packed, padding, lower, upper, self.numbers, self.table, device)

    @property
    def padding(self) -> np.ndarray:
        """What float64 rounds in bounds over boxes, layer by layer."""
        return self.network.padding_for(self.limit, self.terms)

    def coordinates(self, z: np.ndarray) -> np.ndarray:
        """Coordinates ``v`` of a query for numbers of the chart."""
        return self.chart.coordinates(z, self.numbers)


class Descent:
    """Boxes that wait, in a reserve and on the stacks of the kernel's blocks, and what was found on the way.

    Attributes:
        boxes: Number of boxes that were bounded.
        initial_count: Number of initial boxes.
        least: Least bound of a closed box.
        begun: Fraction of the initial boxes that are done or begun.
        stuck: Whether the last step could not do anything, because every stack is full.
        points: ``(K, Z)``, the lowest positives found, numbers of the chart, lowest first.
        values: ``(K,)``, f there.
    """

    def __init__(self, cover: ChartedPositives, device: str):
        dev = wp.get_device(device)
        self._kernel, self._device = depth_first_kernel(cover.network.kernel_shape(cover.chart)), dev
        blocks, size = CPU_BLOCKS if dev.is_cpu else CUDA_BLOCKS, cover.chart.size
        self._stacks = np.empty((blocks, STACK, 2, size))
        self._heights, self._initial = np.zeros(blocks, np.int32), np.zeros(blocks, np.int32)
        self._done, self._closed = np.zeros(blocks, np.int64), np.full(blocks, np.inf)
        self._values, self._points = np.full((blocks, KEPT), np.inf), np.zeros((blocks, KEPT, size))
        order = np.random.default_rng(0).permutation(len(cover.lower))
        self._reserve, self._left = np.stack([cover.lower, cover.upper], axis=1)[order], len(order)
        held = [cover.network.packed, cover.padding, cover.numbers]
        self._parameters_host = [np.ascontiguousarray(a, dtype=np.float64) for a in held]
        self._parameters = [double_array(a, dev) for a in self._parameters_host]
        self._parameters.append(wp.array(cover.table, dtype=wp.int32, device=dev))
        # What the kernel changes; the first STATE arrays are also what it starts from. On a CPU the Warp arrays share
        # their memory; on CUDA those are copied before each launch, and all of them after it.
        self._outputs_host = [self._stacks, self._heights, self._initial]
        self._outputs_host += [self._done, self._closed, self._values, self._points]
        kinds = [wp.float64, wp.int32, wp.int32, wp.int64, *[wp.float64] * 3]
        self._outputs = [
            wp.array(a.reshape(-1), dtype=t, device=dev, copy=not dev.is_cpu)
            for a, t in zip(self._outputs_host, kinds, strict=True)
        ]
        self.points, self.values = np.empty((0, size)), np.empty(0)
        self.boxes, self.initial_count, self.least, self.begun, self.stuck = 0, len(order), np.inf, 0.0, False
        self._target = CLOSE_ALL

    @property
    def waiting(self) -> bool:
        """Whether any box is not closed."""
        return bool(self._left or self._heights.any())

    @property
    def complete(self) -> bool:
        """Whether the last target is proven: every box is closed and reaches it."""
        return not self.waiting and self.least >= self._target

    def step(self, target: float, boxes: float = float("inf")) -> float:
        """Let each block go on, for some 50 ms in all, and close the boxes that reach a target.

        Args:
            target: Value of f, or ``CLOSE_ALL``.
            boxes: About how many boxes to bound at most.

        Returns:
            The lowest value of f at a positive that this step has found.
        """
        self._target = float(target)
        self._left -= _fill(self._stacks, self._heights, self._initial, self._reserve[: self._left])
        most = int(min(MOST, max(boxes / len(self._heights), 1)))
        if not self._device.is_cpu:
            for array, values in zip(self._outputs[:STATE], self._outputs_host[:STATE], strict=True):
                array.assign(values.reshape(-1))
        inputs = [0, self._target, most, *self._parameters]
        launch_blocks(self._kernel, len(self._heights), inputs, self._outputs, self._device, first_index=0, block=1)
        if not self._device.is_cpu:
            for array, values in zip(self._outputs, self._outputs_host, strict=True):
                values[...] = array.numpy().reshape(values.shape)
        self.boxes, self.least = self.boxes + int(self._done.sum()), min(self.least, float(self._closed.min()))
        self.begun = 1 - (self._left + int(self._initial.sum())) / len(self._reserve)
        self.stuck = not self._done.any()
        seen = np.isfinite(self._values)
        self.points, self.values = lowest(self.points, self.values, self._points[seen], self._values[seen])
        return float(self._values.min())


def prove_target(
    cover: ChartedPositives, target: float, *, boxes: float = float("inf"), device: str = "cpu"
) -> Descent:
    """Try to prove ``f >= target`` for all positives; ends early where a positive lies under the target.

    Args:
        cover: The positives.
        target: Value of f, or ``CLOSE_ALL``.
        boxes: Limit: the number of boxes after which the search ends.
        device: Warp device.
    """
    descent = Descent(cover, device)
    while descent.waiting:
        found = descent.step(target, boxes - descent.boxes)
        if descent.boxes >= boxes or descent.stuck or min(found, descent.least) < target:
            break
    return descent


def _fill(stacks: np.ndarray, heights: np.ndarray, initial: np.ndarray, reserve: np.ndarray) -> int:
    """Give empty blocks boxes of the reserve's end, or else the bottom half of the fullest stack, its largest boxes.

    So many boxes as ``initial`` says, at the bottom of each stack ``(STACK, 2, Z)``, are initial ones, which nobody has
    halved yet. Returns how many boxes were taken from the reserve ``(N, 2, Z)``, the initial boxes that no block has
    taken.
    """
    taken, empty = 0, np.flatnonzero(heights == 0)
    for place, block in enumerate(empty):
        left = len(reserve) - taken
        if left:
            count = min(HANDED_OUT, -(-left // (len(empty) - place)))
            stacks[block, :count] = reserve[left - count : left]
            heights[block] = initial[block] = count
            taken += count
            continue
        donor = int(np.argmax(heights))
        if heights[donor] < 2:
            break
        count = heights[donor] // 2
        stacks[block, :count] = stacks[donor, :count]
        stacks[donor, : heights[donor] - count] = stacks[donor, count : heights[donor]].copy()
        heights[block], heights[donor] = count, heights[donor] - count
        initial[block] = min(initial[donor], count)
        initial[donor] -= initial[block]
    return taken


def charted_minimum(
    cover: ChartedPositives,
    *,
    eps: float,
    upper: float = float("inf"),
    seconds: float = float("inf"),
    boxes: float = float("inf"),
    progress: Callable[[int, float, float], None] | None = None,
    device: str = "cpu",
) -> Search:
    """Certified minimum of f over charted positives.

    Args:
        cover: The positives.
        eps: Gap between bound and found value at which the search ends.
        upper: A value of f that is not below the minimum, such as f of a positive that is known.
        seconds: Time after which the search ends with what it has. Compiling the kernels of a network's shape does not
            count.
        boxes: Limit: the number of boxes after which it ends with what it has, the same on every machine.
        progress: Called with boxes done, the fraction of the initial boxes that are done or begun, and the gap that is
            aimed at.
        device: Warp device.
    """
    started = working_seconds()
    cover = divided(cover, INITIAL, device)
    # Each initial box is bounded once: that tells how many there is time for, and finds low positives to begin with.
    survey = prove_target(cover, CLOSE_ALL, device=device)
    affordable = min(boxes, seconds * survey.boxes / (working_seconds() - started))
    initial = min(INITIAL_SHARE * affordable, MOST_INITIAL) if np.isfinite(affordable) else INITIAL
    descent = Descent(divided(cover, initial, device), device)  # no fewer boxes than there are by now
    best = min(upper, float(survey.values.min(initial=np.inf)))

    def done() -> int:
        return survey.boxes + descent.boxes

    def used() -> float:
        spent = working_seconds() - started
        return max(done() / boxes, spent / seconds) if min(boxes, seconds) > 0 else 1.0

    pace = Pace(eps, used())
    while descent.waiting:
        pace.update(used(), descent.begun, descent.boxes, descent.initial_count)
        target = best - pace.gap if used() < 1 else CLOSE_ALL
        best = min(best, descent.step(target, boxes - done()))
        pace.reach(best - descent.least)  # a closed box is not opened again, so no smaller gap can be proven
        if descent.stuck:
            pace.widen()
        if progress:
            progress(done(), descent.begun, pace.gap)
    # Survey and search each cover all positives, so both least bounds hold and the higher one counts. Neither can
    # exceed a value that was found.
    proven, spent = min(max(survey.least, descent.least), best), working_seconds() - started
    numbers = lowest(survey.points, survey.values, descent.points, descent.values)[0]
    needed = max(pace.whole * seconds, spent) if pace.whole else spent
    return Search(proven, best, cover.coordinates(numbers), done(), spent, best - proven <= eps, needed, numbers)


def divided(cover: ChartedPositives, count: float, device: str) -> ChartedPositives:
    """The same positives in at least ``count`` boxes, where halving them makes so many; halves without one are left out."""
    lower, upper = cover.lower, cover.upper
    for _ in range(2 * MOST_INITIAL.bit_length()):  # halves without positives do not count
        if len(lower) >= count:
            break
        bounds = cover.bound(lower, upper, device)
        some = ~np.isposinf(bounds.lower)  # infinity is the bound of a box without positives
        boxes, axis, row = bounds.boxes[some], bounds.axis[some], np.arange(np.count_nonzero(some))
        (lower, upper), middle = boxes.swapaxes(0, 1), cover.chart.middle(boxes[row, 0, axis], boxes[row, 1, axis])
        less, more = upper.copy(), lower.copy()
        less[row, axis] = more[row, axis] = middle
        lower, upper = np.concatenate([lower, more]), np.concatenate([less, upper])
    return replace(cover, lower=lower, upper=upper)
