"""Rays that meet an object, as boxes of the chart ``networks.charts.RayChart``, by where a ray first enters the object.

z = (p, t, m), 2n + 1 numbers: a point p of the object that the ray ``a + t w`` passes, its parameter 0 <= t <= 1 there
(w is the whole displacement, ``stretch`` times a unit vector), and a direction m of any length on the cube's surface.
Of m one entry has no width in each box. Besides, t has none where the ray begins in the object, and else the entry of p
across the exposed face.

Let a ray meet the object. Either its origin lies in the object: these are the boxes with p anywhere in the object,
t = 0 and every direction. Or it first enters at a point p, and exposed faces with inward directions cover it:

1. Let A be an occupied cell that holds p, and D a cell that holds the ray just before p: it is empty, or outside the
   grid. On an axis on which the ray stands still choose D as A is; it holds the ray there, too.
2. On an axis on which D and A differ p lies on the face between them, and the ray moves from D towards A.
3. Change D into A one axis at a time. All cells on this way hold p. The first step from an empty to an occupied cell
   crosses a face that holds p, is exposed, and is crossed inwards by the ray.
"""

from collections.abc import Iterator

import numpy as np

from warp_bounding.arithmetic import UNIT64, gamma
from warp_bounding.bounders.bounder import Bounder
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.indicators.grid import IndicatorGrid, blocks_of
from warp_bounding.networks.charts import RayChart
from warp_bounding.proof.covers.base import Cover
from warp_bounding.proof.search.depth_first import ChartedPositives
from warp_bounding.queries.region_domain import RegionDomain

__all__ = ["RayCover", "single_cells"]

PRODUCTS = 16  # float64 roundings, at most, of a term in ``RayCover.reach``
CELLS = 256  # cells that ``single_cells`` takes at a time


def single_cells(bounder: Mlp, grid: IndicatorGrid) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """The positives of ``RayCover.charted`` in boxes of one cell (t = 0) and of one exposed face each.

    They are found without ``blocks_of`` and ``_exposed``: ``certify`` must not rest on the code of the search.

    Yields:
        Lower and upper corners ``(N, 2 n + 1)`` for up to ``CELLS`` cells: of these cells, then of their faces on each
        of the 2n sides.
    """
    n, domain = grid.ndim, bounder.domain
    occupied = {tuple(cell) for cell in grid.occupied.tolist()}
    for start in range(0, len(grid.occupied), CELLS):
        cells = grid.occupied[start : start + CELLS].astype(np.float64)
        yield _boxes(domain, grid, cells - 0.5, cells + 0.5, 0.0, _directions(n))
        for axis in range(n):
            for sign in (1, -1):
                step = np.eye(n)[axis] * sign
                beyond = (cells + step).astype(int).tolist()
                bare = np.array([tuple(cell) not in occupied for cell in beyond], dtype=bool)
                middle = cells[bare] + step / 2
                half = 0.5 * (1 - np.abs(step))
                yield _boxes(domain, grid, middle - half, middle + half, 1.0, _directions(n, axis, -sign))


