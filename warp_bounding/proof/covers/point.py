"""Points of an object, as boxes of a chart: few large blocks of its cells, widened by what the pipeline rounds."""

import numpy as np

from warp_bounding.bounders.neural.mlp import Mlp
from warp_bounding.coordinates.domain import Domain
from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.networks.charts.base import PlainChart
from warp_bounding.proof.covers.base import Cover, positive_boxes
from warp_bounding.proof.search.depth_first import ChartedPositives

__all__ = ["POINT"]


class PointCover(Cover):
    """The cover of points."""

    name = "point"

    def charted(self, bounder: Mlp, grid: IndicatorGrid) -> ChartedPositives:
        limit = bounder.domain.limit.astype(np.float64)
        return ChartedPositives(
            bounder.network, PlainChart(grid.ndim), *positive_boxes(bounder, grid), np.zeros(1), limit
        )

    def at_points(self, p: np.ndarray, domain: Domain | RegionDomain) -> np.ndarray:
        return p


POINT = PointCover()
