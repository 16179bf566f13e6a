"""Prove from scratch what a file claims: which claim it is, whether it can be about the shape, and what must be proven.

The checks themselves are apart: of points and planes (``check_points``), and of distances (``check_distances``). Both
halve boxes in a loop of their own (``halving``), and ``taylor`` bounds networks.
"""

import os
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.bounders.load import bounder_of
from warp_bounding.certificates import Certificate, Verdict, conjunction, document
from warp_bounding.certificates.claim import OUTSIDE, fitted_and_fault, in_local, mismatch, outside
from warp_bounding.errors import BounderError, BoundingError
from warp_bounding.proof.check_distances import check_distance, distance_to, overestimated, volume_of
from warp_bounding.proof.check_points import check_part, denied, uncovered
from warp_bounding.proof.halving import Checkpoint
from warp_bounding.proof.taylor import TaylorBounds
from warp_bounding.queries import QUERIES
from warp_bounding.runtime.launch import working_seconds
from warp_bounding.shapes.shape import Shape


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
        return _inapplicable(bounder, shape, fault)
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
        fault = fault or uncovered(bounder.domain.base)
    if not bounder.conservative:
        fault = f"{bounder.method} is not conservative"
    if fault and fault != OUTSIDE:
        return _inapplicable(bounder, shape, fault)
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
            fault = mismatch(part, shape) or uncovered(part.domain.base)
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
        certificates.append(_certificate(part, shape, verdict, working_seconds() - begun))
        if verdict.kind not in ("proven", "statistical"):
            break
    return conjunction(certificates)


def _at_fault(bounder: Bounder, shape: Shape, deployed: Bounder, fault: str) -> Verdict:
    """What is known where the claim is not about the shape: points of it outside the domain may refute the claim."""
    x = None
    if fault == OUTSIDE and bounder.of_distances:
        x = overestimated(bounder, shape, outside(bounder, shape))
    elif fault == OUTSIDE and not QUERIES[bounder.query_kind].is_region:
        x = denied(deployed, shape, outside(bounder, shape))
    return Verdict("undecided" if x is None else "refuted", fault, float(bounder.threshold), counterexample=x)


def _certificate(bounder: Bounder, shape: Shape | None, verdict: Verdict, seconds: float) -> Certificate:
    """A verdict's certificate."""
    kind, message, least, boxes, counterexample, statistics = verdict
    about = bounder, shape, kind, float(bounder.threshold), least, boxes, seconds, message, counterexample
    return document(*about, **(statistics or {}))


def _inapplicable(bounder: Bounder, shape, reason: str) -> Certificate:
    certificate = _certificate(bounder, None, Verdict("inapplicable", reason, 0.0), 0.0)
    return replace(certificate, indicator=getattr(shape, "digest", ""))
