"""Proving from scratch what a distance's file claims: ``d - F >= threshold + E`` on the whole domain, and the object lies in it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from warp_bounding.bounders.distances.base import DistanceBounder
from warp_bounding.certificates.certificate import Certificate
from warp_bounding.certificates.document import document
from warp_bounding.errors import BoundingError
from warp_bounding.indicators.shape import IN, Shape
from warp_bounding.proof.distances.prove import distance_shape, other_motion, search
from warp_bounding.proof.prove import OUTSIDE, other_claim, other_dimension, reaches_outside
from warp_bounding.proof.shape_check import points_outside
from warp_bounding.runtime.launch import working_seconds

__all__ = ["certify_distance"]

LOOSE = "the threshold does not cover what float32 rounds"
CLOSE = "F comes closer to the distance than the proof allows"


def certify_distance(
    bounder: DistanceBounder,
    shape,
    expected: dict[str, str | float | None],
    seconds: float,
    progress: Callable[[int, int], None] | None,
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
        of_points: ``certify`` itself, for the volume of a closed form.
    """
    started, threshold, error = working_seconds(), float(bounder.threshold), bounder.rounding_bound()
    other = other_claim(bounder, expected)
    try:
        grid = distance_shape(bounder, shape)
    except BoundingError as reason:
        found = document(bounder, None, "inapplicable", threshold, 0.0, 0, 0.0, other or str(reason))
        return replace(found, indicator=getattr(shape, "digest", ""))

    def result(status: str, message: str, least: float, boxes: int = 0, counterexample=None) -> Certificate:
        spent = working_seconds() - started
        return document(bounder, grid, status, threshold, least, boxes, spent, message, counterexample)

    reason = other or other_dimension(bounder, grid) or bounder.domain.fault() or other_motion(bounder, grid)
    if reason:
        return result("inapplicable", reason, threshold)
    if reaches_outside(bounder, grid):
        point = _overestimated(bounder, grid, points_outside(bounder, grid))
        return result("undecided" if point is None else "refuted", OUTSIDE, threshold, 0, point)
    if bounder.volume is not None:
        volume = bounder.volume.to()
        volume.info = {name: bounder.info.get(name) for name in ("margin", "resolution")}
        of_volume = of_points(volume, grid, seconds=seconds, progress=progress)
        suspects = None if of_volume.counterexample is None else np.array([of_volume.counterexample])
        least, boxes, told = (0.0 if of_volume.proven else -np.inf), of_volume.boxes, of_volume.message
    else:
        found = search(bounder, grid, seconds, float(np.nextafter(threshold + error, np.inf)))
        least, boxes, suspects = found.least, found.boxes, found.worst
        told = CLOSE if found.complete else f"no decision within {seconds:.3g} s"
    if threshold <= 0 and float(np.nextafter(threshold + error, np.inf)) <= least < np.inf:
        return result("proven", "Proven from scratch: the distance is never overestimated.", least, boxes)
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
