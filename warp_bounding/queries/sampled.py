"""The ``sampled`` protocol: the paper's labels, ``any()`` over random points of the region (DESIGN section 6).

500 points of a region, 1500 in four dimensions; of a ray uniform in t over [0, length], of a box uniform inside, of a
plane all coordinates but the first uniform in [-3, 3] (in the frame where the grid's outer cell centres are 0 and 1), the
first solved for; a plane whose normal has no first component yields no points. The generator is counter-based and keyed
by the seed and the query's own bits: a query has one label, in any batch and on every device up to the last bits of a
square root. A region that the *exact* oracle calls empty is not sampled at all. That is fast, and it excludes phantom
hits: a point may be rounded off its region into a cell, but never makes a region positive that meets no cell.
"""

from functools import cache

import numpy as np
import warp as wp

from warp_bounding.errors import QueryError
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.queries.box import BoxOracle
from warp_bounding.queries.plane import PlaneOracle
from warp_bounding.queries.point import PointOracle
from warp_bounding.queries.ray import RayOracle
from warp_bounding.queries.region import RegionOracle, loop_snippet
from warp_bounding.runtime.native import named

__all__ = ["SampledOracle", "points_per_region"]

_EXACT = {"ray": RayOracle, "plane": PlaneOracle, "box": BoxOracle}
PLANE_SPAN = 3.0  # the paper's: free coordinates of a plane's points are uniform in [-3, 3]


def points_per_region(ndim: int) -> int:
    """The paper's number of points: 500, and 1500 in four dimensions (and more)."""
    return 500 if ndim < 4 else 1500


_POINTS = {
    "ray": """
    const double along = length * uniform() / size;
    for (int k = 0; k < N; ++k) y[k] = (double)q[k] + along * (double)q[N + k];
    """,
    "box": """
    for (int k = 0; k < N; ++k) y[k] = (double)q[k] + uniform() * ((double)q[N + k] - (double)q[k]);
    """,
    "plane": """
    // all points whose free coordinates lie outside the domain are skipped at once: their number is geometric
    const double skipped = floor(log(uniform()) / map.data[5 * N]);
    if (skipped >= COUNT - sample) break;
    sample += (int)skipped;
    double rest = 0.0;
    for (int k = 1; k < N; ++k) {
        y[k] = map.data[3 * N + k] + uniform() * (map.data[4 * N + k] - map.data[3 * N + k]);
        rest += (double)q[k] * (y[k] - (double)q[N + k]);
    }
    y[0] = (double)q[N] - rest / (double)q[0];
    """,
}


def _body(query: str, ndim: int) -> str:
    zero_normal = "if (q[0] == 0.0f) break;" if query == "plane" else ""
    return f"""
struct Generator {{  // PCG-RXS-M-XS 32 (O'Neill 2014), keyed by a hash of the seed and the query
    unsigned int state;
    void absorb(unsigned int word) {{ state ^= word; (*this)(); }}
    unsigned int operator()() {{
        state = state * 747796405u + 2891336453u;
        unsigned int word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
        return (word >> 22u) ^ word;
    }}
}};
if (exact.data[i] != 1) break;
{zero_normal}
Generator generator;
generator.state = (unsigned int)seed;
unsigned int key = generator();
for (int k = 0; k < 2 * N; ++k) {{
    union {{ float f; unsigned int u; }} bits;
    bits.f = q[k];
    generator.state = key ^ bits.u;
    key = generator() + 0x9e3779b9u * (unsigned int)(k + 1);
}}
generator.state = key;
const auto uniform = [&]() {{ return ((double)generator() + 0.5) * 0x1p-32; }};
double size = 0.0;
for (int k = 0; k < N; ++k) size += (double)q[N + k] * (double)q[N + k];
size = sqrt(size);
constexpr int COUNT = {points_per_region(ndim)};
for (int sample = 0; sample < COUNT; ++sample) {{
    double y[N];
    {_POINTS[query]}
    long long index = 0;
    bool inside = true;
    for (int k = 0; k < N; ++k) {{
        const double t = floor(y[k] * map.data[k] - map.data[N + k] + 0.5), r = map.data[2 * N + k];
        inside &= t >= 0.0 && t < r;
        index = index * (long long)r + (t >= 0.0 && t < r ? (long long)t : 0);
    }}
    if (inside && occupied.data[index]) {{ answer = 1; break; }}
}}
"""


@cache
def _kernel(query: str, ndim: int) -> wp.Kernel:
    name = named(f"wb_sampled_{query}_{ndim}d")

    @name.func_native(loop_snippet(ndim, _body(query, ndim)))
    def meets(
        x: wp.array(dtype=wp.float32),
        count: int,
        block: int,
        map: wp.array(dtype=wp.float64),
        occupied: wp.array(dtype=wp.uint8),
        exact: wp.array(dtype=wp.uint8),
        length: wp.float64,
        seed: wp.uint32,
        out: wp.array(dtype=wp.uint8),
    ): ...

    @name.kernel
    def sampled_oracle(
        # inputs
        x: wp.array(dtype=wp.float32),
        count: int,
        first: int,
        map: wp.array(dtype=wp.float64),
        occupied: wp.array(dtype=wp.uint8),
        exact: wp.array(dtype=wp.uint8),
        length: wp.float64,
        seed: wp.uint32,
        # outputs
        out: wp.array(dtype=wp.uint8),
    ):
        meets(x, count, first + wp.tid(), map, occupied, exact, length, seed, out)

    return sampled_oracle


class SampledOracle(RegionOracle):
    """The paper's labels. They are a subset of the exact ones: sampling misses thin hits and invents none.

    Args:
        query: ``ray``, ``plane`` or ``box``; ``point`` gives the exact labels, a point being all of its region.
        grid: The object.
        device: Warp device; the default device if ``None``.
        seed: Of the random points.
        length: Of rays, object units.
    """

    def __init__(self, query: str, grid: IndicatorGrid, device: str | None = None, seed: int = 0, length: float = 1.0):
        super().__init__(grid, device)
        self.kind, self.length, self.seed = query, float(length), int(seed)
        if query == "point":
            self._exact = PointOracle(grid, device)
            return
        if query not in _EXACT:
            raise QueryError(f"query must be one of point, {', '.join(_EXACT)}, got {query!r}")
        self._exact = RayOracle(grid, device, length) if query == "ray" else _EXACT[query](grid, device)
        free = (grid.upper - grid.lower)[1:] / (grid.sample_upper - grid.sample_lower)[
            1:
        ]  # of the domain, in the frame
        with np.errstate(divide="ignore"):
            outside = np.log1p(-np.prod(free / (2 * PLANE_SPAN)))
        frame = np.concatenate([self._map.numpy(), grid.lower, grid.upper, [outside]])
        self._map = self._array(frame, wp.float64)
        self._occupied = self._array(grid.occupancy.astype(np.uint8), wp.uint8)

    def __call__(self, q: np.ndarray) -> np.ndarray:
        """Labels of queries.

        Args:
            q: ``(N, m)`` float32, object space.

        Returns:
            ``(N,)`` bool.

        Raises:
            QueryError: For another shape.
        """
        return self._exact(q) if self.kind == "point" else super().__call__(q)

    def _kernel_answers(self, q: np.ndarray) -> np.ndarray:
        exact = self._array(self._exact(q).astype(np.uint8), wp.uint8)
        inputs = [self._occupied, exact, wp.float64(self.length), wp.uint32(self.seed % 2**32)]
        return self._launch(_kernel(self.kind, self.ndim), q, inputs)
