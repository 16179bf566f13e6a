"""Proving from scratch what a file claims: ``f >= threshold + E`` over all positives, by its own loop (``_halved``).

Points are taken cell by cell, rays face by face, boxes from all pairs of corners, and halved until every bound reaches
the target or a counterexample is found. Networks are bounded by ``taylor``, which shares nothing with the bounds of the
search but the parametrizations of rays and boxes; volumes have one bound each. Of shapes without cells it halves what
they do not certify to be empty. Of a distance it proves ``d - F >= threshold + E`` on the whole domain, and that the
object lies in it. A bounder whose method has no proof is asked fresh positives (``stress``).
"""

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.bounders.distance import DistanceBounder
from warp_bounding.bounders.load import bounder_of
from warp_bounding.certificates import Certificate, document, together
from warp_bounding.certificates.claim import OUTSIDE, as_fitted, in_local, mismatch, other_claim, outside
from warp_bounding.errors import BounderError, BoundingError, FileFormatError
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.proof.covers import COVERS
from warp_bounding.proof.distances import overestimate_within
from warp_bounding.proof.halving import Boxes, Checkpoint, Seen, search
from warp_bounding.proof.prove import TOUCHED, ShapeRegions, coarse_cells, parametrized, settle
from warp_bounding.proof.search import NARROWEST, CachedBounds, Search, ShapePositives
from warp_bounding.proof.stress import CONFIDENCE, POSITIVES, descend, fn_rate_bound, fresh_seed, try_positives
from warp_bounding.proof.taylor import taylor_bounds
from warp_bounding.queries import QUERIES, decision
from warp_bounding.queries.boundary import border_points
from warp_bounding.queries.domain import Domain
from warp_bounding.rounding import UNIT32, UNIT64
from warp_bounding.runtime.launch import cpu_threads, working_seconds
from warp_bounding.runtime.workers import Workers
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.shape import IN, Shape

PULL = 1e-4  # of the way to its cell's centre, by which each suspect is also tried farther inside
LEAST_SECONDS = 1.0  # for positives that may refute what the proof could not decide
DENIED = "that meets the object is answered with no"
GRANTED = "a part denies a query that meets the object, which an exit before it grants"
AROUND = (0.0, 1e-6, 1e-5, 1e-4, 1e-3)  # distances in v from a suspect at which a true counterexample is looked for
CHUNK = 16384  # boxes or cells that are taken at a time
TRIED = 512  # of a chunk's points, those of the least f: only these are tested for being positives
SUSPECTS = 1024  # low points that are tried as counterexamples
SMALLEST = 1e-9  # width, in the coordinates that f takes, under which a box is not halved any more


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


