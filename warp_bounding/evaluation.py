"""How tight a bounder is: false positives and false negatives among random queries, as fractions of all of them."""

import os
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import warp as wp

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.bounders.distance import DistanceBounder
from warp_bounding.bounders.load import bounder_of
from warp_bounding.bounders.volumes import Aabb
from warp_bounding.certificates.claim import as_fitted, in_local, of_side
from warp_bounding.errors import QueryError
from warp_bounding.queries import QUERIES, decision, oracle, sample
from warp_bounding.queries.box import BOX
from warp_bounding.queries.point import POINT
from warp_bounding.queries.ray import RAY
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.shapes import Grid
from warp_bounding.shapes.shape import IN, OUT, UNDECIDED, Shape

QUICK, QUICK_SEED = 16_384, 2  # the queries that ``quick_rates`` measures on: how many, and their seed


@dataclass(frozen=True)
class Rates:
    """Rates over all samples, in per cent, as in the paper.

    Example:
        >>> rates = wb.evaluate(bounder, grid, samples=10_000)
        >>> rates.fn, rates.samples
        (0, 10000)
    """

    fp_rate: float  #: False positives, per cent of all samples
    fn: int  #: False negatives, a count; a conservative bounder has none
    positives: float  #: Samples whose truth is *yes*, per cent
    samples: int  #: Number of samples
    seed: int  #: Seed of the samples
    truth: str = "of its cells"  #: Whose: of the shape itself, or of cells, of a grid or where the shape cannot tell
    indicator: str | None = None  #: SHA-256 of what the fit bounded; equal to ``bounder.info["indicator"]``
    undecided: float = 0.0  #: Samples of undecided truth, per cent: positives, but not in ``fn``
    fp_rate_cells: float | None = None  #: Where the fit bounded cells of a shape: ``fp_rate`` against these
    radius: float | None = None  #: For points and a distance: those within it are positive, object units
    query: str | None = None  #: For a distance: the kind of query

    @property
    def reported_truth(self) -> str:
        """Whose truth it is, and what accompanies the rate: that against cells, and what could not be decided."""
        told = [self.truth]
        if self.fp_rate_cells is not None:
            told.append(f"{self.fp_rate_cells:.2f} % against the cells that are bounded")
        if self.radius:
            told.append(f"within radius {self.radius:g}")
        if self.undecided:
            told.append(f"{self.undecided:.2g} % undecided, counted as positives")
        return "; ".join(told)

    def to_dict(self) -> dict:
        """JSON-ready.

        Example:
            >>> wb.evaluate(bounder, grid, samples=1000).to_dict()["samples"]
            1000
        """
        return asdict(self)


# --- truth -----------------------------------------------------------------------------------------------------------


def judge_of(shape, fitted: Shape, query: str) -> Shape:
    """Whose truth counts: that of the shape itself where it can decide, and else of the cells that the fit bounded."""
    known = isinstance(shape, Shape) and not isinstance(shape, Grid)
    return shape.dilated(fitted.margin) if known and QUERIES[query].decides(shape) else fitted


# --- counting --------------------------------------------------------------------------------------------------------

QUERIES_AT_ONCE = 1_000_000  # queries at a time


def counted(
    draw: Callable[[int], np.ndarray],
    truth_of: Callable[[np.ndarray], np.ndarray],
    ask: Callable[[np.ndarray], np.ndarray],
    samples: int,
    progress: Callable[[int, int], None] | None = None,
    of_cells: Callable[[np.ndarray], np.ndarray] | None = None,
    **told: Any,
) -> Rates:
    """Ask a bounder so many queries, ``draw``n a chunk at a time; ``ask`` tells which are *maybe*.

    ``truth_of`` answers as ``Shape.decide``, or with bool; ``of_cells`` is the truth of the cells that the fit bounded,
    where it bounded cells of a shape; ``told`` are the other fields of ``Rates``.
    """
    false_positive = false_negative = positive = undecided = beyond_cells = 0
    for start in range(0, samples, QUERIES_AT_ONCE):
        x = draw(min(QUERIES_AT_ONCE, samples - start))
        truth, maybe = np.asarray(truth_of(x), dtype=np.uint8), ask(x)
        false_positive += int((maybe & (truth == OUT)).sum())
        false_negative += int(((truth == IN) & ~maybe).sum())
        positive += int((truth != OUT).sum())
        undecided += int((truth == UNDECIDED).sum())
        if of_cells is not None:
            beyond_cells += int((maybe & ~of_cells(x)).sum())
        if progress:
            progress(start + len(x), samples)
    return Rates(
        fp_rate=100 * false_positive / samples,
        fn=false_negative,
        positives=100 * positive / samples,
        samples=int(samples),
        undecided=100 * undecided / samples,
        fp_rate_cells=None if of_cells is None else 100 * beyond_cells / samples,
        **told,
    )


