"""Point queries: n numbers, the coordinates of a point in object space. Is a closed occupied cell around it?

The oracle decides in float64, where the cell coordinate of a float32 point is exact (see ``IndicatorGrid``): a point on
the face between two cells belongs to both.
"""

from fractions import Fraction
from functools import cache
from math import ceil, floor

import numpy as np
import warp as wp

from warp_bounding.errors import QueryError
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.queries.base import Query
from warp_bounding.queries.region import rational_map
from warp_bounding.runtime.launch import BLOCK, launch_blocks
from warp_bounding.runtime.native import named

__all__ = ["POINT", "PointOracle", "point_truth", "sample_points"]


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


def point_truth(grid: IndicatorGrid, x: np.ndarray) -> np.ndarray:
    """The truth for points in rational arithmetic, one by one: slow, and plainly right.

    Args:
        grid: The object.
        x: ``(N, n)`` float32 or float64, object space.

    Returns:
        ``(N,)`` bool.
    """
    half, truth = Fraction(1, 2), np.isfinite(x).all(axis=1)
    for index in np.flatnonzero(truth):
        cells = [slice(max(0, ceil(t - half)), max(0, floor(t + half) + 1)) for t in rational_map(grid, x[index])]
        truth[index] = grid.occupancy[tuple(cells)].any()
    return truth


def _snippet(ndim: int) -> str:
    """One block of points on a CPU, one point on CUDA."""
    each = range(ndim)
    inside = " ".join(
        f"const double t{k} = (double)x.data[i * {ndim} + {k}] * map.data[{k}] - map.data[{ndim + k}];"
        f"const double lo{k} = ceil(t{k} - 0.5), hi{k} = floor(t{k} + 0.5), r{k} = map.data[{2 * ndim + k}];"
        f"if (!(hi{k} >= 0.0 && lo{k} < r{k})) continue;"
        f"const int a{k} = lo{k} < 0.0 ? 0 : (int)lo{k}, b{k} = hi{k} >= r{k} ? (int)r{k} - 1 : (int)hi{k};"
        for k in each
    )
    loops = " ".join(f"for (int c{k} = a{k}; c{k} <= b{k}; ++c{k})" for k in each)
    index = "0"
    for k in each:
        index = f"({index}) * (int)r{k} + c{k}"
    return f"""
#if defined(__CUDA_ARCH__)
const int begin = block; const int end = block < count ? block + 1 : count;
#else
const int begin = block * {BLOCK}; const int end = begin + {BLOCK} < count ? begin + {BLOCK} : count;
#endif
for (int i = begin; i < end; ++i) {{
    out.data[i] = 0;
    {inside}
    unsigned int found = 0;
    {loops} {{ const int c = {index}; found |= bits.data[c >> 5] >> (c & 31); }}
    out.data[i] = (unsigned char)(found & 1u);
}}
"""


@cache
def _kernel(ndim: int) -> wp.Kernel:
    name = named(f"wb_point_oracle_{ndim}d")

    @name.func_native(_snippet(ndim))
    def contains(
        x: wp.array(dtype=wp.float32),
        count: int,
        block: int,
        map: wp.array(dtype=wp.float64),
        bits: wp.array(dtype=wp.uint32),
        out: wp.array(dtype=wp.uint8),
    ): ...

    @name.kernel
    def point_oracle(
        # inputs
        x: wp.array(dtype=wp.float32),
        count: int,
        first: int,
        map: wp.array(dtype=wp.float64),
        bits: wp.array(dtype=wp.uint32),
        # outputs
        out: wp.array(dtype=wp.uint8),
    ):
        contains(x, count, first + wp.tid(), map, bits, out)

    return point_oracle


class PointOracle:
    """The exact truth for many points, as a Warp kernel; ``IndicatorGrid.contains`` is its plain twin.

    Args:
        grid: The object.
        device: Warp device; the default device if ``None``.
    """

    def __init__(self, grid: IndicatorGrid, device: str | None = None):
        self.ndim, self.device = grid.ndim, wp.get_device(device)
        packed = np.packbits(grid.occupancy.reshape(-1), bitorder="little")
        bits = np.pad(packed, (0, -len(packed) % 4)).view("<u4").astype(np.uint32)
        values = np.concatenate([grid.cells_per_unit, grid.offset, np.array(grid.shape, dtype=np.float64)])
        self._bits = wp.array(bits, dtype=wp.uint32, device=self.device)
        self._map = wp.array(values, dtype=wp.float64, device=self.device)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Truth for points.

        Args:
            x: ``(N, n)`` float32, object space. NaN and points outside the domain are in no cell.

        Returns:
            ``(N,)`` bool.

        Raises:
            QueryError: For another shape.
        """
        x = np.ascontiguousarray(x, dtype=np.float32)
        if x.ndim != 2 or x.shape[1] != self.ndim:
            raise QueryError(f"points must have shape (N, {self.ndim}), got {x.shape}")
        out = wp.empty(len(x), dtype=wp.uint8, device=self.device)
        if len(x):
            flat = wp.array(x.reshape(-1), dtype=wp.float32, device=self.device, copy=not self.device.is_cpu)
            inputs = [flat, len(x), 0, self._map, self._bits]
            launch_blocks(_kernel(self.ndim), len(x), inputs, [out], self.device, first_index=2)
        return out.numpy().astype(bool)


class PointQuery(Query):
    name = "point"
    is_region = False

    def sample(self, grid: IndicatorGrid, count: int, rng: np.random.Generator) -> np.ndarray:
        return sample_points(grid, count, rng)

    def oracle(self, grid: IndicatorGrid, device: str | None = None, length: float = 1.0) -> PointOracle:
        return PointOracle(grid, device)

    def truth(self, grid: IndicatorGrid, q: np.ndarray, length: float = 1.0) -> np.ndarray:
        return point_truth(grid, q)


POINT = PointQuery()
