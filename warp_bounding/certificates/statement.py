"""A certificate in words: what is claimed, over which set of queries and in which arithmetic, and what is not claimed.

What ``info`` prints can be read beside the theorem of ``docs/proofs.md``. Nothing is computed here; every number is the
certificate's or the domain's.
"""

from math import floor, log10

import numpy as np

from warp_bounding.certificates import Certificate, Subject, least_allowance, shown
from warp_bounding.queries import QUERIES
from warp_bounding.queries.distance import DISTANCE
from warp_bounding.shapes.joints import TURNS

__all__ = ["NOT_CONSERVATIVE", "statement"]

NOT_CONSERVATIVE = "NOT conservative: it misses queries that meet the object, and is kept to show what that does."
DIGITS = 4  # of the size of a box, to which its corners are printed
UNITS = "object units"  # those of the shape's own coordinates
AT_REST = (
    "The distance is never above that to the object, and so no ball, segment, swept ball or box that meets the object "
    "is ever answered with no."
)
MOVING = (
    "The distance is never above that to the object at its time, and so no ball at a time and no box of time and space "
    "that meets the object is ever answered with no; nor is a segment of time and space or a swept ball that touches "
    "it on its way (one that it encloses without touching may be)."
)


def statement(bounder: Subject) -> dict[str, str]:
    """What is known of a bounder, by heading, in the order in which it is to be read.

    Args:
        bounder: Any bounder, with or without a certificate.
    """
    certificate, info = bounder.certificate, bounder.info
    words = _known(bounder, certificate)
    if info.get("note"):  # what of the object is not bounded
        words["note"] = str(info["note"])
    if bounder.frame is not None:
        takes = "query takes world coordinates, and takes it off in float64; kernels take local ones"
        words["origin"] = f"{bounder.frame.told}; {takes}"
    words |= {"for": _queries(bounder), "object": _object(bounder, certificate)}
    if certificate is None:
        return words
    if bounder.query_kind != DISTANCE.name:
        words["placement"] = _placement(bounder)
    words["arithmetic"] = f"{certificate.arithmetic}; CPU or CUDA"
    words["numbers"] = _numbers(bounder, certificate)
    words["proof"] = f"{certificate.boxes:,} boxes in {certificate.seconds:.2f} s; `certify` proves it anew from the "
    words["proof"] += "file and the shape"
    words["not proven"] = _not_proven(bounder)
    return words


def _known(bounder: Subject, certificate: Certificate | None) -> dict[str, str]:
    kind = QUERIES.get(bounder.query_kind)
    if certificate is None:
        none = "none: nothing is known of its false negatives" if kind else "none: nothing is known of its distances"
        return {"certificate": none if bounder.conservative else NOT_CONSERVATIVE}
    if certificate.proven:
        if kind is None:
            proven = MOVING if bounder.domain.time else AT_REST
        elif bounder.domain.unbounded:
            proven = "Where the answer is no, the point is in the object."
        else:
            proven = f"No {kind.positive} is ever answered with no."
        return {"certificate": "proven", "what is proven": proven}
    rate = "unknown" if certificate.fn_rate_bound is None else f"{certificate.fn_rate_bound:.3g}"
    restarts = f"; {certificate.restarts} thresholds before it missed one, each has spent its share of alpha"
    known = (
        f"{certificate.samples:,} fresh positives, none answered with no: fewer than {rate} of such queries are "
        f"missed, wrong with probability alpha = {1 - (certificate.confidence or 0.0):.2g} at most (Clopper-Pearson)"
    )
    return {
        "certificate": f"{certificate.kind}, not proven",
        "what is known": f"{known}{restarts if certificate.restarts else ''}; queries of another distribution, an "
        "adversary's above all, may be missed more often",
        "sampled": kind.distribution if kind else "",
    }


def _corners(domain: Subject) -> str:
    """Both corners of a domain, as finely as its sides are long: what is negligible next to a side is 0."""
    lower, upper = np.asarray(domain.lower, dtype=np.float64), np.asarray(domain.upper, dtype=np.float64)
    places = [DIGITS - 1 - floor(log10(side)) if side > 0 else DIGITS for side in (upper - lower).tolist()]

    def told(corner: np.ndarray) -> str:
        rounded = (round(value, digits) + 0.0 for value, digits in zip(corner.tolist(), places, strict=True))  # no -0
        return f"({', '.join(f'{value:.12g}' for value in rounded)})"

    return f"{told(lower)} to {told(upper)} (the object's own coordinates)"


