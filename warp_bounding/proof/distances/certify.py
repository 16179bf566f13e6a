"""Proving from scratch what a distance's file claims: ``d - F >= threshold + E`` on the whole domain, and the object lies in it."""

import os
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from warp_bounding.bounders.distance import DistanceBounder
from warp_bounding.certificates.certificate import Certificate
from warp_bounding.certificates.claim import OUTSIDE, as_fitted, mismatch, other_claim
from warp_bounding.certificates.document import document
from warp_bounding.errors import BounderError, BoundingError
from warp_bounding.indicators.shape import IN, Shape
from warp_bounding.proof.distances.checkpoint import Checkpoint
from warp_bounding.proof.distances.excesses import excess_within
from warp_bounding.proof.distances.prove import TOUCHED
from warp_bounding.proof.shape_check import points_outside
from warp_bounding.runtime.launch import working_seconds

__all__ = ["certify_distance"]

LOOSE = "the threshold does not cover what float32 rounds"
GOES_ON = "; the same command goes on from {}"
CLOSE = "F comes closer to the distance than the proof allows"


def certify_distance(
    bounder: DistanceBounder,
    shape,
    expected: dict[str, str | float | None],
    seconds: float,
    progress: Callable[[int, int], None] | None,
    checkpoint: str | os.PathLike | None = None,
    *,
    of_points: Callable[..., Certificate],
) -> Certificate:
    """``certify`` of a distance.

    Args:
        bounder: Its threshold and numbers are taken as they are; its own certificate is not looked at.
        shape: As ``certify`` takes it.
        expected: The claim that is expected (``other_claim``).
        seconds: Time allowed.
        progress: As ``certify`` takes it.
        checkpoint: As ``certify`` takes it.
        of_points: ``certify`` itself, for the volume of a closed form.
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
        of_volume = of_points(volume, grid, seconds=seconds, progress=progress)
        suspects = None if of_volume.counterexample is None else np.array([of_volume.counterexample])
        least, boxes, told = (0.0 if of_volume.proven else -np.inf), of_volume.boxes, of_volume.message
    else:
        held = None if checkpoint is None else Checkpoint(checkpoint, bounder, grid)
        bar = -float(np.nextafter(threshold + error, np.inf))
        excess, boxes, complete, suspects = excess_within(bounder, grid, bar, seconds, held, progress)
        least, before = -excess, held.seconds if held else 0.0
        told = CLOSE if complete else f"no decision within {seconds:.3g} s{GOES_ON.format(checkpoint) if held else ''}"
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
