"""Box queries: 2n numbers, the lower and the upper corner of a closed box in object space. Does it meet the object?

Per axis the closed cells that meet the box are a range of integers, found exactly (``Coordinate``); a summed-area table
then counts the occupied cells of the block with 2^n look-ups (Crow 1984). Nothing is ever undecided.
"""

from fractions import Fraction
from functools import cache
from math import ceil, floor

import numpy as np
import warp as wp

from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.queries.base import Query
from warp_bounding.queries.region import RegionOracle, loop_snippet, rational_map
from warp_bounding.runtime.native import named

__all__ = ["BOX", "BoxOracle", "box_truth", "sample_boxes"]


def sample_boxes(grid: IndicatorGrid, count: int, rng: np.random.Generator) -> np.ndarray:
    """Boxes as the paper draws them: min uniform in [0, 1]^n, max = min + (1 - min) U.

    Args:
        grid: The object; 0 and 1 are the centres of its first and last cells.
        count: Number of boxes N.
        rng: Source of randomness.

    Returns:
        ``(N, 2n)`` float32, object space: min, max.
    """
    u = rng.random((count, 2 * grid.ndim), dtype=np.float32)
    lower, upper = u[:, : grid.ndim], u[:, grid.ndim :]
    upper *= 1 - lower
    upper += lower
    size = grid.sample_upper - grid.sample_lower
    lower[:] = grid.sample_lower + lower * size
    upper[:] = grid.sample_upper.astype(np.float32) if not size.any() else grid.sample_lower + upper * size
    np.maximum(lower, upper, out=upper)
    return u


def box_truth(grid: IndicatorGrid, q: np.ndarray) -> np.ndarray:
    """The truth for boxes in rational arithmetic, one by one: slow, and plainly right.

    Args:
        grid: The object.
        q: ``(N, 2n)`` float32, object space.

    Returns:
        ``(N,)`` bool.
    """
    n, half = grid.ndim, Fraction(1, 2)
    truth = BOX.valid(q)
    for index in np.flatnonzero(truth):
        lower, upper = rational_map(grid, q[index, :n]), rational_map(grid, q[index, n:])
        cells = [slice(max(0, ceil(a - half)), max(0, floor(b + half) + 1)) for a, b in zip(lower, upper, strict=True)]
        truth[index] = grid.occupancy[tuple(cells)].any()
    return truth


_BODY = """
bool some = true;
long long first[N], last[N];  // in the table: cells first .. last - 1
for (int k = 0; k < N; ++k) {
    const double r = map.data[2 * N + k];
    const double lo = Coordinate(q[k], map.data[k], map.data[N + k]).lo;
    const double hi = Coordinate(q[N + k], map.data[k], map.data[N + k]).hi;
    some &= q[k] <= q[N + k] && hi >= 0.0 && lo < r;
    first[k] = lo > 0.0 ? (lo < r ? (long long)lo : 0) : 0;
    last[k] = hi < r - 1.0 ? (hi < 0.0 ? 0 : (long long)hi + 1) : (long long)r;
}
if (!some) break;
int sum = 0;
for (int corner = 0; corner < (1 << N); ++corner) {
    long long index = 0;
    int sign = 1;
    for (int k = 0; k < N; ++k) {
        const bool low = (corner >> k) & 1;
        index = index * ((long long)map.data[2 * N + k] + 1) + (low ? first[k] : last[k]);
        sign = low ? -sign : sign;
    }
    sum += sign * table.data[index];
}
answer = sum > 0;
"""


@cache
def _kernel(ndim: int) -> wp.Kernel:
    name = named(f"wb_box_oracle_{ndim}d")

    @name.func_native(loop_snippet(ndim, _BODY))
    def meets(
        x: wp.array(dtype=wp.float32),
        count: int,
        block: int,
        map: wp.array(dtype=wp.float64),
        table: wp.array(dtype=wp.int32),
        out: wp.array(dtype=wp.uint8),
    ): ...

    @name.kernel
    def box_oracle(
        # inputs
        x: wp.array(dtype=wp.float32),
        count: int,
        first: int,
        map: wp.array(dtype=wp.float64),
        table: wp.array(dtype=wp.int32),
        # outputs
        out: wp.array(dtype=wp.uint8),
    ):
        meets(x, count, first + wp.tid(), map, table, out)

    return box_oracle


class BoxOracle(RegionOracle):
    """The exact truth for many boxes, as a Warp kernel; ``box_truth`` is its plain twin.

    Args:
        grid: The object.
        device: Warp device; the default device if ``None``.
    """

    kind = "box"

    def __init__(self, grid: IndicatorGrid, device: str | None = None):
        super().__init__(grid, device)
        table = np.pad(grid.occupancy, [(1, 0)] * grid.ndim).astype(np.int32)
        for axis in range(grid.ndim):
            np.cumsum(table, axis=axis, out=table)
        self._table = self._array(table, wp.int32)

    def _kernel_answers(self, q: np.ndarray) -> np.ndarray:
        return self._launch(_kernel(self.ndim), q, [self._table])


class BoxQuery(Query):
    name = "box"

    def valid(self, q: np.ndarray) -> np.ndarray:
        return super().valid(q) & (q[:, : q.shape[1] // 2] <= q[:, q.shape[1] // 2 :]).all(axis=1)

    def sample(self, grid: IndicatorGrid, count: int, rng: np.random.Generator) -> np.ndarray:
        return sample_boxes(grid, count, rng)

    def oracle(self, grid: IndicatorGrid, device: str | None = None, length: float = 1.0) -> BoxOracle:
        return BoxOracle(grid, device)

    def truth(self, grid: IndicatorGrid, q: np.ndarray, length: float = 1.0) -> np.ndarray:
        return box_truth(grid, q)


BOX = BoxQuery()
