"""How tight a distance is: at a radius, which points does it let through that are farther away?"""

from collections.abc import Callable

import numpy as np

from warp_bounding.bounders.distances.base import DistanceBounder
from warp_bounding.evaluation.report import CHUNK, QUICK, QUICK_SEED, Rates
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.shape import IN, OUT, UNDECIDED, Shape
from warp_bounding.proof.distances.prove import distance_shape
from warp_bounding.queries.distance import METRICS, in_metric
from warp_bounding.queries.point import POINT

__all__ = ["evaluate_distance", "quick_distance_rates", "within"]


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
    radius: float,
    seed: int,
    progress: Callable[[int, int], None] | None,
) -> Rates:
    """``evaluate`` of a distance, at a radius; arguments are checked there.

    Args:
        bounder: Of distances.
        shape: The shape that it bounds, without its margin.
        samples: Number of points, drawn as for points.
        radius: Object units.
        seed: Of the samples.
        progress: Called with samples done and samples in all.
    """
    fitted = distance_shape(bounder, shape)
    margin = bounder.info.get("margin") or 0.0
    judge = fitted if isinstance(shape, IndicatorGrid) else in_metric(shape, bounder.sizes.get("metric", METRICS[0]))
    if isinstance(judge, IndicatorGrid):
        truth_of = within(judge, radius)
    else:
        truth_of = within(judge, margin + radius) if not judge.margin else within(judge.dilated(margin), radius)
    rng, around = np.random.default_rng(seed), judge if judge.margin else judge.dilated(margin)
    false_positive = false_negative = positive = undecided = 0
    for start in range(0, samples, CHUNK):
        x = POINT.sample(around, min(CHUNK, samples - start), rng)
        truth, maybe = np.asarray(truth_of(x), dtype=np.uint8), bounder.query(x, radius).numpy().astype(bool)
        false_positive += int((maybe & (truth == OUT)).sum())
        false_negative += int(((truth == IN) & ~maybe).sum())
        positive += int((truth != OUT).sum())
        undecided += int((truth == UNDECIDED).sum())
        if progress:
            progress(start + len(x), samples)
    cells = "of its cells" + (f" at resolution {fitted.resolution}" if fitted.resolution else "")
    return Rates(
        fp_rate=100 * false_positive / samples,
        fn=false_negative,
        positives=100 * positive / samples,
        samples=int(samples),
        protocol="exact",
        seed=int(seed),
        truth=cells if isinstance(judge, IndicatorGrid) else "of the shape itself",
        indicator=fitted.digest,
        undecided=100 * undecided / samples,
        radius=float(radius),
    )


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
