"""Queries: what is asked of an object, how it is sampled, and the exact truth. One file a kind."""

from collections.abc import Callable

import numpy as np

from warp_bounding.errors import QueryError
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.queries.box import BoxOracle, sample_boxes
from warp_bounding.queries.plane import PlaneOracle, sample_planes
from warp_bounding.queries.point import PointOracle, sample_points
from warp_bounding.queries.ray import RayOracle, sample_rays
from warp_bounding.queries.sampled import SampledOracle

__all__ = [
    "QUERY_KINDS",
    "BoxOracle",
    "PlaneOracle",
    "PointOracle",
    "RayOracle",
    "SampledOracle",
    "check_query",
    "oracle",
    "sample",
    "sample_boxes",
    "sample_planes",
    "sample_points",
    "sample_rays",
]

QUERY_KINDS = ("point", "ray", "plane", "box")

_SAMPLERS = {"point": sample_points, "ray": sample_rays, "plane": sample_planes, "box": sample_boxes}
_ORACLES = {"point": PointOracle, "ray": RayOracle, "plane": PlaneOracle, "box": BoxOracle}


def check_query(query: str) -> str:
    """``query`` itself, if it is a kind that is known.

    Raises:
        QueryError: If it is not.
    """
    if query not in QUERY_KINDS:
        raise QueryError(f"query must be one of {', '.join(QUERY_KINDS)}, got {query!r}")
    return query


def sample(query: str, grid: IndicatorGrid, count: int, rng: np.random.Generator) -> np.ndarray:
    """Random queries of a kind, drawn as the paper draws them.

    Args:
        query: One of ``QUERY_KINDS``.
        grid: The object.
        count: Number of queries N.
        rng: Source of randomness.

    Returns:
        ``(N, m)`` float32, object space; m = n for points, else 2n.

    Raises:
        QueryError: For an unknown kind.
    """
    return _SAMPLERS[check_query(query)](grid, count, rng)


def oracle(
    query: str, grid: IndicatorGrid, device: str | None = None, length: float = 1.0
) -> Callable[[np.ndarray], np.ndarray]:
    """The exact truth for queries of a kind.

    Args:
        query: One of ``QUERY_KINDS``.
        grid: The object.
        device: Warp device; the default device if ``None``.
        length: Of rays, object units; other kinds have none.

    Returns:
        An oracle: called with ``(N, m)`` float32 it answers ``(N,)`` bool.

    Raises:
        QueryError: For an unknown kind, or a length that is negative or not finite.
    """
    if check_query(query) == "ray":
        return RayOracle(grid, device, length)
    return _ORACLES[query](grid, device)
