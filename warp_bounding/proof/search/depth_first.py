"""Proving ``f >= target`` over charted boxes by depth-first search, and the highest target that can be had in some time.

Which boxes must be halved depends on the target alone, not on the order, so a depth-first search with a few boxes a
thread does the same work as one that keeps them all in order, and needs no memory. The first boxes come in random
order, so that the share of them that is done tells early what the rest will take. A search for the minimum goes for the
best target; where that is expected to take too long, it goes on with a lower one, which all boxes that are closed
already reach. The least bound of a closed box is what is proven in the end.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import warp as wp

from warp_bounding.networks.bound_kernel import bound_boxes, double_array
from warp_bounding.networks.box_bounds import BoxBounds
from warp_bounding.networks.charts.base import Chart
from warp_bounding.networks.network import Network
from warp_bounding.proof.search.best_first import WORST, Search
from warp_bounding.proof.search.depth_first_kernel import KEPT, STACK, depth_first_kernel
from warp_bounding.proof.search.pace import Pace
from warp_bounding.runtime.launch import launch_blocks, working_seconds

__all__ = ["Charted", "Cleared", "charted_minimum", "clear"]

CPU_BLOCKS, CUDA_BLOCKS = 64, 2048
MOST = 1024  # boxes that a block bounds before it returns: some 50 ms a launch
SHARE = 64  # boxes that a block is given at a time
FIRST, MOST_FIRST = 4096, 131_072  # boxes that a search begins with, or their shares would tell nothing:
FIRST_SHARE = 0.02  # of those that there is time for
Progress = Callable[[int, float, float], bool | None]


@dataclass(frozen=True)
class Charted:
    """Positives of a network as boxes of a chart.

    Attributes:
        network: Whose f.
        chart: What z means.
        lower: ``(N, Z)`` float64, lower corners of boxes that cover all positives.
        upper: ``(N, Z)`` float64.
        numbers: float64 parameters of the chart.
        limit: ``(K,)``, largest inputs of the network that boxes reach, noise included.
        table: int32 parameters of the chart.
    """

    network: Network
    chart: Chart
    lower: np.ndarray
    upper: np.ndarray
    numbers: np.ndarray
    limit: np.ndarray
    table: np.ndarray = field(default_factory=lambda: np.zeros(1, np.int32))

    def bound(self, lower: np.ndarray, upper: np.ndarray, device="cpu") -> BoxBounds:
        """Certified bounds over boxes of z."""
        return bound_boxes(
            self.network.sizes(self.chart),
            self.network.packed,
            self.network.padding_for(self.limit),
            lower,
            upper,
            self.numbers,
            self.table,
            device,
        )

    def coordinates(self, z: np.ndarray) -> np.ndarray:
        """Coordinates ``v`` of a query for numbers of the chart."""
        return self.chart.coordinates(z, self.numbers)


@dataclass(frozen=True)
class Cleared:
    """What a search for ``f >= target`` found.

    Attributes:
        complete: Every box is closed and reaches the target.
        least: Least bound of a closed box.
        boxes: Boxes bounded.
        share: Of the first boxes, that are done or begun, not those that wait.
        points: ``(K, Z)`` low positives.
        values: ``(K,)`` f there.
    """

    complete: bool
    least: float
    boxes: int
    share: float
    points: np.ndarray
    values: np.ndarray


def clear(
    cover: Charted,
    target: float,
    *,
    seconds: float = float("inf"),
    boxes: float = float("inf"),
    progress: Progress | None = None,
    device: str = "cpu",
) -> Cleared:
    """Try to prove ``f >= target`` for all positives; ends early where a positive lies under the target.

    Args:
        cover: The positives.
        target: In f.
        seconds: Time limit.
        boxes: Limit of boxes.
        progress: Called with boxes bounded, the share of the first boxes that is done, and the target; ends the search
            with True.
        device: Warp device.
    """
    started, descent = working_seconds(), _Descent(cover, device)
    while descent.waiting:
        lowest = descent.step(target, boxes - descent.boxes)
        stopped = progress is not None and progress(descent.boxes, descent.share, target)
        late = descent.boxes >= boxes or working_seconds() - started > seconds
        if stopped or late or descent.stuck or min(lowest, descent.least) < target:
            break
    complete = not descent.waiting and descent.least >= target
    return Cleared(complete, descent.least, descent.boxes, descent.share, *descent.lowest())


class _Descent:
    """Boxes that wait, in a reserve and on the stacks of the kernel's blocks.

    Args:
        cover: The positives.
        device: Warp device.

    Attributes:
        boxes: Boxes bounded.
        count: First boxes.
        least: Least bound of a closed box.
        share: Of the first boxes, that are done or begun.
        stuck: Whether the last step could not do anything: every stack is full.
    """

    def __init__(self, cover: Charted, device: str):
        dev = wp.get_device(device)
        self._kernel, self._device = depth_first_kernel(cover.network.sizes(cover.chart)), dev
        blocks, size = CPU_BLOCKS if dev.is_cpu else CUDA_BLOCKS, cover.chart.size
        self._stacks = np.empty((blocks, STACK, 2, size))
        self._heights, self._first = np.zeros(blocks, np.int32), np.zeros(blocks, np.int32)
        self._done, self._closed = np.zeros(blocks, np.int64), np.full(blocks, np.inf)
        self._values, self._points = np.full((blocks, KEPT), np.inf), np.zeros((blocks, KEPT, size))
        order = np.random.default_rng(0).permutation(len(cover.lower))
        self._reserve, self._left = np.stack([cover.lower, cover.upper], axis=1)[order], len(order)
        held = [np.ascontiguousarray(cover.network.packed), cover.network.padding_for(cover.limit), cover.numbers]
        self._held = [np.ascontiguousarray(a, dtype=np.float64) for a in held]
        self._fixed = [double_array(a, dev) for a in self._held]
        self._fixed.append(wp.array(cover.table, dtype=wp.int32, device=dev))
        self._host = [self._stacks, self._heights, self._first, self._done, self._closed, self._values, self._points]
        kinds = [wp.float64, wp.int32, wp.int32, wp.int64, *[wp.float64] * 3]
        self._shared = [
            wp.array(a.reshape(-1), dtype=t, device=dev, copy=not dev.is_cpu)
            for a, t in zip(self._host, kinds, strict=True)
        ]
        self._found = [(np.empty((0, size)), np.empty(0))]
        self.boxes, self.count, self.least, self.share, self.stuck = 0, len(order), np.inf, 0.0, False

    @property
    def waiting(self) -> bool:
        """Whether any box is open."""
        return bool(self._left or self._heights.any())

    def step(self, target: float, boxes: float = float("inf")) -> float:
        """Let each block go on for a while, some 50 ms in all, and close what reaches a target; at -infinity everything at once.

        Args:
            target: In f.
            boxes: About how many to bound at most.

        Returns:
            The lowest value of f at a positive that this step has found.
        """
        self._left -= _fill(self._stacks, self._heights, self._first, self._reserve[: self._left])
        most = int(min(MOST, max(boxes / len(self._heights), 1)))
        if not self._device.is_cpu:
            for array, values in zip(self._shared[:3], self._host[:3], strict=True):
                array.assign(values.reshape(-1))
        inputs = [0, float(target), most, *self._fixed]
        launch_blocks(self._kernel, len(self._heights), inputs, self._shared, self._device, first_index=0, block=1)
        if not self._device.is_cpu:
            for array, values in zip(self._shared, self._host, strict=True):
                values[...] = array.numpy().reshape(values.shape)
        self.boxes, self.least = self.boxes + int(self._done.sum()), min(self.least, float(self._closed.min()))
        self.share = 1 - (self._left + int(self._first.sum())) / len(self._reserve)
        self.stuck = not self._done.any()
        seen = np.isfinite(self._values)
        self._found.append((self._points[seen], self._values[seen]))
        if len(self._found) > 64:
            self._found = [_lowest(self._found)]
        return float(self._values.min())

    def lowest(self) -> tuple[np.ndarray, np.ndarray]:
        """The lowest positives found ``(K, Z)``, and f there."""
        return _lowest(self._found)


def _lowest(found: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """The lowest ``WORST`` points, lowest first."""
    points, values = (np.concatenate(part) for part in zip(*found, strict=True))
    order = np.argsort(values, kind="stable")[:WORST]
    return points[order], values[order]


def _fill(stacks: np.ndarray, heights: np.ndarray, first: np.ndarray, reserve: np.ndarray) -> int:
    """Give empty blocks boxes from the end of ``reserve``, or else half of another block's: its oldest, which are its largest.

    The lowest ``first`` boxes of each stack are such that come from the reserve.

    Returns:
        How many were taken from the reserve.
    """
    taken, empty = 0, np.flatnonzero(heights == 0)
    for place, block in enumerate(empty):
        left = len(reserve) - taken
        if left:
            share = min(SHARE, -(-left // (len(empty) - place)))
            stacks[block, :share] = reserve[left - share : left]
            heights[block] = first[block] = share
            taken += share
            continue
        donor = int(np.argmax(heights))
        if heights[donor] < 2:
            break
        share = heights[donor] // 2
        stacks[block, :share] = stacks[donor, :share]
        stacks[donor, : heights[donor] - share] = stacks[donor, share : heights[donor]].copy()
        heights[block], heights[donor] = share, heights[donor] - share
        first[block] = min(first[donor], share)
        first[donor] -= first[block]
    return taken


def charted_minimum(
    cover: Charted,
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
        upper: f of a positive that is known.
        seconds: Time after which the search ends with what it has; compiling kernels, once a shape of network, is not
            counted.
        boxes: Number of boxes after which it ends with what it has, the same on every machine.
        progress: Called with boxes done, the share of the first boxes that is done, and the gap that is aimed at.
        device: Warp device.

    Returns:
        See ``Search``; ``worst`` holds numbers of the chart.
    """
    started = working_seconds()
    cover = _divided(cover, FIRST, device)
    first = clear(cover, -np.inf, device=device)  # every box once
    affordable = min(boxes, seconds * first.boxes / (working_seconds() - started))
    many = min(FIRST_SHARE * affordable, MOST_FIRST) if np.isfinite(affordable) else FIRST
    descent = _Descent(_divided(cover, many, device), device)
    best = min(upper, float(first.values.min(initial=np.inf)))

    def done() -> int:
        return first.boxes + descent.boxes

    def used() -> float:
        spent = working_seconds() - started
        return max(done() / boxes, spent / seconds) if min(boxes, seconds) > 0 else 1.0

    pace = Pace(eps, used())
    while descent.waiting:
        pace.update(used(), descent.share, descent.boxes, descent.count)
        best = min(best, descent.step(best - pace.gap if used() < 1 else -np.inf, boxes - done()))
        pace.reach(best - descent.least)  # no more can be proven: what is closed is closed
        if descent.stuck:
            pace.widen()
        if progress:
            progress(done(), descent.share, pace.gap)
    proven, spent = min(max(first.least, descent.least), best), working_seconds() - started
    return Search(
        lower_bound=proven,
        upper_bound=best,
        worst=_lowest([(first.points, first.values), descent.lowest()])[0],
        boxes=done(),
        seconds=spent,
        complete=best - proven <= eps,
        needed=max(pace.whole * seconds, spent) if pace.whole else spent,
    )


def _divided(cover: Charted, count: float, device: str) -> Charted:
    """The same positives in so many boxes or more."""
    lower, upper = cover.lower, cover.upper
    for _ in range(2 * MOST_FIRST.bit_length()):  # halves without positives do not count
        if len(lower) >= count:
            break
        bounds = cover.bound(lower, upper, device)
        some = ~np.isposinf(bounds.lower)
        boxes, axis, row = bounds.boxes[some], bounds.axis[some], np.arange(np.count_nonzero(some))
        (lower, upper), middle = boxes.swapaxes(0, 1), cover.chart.middle(boxes[row, 0, axis], boxes[row, 1, axis])
        less, more = upper.copy(), lower.copy()
        less[row, axis] = more[row, axis] = middle
        lower, upper = np.concatenate([lower, more]), np.concatenate([less, upper])
    return replace(cover, lower=lower, upper=upper)
