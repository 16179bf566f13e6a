"""Prove from scratch what a file claims, ``f >= threshold + E`` over all positives, in a loop of its own (``halving``).

It covers points cell by cell and planes by normals, and halves these covers until every bound reaches the target or a
counterexample is found. ``taylor`` bounds networks. A volume has one bound, here and there. Of a shape without cells it
halves the boxes that the shape does not certify to be empty. Of a distance it proves ``d - F >= threshold + E`` on the
whole domain, and that the object lies in it. A bounder whose method has no proof answers fresh positives (``stress``).
"""

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.bounders.distance import DistanceBounder
from warp_bounding.bounders.load import bounder_of
from warp_bounding.certificates import Certificate, conjunction, document
from warp_bounding.certificates.claim import OUTSIDE, as_fitted, in_local, mismatch, other_claim, outside
from warp_bounding.errors import BounderError, BoundingError, FileFormatError, ProofError
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.proof.distances import overestimate_within
from warp_bounding.proof.halving import Boxes, Checkpoint, Seen, search
from warp_bounding.proof.planes import SupportGap
from warp_bounding.proof.prove import TOUCHED, settle
from warp_bounding.proof.search import NARROWEST, CachedBounds, Search, ShapePositives
from warp_bounding.proof.stress import CONFIDENCE, POSITIVES, descend, fn_rate_bound, fresh_seed, try_positives
from warp_bounding.proof.taylor import TaylorBounds
from warp_bounding.queries import QUERIES, decision
from warp_bounding.queries.boundary import border_points
from warp_bounding.queries.domain import Domain
from warp_bounding.rounding import UNIT32, UNIT64
from warp_bounding.runtime.launch import cpu_threads, working_seconds
from warp_bounding.runtime.progress import Progress, reported
from warp_bounding.runtime.workers import Workers
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.shape import IN, Shape

PULL = 1e-4  # share of the way to its cell's centre: each suspect is also tried there, farther inside
LEAST_SECONDS = 1.0  # of a search for a counterexample where the proof has no decision
DENIED = "that meets the object is answered with no"
UNLIKE = "a part by itself denies a query that meets the object, and the whole does not"
AROUND = (0.0, 1e-6, 1e-5, 1e-4, 1e-3)  # distances in v from a suspect at which a counterexample is searched for
CHUNK = 16384  # boxes or cells of one step
TRIED = 512  # points of a chunk, those of the least f, that are tested for being positives
SUSPECTS = 1024  # points of least f that are tried as counterexamples
SMALLEST = 1e-9  # a box narrower than this, in the coordinates that f takes, ends the proof


