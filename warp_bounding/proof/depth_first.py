"""Proving ``f >= target`` over charted boxes by depth-first search, and raising the target until it meets a positive.

Which boxes must be halved depends on the target alone, not on the order, so a depth-first search with a few boxes a thread does
the same work as one that keeps them all in order, and needs no memory. A search for the minimum first proves a low target,
then higher ones, each from the start, in long strides: as far as the time that is left is expected to reach. Whenever it must
stop, the last target that was proven stands. The first boxes come in random order, so that the share of them that is done
tells what the rest will take.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import warp as wp

from warp_bounding.bounders.charts import Chart
from warp_bounding.bounders.network import Network
from warp_bounding.bounders.network_kernel import NetworkBounds, bound_boxes, double_array
from warp_bounding.launch import launch_blocks
from warp_bounding.proof.depth_first_kernel import KEPT, STACK, depth_first_kernel
from warp_bounding.proof.search import Search

__all__ = ["Charted", "Cleared", "charted_minimum", "clear"]

CPU_BLOCKS, CUDA_BLOCKS = 64, 2048
MOST = 1024  # boxes that a block bounds before it returns: some 50 ms a launch
SHARE = 64  # boxes that a block is given at a time
WORST = 2048  # low points that are kept
STEP = 0.15  # of the gap, from one target to the next
GROWTH = 0.5  # exponent with which the work grows in 1 / gap: 0.3 to 0.8 where boxes are small
HEADROOM = 1.3  # times the work that a target is expected to take must be left for it

Progress = Callable[[int, float, float], None]


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

    def bound(self, lower: np.ndarray, upper: np.ndarray, device="cpu") -> NetworkBounds:
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
        complete: Every box is closed: ``f >= least`` on all positives.
        least: Least bound of a closed box.
        boxes: Boxes bounded.
        share: Of the first boxes, that are done or begun.
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
        progress: Called with boxes bounded, the share of the first boxes that is done, and the target.
        device: Warp device.
    """
    started, dev = time.perf_counter(), wp.get_device(device)
    kernel = depth_first_kernel(cover.network.sizes(cover.chart))
    blocks, size = CPU_BLOCKS if dev.is_cpu else CUDA_BLOCKS, cover.chart.size
    stacks = np.empty((blocks, STACK, 2, size))
    heights, done_out = np.zeros(blocks, np.int32), np.zeros(blocks, np.int64)
    closed_out, low_value = np.full(blocks, np.inf), np.full((blocks, KEPT), np.inf)
    low_point = np.zeros((blocks, KEPT, size))
    order = np.random.default_rng(0).permutation(len(cover.lower))
    reserve, left = np.stack([cover.lower, cover.upper], axis=1)[order], len(order)
    held = [np.ascontiguousarray(cover.network.packed), cover.network.padding_for(cover.limit), cover.numbers]
    fixed = [double_array(np.ascontiguousarray(a, dtype=np.float64), dev) for a in held]
    fixed.append(wp.array(cover.table, dtype=wp.int32, device=dev))
    host = [stacks, heights, done_out, closed_out, low_value, low_point]
    kinds = [wp.float64, wp.int32, wp.int64, *[wp.float64] * 3]
    shared = [
        wp.array(a.reshape(-1), dtype=t, device=dev, copy=not dev.is_cpu) for a, t in zip(host, kinds, strict=True)
    ]
    done, least, found = 0, np.inf, [(np.empty((0, size)), np.empty(0))]
    while True:
        left -= _fill(stacks, heights, reserve[:left])
        if not heights.any():
            return _cleared(True, least, done, 1.0, found)
        most = int(min(MOST, max((boxes - done) / blocks, 1)))
        if not dev.is_cpu:
            for array, values in zip(shared[:2], host[:2], strict=True):
                array.assign(values.reshape(-1))
        launch_blocks(kernel, blocks, [0, float(target), most, *fixed], shared, dev, first_index=0, block=1)
        if not dev.is_cpu:
            for array, values in zip(shared, host, strict=True):
                values[...] = array.numpy().reshape(values.shape)
        done, least = done + int(done_out.sum()), min(least, float(closed_out.min()))
        seen = np.isfinite(low_value)
        found.append((low_point[seen], low_value[seen]))
        if len(found) > 64:
            found = [_lowest(found)]
        if not done_out.any():  # every stack is full
            return _cleared(False, least, done, 1 - left / len(reserve), found)
        if low_value.min() < target:
            return _cleared(False, least, done, 1 - left / len(reserve), found)
        if progress:
            progress(done, 1 - left / len(reserve), target)
        if done >= boxes or time.perf_counter() - started > seconds:
            return _cleared(not heights.any() and not left, least, done, 1 - left / len(reserve), found)


