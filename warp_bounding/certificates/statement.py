"""A certificate in words: its message, over which set of queries and in which arithmetic, and what is not claimed.

What ``info`` prints can be read beside the theorem of ``docs/proofs.md``. Nothing is computed here; every number is the
certificate's or the domain's.
"""

from math import floor, log10
from typing import TYPE_CHECKING

import numpy as np

from warp_bounding.queries import QUERIES
from warp_bounding.queries.distance import DISTANCE
from warp_bounding.shapes.joints import TURNS

if TYPE_CHECKING:
    from warp_bounding.bounders.bounder import Bounder

NOT_CONSERVATIVE = "NOT conservative: it misses queries that meet the object, and is kept to show what that does."
DIGITS = 4  # of the size of a box, to which its corners are printed


def statement(bounder: "Bounder") -> dict[str, str]:
    """What is known of a bounder, by heading, in the order in which it is to be read.

    Args:
        bounder: Any bounder, with or without a certificate.
    """
    certificate, info = bounder.certificate, bounder.info
    side = ", from the inside" if bounder.domain.unbounded else ""
    kind = f"{bounder.ndim}D {bounder.query_kind} queries{side}"
    words = {"method": f"{bounder.method}, {kind}, {bounder.nbytes:,} bytes"}
    if certificate is not None:
        known = "what is proven" if certificate.proven else "what is known"
        words["certificate"] = certificate.kind if certificate.proven else f"{certificate.kind}, not proven"
        words[known] = certificate.message
    elif bounder.conservative:
        of = "distances" if bounder.query_kind == DISTANCE.name else "false negatives"
        words["certificate"] = f"none: nothing is known of its {of}"
    else:
        words["certificate"] = NOT_CONSERVATIVE
    if info.get("note"):  # what of the object is not bounded
        words["note"] = str(info["note"])
    if bounder.frame is not None:
        takes = "query takes world coordinates, and takes it off in float64; kernels take local ones"
        words["origin"] = f"{bounder.frame.summary}; {takes}"
    margin, digest = info.get("margin") or 0.0, info.get("indicator") or "unknown"
    dilated = f"dilated by {margin} (object units)" if margin else "not dilated"
    words["for"] = _queries(bounder)
    words["object"] = f"{info.get('name') or 'a shape'}, {dilated}; SHA-256 {digest[:16]}"
    if certificate is not None:
        words["arithmetic"] = f"{certificate.arithmetic}; CPU or CUDA"
        words["proof"] = f"{certificate.boxes:,} boxes in {certificate.seconds:.2f} s"
        words["proof"] += "; `certify` proves it anew from the file and the shape"
        words["not proven"] = _not_proven(bounder)
    return words


def _corners(domain) -> str:
    """Both corners of a domain, as finely as its sides are long: what is negligible next to a side is 0."""
    lower, upper = np.asarray(domain.lower, dtype=np.float64), np.asarray(domain.upper, dtype=np.float64)
    places = [DIGITS - 1 - floor(log10(side)) if side > 0 else DIGITS for side in (upper - lower).tolist()]

    def told(corner: np.ndarray) -> str:
        rounded = (round(value, digits) + 0.0 for value, digits in zip(corner.tolist(), places, strict=True))  # no -0
        return f"({', '.join(f'{value:.12g}' for value in rounded)})"

    return f"{told(lower)} to {told(upper)} (the object's own coordinates)"


def _queries(bounder: "Bounder") -> str:
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


def _not_proven(bounder: "Bounder") -> str:
    info, far, moves = bounder.info, bounder.query_kind == DISTANCE.name, bounder.domain.time
    if info.get("resolution"):
        what = "anything of the shape but that it lies in these cells (every cell that it or its margin meets is one)"
    elif info.get("grid_shape", ()) is None:  # what was made without ``fit`` says nothing of it
        what = (
            "that a shape made by a function is what its author says; of a mesh, the vertices count as read, in float32"
        )
    else:
        what = "anything of what the cells were made from"
    time = "queries outside the range of time (answered with maybe); " if moves else ""
    time += "segments of time and space that the object encloses without touching; " if far and moves else ""
    other = "" if bounder.certificate.proven else "queries of another distribution, an adversary's above all; "
    loose = "how much smaller than the distance it is" if far else "how many false positives there are"
    return f"{what}; other shapes, or this one dilated by more; {time}{other}{loose} (evaluate measures it)"