# --- distances -------------------------------------------------------------------------------------------------------

# By kind of query: called with a bounder, the length of rays and perhaps ``steps``, it returns how that is asked about
# ``parts_of`` queries.
ASKED: dict[str, Callable[..., Callable[..., wp.array]]] = {
    POINT.name: lambda bounder, length: bounder.query,
    RAY.name: lambda bounder, length, **steps: lambda x: bounder.rays(x, length=length, **steps)[0],
    BOX.name: lambda bounder, length, **steps: lambda lower, upper: bounder.boxes(lower, upper, **steps),
}
OPTIONS = {POINT.name: ("radius",), RAY.name: ("length", "steps"), BOX.name: ("steps",)}  # of ``evaluate``


def parts_of(query: str, x: np.ndarray) -> list[np.ndarray]:
    """``(N, m)`` queries as a distance takes them: boxes by their corners."""
    return [np.ascontiguousarray(part) for part in np.split(x, 2, axis=1)] if query == BOX.name else [x]


def within(shape: Shape, radius: float) -> Callable[[np.ndarray], np.ndarray]:
    """Which points lie within a radius of the object: called with ``(N, n)`` it answers as ``Shape.decide``."""
    if radius == 0:
        return shape.decide
    if not isinstance(shape, Grid):
        return shape.dilated(radius).decide

    def decide(x: np.ndarray) -> np.ndarray:
        low, high = shape.distances(x).T
        return np.where(low > radius, OUT, np.where(high <= radius, IN, UNDECIDED)).astype(np.uint8)

    return decide


def _of_distance(bounder: DistanceBounder, shape: Shape, fitted: Shape, query: str, told: dict) -> tuple:
    """What is evaluated of a distance: whose truth, around which shape, that truth, how it is asked, and more."""
    if query not in ASKED:
        raise QueryError(f"query of a distance must be one of {', '.join(ASKED)}, got {query!r}")
    for name, value in told.items():
        if name not in OPTIONS[query]:
            raise QueryError(f"{name} is not for {query} queries, got {name}={value}")
        if isinstance(value, bool) or not isinstance(value, (int, float, np.number)) or not 0 <= value < np.inf:
            raise QueryError(f"{name} must be a finite number of at least 0, got {value!r}")
    if query == POINT.name:
        radius = float(told.get("radius", 0.0))
        judge, around, truth_of = judge_of_points(bounder, shape, fitted, radius)
        return judge, around, truth_of, lambda x: bounder.query(x, radius), {"query": query, "radius": radius}
    length = float(told.pop("length", 1.0))
    ask = ASKED[query](bounder, length, **told)
    judge = judge_of(shape, fitted, query)
    truth_of = decision(query, judge, bounder.device, length)
    return judge, judge, truth_of, lambda x: ask(*parts_of(query, x)), {"query": query}


def judge_of_points(bounder: DistanceBounder, shape: Shape, fitted: Shape, radius: float):
    """Whose truth counts for points within a radius, the shape around which they are drawn, and that truth."""
    margin = bounder.info.get("margin") or 0.0
    judge = fitted if isinstance(shape, Grid) else shape
    around = judge if judge.margin else judge.dilated(margin)
    if judge.margin and not isinstance(judge, Grid):
        return judge, around, within(around, radius)
    return judge, around, within(judge, radius if isinstance(judge, Grid) else margin + radius)