def _queries(bounder: Subject) -> str:
    domain, corners = bounder.domain, _corners(bounder.domain)
    if bounder.query_kind == DISTANCE.name:
        return f"every float32 point, inside the domain, {corners}, or outside; NaN and infinity have distance 0"
    kind = QUERIES[bounder.query_kind]
    every = kind.every.format(length=domain.length or 0)
    if domain.unbounded:
        return f"{every}, {corners}, that is not in it; what lies outside the domain is answered with maybe"
    if domain.joints is not None:
        turns = f", and continuous joints count within {TURNS:,} turns" if any(domain.joints.period) else ""
        return f"{every}, {corners}; beyond the limits of joints the answer is maybe{turns}"
    if not kind.is_region:
        return f"{every}, {corners}; what lies outside it is not in the object"
    return f"{every}; only its part inside the domain counts, {corners}"


def _without_cells(bounder: Subject) -> bool:
    """Whether the bounder is of a shape itself; what was made without ``fit`` says nothing of it."""
    return "grid_shape" in bounder.info and bounder.info["grid_shape"] is None


def _object(bounder: Subject, certificate: Certificate | None) -> str:
    info, cells = bounder.info, ""
    if not _without_cells(bounder):
        shape = info.get("grid_shape")
        cells = f": a grid of {' x '.join(map(str, shape)) if shape else 'an unknown number of'} closed cells"
        cells += f", {certificate.cells:,} of them occupied" if certificate else ""
        cells += f", at resolution {info['resolution']}" if info.get("resolution") else ""
    margin, digest = info.get("margin") or 0.0, info.get("indicator") or "unknown"
    dilated = f"dilated by {margin} ({UNITS})" if margin else "not dilated"
    return f"{info.get('name') or 'a shape'}{cells}, {dilated}; SHA-256 {digest[:16]}"


def _placement(bounder: Subject) -> str:
    """By how much the numbers of a query may be off, in the units of the object's coordinates."""
    if bounder.domain.joints is not None:
        return "configurations have no place in the world: xform= and scale= are refused"
    base, timed = bounder.domain.base, bounder.domain.time
    covered = np.asarray(base.delta, dtype=np.float64) / base.scale.astype(np.float64)
    of_time = f" and {covered[0]:.2g} in time" if timed else ""
    return (
        f"a query may be off by up to {covered[int(timed) :].max(initial=0.0):.2g} ({UNITS}) on each axis{of_time}, "
        "for what float32 rounds of float64 queries, of xform= and scale=, and inside; a placement that rounds it by "
        f"more than {least_allowance(bounder):.2g}, such as one far from the object, is refused with an error"
    )


def _numbers(bounder: Subject, certificate: Certificate) -> str:
    if bounder.query_kind == DISTANCE.name:
        unit = bounder.domain.unit
        return (
            f"the slack, {-certificate.threshold * unit:.6g} ({UNITS}), is taken off what the method computes, so that "
            f"it is never too large; E = {certificate.rounding_bound * unit:.2g} of it is for rounding"
        )
    least = (
        f"at least {shown(certificate.lower_bound)} on all of these"
        if certificate.proven
        else f"{shown(certificate.lower_bound)} where a search found it least"
    )
    above = certificate.worst_margin
    closest = "" if above is None else f"; the closest sample lay {above:.3g} above it"
    return (
        f"f, which the method computes, is {least}, and rounding changes it by at most "
        f"E = {shown(certificate.rounding_bound, 2)}; the answer is no only where f < "
        f"{shown(certificate.threshold, 9)}, the threshold{closest}"
    )


def _not_proven(bounder: Subject) -> str:
    info, far = bounder.info, bounder.query_kind == DISTANCE.name
    if info.get("resolution"):
        what = "anything of the shape but that it lies in these cells (every cell that it or its margin meets is one)"
    elif _without_cells(bounder):
        what = (
            "that a shape made by a function is what its author says; of a mesh, the vertices count as read, in float32"
        )
    else:
        what = "anything of what the cells were made from"
    time = "queries outside the range of time (answered with maybe); " if bounder.domain.time else ""
    loose = "how much smaller than the distance it is" if far else "how many false positives there are"
    return f"{what}; other shapes, or this one dilated by more; {time}{loose} (evaluate measures it)"
