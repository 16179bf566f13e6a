"""How tight a bounder is: false positives and false negatives among random queries, as fractions of all of them."""

import os
from collections.abc import Callable

import numpy as np

from warp_bounding.bounders.base import Bounder
from warp_bounding.bounders.distances.base import DistanceBounder
from warp_bounding.bounders.load import bounder_of
from warp_bounding.bounders.slabs.aabb import Aabb
from warp_bounding.coordinates.region_domain import domain_of
from warp_bounding.errors import QueryError
from warp_bounding.evaluation.distances import evaluate_distance
from warp_bounding.evaluation.report import CHUNK, QUICK, QUICK_SEED, Rates
from warp_bounding.indicators import IndicatorGrid, load_indicator
from warp_bounding.indicators.shape import IN, OUT, UNDECIDED, Shape
from warp_bounding.proof.prove import as_fitted, of_side
from warp_bounding.queries import QUERIES, SampledOracle, decision, oracle, sample

__all__ = ["PROTOCOLS", "evaluate", "quick_rates"]

PROTOCOLS = ("exact", "sampled")


def evaluate(
    bounder: Bounder | DistanceBounder | str | os.PathLike,
    shape,
    samples: int = 1_000_000,
    protocol: str = "exact",
    *,
    seed: int = 1,
    radius: float | None = None,
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
        radius: Of a distance: points within it count as positive; 0 if ``None``. Other bounders have none.
        progress: Called with samples done and samples in all.

    Returns:
        The rates.

    Raises:
        QueryError: For an unknown protocol, fewer than one sample, a shape of another dimension, or an impossible radius.

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
    bounder = bounder_of(bounder)
    if isinstance(bounder, DistanceBounder):
        shape = load_indicator(shape)
        if shape.ndim != bounder.ndim:
            raise QueryError(f"the shape is {shape.ndim}D, the bounder {bounder.ndim}D")
        radius = 0.0 if radius is None else radius
        if isinstance(radius, bool) or not isinstance(radius, (int, float, np.number)) or not 0 <= radius < np.inf:
            raise QueryError(f"radius must be a length of at least 0, got {radius!r}")
        return evaluate_distance(bounder, shape, int(samples), float(radius), int(seed), progress)
    if radius is not None:
        raise QueryError(f"radius is for distances, got radius={radius} for {bounder.query_kind} queries")
    shape = of_side(bounder, shape)
    fitted = as_fitted(bounder, shape)
    if fitted.ndim != bounder.ndim:
        raise QueryError(f"the shape is {fitted.ndim}D, the bounder {bounder.ndim}D")
    judge = _judge(shape, fitted, bounder.query_kind, protocol)
    rng, length = np.random.default_rng(seed), bounder.domain.oracle_length
    if protocol == "sampled":
        truth_of = SampledOracle(bounder.query_kind, judge, device=bounder.device, seed=seed, length=length)
    else:
        truth_of = decision(bounder.query_kind, judge, bounder.device, length)
    laid = isinstance(fitted, IndicatorGrid) and judge is not fitted
    of_cells = oracle(bounder.query_kind, fitted, bounder.device, length) if laid else None
    false_positive = false_negative = positive = undecided = beyond_cells = 0
    for start in range(0, samples, CHUNK):
        x = sample(bounder.query_kind, judge, min(CHUNK, samples - start), rng)
        truth, maybe = np.asarray(truth_of(x), dtype=np.uint8), bounder.query(x).numpy().astype(bool)
        false_positive += int((maybe & (truth == OUT)).sum())
        false_negative += int(((truth == IN) & ~maybe).sum())
        positive += int((truth != OUT).sum())
        undecided += int((truth == UNDECIDED).sum())
        if of_cells is not None:
            beyond_cells += int((maybe & ~of_cells(x)).sum())
        if progress:
            progress(start + len(x), samples)
    cells = "of its cells" + (f" at resolution {fitted.resolution}" if fitted.resolution else "")
    return Rates(
        fp_rate=100 * false_positive / samples,
        fn=false_negative,
        positives=100 * positive / samples,
        samples=int(samples),
        protocol=protocol,
        seed=int(seed),
        truth=cells if isinstance(judge, IndicatorGrid) else "of the shape itself",
        indicator=fitted.digest,
        undecided=100 * undecided / samples,
        fp_rate_cells=None if of_cells is None else 100 * beyond_cells / samples,
    )


def _judge(shape, fitted: Shape, query: str, protocol: str) -> Shape:
    """Whose truth counts: that of the shape itself where it can tell, and else of the cells that the fit bounded."""
    known = isinstance(shape, Shape) and not isinstance(shape, IndicatorGrid) and protocol == PROTOCOLS[0]
    return shape.dilated(fitted.margin) if known and QUERIES[query].decides(shape) else fitted


def quick_rates(bounder: Bounder, grid: Shape) -> dict:
    """About how tight a bounder is, and an axis-aligned box around the same object, by their f in float64.

    Args:
        bounder: Any bounder.
        grid: What the fit bounded.

    Returns:
        ``fp_rate`` and ``fp_rate_aabb``, per cent of ``samples``; JSON-ready.
    """
    query, length = bounder.query_kind, bounder.domain.oracle_length
    x = sample(query, grid, QUICK, np.random.default_rng(QUICK_SEED))
    x = x[~oracle(query, grid, device="cpu", length=length)(x)]
    box = Aabb.fit(grid, domain_of(grid, query, length))

    def rate(b: Bounder) -> float:
        v = b.domain.to_local(x)
        asked = (np.abs(v) <= b.domain.limit).all(axis=1) | (not b.domain.tested_as_point)
        return 100 * int((asked & (b.reference(v) >= float(b.threshold))).sum()) / QUICK if len(x) else 0.0

    return {"fp_rate": rate(bounder), "fp_rate_aabb": rate(box), "samples": QUICK}
