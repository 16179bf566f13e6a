"""Box queries: 2n numbers, the lower and the upper corner of a closed box in object space. Does it meet the object?

Per axis the closed cells that meet the box are a range of integers, found exactly (``Coordinate``); a summed-area
table then counts the occupied cells of the block with 2^n look-ups (Crow 1984). Nothing is ever undecided.

Boxes: ``v = (low, high)``, the corners in local space, cut at the domain; a moved box is the one around it.
"""

import numpy as np

from warp_bounding.queries.base import Query, WorldMap
from warp_bounding.queries.directions import NARROW, at_points
from warp_bounding.queries.domain import GROWTH, Domain, input_rounding
from warp_bounding.queries.exact import any_occupied, rational_map
from warp_bounding.queries.point import POINT
from warp_bounding.rounding import TINY, UNIT32
from warp_bounding.runtime.native import native_text
from warp_bounding.shapes.grid import Grid, summed_area

text = native_text("truth.h")
# Sides of hard boxes, as shares of the way from a point p of the object to the domain's end: 0 touches p, ``NARROW``
# makes the box thin, 1 reaches the end of the domain. Half of all sides touch p or are narrow.
TOUCHING, BEYOND = 0.3, 0.15  # shares of all sides: those that touch p, and those outside the domain
FARTHEST = 10  # these are up to 2^FARTHEST times as far away as the domain's end


class BoxQuery(Query):
    """Box queries."""

    name = "box"
    decider = "decide_boxes"
    every = "every axis-aligned box, of any size, also of none"
    hard_positives = (
        "thin, small or touching boxes around its points, mostly on faces, edges and corners of boundary cells, some "
        "reaching outside the domain"
    )
    oracle_body = text.BOX

    def valid(self, q: np.ndarray) -> np.ndarray:
        return super().valid(q) & (q[:, : q.shape[1] // 2] <= q[:, q.shape[1] // 2 :]).all(axis=1)

    def sample(self, grid: Grid, count: int, rng: np.random.Generator) -> np.ndarray:
        """Min uniform in [0, 1]^n, max = min + (1 - min) U."""
        u = rng.random((count, 2 * grid.ndim), dtype=np.float32)
        lower, upper = u[:, : grid.ndim], u[:, grid.ndim :]  # views: u is what is returned
        upper *= 1 - lower
        upper += lower
        size = grid.sample_upper - grid.sample_lower
        lower[:] = grid.sample_lower + lower * size
        upper[:] = grid.sample_lower + upper * size
        np.maximum(lower, upper, out=upper)
        return u

    def truth(self, grid: Grid, q: np.ndarray, length: float = 1.0, cells: np.ndarray | None = None) -> np.ndarray:
        n, truth = grid.ndim, self.valid(q)
        for index in np.flatnonzero(truth):
            truth[index] = any_occupied(grid, rational_map(grid, q[index, :n]), rational_map(grid, q[index, n:]))
        return truth

    def arrays(self, grid: Grid) -> dict[str, np.ndarray]:
        return {"indices": summed_area(grid.occupancy)}

    def barely(self, grid: Grid, p: np.ndarray, rng: np.random.Generator, length: float, outside: bool) -> np.ndarray:
        corners, spanning = [], rng.random((len(p), 1)) < 0.5  # about half of these boxes' sides reach the domain's end
        for end in (grid.lower, grid.upper):
            chosen = rng.random(p.shape)
            share = rng.random(p.shape) * np.where(chosen < 0.5, NARROW, 1.0)
            share = np.where((chosen > 0.5) & spanning, 1.0, share)
            share = np.where(chosen < TOUCHING, 0.0, share)
            if outside:
                share = np.where(chosen > 1 - BEYOND, np.exp2(rng.uniform(0, FARTHEST, p.shape)), share)
            corners.append(p + share * (end - p))
        return np.concatenate(corners, axis=1)

    def nudged(self, grid: Grid, x: np.ndarray, move: np.ndarray) -> np.ndarray:
        n = grid.ndim
        ends = [POINT.nudged(grid, x[:, part], move[:, part]) for part in (slice(n), slice(n, None))]
        return np.concatenate([np.minimum(*ends), np.maximum(*ends)], axis=1)

    # --- the map to coordinates v ------------------------------------------------------------------------------------

    directed, ends = (False, False), ((False, True), (True, False))
    map_text = """
for (int k = 0; k < AXES; ++k) {
    const V low = (q[k] - center[k]) * scale[k], high = (q[AXES + k] - center[k]) * scale[k];
    const V top = zero + limit[k], bottom = zero - limit[k];
    testable = testable & (q[k] <= q[AXES + k]);
    const Mask within = (low <= top) & (high >= bottom);
    inside = inside & within;
    v[k] = low < bottom ? bottom : low;
    v[k] = v[k] > top ? top : v[k];
    v[AXES + k] = high < bottom ? bottom : high;
    v[AXES + k] = v[AXES + k] > top ? top : v[AXES + k];
    if (TIME && k == 0) testable = testable & (low <= zero + extra[0]) & (high >= zero - extra[0]);
}
"""
    placed_text = """
V below[AXES], above[AXES];  // the box around the moved one (Arvo 1990)
for (int k = 0; k < AXES; ++k) {
    testable = testable & (q[k] <= q[AXES + k]);
    below[k] = q[k] - place[k], above[k] = q[AXES + k] - place[k];
    testable = testable & ((below[k] - below[k]) == zero) & ((above[k] - above[k]) == zero);
}
for (int k = 0; k < AXES; ++k) {
    V low = zero, high = zero;
    for (int j = 0; j < AXES; ++j) {
        const V s = below[j] * place[AXES + AXES * k + j], t = above[j] * place[AXES + AXES * k + j];
        low = low + (s < t ? s : t);
        high = high + (s < t ? t : s);
    }
    q[k] = low, q[AXES + k] = high;
    testable = testable & ((low - low) == zero) & ((high - high) == zero);  // an overflow
}
"""

    def rounding(self, base: Domain, length: float | None) -> np.ndarray:
        return input_rounding(base.center, base.scale, base.limit.astype(np.float64), base.lower, base.upper)

    def to_local(self, domain, q: np.ndarray) -> np.ndarray:
        limit = domain.limit.astype(np.float64)
        return np.clip(super().to_local(domain, q), -limit, limit)

    def placed_rounding(self, domain, world: WorldMap, input_unit: float) -> np.ndarray:
        base = domain.base
        return (at_points(base, world, input_unit) * base.scale.astype(np.float64) * (1 + 4 * UNIT32) + TINY) * GROWTH


BOX = BoxQuery()
