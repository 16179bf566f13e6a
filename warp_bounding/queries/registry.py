"""The kinds of query by name, and what is most often asked of one."""

from collections.abc import Callable

import numpy as np

from warp_bounding.errors import QueryError
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.shape import Shape
from warp_bounding.queries.base import Query
from warp_bounding.queries.box import BOX
from warp_bounding.queries.distance import DISTANCE, DistanceQuery
from warp_bounding.queries.plane import PLANE
from warp_bounding.queries.point import POINT
from warp_bounding.queries.ray import RAY

__all__ = ["QUERIES", "QUERY_KINDS", "check_query", "decision", "described", "oracle", "sample"]

QUERIES: dict[str, Query] = {kind.name: kind for kind in (POINT, RAY, PLANE, BOX)}  # a new kind is one more entry
QUERY_KINDS = QUERIES.keys()


def check_query(query: str, *more: str) -> str:
    """``query`` itself, if it is a kind that is known, or one of ``more``.

    Raises:
        QueryError: If it is not.
    """
    if query not in QUERIES and query not in more:
        raise QueryError(f"query must be one of {', '.join([*QUERIES, *more])}, got {query!r}")
    return query


def described(query: str) -> Query | DistanceQuery:
    """What there is to say of a kind of query, or of distances, by its name."""
    return DISTANCE if query == DISTANCE.name else QUERIES[query]


def sample(query: str, grid: IndicatorGrid, count: int, rng: np.random.Generator) -> np.ndarray:
    """Random queries ``(count, m)`` float32 of a kind, as of ``Query.sample``; raises ``QueryError`` for no kind."""
    return QUERIES[check_query(query)].sample(grid, count, rng)


def decision(
    query: str, shape: Shape, device: str | None = None, length: float = 1.0
) -> Callable[[np.ndarray], np.ndarray]:
    """``oracle``, but of a shape without cells ``(N,)`` uint8: ``OUT``, ``IN`` or ``UNDECIDED`` (``indicators.shape``)."""
    if isinstance(shape, IndicatorGrid):
        return oracle(query, shape, device, length)
    return lambda q: QUERIES[query].decide(shape, q, length)


def oracle(
    query: str, grid: IndicatorGrid, device: str | None = None, length: float = 1.0
) -> Callable[[np.ndarray], np.ndarray]:
    """The exact truth for queries of a kind, as of ``Query.oracle``: called with ``(N, m)`` it answers ``(N,)`` bool.

    Raises:
        QueryError: For an unknown kind, or a length that is negative or not finite.
    """
    return QUERIES[check_query(query)].oracle(grid, device, length)
