"""Point queries: n numbers, the coordinates of a point in object space. Is a closed occupied cell around it?

The oracle decides in float64, where the cell coordinate of a float32 point is exact (see ``IndicatorGrid``): a point
on the face between two cells belongs to both.
"""

from functools import cache

import numpy as np
import warp as wp

from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.queries.base import Query
from warp_bounding.queries.exact import ExactOracle, any_occupied, oracle_kernel, rational_map

__all__ = ["POINT", "PointOracle", "nudged_points", "point_truth", "sample_points"]


def sample_points(grid: IndicatorGrid, count: int, rng: np.random.Generator) -> np.ndarray:
    """Uniform points between the centres of the first and the last cells: the paper's [0, 1]^n.

    Args:
        grid: The object.
        count: Number of points N.
        rng: Source of randomness.

    Returns:
        ``(N, n)`` float32, object space.
    """
    u = rng.random((count, grid.ndim), dtype=np.float32)
    return (grid.sample_lower + u * (grid.sample_upper - grid.sample_lower)).astype(np.float32)


def nudged_points(grid: IndicatorGrid, p: np.ndarray, move: np.ndarray) -> np.ndarray:
    """Points moved by shares ``(N, n)`` of the domain, and not out of it."""
    return np.clip(p + move * (grid.upper - grid.lower), grid.lower, grid.upper)


def point_truth(grid: IndicatorGrid, x: np.ndarray) -> np.ndarray:
    """The truth for points in rational arithmetic, one by one: slow, and plainly right.

    Args:
        grid: The object.
        x: ``(N, n)`` float32 or float64, object space.

    Returns:
        ``(N,)`` bool.
    """
    truth = POINT.valid(x)
    for index in np.flatnonzero(truth):
        cell = rational_map(grid, x[index])
        truth[index] = any_occupied(grid, cell, cell)
    return truth


_BODY = """
int first[N], last[N], cell[N];  // cells that the point may lie in, two where it lies on a face
bool some = true;
for (int k = 0; k < N; ++k) {
    const double t = (double)q[k] * map.data[k] - map.data[N + k], r = map.data[2 * N + k];
    const double lo = ceil(t - 0.5), hi = floor(t + 0.5);
    some = hi >= 0.0 && lo < r;
    if (!some) break;
    first[k] = cell[k] = lo < 0.0 ? 0 : (int)lo;
    last[k] = hi >= r ? (int)r - 1 : (int)hi;
}
while (some) {
    int c = 0, k = N - 1;
    for (int j = 0; j < N; ++j) c = c * (int)map.data[2 * N + j] + cell[j];
    if (indices.data[c >> 5] >> (c & 31) & 1) { answer = 1; break; }
    for (; k >= 0; --k) {
        if (++cell[k] <= last[k]) break;
        cell[k] = first[k];
    }
    some = k >= 0;
}
"""


@cache
def _kernel(ndim: int) -> wp.Kernel:
    return oracle_kernel(f"wb_point_oracle_{ndim}d", ndim, _BODY, columns=ndim)


class PointOracle(ExactOracle):
    """The exact truth for many points, as a Warp kernel; ``IndicatorGrid.contains`` is its plain twin.

    Args:
        grid: The object.
        device: Warp device; the default device if ``None``.
    """

    kind = "point"

    def __init__(self, grid: IndicatorGrid, device: str | None = None):
        packed = np.packbits(grid.occupancy.reshape(-1), bitorder="little")
        bits = np.pad(packed, (0, -len(packed) % 4)).view("<i4").astype(np.int32)
        super().__init__(grid, device, _kernel(grid.ndim), columns=grid.ndim, indices=bits)


class PointQuery(Query):
    """Point queries; see ``Query``."""

    name = "point"
    is_region = False
    sample = staticmethod(sample_points)
    nudged = staticmethod(nudged_points)
    every = "every point of the domain"
    hard_positives = "points of its cells, mostly on faces, edges and corners of boundary cells"
    hard_draw = "for (int k = 0; k < N; ++k) a[k] = p[k];"
    hard_to_world = "for (int k = 0; k < N; ++k) q[k] = moved(a, k) + place.data[k];"
    hard_certain = """
for (int k = 0; k < N; ++k) {
    const At c = at(0, k);
    sure &= c.to(cell[k] - 0.5) <= -c.err && c.to(cell[k] + 0.5) >= c.err;
}
"""

    @property
    def positive(self) -> str:
        return "point of the object"

    def oracle(self, grid: IndicatorGrid, device: str | None = None, length: float = 1.0) -> PointOracle:
        return PointOracle(grid, device)

    def truth(self, grid: IndicatorGrid, q: np.ndarray, length: float = 1.0) -> np.ndarray:
        return point_truth(grid, q)

    def barely(
        self, grid: IndicatorGrid, p: np.ndarray, rng: np.random.Generator, length: float, outside: bool
    ) -> np.ndarray:
        return p


POINT = PointQuery()
