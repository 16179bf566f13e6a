"""What is known about a bounder, as a document: what was proven, over which set and in which arithmetic."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from math import expm1, log1p
from typing import Any, Protocol

import numpy as np

from warp_bounding.errors import FileFormatError
from warp_bounding.indicators.recentred import Frame
from warp_bounding.queries.domain import Domain
from warp_bounding.queries.region_domain import RegionDomain

__all__ = ["ABOUT", "Certificate", "Subject", "fn_rate_bound"]

ARITHMETIC = (
    "float32, round to nearest, any summation order, with or without fused multiply-add, subnormals kept or flushed"
)
ABOUT = ("object", "margin", "length", "resolution", "placement")  # fields that say what the claim is about


def fn_rate_bound(count: int, confidence: float = 0.95) -> float:
    """Upper confidence bound of a rate of which no case was seen in ``count`` independent trials; 1 without trials."""
    return -expm1(log1p(-confidence) / count) if count else 1.0


@dataclass(frozen=True)
class Certificate:
    """A proof that a bounder has no false negative, or an honest account of why there is none.

    Attributes:
        kind: ``"proven"``; ``"statistical"`` where there is no proof, or it did not end in its time; or, from
            ``certify`` only, ``"refuted"`` (a counterexample is given), ``"undecided"`` (as where time ran out) or
            ``"inapplicable"`` (the shape cannot be the bounded one, or another claim was expected).
        query: Kind of query, such as ``"point"``.
        domain: ``[lower, upper]`` corners in object space.
        threshold: The float32 number that ``f`` is compared with.
        lower_bound: Certified lower bound of the exact ``f`` over every v that the pipeline can make of a positive
            query.
        rounding_bound: E, which bounds the error of ``f`` as any device computes it.
        delta: Per axis, the input error that the proof covers, as a fraction of a cell.
        boxes: Boxes that the proof examined.
        seconds: Time that the proof took.
        indicator: SHA-256 of the cells it was proven over.
        cells: Number of occupied cells.
        counterexample: A positive query, in object space, that the bounder denies, or ``None``.
        message: A few sentences for people.
        arithmetic: What ``rounding_bound`` covers.
        samples: Statistical: fresh positives that were asked, none of them missed.
        fn_rate_bound: Statistical: upper confidence bound of the rate of false negatives among such positives.
        confidence: Confidence of that bound; all restarts are counted, each has spent its share of the risk.
        worst_margin: Statistical: how far the least f of these positives lies above the threshold.
        restarts: Statistical: thresholds before this one that missed a positive.
        object: Name of the object. This and what follows is ``None`` in files made by versions that did not tell it
            here.
        margin: The length by which the object was dilated, object units.
        length: The length of rays, object units; ``None`` for other queries.
        resolution: The resolution that a mesh was voxelised with; ``None`` for grids.
        placement: Per axis, object units: by how much ``xform=`` and ``scale=`` may round a query; those that need more
            are refused.

    Example:
        >>> certificate = bounder.certificate
        >>> certificate.proven, certificate.query
        (True, 'point')
        >>> certificate.threshold <= certificate.lower_bound - certificate.rounding_bound
        True
    """

    kind: str
    query: str
    domain: list[list[float]]
    threshold: float
    lower_bound: float
    rounding_bound: float
    delta: list[float]
    boxes: int
    seconds: float
    indicator: str
    cells: int
    counterexample: list[float] | None = None
    message: str = ""
    arithmetic: str = ARITHMETIC
    samples: int = 0
    fn_rate_bound: float | None = None
    confidence: float | None = None
    worst_margin: float | None = None
    restarts: int = 0
    object: str | None = None
    margin: float | None = None
    length: float | None = None
    resolution: int | None = None
    placement: list[float] | None = None

    @property
    def proven(self) -> bool:
        """Whether there is a proof.

        Example:
            >>> bounder.certificate.proven
            True
        """
        return self.kind == "proven"

    def to_dict(self) -> dict:
        """JSON-ready.

        Example:
            >>> bounder.certificate.to_dict()["kind"]
            'proven'
        """
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict) -> "Certificate":
        """Inverse of ``to_dict``.

        Raises:
            FileFormatError: If a field is missing or unknown.

        Example:
            >>> wb.Certificate.from_dict(bounder.certificate.to_dict()) == bounder.certificate
            True
        """
        names = {f.name for f in fields(cls)}
        later = {"samples", "fn_rate_bound", "confidence", "worst_margin", "restarts", *ABOUT}  # than the first files
        if not isinstance(values, dict) or not names - later <= set(values) <= names:
            raise FileFormatError("the certificate's fields are not the ones this version knows")
        return cls(**values)


class Subject(Protocol):
    """A bounder as certificates and files see it, without its method; every ``Bounder`` is one, and says what these are."""

    method: str
    conservative: bool
    composed: bool
    domain: Domain | RegionDomain
    tensors: dict[str, np.ndarray]
    sizes: dict[str, Any]
    threshold: np.float32
    certificate: Certificate | None
    info: dict[str, Any]
    frame: Frame | None
    query_kind: str
    ndim: int
    provable: bool
    parts: Sequence["Subject"]
    delta_share: np.ndarray | None

    def rounding_bound(self) -> float:
        """See ``Bounder``."""
