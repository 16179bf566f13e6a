"""Whose truth an evaluation compares with, and how it is found."""

from collections.abc import Callable

import numpy as np

from warp_bounding.indicators import IndicatorGrid
from warp_bounding.indicators.shape import Shape
from warp_bounding.queries import QUERIES, SampledOracle, decision

__all__ = ["PROTOCOLS", "judge_of", "truth_by"]

PROTOCOLS = ("exact", "sampled")


def judge_of(shape, fitted: Shape, query: str, protocol: str) -> Shape:
    """Whose truth counts: that of the shape itself where it can tell, and else of the cells that the fit bounded."""
    known = isinstance(shape, Shape) and not isinstance(shape, IndicatorGrid) and protocol == PROTOCOLS[0]
    return shape.dilated(fitted.margin) if known and QUERIES[query].decides(shape) else fitted


def truth_by(
    protocol: str, query: str, judge: Shape, device, length: float, seed: int
) -> Callable[[np.ndarray], np.ndarray]:
    """The truth of queries by a protocol; ``length`` is that of rays, ``seed`` of the random points of sampled truth."""
    if protocol == PROTOCOLS[0]:
        return decision(query, judge, device, length)
    return SampledOracle(query, judge, device=device, seed=seed, length=length)