class Checked(NamedTuple):
    """What a check has found.

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


def certify(
    bounder: Bounder,
    shape,
    *,
    margin: float | None = None,
    length: float | None = None,
    resolution: int | None = None,
    query: str | None = None,
    budget: float = 900.0,
    progress: Callable[[int, int], None] | None = None,
    checkpoint: str | os.PathLike | None = None,
    scheduler: str | int | None = None,
) -> Certificate:
    """Prove from scratch that a bounder has no false negative on a shape, or find out why there is no proof.

    A bounder's certificate names the margin, the length of rays and the resolution of a mesh that its claim is about.
    If you rely on one of these, state it here: a bounder that claims another one is then ``"inapplicable"``.

    Args:
        bounder: Its threshold and weights are taken as they are; its own certificate is ignored.
        shape: Any shape, or anything that ``load_shape`` takes; where the bounder is one of cells, the shape is divided
            into cells with the bounder's resolution and margin.
        margin: The margin that is expected, object units; the bounder's own if ``None``.
        length: The length of rays that is expected, object units; the bounder's own if ``None``.
        resolution: The resolution of a mesh that is expected; the bounder's own if ``None``.
        query: The kind of query that is expected; the bounder's own if ``None``.
        budget: Seconds allowed for all parts together; compiling kernels is not counted. Where they do not suffice, a
            search for a counterexample takes up to a quarter more.
        progress: Called with how much is done and how much there is; counts begin anew for each part of a conjunction.
        checkpoint: A file for the state of a proof that runs out of time or is stopped; the same call goes on from
            there. It is removed when the proof has ended. For proofs of one part, and not of functions: another
            function can have the same digest, so a checkpoint could go on for the wrong one.
        scheduler: Address of a Dask scheduler whose workers search, or a number of processes of this machine (then a
            script needs ``if __name__ == "__main__":``). The result is the same.

    Returns:
        A certificate of kind ``"proven"``; ``"statistical"`` (the method has no proof; fresh positives were queried,
        and none was denied); ``"refuted"`` (with a counterexample); ``"undecided"``; or ``"inapplicable"`` (the shape
        cannot be the bounded one, the claim is not the expected one, or the method is not conservative).

    Raises:
        BounderError: For an argument out of range, or a checkpoint of a proof of several parts.
        FileFormatError: For a checkpoint of another proof, or one that cannot be read or written.
        ShapeError: For a checkpoint of the proof for a function.

    Example:
        >>> wb.certify(bounder, grid).kind, wb.certify(bounder, grid, margin=0.5).kind
        ('proven', 'inapplicable')
    """
    _check_budget(budget)
    started, bounder = working_seconds(), bounder_of(bounder)
    frame = bounder.frame
    try:
        bounder, shape = in_local(bounder, shape)
    except BoundingError as error:
        return _inapplicable(bounder, shape, str(error))
    if frame is not None:
        own = {"margin": margin, "length": length, "resolution": resolution, "query": query}
        if fault := frame.fault(bounder):
            return _inapplicable(bounder, shape, fault)
        run = {"budget": budget, "progress": progress, "checkpoint": checkpoint, "scheduler": scheduler}
        return frame.noted(certify(bounder, shape, **own, **run))
    bounder, shape = TaylorBounds().given_to(bounder), TaylorBounds().given_to(shape)
    numbers = {"margin": margin, "length": length, "resolution": resolution}
    expected = {"query": query} | {name: _exactly(name, value) for name, value in numbers.items()}
    options = {"progress": progress, "scheduler": scheduler}
    if bounder.of_distances:
        return certify_distance(bounder, shape, expected, budget, checkpoint, options)
    other = other_claim(bounder, expected)
    try:
        grid = as_fitted(bounder, shape)
    except BoundingError as error:
        return _inapplicable(bounder, shape, other or str(error))
    reason = other or mismatch(bounder, grid)
    reason = reason or uncovered(bounder.domain.base)
    if not bounder.conservative:
        reason = f"{bounder.method} is not conservative"
    if reason and reason != OUTSIDE:
        return _inapplicable(bounder, grid, reason)
    if reason:  # the object reaches out of the domain, where the bounder answers before any part does
        point, threshold = _denied_outside(bounder, bounder, grid), float(bounder.threshold)
        kind, spent = "undecided" if point is None else "refuted", working_seconds() - started
        return document(bounder, grid, kind, threshold, threshold, 0, spent, OUTSIDE, point)
    if checkpoint is not None and len(bounder.parts) > 1:
        raise BounderError(f"{bounder.method}: a checkpoint is for a proof of one part, this has {len(bounder.parts)}")
    options["checkpoint"] = None if checkpoint is None else Checkpoint(checkpoint, bounder, grid)
    certificates = []
    for part in bounder.parts:
        left = budget - (working_seconds() - started)
        certificates.append(_certify(part, grid, max(left, 0.0), options, bounder))
        if certificates[-1].kind not in ("proven", "statistical"):
            break
    return conjunction(certificates)


def _check_budget(budget: float) -> None:
    """Raises ``BounderError`` if it is no number of seconds."""
    if isinstance(budget, bool) or not isinstance(budget, (int, float)) or not budget >= 0:
        raise BounderError(f"budget must be a number of at least 0, got {budget!r}")


def _exactly(name: str, value: float | None) -> float | None:
    """An expected number as an int or a float, not rounded: ``np.float32(0.1)`` does not match a claim of 0.1."""
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise BounderError(f"{name} must be a number, got {value!r}")
    return value if isinstance(value, int) else float(value)


def _certify(bounder: Bounder, grid: Grid, budget: float, options: dict, deployed: Bounder) -> Certificate:
    """``certify`` for one part of a conjunction; a counterexample is one only if ``deployed`` denies it."""
    started = working_seconds()
    threshold, target = float(bounder.threshold), _target(bounder)

    def result(status: str, message: str, bound: float, boxes: int = 0, counterexample=None) -> Certificate:
        spent = working_seconds() - started
        if counterexample is not None and deployed.query(np.float32(counterexample)[None]).numpy()[0]:
            status, message, counterexample = "undecided", UNLIKE, None
        return document(bounder, grid, status, threshold, bound, boxes, spent, message, counterexample)

    if reason := mismatch(bounder, grid):
        point = _denied_outside(deployed, bounder, grid) if reason == OUTSIDE else None
        return result("refuted" if point is not None else "undecided", reason, threshold, 0, point)
    if QUERIES[bounder.query_kind].is_region:
        return _certify_regions(bounder, grid, target, budget, result, options)
    if not grid.certified:
        return _statistical(bounder, grid, budget, result)
    if not isinstance(grid, Grid):
        grid.check()
        if bounder.exact_on_hull(grid):
            least, boxes = bounder.least(grid)
            if target <= least < np.inf:
                return result("proven", _proven(bounder), least, boxes)
    cover = _cells(bounder, grid) if isinstance(grid, Grid) else _points(bounder, grid)
    found = _checked(cover, target, budget, options)
    return _conclusion(bounder, grid, found, f"{budget:.3g} s{_goes_on(options)}", budget, result, deployed)


def _goes_on(options: dict) -> str:
    """What a message about time that ran out adds if there is a checkpoint."""
    return GOES_ON.format(options["checkpoint"].path) if options.get("checkpoint") else ""


def _conclusion(
    bounder: Bounder, grid: Shape, found: Checked, time: str, budget: float, result, deployed: Bounder
) -> Certificate:
    """The certificate for what a check has found; ``time`` says in words which budget it had."""
    least, boxes = found.least, found.boxes
    if not found.complete:
        denied = descend(deployed, grid, fresh_seed(), max(budget / 4, LEAST_SECONDS))[0]
        if len(denied):
            return result("refuted", f"a {bounder.query_kind} {DENIED}", least, boxes, denied[0])
        return result("undecided", f"no decision within {time}", least, boxes)
    if found.suspects is None:
        return result("proven", _proven(bounder), least, boxes)
    if (point := _denied(deployed, grid, found.suspects)) is not None:
        return result("refuted", f"a {bounder.query_kind} {DENIED}", least, boxes, point)
    return result(
        "undecided", "f comes closer to the threshold than the proof's margins for rounding allow", least, boxes
    )


def _certify_regions(bounder: Bounder, grid: Grid, target: float, budget: float, result, options: dict) -> Certificate:
    """``certify`` for rays, planes and boxes."""
    least, boxes, suspects, complete = Checked(-np.inf, 0)
    text = "f comes closer to the threshold than the proof allows"
    try:
        if bounder.exact_on_cells:
            least, boxes = bounder.least(grid)
        else:
            least, boxes, suspects, complete = _checked(_planes(bounder, grid), target, budget, options)
    except BounderError as error:  # the volume does not hold the object, or numbers leave the range of the proof
        text = str(error)
    if target <= least < np.inf:  # infinity: no positive was looked at, which proves nothing
        return result("proven", _proven(bounder), least, boxes)
    missed = None if suspects is None else _denied_region(bounder, grid, suspects)
    if missed is None:
        missed = try_positives(bounder, grid, POSITIVES, fresh_seed(), budget=max(budget, LEAST_SECONDS))[2]
    if missed is not None:
        return result("refuted", f"a query {DENIED}", least, boxes, missed)
    text = text if complete else f"no decision within {budget:.3g} s{_goes_on(options)}"
    return result("undecided", text, least, boxes)


def _statistical(bounder: Bounder, grid: Grid, budget: float, result) -> Certificate:
    """A statistical certificate by fresh positives, where there is no proof."""
    done, lowest, missed = try_positives(bounder, grid, POSITIVES, fresh_seed(), budget=budget)
    if missed is not None:
        return result("refuted", f"a query {DENIED}", lowest, 0, missed)
    if not done:
        return result("undecided", f"no positive could be queried within {budget:g} s", float(bounder.threshold))
    rate = fn_rate_bound(done)
    text = (
        f"Statistical, not proven: {done:,} fresh positives, none answered with no; at {CONFIDENCE:.0%} confidence "
        f"fewer than {rate:.2g} of such queries are missed."
    )
    certificate = result("statistical", text, lowest)
    margin = lowest - float(bounder.threshold)
    return replace(certificate, samples=done, fn_rate_bound=rate, confidence=CONFIDENCE, worst_margin=margin)


def _denied_region(bounder: Bounder, grid: Grid, v: np.ndarray) -> np.ndarray | None:
    """A float32 query at or close to coordinates ``v`` that meets the object and that the deployed bounder denies."""
    truth = decision(bounder.query_kind, grid, bounder.device, bounder.domain.oracle_length)
    rng = np.random.default_rng(0)
    for step in AROUND:
        x = bounder.domain.to_object(v + step * rng.uniform(-1, 1, v.shape)).astype(np.float32)
        missed = np.flatnonzero(~bounder.query(x).numpy() & (truth(x) == IN))
        if len(missed):
            return x[missed[0]]
    return None


def _denied(bounder: Bounder, grid: Grid, x: np.ndarray) -> np.ndarray | None:
    """The first of these points, as float32, that lies in the object and that the deployed bounder denies."""
    x = np.asarray(x, dtype=np.float64).astype(np.float32)
    x = x[grid.contains(x)]
    if not len(x):
        return None
    missed = np.flatnonzero(~bounder.query(x).numpy())
    return x[missed[0]] if len(missed) else None


def _denied_outside(deployed: Bounder, bounder: Bounder, grid: Shape) -> np.ndarray | None:
    """A denied point of the object outside the bounder's domain; ``None`` for regions, or if none is found."""
    return None if QUERIES[bounder.query_kind].is_region else _denied(deployed, grid, points_outside(bounder, grid))


