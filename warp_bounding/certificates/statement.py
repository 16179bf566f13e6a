"""A certificate in words: what is claimed, over which set of queries and in which arithmetic, and what is not claimed.

One text for each kind of certificate and of query, so that what ``info`` prints can be read beside the theorem of
``docs/proofs.md``. Nothing is computed here; every number is the certificate's or the domain's.
"""

from collections.abc import Iterable
from math import floor, log10

import numpy as np

from warp_bounding.certificates import Certificate, Subject, least_allowance, shown
from warp_bounding.queries import QUERIES
from warp_bounding.queries.distance import DISTANCE
from warp_bounding.shapes.joints import TURNS

__all__ = ["NOT_CONSERVATIVE", "statement"]

NOT_CONSERVATIVE = "NOT conservative: it misses queries that meet the object, and is kept to show what that does."


DIGITS = 4  # of the size of a box, to which its corners are printed

AT_REST = (
    "The distance is never above that to the object, and so no ball, segment, swept ball or box that meets the object "
    "is ever answered with no."
)
MOVING = (
    "The distance is never above that to the object at its time, and so no ball at a time and no box of time and space "
    "that meets the object is ever answered with no; nor is a segment of time and space or a swept ball that touches "
    "it "
    "on its way (one that it encloses without touching may be)."
)
UNITS = "object units"  # those of the shape's own coordinates


def _corners(domain: Subject) -> str:
    """Both corners of a domain, as finely as its sides are long: what is negligible next to a side is 0."""
    lower, upper = np.asarray(domain.lower, dtype=np.float64), np.asarray(domain.upper, dtype=np.float64)
    places = [DIGITS - 1 - floor(log10(side)) if side > 0 else DIGITS for side in (upper - lower).tolist()]

    def told(corner: np.ndarray) -> str:
        rounded = (round(value, digits) + 0.0 for value, digits in zip(corner.tolist(), places, strict=True))  # no -0
        return f"({', '.join(f'{value:.12g}' for value in rounded)})"

    return f"{told(lower)} to {told(upper)} (the object's own coordinates)"


def _queries(bounder: Subject) -> str:
    domain, kind = bounder.domain, QUERIES[bounder.query_kind]
    corners = _corners(domain)
    every = kind.every.format(length=domain.length or 0)
    if domain.unbounded:
        return f"{every}, {corners}, that is not in it; what lies outside the domain is answered with maybe"
    if domain.joints is not None:
        turns = f", and continuous joints count within {TURNS:,} turns" if any(domain.joints.period) else ""
        return f"{every}, {corners}; beyond the limits of joints the answer is maybe{turns}"
    if not kind.is_region:
        return f"{every}, {corners}; what lies outside it is not in the object"
    return f"{every}; only its part inside the domain counts, {corners}"


def _object(bounder: Subject, certificate: Certificate | None) -> str:
    info = bounder.info
    margin, shape = info.get("margin") or 0.0, info.get("grid_shape")
    if _without_cells(bounder):
        dilated = f"dilated by {margin} ({UNITS})" if margin else "not dilated"
        return f"{info.get('name') or 'a shape'}, {dilated}; SHA-256 {str(info.get('indicator'))[:16]}"
    grid = " x ".join(map(str, shape)) if shape else "an unknown number of"
    cells = f"{certificate.cells:,} occupied of {grid} closed cells" if certificate else f"a grid of {grid} cells"
    fineness = f" at resolution {info['resolution']}" if info.get("resolution") else ""
    dilated = f", dilated by {margin} ({UNITS})" if margin else ", not dilated"
    digest = (certificate.indicator if certificate else info.get("indicator")) or "unknown"
    return f"{info.get('name') or 'a shape'}: {cells}{fineness}{dilated}; SHA-256 {digest[:16]}"


def _note(bounder: Subject) -> dict[str, str]:
    """What of the object is not bounded, under a heading of its own, where there is something."""
    told = {"note": str(bounder.info["note"])} if bounder.info.get("note") else {}
    if bounder.frame is not None:
        told["origin"] = (
            f"{bounder.frame.told}; query takes world coordinates, and takes it off in float64; kernels take local ones"
        )
    return told


def _input_error(bounder: Subject) -> str:
    """By how much the proof lets the numbers of a query be off, in the units of the object's coordinates."""
    base, timed = bounder.domain.base, bounder.domain.time
    covered = np.asarray(base.delta, dtype=np.float64) / base.scale.astype(np.float64)
    space = covered[int(timed) :]
    of_time = f" and {covered[0]:.2g} in time" if timed else ""
    return (
        f"a query may be off by up to {space.max(initial=0.0):.2g} ({UNITS}) on each axis{of_time}, for what float32 "
        "rounds of "
        "float64 queries, of xform= and scale=, and inside"
    )


def _without_cells(bounder: Subject) -> bool:
    """Whether the bounder is of a shape itself; what was made without ``fit`` says nothing of it."""
    return "grid_shape" in bounder.info and bounder.info["grid_shape"] is None


