"""The least value of a bounder's f over all positives, certified: by one pass over the cells, or by branch and bound.

Points, rays and boxes of a network are searched depth first in the numbers of a chart (``charted``). Where there is no
chart the search is best first: planes over their normals, a monotone network's boxes over the object's points
(``covers``).
"""

from collections.abc import Callable

import numpy as np

from warp_bounding.bounders.base import Bounder
from warp_bounding.bounders.neural.mlp import Mlp
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.proof.covers import COVERS
from warp_bounding.proof.search.best_first import Search, minimum
from warp_bounding.proof.search.depth_first import ChartedPositives, charted_minimum
from warp_bounding.runtime.launch import working_seconds

__all__ = ["charted", "least_value"]

CENTERS = 64  # about how many cells' centres a search begins with, where it is given no points


def charted(bounder: Bounder, grid: IndicatorGrid) -> ChartedPositives | None:
    """The positives of a network as boxes of a chart; ``None`` where the proof has no chart.

    Args:
        bounder: Its domain holds the object.
        grid: The object.

    Raises:
        BounderError: If the bounds' own arithmetic cannot be certified so far beyond the domain.
    """
    return COVERS[bounder.query_kind].charted(bounder, grid) if type(bounder) is Mlp else None


def least_value(
    bounder: Bounder,
    grid: IndicatorGrid,
    *,
    eps: float = 1e-3,
    seconds: float = float("inf"),
    boxes: float = float("inf"),
    points: np.ndarray | None = None,
    progress: Callable[[int, float, float], None] | None = None,
) -> Search:
    """Certified minimum of f over every v that the pipeline can make of a positive; arguments as in ``prove``."""
    started = working_seconds()
    if bounder.exact_on_cells:
        least, looked_at = bounder.least(grid)
        return Search(least, least, np.empty((0, grid.ndim)), looked_at, working_seconds() - started, True)
    limits = {"eps": eps, "seconds": seconds, "boxes": boxes, "progress": progress}
    kind, found = COVERS[bounder.query_kind], charted(bounder, grid)
    if found is None:
        return minimum(*kind.best_first(bounder, grid), points=points, **limits)
    if points is None or not len(points):
        centers = grid.position(grid.occupied[:: max(1, len(grid.occupied) // CENTERS)].astype(np.float64))
        points = kind.at_points(bounder.domain.base.to_local(centers), bounder.domain)
    return charted_minimum(found, upper=float(bounder.reference(points).min()), **limits)
