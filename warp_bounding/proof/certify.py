"""Proving from scratch what a file claims: ``f >= threshold + E`` over all positives, by a loop of its own.

Points are taken cell by cell, rays face by face, boxes from all pairs of corners, and halved until every bound reaches
the target or a counterexample is found. The bounds over one box, and for rays and boxes the chart, are those of the
search; so is the search over the normals of planes. A bounder whose method has no proof is asked fresh positives
(``statistics``).
"""

import os
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from warp_bounding.bounders.batch import frame_fault
from warp_bounding.bounders.bounder import Bounder
from warp_bounding.bounders.distance import DistanceBounder
from warp_bounding.bounders.load import bounder_of
from warp_bounding.bounders.mlp import Local
from warp_bounding.certificates.certificate import Certificate
from warp_bounding.certificates.claim import OUTSIDE, as_fitted, in_local, mismatch, other_claim
from warp_bounding.certificates.document import document, together
from warp_bounding.errors import BounderError, BoundingError
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.shape import IN, Shape
from warp_bounding.proof.attest.statistics import CONFIDENCE, POSITIVES, fn_rate_bound, fresh_seed, try_positives
from warp_bounding.proof.box_check import NARROWEST, check_boxes, check_charted, check_parts
from warp_bounding.proof.covers import COVERS
from warp_bounding.proof.covers.monotone_box import of_points
from warp_bounding.proof.distances.certify import certify_distance
from warp_bounding.proof.prove import charted
from warp_bounding.proof.search.best_first import minimum
from warp_bounding.proof.shape_check import CHUNK, SUSPECTS, Checked, check_regions, check_shape, points_outside
from warp_bounding.queries import QUERIES, decision
from warp_bounding.runtime.launch import working_seconds

__all__ = ["certify"]

PULL = 1e-4  # of the way to its cell's centre, by which each suspect is also tried farther inside
COARSEST = 1e-4  # of f: the least precision that the search for planes begins with
LEAST_SECONDS = 1.0  # for positives that may refute what the proof could not decide
DENIED = "that meets the object is answered with no"
GRANTED = "a part denies a query that meets the object, which an exit before it grants"
AROUND = (0.0, 1e-6, 1e-5, 1e-4, 1e-3)  # distances in v from a suspect at which a true counterexample is looked for


def certify(
    bounder: Bounder,
    shape,
    *,
    margin: float | None = None,
    length: float | None = None,
    resolution: int | None = None,
    query: str | None = None,
    seconds: float = 900.0,
    progress: Callable[[int, int], None] | None = None,
    checkpoint: str | os.PathLike | None = None,
) -> Certificate:
    """Prove from scratch that a bounder has no false negative on a shape, or find out why that is not so.

    A bounder itself says which margin, which length of rays and which resolution of a mesh its claim is about; its
    certificate names them. If you rely on one of these, state it here: a proof of another claim is then not accepted.

    Args:
        bounder: Its threshold and weights are taken as they are; its own certificate is not looked at.
        shape: An ``IndicatorGrid`` or ``IndicatorMesh``, or anything that ``load_indicator`` takes; voxelised with the
            bounder's own resolution and margin.
        margin: The margin that is expected, object units; the bounder's own if ``None``.
        length: The length of rays that is expected, object units; the bounder's own if ``None``.
        resolution: The resolution of a mesh that is expected; the bounder's own if ``None``.
        query: The kind of query that is expected; the bounder's own if ``None``.
        seconds: Time allowed for all parts together; compiling kernels is not counted.
        progress: Called with cells done and cells in all; counts begin anew for each part of a conjunction.
        checkpoint: Of a learned distance or a ``distance-grid``: a file that holds what is left of a proof whose time was over, or that was stopped; the
            same call goes on from there. It is removed when the proof has ended.

    Returns:
        A certificate of kind ``"proven"``; ``"statistical"`` (the method has no proof; fresh positives were asked, and
        none was denied); ``"refuted"`` (with a counterexample); ``"undecided"``; or ``"inapplicable"`` (the shape
        cannot be the bounded one, the claim is not the expected one, or the method is not conservative).

    Example:
        >>> wb.certify(bounder, grid).kind, wb.certify(bounder, grid, margin=0.5).kind
        ('proven', 'inapplicable')
    """
    if isinstance(seconds, bool) or not isinstance(seconds, (int, float)) or not seconds >= 0:
        raise BounderError(f"seconds must be a number of at least 0, got {seconds!r}")
    started, bounder = working_seconds(), bounder_of(bounder)
    frame = bounder.frame
    try:
        bounder, shape = in_local(bounder, shape)
    except BoundingError as error:
        return _inapplicable(bounder, shape, str(error))
    if frame is not None:
        own = {"margin": margin, "length": length, "resolution": resolution, "query": query}
        fault = frame_fault(bounder, frame)
        if fault:
            return _inapplicable(bounder, shape, fault)
        run = {"seconds": seconds, "progress": progress, "checkpoint": checkpoint}
        return frame.noted(certify(bounder, shape, **own, **run))
    numbers = {"margin": margin, "length": length, "resolution": resolution}
    expected = {"query": query} | {name: _exactly(name, value) for name, value in numbers.items()}
    if isinstance(bounder, DistanceBounder):
        return certify_distance(bounder, shape, expected, seconds, progress, checkpoint, of_points=certify)
    if checkpoint is not None:
        raise BounderError(f"{bounder.method}: a checkpoint is for proofs of distances")
    other = other_claim(bounder, expected)
    try:
        grid = as_fitted(bounder, shape)
    except BoundingError as error:
        return _inapplicable(bounder, shape, other or str(error))
    reason = other or mismatch(bounder, grid)
    if not bounder.conservative:
        reason = f"{bounder.method} is not conservative"
    if reason and reason != OUTSIDE:
        return _inapplicable(bounder, grid, reason)
    try:
        owed = bounder.obligations(grid)
    except BoundingError as error:
        return document(bounder, grid, "undecided", float(bounder.threshold), 0.0, 0, 0.0, str(error))
    if reason:  # outside its own domain no part of it is asked
        point, threshold = _denied_outside(bounder, bounder, grid), float(bounder.threshold)
        kind, spent = "undecided" if point is None else "refuted", working_seconds() - started
        return document(bounder, grid, kind, threshold, threshold, 0, spent, OUTSIDE, point)
    certificates = []
    for part, own in owed:
        left = seconds - (working_seconds() - started)
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


