"""Checks ``f >= threshold + E`` over all positives of a bounder of points, in a loop of its own.

Boxes cover what comes from the object: cell by cell; of a shape without cells the whole domain, of which boxes that the
shape certifies to be empty are left out. They are halved (``halving``) until every bound reaches the target or a
counterexample is found.
"""

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.proof.halving import Boxes, Seen, search
from warp_bounding.proof.search import NARROWEST, ShapePositives, TightenedBounds
from warp_bounding.queries.domain import Domain
from warp_bounding.rounding import UNIT64
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.shape import Shape

PULL = 1e-4  # share of the way to its cell's centre: each suspect is also tried there, farther inside
INWARD = 1 - 1e-3  # of the way from the domain's middle to a suspect: it is tried there, too
BOX_BATCH = 16384  # boxes or cells of one step
TRIED = 512  # points of a chunk, those of the least f, that are tested for being positives
SUSPECTS = 1024  # points of least f that are tried as counterexamples
SMALLEST = 1e-9  # a box narrower than this, in the coordinates that f takes, ends the proof
FINER = 1 / 8  # times the fit's smallest box: the size at which a box counts as object here


class PositivesOnly:
    """Boxes that hold positives only; as ``ShapePositives``, which is for boxes that may hold none."""

    def __init__(self, bounder: Bounder):
        self.bound = bounder.bound

    def tightened(self, lower: np.ndarray, upper: np.ndarray, bounds: BoxBounds, target: np.ndarray) -> TightenedBounds:
        return TightenedBounds(bounds.lower, bounds.axis, (lower, upper), np.zeros(len(lower), dtype=bool))

    def too_small(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        return np.zeros(len(lower), dtype=bool)

    def holds(self, v: np.ndarray) -> np.ndarray:
        return np.ones(len(v), dtype=bool)


class ReachesTarget:
    """Looks whether ``f >= target`` on all positives.

    A positive with f under the target ends the search, and so does a box that is too small to be halved. Neither
    refutes the claim: only a positive that the deployed bounder denies does (``certify``). ``maxima`` holds minus the
    least lower bound of the boxes that reach the target, and minus that of the others.

    Args:
        positives: Bounds f over boxes, and knows where positives are.
        target: What every lower bound must reach.
    """

    chunk = BOX_BATCH

    def __init__(self, positives: PositivesOnly | ShapePositives, target: float):
        self.positives, self.target = positives, target

    def __call__(self, boxes: Boxes) -> Seen:
        positives, target, (low, high) = self.positives, self.target, boxes[:2]
        bounds = positives.bound(low, high)
        reached = bounds.lower >= target
        least = bounds.lower[reached].min(initial=np.inf)
        unreached = np.flatnonzero(~reached)  # NaN has not reached it
        low, high, bounds = low[unreached], high[unreached], bounds.part(unreached)
        small = positives.too_small(low, high)  # of whole boxes, as the bounds are: ``tightened`` may cut parts off
        known = positives.tightened(low, high, bounds, np.full(len(unreached), target))
        open_ = ~(known.lower >= target)
        least = min(least, known.lower[~open_].min(initial=target if known.cut.any() else np.inf))
        low, high = (np.asarray(corner)[open_] for corner in known.corners)
        axis, bounds, small = known.axis[open_].astype(np.int64), bounds.part(open_), small[open_]
        failed = small | ((high - low)[np.arange(len(low)), axis] < SMALLEST)
        lowest = np.argpartition(bounds.value, TRIED)[:TRIED] if len(low) > TRIED else np.arange(len(low))
        lowest = lowest[bounds.value[lowest] < target]
        failed[lowest] |= positives.holds(bounds.point[lowest])
        rest, suspects = boxes.part(unreached[open_])._replace(lower=low, upper=high), None
        if failed.any():
            order = np.lexsort((bounds.value, ~failed))[:SUSPECTS]
            at = np.concatenate([bounds.point[order], (low + high)[order] / 2])
            suspects = at, np.tile(rest.owner[order], 2)
            least = np.fmin(least, np.fmin.reduce(np.concatenate([bounds.lower[failed], bounds.value[failed]])))
        least = np.array([least, np.fmin.reduce(bounds.lower, initial=np.inf)])
        return Seen(rest.halves(axis), np.arange(2), -least, suspects)


class Covering(NamedTuple):
    """Boxes that cover all positives of an object."""

    positives: PositivesOnly | ShapePositives
    starts: Iterable[tuple[np.ndarray, np.ndarray, float]]  # as ``halving.search`` takes them
    at: Callable[[np.ndarray, np.ndarray], np.ndarray]  # ``Checked.suspects`` of coordinates and owners of boxes


class Checked(NamedTuple):
    """What a search has found.

    Attributes:
        least: The least certified lower bound of the boxes that were looked at.
        boxes: How many boxes were looked at.
        suspects: ``(S, m)`` queries in object space whose f may lie under the target, candidates for a counterexample.
            ``None`` if every bound reached the target, which proves it where the search is complete.
        complete: False if time ran out.
    """

    least: float
    boxes: int
    suspects: np.ndarray | None = None
    complete: bool = True


def check_covering(covering: Covering, target: float, budget: float, **options) -> Checked:
    """Check that ``f >= target`` on all positives, until that fails or time is over; ``options`` are the search's."""
    look = ReachesTarget(covering.positives, target)
    end = search(look, covering.starts, np.full(2, -np.inf), budget=budget, **options)
    reached, not_reached = -end.maxima
    if end.failed is not None:
        return Checked(float(reached), end.boxes, covering.at(*end.failed))
    return Checked(float(reached if end.complete else np.fmin(reached, not_reached)), end.boxes, None, end.complete)


# --- boxes that cover all positives ----------------------------------------------------------------------------------


def reachable(domain: Domain, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners of boxes of all v that the pipeline can make of points of boxes: ``Domain.widened``, computed anew.

    Args:
        domain: The map to v, with the error ``delta`` that it may have.
        lower: ``(N, n)`` float64, object space.
        upper: ``(N, n)`` float64.
    """
    center, scale, limit = (np.float64(each) for each in (domain.center, domain.scale, domain.limit))
    sides = []
    for corner, sign in ((lower, -1.0), (upper, 1.0)):
        v = (corner - center) * scale
        v += sign * (domain.delta + 4 * UNIT64 * (np.abs(v) + domain.delta))  # a difference, a product, a sum
        sides.append(np.clip(v, -limit, limit))
    return sides[0], sides[1]


def cover_cells(bounder: Bounder, grid: Grid) -> Covering:
    """Covers every v that the pipeline can make of points of the object's cells; suspects are points of the object."""

    def corners(some) -> tuple[np.ndarray, np.ndarray]:
        return grid.position(grid.occupied[some] - 0.5), grid.position(grid.occupied[some] + 0.5)

    def starts() -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
        for start in range(0, len(grid.occupied), BOX_BATCH):
            boxes = reachable(bounder.domain, *corners(slice(start, start + BOX_BATCH)))
            yield *boxes, BOX_BATCH / max(len(grid.occupied), BOX_BATCH)

    def inside(v: np.ndarray, box: np.ndarray) -> np.ndarray:
        first, last = corners(box)
        x = np.clip(bounder.domain.to_object(v), first, last)  # boxes of v are wider than cells, by delta
        # rounded to float32, a point of a corner may lie outside its cell
        return np.concatenate([x, x + PULL * ((first + last) / 2 - x)])

    return Covering(PositivesOnly(bounder), starts(), inside)


def cover_domain(bounder: Bounder, shape: Shape) -> Covering:
    """Covers the points of a shape by the domain's box; suspects are points in object space."""
    positives = ShapePositives(bounder, shape, FINER * NARROWEST)

    def inside(v: np.ndarray, _: np.ndarray) -> np.ndarray:
        # at the end of a complement's domain a point may round to one beyond it, where the answer is maybe
        return bounder.domain.to_object(np.concatenate([v, v * INWARD]) if bounder.domain.unbounded else v)

    return Covering(positives, [(*positives.boxes(), 1.0)], inside)
