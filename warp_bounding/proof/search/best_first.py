"""Branch and bound: the least value of a bounder's ``f`` over a union of boxes, certified from below.

Every box gets a certified lower bound from the method (``Bounder.bound``) and a few concrete points. Boxes whose bound
is not more than ``eps`` under the least value found are closed, the others halved. What is returned is sound whenever
the search ends: the least bound over all closed *and* open boxes. Boxes wait in chunks, and the chunk whose boxes matter
most comes first, those with the largest gap where nothing else is said, so that a search that is stopped early has raised
its bound as far as it could. When many wait, those are closed as they are that will not matter by the end, as far as that
can be told, and when too many do, the half that matters least: memory stays bounded, and the search goes on where it counts,
but it can no longer end with the gap that was asked for.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.proof.search.vacancy import Positives
from warp_bounding.runtime.launch import working_seconds

__all__ = ["WORST", "Search", "halve", "lowest", "minimum"]

CHUNK = 32768  # boxes that are bounded at a time
MANY, TOO_MANY = 5_000_000, 15_000_000  # boxes that wait (a million takes about 0.1 GB in 4D)
AGAIN = 1.2  # times as many as after the last time: when boxes are looked through again
# The gap falls with the boxes bounded, to this power, about; those that wait and cost less than a share of what that leaves are closed.
FALLS, SHARE = 0.6, 0.5
QUARTER = 1.7  # a box whose bound is too loose by more than this factor is quartered at once
NEAR = 16.0  # gaps above the least value found: positives of a shape under it are kept as samples
WORST = 2048  # low points that are kept, as samples for training


@dataclass(frozen=True)
class Search:
    """Result of a search.

    Attributes:
        lower_bound: Certified: ``f >= lower_bound`` on every box.
        upper_bound: Least value found at a concrete point.
        worst: ``(K, n)`` float64, the lowest concrete points, lowest first, in the coordinates that f takes.
        boxes: Boxes that were bounded.
        seconds: Wall time.
        complete: Whether the two bounds agree within ``eps``, or as nearly as float64 can tell.
        needed: Seconds that a complete search is expected to take; infinity where that is not known.
        numbers: ``(K, Z)``, the lowest points as numbers of a chart, where there is one.
        by_group: ``(G,)``, the same as ``lower_bound`` of each group of boxes by itself.
    """

    lower_bound: float
    upper_bound: float
    worst: np.ndarray
    boxes: int
    seconds: float
    complete: bool
    needed: float = np.inf
    numbers: np.ndarray | None = None
    by_group: np.ndarray | None = None


def minimum(
    bounder: Bounder,
    lower: np.ndarray,
    upper: np.ndarray,
    *,
    eps: float | np.ndarray,
    seconds: float = float("inf"),
    boxes: float = float("inf"),
    points: np.ndarray | None = None,
    progress: Callable[[int, int, float], None] | None = None,
    positives: Positives | None = None,
    known: float = float("inf"),
    groups: np.ndarray | None = None,
    group_of: Callable[[np.ndarray], np.ndarray] | None = None,
    group_count: int = 1,
    price: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
) -> Search:
    """Certified minimum of ``f`` over boxes, or over those of their points that are positives of a shape.

    Boxes may be told apart by groups, each with a minimum of its own: one is not searched for less than itself, and a
    search that runs out of time is loose in the groups only that are not done.

    Args:
        bounder: The bounder of ``f``.
        lower: ``(N, n)`` float64 lower corners, coordinates ``v``.
        upper: ``(N, n)`` float64 upper corners.
        eps: Gap between bound and found value at which a box is closed; at least 0. It is not taken smaller than what
            the bounds of single points resolve, or the search would not end. Of groups there may be one for each.
        seconds: Time after which the search ends with what it has; the given boxes are bounded once in any case.
        boxes: Number of boxes after which it ends with what it has, the same on every machine.
        points: ``(P, n)`` concrete points in the boxes to begin with; good ones save most of the work.
        progress: Called now and then with boxes done, boxes waiting, gap.
        positives: Tells which boxes hold no positive; every point of the boxes is one if ``None``.
        known: A value of f at a positive, where there are no groups.
        groups: ``(N,)`` int, the group of each box, from 0 on; all are one group if ``None``.
        group_of: The groups of ``points``; needed where there are groups.
        group_count: How many groups there are, those without a box among them.
        price: What it costs that a group's minimum is known to be no less than a bound: called with bounds ``(K,)`` and their groups, it
            grows as bounds fall. Boxes of the highest price come first. The gap if ``None``.

    Returns:
        The result; sound also where it is not complete.
    """
    started = working_seconds()
    low_points = np.empty((0, lower.shape[1])) if points is None else np.asarray(points, dtype=np.float64)
    low_values = bounder.reference(low_points) if len(low_points) else np.empty(0)
    groups = np.zeros(len(lower), np.int64) if groups is None else np.asarray(groups)
    best, closed, done = np.full(group_count, known), np.full(group_count, np.inf), 0
    np.minimum.at(best, np.zeros(len(low_points), np.int64) if group_of is None else group_of(low_points), low_values)
    probe = (lower[:CHUNK] + upper[:CHUNK]) / 2
    resolved = 4 * float((bounder.reference(probe) - bounder.bound(probe, probe).lower).max())
    eps = np.broadcast_to(np.maximum(eps, resolved), best.shape)

    def goals() -> np.ndarray:
        """For each group f that is of no interest any more: near its least value found, or no less than what has been closed."""
        return np.minimum(best - eps, closed)

    def prices(bound: np.ndarray, group: np.ndarray) -> np.ndarray:
        with np.errstate(invalid="ignore"):  # nothing is known of a group: its best value is infinite, as is the price
            gap = np.nan_to_num(best[group] - bound, nan=np.inf)
            return gap if price is None else price(bound, group)

    def advance(low: np.ndarray, high: np.ndarray, parent: np.ndarray, group: np.ndarray, _) -> list[_Chunk]:
        """Bound a chunk; its halves that stay open, in chunks."""
        nonlocal done, low_points, low_values
        open_ = parent < goals()[group]
        np.minimum.at(closed, group[~open_], parent[~open_])
        low, high, parent, group = low[open_], high[open_], parent[open_], group[open_]
        if not len(low):
            return []
        bounds = bounder.bound(low, high)
        done += len(low)
        bound = np.fmax(bounds.lower, parent)  # a half is no worse than the whole, nor is one without a bound (NaN)
        points, values, of_points, axis = bounds.point, bounds.value, group, bounds.axis.copy()
        if positives is not None:
            small = positives.too_small(low, high)  # before anything is cut off: the bounds are of whole boxes
            asked = np.flatnonzero(bound < goals()[group])
            goal = goals()[group[asked]]
            held = positives.held(low[asked], high[asked], bounds.part(asked), goal)
            bound[asked], axis[asked] = np.fmax(held.lower, bound[asked]), held.axis
            low[asked], high[asked] = held.corners
            np.minimum.at(closed, group[asked[held.cut]], goal[held.cut])
            near = np.flatnonzero((bound < np.inf) & (values < (best + NEAR * eps)[group]))
            near = near[positives.holds(points[near])]
            points, values, of_points = points[near], values[near], group[near]
        low_points, low_values = lowest(low_points, low_values, points, values)
        np.minimum.at(best, of_points, values)
        open_ = bound < goals()[group]
        if positives is not None:
            open_ &= ~small
        np.minimum.at(closed, group[~open_], bound[~open_])
        # Where the bound is much looser than it may be, its halves would only be halved again: quarter at once.
        with np.errstate(invalid="ignore"):  # no positive of a box is known: its value is infinite
            loose = open_ & (bounds.value - bound > QUARTER * (bounds.value - (best - eps)[group]))
        loose &= bounds.next_axis is not None
        once, parts = open_ & ~loose, []
        if once.any():
            halves = halve(low[once], high[once], axis[once])
            parts.append((*halves, np.tile(bound[once], 2), np.tile(group[once], 2)))
        if loose.any():
            halves = halve(low[loose], high[loose], axis[loose])
            halves = halve(*halves, np.tile(bounds.next_axis[loose], 2))
            parts.append((*halves, np.tile(bound[loose], 4), np.tile(group[loose], 4)))
        if not parts:
            return []
        low, high, bound, group = (np.concatenate(part) for part in zip(*parts, strict=True))
        return _chunks(low, high, bound, group, prices(bound, group))

    def least() -> np.ndarray:
        found = closed.copy()
        for chunk in waiting:
            np.minimum.at(found, chunk.group, chunk.bound)
        return found

    nowhere = np.full(len(lower), -np.inf)
    start = _chunks(lower, upper, nowhere, groups, -nowhere)
    waiting, gave_up = [rest for chunk in start for rest in advance(*chunk)], False
    looked_at = MANY
    while waiting and done < boxes and working_seconds() - started < seconds:
        waiting += advance(*waiting.pop(max(range(len(waiting)), key=lambda i: waiting[i].price[0])))
        count = sum(len(chunk.bound) for chunk in waiting)
        if count > looked_at * AGAIN:
            spent = working_seconds() - started
            used = max(done / boxes, spent / seconds) if min(boxes, seconds) > 0 else 1.0
            known = [float(chunk.price[0]) for chunk in waiting if np.isfinite(chunk.price[0])]
            level = SHARE * max(known, default=0.0) * used**FALLS
            waiting, rest = _split(waiting, level, TOO_MANY // 2 if count > TOO_MANY else count)
            looked_at = max(MANY, sum(len(chunk.bound) for chunk in waiting))
            for chunk in rest:
                np.minimum.at(closed, chunk.group, chunk.bound)
                gave_up = True
        if progress:
            progress(done, sum(len(chunk.bound) for chunk in waiting), float(best.min() - least().min()))
    # No more than the least value found, which may be that of a point that nothing is decided of.
    found, spent = np.minimum(least(), best), working_seconds() - started
    complete = not waiting and not gave_up
    return Search(float(found.min()), float(best.min()), low_points, done, spent, complete, by_group=found)


class _Chunk(NamedTuple):
    """Boxes that wait: corners, bounds, groups, and prices, the highest first."""

    low: np.ndarray
    high: np.ndarray
    bound: np.ndarray
    group: np.ndarray
    price: np.ndarray


def _chunks(*columns: np.ndarray) -> list[_Chunk]:
    """Boxes, given by the columns of ``_Chunk``, in chunks of ``CHUNK``."""
    order = np.argsort(-columns[-1], kind="stable")
    held = [each[order] for each in columns]
    return [_Chunk(*(each[i : i + CHUNK] for each in held)) for i in range(0, len(order), CHUNK)]


def _split(chunks: list[_Chunk], level: float, most: int) -> tuple[list[_Chunk], list[_Chunk]]:
    """The boxes of a price above a level, those of the highest prices where there would be more than ``most``, and the others."""
    price = np.concatenate([chunk.price for chunk in chunks])
    dear = price > level
    if dear.sum() > most:
        dear = np.zeros(len(price), dtype=bool)
        dear[np.argpartition(-price, most)[:most]] = True
    kept, rest, begin = [], [], 0
    for chunk in chunks:
        own, begin = dear[begin : begin + len(chunk.price)], begin + len(chunk.price)
        for part, held in ((own, kept), (~own, rest)):
            if part.any():
                held.append(_Chunk(*(each[part] for each in chunk)))
    return kept, rest


def halve(low: np.ndarray, high: np.ndarray, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both halves of each box: ``(2N, n)`` lower and upper corners."""
    row = np.arange(len(low))
    middle = (low[row, axis] + high[row, axis]) / 2
    left_high, right_low = high.copy(), low.copy()
    left_high[row, axis] = middle
    right_low[row, axis] = middle
    return np.concatenate([low, right_low]), np.concatenate([left_high, high])


def lowest(
    points: np.ndarray, values: np.ndarray, more: np.ndarray, more_values: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The lowest ``WORST`` of two sets of points and their values, sorted."""
    if len(values) >= WORST:
        better = more_values < values[-1]
        more, more_values = more[better], more_values[better]
        if not len(more):
            return points, values
    points, values = np.concatenate([points, more]), np.concatenate([values, more_values])
    order = np.argsort(values, kind="stable")[:WORST]
    return points[order], values[order]