def _proven(bounder: Bounder) -> str:
    """The first sentence of a certificate."""
    return f"Proven from scratch: every {QUERIES[bounder.query_kind].positive} is answered with maybe."


def _inapplicable(bounder: Bounder, shape, reason: str) -> Certificate:
    certificate = document(bounder, None, "inapplicable", float(bounder.threshold), 0.0, 0, 0.0, reason)
    return replace(certificate, indicator=getattr(shape, "digest", ""))


# --- the loop --------------------------------------------------------------------------------------------------------


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


class _Positives:
    """A look that decides whether ``f >= target`` on all positives.

    A positive with f under the target ends the search, and so does a box that is too small to be halved. Neither
    refutes the claim: only a positive that the deployed bounder denies does (``certify``). ``found`` holds minus the
    least lower bound of the boxes that reach the target, and minus that of the others.

    Args:
        positives: Bounds f over boxes, and knows where positives are.
        target: What every lower bound must reach.
    """

    chunk = CHUNK

    def __init__(self, positives: PositivesOnly | ShapePositives, target: float):
        self.positives, self.target = positives, target

    def __call__(self, boxes: Boxes) -> Seen:
        positives, target, (low, high) = self.positives, self.target, boxes[:2]
        bounds = positives.bound(low, high)
        reached = bounds.lower >= target
        least = bounds.lower[reached].min(initial=np.inf)
        left = np.flatnonzero(~reached)  # NaN has not reached it
        low, high, bounds = low[left], high[left], bounds.part(left)
        small = positives.too_small(low, high)  # of whole boxes, as the bounds are: ``held`` may cut parts off
        found = positives.held(low, high, bounds, np.full(len(left), target))
        open_ = ~(found.lower >= target)
        least = min(least, found.lower[~open_].min(initial=target if found.cut.any() else np.inf))
        low, high = (np.asarray(corner)[open_] for corner in found.corners)
        axis, bounds, small = found.axis[open_].astype(np.int64), bounds.part(open_), small[open_]
        failed = small | ((high - low)[np.arange(len(low)), axis] < SMALLEST)
        lowest = np.argpartition(bounds.value, TRIED)[:TRIED] if len(low) > TRIED else np.arange(len(low))
        lowest = lowest[bounds.value[lowest] < target]
        failed[lowest] |= positives.holds(bounds.point[lowest])
        rest, suspects = boxes.part(left[open_])._replace(lower=low, upper=high), None
        if failed.any():
            order = np.lexsort((bounds.value, ~failed))[:SUSPECTS]
            at = np.concatenate([bounds.point[order], (low + high)[order] / 2])
            suspects = at, np.tile(rest.owner[order], 2)
            least = np.fmin(least, np.fmin.reduce(np.concatenate([bounds.lower[failed], bounds.value[failed]])))
        least = np.array([least, np.fmin.reduce(bounds.lower, initial=np.inf)])
        return Seen(rest.halves(axis), np.arange(2), -least, suspects)