@taylor_bounds()
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
    """Prove from scratch that a bounder has no false negative on a shape, or find out why that is not so.

    A bounder itself says which margin, which length of rays and which resolution of a mesh its claim is about; its
    certificate names them. If you rely on one of these, state it here: a proof of another claim is then not accepted.

    Args:
        bounder: Its threshold and weights are taken as they are; its own certificate is not looked at.
        shape: A ``Grid`` or ``Mesh``, or anything that ``load_shape`` takes; voxelised with the
            bounder's own resolution and margin.
        margin: The margin that is expected, object units; the bounder's own if ``None``.
        length: The length of rays that is expected, object units; the bounder's own if ``None``.
        resolution: The resolution of a mesh that is expected; the bounder's own if ``None``.
        query: The kind of query that is expected; the bounder's own if ``None``.
        budget: Seconds allowed for all parts together; compiling kernels is not counted. Where they do not suffice, a
            search for a counterexample takes up to a quarter more.
        progress: Called with what is done and how much there is; counts begin anew for each part of a conjunction.
        checkpoint: A file that holds what is left of a proof whose time was over, or that was stopped; the same call
            goes on from there. It is removed when the proof has ended. For proofs of one part.
        scheduler: Address of a Dask scheduler whose workers search, or a number of processes of this machine, in a
            script behind ``if __name__ == "__main__":``. The result is the same.

    Returns:
        A certificate of kind ``"proven"``; ``"statistical"`` (the method has no proof; fresh positives were queried,
        and none was denied); ``"refuted"`` (with a counterexample); ``"undecided"``; or ``"inapplicable"`` (the shape
        cannot be the bounded one, the claim is not the expected one, or the method is not conservative).

    Example:
        >>> wb.certify(bounder, grid).kind, wb.certify(bounder, grid, margin=0.5).kind
        ('proven', 'inapplicable')
    """
    if isinstance(budget, bool) or not isinstance(budget, (int, float)) or not budget >= 0:
        raise BounderError(f"budget must be a number of at least 0, got {budget!r}")
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
    numbers = {"margin": margin, "length": length, "resolution": resolution}
    expected = {"query": query} | {name: _exactly(name, value) for name, value in numbers.items()}
    told = {"progress": progress, "scheduler": scheduler}
    if bounder.of_distances:
        return certify_distance(bounder, shape, expected, budget, checkpoint, told)
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
    try:
        obligations = bounder.obligations(grid)
    except BoundingError as error:
        return document(bounder, grid, "undecided", float(bounder.threshold), 0.0, 0, 0.0, str(error))
    if reason:  # outside its own domain no part of it is asked
        point, threshold = _denied_outside(bounder, bounder, grid), float(bounder.threshold)
        kind, spent = "undecided" if point is None else "refuted", working_seconds() - started
        return document(bounder, grid, kind, threshold, threshold, 0, spent, OUTSIDE, point)
    if checkpoint is not None and (len(obligations) > 1 or not bounder.provable):
        raise BounderError(f"{bounder.method}: a checkpoint is for a proof of one part, this has {len(obligations)}")
    told["checkpoint"] = None if checkpoint is None else Checkpoint(checkpoint, bounder, grid)
    certificates = []
    for part, own in obligations:
        left = budget - (working_seconds() - started)
        # what a network's exit grants, no part of it can deny
        asked = part if bounder.composed else bounder
        certificates.append(_certify(part, own, max(left, 0.0), told, asked))
        if certificates[-1].kind not in ("proven", "statistical"):
            break
    return together(bounder, certificates, grid.digest)


def _exactly(name: str, value: float | None) -> float | None:
    """An expected number as an int or a float, not rounded: ``np.float32(0.1)`` is another claim than 0.1."""
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise BounderError(f"{name} must be a number, got {value!r}")
    return value if isinstance(value, int) else float(value)


def _certify(bounder: Bounder, grid: Grid, budget: float, told: dict, asked: Bounder) -> Certificate:
    """``certify`` for one part of a conjunction; ``asked`` is who must deny a counterexample."""
    started = working_seconds()
    threshold, target = float(bounder.threshold), _target(bounder)

    def result(status: str, message: str, bound: float, boxes: int = 0, counterexample=None) -> Certificate:
        spent = working_seconds() - started
        if counterexample is not None and asked.query(np.float32(counterexample)[None]).numpy()[0]:
            status, message, counterexample = "undecided", GRANTED, None
        return document(bounder, grid, status, threshold, bound, boxes, spent, message, counterexample)

    if len(bounder.parts) > 1:  # its parts are proven one by one (``Bounder.obligations``), never as a whole
        return result("undecided", f"{bounder.method}: a part of several tests", threshold)
    if reason := mismatch(bounder, grid):
        point = _denied_outside(asked, bounder, grid) if reason == OUTSIDE else None
        return result("refuted" if point is not None else "undecided", reason, threshold, 0, point)
    if QUERIES[bounder.query_kind].is_region:
        return _certify_regions(bounder, grid, target, budget, result, told)
    if not grid.certified:
        return _attested(bounder, grid, budget, result)
    if not isinstance(grid, Grid):
        grid.check()
        if bounder.exact_on_hull(grid):
            least, boxes = bounder.least(grid)
            if target <= least < np.inf:
                return result("proven", _proven(bounder), least, boxes)
    cover = _cells(bounder, grid) if isinstance(grid, Grid) else _points(bounder, grid)
    found = _checked(cover, target, budget, told)
    return _conclusion(bounder, grid, found, f"{budget:.3g} s{_goes_on(told)}", budget, result, asked)


