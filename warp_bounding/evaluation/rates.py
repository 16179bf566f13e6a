"""How tight a bounder is: false positives and false negatives among random queries, as fractions of all of them."""

import os
from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np

from warp_bounding.bounders.base import Bounder
from warp_bounding.bounders.load import bounder_of
from warp_bounding.bounders.slabs.aabb import Aabb
from warp_bounding.coordinates.region_domain import domain_of
from warp_bounding.errors import QueryError
from warp_bounding.indicators import IndicatorGrid
from warp_bounding.proof.prove import as_fitted
from warp_bounding.queries import SampledOracle, oracle, sample

__all__ = ["PROTOCOLS", "Rates", "evaluate", "quick_rates"]

PROTOCOLS = ("exact", "sampled")
CHUNK = 1_000_000  # queries that are asked at a time
QUICK, QUICK_SEED = 16_384, 2  # the queries that ``quick_rates`` measures on: how many, and their seed


@dataclass(frozen=True)
class Rates:
    """Rates over all samples, in per cent, as in the paper.

    Attributes:
        fp_rate: False positives, per cent of all samples.
        fn: False negatives, a count; a conservative bounder has none.
        positives: Samples whose truth is *yes*, per cent.
        samples: Number of samples.
        protocol: ``"exact"`` or ``"sampled"`` (the truth from random points of a region, as in the paper; for points
            both are the same).
        seed: Seed of the samples.
        truth: Whose truth it is, in words: that of the cells, which reach beyond a mesh by up to a cell and the margin.
        indicator: SHA-256 of the cells that were asked about; ``bounder.info["indicator"]`` for those of the fit.

    Example:
        >>> rates = wb.evaluate(bounder, grid, samples=10_000)
        >>> rates.fn, rates.samples
        (0, 10000)
    """

    fp_rate: float
    fn: int
    positives: float
    samples: int
    protocol: str
    seed: int
    truth: str = "of its cells"
    indicator: str | None = None

    def to_dict(self) -> dict:
        """JSON-ready.

        Example:
            >>> wb.evaluate(bounder, grid, samples=1000).to_dict()["protocol"]
            'exact'
        """
        return asdict(self)


def evaluate(
    bounder: Bounder | str | os.PathLike,
    shape,
    samples: int = 1_000_000,
    protocol: str = "exact",
    *,
    seed: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> Rates:
    """Ask a bounder random queries of its kind and compare with the exact truth, that of the shape's cells.

    Args:
        bounder: Any bounder, or the path of its file.
        shape: The ``IndicatorGrid`` or ``IndicatorMesh`` that it bounds, or anything that ``load_indicator`` takes. A
            mesh is voxelised as it was for the fit.
        samples: Number of queries, drawn as in the paper (points: between the centres of the first and the last cells).
        protocol: ``"exact"``, or ``"sampled"``, the paper's way to find the truth: ``any()`` over random points of the
            region. That misses thin hits, so there are fewer positives. For points both are the same.
        seed: Seed of the samples.
        progress: Called with samples done and samples in all.

    Returns:
        The rates.

    Raises:
        QueryError: For an unknown protocol, fewer than one sample, or a shape of another dimension.

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
    grid = as_fitted(bounder, shape)
    if grid.ndim != bounder.ndim:
        raise QueryError(f"the shape is {grid.ndim}D, the bounder {bounder.ndim}D")
    query, rng = bounder.query_kind, np.random.default_rng(seed)
    length = bounder.domain.oracle_length
    if protocol == "sampled":
        truth_of = SampledOracle(query, grid, device=bounder.device, seed=seed, length=length)
    else:
        truth_of = oracle(query, grid, device=bounder.device, length=length)
    false_positive = false_negative = positive = 0
    for start in range(0, samples, CHUNK):
        x = sample(query, grid, min(CHUNK, samples - start), rng)
        truth, maybe = truth_of(x), bounder.query(x).numpy().astype(bool)
        false_positive += int((maybe & ~truth).sum())
        false_negative += int((truth & ~maybe).sum())
        positive += int(truth.sum())
        if progress:
            progress(start + len(x), samples)
    truth = "of its cells" + (f" at resolution {grid.resolution}" if grid.resolution else "")
    shares = (100 * false_positive / samples, false_negative, 100 * positive / samples)
    return Rates(*shares, int(samples), protocol, int(seed), truth, grid.digest)


def quick_rates(bounder: Bounder, grid: IndicatorGrid) -> dict:
    """About how tight a bounder is, and an axis-aligned box around the same cells, by their f in float64.

    Args:
        bounder: Any bounder.
        grid: The cells that it bounds.

    Returns:
        ``fp_rate`` and ``fp_rate_aabb``, per cent of ``samples``; JSON-ready.
    """
    query, length = bounder.query_kind, bounder.domain.oracle_length
    x = sample(query, grid, QUICK, np.random.default_rng(QUICK_SEED))
    x = x[~oracle(query, grid, device="cpu", length=length)(x)]
    box = Aabb.fit(grid, domain_of(grid, query, length))

    def rate(b: Bounder) -> float:
        return 100 * int((b.reference(b.domain.to_local(x)) >= float(b.threshold)).sum()) / QUICK if len(x) else 0.0

    return {"fp_rate": rate(bounder), "fp_rate_aabb": rate(box), "samples": QUICK}