class Cover(NamedTuple):
    """Boxes that cover all positives of an object."""

    positives: PositivesOnly | ShapePositives
    starts: Iterable[tuple[np.ndarray, np.ndarray, float]]  # as ``halving.search`` takes them
    at: Callable[[np.ndarray, np.ndarray], np.ndarray]  # ``Checked.suspects`` of coordinates and owners of boxes


def _checked(cover: Cover, target: float, budget: float, options: dict) -> Checked:
    """Check that ``f >= target`` on all positives, until that fails or time is over; ``options`` are the search's."""
    left = search(_Positives(cover.positives, target), cover.starts, np.full(2, -np.inf), budget=budget, **options)
    reached, not_reached = -left.found
    if left.failed is not None:
        return Checked(float(reached), left.boxes, cover.at(*left.failed))
    return Checked(float(reached if left.complete else np.fmin(reached, not_reached)), left.boxes, None, left.complete)


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


def _cells(f: Bounder, grid: Grid) -> Cover:
    """Covers every v that the pipeline can make of points of the object's cells; suspects are points of the object."""

    def corners(some) -> tuple[np.ndarray, np.ndarray]:
        return grid.position(grid.occupied[some] - 0.5), grid.position(grid.occupied[some] + 0.5)

    def starts() -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
        for start in range(0, len(grid.occupied), CHUNK):
            boxes = reachable(f.domain, *corners(slice(start, start + CHUNK)))
            yield *boxes, CHUNK / max(len(grid.occupied), CHUNK)

    def inside(v: np.ndarray, box: np.ndarray) -> np.ndarray:
        first, last = corners(box)
        x = np.clip(f.domain.to_object(v), first, last)  # boxes of v are wider than cells, by delta
        # rounded to float32, a point of a corner may lie outside its cell
        return np.concatenate([x, x + PULL * ((first + last) / 2 - x)])

    return Cover(PositivesOnly(f), starts(), inside)


