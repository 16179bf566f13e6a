"""A certificate in words: what is claimed, over which set of queries and in which arithmetic, and what is not claimed.

One text for each kind of certificate and of query, so that what ``info`` prints can be read beside the theorem of
``docs/proofs.md``. Nothing is computed here; every number is the certificate's or the domain's.
"""

from collections.abc import Iterable

from warp_bounding.certificates.certificate import Certificate, Subject
from warp_bounding.certificates.document import least_allowance
from warp_bounding.indicators.shape import DETAILS
from warp_bounding.queries import QUERIES
from warp_bounding.queries.distance import DISTANCE

__all__ = ["NOT_CONSERVATIVE", "statement"]

NOT_CONSERVATIVE = "NOT conservative: it misses queries that meet the object, and is kept to show what that does."


def _numbers(values: Iterable[float]) -> str:
    return f"({', '.join(f'{v:.4g}' for v in values)})"


def _queries(bounder: Subject) -> str:
    domain, kind = bounder.domain, QUERIES[bounder.query_kind]
    corners = f"{_numbers(domain.lower)} to {_numbers(domain.upper)}"
    every = kind.every.format(length=domain.length or 0)
    if domain.unbounded:
        return (
            f"{every}, {corners} (object space), that is not in it; what lies outside the domain is answered with maybe"
        )
    if not kind.is_region:
        return f"{every}, {corners} (object space); what lies outside it is not in the object"
    text = f"{every}; only its part inside the domain counts, {corners} (object space)"
    if domain.parametric:
        text += "; fitted in the paper's parametric space, a query given by a point outside the domain is answered with maybe"
    return text


def _object(bounder: Subject, certificate: Certificate | None) -> str:
    info = bounder.info
    margin, shape = info.get("margin") or 0.0, info.get("grid_shape")
    if _without_cells(bounder):
        dilated = f"dilated by {margin} (object units)" if margin else "not dilated"
        return f"{info.get('name') or 'a shape'}: the shape itself, no cells, {dilated}; SHA-256 {str(info.get('indicator'))[:16]}"
    grid = " x ".join(map(str, shape)) if shape else "an unknown number of"
    cells = f"{certificate.cells:,} occupied of {grid} closed cells" if certificate else f"a grid of {grid} cells"
    fineness = f" at resolution {info['resolution']}" if info.get("resolution") else ""
    dilated = f", dilated by {margin} (object units)" if margin else ", not dilated"
    digest = (certificate.indicator if certificate else info.get("indicator")) or "unknown"
    return f"{info.get('name') or 'a shape'}: {cells}{fineness}{dilated}; SHA-256 {digest[:16]}"


def _detail(bounder: Subject) -> str:
    if bounder.domain.unbounded:
        return f"a cell, or of 1/{DETAILS} of the longest side where there are no cells,"
    return f"1/{DETAILS} of the longest side" if _without_cells(bounder) else "a cell"


def _without_cells(bounder: Subject) -> bool:
    """Whether the bounder is of a shape itself; what was made without ``fit`` says nothing of it."""
    return "grid_shape" in bounder.info and bounder.info["grid_shape"] is None


def _not_proven(bounder: Subject) -> Iterable[str]:
    info = bounder.info
    if info.get("resolution"):
        yield "anything of the mesh beyond its cells' cover of it (every cell within the margin of it is occupied)"
    elif _without_cells(bounder):
        yield "what a function's author says of it; a mesh is the one with the float32 vertices that were read"
    else:
        yield "anything of what the cells were made from"
    yield "other shapes, or this one dilated by more"
    if bounder.domain.time:
        yield "queries outside the range of time (answered with maybe)"
        if not info.get("resolution") and not _without_cells(bounder):
            yield "motion between the frames of the array"
    yield "how many false positives there are (evaluate)"


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
        return {"certificate": text, "queries": _queries(bounder), "object": _object(bounder, None)}
    about = {"for": _queries(bounder), "object": _object(bounder, certificate)}
    placement = (
        f"xform= and scale= may round a query by up to {least_allowance(bounder):.2g} (object units) on every axis; one that "
        "needs more, such as a shape that is very large beside its cells, is refused with an error"
    )
    if not certificate.proven:
        return _statistical(bounder, certificate, about, placement)
    return {
        "certificate": "proven",
        "what is proven": "Where the answer is no, the point is in the object."
        if bounder.domain.unbounded
        else f"No {QUERIES[bounder.query_kind].positive} is ever answered with no.",
        **about,
        "input error": f"up to {max(certificate.delta, default=0.0):.2g} of {_detail(bounder)} on each axis: the rounding of float64 queries, of the "
        "map, and of xform= and scale=",
        "placement": placement,
        "arithmetic": f"{certificate.arithmetic}; CPU or CUDA",
        "numbers": f"f >= {certificate.lower_bound:.6g} on all of these, rounding E <= {certificate.rounding_bound:.2g}, "
        f"maybe unless f < threshold {certificate.threshold:.9g} <= bound - E",
        "proof": f"{certificate.boxes:,} boxes in {certificate.seconds:.2f} s; `certify` proves it anew from the file and the shape",
        "not proven": "; ".join(_not_proven(bounder)),
    }


def _of_distance(bounder: Subject, certificate: Certificate | None) -> dict[str, str]:
    domain = bounder.domain
    corners = f"{_numbers(domain.lower)} to {_numbers(domain.upper)}"
    about = {
        "for": f"every float32 point, inside the domain {corners} (object space) or outside; NaN and infinity have distance 0",
        "object": _object(bounder, certificate),
    }
    if certificate is None or not certificate.proven:
        return {"certificate": "none: nothing is known of its distances", **about}
    unit = domain.unit
    return {
        "certificate": "proven",
        "what is proven": "The distance is never above that to the object, and so no ball, segment, swept ball or box that meets the object is "
        "ever answered with no.",
        **about,
        "arithmetic": f"{certificate.arithmetic}; CPU or CUDA",
        "numbers": f"slack {-certificate.threshold * unit:.6g}, of which rounding takes E <= {certificate.rounding_bound * unit:.2g} (object units)",
        "proof": f"{certificate.boxes:,} boxes in {certificate.seconds:.2f} s; `certify` proves it anew from the file and the shape",
        "not proven": "; ".join(
            [*list(_not_proven(bounder))[:-1], "how much smaller than the distance it is (evaluate)"]
        ),
    }


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
        "what is known": f"{certificate.samples:,} fresh positives in {certificate.seconds:.2f} s, none answered with no: fewer than "
        f"{rate} of such queries are missed, wrong with probability alpha = {alpha:.2g} at most (Clopper-Pearson){tried}",
        "sampled": QUERIES[bounder.query_kind].distribution,
        **about,
        "placement": placement,
        "arithmetic": "float32, as this device computed it; CPU or CUDA",
        "numbers": f"least f that a search found {certificate.lower_bound:.6g}; threshold {certificate.threshold:.9g}; "
        f"{closest}; rounding E <= {certificate.rounding_bound:.2g}",
        "not proven": "that no query is missed: queries of another distribution, an adversary's above all, may be missed more "
        "often; and " + "; ".join(_not_proven(bounder)),
    }
