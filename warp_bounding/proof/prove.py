"""The step from a bounder and a grid to a proven threshold, and back: proving from scratch what a file claims.

``prove`` finds the least value of ``f`` over P_delta, every float32 input that the pipeline can make of a query that meets
the object, and sets ``threshold <= minimum - E``: in closed form, or by branch and bound (networks: over the object for
points, over all normals for planes). ``certify`` takes threshold and shape as given and checks ``f >= threshold + E``, for
points cell by cell; it shares nothing with the search but the methods' bound rules. A monotone network's boxes are proven
as points (``monotone``). Other networks of rays and boxes have no proof yet: ``certify`` puts fresh positives to them
instead (``statistics``).
"""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from warp_bounding.arithmetic import UNIT64, round_down
from warp_bounding.bounders.base import Bounder
from warp_bounding.bounders.certificate import Certificate
from warp_bounding.errors import BounderError, BoundingError
from warp_bounding.indicators import load_indicator
from warp_bounding.indicators.blocks import full_blocks
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.proof.document import conjunction, document
from warp_bounding.proof.monotone import of_points
from warp_bounding.proof.planes import SupportGap
from warp_bounding.proof.search import Search, halve, minimum
from warp_bounding.proof.statistics import CONFIDENCE, POSITIVES, fn_rate_bound, try_positives

__all__ = ["certify", "positive_boxes", "provable", "prove"]

CHUNK = 16384  # cells that `certify` takes at a time
SUSPECTS = 1024  # low points that are tried as counterexamples
PULL = 1e-4  # towards the cell's centre, of points that may break the proof
NARROWEST = 1e-9  # boxes of this width in v are not halved any more


def provable(bounder: Bounder) -> bool:
    """Whether there is a proof for the bounder's method and kind of query."""
    return bounder.provable


def positive_boxes(bounder: Bounder, grid: IndicatorGrid) -> tuple[np.ndarray, np.ndarray]:
    """P_delta as boxes of ``v``: one per cell for closed forms, few large ones where a search halves them itself.

    Returns:
        Lower and upper corners ``(N, n)`` float64.
    """
    first, last = (grid.occupied, grid.occupied + 1) if bounder.closed_form else full_blocks(grid)
    return bounder.domain.widened(grid.position(first - 0.5), grid.position(last - 0.5))


def prove(
    bounder: Bounder,
    grid: IndicatorGrid,
    *,
    eps: float = 1e-3,
    seconds: float = float("inf"),
    boxes: float = float("inf"),
    points: np.ndarray | None = None,
    progress: Callable[[int, int, float], None] | None = None,
) -> Search:
    """Set a bounder's threshold by proof and give it its certificate.

    Args:
        bounder: Changed in place (``freeze``).
        grid: The object that it bounds.
        eps: Largest gap, in ``f``, between the proven minimum and the least value found.
        seconds: Time for the search; a shorter one costs tightness, never soundness.
        boxes: Number of boxes for the search, likewise.
        points: ``(P, n)`` concrete low points to begin with, coordinates ``v``.
        progress: See ``minimum``.

    Returns:
        The search, with its lowest points.

    Raises:
        BounderError: If the bounder was made for another domain, or no threshold separates anything (the proven minimum is
            not finite).
    """
    started = time.perf_counter()
    reason = _mismatch(bounder, grid) or bounder.domain.fault()
    if reason or len(_outside(bounder, grid)):
        raise BounderError(
            f"{bounder.method}: {reason or 'the shape reaches outside the domain that the bounder was made for'}"
        )
    if not provable(bounder):
        raise BounderError(f"{bounder.method}: {bounder.query_kind} queries have no proof yet")
    if bounder.closed_form:
        least, looked_at = bounder.least(grid)
        search = Search(least, least, np.empty((0, grid.ndim)), looked_at, time.perf_counter() - started, True)
    else:
        limits = {"eps": eps, "seconds": seconds, "boxes": boxes, "points": points, "progress": progress}
        if bounder.query_kind == "plane":
            gap = SupportGap(bounder, grid)
            search = minimum(gap, *gap.boxes(), **limits)
        else:
            search = minimum(of_points(bounder), *positive_boxes(of_points(bounder), grid), **limits)
    error = bounder.rounding_bound()
    threshold = float(round_down(_minus(search.lower_bound, error)))
    if not np.isfinite(threshold):
        raise BounderError(f"{bounder.method}: the proof found no finite minimum")
    cells, dilated = len(grid.occupied), f" dilated by {grid.margin:g}" if grid.margin else ""
    met = "no point of" if bounder.query_kind == "point" else f"no {bounder.query_kind} that meets"
    message = (
        f"Proven: {met} the object{dilated}, all {cells} occupied cells, is ever answered with no. "
        f"f >= {search.lower_bound:.6g} on them, float32 rounding changes it by at most {error:.2g}, the threshold is {threshold:.6g}."
    )
    certificate = document(
        bounder, grid, "proven", threshold, search.lower_bound, search.boxes, search.seconds, message
    )
    bounder.freeze(threshold, certificate)
    return search