def _planes(bounder: Bounder, shape: Shape) -> Cover:
    """Covers the planes that meet an object by boxes of their normals."""
    gap = SupportGap(bounder, shape)
    return Cover(PositivesOnly(gap), [(*gap.boxes(), 1.0)], lambda m, _: gap.touching(m))


# --- shapes without cells --------------------------------------------------------------------------------------------


FINER = 1 / 8  # times the fit's smallest box: the size at which a box counts as object here
BORDER = 65_536  # points of the border among which some outside the domain are looked for
INWARD = 1 - 1e-3  # of the way from the domain's middle to a suspect: it is tried there, too


def points_outside(bounder: Bounder, shape: Shape) -> np.ndarray:
    """``(N, n)`` points in object space: those that may be in the object and outside the bounder's domain."""
    if isinstance(shape, Grid):
        return shape.position(outside(bounder, shape))
    domain, x = bounder.domain.base, border_points(shape, BORDER, np.random.default_rng(0))
    return x[((x < domain.lower) | (x > domain.upper)).any(axis=1)]


def _points(bounder: Bounder, shape: Shape) -> Cover:
    """Covers the points of a shape by the domain's box; suspects are points in object space."""
    positives = ShapePositives(bounder, shape, FINER * NARROWEST)

    def inside(v: np.ndarray, _: np.ndarray) -> np.ndarray:
        # at the end of a complement's domain a point may round to one beyond it, where the answer is maybe
        return bounder.domain.to_object(np.concatenate([v, v * INWARD]) if bounder.domain.unbounded else v)

    return Cover(positives, [(*positives.boxes(), 1.0)], inside)


# --- from a statistical threshold to a proven one ---------------------------------------------------------------------


# The shares of queries that lower thresholds answer with maybe, where the bounder's own threshold answers no.
LOWER = [[0, 1 / 64, 1 / 32, 1 / 16], np.arange(1 / 8, 2, 1 / 8), np.arange(2, 4, 1 / 4), np.arange(4, 8)]
LOWER = np.concatenate([*LOWER, np.arange(8, 96, 4)]) / 100
DRAWN = 1 << 16  # random queries that these shares are measured on
USEFUL = 0.1  # of the free queries: a threshold that denies fewer is not tried
FOLLOWED = 8192  # boxes of each generation that an estimate follows at most
ESTIMATE_SHARE = 0.02  # of the time that is left, for an estimate; about GENERATIONS an axis share it
FEWEST, GENERATIONS = 512, 10
PLANNED = 0.8  # of the budget: what a proof may be expected to take


