"""Points of an object, as boxes of a chart: few large blocks of its cells, widened by what the pipeline rounds."""

import numpy as np

from warp_bounding.bounders.neural.mlp import Mlp
from warp_bounding.indicators.blocks import full_blocks
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.networks.charts.base import PlainChart
from warp_bounding.proof.search.depth_first import Charted

__all__ = ["charted_points"]


def charted_points(bounder: Mlp, grid: IndicatorGrid) -> Charted:
    """The object's points, for a network of point queries.

    Args:
        bounder: Its domain holds the object.
        grid: The object.
    """
    first, last = full_blocks(grid)
    lower, upper = bounder.domain.widened(grid.position(first - 0.5), grid.position(last - 0.5))
    limit = bounder.domain.limit.astype(np.float64)
    return Charted(bounder.network, PlainChart(grid.ndim), lower, upper, np.zeros(1), limit)