def certify(
    bounder: Bounder, shape, *, seconds: float = 300.0, progress: Callable[[int, int], None] | None = None
) -> Certificate:
    """Prove from scratch that a bounder has no false negative on a shape. Raises nothing for a bounder that does; tells the truth.

    Args:
        bounder: Its threshold and weights are taken as they are, its own certificate is not looked at.
        shape: An ``IndicatorGrid`` or ``IndicatorMesh``, or anything that ``load_indicator`` takes; voxelised with the bounder's
            own resolution and margin.
        seconds: Time allowed.
        progress: Called with cells done and cells in all.

    Returns:
        A certificate of kind ``"proven"``, ``"refuted"`` (with a counterexample), ``"undecided"`` or ``"inapplicable"``.
    """
    started = time.perf_counter()
    try:
        grid = _as_grid(bounder, shape)
    except BoundingError as error:
        return _inapplicable(bounder, shape, str(error))
    reason = _mismatch(bounder, grid) or bounder.domain.fault()
    if not bounder.conservative:
        reason = f"{bounder.method} is not conservative"
    if reason:
        return _inapplicable(bounder, shape, reason)
    certificates = []
    for part in bounder.parts:
        left = seconds - (time.perf_counter() - started)
        certificates.append(_certify(part, grid, max(left, 0.0), progress))
        if certificates[-1].kind not in ("proven", "statistical"):
            break
    return conjunction(certificates)


def _certify(bounder: Bounder, grid: IndicatorGrid, seconds: float, progress) -> Certificate:
    """``certify`` for one part of a conjunction."""
    started = time.perf_counter()
    threshold, error = float(bounder.threshold), bounder.rounding_bound()
    target = _plus(threshold, error)
    cells, least, boxes = grid.occupied, np.inf, 0

    def result(kind: str, message: str, bound: float, counterexample=None) -> Certificate:
        spent = time.perf_counter() - started
        return document(bounder, grid, kind, threshold, bound, boxes, spent, message, counterexample)

    outside = _outside(bounder, grid)
    if len(outside):
        point = _denied(bounder, grid, grid.position(outside)) if bounder.query_kind == "point" else None
        text = "the shape reaches outside the domain that the bounder was made for"
        return result("refuted" if point is not None else "undecided", text, threshold, point)
    checked = of_points(bounder)
    if bounder.query_kind != "point" and checked is bounder:
        return _certify_regions(bounder, grid, target, seconds, result)
    for start in range(0, len(cells), CHUNK):
        part = _check_cells(checked, grid, target, started + seconds, cells[start : start + CHUNK])
        least, boxes = min(least, part.least), boxes + part.boxes
        if part.suspects is not None or part.late:
            break
        if progress:
            progress(min(start + CHUNK, len(cells)), len(cells))
    if part.late:
        return result("undecided", f"no decision within {seconds:g} s", least)
    if part.suspects is not None:
        point = _denied(bounder, grid, part.suspects)
        if point is not None:
            text = f"a {bounder.query_kind} that meets the object is answered with no"
            return result("refuted", text, least, point)
        return result("undecided", "f comes closer to the threshold than the proof's margins for rounding allow", least)
    dilated = f" dilated by {grid.margin:g}" if grid.margin else ""
    return result(
        "proven",
        f"Proven from scratch: all {len(cells)} occupied cells of {grid.name}{dilated} are answered with maybe.",
        least,
    )


def _certify_regions(bounder: Bounder, grid: IndicatorGrid, target: float, seconds: float, result) -> Certificate:
    """``certify`` for rays, planes and boxes."""
    if not provable(bounder):
        done, lowest, missed = try_positives(bounder, grid, POSITIVES, int(grid.digest[:8], 16))
        if missed is not None:
            return result("refuted", "a query that meets the object is answered with no", lowest, missed)
        rate = fn_rate_bound(done)
        text = (
            f"Statistical, not proven: {done:,} fresh positives, none answered with no; at {CONFIDENCE:.0%} confidence fewer "
            f"than {rate:.2g} of such queries are missed."
        )
        margin = lowest - float(bounder.threshold)
        certificate = result("statistical", text, lowest)
        return replace(certificate, samples=done, fn_rate_bound=rate, confidence=CONFIDENCE, worst_margin=margin)
    if bounder.closed_form:
        least, complete = bounder.least(grid)[0], True
    else:
        gap = SupportGap(bounder, grid)
        found = float(gap.reference(gap.boxes()[0]).min())
        search = minimum(gap, *gap.boxes(), eps=max(1e-4, 0.25 * (found - target)), seconds=seconds)
        while search.lower_bound < target <= search.upper_bound and search.complete and search.seconds < seconds:
            eps = 0.5 * (search.upper_bound - target)
            if eps < NARROWEST:
                break
            search = minimum(gap, *gap.boxes(), eps=eps, seconds=seconds, points=search.worst)
        least, complete = search.lower_bound, search.complete
    if least >= target:
        return result(
            "proven",
            f"Proven from scratch: every {bounder.query_kind} that meets {grid.name} is answered with maybe.",
            least,
        )
    _, _, missed = try_positives(bounder, grid, POSITIVES, 1)
    if missed is not None:
        return result("refuted", "a query that meets the object is answered with no", least, missed)
    text = "f comes closer to the threshold than the proof allows" if complete else f"no decision within {seconds:g} s"
    return result("undecided", text, least)


