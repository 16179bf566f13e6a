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
from warp_bounding.errors import BounderError, BoundingError
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.proof.covers import COVERS
from warp_bounding.proof.distances import Checkpoint, overestimate_within
from warp_bounding.proof.prove import TOUCHED, ShapeRegions, coarse_cells, parametrized
from warp_bounding.proof.search import NARROWEST, CachedBounds, ShapePositives, halve
from warp_bounding.proof.stress import CONFIDENCE, POSITIVES, descend, fn_rate_bound, fresh_seed, try_positives
from warp_bounding.proof.taylor import taylor_bounds
from warp_bounding.queries import QUERIES, decision
from warp_bounding.queries.boundary import border_points
from warp_bounding.queries.domain import Domain
from warp_bounding.rounding import UNIT32, UNIT64
from warp_bounding.runtime.launch import working_seconds
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
        progress: Called with cells done and cells in all; counts begin anew for each part of a conjunction.
        checkpoint: Of a learned distance or a ``distance-grid``: a file that holds what is left of a proof whose time
            was over, or that was stopped; the same call goes on from there. It is removed when the proof has ended.

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
        run = {"budget": budget, "progress": progress, "checkpoint": checkpoint}
        return frame.noted(certify(bounder, shape, **own, **run))
    numbers = {"margin": margin, "length": length, "resolution": resolution}
    expected = {"query": query} | {name: _exactly(name, value) for name, value in numbers.items()}
    if bounder.of_distances:
        return certify_distance(bounder, shape, expected, budget, progress, checkpoint)
    if checkpoint is not None:
        raise BounderError(f"{bounder.method}: a checkpoint is for proofs of distances")
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
    certificates = []
    for part, own in obligations:
        left = budget - (working_seconds() - started)
        # what a network's exit grants, no part of it can deny
        asked = part if bounder.composed else bounder
        certificates.append(_certify(part, own, max(left, 0.0), progress, asked))
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


def _certify(bounder: Bounder, grid: Grid, budget: float, progress, asked: Bounder) -> Certificate:
    """``certify`` for one part of a conjunction; ``asked`` is who must deny a counterexample."""
    started = working_seconds()
    threshold, error = float(bounder.threshold), bounder.rounding_bound()
    target = float(np.nextafter(threshold + error, np.inf))  # no less than the exact sum

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
        return _certify_regions(bounder, grid, target, budget, result, progress)
    if not grid.certified:
        return _attested(bounder, grid, budget, result)
    if not isinstance(grid, Grid):
        grid.check()
        if bounder.exact_on_hull(grid):
            least, boxes = bounder.least(grid)
            if target <= least < np.inf:
                return result("proven", _proven(bounder), least, boxes)
        found = _check_shape(bounder, grid, target, started + budget, progress)
        return _conclusion(bounder, grid, found, budget, result, asked)
    found = _checked(_cell_pieces(bounder, grid, target), started + budget, len(grid.occupied), progress)
    return _conclusion(bounder, grid, found, budget, result, asked)


def _conclusion(bounder: Bounder, grid: Shape, found: Checked, budget: float, result, asked: Bounder) -> Certificate:
    """The certificate for what a check has found."""
    least, boxes = found.least, found.boxes
    if not found.complete:
        denied = descend(asked, grid, fresh_seed(), max(budget / 4, LEAST_SECONDS))[0]
        if len(denied):
            return result("refuted", f"a {bounder.query_kind} {DENIED}", least, boxes, denied[0])
        return result("undecided", f"no decision within {budget:.3g} s", least, boxes)
    if found.suspects is None:
        return result("proven", _proven(bounder), least, boxes)
    if (point := _denied(asked, grid, found.suspects)) is not None:
        return result("refuted", f"a {bounder.query_kind} {DENIED}", least, boxes, point)
    return result(
        "undecided", "f comes closer to the threshold than the proof's margins for rounding allow", least, boxes
    )


