"""``fit`` of distances: from a shape to a proven lower bound of the distance to it.

A method that has a volume is fitted as a bounder of points, whose proof carries over. Other closed forms have a ``fit`` of their own, and what is learned
an entry in ``DISTANCE_TRAINERS``; ``prove_distance`` then finds the slack.
"""

from collections.abc import Callable, Iterable
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from warp_bounding.bounders.bounder import Bounder, unknown_option
from warp_bounding.bounders.distance import DISTANCES, DistanceBounder, VolumeDistance, distance_class
from warp_bounding.bounders.mlp_distance import MlpDistance
from warp_bounding.certificates.claim import as_fitted
from warp_bounding.coordinates.distance_domain import DistanceDomain
from warp_bounding.errors import BounderError
from warp_bounding.evaluation import quick_distance_rates
from warp_bounding.indicators.shape import Shape
from warp_bounding.proof.distances.excesses import excesses
from warp_bounding.proof.distances.prove import prove_distance
from warp_bounding.queries.distance import METRICS, in_metric
from warp_bounding.queries.point import POINT
from warp_bounding.runtime.progress import reported
from warp_bounding.training.recipes.distance import train_distance

__all__ = ["DISTANCE_TRAINERS", "METRIC", "check_distance_options", "fit_distance"]

METRIC = "metric"  # the option that all methods take
TOLERANCE = 0.02  # of a cell's side, and ...
LOOSER = 1.25  # ... of what some points of it have: an excess up to their sum is not looked at more closely
CELL_HALVINGS = 3  # on each axis, of a cell whose excess is larger
MOST_HALVED = 3  # axes that this counts, so that there are not too many boxes in higher dimensions
# Of the budget, what training leaves for the proof; from so many dimensions on.
PROOF_SHARE, LARGE_PROOF_SHARE, LARGE = 0.2, 0.15, 4

# By class, how a learned method is trained: called with the class, the shape, the domain, its options, seconds, a seed, a device and
# progress, it returns the bounder, without a threshold, and a record of the training. A trainer chooses its domain's room.
DistanceTrainer = Callable[..., tuple[DistanceBounder, dict[str, Any]]]
DISTANCE_TRAINERS: dict[type[DistanceBounder], DistanceTrainer] = {MlpDistance: train_distance}


def check_distance_options(cls: type[DistanceBounder], names: Iterable[str], callers: Iterable[Callable] = ()) -> None:
    """Refuse options that a method's distance does not take.

    Args:
        cls: Of the method.
        names: Of the options, all but those of ``fit``.
        callers: As of ``settled``.

    Raises:
        BounderError: Naming one of them, and what there is.
    """
    known = [*(option.name for option in cls.options_taken()), METRIC]
    for name in names:
        if name not in known:
            raise BounderError(unknown_option(name, cls.method, known, "distances", callers))