def _boxes(
    domain: RegionDomain,
    grid: IndicatorGrid,
    first: np.ndarray,
    last: np.ndarray,
    t_most: float,
    directions: tuple[np.ndarray, np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Boxes (p, t, m): p between corners given in cells, 0 <= t <= ``t_most``, m in each of ``directions``."""
    sides = []
    for corner, t, m in ((first, 0.0, directions[0]), (last, t_most, directions[1])):
        p = np.repeat(domain.base.to_local(grid.position(corner)), len(m), axis=0)
        sides.append(np.concatenate([p, np.full((len(p), 1), t), np.tile(m, (len(corner), 1))], axis=1))
    return sides[0], sides[1]


def _exposed(occupancy: np.ndarray, axis: int, sign: int) -> np.ndarray:
    """Occupied cells whose neighbour along an axis is empty, or outside the grid."""
    occupied = occupancy.astype(np.int8)
    return np.diff(occupied, axis=axis, append=0) < 0 if sign > 0 else np.diff(occupied, axis=axis, prepend=0) > 0


def _directions(n: int, axis: int | None = None, sign: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """The faces of the cube [-1, 1]^n as boxes ``(F, n)``; given an axis, only the part that has this sign along it."""
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


class RayCover(Cover):
    """The cover of rays."""

    def charted(self, bounder: Mlp, grid: IndicatorGrid) -> ChartedPositives:
        n, domain = grid.ndim, bounder.domain
        local = domain.base.to_local
        first, last = blocks_of(grid.occupancy)
        boxes = [_boxes(domain, grid, first - 0.5, last - 0.5, 0.0, _directions(n))]
        for axis in range(n):
            for sign in (1, -1):
                first, last = blocks_of(_exposed(grid.occupancy, axis, sign), flat=axis)
                # From cells to corners: cell i is [i - 1/2, i + 1/2], and ``last`` is one past the last cell.
                first, last = first - 0.5, last - 0.5
                # Each block is one cell thick on the axis; only its exposed face is kept, the upper one for sign > 0.
                (first if sign > 0 else last)[:, axis] = (last if sign > 0 else first)[:, axis]
                boxes.append(_boxes(domain, grid, first, last, 1.0, _directions(n, axis, -sign)))
        lower, upper = (np.concatenate(side) for side in zip(*boxes, strict=True))
        stretch, base = domain.stretch.astype(np.float64), domain.base
        limit = base.limit.astype(np.float64)
        # What the chart rounds in ``a = p - t w``: an entry goes through some 2 n + 12 roundings, of which the length
        # of m takes most.
        slop = gamma(128, UNIT64) * (limit + 2 * stretch)
        # in the order in which ``RayChart`` reads them
        numbers = [stretch, limit, local(grid.lower), local(grid.upper), *np.split(domain.delta, 2), slop]
        # The centres of a box are ``p - t w`` and w. An input's absolute terms are most where the box is a whole face of
        # the cube, |m| >= 1 and half widths of 1: w its length 1, n - 1 linear parts, a rest of 0.71 (n - 1)^1.5, n - 1
        # squares of at most 2 each, (n - 1)(n - 2) / 2 products of at most 3.5 each, and n - 1 with t, all times
        # ``stretch``; together under 2 n^2. In a they come with t <= 1, and with p.
        size, terms = limit + 2 * stretch, 2 * n * n * stretch
        size, terms = np.concatenate([size, stretch * (1 + 1e-3)]), np.concatenate([size + terms, limit + terms])
        return ChartedPositives(
            bounder.network, RayChart(2 * n), lower, upper, np.concatenate(numbers), size, terms=terms
        )

    pieces = (1, 6, 24)

    def reach(
        self, cover: ChartedPositives, lower: np.ndarray, upper: np.ndarray, pieces: int
    ) -> tuple[np.ndarray, np.ndarray]:
        # Before p the ray is outside of all cells, or p is its origin: what counts is p + r w with 0 <= r <= 1 - t.
        n = cover.chart.inputs // 2
        low, high = (side[:, None, n:] for side in cover.chart.hull(lower, upper, cover.numbers))
        left = 1.0 - lower[:, n]
        first, last = (left[:, None, None] * ((np.arange(pieces) + end) / pieces)[:, None] for end in (0, 1))
        ways = np.stack([first * low, first * high, last * low, last * high])
        begin, end = lower[:, None, :n], upper[:, None, :n]
        room = PRODUCTS * UNIT64 * (np.maximum(np.abs(begin), np.abs(end)) + np.abs(ways).max(axis=0))
        return begin + ways.min(axis=0) - room, end + ways.max(axis=0) + room

    def anew(
        self, bounder: Mlp, grid: IndicatorGrid, cover: ChartedPositives
    ) -> Iterator[tuple[np.ndarray, np.ndarray, int]]:
        sets = 1 + 2 * grid.ndim  # the cells of a part, and their faces on each side
        for index, (lower, upper) in enumerate(single_cells(bounder, grid)):
            yield lower, upper, min((index + 1) * CELLS // sets, len(grid.occupied))

    def at_points(self, p: np.ndarray, bounder: Bounder) -> np.ndarray:
        # the ray that begins at p, along the axes in turn
        n = p.shape[1]
        return np.concatenate([p, np.eye(n)[np.arange(len(p)) % n] * bounder.domain.stretch.astype(np.float64)], axis=1)

    def coordinates(self, bounder: Bounder, grid: IndicatorGrid, v: np.ndarray) -> np.ndarray:
        # (p, t, m) of the chart is the ray with p = a + t w, and a direction m of any length
        n = grid.ndim
        if v.shape[1] != 2 * n + 1:
            return super().coordinates(bounder, grid, v)
        m = v[:, n + 1 :]
        w = m / np.linalg.norm(m, axis=1, keepdims=True) * bounder.domain.stretch.astype(np.float64)
        return np.concatenate([v[:, :n] - v[:, n : n + 1] * w, w], axis=1)
