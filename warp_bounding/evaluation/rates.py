"""How tight a bounder is: false positives and false negatives among random queries, as fractions of all of them."""

import os
from collections.abc import Callable

import numpy as np

from warp_bounding.bounders.base import Bounder
from warp_bounding.bounders.distances.base import DistanceBounder
from warp_bounding.bounders.load import bounder_of
from warp_bounding.bounders.slabs import Aabb
from warp_bounding.certificates.claim import as_fitted, in_local, of_side
from warp_bounding.coordinates.region_domain import domain_of
from warp_bounding.errors import QueryError
from warp_bounding.evaluation.counting import counted
from warp_bounding.evaluation.distances import evaluate_distance
from warp_bounding.evaluation.report import QUICK, QUICK_SEED, Rates, truth_told
from warp_bounding.evaluation.truth import PROTOCOLS, judge_of, truth_by
from warp_bounding.indicators import IndicatorGrid
from warp_bounding.indicators.shape import Shape
from warp_bounding.queries import oracle, sample

__all__ = ["PROTOCOLS", "evaluate", "quick_rates"]


def evaluate(
    bounder: Bounder | DistanceBounder | str | os.PathLike,
    shape,
    samples: int = 1_000_000,
    protocol: str = "exact",
    *,
    seed: int = 1,
    radius: float | None = None,
    query: str | None = None,
    length: float | None = None,
    steps: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Rates:
    """Ask a bounder random queries of its kind and compare with the exact truth, that of the shape itself.

    Args:
        bounder: Any bounder, or the path of its file.
        shape: The ``IndicatorGrid`` or ``IndicatorMesh`` that it bounds, or anything that ``load_indicator`` takes. A
            mesh or a function is the truth itself, also where the fit bounded its cells.
        samples: Number of queries, drawn as in the paper (about a grid: between the centres of the first and
            the last cells; other shapes: a tenth of the longest side around the box that holds the object).
        protocol: ``"exact"``, or ``"sampled"``, the paper's way to find the truth: ``any()`` over random points of the
            region. That misses thin hits, so there are fewer positives. For points both are the same.
        seed: Seed of the samples.
        radius: Of a distance that is asked points: those within it count as positive; 0 if ``None``. Other bounders have none.
        query: Of a distance: what it is asked, ``"point"``, ``"ray"`` or ``"box"``; points if ``None``. Other bounders have one kind.
        length: Of the rays that a distance is asked, object units; 1 if ``None``.
        steps: Evaluations that a distance may spend on a ray or a box; its own default if ``None``.
        progress: Called with samples done and samples in all.

    Returns:
        The rates.

    Raises:
        QueryError: For an unknown protocol, fewer than one sample, a shape of another dimension, an impossible radius, or what only a
            distance is told.

    Example:
        >>> rates = wb.evaluate(bounder, grid, samples=10_000)
        >>> rates.fn, 0 < rates.fp_rate < 100
        (0, True)
    """
    if protocol not in PROTOCOLS:
        raise QueryError(f"protocol must be one of {', '.join(PROTOCOLS)}, got {protocol!r}")
    if isinstance(samples, bool) or not isinstance(samples, (int, np.integer)) or samples < 1:
        raise QueryError(f"samples must be a whole number of at least 1, got {samples!r}")
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise QueryError(f"seed must be a whole number of at least 0, got {seed!r}")
    bounder, shape = in_local(bounder_of(bounder), shape)
    if isinstance(bounder, DistanceBounder):
        told = {"radius": radius, "query": query, "length": length, "steps": steps}
        if shape.ndim != bounder.ndim:
            raise QueryError(f"the shape is {shape.ndim}D, the bounder {bounder.ndim}D")
        return evaluate_distance(bounder, shape, int(samples), protocol, int(seed), progress, **told)
    for name, value in {"radius": radius, "query": query, "length": length, "steps": steps}.items():
        if value is not None:
            raise QueryError(f"{name} is for distances, got {name}={value} for {bounder.query_kind} queries")
    shape = of_side(bounder, shape)
    fitted = as_fitted(bounder, shape)
    if fitted.ndim != bounder.ndim:
        raise QueryError(f"the shape is {fitted.ndim}D, the bounder {bounder.ndim}D")
    judge = judge_of(shape, fitted, bounder.query_kind, protocol)
    rng, length = np.random.default_rng(seed), bounder.domain.oracle_length
    truth_of = truth_by(protocol, bounder.query_kind, judge, bounder.device, length, seed)
    laid = isinstance(fitted, IndicatorGrid) and judge is not fitted
    of_cells = oracle(bounder.query_kind, fitted, bounder.device, length) if laid else None
    return counted(
        lambda count: sample(bounder.query_kind, judge, count, rng),
        truth_of,
        lambda x: bounder.query(x).numpy().astype(bool),
        int(samples),
        progress,
        of_cells,
        protocol=protocol,
        seed=int(seed),
        truth=truth_told(judge, fitted),
        indicator=fitted.digest,
    )


def quick_rates(bounder: Bounder, grid: Shape, shape: Shape | None = None) -> dict:
    """About how tight a bounder is, and an axis-aligned box around the same object, by their f in float64.

    Args:
        bounder: Any bounder.
        grid: What the fit bounded.
        shape: What it was given, without a margin: the truth where it can tell (``evaluate`` asks the same), also where
            the fit bounded its cells. What the fit bounded if ``None``.

    Returns:
        ``fp_rate`` and ``fp_rate_aabb``, per cent of ``samples``; and ``itself``, whether the truth is that of the shape
        itself, not of cells. JSON-ready.
    """
    query, length = bounder.query_kind, bounder.domain.oracle_length
    judge = judge_of(grid if shape is None else shape, grid, query, PROTOCOLS[0])
    x = sample(query, judge, QUICK, np.random.default_rng(QUICK_SEED))
    x = x[~oracle(query, judge, device="cpu", length=length)(x)]
    box = Aabb.fit(judge, domain_of(grid, query, length))

    def rate(b: Bounder) -> float:
        v = b.domain.to_local(x)
        asked = (np.abs(v) <= b.domain.limit).all(axis=1) | (not b.domain.tested_as_point)
        return 100 * int((asked & (b.reference(v) >= float(b.threshold))).sum()) / QUICK if len(x) else 0.0

    itself = not isinstance(judge, IndicatorGrid)
    return {"fp_rate": rate(bounder), "fp_rate_aabb": rate(box), "samples": QUICK, "itself": itself}
