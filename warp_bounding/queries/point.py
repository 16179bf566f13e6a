"""Point queries: n numbers, the coordinates of a point in object space. Is a closed occupied cell around it?

The oracle decides in float64, where the cell coordinate of a float32 point is exact (see ``Grid``): a point
on the face between two cells belongs to both.

Points: ``v = (x - center) * scale``, inside where ``|v| <= limit``; see ``domain`` for what that rounds.
"""

import numpy as np

from warp_bounding.queries.base import Query, WorldMap
from warp_bounding.queries.directions import at_points
from warp_bounding.queries.domain import GROWTH, Domain, rounding_of_map
from warp_bounding.queries.exact import any_occupied, rational_map
from warp_bounding.rounding import TINY, UNIT32
from warp_bounding.runtime.native import native_text
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.shape import Shape


class PointQuery(Query):
    """Point queries; ``Grid.decide`` is a plain reference implementation of their oracle too."""

    name = "point"
    decider = "decide"
    is_region = False
    every = "every point of the domain"
    hard_positives = "points of the object, mostly on its border (of cells: on faces, edges and corners)"
    oracle_body = native_text("truth.h").POINT

    @property
    def positive(self) -> str:
        return "point of the object"

    def sample(self, grid: Shape, count: int, rng: np.random.Generator) -> np.ndarray:
        """Uniform points from ``sample_lower`` to ``sample_upper``; of a grid that is [0, 1]^n, as in the paper."""
        u = rng.random((count, grid.ndim), dtype=np.float32)
        return (grid.sample_lower + u * (grid.sample_upper - grid.sample_lower)).astype(np.float32)

    def decide(self, shape: Shape, q: np.ndarray, length: float = 1.0) -> np.ndarray:
        return shape.decide(q)

    def truth(self, grid: Shape, q: np.ndarray, length: float = 1.0, cells: np.ndarray | None = None) -> np.ndarray:
        if not isinstance(grid, Grid):
            return grid.contains(q)
        truth = self.valid(q)
        for index in np.flatnonzero(truth):
            cell = rational_map(grid, q[index])
            truth[index] = any_occupied(grid, cell, cell)
        return truth

    def arrays(self, grid: Grid) -> dict[str, np.ndarray]:
        packed = np.packbits(grid.occupancy.reshape(-1), bitorder="little")
        return {"indices": np.pad(packed, (0, -len(packed) % 4)).view("<i4").astype(np.int32)}

    def barely(self, grid: Grid, p: np.ndarray, rng: np.random.Generator, length: float, outside: bool) -> np.ndarray:
        return p

    def nudged(self, grid: Grid, x: np.ndarray, move: np.ndarray) -> np.ndarray:
        """Points moved by shares ``(N, n)`` of the domain, and not out of it."""
        return np.clip(x + move * (grid.upper - grid.lower), grid.lower, grid.upper)

    # --- the map to coordinates v ------------------------------------------------------------------------------------

    directed, ends = (False,), ((True, True),)
    map_text = """
for (int k = 0; k < AXES; ++k) {
    v[k] = (q[k] - center[k]) * scale[k];
    const Mask within = (v[k] <= limit[k]) & (v[k] >= -limit[k]);
    inside = inside & within;
    if (k < FREE) testable = testable & within;  // outside, the object may be anywhere
}
"""
    placed_text = """
V d[AXES];
for (int k = 0; k < AXES; ++k) d[k] = q[k] - place[k];
for (int k = 0; k < AXES; ++k) {
    V x = d[0] * place[AXES + AXES * k];
    for (int j = 1; j < AXES; ++j) x = x + d[j] * place[AXES + AXES * k + j];
    q[k] = x;
}
"""

    def extra_count(self, n: int, time: bool) -> int:
        return 0

    def rounding(self, base: Domain, length: float | None) -> np.ndarray:
        return rounding_of_map(base.limit.astype(np.float64))

    def placed_rounding(self, domain: Domain, world: WorldMap, input_unit: float) -> np.ndarray:
        moved = at_points(domain, world, input_unit) * domain.scale.astype(np.float64) * (1 + 4 * UNIT32)
        return (moved + self.rounding(domain, None) + TINY) * GROWTH


POINT = PointQuery()
