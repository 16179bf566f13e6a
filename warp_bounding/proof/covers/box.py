"""Boxes that meet an object, as boxes of a chart (``box_chart``): all pairs of corners, cut down by a summed-area table.

Devices cut boxes at ``|v| = limit``, which may lie outside the grid on one side (the domain's centre is a float32 number), or on
all (the bounder was made for a larger grid). So corners run over all that is within the limit, in cells of this grid.
"""

import numpy as np

from warp_bounding.arithmetic import UNIT64, gamma
from warp_bounding.bounders.neural.mlp import Mlp
from warp_bounding.errors import BounderError
from warp_bounding.indicators.blocks import summed_area
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.networks.charts.box import BoxChart
from warp_bounding.proof.search.depth_first import Charted

__all__ = ["charted_boxes"]

MOST_CELLS = 2.0**30  # from the grid's origin to the domain's ends: the chart counts cells in 32 bits


def charted_boxes(bounder: Mlp, grid: IndicatorGrid) -> Charted:
    """The boxes that meet an object, for a network of box queries.

    Args:
        bounder: Its domain holds the object.
        grid: The object.
    """
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
        raise BounderError(
            f"{bounder.method}: the domain is {most:.3g} cells of the shape wide, more than the proof counts"
        )
    return Charted(
        bounder.network,
        BoxChart(2 * n),
        lower,
        upper,
        np.concatenate([unit, origin, noise]),
        np.tile(limit + noise, 2),
        words,
    )