def fit_distance(
    shape: Shape,
    method: str,
    options: dict[str, Any],
    *,
    budget: float,
    seed: int,
    margin: float,
    resolution: int | None,
    device: str | None,
    progress,
    of_points: Callable[..., Bounder],
    described: Callable[..., dict[str, Any]],
    callers: Iterable[Callable] = (),
) -> DistanceBounder:
    """The part of ``fit`` that is about distances; arguments are checked there.

    Args:
        shape: What is bounded, without the margin.
        method: A name in ``DISTANCES``.
        options: The method's own, and ``metric``.
        budget: Seconds.
        seed: Of everything random.
        margin: By how much the object is dilated.
        resolution: Of cells, where they are asked for.
        device: Warp device.
        progress: As of ``fit``.
        of_points: ``fit`` itself, for a volume.
        described: Makes the ``info`` of a bounder.
        callers: As of ``settled``.

    Raises:
        BounderError: For a method without a distance, an option that it does not take, or a shape without a proof.
    """
    metric = options.pop(METRIC, METRICS[0])
    shape = in_metric(shape, metric)
    cls = distance_class(method, shape.ndim)
    if shape.joints is not None:
        raise BounderError(f"{method}: {shape.name}: distances of configurations are not bounded, points are; clear_segments clears whole motions")  # fmt: skip
    if shape.time and not (cls.moving and shape.speed is not None):
        able = ", ".join(name for name, each in DISTANCES.items() if each.moving)
        raise BounderError(
            f"{method}: {shape.name} moves; distances to it at a time are bounded of moving meshes by {able}; grids take metric={METRICS[1]!r}, where "
            "time is one more coordinate"
        )
    check_distance_options(cls, options, callers)
    own = {"margin": margin, "resolution": resolution}
    if issubclass(cls, VolumeDistance):
        volume = of_points(
            shape, POINT.name, method, budget=budget, seed=seed, device=device, progress=progress, **own, **options
        )
        fitted, info = as_fitted(volume, shape), volume.info
        bounder = cls.around(volume, DistanceDomain.of(fitted), {METRIC: metric}, device)
        prove_distance(bounder, fitted, of_volume=volume.certificate)
        bounder.info = {**info, "rates": None}
    else:
        fitted = as_fitted_to(shape, margin, resolution)
        if fitted.distances(fitted.lower[None]) is None:
            raise BounderError(
                f"{method}: {shape.name} has no distance; meshes, grids, solids and functions with distance= have one"
            )
        proving = budget * (PROOF_SHARE if shape.ndim < LARGE else LARGE_PROOF_SHARE)
        settled = {option.name: _settled(option, options) for option in cls.options_taken()}
        if cls in DISTANCE_TRAINERS:
            with reported(progress, f"fit {method}") as update:
                left = budget - proving
                bounder, record = DISTANCE_TRAINERS[cls](cls, fitted, settled, left, seed, device, update)
        else:
            domain = DistanceDomain.of(fitted, cls.room)
            lowered = partial(_excess_of_cells, shape=fitted, seconds=budget - proving)
            bounder, record = cls.fit(fitted, domain, lowered=lowered, device=device, **settled), {}
        bounder.sizes[METRIC] = metric
        prove_distance(bounder, fitted, seconds=proving)
        bounder.info = described(fitted, seed, record)
    bounder.info["rates"] = quick_distance_rates(bounder, fitted)
    return bounder


def _excess_of_cells(bounder: DistanceBounder, shape: Shape, seconds: float) -> np.ndarray:
    """By how much F exceeds the distance in each of its pieces."""
    lower, upper = bounder.pieces()
    tolerance = TOLERANCE * float((upper - lower).max()) + LOOSER * _sampled_excess(bounder, shape, lower, upper)
    halvings = CELL_HALVINGS * min(bounder.ndim, MOST_HALVED)
    return excesses(bounder, shape, lower, upper, tolerance=tolerance, halvings=halvings, seconds=seconds)[0]


def _sampled_excess(bounder: DistanceBounder, shape: Shape, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """By how much F exceeds the distance at some points of boxes, at least 0: halving a box cannot make a bound smaller than that."""
    most = np.zeros(len(lower))
    for share in [np.full(bounder.ndim, 0.5), *(np.array(s) for s in product((0.25, 0.75), repeat=bounder.ndim))]:
        v = lower + share * (upper - lower)
        low = shape.distances(bounder.domain.to_object(v))[:, 0] / bounder.domain.unit
        most = np.maximum(most, bounder.reference(v) - low)
    return most


def as_fitted_to(shape: Shape, margin: float, resolution: int | None) -> Shape:
    """The dilated shape, or its cells where a resolution asks for them."""
    shape.check()
    return shape.dilated(margin) if resolution is None else shape.to_grid(resolution=resolution, margin=margin)


def _settled(option, given: dict[str, Any]) -> Any:
    value = given.get(option.name, option.default)
    return None if value is None and option.default is None else option.check(value)