def make_proven(
    bounder: Bounder,
    shape,
    *,
    budget: float = 3600.0,
    scheduler: str | int | None = None,
    checkpoint: str | os.PathLike | None = None,
    progress: Progress | bool | None = None,
) -> Bounder:
    """A copy of a bounder with a statistical threshold, at a lower threshold that is proven.

    A lower threshold has a shorter proof and more false positives. Before a proof begins, an unbiased estimate says how
    long it takes. The threshold is lowered as little as that estimate allows within the budget.

    Args:
        bounder: One network that bounds points of a shape without cells, such as an arm's configurations; not changed.
        shape: As ``certify`` takes it.
        budget: Seconds for estimates and proof.
        scheduler: As ``certify`` takes it; the estimate counts on the workers that an address has now.
        checkpoint: As ``certify`` takes it: the same call goes on from there, with the threshold that was chosen.
        progress: As ``fit`` takes it.

    Returns:
        A new bounder with its certificate.

    Raises:
        ProofError: If no proof that denies a tenth of the free queries is expected to end in time, time runs out, or a
            proof fails at every threshold.
        BounderError: If the bounder is no such network.
        FileFormatError: For a checkpoint of another proof, or one that cannot be read or written.
        ShapeError: For a checkpoint of the proof for a function.

    Example:
        >>> ball = wb.shapes.Function(None, [-1, -1], [1, 1], distance=lambda x: np.linalg.norm(x, axis=1) - 0.9)
        >>> network = wb.fit(ball, hidden=(8, 8), steps=100, statistical=True, device="cpu", progress=False)
        >>> wb.proof.make_proven(network, ball, budget=60.0).certificate.kind
        'proven'
    """
    _check_budget(budget)
    bounder = bounder_of(bounder)
    frame = bounder.frame
    bounder, shape = in_local(bounder, shape)
    grid = as_fitted(bounder, shape)
    if reason := mismatch(bounder, grid) or uncovered(bounder.domain.base):
        raise BounderError(f"{bounder.method}: {reason}")
    if isinstance(grid, Grid) or bounder.query_kind != "point" or len(bounder.parts) > 1:
        raise BounderError(f"{bounder.method}: expected a bounder of points of a shape without cells, in one part")
    if not (bounder.conservative and grid.certified):
        raise BounderError(f"{bounder.method}: {grid.name} or the method has no proof")
    if checkpoint is not None:
        grid.expect_identified("a checkpoint")
    grid.check()
    with reported(progress, f"prove {bounder.method}") as update:
        limits = {"budget": budget, "scheduler": scheduler, "checkpoint": checkpoint, "progress": update}
        try:
            return prove_lower(bounder, grid, **limits).in_frame(frame)
        except ProofError as error:
            error.bounder = bounder.in_frame(frame)
            raise


def prove_lower(
    bounder: Bounder,
    grid: Shape,
    *,
    budget: float = float("inf"),
    boxes: float = float("inf"),
    scheduler: str | int | None = None,
    checkpoint: str | os.PathLike | None = None,
    progress: Callable[..., None] | None = None,
) -> Bounder:
    """``make_proven`` of a bounder in its shape's frame; ``boxes`` limit the proof where no clock may."""
    end, lowered = working_seconds() + budget, TaylorBounds().given_to(_lowered(bounder, grid))
    grid = TaylorBounds().given_to(grid)
    if checkpoint is not None and os.path.exists(checkpoint):
        index = _begun(lowered, grid, checkpoint)
    else:
        try:
            index = _planned(lowered, grid, end, boxes, scheduler)
        except ProofError as error:
            error.bounder = bounder
            raise
    lowest = np.inf  # f of a positive
    for lower in lowered[index:]:
        if _target(lower) > lowest:
            continue
        options = {"progress": progress, "scheduler": scheduler, "most": boxes}
        options["checkpoint"] = None if checkpoint is None else Checkpoint(checkpoint, lower, grid)
        started, left = working_seconds(), max(end - working_seconds(), 0.0)
        found = _checked(_points(lower, grid), _target(lower), left, options)
        if not found.complete:
            within = f"{budget:.3g} s" if budget < np.inf else f"{boxes:,.0f} boxes"
            raise ProofError(f"{bounder.method}: no decision within {within}{_goes_on(options)}", bounder)
        if found.suspects is None:
            spent, none = working_seconds() - started, np.empty((0, grid.ndim))
            proven = bounder.to()
            settle(proven, grid, Search(found.least, found.least, none, found.boxes, spent, True))
            proven.info = bounder.info | {"rates": None}
            return proven
        positive = found.suspects[grid.contains(found.suspects)]
        values = bounder.reference(bounder.domain.to_local(positive))
        lowest = min(lowest, float(values.min(initial=np.inf)))
    raise ProofError(f"{bounder.method}: the proof fails at each threshold that was tried; train it longer", bounder)


