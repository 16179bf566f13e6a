"""Thresholds of the parts of a network's domain, for rays and boxes: each part is a search of its own.

The chart of a part (``networks.charts.part``) holds the positives whose coordinates v lie in it. A part's search that
runs out of time is loose in that part only; and no part is looser than the whole domain, which is searched first.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from warp_bounding.bounders.mlp import Lattice, Mlp
from warp_bounding.networks.charts import FARTHEST, PartChart
from warp_bounding.proof.search.best_first import Search
from warp_bounding.proof.search.depth_first import ChartedPositives, charted_minimum, divided
from warp_bounding.runtime.launch import working_seconds

__all__ = ["in_part", "least_by_part", "meeting"]

INITIAL = 32768  # boxes of the whole domain, of which each part takes those that meet it
WHOLE_SHARE = 0.25  # of the time: the search of the whole domain
COST = 0.02  # of the negatives that a part may deny: how many its gap may make false positives


def corners(lattice: Lattice) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corners ``(parts, n)`` of the closed parts; the outer ones end far beyond all coordinates."""
    ends = [np.concatenate([[-FARTHEST], axis.astype(np.float64), [FARTHEST]]) for axis in lattice.edges]
    index = np.unravel_index(np.arange(lattice.count), lattice.shape)
    sides = (0, 1)
    return tuple(np.stack([end[i + side] for end, i in zip(ends, index, strict=True)], axis=1) for side in sides)


def in_part(cover: ChartedPositives, lower: np.ndarray, upper: np.ndarray) -> ChartedPositives:
    """The positives with coordinates v between two corners ``(n,)``."""
    chart = PartChart.of(cover.chart, cover.numbers)
    return replace(cover, chart=chart, numbers=np.concatenate([cover.numbers, lower, upper]))


def meeting(cover: ChartedPositives, lattice: Lattice) -> Iterator[tuple[int, ChartedPositives]]:
    """The parts that the boxes of a cover may meet, each with the positives in it."""
    low, high = cover.chart.hull(cover.lower, cover.upper, cover.numbers)
    for part, (lower, upper) in enumerate(zip(*corners(lattice), strict=True)):
        meets = ((low <= upper) & (high >= lower)).all(axis=1)
        if meets.any():
            own = in_part(cover, lower, upper)
            yield part, replace(own, lower=cover.lower[meets], upper=cover.upper[meets])


def least_by_part(
    member: Mlp,
    cover: ChartedPositives,
    lattice: Lattice,
    negatives: np.ndarray,
    points: np.ndarray,
    *,
    eps: float,
    seconds: float = float("inf"),
    boxes: float = float("inf"),
    progress: Callable[[int, float, float], None] | None = None,
) -> tuple[np.ndarray, np.ndarray, Search]:
    """Certified least f of the positives of each part.

    Args:
        member: The network.
        cover: Its positives.
        lattice: The parts.
        negatives: ``(N, n)`` coordinates v that are no positives: what a part may deny of them tells how much of the
            time it gets, and its gap.
        points: ``(P, n)`` positives, the more the better.
        eps: Gap of the whole domain, and the least one of a part.
        seconds: Time for all parts together.
        boxes: Boxes for all parts together, instead of time.
        progress: Called with boxes done, the fraction of the work that is done, and the gap that is aimed at.

    Returns:
        ``(parts,)`` least f, infinity where no positive lies; ``(parts,)`` the least f found, not lower; and the search
        of the whole domain, with all boxes and seconds counted.
    """
    started = working_seconds()
    f, place = member.reference(negatives), lattice.place(negatives)
    found = np.full(lattice.count, np.inf)
    np.minimum.at(found, lattice.place(points), member.reference(points))
    limits = {"seconds": WHOLE_SHARE * seconds, "boxes": WHOLE_SHARE * boxes}
    whole = charted_minimum(cover, eps=eps, upper=float(found.min()), progress=progress, **limits)
    np.minimum.at(found, lattice.place(whole.worst), member.reference(whole.worst))
    least, own = np.full(lattice.count, np.inf), dict(meeting(divided(cover, INITIAL, "cpu"), lattice))
    least[list(own)] = whole.lower_bound
    # What each part may deny beyond the whole domain's threshold; where none of its negatives is, nothing is to be proven.
    by_part = {part: np.sort(f[(place == part) & (f >= whole.lower_bound) & (f < found[part])]) for part in own}
    order = sorted((part for part in own if len(by_part[part])), key=lambda part: -len(by_part[part]))
    weights = np.sqrt([len(by_part[part]) for part in order])
    done, complete = whole.boxes, whole.complete
    for index, part in enumerate(order):
        share = float(weights[index] / weights[index:].sum())
        above = by_part[part][::-1]
        upper = float(min(found[part], above[0] + eps))  # no higher threshold denies more of the negatives
        gap = max(upper - float(above[min(int(COST * len(above)), len(above) - 1)]), eps)
        left = max(seconds - (working_seconds() - started), 0.0), max(boxes - done, 0.0)
        search = charted_minimum(own[part], eps=gap, upper=upper, seconds=share * left[0], boxes=share * left[1])
        done, complete = done + search.boxes, complete and search.complete
        least[part] = max(least[part], search.lower_bound)
        found[part] = min(found[part], search.upper_bound)
        if progress:
            progress(done, (index + 1) / len(order), gap)
    unknown = [part for part in own if found[part] == np.inf]  # nothing to be denied, so nobody has looked there
    found[unknown], spent = whole.upper_bound, working_seconds() - started
    return least, np.maximum(found, least), replace(whole, boxes=done, seconds=spent, complete=complete)
