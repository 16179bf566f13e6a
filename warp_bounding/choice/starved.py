"""Whether a network had too little time to tell what its kind can do: too few steps, or a proof that was cut short."""

import numpy as np

from warp_bounding.bounders import Bounder, DistanceBounder
from warp_bounding.bounders.neural.mlp import RECIPES
from warp_bounding.choice.pace import ROUND_STEPS, ROUNDS

__all__ = ["hardly_trained", "starved"]

ENOUGH = 0.6  # of ``ROUNDS``
LOST = 0.25  # of what it leaves beside positives: what the proof's gap may account for


def hardly_trained(bounder: Bounder | DistanceBounder) -> str:
    """That a network has made too few steps by the default recipe to tell what its kind can do, in words; empty for others."""
    record, enough = _record(bounder), ROUNDS * ROUND_STEPS
    steps, usual = record.get("steps"), record.get("recipe", RECIPES[0]) == RECIPES[0]
    if steps is None or steps >= ENOUGH * enough or not usual:
        return ""
    return f"hardly trained: {steps:,} steps, about {enough:,} tell what it can do"


def starved(bounder: Bounder | DistanceBounder, spare: float, x: np.ndarray) -> str:
    """Why a network that has just been fitted tells little, in words; empty where it was trained and proven in peace.

    Args:
        bounder: With the record of its training.
        spare: Share of the queries that it leaves although they do not meet the object.
        x: ``(Q, m)`` queries.
    """
    if few := hardly_trained(bounder):
        return few
    record = _record(bounder)
    if record.get("complete", True) or spare <= 0:
        return ""
    if "thresholds" not in record and isinstance(bounder, Bounder):
        f = bounder.values(np.ascontiguousarray(x, dtype=np.float32)).numpy()
        threshold = float(bounder.threshold)
        if float(((f >= threshold) & (f < threshold + record["gap"])).mean()) <= LOST * spare:
            return ""
    return "its proof had too little time, so that it is looser than its kind"


def _record(bounder: Bounder | DistanceBounder) -> dict:
    """Of a network's training; a cascade's last part has it."""
    record = bounder.info["training"]
    if "steps" not in record:
        record = (getattr(bounder, "parts", None) or [bounder])[-1].info.get("training") or record
    return record
