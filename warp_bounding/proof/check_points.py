"""Checks ``f >= threshold + E`` over all positives of a bounder of points or regions, in a loop of its own.

Boxes cover what comes from the object: cell by cell; of a shape without cells the whole domain, of which boxes that the
shape certifies to be empty are left out; of planes all normals. They are halved (``halving``) until every bound reaches
the target or a counterexample is found. A volume has one bound, here and where its threshold is set. Where the shape
certifies no box, fresh positives are queried (``stress``).
"""

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.certificates import Verdict
from warp_bounding.certificates.claim import target
from warp_bounding.errors import BounderError
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.proof.halving import Boxes, Seen, search, unfinished
from warp_bounding.proof.planes import SupportGap
from warp_bounding.proof.search import NARROWEST, CachedBounds, ShapePositives
from warp_bounding.proof.stress import CONFIDENCE, POSITIVES, descend, fn_rate_bound, fresh_seed, try_positives
from warp_bounding.queries import QUERIES, decision
from warp_bounding.queries.domain import Domain
from warp_bounding.rounding import UNIT32, UNIT64
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.shape import IN, Shape

PULL = 1e-4  # share of the way to its cell's centre: each suspect is also tried there, farther inside
INWARD = 1 - 1e-3  # of the way from the domain's middle to a suspect: it is tried there, too
LEAST_SECONDS = 1.0  # of a search for a counterexample where the proof has no decision
AROUND = (0.0, 1e-6, 1e-5, 1e-4, 1e-3)  # distances in v from a suspect at which a counterexample is searched for
BOX_BATCH = 16384  # boxes or cells of one step
TRIED = 512  # points of a chunk, those of the least f, that are tested for being positives
SUSPECTS = 1024  # points of least f that are tried as counterexamples
SMALLEST = 1e-9  # a box narrower than this, in the coordinates that f takes, ends the proof
FINER = 1 / 8  # times the fit's smallest box: the size at which a box counts as object here
CLOSE = "f comes closer to the threshold than the proof's margins for rounding allow"


def check_part(bounder: Bounder, shape: Shape, deployed: Bounder, budget: float, **options) -> Verdict:
    """Check one part of a conjunction.

    Args:
        bounder: The part.
        shape: What it must be proven for.
        deployed: The whole: a query that it does not deny refutes nothing.
        budget: Seconds.
        **options: For ``halving.search``.
    """
    if QUERIES[bounder.query_kind].is_region:
        verdict = _check_regions(bounder, shape, budget, options)
    elif shape.certified:
        verdict = _check_points(bounder, shape, deployed, budget, options)
    else:
        verdict = _test(bounder, shape, budget)
    x = verdict.counterexample
    if x is not None and deployed.query(np.float32(x)[None]).numpy()[0]:
        text = "a part by itself denies a query that meets the object, and the whole does not"
        return verdict._replace(kind="undecided", message=text, counterexample=None)
    return verdict


def _check_points(bounder: Bounder, shape: Shape, deployed: Bounder, budget: float, options: dict) -> Verdict:
    """``check_part`` of points, where the shape certifies boxes."""
    if not isinstance(shape, Grid):
        shape.check()
        if bounder.exact_on_hull(shape):
            least, boxes = bounder.least(shape)
            if target(bounder) <= least < np.inf:
                return _proven(bounder, least, boxes)
    covering = cover_cells(bounder, shape) if isinstance(shape, Grid) else cover_domain(bounder, shape)
    checked = check_covering(covering, target(bounder), budget, **options)
    if checked.complete and checked.suspects is None:
        return _proven(bounder, checked.least, checked.boxes)
    if checked.complete:
        text, x = CLOSE, denied(deployed, shape, checked.suspects)
    else:
        text = unfinished(f"{budget:.3g} s", options["checkpoint"])
        x = next(iter(descend(deployed, shape, fresh_seed(), max(budget / 4, LEAST_SECONDS))[0]), None)
    return _unproven(bounder, x, text, checked.least, checked.boxes)


def _check_regions(bounder: Bounder, shape: Shape, budget: float, options: dict) -> Verdict:
    """``check_part`` of rays, planes and boxes."""
    checked, text = Checked(-np.inf, 0), CLOSE
    try:
        if bounder.exact_on_cells:
            checked = Checked(*bounder.least(shape))
        else:
            checked = check_covering(cover_planes(bounder, shape), target(bounder), budget, **options)
    except BounderError as error:  # the volume does not hold the object, or numbers leave the range of the proof
        text = str(error)
    decided = checked.complete and checked.suspects is None
    if decided and target(bounder) <= checked.least < np.inf:  # infinity: no positive was looked at
        return _proven(bounder, checked.least, checked.boxes)
    x = None if checked.suspects is None else _denied_near(bounder, shape, checked.suspects)
    if x is None:
        x = try_positives(bounder, shape, POSITIVES, fresh_seed(), budget=max(budget, LEAST_SECONDS))[2]
    text = text if checked.complete else unfinished(f"{budget:.3g} s", options["checkpoint"])
    return _unproven(bounder, x, text, checked.least, checked.boxes)


