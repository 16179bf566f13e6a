"""How a bounder of each kind is asked about points, and what the truth is: the test whose level set is shown.

A bounder of points is asked them; one of boxes, boxes without a size; a distance, points within a radius. The other kinds have no such test:
whether a ray or a plane meets the object depends on more than a point.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from warp_bounding.bounders.base import Bounder
from warp_bounding.bounders.distances.base import DistanceBounder
from warp_bounding.certificates.claim import as_fitted, in_local, of_side
from warp_bounding.errors import QueryError
from warp_bounding.evaluation.distances import judge_of_points
from warp_bounding.evaluation.truth import PROTOCOLS, judge_of
from warp_bounding.indicators.shape import Shape
from warp_bounding.queries.box import BOX
from warp_bounding.queries.distance import DISTANCE
from warp_bounding.queries.point import POINT

__all__ = ["ASKED", "Asked", "asked_of"]

Answers = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Asked:
    """A bounder and its shape, asked about points ``(N, n)`` float32.

    Attributes:
        maybe: ``(N,)`` bool, where the bounder says *maybe*.
        truth: ``(N,)`` uint8, as of ``Shape.decide``.
        around: The shape around which points are drawn.
        fitted: What the fit bounded, if the shape is that of the fit.
    """

    maybe: Answers
    truth: Answers
    around: Shape
    fitted: Shape


def _points(bounder: Bounder, shape: Shape, radius: float) -> Asked:
    fitted = as_fitted(bounder, shape)
    judge = judge_of(of_side(bounder, shape), fitted, POINT.name, PROTOCOLS[0])
    return Asked(lambda x: bounder.query(x).numpy() != 0, judge.decide, judge, fitted)


def _boxes(bounder: Bounder, shape: Shape, radius: float) -> Asked:
    points = _points(bounder, shape, radius)
    return Asked(
        lambda x: bounder.query(np.concatenate([x, x], axis=1)).numpy() != 0,
        points.truth,
        points.around,
        points.fitted,
    )


def _distances(bounder: DistanceBounder, shape: Shape, radius: float) -> Asked:
    fitted = as_fitted(bounder, shape)
    _, around, truth = judge_of_points(bounder, shape, fitted, radius)
    return Asked(lambda x: bounder.query(x, radius).numpy() != 0, truth, around, fitted)


# By kind of query: called with a bounder, its shape and a radius, which only a distance is asked with.
ASKED: dict[str, Callable[..., Asked]] = {POINT.name: _points, BOX.name: _boxes, DISTANCE.name: _distances}


def asked_of(bounder: Bounder | DistanceBounder, shape: Shape, radius: float) -> Asked:
    """A bounder and its shape, asked about points.

    Raises:
        QueryError: For a kind of query that a point says nothing about.
    """
    if bounder.query_kind not in ASKED:
        raise QueryError(
            f"show is for bounders of {', '.join(ASKED)} queries, got one of {bounder.query_kind} queries: "
            "what it answers depends on more than a place"
        )
    return ASKED[bounder.query_kind](*in_local(bounder, shape), radius)
