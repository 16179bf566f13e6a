"""The step from a distance's F and a shape to a proven threshold: ``threshold <= L - E``, where ``d - F >= L`` on the whole domain.

Where F is the distance to a volume that a proven bounder of points has, L is 0: the volume holds the object. Else boxes of the domain are searched
(``excesses``).
"""

from typing import NamedTuple

import numpy as np

from warp_bounding.arithmetic import round_down
from warp_bounding.bounders.distance import DistanceBounder
from warp_bounding.certificates.certificate import Certificate
from warp_bounding.certificates.claim import mismatch
from warp_bounding.certificates.document import document
from warp_bounding.errors import BounderError
from warp_bounding.indicators.shape import Shape
from warp_bounding.proof.distances.excesses import largest_excess
from warp_bounding.runtime.launch import working_seconds

TOUCHED = ", at its time; segments and swept balls that are cleared touch nothing on their way, but may be enclosed"

__all__ = ["Found", "prove_distance", "search", "settle_distance"]


class Found(NamedTuple):
    """What a prover has found.

    Attributes:
        least: Certified lower bound of ``d - F`` over the domain, local units; minus infinity for none.
        boxes: How many boxes were looked at.
        seconds: How long that took.
        complete: False if time ran out.
        worst: ``(P, n)`` points in object space at which ``d - F`` is small, candidates for a counterexample.
        excess: ``(parts,)``, by how much F exceeds d in each part of the domain at most.
    """

    least: float
    boxes: int
    seconds: float
    complete: bool = True
    worst: np.ndarray | None = None
    excess: np.ndarray | None = None


def search(bounder: DistanceBounder, shape: Shape, seconds: float) -> Found:
    """Find the best L that there is time for."""
    started = working_seconds()
    excess, boxes, complete, worst = largest_excess(bounder, shape, seconds)
    return Found(-float(excess.max()), boxes, working_seconds() - started, complete, worst, excess)


def prove_distance(
    bounder: DistanceBounder, shape: Shape, *, of_volume: Certificate | None = None, seconds: float = float("inf")
) -> Found:
    """Set a bounder's threshold by proof and give it its certificate.

    Args:
        bounder: Changed in place (``freeze``).
        shape: The object that it bounds, its margin included.
        of_volume: The certificate of ``bounder.volume``, where there is one.
        seconds: Time for a search.

    Raises:
        BounderError: If the bounder was made for another domain or dimension, its volume is not proven, or nothing was found.
    """
    if reason := mismatch(bounder, shape):
        raise BounderError(f"{bounder.method}: {reason}")
    if bounder.volume is not None:
        if of_volume is None or not of_volume.proven:
            raise BounderError(
                f"{bounder.method}: a distance needs a volume that is proven, and {shape.name} certifies no box to be empty"
            )
        found = Found(0.0, of_volume.boxes, of_volume.seconds)
    else:
        found = search(bounder, shape, seconds)
        bounder.relieve(found.excess)
    settle_distance(bounder, shape, found)
    return found


def settle_distance(bounder: DistanceBounder, shape: Shape, found: Found) -> Certificate:
    """Set a bounder's threshold under what was found, and give it its certificate.

    Raises:
        BounderError: If there is no finite lower bound, or if the bounder was made for another object.
    """
    if reason := mismatch(bounder, shape):
        raise BounderError(f"{bounder.method}: {reason}")
    error = bounder.rounding_bound()
    threshold = min(float(round_down(np.nextafter(found.least - error, -np.inf))), 0.0)
    if not np.isfinite(threshold):
        raise BounderError(f"{bounder.method}: the proof found no finite slack")
    unit = bounder.domain.unit
    message = (
        f"Proven: the distance is never overestimated, for any float32 point anywhere{TOUCHED if shape.time else ''}."
    )
    numbers = (
        f"The slack, taken off so that no distance is too large, is {-threshold * unit:.3g}, {error * unit:.2g} of it for float32 "
        "rounding."
    )
    certificate = document(
        bounder, shape, "proven", threshold, found.least, found.boxes, found.seconds, message, numbers=numbers
    )
    bounder.freeze(threshold, certificate)
    return certificate