def _target(bounder: Bounder) -> float:
    """What lower bounds of f must reach: at least the exact sum of the threshold and the rounding bound E."""
    return float(np.nextafter(float(bounder.threshold) + bounder.rounding_bound(), np.inf))


def _lowered(bounder: Bounder, shape: Shape) -> list[Bounder]:
    """The bounder, and others at lower thresholds that answer more queries with maybe, by the shares in ``LOWER``.

    Each of them denies the share ``USEFUL`` of the free queries; or half of what the bounder does, where that is less.
    """
    x = np.random.default_rng(0).uniform(shape.lower, shape.upper, (DRAWN, shape.ndim)).astype(np.float32)
    values, now = bounder.values(x).numpy(), float(bounder.threshold)
    denied = np.sort(values[values < now])[::-1]
    most = len(denied) - min(USEFUL * np.count_nonzero(~shape.contains(x)), len(denied) / 2)
    lower = (float(denied[place]) for place in (LOWER[1:] * DRAWN).astype(int) if place < most)
    return [bounder.to().freeze(threshold, None) for threshold in (now, *lower)]


def _begun(lowered: list[Bounder], shape: Shape, checkpoint: str | os.PathLike) -> int:
    """The index of the bounder that the checkpoint is about; raises ``FileFormatError`` if it is about none."""
    for index, bounder in enumerate(lowered):
        try:
            Checkpoint(checkpoint, bounder, shape)
        except FileFormatError as error:
            reason = error
        else:
            return index
    raise reason


def _planned(lowered: list[Bounder], shape: Shape, end: float, boxes: float, scheduler: str | int | None) -> int:
    """The index of the first bounder (highest threshold) whose proof is expected to end in time, by bisection.

    ``end`` is by ``working_seconds``. Raises ``ProofError`` if there is none.
    """
    cores = cpu_threads() if scheduler is None else scheduler
    if not isinstance(cores, int) or isinstance(cores, bool) or cores < 1:  # an address, or what is refused
        with Workers(cores) as workers:
            cores = workers.count
    first, last = 0, len(lowered)
    while first < last:
        middle, left = (first + last) // 2, max(end - working_seconds(), 0.0)
        count, pace = _expected(lowered[middle], shape, ESTIMATE_SHARE * left)
        pace *= cpu_threads() / cores
        fits = count <= PLANNED * boxes and count * pace <= PLANNED * (end - working_seconds())
        first, last = (first, middle) if fits else (middle + 1, last)
    method = lowered[0].method
    if first == len(lowered) and count == np.inf:
        raise ProofError(f"{method}: the proof fails at each threshold that was tried; is {shape.name} its shape?")
    if first == len(lowered):
        time = f"{left:.3g} s" if left < np.inf else f"{boxes:,.0f} boxes"
        expected = f"about {count * pace:.3g} s, {count:.3g} boxes, on {cores} cores"
        raise ProofError(
            f"{method}: no useful proof of {shape.name} is expected within {time}; that of the lowest threshold that "
            f"denies {USEFUL:.0%} of what is free takes {expected}. Give a larger budget= or more workers "
            "(scheduler=), or take a threshold from samples (statistical=True)",
            seconds=count * pace,
        )
    return first


def _expected(bounder: Bounder, shape: Shape, seconds: float) -> tuple[float, float]:
    """How many boxes a proof looks at, an unbiased estimate, and seconds of each on this machine.

    Infinitely many if the proof is seen to fail. The estimate follows a random part of each generation of boxes, and
    takes about some ``seconds``. Source: D. E. Knuth, "Estimating the Efficiency of Backtrack Programs" (1975).
    """
    bounder, rng = TaylorBounds().given_to(bounder), np.random.default_rng(0)
    positives = ShapePositives(bounder, shape, FINER * NARROWEST)
    look = _Positives(positives, _target(bounder))
    lower, upper = positives.boxes()
    counts = np.arange(len(lower)), np.zeros(len(lower), np.int64)
    boxes, weight, expected, looked, started = Boxes(lower, upper, *counts, 0.0), 1.0, 0.0, 0, working_seconds()
    while boxes.count:
        left, _, _, failed = look(boxes)
        expected, looked = expected + weight * boxes.count, looked + boxes.count
        pace = (working_seconds() - started) / looked
        if failed is not None:
            return np.inf, pace
        followed = FOLLOWED
        if seconds < np.inf:
            followed = int(np.clip(seconds / (GENERATIONS * shape.ndim * max(pace, 1e-9)), FEWEST, FOLLOWED))
        if left.count > followed:
            weight *= left.count / followed
            left = left.part(rng.choice(left.count, followed, replace=False))
        boxes = left
    return expected, pace