def _test(bounder: Bounder, shape: Shape, budget: float) -> Verdict:
    """A statistical verdict by fresh positives, where there is no proof."""
    done, lowest, x = try_positives(bounder, shape, POSITIVES, fresh_seed(), budget=budget)
    if x is not None or not done:
        lowest = lowest if done else float(bounder.threshold)
        return _unproven(bounder, x, f"no positive could be queried within {budget:g} s", lowest, 0)
    rate = fn_rate_bound(done)
    text = (
        f"Statistical, not proven: {done:,} fresh positives, none answered with no; at {CONFIDENCE:.0%} confidence "
        f"fewer than {rate:.2g} of such queries are missed."
    )
    counts = {"samples": done, "fn_rate_bound": rate, "confidence": CONFIDENCE}
    return Verdict("statistical", text, lowest, statistics=counts | {"worst_margin": lowest - float(bounder.threshold)})


def _proven(bounder: Bounder, least: float, boxes: int) -> Verdict:
    text = f"Proven from scratch: every {QUERIES[bounder.query_kind].positive} is answered with maybe."
    return Verdict("proven", text, least, boxes)


def _unproven(bounder: Bounder, x: np.ndarray | None, text: str, least: float, boxes: int) -> Verdict:
    """Refuted by a query ``x`` that is denied; without one undecided, for the reason in ``text``."""
    if x is None:
        return Verdict("undecided", text, least, boxes)
    return Verdict("refuted", f"a {bounder.query_kind} that meets the object is answered with no", least, boxes, x)


def denied(bounder: Bounder, shape: Shape, x: np.ndarray) -> np.ndarray | None:
    """The first of these points, as float32, that lies in the object and that the bounder denies."""
    x = np.asarray(x, dtype=np.float64).astype(np.float32)
    x = x[shape.contains(x)]
    return next(iter(x[~bounder.query(x).numpy()]), None) if len(x) else None


def _denied_near(bounder: Bounder, shape: Shape, v: np.ndarray) -> np.ndarray | None:
    """A float32 query at or close to coordinates ``v`` that meets the object and that the bounder denies."""
    truth = decision(bounder.query_kind, shape, bounder.device, bounder.domain.oracle_length)
    rng = np.random.default_rng(0)
    for step in AROUND:
        x = bounder.domain.to_object(v + step * rng.uniform(-1, 1, v.shape)).astype(np.float32)
        missed = np.flatnonzero(~bounder.query(x).numpy() & (truth(x) == IN))
        if len(missed):
            return x[missed[0]]
    return None


# --- the search ------------------------------------------------------------------------------------------------------


class PositivesOnly:
    """Boxes that hold positives only; as ``ShapePositives``, which is for boxes that may hold none.

    Args:
        f: A bounder, or a ``SupportGap``.
    """

    def __init__(self, f):
        self.bound = f.bound

    def held(self, lower: np.ndarray, upper: np.ndarray, bounds: BoxBounds, target: np.ndarray) -> CachedBounds:
        return CachedBounds(bounds.lower, bounds.axis, (lower, upper), np.zeros(len(lower), dtype=bool))

    def too_small(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        return np.zeros(len(lower), dtype=bool)

    def holds(self, v: np.ndarray) -> np.ndarray:
        return np.ones(len(v), dtype=bool)


class ReachesTarget:
    """Looks whether ``f >= target`` on all positives.

    A positive with f under the target ends the search, and so does a box that is too small to be halved. Neither
    refutes the claim: only a positive that the deployed bounder denies does (``certify``). ``found`` holds minus the
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
        small = positives.too_small(low, high)  # of whole boxes, as the bounds are: ``held`` may cut parts off
        known = positives.held(low, high, bounds, np.full(len(unreached), target))
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
        suspects: Where f may lie under the target, candidates for a counterexample: points ``(S, n)`` in object space,
            or of planes coordinates v ``(S, n + 1)``. ``None`` if every bound reached the target.
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
    reached, not_reached = -end.found
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


def uncovered(domain: Domain) -> str:
    """A message if ``delta`` is less than the rounding on the way to v at a corner of the domain; empty if it is not.

    Three operations round: the point to float32, its difference to the centre, and the product with the scale.
    """
    center, scale = np.float64(domain.center), np.float64(domain.scale)
    needed = [UNIT32 * (np.abs(x) * scale + 2 * np.abs(x - center) * scale) for x in (domain.lower, domain.upper)]
    return "the domain's delta does not cover what float32 rounds" if (np.maximum(*needed) > domain.delta).any() else ""


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


def cover_planes(bounder: Bounder, shape: Shape) -> Covering:
    """Covers the planes that meet an object by boxes of their normals."""
    gap = SupportGap(bounder, shape)
    return Covering(PositivesOnly(gap), [(*gap.boxes(), 1.0)], lambda m, _: gap.touching(m))


def cover_domain(bounder: Bounder, shape: Shape) -> Covering:
    """Covers the points of a shape by the domain's box; suspects are points in object space."""
    positives = ShapePositives(bounder, shape, FINER * NARROWEST)

    def inside(v: np.ndarray, _: np.ndarray) -> np.ndarray:
        # at the end of a complement's domain a point may round to one beyond it, where the answer is maybe
        return bounder.domain.to_object(np.concatenate([v, v * INWARD]) if bounder.domain.unbounded else v)

    return Covering(positives, [(*positives.boxes(), 1.0)], inside)
