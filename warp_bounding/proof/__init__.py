"""Proofs: branch and bound over every input that can come from the object, and proving anew what a file claims."""

from warp_bounding.proof.prove import certify, positive_boxes, prove
from warp_bounding.proof.search import Search, minimum

__all__ = ["Search", "certify", "minimum", "positive_boxes", "prove"]
