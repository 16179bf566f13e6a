"""The part of ``certify`` that is about shapes without cells: a loop of its own over what they do not certify empty."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.certificates.claim import outside
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.shape import Shape
from warp_bounding.proof.search.best_first import halve
from warp_bounding.proof.search.vacancy import NARROWEST, Positives, ShapePositives
from warp_bounding.proof.shape_regions import ShapeRegions, coarse_cells
from warp_bounding.queries.boundary import border_points
from warp_bounding.runtime.launch import working_seconds

__all__ = ["CHUNK", "SUSPECTS", "Checked", "check_regions", "check_shape", "points_outside"]

CHUNK = 16384  # boxes or cells that are taken at a time
FINER = 1 / 8  # boxes are halved so much further than in the fit's proof, whose smallest count as object
OTHER_CELLS = 0.8  # of the number of cells along the longest side: ``check_regions`` rests on other ones than the fit
BORDER = 65_536  # points of the border among which some outside the domain are looked for
PARTS = 1000  # of the domain, in which progress is told
INWARD = 1 - 1e-3  # of the way from the domain's middle, where a suspect is tried besides
SUSPECTS = 1024  # low points that are tried as counterexamples


class Checked(NamedTuple):
    """What a check has found.

    Attributes:
        least: Least certified bound of the boxes that were looked at.
        boxes: How many these were.
        suspects: Points where f may lie under the target, candidates for a counterexample: ``(S, n)`` in object space
            where f is a function of the object's points, ``(S, ndim)`` coordinates v of regions; ``None`` if every
            bound reached the target.
        complete: False if time ran out.
    """

    least: float
    boxes: int
    suspects: np.ndarray | None = None
    complete: bool = True


def points_outside(bounder: Bounder, shape: Shape) -> np.ndarray:
    """``(N, n)`` points in object space, of which some may be in the object and outside the bounder's domain."""
    if isinstance(shape, IndicatorGrid):
        return shape.position(outside(bounder, shape))
    domain, x = bounder.domain.base, border_points(shape, BORDER, np.random.default_rng(0))
    return x[((x < domain.lower) | (x > domain.upper)).any(axis=1)]


def check_shape(
    bounder: Bounder, shape: Shape, target: float, end: float, progress: Callable[[int, int], None] | None
) -> Checked:
    """Halve the domain's box, deepest boxes first, until every bound reaches the target or the shape is not there.

    Args:
        bounder: Its f is checked.
        shape: The object.
        target: What every lower bound must reach: threshold + E.
        end: On the clock ``working_seconds``.
        progress: Called with the share of the domain that is done, in ``PARTS``.
    """
    positives = ShapePositives(bounder, shape, FINER * NARROWEST)
    lower, upper = positives.boxes()
    whole = float(np.prod(upper - lower, axis=1).sum())

    def told(volume: float) -> None:
        if progress:
            progress(round(PARTS * volume / whole), PARTS)

    found = _halved(positives, lower, upper, target, end, told)
    if found.suspects is None:
        return found
    at = found.suspects
    # a point on the end of a complement's domain may round to one beyond it, where the answer is maybe
    if bounder.domain.unbounded:
        at = np.concatenate([at, at * INWARD])
    return found._replace(suspects=bounder.domain.to_object(at))


def check_regions(
    bounder: Mlp, shape: Shape, target: float, end: float, progress: Callable[[int, int], None] | None
) -> Checked:
    """The same of rays and boxes of a network, over the cover of other cells than the fit's, box by box of that."""
    cells = coarse_cells(shape, OTHER_CELLS)
    positives, least, boxes = ShapeRegions(bounder, shape, cells, FINER * NARROWEST), np.inf, 0
    for lower, upper, done in positives.kind.anew(bounder, cells, positives.cover):
        found = _halved(positives, lower, upper, target, end)
        least, boxes = min(least, found.least), boxes + found.boxes
        if found.suspects is not None:
            return Checked(found.least, boxes, positives.coordinates(found.suspects))
        if not found.complete:
            return Checked(least, boxes, complete=False)
        if progress:
            progress(done, len(cells.occupied))
    return Checked(least, boxes)


def _halved(
    positives: Positives,
    lower: np.ndarray,
    upper: np.ndarray,
    target: float,
    end: float,
    told: Callable[[float], None] = lambda volume: None,
) -> Checked:
    """Halve boxes until every bound reaches the target or no positive is there; suspects are points of the boxes."""
    waiting, least, boxes, done = [(lower, upper)], np.inf, 0, 0.0
    while waiting:
        if working_seconds() > end:
            return Checked(least, boxes, complete=False)
        low, high = waiting.pop()
        if len(low) > CHUNK:
            waiting += [(low[part], high[part]) for part in (slice(CHUNK, None), slice(CHUNK))]
            continue
        bounds = positives.bound(low, high)
        boxes += len(low)
        below = ~(bounds.lower >= target)  # NaN is below
        asked, volume = np.flatnonzero(below), (high - low).prod(axis=1)
        small = positives.too_small(low, high)  # before anything is cut off: the bounds are of whole boxes
        found = positives.held(low[asked], high[asked], bounds.part(asked), np.full(len(asked), target))
        low[asked], high[asked] = found.corners
        below[asked], bounds.axis[asked] = ~(found.lower >= target), found.axis
        volume[below] -= (high - low)[below].prod(axis=1)
        done += float(volume.sum())
        reached = np.concatenate([bounds.lower[bounds.lower >= target], found.lower])
        least = min(least, reached[reached >= target].min(initial=target if found.cut.any() else np.inf))
        small &= below
        lowest = np.flatnonzero(below & (bounds.value < target))
        held = lowest[positives.holds(bounds.point[lowest])]
        if small.any() or len(held):
            at = np.concatenate([bounds.point[held], bounds.point[small]])[:SUSPECTS]
            worst = min(least, bounds.lower[small].min(initial=np.inf), bounds.value[held].min(initial=np.inf))
            return Checked(worst, boxes, at)
        told(done)
        if below.any():
            low, high = halve(low[below], high[below], bounds.axis[below])
            waiting.append((low, high))
    return Checked(least, boxes)
