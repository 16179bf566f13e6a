"""What is known about a bounder, as a document: what was proven, over which set and in which arithmetic."""

from dataclasses import asdict, dataclass, fields, replace
from math import expm1, log1p
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from warp_bounding.errors import FileFormatError
from warp_bounding.queries.placement import placement_allowance
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.shape import Shape

if TYPE_CHECKING:
    from warp_bounding.bounders.bounder import Bounder

ARITHMETIC = (
    "float32, round to nearest, any summation order, with or without fused multiply-add, subnormals kept or flushed"
)
FINITE = tuple(float(end) for end in (np.finfo(np.float32).min, np.finfo(np.float32).max))  # JSON has no infinity
ABOUT = ("object", "margin", "length", "resolution", "placement")  # fields that say what the claim is about


def fn_rate_bound(count: int, confidence: float = 0.95) -> float:
    """Upper confidence bound of a rate of which no case was seen in ``count`` independent trials; 1 without trials."""
    return -expm1(log1p(-confidence) / count) if count else 1.0


@dataclass(frozen=True)
class Certificate:
    """A proof that a bounder has no false negative, or an honest account of why there is none.

    Attributes:
        kind: ``"proven"``; ``"statistical"`` where there is no proof; or, from ``certify`` only, ``"refuted"`` (a
            counterexample is given), ``"undecided"`` (as where time ran out) or ``"inapplicable"`` (the shape cannot
            be the bounded one, or another claim was expected).
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
        samples: Statistical: fresh positives that were queried, none of them missed.
        fn_rate_bound: Statistical: upper confidence bound of the rate of false negatives among such positives.
        confidence: Confidence of that bound; all restarts are counted, each has spent its share of the risk.
        worst_margin: Statistical: how far the least f of these positives lies above the threshold.
        restarts: Statistical: thresholds before this one that missed a positive.
        object: Name of the object. This and what follows is ``None`` in files of versions that did not store it
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


class Verdict(NamedTuple):
    """What a check has found: fields of the ``Certificate`` that is made of it.

    Attributes:
        kind: See ``Certificate``.
        message: Its first sentence.
        lower_bound: See ``Certificate``.
        boxes: See ``Certificate``.
        counterexample: ``(m,)`` float32, or ``None``.
        statistics: Further fields, of a statistical test.
    """

    kind: str
    message: str
    lower_bound: float
    boxes: int = 0
    counterexample: np.ndarray | None = None
    statistics: dict | None = None


def document(bounder: "Bounder", shape: Shape, verdict: Verdict, seconds: float, numbers: str = "") -> Certificate:
    """The certificate of a bounder, at its threshold, for a shape.

    To the verdict's message is added what the claim is about and what restricts the object (``Shape.restriction``),
    then sentences with ``numbers``, and what placements are covered. Where the claim cannot be about the shape, no more
    of the shape is said than its digest, and it may be anything.
    """
    base, message, of_shape = bounder.domain.base, verdict.message, {"delta": [], "cells": 0}
    if verdict.kind != "inapplicable":
        sentences = [f"{message.strip().rstrip('.')}.", about(bounder, shape), numbers, _placed(bounder)]
        message = " ".join(filter(None, sentences))
        of_shape = {
            "delta": (base.delta / (base.scale / shape.details_per_unit)).tolist(),
            "cells": len(shape.occupied) if isinstance(shape, Grid) else 0,
            "object": shape.name,
            "margin": float(shape.margin),
            "resolution": shape.resolution,
            "placement": placement_allowance(bounder.domain).tolist(),
        }
    x = verdict.counterexample
    return Certificate(
        kind=verdict.kind,
        query=bounder.query_kind,
        domain=[base.lower.tolist(), base.upper.tolist()],
        threshold=float(bounder.threshold),
        lower_bound=float(np.clip(verdict.lower_bound, *FINITE)),
        rounding_bound=bounder.rounding_bound(),
        boxes=int(verdict.boxes),
        seconds=round(float(seconds), 3),
        indicator=getattr(shape, "digest", ""),
        counterexample=None if x is None else [float(c) for c in x],
        message=message,
        length=bounder.domain.length,
        **of_shape,
        **(verdict.statistics or {}),
    )


def about(bounder: "Bounder", grid: Shape) -> str:
    """What a certificate is about, in words: object, margin, cells, length of rays, and restrictions."""
    words = [grid.name, f"dilated by {float(grid.margin)} of its own units" if grid.margin else "not dilated"]
    if isinstance(grid, Grid):
        fineness = "" if grid.resolution is None else f", resolution {grid.resolution}"
        words.append(f"as {len(grid.occupied):,} of {' x '.join(map(str, grid.shape))} cells{fineness}")
    rays = "" if bounder.domain.length is None else f" Rays have length {bounder.domain.length}."
    known = "; ".join(filter(None, [grid.restriction, grid.remark]))
    restricted = f" ({known})" if known else ""
    return f"Object: {', '.join(words)}{restricted}.{rays}"


def _placed(bounder: "Bounder") -> str:
    """Which placements are covered."""
    if bounder.domain.joints is not None:
        return "Beyond limits of joints the answer is maybe."
    if not bounder.domain.base.delta.any():  # nothing is left for a placement
        return "Queries are in the object's own coordinates."
    least = float(placement_allowance(bounder.domain)[int(bounder.domain.time) :].min())
    return f"An xform= or scale= that rounds a query by more than {least:.2g} is refused."


def shown(value: float) -> str:
    """A number for people: what lies nearer to 0 than normal float32 numbers is 0."""
    return f"{value if abs(value) >= np.finfo(np.float32).tiny else 0.0:.6g}"


ORDER = ("refuted", "undecided", "statistical", "proven")  # a conjunction is known no better than its worst part


def conjunction(certificates: list[Certificate]) -> Certificate:
    """What is known of a conjunction of bounders, from the certificate of each; the threshold is that of the last one.

    The whole is proven if all parts are; rates of false negatives add up.
    """
    if len(certificates) == 1:
        return certificates[0]
    worst, last = min(certificates, key=lambda c: ORDER.index(c.kind)), certificates[-1]
    statistical = worst.kind == "statistical"
    message = f"{len(certificates)} tests that must all pass, each by itself; the last: {last.message}"
    return replace(
        last,
        kind=worst.kind,
        boxes=sum(c.boxes for c in certificates),
        seconds=round(sum(c.seconds for c in certificates), 3),
        counterexample=worst.counterexample,
        message=message if worst.kind in ("proven", "statistical") else worst.message,
        samples=min(c.samples for c in certificates) if statistical else last.samples,
        fn_rate_bound=sum(c.fn_rate_bound or 0.0 for c in certificates) if statistical else None,
        confidence=1 - sum(1 - (c.confidence or 1.0) for c in certificates) if statistical else None,
    )
