"""Proofs: branch and bound over every input that can come from the object, and proving anew what a file claims."""

from warp_bounding.certificates import conjunction
from warp_bounding.proof.check import certify
from warp_bounding.proof.lowering import make_proven
from warp_bounding.proof.prove import least_value, positive_boxes, prove, prove_or_test, settle
from warp_bounding.proof.search import Search, minimum
from warp_bounding.proof.segments import Segments, clear_segments
from warp_bounding.proof.stress import (
    StressResult,
    attempt_confidence,
    fn_rate_bound,
    fresh_seed,
    statistical_test,
    stress_test,
    try_positives,
)

__all__ = [
    "Search",
    "Segments",
    "StressResult",
    "attempt_confidence",
    "certify",
    "clear_segments",
    "conjunction",
    "fn_rate_bound",
    "fresh_seed",
    "least_value",
    "make_proven",
    "minimum",
    "positive_boxes",
    "prove",
    "prove_or_test",
    "settle",
    "statistical_test",
    "stress_test",
    "try_positives",
]