def _not_proven(bounder: Subject) -> Iterable[str]:
    info = bounder.info
    if info.get("resolution"):
        yield (
            "anything of the shape but that it lies in these cells (every cell that the shape or its margin meets "
            "is "
            "one)"
        )
    elif _without_cells(bounder):
        yield (
            "that a shape made by a function is what its author says; of a mesh, the vertices count as they were "
            "read, in float32"
        )
    else:
        yield "anything of what the cells were made from"
    yield "other shapes, or this one dilated by more"
    if bounder.domain.time:
        yield "queries outside the range of time (answered with maybe)"
        if not info.get("resolution") and not _without_cells(bounder):
            yield "motion between the frames of the array"
    yield "how many false positives there are (evaluate measures it)"


def statement(bounder: Subject) -> dict[str, str]:
    """What is known of a bounder, by heading, in the order in which it is to be read.

    Args:
        bounder: Any bounder, with or without a certificate.
    """
    certificate = bounder.certificate
    if bounder.query_kind == DISTANCE.name:
        return _of_distance(bounder, certificate)
    if certificate is None:
        text = "none: nothing is known of its false negatives" if bounder.conservative else NOT_CONSERVATIVE
        return {"certificate": text, **_note(bounder), "queries": _queries(bounder), "object": _object(bounder, None)}
    about = _note(bounder) | {"for": _queries(bounder), "object": _object(bounder, certificate)}
    placement = (
        f"xform= and scale= may round a query by up to {least_allowance(bounder):.2g} ({UNITS}) on every axis; what "
        "would round "
        "it by more, such as a translation that is very large beside the object, is refused with an error"
        if bounder.domain.joints is None
        else "configurations have no place in the world: xform= and scale= are refused"
    )
    if not certificate.proven:
        return _statistical(bounder, certificate, about, placement)
    return {
        "certificate": "proven",
        "what is proven": "Where the answer is no, the point is in the object."
        if bounder.domain.unbounded
        else f"No {QUERIES[bounder.query_kind].positive} is ever answered with no.",
        **about,
        "input error": _input_error(bounder),
        "placement": placement,
        "arithmetic": f"{certificate.arithmetic}; CPU or CUDA",
        "numbers": f"f, which the method computes, is at least {shown(certificate.lower_bound)} on all of these, and "
        "rounding changes it by at most "
        f"E = {shown(certificate.rounding_bound, 2)}; the answer is no only where f < "
        f"{shown(certificate.threshold, 9)}, the threshold",
        "proof": _proof(certificate),
        "not proven": "; ".join(_not_proven(bounder)),
    }


def _of_distance(bounder: Subject, certificate: Certificate | None) -> dict[str, str]:
    domain = bounder.domain
    corners = _corners(domain)
    about = {
        **_note(bounder),
        "for": f"every float32 point, inside the domain, {corners}, or outside; NaN and infinity have distance 0",
        "object": _object(bounder, certificate),
    }
    if certificate is None or not certificate.proven:
        return {"certificate": "none: nothing is known of its distances", **about}
    unit = domain.unit
    return {
        "certificate": "proven",
        "what is proven": MOVING if domain.time else AT_REST,
        **about,
        "arithmetic": f"{certificate.arithmetic}; CPU or CUDA",
        "numbers": f"the slack, {-certificate.threshold * unit:.6g} ({UNITS}), is taken off what the method computes, "
        "so that it is never too large; "
        f"E = {certificate.rounding_bound * unit:.2g} of it is for rounding",
        "proof": _proof(certificate),
        "not proven": "; ".join(
            [*list(_not_proven(bounder))[:-1], "how much smaller than the distance it is (evaluate measures it)"]
        ),
    }


def _proof(certificate: Certificate) -> str:
    boxes = f"{certificate.boxes:,} box{'' if certificate.boxes == 1 else 'es'}"
    return f"{boxes} in {certificate.seconds:.2f} s; `certify` proves it anew from the file and the shape"


def _statistical(bounder: Subject, certificate: Certificate, about: dict[str, str], placement: str) -> dict[str, str]:
    rate = "unknown" if certificate.fn_rate_bound is None else f"{certificate.fn_rate_bound:.3g}"
    alpha = 1 - (certificate.confidence or 0.0)
    margin = certificate.worst_margin
    closest = "no f was computed" if margin is None else f"the closest lay {margin:.3g} above the threshold"
    tried = ""
    if certificate.restarts:
        tried = f"; {certificate.restarts} thresholds before it missed one, each has spent its share of alpha"
    return {
        "certificate": f"{certificate.kind}, not proven",
        "what is known": f"{certificate.samples:,} fresh positives in {certificate.seconds:.2f} s, none answered with "
        "no: fewer than "
        f"{rate} of such queries are missed, wrong with probability alpha = {alpha:.2g} at most "
        f"(Clopper-Pearson){tried}",
        "sampled": QUERIES[bounder.query_kind].distribution,
        **about,
        "placement": placement,
        "arithmetic": "float32, as this device computed it; CPU or CUDA",
        "numbers": f"least f that a search found {shown(certificate.lower_bound)}; threshold "
        f"{shown(certificate.threshold, 9)}; "
        f"{closest}; rounding changes f by at most E = {shown(certificate.rounding_bound, 2)}",
        "not proven": "that no query is missed: queries of another distribution, an adversary's above all, may be "
        "missed more "
        "often; and " + "; ".join(_not_proven(bounder)),
    }