def _certify(bounder: Bounder, grid: IndicatorGrid, seconds: float, progress, asked: Bounder) -> Certificate:
    """``certify`` for one part of a conjunction; ``asked`` is who must deny a counterexample."""
    started = working_seconds()
    threshold, error = float(bounder.threshold), bounder.rounding_bound()
    target = float(np.nextafter(threshold + error, np.inf))  # no less than the exact sum
    least, boxes = np.inf, 0

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
    f = of_points(bounder)  # of boxes and a monotone network too (``covers.monotone_box``)
    if QUERIES[bounder.query_kind].is_region and f is bounder:
        return _certify_regions(bounder, grid, target, seconds, result, progress)
    if not grid.certified:
        return _attested(bounder, grid, seconds, result)
    if not isinstance(grid, IndicatorGrid):
        grid.check()
        if bounder.exact_on_hull(grid):
            least, boxes = bounder.least(grid)
            if target <= least < np.inf:
                return result("proven", _proven(bounder), least, boxes)
        return _conclusion(
            bounder, grid, check_shape(f, grid, target, started + seconds, progress), seconds, result, asked
        )
    cells = grid.occupied
    for start in range(0, len(cells), CHUNK):
        found = _check_cells(f, grid, target, started + seconds, cells[start : start + CHUNK])
        least, boxes = min(least, found.least), boxes + found.boxes
        if found.suspects is not None or not found.complete:
            break
        if progress:
            progress(min(start + CHUNK, len(cells)), len(cells))
    return _conclusion(bounder, grid, found._replace(least=least, boxes=boxes), seconds, result, asked)


def _conclusion(bounder: Bounder, grid: Shape, found: Checked, seconds: float, result, asked: Bounder) -> Certificate:
    """The certificate for what a check has found."""
    least, boxes = found.least, found.boxes
    if not found.complete:
        return result("undecided", f"no decision within {seconds:.3g} s", least, boxes)
    if found.suspects is None:
        return result("proven", _proven(bounder), least, boxes)
    if (point := _denied(asked, grid, found.suspects)) is not None:
        return result("refuted", f"a {bounder.query_kind} {DENIED}", least, boxes, point)
    return result(
        "undecided", "f comes closer to the threshold than the proof's margins for rounding allow", least, boxes
    )


def _certify_regions(
    bounder: Bounder, grid: IndicatorGrid, target: float, seconds: float, result, progress
) -> Certificate:
    """``certify`` for rays, planes and boxes."""
    if not bounder.provable:
        return _attested(bounder, grid, seconds, result)
    least, boxes, complete, suspects = -np.inf, 0, True, None
    text = "f comes closer to the threshold than the proof allows"
    try:
        if bounder.exact_on_cells:
            least, boxes = bounder.least(grid)
        elif isinstance(bounder, Local):
            least, boxes, suspects, complete = check_parts(bounder, grid, target, seconds, progress)
        elif not isinstance(grid, IndicatorGrid) and COVERS[bounder.query_kind].pieces:
            grid.check()
            end = working_seconds() + seconds
            least, boxes, suspects, complete = check_regions(bounder, grid, target, end, progress)
        elif (cover := charted(bounder, grid)) is not None:
            least, boxes, suspects, complete = check_charted(bounder, grid, cover, target, seconds, progress)
        else:
            least, boxes, suspects, complete = _check_best_first(bounder, grid, target, seconds)
    except BounderError as error:  # of this object: a volume does not hold it, or numbers leave the range of the proof
        text = str(error)
    if target <= least < np.inf:  # infinity: no positive was looked at, which proves nothing
        return result("proven", _proven(bounder), least, boxes)
    missed = None if suspects is None else _denied_region(bounder, grid, suspects)
    if missed is None:
        missed = try_positives(bounder, grid, POSITIVES, fresh_seed(), seconds=max(seconds, LEAST_SECONDS))[2]
    if missed is not None:
        return result("refuted", f"a query {DENIED}", least, boxes, missed)
    text = text if complete else f"no decision within {seconds:.3g} s"
    least = max(least, -float(np.finfo(np.float32).max))  # JSON has no infinity
    return result("undecided", text, least, boxes)


