"""Proofs: branch and bound over every input that can come from the object, and proving anew what a file claims."""

from warp_bounding.certificates.document import conjunction
from warp_bounding.proof.attest.soak import Soak, soak
from warp_bounding.proof.attest.statistics import attempt_confidence, attest, fn_rate_bound, fresh_seed, try_positives
from warp_bounding.proof.certify import certify
from warp_bounding.proof.covers.base import positive_boxes
from warp_bounding.proof.prove import charted, least_value, prove, prove_or_attest, settle
from warp_bounding.proof.search.best_first import Search, minimum
from warp_bounding.proof.segments import clear_segments
from warp_bounding.proof.share import Share, proven_share

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
