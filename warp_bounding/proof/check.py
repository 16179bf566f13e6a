"""Prove from scratch what a file claims: which claim it is, whether it can be about the shape, and what must be proven.

Both searches are loops of their own, which halve boxes (``halving``): of points and planes (``covering``), and of
distances (``distances``), by other boxes than those by which the threshold was set. ``taylor`` bounds networks. A
volume has one bound, here and where its threshold is set; where F is the distance to a volume, that volume is checked.
Where the shape certifies no box, fresh positives are queried (``stress``).
"""

import os
from collections.abc import Callable

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.bounders.distance import DistanceBounder
from warp_bounding.bounders.load import bounder_of
from warp_bounding.certificates import Certificate, Verdict, conjunction, document
from warp_bounding.certificates.claim import OUTSIDE, fitted_and_fault, in_local, mismatch, target, uncovered
from warp_bounding.errors import BounderError, BoundingError
from warp_bounding.proof.covering import Checked, check_covering, cover_cells, cover_domain, cover_planes
from warp_bounding.proof.distances import overestimate_within
from warp_bounding.proof.halving import Checkpoint, unfinished
from warp_bounding.proof.prove import TOUCHED
from warp_bounding.proof.stress import CONFIDENCE, POSITIVES, descend, fn_rate_bound, fresh_seed, try_positives
from warp_bounding.proof.taylor import TaylorBounds
from warp_bounding.queries import QUERIES, decision
from warp_bounding.queries.boundary import border_points
from warp_bounding.runtime.launch import working_seconds
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.shape import IN, OUT, Shape

BORDER = 65_536  # points of a border among which some outside the domain are looked for
LEAST_SECONDS = 1.0  # of a search for a counterexample where the proof has no decision
AROUND = (0.0, 1e-6, 1e-5, 1e-4, 1e-3)  # distances in v from a suspect at which a counterexample is searched for
CLOSE = "f comes closer to the threshold than the proof's margins for rounding allow"


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
    check_budget(budget)
    numbers = {"margin": margin, "length": length, "resolution": resolution}
    expected = {"query": query} | {name: _exactly(name, value) for name, value in numbers.items()}
    bounder = bounder_of(bounder)
    frame, fault = bounder.frame, None
    try:
        bounder, shape = in_local(bounder, shape)
        fault = frame.fault(bounder) if frame else None
    except BoundingError as error:
        fault = str(error)
    if fault:
        return document(bounder, shape, Verdict("inapplicable", fault, 0.0), 0.0)
    bounder, shape = (TaylorBounds().given_to(each) for each in (bounder, shape))
    options = {"checkpoint": checkpoint, "progress": progress, "scheduler": scheduler}
    certificate = _certify(bounder, shape, expected, budget, **options)
    return frame.noted(certificate) if frame else certificate


def check_budget(budget: float) -> None:
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


def _certify(
    bounder: Bounder,
    shape,
    expected: dict[str, str | float | None],
    budget: float,
    checkpoint: str | os.PathLike | None = None,
    **options,
) -> Certificate:
    """``certify`` in local coordinates; ``expected`` is for ``other_claim``, ``options`` are for ``halving.search``."""
    started = working_seconds()
    shape, fault = fitted_and_fault(bounder, shape, expected)
    if not bounder.of_distances:
        fault = fault or uncovered(bounder)
    if not bounder.conservative:
        fault = f"{bounder.method} is not conservative"
    if fault and fault != OUTSIDE:
        return document(bounder, shape, Verdict("inapplicable", fault, 0.0), 0.0)
    volume, saved = volume_of(bounder) if bounder.of_distances else None, None
    parts = bounder.parts if volume is None else [volume]
    if fault:  # the object reaches out of the domain, where the bounder answers before any part does
        parts = [bounder]
    elif checkpoint is not None:
        if parts != [bounder]:
            raise BounderError(f"{bounder.method}: a checkpoint is for a proof of one part that is searched for")
        saved = Checkpoint(checkpoint, bounder, shape)
    certificates = []
    for part in parts:
        begun = working_seconds() - (saved.seconds if saved else 0.0)
        if part is not bounder:
            fault = mismatch(part, shape) or uncovered(part)
        limits = {"budget": max(budget - (working_seconds() - started), 0.0), "checkpoint": saved, **options}
        deployed = bounder if volume is None else volume
        if fault:
            verdict = _at_fault(part, shape, deployed, fault)
        elif part.of_distances:
            verdict = check_distance(part, shape, **limits)
        else:
            verdict = check_part(part, shape, deployed, **limits)
        if part is volume:
            part, verdict = bounder, distance_to(bounder, shape, verdict)
        certificates.append(document(part, shape, verdict, working_seconds() - begun))
        if verdict.kind not in ("proven", "statistical"):
            break
    return conjunction(certificates)