def evaluate(
    bounder: Bounder | str | os.PathLike,
    shape,
    samples: int = 1_000_000,
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
        shape: The ``Grid`` or ``Mesh`` that it bounds, or anything that ``load_shape`` takes. A
            mesh or a function is the truth itself, also where the fit bounded its cells.
        samples: Number of queries, drawn as in the paper (about a grid: between the centres of the first and
            the last cells; other shapes: a tenth of the longest side around the box that holds the object).
        seed: Seed of the samples.
        radius: For points and a distance: those within it count as positive; 0 if ``None``. Other bounders
            have none.
        query: For a distance: its queries, ``"point"``, ``"ray"`` or ``"box"``; points if ``None``. Other bounders
            have one kind.
        length: Of the rays for a distance, object units; 1 if ``None``.
        steps: Evaluations that a distance may spend on a ray or a box; its own default if ``None``.
        progress: Called with samples done and samples in all.

    Returns:
        The rates.

    Raises:
        QueryError: For fewer than one sample, a shape of another dimension, an impossible radius,
            or options of distances only.

    Example:
        >>> rates = wb.evaluate(bounder, grid, samples=10_000)
        >>> rates.fn, 0 < rates.fp_rate < 100
        (0, True)
    """
    for name, value, least in (("samples", samples, 1), ("seed", seed, 0)):
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
            raise QueryError(f"{name} must be a whole number of at least {least}, got {value!r}")
    bounder, shape = in_local(bounder_of(bounder), shape)
    told = {"radius": radius, "length": length, "steps": steps}
    told = {name: value for name, value in told.items() if value is not None}
    if not bounder.of_distances:
        for name, value in (told | ({} if query is None else {"query": query})).items():
            raise QueryError(f"{name} is for distances, got {name}={value} for {bounder.query_kind} queries")
    shape = of_side(bounder, shape)
    fitted, seed = as_fitted(bounder, shape), int(seed)
    if fitted.ndim != bounder.ndim:
        raise QueryError(f"the shape is {fitted.ndim}D, the bounder {bounder.ndim}D")
    if bounder.of_distances:
        query = POINT.name if query is None else query
        judge, around, truth_of, ask, more = _of_distance(bounder, shape, fitted, query, told)
    else:
        query, ask, more = bounder.query_kind, bounder.query, {}
        around = judge = judge_of(shape, fitted, query)
        truth_of = decision(query, judge, bounder.device, bounder.domain.oracle_length)
        if isinstance(fitted, Grid) and judge is not fitted:
            more["of_cells"] = oracle(query, fitted, bounder.device, bounder.domain.oracle_length)
    truth = "of the shape itself"
    if isinstance(judge, Grid):
        truth = f"of its cells at resolution {fitted.resolution}" if fitted.resolution else "of its cells"
    rng = np.random.default_rng(seed)
    return counted(
        lambda count: sample(query, around, count, rng),
        truth_of,
        lambda x: ask(x).numpy(),
        int(samples),
        progress,
        seed=seed,
        truth=truth,
        indicator=fitted.digest,
        **more,
    )


def quick_rates(bounder: Bounder, grid: Shape, shape: Shape | None = None) -> dict:
    """Approximate tightness of a bounder, and a box around its object, by f in float64; a distance at radius 0.

    Args:
        bounder: Any bounder.
        grid: What the fit bounded.
        shape: What it was given, without a margin: the truth where it can tell (``evaluate`` asks the same), also where
            the fit bounded its cells. What the fit bounded if ``None``.

    Returns:
        ``fp_rate``, ``fp_rate_aabb`` and ``free``, the negatives, per cent of ``samples``; and ``itself``, whether the
        truth is that of the shape itself, not of cells. JSON-ready.
    """
    if bounder.of_distances:
        x = POINT.sample(grid, QUICK, np.random.default_rng(QUICK_SEED))
        outside = grid.decide(x) == OUT
        boxed = ((x >= bounder.domain.lower) & (x <= bounder.domain.upper)).all(axis=1)
        rates = [100 * int((maybe & outside).sum()) / QUICK for maybe in (bounder.exact(x) <= 0, boxed)]
        return {"fp_rate": rates[0], "fp_rate_aabb": rates[1], "free": 100 * float(outside.mean()), "samples": QUICK}
    query, length = bounder.query_kind, bounder.domain.oracle_length
    judge = judge_of(grid if shape is None else shape, grid, query)
    x = sample(query, judge, QUICK, np.random.default_rng(QUICK_SEED))
    x = x[~oracle(query, judge, device="cpu", length=length)(x)]
    box = Aabb.fit(judge, domain_of(grid, query, length))

    def rate(b: Bounder) -> float:
        v = b.domain.to_local(x)
        queried = (np.abs(v) <= b.domain.limit).all(axis=1) | (not b.domain.tested_as_point)
        return 100 * int((queried & (b.reference(v) >= float(b.threshold))).sum()) / QUICK if len(x) else 0.0

    itself = not isinstance(judge, Grid)
    rates = {"fp_rate": rate(bounder), "fp_rate_aabb": rate(box), "free": 100 * len(x) / QUICK}
    return rates | {"samples": QUICK, "itself": itself}
