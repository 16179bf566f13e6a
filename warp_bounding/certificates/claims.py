"""Whether the numbers of a stored certificate can be true of the bounder in the same file.

A file's digest detects damage, and these checks detect careless edits by someone who computed it anew. A lie that adds
up passes, and only ``certify`` finds it out.
"""

from math import isfinite, prod
from typing import Any

import numpy as np

from warp_bounding.arithmetic import round_down
from warp_bounding.certificates.certificate import Certificate, Subject, fn_rate_bound
from warp_bounding.errors import FileFormatError
from warp_bounding.indicators.shape import Shape
from warp_bounding.queries.domain import DELTA_LARGEST_SHARE

__all__ = ["check_claims"]

KINDS = ("proven", "statistical", "refuted", "undecided", "inapplicable")
CLOSE = 1e-6  # relative difference of numbers that another machine may have computed with other last bits
LEAST_ERROR = 0.5  # of E as this version computes it: other versions may bound E otherwise, but not by less than half


def check_claims(bounder: Subject, certificate: Certificate, document: dict[str, Any]) -> None:
    """Refuse a certificate whose fields contradict each other, the bounder, or what the file says of the shape.

    Args:
        bounder: As it was read.
        certificate: As it was read.
        document: The file's other fields: ``threshold``, ``indicator``, ``name``, ``margin``, ``length``,
            ``resolution``, and ``grid_shape``, which older files do not have.

    Raises:
        FileFormatError: If one is impossible; it is named.
    """
    _check_subject(bounder, certificate, document["threshold"])
    kind, error = certificate.kind, bounder.rounding_bound()
    if kind not in KINDS:
        _refuse(f"kind {kind!r} is not one of {', '.join(KINDS)}")
    for name in ("boxes", "cells", "samples", "restarts"):
        value = getattr(certificate, name)
        if type(value) is not int or value < 0:
            _refuse(f"{name} must be a whole number of at least 0, got {value!r}")
    for name in ("lower_bound", "rounding_bound", "seconds"):
        if not _number(getattr(certificate, name)):
            _refuse(f"{name} must be a finite number, got {getattr(certificate, name)!r}")
    if not isinstance(certificate.message, str) or not isinstance(certificate.arithmetic, str):
        _refuse("message and arithmetic must be text")
    if kind not in ("proven", "statistical"):  # the others promise nothing
        return
    if certificate.counterexample is not None:
        _refuse(f"{kind}, and yet there is a counterexample")
    _check_about(certificate, document)
    if document["indicator"] is not None and certificate.indicator != document["indicator"]:
        _refuse(f"it is about the shape {certificate.indicator[:16]}, the file about {document['indicator'][:16]}")
    if not certificate.rounding_bound >= LEAST_ERROR * error:
        _refuse(f"rounding bound {certificate.rounding_bound:.3g}, this bounder rounds by {error:.3g}")
    if not certificate.lower_bound >= certificate.threshold:
        _refuse(f"lower bound {certificate.lower_bound:.6g} is less than the threshold {certificate.threshold:.6g}")
    _check_delta(bounder, certificate, document.get("grid_shape"))
    if kind == "statistical":
        _check_statistics(bounder, certificate)
    elif certificate.samples or certificate.fn_rate_bound is not None:
        _refuse("proven, and yet there are samples")


def _check_subject(bounder: Subject, certificate: Certificate, threshold: float) -> None:
    """The certificate must be about this bounder; where it claims a proof, threshold, bound and rounding must agree."""
    if certificate.threshold != threshold:
        raise FileFormatError(f"the certificate is about threshold {certificate.threshold}, the file has {threshold}")
    corners = [bounder.domain.lower.tolist(), bounder.domain.upper.tolist()]
    if certificate.query != bounder.query_kind or certificate.domain != corners:
        raise FileFormatError("the certificate is about other queries or another domain than the file")
    if not bounder.conservative:
        raise FileFormatError(f"{bounder.method} is not conservative and cannot hold a certificate")
    if not certificate.proven:
        return
    if not bounder.provable:
        raise FileFormatError(
            f"the certificate claims a proof, {bounder.method} has none for {bounder.query_kind} queries"
        )
    error = bounder.rounding_bound()
    if not threshold <= round_down(certificate.lower_bound - error):
        raise FileFormatError(
            f"the certificate does not add up: threshold {threshold:.6g} exceeds bound {certificate.lower_bound:.6g} "
            f"less rounding {error:.2g}"
        )


