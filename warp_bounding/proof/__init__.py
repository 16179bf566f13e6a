"""Proofs: branch and bound over every input that can come from the object, and proving anew what a file claims."""

from warp_bounding.certificates import conjunction
from warp_bounding.proof.check import Share, certify, proven_share
from warp_bounding.proof.covers import positive_boxes
from warp_bounding.proof.prove import charted, least_value, prove, prove_or_attest, settle
from warp_bounding.proof.search import Search, minimum
from warp_bounding.proof.segments import clear_segments
from warp_bounding.proof.stress import (
    Soak,
    attempt_confidence,
    attest,
    fn_rate_bound,
    fresh_seed,
    soak,
    try_positives,
)

__all__ = [
    "Search",
    "Share",
    "Soak",
    "attempt_confidence",
    "attest",
    "certify",
    "charted",
    "clear_segments",
    "conjunction",
    "fn_rate_bound",
    "fresh_seed",
    "least_value",
    "minimum",
    "positive_boxes",
    "prove",
    "prove_or_attest",
    "proven_share",
    "settle",
    "soak",
    "try_positives",
]
