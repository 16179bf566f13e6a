"""Rays that meet an object, as boxes of a chart (``ray_chart``): 2n - 1 numbers, by where a ray first enters the object.

Let a ray ``a + t w`` pass a point of the object at t. Either a lies in the object; or the ray comes, just before it first
enters, through an empty cell D (or from outside the grid) whose closure holds the point of entry p. Go from D to an occupied
cell at p by one axis at a time, of those on which the ray moves towards it: the first step from an empty to an occupied cell
crosses a face that holds p, that is exposed, and that the ray crosses inwards. So exposed faces with directions inwards, and
origins in the object with all directions, cover all positives.
"""

import numpy as np

from warp_bounding.arithmetic import UNIT64, gamma
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.bounders.ray_chart import RayChart
from warp_bounding.indicators.blocks import blocks_of, full_blocks
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.proof.depth_first import Charted

__all__ = ["charted_rays", "rays_of"]


def charted_rays(bounder: Mlp, grid: IndicatorGrid) -> Charted:
    """The rays that meet an object, for a network of ray queries.

    Args:
        bounder: Its domain holds the object.
        grid: The object.
    """
    n, domain = grid.ndim, bounder.domain
    local = domain.base.to_local
    lower, upper = [], []

    def add(first: np.ndarray, last: np.ndarray, latest: float, directions: tuple[np.ndarray, np.ndarray]) -> None:
        """Boxes of p between two corners in cells, t up to a time, and all of some boxes of directions."""
        p_low, p_high = local(grid.position(first)), local(grid.position(last))
        for side, p, t, m in ((lower, p_low, 0.0, directions[0]), (upper, p_high, latest, directions[1])):
            rows = np.concatenate(
                [np.repeat(p, len(m), axis=0), np.full((len(p) * len(m), 1), t), np.tile(m, (len(p), 1))], axis=1
            )
            side.append(rows)

    first, last = full_blocks(grid)
    add(first - 0.5, last - 0.5, 0.0, _directions(n))
    for axis in range(n):
        for sign in (1, -1):
            first, last = blocks_of(_exposed(grid.occupancy, axis, sign), flat=axis)
            first, last = first - 0.5, last - 0.5
            (first if sign > 0 else last)[:, axis] = (last if sign > 0 else first)[:, axis]
            add(first, last, 1.0, _directions(n, axis, -sign))
    stretch, base = domain.stretch.astype(np.float64), domain.base
    limit = base.limit.astype(np.float64)
    slop = gamma(128, UNIT64) * (limit + 2 * stretch)
    numbers = [stretch, limit, local(grid.lower), local(grid.upper), *np.split(domain.delta, 2), slop]
    reach = np.concatenate([limit + 2 * stretch, stretch * (1 + 1e-3)])
    return Charted(
        bounder.network, RayChart(2 * n), np.concatenate(lower), np.concatenate(upper), np.concatenate(numbers), reach
    )


def rays_of(z: np.ndarray, stretch: np.ndarray) -> np.ndarray:
    """Coordinates ``v = (a, w)`` ``(N, 2n)`` of numbers ``(N, 2n + 1)`` of the chart."""
    n = len(stretch)
    m = z[:, n + 1 :]
    w = m / np.linalg.norm(m, axis=1, keepdims=True) * stretch
    return np.concatenate([z[:, :n] - z[:, n : n + 1] * w, w], axis=1)


def _exposed(occupancy: np.ndarray, axis: int, sign: int) -> np.ndarray:
    """Occupied cells whose neighbour along an axis is empty, or outside the grid."""
    near = np.moveaxis(occupancy, axis, 0)
    beyond = np.zeros_like(near)
    if sign > 0:
        beyond[:-1] = near[1:]
    else:
        beyond[1:] = near[:-1]
    return np.moveaxis(near & ~beyond, 0, axis)


def _directions(n: int, axis: int | None = None, sign: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """The faces of the cube [-1, 1]^n as boxes ``(F, n)``; of those, what has the given sign along an axis."""
    lower, upper = [], []
    for k in range(n):
        for side in (1.0, -1.0):
            low, high = -np.ones(n), np.ones(n)
            low[k] = high[k] = side
            if axis is not None:
                if k == axis and side != sign:
                    continue
                if k != axis:
                    (low if sign > 0 else high)[axis] = 0.0
            lower.append(low)
            upper.append(high)
    return np.array(lower), np.array(upper)