def _goes_on(told: dict) -> str:
    """Of a proof whose time was over."""
    return GOES_ON.format(told["checkpoint"].path) if told.get("checkpoint") else ""


def _conclusion(
    bounder: Bounder, grid: Shape, found: Checked, time: str, budget: float, result, asked: Bounder
) -> Certificate:
    """The certificate for what a check has found; ``time`` is what it had."""
    least, boxes = found.least, found.boxes
    if not found.complete:
        denied = descend(asked, grid, fresh_seed(), max(budget / 4, LEAST_SECONDS))[0]
        if len(denied):
            return result("refuted", f"a {bounder.query_kind} {DENIED}", least, boxes, denied[0])
        return result("undecided", f"no decision within {time}", least, boxes)
    if found.suspects is None:
        return result("proven", _proven(bounder), least, boxes)
    if (point := _denied(asked, grid, found.suspects)) is not None:
        return result("refuted", f"a {bounder.query_kind} {DENIED}", least, boxes, point)
    return result(
        "undecided", "f comes closer to the threshold than the proof's margins for rounding allow", least, boxes
    )


def _certify_regions(bounder: Bounder, grid: Grid, target: float, budget: float, result, told: dict) -> Certificate:
    """``certify`` for rays, planes and boxes."""
    if not bounder.provable:
        return _attested(bounder, grid, budget, result)
    kind = COVERS[bounder.query_kind]
    least, boxes, suspects, complete = Checked(-np.inf, 0)
    text = "f comes closer to the threshold than the proof allows"
    try:
        if bounder.exact_on_cells:
            least, boxes = bounder.least(grid)
        elif not isinstance(grid, Grid) and kind.pieces:
            grid.check()
            least, boxes, suspects, complete = _checked(_regions(bounder, grid), target, budget, told)
        else:
            least, boxes, suspects, complete = _checked(_parametrized(bounder, grid), target, budget, told)
    except BounderError as error:  # of this object: a volume does not hold it, or numbers leave the range of the proof
        text = str(error)
    if target <= least < np.inf:  # infinity: no positive was looked at, which proves nothing
        return result("proven", _proven(bounder), least, boxes)
    missed = None if suspects is None else _denied_region(bounder, grid, suspects)
    if missed is None:
        missed = try_positives(bounder, grid, POSITIVES, fresh_seed(), budget=max(budget, LEAST_SECONDS))[2]
    if missed is not None:
        return result("refuted", f"a query {DENIED}", least, boxes, missed)
    text = text if complete else f"no decision within {budget:.3g} s{_goes_on(told)}"
    least = max(least, -float(np.finfo(np.float32).max))  # JSON has no infinity
    return result("undecided", text, least, boxes)


def _attested(bounder: Bounder, grid: Grid, budget: float, result) -> Certificate:
    """What fresh positives tell where there is no proof."""
    done, lowest, missed = try_positives(bounder, grid, POSITIVES, fresh_seed(), budget=budget)
    if missed is not None:
        return result("refuted", f"a query {DENIED}", lowest, 0, missed)
    if not done:
        return result("undecided", f"no positive could be asked within {budget:g} s", float(bounder.threshold))
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
        missed = np.flatnonzero((bounder.query(x).numpy() == 0) & (truth(x) == IN))
        if len(missed):
            return x[missed[0]]
    return None


def _denied(bounder: Bounder, grid: Grid, x: np.ndarray) -> np.ndarray | None:
    """The first of these points, as float32, that lies in the object and that the deployed bounder denies.

    A bounder of boxes is asked about a box that is no more than the point.
    """
    x = np.asarray(x, dtype=np.float64).astype(np.float32)
    x = x[grid.contains(x)]
    if not len(x):
        return None
    x = COVERS[bounder.query_kind].at_points(x, bounder)
    missed = np.flatnonzero(bounder.query(x).numpy() == 0)
    return x[missed[0]] if len(missed) else None