def _at_fault(bounder: Bounder, shape: Shape, deployed: Bounder, fault: str) -> Verdict:
    """What is known where the claim is not about the shape: points of it outside the domain may refute the claim."""
    x = None
    if fault == OUTSIDE and (bounder.of_distances or not QUERIES[bounder.query_kind].is_region):
        domain = bounder.domain.base
        if isinstance(shape, Grid):
            x = shape.position(shape.cells_beyond(domain.lower, domain.upper))
        else:
            x = border_points(shape, BORDER, np.random.default_rng(0))
            x = x[((x < domain.lower) | (x > domain.upper)).any(axis=1)]
        x = overestimated(bounder, shape, x) if bounder.of_distances else denied(deployed, shape, x)
    return Verdict("undecided" if x is None else "refuted", fault, float(bounder.threshold), counterexample=x)


# --- points and regions -----------------------------------------------------------------------------------------------


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
    x = x[shape.decide(x) != OUT]
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


# --- distances -------------------------------------------------------------------------------------------------------


def check_distance(bounder: DistanceBounder, shape: Shape, budget: float, **options) -> Verdict:
    """Check a distance whose F is bounded over boxes.

    Args:
        bounder: Its threshold and numbers are taken as they are; its own certificate is ignored.
        shape: The object, its margin included.
        budget: Seconds allowed.
        **options: For ``halving.search``.
    """
    overestimate, boxes, complete, suspects = overestimate_within(bounder, shape, -target(bounder), budget, **options)
    text = "F comes closer to the distance than the proof allows"
    if not complete:
        text = unfinished(f"{budget:.3g} s", options["checkpoint"])
    return _concluded(bounder, shape, -overestimate, boxes, text, suspects)


def volume_of(bounder: DistanceBounder) -> Bounder | None:
    """The bounder of points whose volume's distance F is, to be checked by itself; ``None`` if F is another one."""
    if bounder.volume is None:
        return None
    volume = bounder.volume.to()
    volume.info = {name: bounder.info.get(name) for name in ("margin", "resolution")}
    return volume


def distance_to(bounder: DistanceBounder, shape: Shape, volume: Verdict) -> Verdict:
    """The verdict of a distance to a volume, from that of the volume."""
    suspects = np.reshape([] if volume.counterexample is None else volume.counterexample, (-1, shape.ndim))
    if volume.kind == "proven":
        text = "the threshold does not cover what float32 rounds"
        return _concluded(bounder, shape, 0.0, volume.boxes, text, suspects)
    return _concluded(bounder, shape, -np.inf, volume.boxes, volume.message, suspects)


def _concluded(
    bounder: DistanceBounder, shape: Shape, least: float, boxes: int, text: str, suspects: np.ndarray
) -> Verdict:
    """The verdict where ``d - F >= least`` holds; ``text`` says why that may not be enough."""
    if float(bounder.threshold) <= 0 and target(bounder) <= least < np.inf:
        text = f"Proven from scratch: the distance is never overestimated{TOUCHED if shape.time else ''}."
        return Verdict("proven", text, least, boxes)
    if (x := overestimated(bounder, shape, suspects)) is not None:
        return Verdict("refuted", "a distance is overestimated", least, boxes, x)
    return Verdict("undecided", text, least, boxes)


def overestimated(bounder: DistanceBounder, shape: Shape, x: np.ndarray) -> np.ndarray | None:
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
