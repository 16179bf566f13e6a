"""What is known of a bounder, in the words that stand beside a picture of it."""

from warp_bounding.bounders.base import Bounder
from warp_bounding.bounders.distances.base import DistanceBounder
from warp_bounding.certificates.statement import NOT_CONSERVATIVE
from warp_bounding.indicators.shape import Shape
from warp_bounding.views.view import DRAWN, View

__all__ = ["facts_of", "title_of"]

FINENESS = {
    True: "what is thinner than a cell of the grid that finds it can be missing.",
    False: "each was asked at its centre.",
}  # by whether three coordinates are seen
NONE = "None: nothing is known of its false negatives."


def title_of(bounder: Bounder | DistanceBounder, shape: Shape) -> str:
    """A heading: the shape and the method."""
    return f"{shape.name}, bounded by {bounder.method}"


def facts_of(bounder: Bounder | DistanceBounder, shape: Shape, view: View) -> dict[str, str]:
    """Facts by heading, in the order in which they are to be read.

    Args:
        bounder: Any.
        shape: That is shown with it.
        view: That is shown with them.
    """
    side = ", from the inside" if bounder.domain.unbounded else ""
    facts = {
        "Bounder": f"{bounder.method}, {bounder.ndim}D {bounder.query_kind} queries{side}, {bounder.nbytes:,} bytes"
    }
    if bounder.certificate is not None:
        facts["Certificate"] = bounder.certificate.message
    else:
        facts["Certificate"] = NONE if bounder.conservative else NOT_CONSERVATIVE
    indicator = view.indicator
    if indicator != bounder.info.get("indicator"):
        fitted = bounder.info.get("indicator") or "unknown"
        facts["Another shape"] = (
            f"{shape.name} is not the shape that the bounder was fitted to: SHA-256 {indicator[:16]}, "
            f"that of the fit {fitted[:16]}. The certificate says nothing of it."
        )
    margin = bounder.info.get("margin") or 0.0
    object_told = f"{shape.name} as it is read" + (
        f"; the bound holds it dilated by {margin:g} (object units)" if margin else ""
    )
    where = "the surface" if view.solid else "the pixels"
    facts["Drawn"] = (
        f"The object is {object_told}. The bound is {where} where the deployed answers change; {FINENESS[view.solid]}"
    )
    if view.held:
        facts["Held"] = ", ".join(f"coordinate {axis} at {value:g}" for axis, value in view.held.items())
    facts["Points"] = f"Drawn at random in and around the object; at most {DRAWN:,} of a kind are shown."
    return facts