class _Checked(NamedTuple):
    """Outcome of some cells: least bound, boxes, points (object space) that break the proof, whether time ran out."""

    least: float
    boxes: int
    suspects: np.ndarray | None = None
    late: bool = False


def _check_cells(bounder: Bounder, grid: IndicatorGrid, target: float, deadline: float, cells: np.ndarray) -> _Checked:
    """Check ``f >= target`` over all that the pipeline can make of the points of some cells."""
    first, last = grid.position(cells - 0.5), grid.position(cells + 0.5)
    low, high = bounder.domain.widened(first, last)
    stack, least, boxes = [(low, high, np.arange(len(cells)))], np.inf, 0
    while stack:  # in chunks, so that memory grows with depth, not with the number of boxes
        low, high, owner = stack.pop()
        if len(low) > CHUNK:
            stack += [(low[part], high[part], owner[part]) for part in (slice(CHUNK, None), slice(CHUNK))]
            continue
        bounds = bounder.bound(low, high)
        boxes += len(low)
        proven = bounds.lower >= target
        least = min(least, float(bounds.lower[proven].min(initial=np.inf)))
        low, high, owner, failed = low[~proven], high[~proven], owner[~proven], bounds.lower[~proven]
        if not len(low):
            continue
        below = bounds.value[~proven] < target
        if below.any() or (high - low).max(axis=1).min() < NARROWEST:
            suspects, cell = np.concatenate([bounds.point[~proven], (low + high) / 2]), np.tile(owner, 2)
            lowest = np.argsort(bounder.reference(suspects))[:SUSPECTS]
            suspects, cell = suspects[lowest], cell[lowest]
            inside = np.clip(bounder.domain.to_object(suspects), first[cell], last[cell])  # P_delta is a little wider
            inner = inside + PULL * (
                (first[cell] + last[cell]) / 2 - inside
            )  # a corner's float32 neighbour may lie outside
            inside = np.concatenate([inside, inner])
            return _Checked(float(failed.min()), boxes, inside)
        if time.perf_counter() > deadline:
            return _Checked(float(failed.min()), boxes, late=True)
        low, high = halve(low, high, bounds.axis[~proven])
        stack.append((low, high, np.tile(owner, 2)))
    return _Checked(least, boxes)


def _as_grid(bounder: Bounder, shape) -> IndicatorGrid:
    """The shape's cells, made as they were for the fit."""
    shape, margin = load_indicator(shape), bounder.info.get("margin") or 0.0
    resolution = None if isinstance(shape, IndicatorGrid) else bounder.info.get("resolution")
    return shape.to_grid(resolution=resolution, margin=margin)


def _mismatch(bounder: Bounder, grid: IndicatorGrid) -> str | None:
    """Why a grid's points cannot be this bounder's queries, or ``None``."""
    if grid.ndim == bounder.ndim and grid.time == bounder.domain.time:
        return None
    kinds = [
        f"{n}D" + (", animated" if t else "") for n, t in ((grid.ndim, grid.time), (bounder.ndim, bounder.domain.time))
    ]
    return f"the shape is {kinds[0]}, the bounder {kinds[1]}"


def _outside(bounder: Bounder, grid: IndicatorGrid) -> np.ndarray:
    """The occupied cells that reach outside the bounder's domain."""
    domain, cells = bounder.domain.base, grid.occupied
    return cells[
        ((grid.position(cells - 0.5) < domain.lower) | (grid.position(cells + 0.5) > domain.upper)).any(axis=1)
    ]


def _denied(bounder: Bounder, grid: IndicatorGrid, x: np.ndarray) -> np.ndarray | None:
    """The first of these points, as float32, that lies in the object and that the deployed bounder answers with no.

    Boxes: as a box that is no more than the point.
    """
    x = np.asarray(x, dtype=np.float64).astype(np.float32)
    x = x[grid.contains(x)]
    if not len(x):
        return None
    x = x if bounder.query_kind == "point" else np.concatenate([x, x], axis=1)
    missed = np.flatnonzero(bounder.query(x).numpy() == 0)
    return x[missed[0]] if len(missed) else None


def _minus(a: float, b: float) -> float:
    """``a - b`` rounded down, whatever the last bit does."""
    return float(np.nextafter(a - b, -np.inf))


def _plus(a: float, b: float) -> float:
    """``a + b`` rounded up."""
    return float(np.nextafter(a + b, np.inf)) + UNIT64 * abs(a)


def _inapplicable(bounder: Bounder, shape, reason: str) -> Certificate:
    certificate = document(bounder, None, "inapplicable", float(bounder.threshold), 0.0, 0, 0.0, reason)
    return replace(certificate, indicator=getattr(shape, "digest", ""))
