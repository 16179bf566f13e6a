"""The loop of ``certify`` over boxes: they are halved until every bound reaches the target, or a point shows that it does not."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.bounders.mlp import CERTAIN, Local
from warp_bounding.errors import BounderError
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.proof.covers import COVERS
from warp_bounding.proof.parts import corners, in_part
from warp_bounding.proof.prove import charted
from warp_bounding.proof.search.best_first import halve
from warp_bounding.proof.search.depth_first import ChartedPositives
from warp_bounding.proof.shape_check import CHUNK, SUSPECTS, Checked
from warp_bounding.runtime.launch import working_seconds

__all__ = ["NARROWEST", "Failed", "check_boxes", "check_charted", "check_parts"]

NARROWEST = 1e-9  # width, in the coordinates that f takes, under which a box is not halved any more


class Failed(NamedTuple):
    """The boxes that do not reach the target, in the coordinates that f takes."""

    point: np.ndarray  # where f is low
    value: np.ndarray  # f there
    center: np.ndarray
    owner: np.ndarray  # index of the given box that it is a part of


def check_boxes(
    f, lower: np.ndarray, upper: np.ndarray, target: float, deadline: float
) -> tuple[Checked, Failed | None]:
    """Halve boxes until ``f >= target`` on all, a point shows that it is not, a box is too narrow, or time is over.

    Corners are ``(N, Z)`` float64 in the coordinates that f takes: v of a bounder or ``LeastBox``, the numbers of a
    chart of its positives. The deadline is on the clock ``working_seconds``.

    Returns:
        What was found, without suspects; and ``None``, or the boxes that failed. A point with f under the target
        refutes nothing until the deployed bounder has denied it (``certify``).
    """
    stack, least, boxes = [(lower, upper, np.arange(len(lower)))], np.inf, 0
    while stack:  # newest first, in chunks: memory grows with depth, not with the number of boxes
        lower, upper, owner = stack.pop()
        if len(lower) > CHUNK:
            stack += [(lower[part], upper[part], owner[part]) for part in (slice(CHUNK, None), slice(CHUNK))]
            continue
        bounds = f.bound(lower, upper)
        boxes += len(lower)
        low = ~(bounds.lower >= target)
        least = min(least, float(bounds.lower[~low].min(initial=np.inf)))
        if not low.any():
            continue
        lower, upper = (lower[low], upper[low]) if bounds.boxes is None else bounds.boxes[low].swapaxes(0, 1)
        axis, owner, lowest = bounds.axis[low], owner[low], float(bounds.lower[low].min())
        width = np.take_along_axis(upper - lower, axis[:, None].astype(np.int64), axis=1)
        if (bounds.value[low] < target).any() or width.min() < NARROWEST:
            return Checked(lowest, boxes), Failed(bounds.point[low], bounds.value[low], (lower + upper) / 2, owner)
        if working_seconds() > deadline:
            return Checked(lowest, boxes, complete=False), None
        stack.append((*halve(lower, upper, axis), np.tile(owner, 2)))
    return Checked(least, boxes), None


def check_charted(
    bounder: Bounder, grid: IndicatorGrid, cover: ChartedPositives, target: float, seconds: float, progress
) -> Checked:
    """The positives of a network as boxes of a chart."""
    deadline, least, boxes = working_seconds() + seconds, np.inf, 0
    for lower, upper, done in COVERS[bounder.query_kind].anew(bounder, grid, cover):
        found, failed = check_boxes(cover, lower, upper, target, deadline)
        least, boxes = min(least, found.least), boxes + found.boxes
        if failed is not None:
            lowest = np.argsort(failed.value)[:SUSPECTS]
            return Checked(found.least, boxes, cover.coordinates(failed.point[lowest]))
        if not found.complete:
            return found._replace(boxes=boxes)
        if progress:
            progress(done, len(grid.occupied))
    return Checked(least, boxes)


def check_parts(
    bounder: Local,
    grid: IndicatorGrid,
    target: float,
    seconds: float,
    progress: Callable[[int, int], None] | None,
) -> Checked:
    """The positives of a network with a threshold for each part of its domain, part by part.

    Args:
        bounder: Its f is the network's less the part's threshold; a part that is denied must hold no positive at all.
        grid: The object.
        target: What f must reach.
        seconds: Time allowed.
        progress: Called with cells done and cells in all.

    Returns:
        What was found, ``least`` of f less the part's threshold.

    Raises:
        BounderError: If the network has no chart, or the target is beyond what a part without threshold answers.
    """
    deadline, least, boxes, member = working_seconds() + seconds, np.inf, 0, bounder.member
    cover = charted(member, grid)
    if cover is None or not target <= CERTAIN:
        raise BounderError("there is no proof of such a network part by part")
    thresholds, lowest, highest = bounder.thresholds, *corners(bounder.lattice)
    for lower, upper, done in COVERS[bounder.query_kind].anew(member, grid, cover):
        low, high = cover.chart.hull(lower, upper, cover.numbers)
        for part in np.flatnonzero(thresholds > -np.inf):  # others answer *maybe* to everything
            meets = ((low <= highest[part]) & (high >= lowest[part])).all(axis=1)
            if not meets.any():
                continue
            own = in_part(cover, lowest[part], highest[part])
            needed = float(np.nextafter(target + thresholds[part], np.inf))
            found, failed = check_boxes(own, lower[meets], upper[meets], needed, deadline)
            reached = target if found.least == np.inf else np.nextafter(found.least - thresholds[part], -np.inf)
            least, boxes = min(least, float(reached)), boxes + found.boxes
            if failed is not None:
                worst = np.argsort(failed.value)[:SUSPECTS]
                return Checked(-np.inf, boxes, cover.coordinates(failed.point[worst]))
            if not found.complete:
                return Checked(-np.inf, boxes, complete=False)
        if progress:
            progress(done, len(grid.occupied))
    return Checked(min(least, CERTAIN) if np.isneginf(thresholds).any() else least, boxes)
