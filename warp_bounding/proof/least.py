"""The least value of a bounder's f over all positives, certified: in closed form, or by branch and bound.

Points, rays and boxes of a network are searched depth first in charts (``charted``), planes over their normals
(``planes``), a monotone network's boxes over the object's points (``monotone``).
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from warp_bounding.bounders.base import Bounder
from warp_bounding.bounders.neural.mlp import Mlp
from warp_bounding.indicators.blocks import full_blocks
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.proof.covers.box import charted_boxes
from warp_bounding.proof.covers.monotone_box import of_points
from warp_bounding.proof.covers.plane import SupportGap
from warp_bounding.proof.covers.point import charted_points
from warp_bounding.proof.covers.ray import charted_rays
from warp_bounding.proof.search.best_first import Search, minimum
from warp_bounding.proof.search.depth_first import Charted, charted_minimum
from warp_bounding.runtime.launch import working_seconds

__all__ = ["charted", "least_value", "positive_boxes"]

CENTERS = 64  # of cells, as positives to begin with
CHARTS = {"point": charted_points, "ray": charted_rays, "box": charted_boxes}


def positive_boxes(bounder: Bounder, grid: IndicatorGrid) -> tuple[np.ndarray, np.ndarray]:
    """P_delta as boxes of ``v``: one per cell for closed forms, few large ones where a search halves them itself.

    Returns:
        Lower and upper corners ``(N, n)`` float64.
    """
    first, last = (grid.occupied, grid.occupied + 1) if bounder.closed_form else full_blocks(grid)
    return bounder.domain.widened(grid.position(first - 0.5), grid.position(last - 0.5))


def charted(bounder: Bounder, grid: IndicatorGrid) -> Charted | None:
    """The positives of a network as boxes of a chart; ``None`` where its proof is another.

    Args:
        bounder: Its domain holds the object.
        grid: The object.

    Raises:
        BounderError: If the bounds' own arithmetic cannot be certified so far beyond the domain.
    """
    if of_points(bounder) is not bounder or type(bounder) is not Mlp or bounder.query_kind not in CHARTS:
        return None
    return CHARTS[bounder.query_kind](bounder, grid)


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
    """Certified minimum of f over every input that the pipeline can make of a positive; arguments and errors as of ``prove``."""
    started = working_seconds()
    if bounder.closed_form:
        least, looked_at = bounder.least(grid)
        return Search(least, least, np.empty((0, grid.ndim)), looked_at, working_seconds() - started, True)
    limits = {"eps": eps, "seconds": seconds, "boxes": boxes, "progress": progress}
    if bounder.query_kind == "plane":
        gap = SupportGap(bounder, grid)
        return minimum(gap, *gap.boxes(), points=points, **limits)
    cover = charted(bounder, grid)
    if cover is None:
        return minimum(of_points(bounder), *positive_boxes(of_points(bounder), grid), points=points, **limits)
    known = _certain(bounder, grid) if points is None or not len(points) else points
    search = charted_minimum(cover, upper=float(bounder.reference(known).min()), **limits)
    return replace(search, worst=cover.coordinates(search.worst), numbers=search.worst)


def _certain(bounder: Bounder, grid: IndicatorGrid) -> np.ndarray:
    """Queries that meet the object for certain: the centres of some cells, as points, boxes without extent, rays from there."""
    centers = grid.position(grid.occupied[:: max(1, len(grid.occupied) // CENTERS)].astype(np.float64))
    if bounder.query_kind == "point":
        return bounder.domain.to_local(centers)
    local = bounder.domain.base.to_local(centers)
    if bounder.query_kind == "box":
        return np.concatenate([local, local], axis=1)
    along = np.eye(grid.ndim)[np.arange(len(local)) % grid.ndim] * bounder.domain.stretch.astype(np.float64)
    return np.concatenate([local, along], axis=1)
