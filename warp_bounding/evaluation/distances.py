"""How tight a distance is: which points does it let through that are farther away than a radius, which rays and boxes that do not meet the object?"""

from collections.abc import Callable

import numpy as np
import warp as wp

from warp_bounding.bounders.distances.base import DistanceBounder
from warp_bounding.certificates.claim import as_fitted
from warp_bounding.errors import QueryError
from warp_bounding.evaluation.counting import counted
from warp_bounding.evaluation.report import QUICK, QUICK_SEED, Rates, truth_told
from warp_bounding.evaluation.truth import judge_of, truth_by
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.shape import IN, OUT, UNDECIDED, Shape
from warp_bounding.queries import QUERIES, sample
from warp_bounding.queries.box import BOX
from warp_bounding.queries.distance import METRICS, in_metric
from warp_bounding.queries.point import POINT
from warp_bounding.queries.ray import RAY

__all__ = ["ASKED", "evaluate_distance", "judge_of_points", "parts_of", "quick_distance_rates", "within"]


# By kind of query: called with a bounder, the length of rays and what else it is told, it returns how that is asked about ``parts_of`` queries.
ASKED: dict[str, Callable[[DistanceBounder, float, dict], Callable[..., wp.array]]] = {
    POINT.name: lambda bounder, length, told: bounder.query,
    RAY.name: lambda bounder, length, told: lambda x: bounder.rays(x, length=length, **told)[0],
    BOX.name: lambda bounder, length, told: lambda lower, upper: bounder.boxes(lower, upper, **told),
}


def parts_of(query: str, x: np.ndarray) -> list[np.ndarray]:
    """``(N, m)`` queries as a distance takes them: boxes by their corners."""
    return [np.ascontiguousarray(part) for part in np.split(x, 2, axis=1)] if query == BOX.name else [x]


def within(shape: Shape, radius: float) -> Callable[[np.ndarray], np.ndarray]:
    """Which points lie within a radius of the object: called with ``(N, n)`` it answers as ``Shape.decide``.

    Raises:
        IndicatorError: For a radius above 0, if the shape cannot tell distances.
    """
    if radius == 0:
        return shape.decide
    if isinstance(shape, IndicatorGrid):

        def decide(x: np.ndarray) -> np.ndarray:
            low, high = shape.distances(x).T
            return np.where(low > radius, OUT, np.where(high <= radius, IN, UNDECIDED)).astype(np.uint8)

        return decide
    return shape.dilated(radius).decide


def evaluate_distance(
    bounder: DistanceBounder,
    shape: Shape,
    samples: int,
    protocol: str,
    seed: int,
    progress: Callable[[int, int], None] | None,
    *,
    radius: float | None = None,
    query: str | None = None,
    length: float | None = None,
    steps: int | None = None,
) -> Rates:
    """``evaluate`` of a distance.

    Args:
        bounder: Of distances.
        shape: The shape that it bounds, without its margin.
        samples: Number of queries, drawn as for other bounders.
        protocol: Checked there, as are ``samples`` and ``seed``.
        seed: Of the samples.
        progress: Called with samples done and samples in all.
        radius: Of points, object units.
        query: A name in ``ASKED``.
        length: Of rays.
        steps: Evaluations.

    Raises:
        QueryError: For another query, or a value that makes no sense for it.
    """
    query = POINT.name if query is None else query
    if query not in ASKED:
        raise QueryError(f"query of a distance must be one of {', '.join(ASKED)}, got {query!r}")
    kind = QUERIES[query]
    for name, value, taken in (
        ("radius", radius, not kind.is_region),
        ("length", length, kind.has_length),
        ("steps", steps, kind.is_region),
    ):
        if value is not None and not taken:
            raise QueryError(f"{name} is not for {query} queries, got {name}={value}")
    for name, value in (("radius", radius), ("length", length)):
        if value is not None and (
            isinstance(value, bool) or not isinstance(value, (int, float, np.number)) or not 0 <= value < np.inf
        ):
            raise QueryError(f"{name} must be a length of at least 0, got {value!r}")
    fitted, rng = as_fitted(bounder, shape), np.random.default_rng(seed)
    told = {"protocol": protocol, "seed": seed, "indicator": fitted.digest, "query": query}
    if kind.is_region:
        length = 1.0 if length is None else float(length)
        judge = judge_of(in_metric(shape, _metric(bounder)), fitted, query, protocol)
        truth_of, given = (
            truth_by(protocol, query, judge, bounder.device, length, seed),
            {} if steps is None else {"steps": steps},
        )
        around, asked = judge, ASKED[query](bounder, length, given)

        def ask(x: np.ndarray) -> wp.array:
            return asked(*parts_of(query, x))
    else:
        radius = told["radius"] = 0.0 if radius is None else float(radius)
        judge, around, truth_of = judge_of_points(bounder, shape, fitted, radius)

        def ask(x: np.ndarray) -> wp.array:
            return bounder.query(x, radius)

    return counted(
        lambda count: sample(query, around, count, rng),
        truth_of,
        lambda x: ask(x).numpy().astype(bool),
        samples,
        progress,
        truth=truth_told(judge, fitted),
        **told,
    )


def _metric(bounder: DistanceBounder) -> str:
    return bounder.sizes.get("metric", METRICS[0])


def judge_of_points(bounder: DistanceBounder, shape: Shape, fitted: Shape, radius: float):
    """Whose truth counts for points within a radius, the shape around which they are drawn, and that truth."""
    margin = bounder.info.get("margin") or 0.0
    judge = fitted if isinstance(shape, IndicatorGrid) else in_metric(shape, _metric(bounder))
    around = judge if judge.margin else judge.dilated(margin)
    if isinstance(judge, IndicatorGrid):
        return judge, around, within(judge, radius)
    return judge, around, within(judge, margin + radius) if not judge.margin else within(around, radius)


def quick_distance_rates(bounder: DistanceBounder, shape: Shape) -> dict:
    """About how tight a distance is at radius 0, and the box around the object; as ``quick_rates`` of other bounders."""
    x = POINT.sample(shape, QUICK, np.random.default_rng(QUICK_SEED))
    outside = shape.decide(x) == OUT
    boxed = ((x >= bounder.domain.lower) & (x <= bounder.domain.upper)).all(axis=1)
    maybe = bounder.exact(x) <= 0
    return {
        "fp_rate": 100 * int((maybe & outside).sum()) / QUICK,
        "fp_rate_aabb": 100 * int((boxed & outside).sum()) / QUICK,
        "samples": QUICK,
    }
