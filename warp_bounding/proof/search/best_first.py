"""Branch and bound: the least value of a bounder's ``f`` over a union of boxes, certified from below.

Every box gets a certified lower bound from the method (``Bounder.bound``) and a few concrete points. Boxes whose bound
is not more than ``eps`` under the least value found are closed, the others halved. What is returned is sound whenever
the search ends: the least bound over all closed *and* open boxes. Boxes wait in chunks, and the chunk with the lowest
bound comes first, so that a search that is stopped early has raised its bound as far as it could; when too many wait,
the newest chunk comes first instead, whose halves close soon, and memory stays bounded.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from warp_bounding.bounders.base import Bounder
from warp_bounding.proof.search.vacancy import ShapePositives
from warp_bounding.runtime.launch import working_seconds

__all__ = ["WORST", "Search", "halve", "lowest", "minimum"]

CHUNK = 32768  # boxes that are bounded at a time
MOST_WAITING = 6_000_000  # boxes (about 0.5 GB in 4D): where more wait, the newest chunk comes first
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
    """

    lower_bound: float
    upper_bound: float
    worst: np.ndarray
    boxes: int
    seconds: float
    complete: bool
    needed: float = np.inf
    numbers: np.ndarray | None = None


def minimum(
    bounder: Bounder,
    lower: np.ndarray,
    upper: np.ndarray,
    *,
    eps: float,
    seconds: float = float("inf"),
    boxes: float = float("inf"),
    points: np.ndarray | None = None,
    progress: Callable[[int, int, float], None] | None = None,
    positives: ShapePositives | None = None,
) -> Search:
    """Certified minimum of ``f`` over boxes, or over those of their points that are positives of a shape.

    Args:
        bounder: The bounder of ``f``.
        lower: ``(N, n)`` float64 lower corners, coordinates ``v``.
        upper: ``(N, n)`` float64 upper corners.
        eps: Gap between bound and found value at which a box is closed; at least 0. It is not taken smaller than what
            the bounds of single points resolve, or the search would not end.
        seconds: Time after which the search ends with what it has; the given boxes are bounded once in any case.
        boxes: Number of boxes after which it ends with what it has, the same on every machine.
        points: ``(P, n)`` concrete points in the boxes to begin with; good ones save most of the work.
        progress: Called now and then with boxes done, boxes waiting, gap.
        positives: Tells which boxes hold no positive; every point of the boxes is one if ``None``.

    Returns:
        The result; sound also where it is not complete.
    """
    started = working_seconds()
    low_points = np.empty((0, lower.shape[1])) if points is None else np.asarray(points, dtype=np.float64)
    low_values = bounder.reference(low_points) if len(low_points) else np.empty(0)
    best = float(low_values.min(initial=np.inf))
    closed, done = np.inf, 0
    probe = (lower[:CHUNK] + upper[:CHUNK]) / 2
    eps = max(eps, 4 * float((bounder.reference(probe) - bounder.bound(probe, probe).lower).max()))

    def advance(low: np.ndarray, high: np.ndarray, parent: np.ndarray) -> list[tuple]:
        """Bound a chunk; its halves that stay open, in chunks."""
        nonlocal closed, done, best, low_points, low_values
        open_ = parent < best - eps
        closed = min(closed, parent[~open_].min(initial=np.inf))
        low, high, parent = low[open_], high[open_], parent[open_]
        if not len(low):
            return []
        bounds = bounder.bound(low, high)
        done += len(low)
        bound = np.fmax(bounds.lower, parent)  # a half is no worse than the whole, nor is one without a bound (NaN)
        points, values = bounds.point, bounds.value
        if positives is not None:
            asked = np.flatnonzero(bound < best - eps)
            bound[asked[positives.vacant(low[asked], high[asked])]] = np.inf
            near = np.flatnonzero((bound < np.inf) & (values < best + NEAR * eps))
            near = near[positives.holds(points[near])]
            points, values = points[near], values[near]
        low_points, low_values = lowest(low_points, low_values, points, values)
        best = min(best, float(low_values.min(initial=np.inf)))
        open_ = bound < best - eps
        if positives is not None:
            open_ &= ~positives.too_small(low, high)
        closed = min(closed, bound[~open_].min(initial=np.inf))
        # Where the bound is much looser than it may be, its halves would only be halved again: quarter at once.
        loose = open_ & (bounds.value - bound > QUARTER * (bounds.value - best + eps))
        loose &= bounds.next_axis is not None
        once, parts = open_ & ~loose, []
        if once.any():
            parts.append((*halve(low[once], high[once], bounds.axis[once]), np.tile(bound[once], 2)))
        if loose.any():
            halves = halve(low[loose], high[loose], bounds.axis[loose])
            parts.append((*halve(*halves, np.tile(bounds.next_axis[loose], 2)), np.tile(bound[loose], 4)))
        return _chunks(*(np.concatenate(part) for part in zip(*parts, strict=True))) if parts else []

    def least() -> float:
        return min([closed, *(bound[0] for _, _, bound in waiting)])

    waiting = [rest for chunk in _chunks(lower, upper, np.full(len(lower), -np.inf)) for rest in advance(*chunk)]
    while waiting and done < boxes and working_seconds() - started < seconds:
        crowded = sum(len(bound) for _, _, bound in waiting) > MOST_WAITING
        chunk = waiting.pop(-1 if crowded else min(range(len(waiting)), key=lambda i: waiting[i][2][0]))
        waiting += advance(*chunk)
        if progress:
            progress(done, sum(len(bound) for _, _, bound in waiting), best - least())
    return Search(least(), best, low_points, done, working_seconds() - started, complete=not waiting)


def _chunks(low: np.ndarray, high: np.ndarray, bound: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Boxes in chunks of ``CHUNK``, lowest bounds first."""
    order = np.argsort(bound, kind="stable")
    low, high, bound = low[order], high[order], bound[order]
    return [(low[i : i + CHUNK], high[i : i + CHUNK], bound[i : i + CHUNK]) for i in range(0, len(low), CHUNK)]


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