def _check_about(certificate: Certificate, document: dict[str, Any]) -> None:
    """What the claim is about stands in the certificate and beside it; older files have it beside it only."""
    if certificate.placement is None:
        return
    beside = {name: document[name] for name in ("margin", "length", "resolution")} | {"object": document["name"]}
    beside["margin"] = beside["margin"] or 0.0  # ``None`` if the bounder was made without ``fit``
    for name, value in beside.items():
        own = getattr(certificate, name)
        if own != value and not (name == "object" and value is None):
            _refuse(f"it is for {name} {own!r}, the file for {value!r}")


def _check_delta(bounder: Subject, certificate: Certificate, grid_shape: Any) -> None:
    """Refuse an impossible number of cells, or an input error that is not the domain's.

    ``delta`` is a share of a cell, or without cells of a detail, in the certificate, and in local units in the domain.
    """
    base, delta = bounder.domain.base, np.array(certificate.delta, dtype=np.float64)
    largest, of_what = (DELTA_LARGEST_SHARE, "a cell") if certificate.cells else (Shape.largest_delta, "a detail")
    if delta.shape != (base.ndim,) or not ((delta >= 0) & (delta <= largest * (1 + CLOSE))).all():
        _refuse(f"delta must hold {base.ndim} shares of {of_what} up to {largest}, got {certificate.delta}")
    allowed = certificate.placement  # object units on each axis: by how much placing the shape may round a query
    if allowed is not None and not (
        isinstance(allowed, list) and len(allowed) == base.ndim and all(_number(a) and a >= 0 for a in allowed)
    ):
        _refuse(f"placement must hold {base.ndim} lengths of at least 0, got {allowed!r}")
    if allowed is not None and not (np.array(allowed) * base.scale <= base.delta * (1 + CLOSE)).all():
        _refuse(f"placements that round by {allowed}, delta covers less")
    if grid_shape is None:
        return
    if len(grid_shape) != base.ndim or not 0 < certificate.cells < prod(grid_shape):  # a grid is neither empty nor full
        _refuse(f"{certificate.cells} occupied cells of a grid of shape {grid_shape}")
    cell = base.scale.astype(np.float64) * (base.upper - base.lower) / np.array(grid_shape)  # local units
    share = base.delta / cell
    if not np.allclose(delta, share, rtol=CLOSE, atol=0.0):
        _refuse(f"delta {certificate.delta}, the domain's is {share.tolist()}")


def _check_statistics(bounder: Subject, certificate: Certificate) -> None:
    """Refuse a rate that is smaller than the samples allow; of a conjunction, the certificate holds sums."""
    rate, confidence = certificate.fn_rate_bound, certificate.confidence
    above = certificate.worst_margin  # the least f of the samples, less the threshold
    if not (_number(rate) and _number(confidence) and rate >= 0 and 0 < confidence < 1):
        _refuse(f"a rate of {rate!r} at confidence {confidence!r}")
    if len(bounder.parts) == 1 and not rate >= fn_rate_bound(certificate.samples, confidence) * (1 - CLOSE):
        _refuse(f"a rate of {rate:.3g} is less than {certificate.samples:,} samples allow")
    if above is not None and not (_number(above) and above >= 0):
        _refuse(f"worst margin {above!r}: a positive was missed")


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)


def _refuse(reason: str) -> None:
    raise FileFormatError(f"the certificate does not add up: {reason}")
