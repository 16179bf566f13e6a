"""Whether a network had too little time to tell what its kind can do: too few steps, or a proof that was cut short."""

import numpy as np

from warp_bounding.bounders import Bounder, DistanceBounder
from warp_bounding.choice.pace import ROUND_STEPS, ROUNDS

__all__ = ["starved"]

ENOUGH = 0.6  # of ``ROUNDS``
LOST = 0.25  # of what it leaves beside positives: what the proof's gap may account for


def starved(bounder: Bounder | DistanceBounder, spare: float, x: np.ndarray) -> str:
    """Why a network that has just been fitted tells little, in words; empty where it was trained and proven in peace.

    Args:
        bounder: With the record of its training.
        spare: Share of the queries that it leaves although they do not meet the object.
        x: ``(Q, m)`` queries.
    """
    record = bounder.info["training"]
    if "steps" not in record:  # a cascade's last part has it
        record = (getattr(bounder, "parts", None) or [bounder])[-1].info.get("training") or record
    steps, enough = record.get("steps"), ROUNDS * ROUND_STEPS
    if steps is not None and steps < ENOUGH * enough:
        return f"hardly trained: {steps:,} steps, about {enough:,} tell what it can do"
    if record.get("complete", True) or spare <= 0:
        return ""
    if "thresholds" not in record and isinstance(bounder, Bounder):
        f = bounder.values(np.ascontiguousarray(x, dtype=np.float32)).numpy()
        threshold = float(bounder.threshold)
        if float(((f >= threshold) & (f < threshold + record["gap"])).mean()) <= LOST * spare:
            return ""
    return "its proof had too little time, so that it is looser than its kind"
