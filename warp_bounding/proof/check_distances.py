"""Checks ``d - F >= threshold + E`` of a distance on the whole domain, and that the object lies in it.

Where F is the distance to a volume that a bounder of points has, that bounder is checked. Else boxes of the domain are
halved (``distances``), other ones than those by which the threshold was set.
"""

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.bounders.distance import DistanceBounder
from warp_bounding.certificates import Verdict
from warp_bounding.certificates.claim import target
from warp_bounding.proof.distances import overestimate_within
from warp_bounding.proof.halving import unfinished
from warp_bounding.proof.prove import TOUCHED
from warp_bounding.shapes.shape import IN, Shape


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