def _certify_regions(bounder: Bounder, grid: Grid, target: float, budget: float, result, progress) -> Certificate:
    """``certify`` for rays, planes and boxes."""
    if not bounder.provable:
        return _attested(bounder, grid, budget, result)
    kind = COVERS[bounder.query_kind]
    least, boxes, suspects, complete = Checked(-np.inf, 0)
    end, cells = working_seconds() + budget, getattr(grid, "occupied", ())
    text = "f comes closer to the threshold than the proof allows"
    try:
        if bounder.exact_on_cells:
            least, boxes = bounder.least(grid)
        elif not isinstance(grid, Grid) and kind.pieces:
            grid.check()
            cells = coarse_cells(grid, OTHER_CELLS)
            pieces = _region_pieces(ShapeRegions(bounder, grid, cells, FINER * NARROWEST), target)
            least, boxes, suspects, complete = _checked(pieces, end, len(cells.occupied), progress)
        else:
            pieces = _charted_pieces(bounder, grid, target)
            least, boxes, suspects, complete = _checked(pieces, end, len(cells), progress)
    except BounderError as error:  # of this object: a volume does not hold it, or numbers leave the range of the proof
        text = str(error)
    if target <= least < np.inf:  # infinity: no positive was looked at, which proves nothing
        return result("proven", _proven(bounder), least, boxes)
    missed = None if suspects is None else _denied_region(bounder, grid, suspects)
    if missed is None:
        missed = try_positives(bounder, grid, POSITIVES, fresh_seed(), budget=max(budget, LEAST_SECONDS))[2]
    if missed is not None:
        return result("refuted", f"a query {DENIED}", least, boxes, missed)
    text = text if complete else f"no decision within {budget:.3g} s"
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


def _halved(
    positives: Everything | ShapePositives | ShapeRegions,
    lower: np.ndarray,
    upper: np.ndarray,
    target: float,
    end: float,
    told: Callable[[float], None] = lambda volume: None,
) -> tuple[Checked, np.ndarray]:
    """Halve boxes until ``f >= target`` on all positives.

    Ends as well when a positive refutes that, a box is too small, or time is over.

    Newest boxes come first, so that memory grows with depth, not with the number of boxes. A point with f under the
    target refutes nothing until the deployed bounder has denied it (``certify``).

    Args:
        positives: What is known of f, and of where positives are.
        lower: ``(N, Z)`` float64, in the numbers that ``positives`` takes.
        upper: ``(N, Z)`` float64.
        target: What every lower bound must reach.
        end: On the clock ``working_seconds``.
        told: Called with the volume that is done.

    Returns:
        What was found, its suspects in the same numbers as the boxes; and ``(S,)``, of which given box each suspect is
        a part.
    """
    waiting, least, lowest_open, boxes, done = [(lower, upper, np.arange(len(lower)))], np.inf, np.inf, 0, 0.0
    nobody = np.zeros(0, dtype=np.int64)
    while waiting:
        if boxes and working_seconds() > end:
            return Checked(float(np.fmin(least, lowest_open)), boxes, complete=False), nobody
        low, high, owner = waiting.pop()
        if len(low) > CHUNK:
            first, rest = ((low[part], high[part], owner[part]) for part in (slice(CHUNK), slice(CHUNK, None)))
            waiting += [rest, first]
            continue
        bounds, volume = positives.bound(low, high), float((high - low).prod(axis=1).sum())
        boxes += len(low)
        least = min(least, bounds.lower[bounds.lower >= target].min(initial=np.inf))
        left = np.flatnonzero(~(bounds.lower >= target))  # NaN is below
        low, high, bounds = low[left], high[left], bounds.part(left)
        small = positives.too_small(low, high)  # before anything is cut off: the bounds are of whole boxes
        found = positives.held(low, high, bounds, np.full(len(left), target))
        open_ = ~(found.lower >= target)
        least = min(least, found.lower[~open_].min(initial=target if found.cut.any() else np.inf))
        low, high = (np.asarray(corner)[open_] for corner in found.corners)
        axis, bounds, small, owner = (
            found.axis[open_].astype(np.int64),
            bounds.part(open_),
            small[open_],
            owner[left[open_]],
        )
        done += volume - float((high - low).prod(axis=1).sum())
        told(done)
        if not len(low):
            continue
        failed = small | ((high - low)[np.arange(len(low)), axis] < SMALLEST)
        lowest = np.argpartition(bounds.value, TRIED)[:TRIED] if len(low) > TRIED else np.arange(len(low))
        lowest = lowest[bounds.value[lowest] < target]
        failed[lowest] |= positives.holds(bounds.point[lowest])
        if failed.any():
            order = np.lexsort((bounds.value, ~failed))[:SUSPECTS]
            at = np.concatenate([bounds.point[order], (low + high)[order] / 2])
            worst = np.fmin.reduce(np.concatenate([bounds.lower[failed], bounds.value[failed]]))
            return Checked(float(np.fmin(least, worst)), boxes, at), np.tile(owner[order], 2)
        lowest_open = np.fmin(lowest_open, np.fmin.reduce(bounds.lower))
        waiting.append((*halve(low, high, axis), np.tile(owner, 2)))
    return Checked(least, boxes), nobody


