"""Boxes that meet an object, as boxes of the chart ``networks.charts.box``: all pairs of corners.

A summed-area table says which of them meet the object. Devices cut boxes at ``|v| = limit``, which may lie outside the
grid on one side (the domain's centre is a float32 number), or on all (the bounder was made for a larger grid). So
corners run over all that is within the limit, in cells of this grid.
"""

import numpy as np

from warp_bounding.arithmetic import UNIT64, gamma
from warp_bounding.bounders.bounder import Bounder
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.errors import BounderError
from warp_bounding.indicators.grid import IndicatorGrid, summed_area
from warp_bounding.networks.charts import BoxChart
from warp_bounding.proof.covers.base import Cover
from warp_bounding.proof.search.depth_first import ChartedPositives

__all__ = ["BoxCover"]

MOST_CELLS = 2.0**30  # cells from the grid's origin to the domain's ends: the chart counts them in 32 bits


class BoxCover(Cover):
    """The cover of boxes."""

    def charted(self, bounder: Mlp, grid: IndicatorGrid) -> ChartedPositives:
        n, base = grid.ndim, bounder.domain.base
        origin = base.to_local(grid.position(np.zeros(n)))
        unit = base.to_local(grid.position(np.ones(n))) - origin
        limit = base.limit.astype(np.float64) + 2 * base.delta
        noise = base.delta * (1 + 1e-9) + gamma(64, UNIT64) * (limit + np.abs(origin) + unit * np.array(grid.shape))
        table = summed_area(grid.occupancy)
        strides = [int(np.prod(table.shape[k + 1 :])) for k in range(n)]
        words = np.concatenate([grid.shape, strides, table.reshape(-1)]).astype(np.int32)
        edge = base.limit.astype(np.float64)
        lower, upper = (np.tile((side - origin) / unit, 2)[None] for side in (-edge, edge))
        most = float(max(np.abs(lower).max(), np.abs(upper).max()))
        if not most < MOST_CELLS:
            wide = f"the domain is {most:.3g} cells of the shape wide, more than the proof counts"
            raise BounderError(f"{bounder.method}: {wide}")
        numbers, largest = np.concatenate([unit, origin, noise]), np.tile(limit + noise, 2)
        return ChartedPositives(bounder.network, BoxChart(2 * n), lower, upper, numbers, largest, words)

    pieces = (1,)

    def reach(
        self, cover: ChartedPositives, lower: np.ndarray, upper: np.ndarray, pieces: int
    ) -> tuple[np.ndarray, np.ndarray]:
        # the largest box
        n = cover.chart.inputs // 2
        low, high = cover.chart.hull(lower, upper, cover.numbers)
        return low[:, None, :n], high[:, None, n:]

    def at_points(self, p: np.ndarray, bounder: Bounder) -> np.ndarray:
        return np.concatenate([p, p], axis=1)

    def coordinates(self, bounder: Bounder, grid: IndicatorGrid, v: np.ndarray) -> np.ndarray:
        # a monotone network is searched over points: each is the box that is no more than it
        return np.concatenate([v, v], axis=1) if v.shape[1] == grid.ndim else super().coordinates(bounder, grid, v)