def _cleared(complete: bool, least: float, done: int, share: float, found: list) -> Cleared:
    points, values = _lowest(found)
    return Cleared(complete, least, done, share, points, values)


def _lowest(found: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """The lowest ``WORST`` points, lowest first."""
    points, values = (np.concatenate(part) for part in zip(*found, strict=True))
    order = np.argsort(values, kind="stable")[:WORST]
    return points[order], values[order]


def _fill(stacks: np.ndarray, heights: np.ndarray, reserve: np.ndarray) -> int:
    """Give empty blocks boxes from the end of ``reserve``, or else half of another block's: its oldest, which are its largest.

    Returns:
        How many were taken from the reserve.
    """
    taken, empty = 0, np.flatnonzero(heights == 0)
    for place, block in enumerate(empty):
        left = len(reserve) - taken
        if left:
            share = min(SHARE, -(-left // (len(empty) - place)))
            stacks[block, :share] = reserve[left - share : left]
            heights[block], taken = share, taken + share
            continue
        donor = int(np.argmax(heights))
        if heights[donor] < 2:
            break
        share = heights[donor] // 2
        stacks[block, :share] = stacks[donor, :share]
        stacks[donor, : heights[donor] - share] = stacks[donor, share : heights[donor]].copy()
        heights[block], heights[donor] = share, heights[donor] - share
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
        seconds: Time after which the search ends with what it has.
        boxes: Number of boxes after which it ends likewise, the same on every machine.
        progress: Called with boxes done, the share of the present target that is done, and the gap that is proven.
        device: Warp device.

    Returns:
        See ``Search``; ``worst`` holds numbers of the chart.
    """
    started = time.perf_counter()
    first = clear(cover, -np.inf, boxes=len(cover.lower), device=device)  # every box once
    proven, done, best = first.least, first.boxes, min(upper, float(first.values.min(initial=np.inf)))
    proven = proven if first.complete else -np.inf
    found = [(first.points, first.values)]
    known = rate = None  # a gap, and the boxes that it took or is expected to take; boxes a second

    def shown(n: int, share: float, _: float) -> None:
        if progress:
            progress(done + n, share, best - proven)

    while best - proven > eps and np.isfinite(best):
        spent = time.perf_counter() - started
        left = min(boxes - done, (seconds - spent) * rate if rate else np.inf)
        if seconds - spent <= 0 or left <= 0:
            break
        wanted = max(eps, STEP * (best - proven))
        if known:
            affordable = known[0] * (HEADROOM * known[1] / left) ** (1 / GROWTH)
            if affordable > 0.95 * (best - proven):
                break
            wanted = max(eps, affordable)
        target, began = best - wanted, time.perf_counter()
        outcome = clear(cover, target, seconds=seconds - spent, boxes=boxes - done, progress=shown, device=device)
        done, rate = done + outcome.boxes, outcome.boxes / max(time.perf_counter() - began, 1e-6)
        found.append((outcome.points, outcome.values))
        best = min(best, float(outcome.values.min(initial=np.inf)))
        if outcome.complete or best >= target:
            known = wanted, outcome.boxes / max(outcome.share, 1e-3)
        if outcome.complete:
            proven = max(proven, outcome.least)
        elif best >= target:
            break  # out of time
    points, _ = _lowest(found)
    return Search(
        lower_bound=min(proven, best),
        upper_bound=best,
        worst=points,
        boxes=done,
        seconds=time.perf_counter() - started,
        complete=best - proven <= eps,
        needed=known[1] / rate * max(known[0] / eps, 1.0) ** GROWTH if known and rate else np.inf,
    )
