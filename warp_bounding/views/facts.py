"""What is known of a bounder, in the words that stand beside a picture of it."""

from warp_bounding.bounders.base import Bounder
from warp_bounding.bounders.distances.base import DistanceBounder
from warp_bounding.certificates.statement import NOT_CONSERVATIVE
from warp_bounding.indicators.shape import Shape

__all__ = ["facts_of", "title_of"]

NONE = "None: nothing is known of its false negatives."


def title_of(bounder: Bounder | DistanceBounder, shape: Shape) -> str:
    """A heading: the shape and the method."""
    return f"{shape.name}, bounded by {bounder.method}"


def facts_of(bounder: Bounder | DistanceBounder, shape: Shape, indicator: str, level: str) -> dict[str, str]:
    """Facts by heading, in the order in which they are to be read.

    Args:
        bounder: Any.
        shape: That is shown with it.
        indicator: SHA-256 of what was fitted, if the shape is that of the fit.
        level: What is drawn, in words.
    """
    side = ", from the inside" if bounder.domain.unbounded else ""
    facts = {"Bounder": f"{bounder.method}, {bounder.ndim}D {bounder.query_kind} queries{side}, {bounder.nbytes:,} bytes"}
    if bounder.certificate is not None:
        facts["Certificate"] = bounder.certificate.message
    else:
        facts["Certificate"] = NONE if bounder.conservative else NOT_CONSERVATIVE
    if indicator != bounder.info.get("indicator"):
        fitted = bounder.info.get("indicator") or "unknown"
        facts["Another shape"] = (
            f"{shape.name} is not the shape that the bounder was fitted to: SHA-256 {indicator[:16]}, "
            f"that of the fit {fitted[:16]}. The certificate says nothing of it."
        )
    facts["Drawn"] = level
    return facts