class Piece(NamedTuple):
    """Some of an object's positives."""

    positives: Everything | ShapePositives | ShapeRegions
    lower: np.ndarray
    upper: np.ndarray
    target: float
    at: Callable[[np.ndarray, np.ndarray], np.ndarray]  # suspects, of their numbers and of the boxes that they are in
    done: int  # cells of the object that are done with this piece


def _checked(
    pieces: Iterable[Piece], end: float, cells: int, progress: Callable[[int, int], None] | None = None
) -> Checked:
    """Check pieces one after another, until one fails or time is over."""
    least, boxes = np.inf, 0
    for piece in pieces:
        if boxes and working_seconds() > end:
            return Checked(least, boxes, complete=False)
        found, owner = _halved(*piece[:4], end)
        least, boxes = min(least, found.least), boxes + found.boxes
        if found.suspects is not None or not found.complete:
            suspects = None if found.suspects is None else piece.at(found.suspects, owner)
            return Checked(least, boxes, suspects, found.complete)
        if progress:
            progress(piece.done, cells)
    return Checked(least, boxes)


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


def _cell_pieces(f: Bounder, grid: Grid, target: float) -> Iterator[Piece]:
    """Every v that the pipeline can make of the points of the object's cells; suspects are points of the object."""
    for start in range(0, len(grid.occupied), CHUNK):
        cells = grid.occupied[start : start + CHUNK]
        corners = grid.position(cells - 0.5), grid.position(cells + 0.5)
        lower, upper, owner = f.cut(*reachable(f.domain, *corners))

        def inside(v: np.ndarray, box: np.ndarray, corners=corners, owner=owner) -> np.ndarray:
            first, last = (side[owner[box]] for side in corners)
            x = np.clip(f.domain.to_object(v), first, last)  # the boxes are wider, by delta
            # a corner's float32 neighbour may lie outside
            return np.concatenate([x, x + PULL * ((first + last) / 2 - x)])

        yield Piece(Everything(f), lower, upper, target, inside, start + len(cells))


def _charted_pieces(bounder: Bounder, grid: Shape, target: float) -> Iterator[Piece]:
    """The positives of a network as boxes of a parametrization; of planes, their normals."""
    kind, cover = COVERS[bounder.query_kind], parametrized(bounder, grid)
    if cover is None:
        f, lower, upper = kind.best_first(bounder, grid)
        yield Piece(Everything(f), lower, upper, target, lambda m, _: kind.coordinates(bounder, grid, m), 1)
        return
    for lower, upper, done in kind.anew(bounder, grid, cover):
        yield Piece(Everything(cover), lower, upper, target, lambda z, _: cover.coordinates(z), done)