# --- distances -------------------------------------------------------------------------------------------------------


LOOSE = "the threshold does not cover what float32 rounds"
GOES_ON = "; the same command goes on from {}"
CLOSE = "F comes closer to the distance than the proof allows"


def certify_distance(
    bounder: DistanceBounder,
    shape,
    expected: dict[str, str | float | None],
    budget: float,
    checkpoint: str | os.PathLike | None,
    options: dict,
) -> Certificate:
    """``certify`` of a distance.

    Args:
        bounder: Its threshold and numbers are taken as they are; its own certificate is ignored.
        shape: As ``certify`` takes it.
        expected: The claim that is expected (``other_claim``).
        budget: Seconds allowed.
        checkpoint: As ``certify`` takes it.
        options: ``progress`` and ``scheduler``, as ``certify`` takes them.
    """
    started, threshold, error = working_seconds(), float(bounder.threshold), bounder.rounding_bound()
    before = 0.0  # seconds that the search took before the checkpoint
    if checkpoint is not None and bounder.volume is not None:
        raise BounderError(
            f"{bounder.method}: a checkpoint is for a distance that is searched for; this proof is short"
        )
    other = other_claim(bounder, expected)
    try:
        grid = as_fitted(bounder, shape)
        reason = other or mismatch(bounder, grid)
    except BoundingError as error:
        grid, reason = shape, other or str(error)
    if reason and reason != OUTSIDE:
        found = document(bounder, None, "inapplicable", threshold, 0.0, 0, 0.0, reason)
        return replace(found, indicator=getattr(grid, "digest", ""))

    def result(status: str, message: str, least: float, boxes: int = 0, counterexample=None) -> Certificate:
        spent = before + working_seconds() - started
        return document(bounder, grid, status, threshold, least, boxes, spent, message, counterexample)

    if reason:
        point = _overestimated(bounder, grid, points_outside(bounder, grid))
        return result("undecided" if point is None else "refuted", OUTSIDE, threshold, 0, point)
    if bounder.volume is not None:
        volume = bounder.volume.to()
        volume.info = {name: bounder.info.get(name) for name in ("margin", "resolution")}
        of_volume = certify(volume, grid, budget=budget, **options)
        suspects = None if of_volume.counterexample is None else np.array([of_volume.counterexample])
        least, boxes, message = (0.0 if of_volume.proven else -np.inf), of_volume.boxes, of_volume.message
    else:
        held = options["checkpoint"] = None if checkpoint is None else Checkpoint(checkpoint, bounder, grid)
        bar = -float(np.nextafter(threshold + error, np.inf))
        overestimate, boxes, complete, suspects = overestimate_within(bounder, grid, bar, budget, **options)
        least, before = -overestimate, held.seconds if held else 0.0
        message = CLOSE if complete else f"no decision within {budget:.3g} s{_goes_on(options)}"
    if threshold <= 0 and float(np.nextafter(threshold + error, np.inf)) <= least < np.inf:
        message = f"Proven from scratch: the distance is never overestimated{TOUCHED if grid.time else ''}."
        return result("proven", message, least, boxes)
    point = None if suspects is None else _overestimated(bounder, grid, suspects)
    if point is not None:
        return result("refuted", "a distance is overestimated", least, boxes, point)
    return result("undecided", LOOSE if least == 0 else message, least, boxes)


def _overestimated(bounder: DistanceBounder, shape: Shape, x: np.ndarray) -> np.ndarray | None:
    """The first of these points, as float32, whose distance the deployed bounder overestimates for certain."""
    x = np.asarray(x, dtype=np.float64).astype(np.float32)
    if not len(x):
        return None
    g, known = bounder.distance(x).numpy().astype(np.float64), shape.distances(x)
    above = (g > 0) & (shape.decide(x) == IN)
    if known is not None:
        above |= g > known[:, 1]
    missed = np.flatnonzero(above)
    return x[missed[0]] if len(missed) else None
