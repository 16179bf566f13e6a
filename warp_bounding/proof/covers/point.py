"""Points of an object, as boxes of a chart: few large blocks of its cells, widened by what the pipeline rounds."""

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.networks.bounds import PlainChart
from warp_bounding.proof.covers.base import Cover, positive_boxes
from warp_bounding.proof.search.depth_first import ChartedPositives

__all__ = ["PointCover"]


class PointCover(Cover):
    """The cover of points."""

    def charted(self, bounder: Mlp, grid: IndicatorGrid) -> ChartedPositives:
        boxes, limit = positive_boxes(bounder, grid), bounder.domain.limit.astype(np.float64)
        return ChartedPositives(bounder.network, PlainChart(grid.ndim), *boxes, np.zeros(1), limit)

    def at_points(self, p: np.ndarray, bounder: Bounder) -> np.ndarray:
        return p