def _attested(bounder: Bounder, grid: IndicatorGrid, seconds: float, result) -> Certificate:
    """What fresh positives tell where there is no proof."""
    done, lowest, missed = try_positives(bounder, grid, POSITIVES, fresh_seed(), seconds=seconds)
    if missed is not None:
        return result("refuted", f"a query {DENIED}", lowest, 0, missed)
    if not done:
        return result("undecided", f"no positive could be asked within {seconds:g} s", float(bounder.threshold))
    rate = fn_rate_bound(done)
    text = (
        f"Statistical, not proven: {done:,} fresh positives, none answered with no; at {CONFIDENCE:.0%} confidence "
        f"fewer than {rate:.2g} of such queries are missed."
    )
    certificate = result("statistical", text, lowest)
    margin = lowest - float(bounder.threshold)
    return replace(certificate, samples=done, fn_rate_bound=rate, confidence=CONFIDENCE, worst_margin=margin)


def _check_best_first(bounder: Bounder, grid: IndicatorGrid, target: float, seconds: float) -> Checked:
    """Positives without a chart (planes of a network): their least f, as precisely as the target needs."""
    kind = COVERS[bounder.query_kind]
    f, lower, upper = kind.best_first(bounder, grid)
    # First as coarsely as the distance to the target allows, then finer until it is decided.
    eps, points, deadline = max(COARSEST, 0.25 * (float(f.reference(lower).min()) - target)), None, None
    while True:
        search = minimum(f, lower, upper, eps=eps, seconds=seconds, points=points)
        deadline = deadline or working_seconds() - search.seconds + seconds
        eps, points, seconds = 0.5 * (search.upper_bound - target), search.worst, deadline - working_seconds()
        undecided = search.lower_bound < target <= search.upper_bound and search.complete
        if not undecided or seconds <= 0 or eps < NARROWEST:
            break
    worst = search.worst[:SUSPECTS][f.reference(search.worst[:SUSPECTS]) < target]
    suspects = kind.coordinates(bounder, grid, worst) if len(worst) else None
    return Checked(search.lower_bound, search.boxes, suspects, search.complete)


def _denied_region(bounder: Bounder, grid: IndicatorGrid, v: np.ndarray) -> np.ndarray | None:
    """A float32 query at or close to coordinates ``v`` that meets the object and that the deployed bounder denies."""
    truth = decision(bounder.query_kind, grid, bounder.device, bounder.domain.oracle_length)
    rng = np.random.default_rng(0)
    for step in AROUND:
        x = bounder.domain.to_object(v + step * rng.uniform(-1, 1, v.shape)).astype(np.float32)
        missed = np.flatnonzero((bounder.query(x).numpy() == 0) & (truth(x) == IN))
        if len(missed):
            return x[missed[0]]
    return None


def _check_cells(bounder: Bounder, grid: IndicatorGrid, target: float, deadline: float, cells: np.ndarray) -> Checked:
    """Check ``f >= target`` over every v that the pipeline can make of the points of some cells."""
    first, last = grid.position(cells - 0.5), grid.position(cells + 0.5)
    lower, upper, owner = bounder.cut(*bounder.domain.widened(first, last))
    first, last = first[owner], last[owner]
    checked, failed = check_boxes(bounder, lower, upper, target, deadline)
    if failed is None:
        return checked
    suspects, cell = np.concatenate([failed.point, failed.center]), np.tile(failed.owner, 2)
    lowest = np.argsort(bounder.reference(suspects))[:SUSPECTS]
    suspects, cell = suspects[lowest], cell[lowest]
    inside = np.clip(bounder.domain.to_object(suspects), first[cell], last[cell])  # the boxes are wider, by delta
    inner = inside + PULL * ((first[cell] + last[cell]) / 2 - inside)  # a corner's float32 neighbour may lie outside
    return checked._replace(suspects=np.concatenate([inside, inner]))


def _denied(bounder: Bounder, grid: IndicatorGrid, x: np.ndarray) -> np.ndarray | None:
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
    """A point of the object outside of a bounder's domain that ``asked`` denies; ``None`` of regions, or if none is found."""
    return None if QUERIES[bounder.query_kind].is_region else _denied(asked, grid, points_outside(bounder, grid))


def _proven(bounder: Bounder) -> str:
    """The first sentence of a certificate."""
    return f"Proven from scratch: every {QUERIES[bounder.query_kind].positive} is answered with maybe."


def _inapplicable(bounder: Bounder, shape, reason: str) -> Certificate:
    certificate = document(bounder, None, "inapplicable", float(bounder.threshold), 0.0, 0, 0.0, reason)
    return replace(certificate, indicator=getattr(shape, "digest", ""))