def _denied_outside(asked: Bounder, bounder: Bounder, grid: Shape) -> np.ndarray | None:
    """A point of the object outside of a bounder's domain that it denies; ``None`` for regions, or if none is found."""
    return None if QUERIES[bounder.query_kind].is_region else _denied(asked, grid, points_outside(bounder, grid))


def _proven(bounder: Bounder) -> str:
    """The first sentence of a certificate."""
    return f"Proven from scratch: every {QUERIES[bounder.query_kind].positive} is answered with maybe."


def _inapplicable(bounder: Bounder, shape, reason: str) -> Certificate:
    certificate = document(bounder, None, "inapplicable", float(bounder.threshold), 0.0, 0, 0.0, reason)
    return replace(certificate, indicator=getattr(shape, "digest", ""))


# --- the loop --------------------------------------------------------------------------------------------------------


class Everything:
    """Boxes all of whose points come from positives, as ``ShapePositives`` tells of a shape.

    Args:
        f: What is bounded: a bounder, ``SupportGap``, or ``ChartedPositives``, whose bounds are about the
            boxes that the parametrization has cut.
    """

    def __init__(self, f):
        self.bound = f.bound

    def held(self, lower: np.ndarray, upper: np.ndarray, bounds: BoxBounds, target: np.ndarray) -> CachedBounds:
        corners = (lower, upper) if bounds.boxes is None else tuple(bounds.boxes.swapaxes(0, 1))
        return CachedBounds(bounds.lower, bounds.axis, corners, np.zeros(len(lower), dtype=bool))

    def too_small(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        return np.zeros(len(lower), dtype=bool)

    def holds(self, v: np.ndarray) -> np.ndarray:
        return np.ones(len(v), dtype=bool)


class _Positives:
    """Looks at boxes: whether ``f >= target`` on all positives.

    A positive refutes that, a box that is too small ends it as well. A point with f under the target refutes nothing
    until the deployed bounder has denied it (``certify``). What is found is minus the least bound of boxes that reach
    the target, and of those that did not.

    Args:
        positives: What is known of f, and of where positives are.
        target: What every lower bound must reach.
    """

    chunk = CHUNK

    def __init__(self, positives: Everything | ShapePositives | ShapeRegions, target: float):
        self.positives, self.target = positives, target

    @taylor_bounds()
    def __call__(self, boxes: Boxes) -> Seen:
        positives, target, (low, high) = self.positives, self.target, boxes[:2]
        bounds = positives.bound(low, high)
        reached = bounds.lower >= target
        least = bounds.lower[reached].min(initial=np.inf)
        left = np.flatnonzero(~reached)  # NaN is below
        low, high, bounds = low[left], high[left], bounds.part(left)
        small = positives.too_small(low, high)  # before anything is cut off: the bounds are of whole boxes
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
    """All positives of an object."""

    positives: Everything | ShapePositives | ShapeRegions
    starts: Iterable[tuple[np.ndarray, np.ndarray, float]]  # as ``halving.search`` takes them
    at: Callable[[np.ndarray, np.ndarray], np.ndarray]  # suspects, of their numbers and of the boxes that they are in


def _checked(cover: Cover, target: float, budget: float, told: dict) -> Checked:
    """Check that ``f >= target`` on all positives, until that fails or time is over; ``told`` is for the search."""
    left = search(_Positives(cover.positives, target), cover.starts, np.full(2, -np.inf), budget=budget, **told)
    reached, not_reached = -left.found
    if left.failed is not None:
        return Checked(float(reached), left.boxes, cover.at(*left.failed))
    return Checked(float(reached if left.complete else np.fmin(reached, not_reached)), left.boxes, None, left.complete)


def reachable(domain: Domain, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners of all v that the pipeline can make of points of boxes: what ``Domain.widened`` says, made anew.

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
    """Why ``delta`` is less than what rounds on the way to v, at a corner of the domain; empty if it is not.

    What rounds is a point, its difference to the centre, and a product.
    """
    center, scale = np.float64(domain.center), np.float64(domain.scale)
    needed = [UNIT32 * (np.abs(x) * scale + 2 * np.abs(x - center) * scale) for x in (domain.lower, domain.upper)]
    return "the domain's delta does not cover what float32 rounds" if (np.maximum(*needed) > domain.delta).any() else ""


def _cells(f: Bounder, grid: Grid) -> Cover:
    """Every v that the pipeline can make of the points of the object's cells; suspects are points of the object."""

    def corners(some) -> tuple[np.ndarray, np.ndarray]:
        return grid.position(grid.occupied[some] - 0.5), grid.position(grid.occupied[some] + 0.5)

    def starts() -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
        for start in range(0, len(grid.occupied), CHUNK):
            lower, upper, owner = f.cut(*reachable(f.domain, *corners(slice(start, start + CHUNK))))
            cells.append(start + owner)
            yield lower, upper, CHUNK / max(len(grid.occupied), CHUNK)

    def inside(v: np.ndarray, box: np.ndarray) -> np.ndarray:
        first, last = corners(np.concatenate(cells)[box])
        x = np.clip(f.domain.to_object(v), first, last)  # the boxes are wider, by delta
        # a corner's float32 neighbour may lie outside
        return np.concatenate([x, x + PULL * ((first + last) / 2 - x)])

    cells: list[np.ndarray] = []  # the number of the cell of each box
    return Cover(Everything(f), starts(), inside)


def _parametrized(bounder: Bounder, grid: Grid) -> Cover:
    """The positives of a network as boxes of a parametrization; of planes, their normals."""
    kind, cover = COVERS[bounder.query_kind], parametrized(bounder, grid)
    if cover is None:
        f, lower, upper = kind.best_first(bounder, grid)
        starts = [(lower, upper, 1.0)]
        return Cover(Everything(f), starts, lambda m, _: kind.coordinates(bounder, grid, m))
    return Cover(Everything(cover), _anew(kind, bounder, grid, cover), lambda z, _: cover.coordinates(z))


def _anew(kind, bounder: Bounder, grid: Grid, cover) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
    """The starts of a parametrization."""
    before, whole = 0, max(len(grid.occupied), 1)
    for lower, upper, done in kind.anew(bounder, grid, cover):
        yield lower, upper, (done - before) / whole
        before = done


# --- shapes without cells --------------------------------------------------------------------------------------------


FINER = 1 / 8  # boxes are halved so much further than in the fit's proof, whose smallest count as object
OTHER_CELLS = 0.8  # of the number of cells along the longest side: regions rest on other ones than the fit
BORDER = 65_536  # points of the border among which some outside the domain are looked for
INWARD = 1 - 1e-3  # of the way from the domain's middle, where a suspect is tried besides


def points_outside(bounder: Bounder, shape: Shape) -> np.ndarray:
    """``(N, n)`` points in object space, of which some may be in the object and outside the bounder's domain."""
    if isinstance(shape, Grid):
        return shape.position(outside(bounder, shape))
    domain, x = bounder.domain.base, border_points(shape, BORDER, np.random.default_rng(0))
    return x[((x < domain.lower) | (x > domain.upper)).any(axis=1)]


def _points(bounder: Bounder, shape: Shape) -> Cover:
    """The points of a shape, in the domain's box; suspects are points in object space."""
    positives = ShapePositives(bounder, shape, FINER * NARROWEST)

    def inside(v: np.ndarray, _: np.ndarray) -> np.ndarray:
        # a point on the end of a complement's domain may round to one beyond it, where the answer is maybe
        return bounder.domain.to_object(np.concatenate([v, v * INWARD]) if bounder.domain.unbounded else v)

    return Cover(positives, [(*positives.boxes(), 1.0)], inside)


def _regions(bounder: Bounder, shape: Shape) -> Cover:
    """The rays or boxes of a shape, over the cover of cells that hold it, other ones than the fit's."""
    positives = ShapeRegions(bounder, shape, coarse_cells(shape, OTHER_CELLS), FINER * NARROWEST)
    starts = _anew(positives.kind, bounder, positives.cells, positives.cover)
    return Cover(positives, starts, lambda z, _: positives.coordinates(z))


# --- from a statistical threshold to a proven one ---------------------------------------------------------------------


LOWER = (
    np.array([0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0]) / 100
)  # of queries: more false positives
DRAWN = 1 << 16  # queries that these are counted on
FOLLOWED = 8192  # boxes of each generation that an estimate follows
PLANNED = 0.8  # of the time: as much as a proof is expected to take


def make_proven(
    bounder: Bounder,
    shape,
    *,
    budget: float = 3600.0,
    scheduler: str | int | None = None,
    checkpoint: str | os.PathLike | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Bounder:
    """A bounder whose threshold was attested by samples, with a lower one that is proven.

    How many boxes a proof takes is estimated, without bias, before it begins. The lower the threshold, the fewer there
    are, and the more false positives: the threshold is lowered as far as the proof is expected to end in time.

    Args:
        bounder: Of points, one network of a shape without cells, such as an arm's configurations; not changed.
        shape: As ``certify`` takes it.
        budget: Seconds for the proof.
        scheduler: As ``certify`` takes it; of an address all workers that are there now are counted.
        checkpoint: As ``certify`` takes it: the same call goes on from there, with the threshold that was chosen.
        progress: As ``certify`` takes it.

    Returns:
        The bounder with its certificate.

    Raises:
        BounderError: If the bounder is no such network, no threshold can be proven in time, or time was over.

    Example:
        >>> ball = wb.shapes.Function(None, [-1, -1], [1, 1], distance=lambda x: np.linalg.norm(x, axis=1) - 0.9)
        >>> network = wb.fit(ball, hidden=(8, 8), steps=100, statistical=True, device="cpu", progress=False)
        >>> wb.proof.make_proven(network, ball, budget=60.0).certificate.kind
        'proven'
    """
    frame = bounder.frame
    bounder, shape = in_local(bounder, shape)
    grid = as_fitted(bounder, shape)
    if isinstance(grid, Grid) or bounder.query_kind != "point" or len(bounder.obligations(grid)) > 1:
        raise BounderError(f"{bounder.method}: expected a bounder of points of a shape without cells, in one part")
    if not (bounder.provable and grid.certified):
        raise BounderError(f"{bounder.method}: {grid.name} or the method has no proof")
    each = [bounder.to().freeze(threshold, None) for threshold in _lower_thresholds(bounder, grid)]
    if checkpoint is not None and os.path.exists(checkpoint):
        index = _begun(each, grid, checkpoint)
    else:
        index = _planned(each, grid, budget, scheduler)
    end = working_seconds() + budget
    for lower in each[index:]:
        told = {"progress": progress, "scheduler": scheduler}
        told["checkpoint"] = None if checkpoint is None else Checkpoint(checkpoint, lower, grid)
        started, left = working_seconds(), max(end - working_seconds(), 0.0)
        found = _checked(_points(lower, grid), _target(lower), left, told)
        if not found.complete:
            raise BounderError(f"{bounder.method}: no decision within {budget:.3g} s{_goes_on(told)}")
        if found.suspects is None:
            spent, none = working_seconds() - started, np.empty((0, grid.ndim))
            settle(lower, grid, Search(found.least, found.least, none, found.boxes, spent, True))
            lower.info = bounder.info | {"rates": None}
            return lower.in_frame(frame)
    raise BounderError(f"{bounder.method}: at every threshold a positive or a proof comes too close; train it longer")


def _target(bounder: Bounder) -> float:
    """What f must reach, no less than the exact sum of the threshold and what is rounded."""
    return float(np.nextafter(float(bounder.threshold) + bounder.rounding_bound(), np.inf))


def _lower_thresholds(bounder: Bounder, shape: Shape) -> list[float]:
    """The bounder's threshold and lower ones, each with more false positives, as ``LOWER`` says."""
    x = np.random.default_rng(0).uniform(shape.lower, shape.upper, (DRAWN, shape.ndim)).astype(np.float32)
    values, now = bounder.values(x).numpy(), float(bounder.threshold)
    denied = np.sort(values[values < now])[::-1]
    places = (LOWER[1:] * DRAWN).astype(int)
    return [now, *(float(denied[place]) for place in places if place < len(denied))]


def _begun(each: list[Bounder], shape: Shape, checkpoint: str | os.PathLike) -> int:
    """Which of these the checkpoint is of."""
    for index, bounder in enumerate(each):
        try:
            Checkpoint(checkpoint, bounder, shape)
        except FileFormatError as error:
            reason = error
        else:
            return index
    raise reason


def _planned(each: list[Bounder], shape: Shape, budget: float, scheduler: str | int | None) -> int:
    """The first of these whose proof is expected to end in time."""
    cores = cpu_threads() if scheduler is None else scheduler
    if isinstance(cores, str):
        with Workers(cores) as workers:
            cores = workers.count
    first, last = 0, len(each)
    while first < last:
        middle = (first + last) // 2
        seconds = _expected_seconds(each[middle], shape) * cpu_threads() / cores
        first, last = (first, middle) if seconds <= PLANNED * budget else (middle + 1, last)
    if first == len(each):
        raise BounderError(
            f"{each[0].method}: a proof in {budget:.3g} s is not expected, that of the lowest threshold takes about "
            f"{seconds:.3g} s; give a larger budget, more workers (scheduler=), or a smaller network"
        )
    return first


@taylor_bounds()
def _expected_seconds(bounder: Bounder, shape: Shape) -> float:
    """Of a proof on this machine, an unbiased estimate; infinity where it fails.

    Follows a random part of each generation of boxes. Source: D. E. Knuth, "Estimating the Efficiency of Backtrack
    Programs" (1975).
    """
    positives, rng = ShapePositives(bounder, shape, FINER * NARROWEST), np.random.default_rng(0)
    look = _Positives(positives, _target(bounder))
    lower, upper = positives.boxes()
    counts = np.arange(len(lower)), np.zeros(len(lower), np.int64)
    boxes, weight, expected, looked, started = Boxes(lower, upper, *counts, 0.0), 1.0, 0.0, 0, working_seconds()
    while boxes.count:
        left, _, _, failed = look(boxes)
        if failed is not None:
            return np.inf
        expected, looked = expected + weight * boxes.count, looked + boxes.count
        if left.count > FOLLOWED:
            weight *= left.count / FOLLOWED
            left = left.part(rng.choice(left.count, FOLLOWED, replace=False))
        boxes = left
    return expected / looked * (working_seconds() - started)


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
    told: dict,
) -> Certificate:
    """``certify`` of a distance.

    Args:
        bounder: Its threshold and numbers are taken as they are; its own certificate is not looked at.
        shape: As ``certify`` takes it.
        expected: The claim that is expected (``other_claim``).
        budget: Seconds allowed.
        checkpoint: As ``certify`` takes it.
        told: Progress and scheduler, as ``certify`` takes them.
    """
    started, threshold, error = working_seconds(), float(bounder.threshold), bounder.rounding_bound()
    before = 0.0  # seconds of the part that a checkpoint holds
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
        of_volume = certify(volume, grid, budget=budget, **told)
        suspects = None if of_volume.counterexample is None else np.array([of_volume.counterexample])
        least, boxes, told = (0.0 if of_volume.proven else -np.inf), of_volume.boxes, of_volume.message
    else:
        held = told["checkpoint"] = None if checkpoint is None else Checkpoint(checkpoint, bounder, grid)
        bar = -float(np.nextafter(threshold + error, np.inf))
        overestimate, boxes, complete, suspects = overestimate_within(bounder, grid, bar, budget, **told)
        least, before = -overestimate, held.seconds if held else 0.0
        told = CLOSE if complete else f"no decision within {budget:.3g} s{_goes_on(told)}"
    if threshold <= 0 and float(np.nextafter(threshold + error, np.inf)) <= least < np.inf:
        told = f"Proven from scratch: the distance is never overestimated{TOUCHED if grid.time else ''}."
        return result("proven", told, least, boxes)
    point = None if suspects is None else _overestimated(bounder, grid, suspects)
    least = max(least, -float(np.finfo(np.float32).max))  # JSON has no infinity
    if point is not None:
        return result("refuted", "a distance is overestimated", least, boxes, point)
    return result("undecided", LOOSE if least == 0 else told, least, boxes)


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