# --- shapes without cells --------------------------------------------------------------------------------------------


FINER = 1 / 8  # boxes are halved so much further than in the fit's proof, whose smallest count as object
OTHER_CELLS = 0.8  # of the number of cells along the longest side: regions rest on other ones than the fit
BORDER = 65_536  # points of the border among which some outside the domain are looked for
PARTS = 1000  # of the domain, in which progress is told
INWARD = 1 - 1e-3  # of the way from the domain's middle, where a suspect is tried besides


def points_outside(bounder: Bounder, shape: Shape) -> np.ndarray:
    """``(N, n)`` points in object space, of which some may be in the object and outside the bounder's domain."""
    if isinstance(shape, Grid):
        return shape.position(outside(bounder, shape))
    domain, x = bounder.domain.base, border_points(shape, BORDER, np.random.default_rng(0))
    return x[((x < domain.lower) | (x > domain.upper)).any(axis=1)]


def _check_shape(
    bounder: Bounder, shape: Shape, target: float, end: float, progress: Callable[[int, int], None] | None
) -> Checked:
    """The points of a shape, in the domain's box; suspects are points in object space."""
    positives = ShapePositives(bounder, shape, FINER * NARROWEST)
    lower, upper = positives.boxes()
    whole = float(np.prod(upper - lower, axis=1).sum())

    def told(volume: float) -> None:
        if progress:
            progress(round(PARTS * volume / whole), PARTS)

    found, _ = _halved(positives, lower, upper, target, end, told)
    if found.suspects is None:
        return found
    at = found.suspects
    # a point on the end of a complement's domain may round to one beyond it, where the answer is maybe
    if bounder.domain.unbounded:
        at = np.concatenate([at, at * INWARD])
    return found._replace(suspects=bounder.domain.to_object(at))


def _region_pieces(positives: ShapeRegions, target: float) -> Iterator[Piece]:
    """The rays or boxes of a shape, over the cover of cells that hold it, other ones than the fit's."""
    for lower, upper, done in positives.kind.anew(positives.bounder, positives.cells, positives.cover):
        yield Piece(positives, lower, upper, target, lambda z, _: positives.coordinates(z), done)


# --- distances -------------------------------------------------------------------------------------------------------


LOOSE = "the threshold does not cover what float32 rounds"
GOES_ON = "; the same command goes on from {}"
CLOSE = "F comes closer to the distance than the proof allows"


def certify_distance(
    bounder: DistanceBounder,
    shape,
    expected: dict[str, str | float | None],
    budget: float,
    progress: Callable[[int, int], None] | None,
    checkpoint: str | os.PathLike | None = None,
) -> Certificate:
    """``certify`` of a distance.

    Args:
        bounder: Its threshold and numbers are taken as they are; its own certificate is not looked at.
        shape: As ``certify`` takes it.
        expected: The claim that is expected (``other_claim``).
        budget: Seconds allowed.
        progress: As ``certify`` takes it.
        checkpoint: As ``certify`` takes it.
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
        of_volume = certify(volume, grid, budget=budget, progress=progress)
        suspects = None if of_volume.counterexample is None else np.array([of_volume.counterexample])
        least, boxes, told = (0.0 if of_volume.proven else -np.inf), of_volume.boxes, of_volume.message
    else:
        held = None if checkpoint is None else Checkpoint(checkpoint, bounder, grid)
        bar = -float(np.nextafter(threshold + error, np.inf))
        overestimate, boxes, complete, suspects = overestimate_within(bounder, grid, bar, budget, held, progress)
        least, before = -overestimate, held.seconds if held else 0.0
        told = CLOSE if complete else f"no decision within {budget:.3g} s{GOES_ON.format(checkpoint) if held else ''}"
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
