"""What rays, planes and boxes share: the batch oracle around a kernel, and exact rational numbers on the host.

A kernel writes 0 or 1 where float64 arithmetic is certain, and 2 where a comparison that matters is closer than its
error bound; those few queries are decided on the host, in integers. The cell coordinate ``t = cells_per_unit x - offset``
of a float32 ``x`` needs two float64 numbers: the product is exact, and the rounding error of the difference is computed
too (Knuth's TwoSum), so that signs of ``face - t`` are exact and its relative error is a few roundings.
"""

from fractions import Fraction
from math import lcm

import numpy as np
import warp as wp

from warp_bounding.errors import QueryError
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.runtime.launch import BLOCK, launch_blocks

__all__ = [
    "COORDINATE",
    "RELATIVE_ERROR",
    "RegionOracle",
    "cell_coordinates",
    "integers",
    "loop_snippet",
    "rational_map",
]

RELATIVE_ERROR = 2.0**-48  # 32 roundings: no quantity that carries it goes through more than 16 (n <= 16)

COORDINATE = """
struct Coordinate {  // t + rest = cells_per_unit * x - offset, exactly; lo, hi: the first and the last closed cell there
    double t, rest, lo, hi;
    Coordinate() = default;
    Coordinate(float x, double scale, double offset) {
        const double p = (double)x * scale;  // at most 48 bits: exact
        t = p - offset;
        const double back = t - p;
        rest = (p - (t - back)) + (-offset - back);
        lo = ceil(t - 0.5), hi = floor(t + 0.5);
        if (hi > lo && rest > 0.0) lo = hi;  // t was rounded onto a face, from above
        else if (hi > lo && rest < 0.0) hi = lo;
    }
    double to(double face) const { return (face - t) - rest; }  // sign exact, a few roundings
};
"""


def loop_snippet(ndim: int, body: str) -> str:
    """Native source: ``body`` for every query of a block on a CPU, for one query on CUDA.

    The body sees ``q`` (2n finite floats), ``N``, ``rho`` (``RELATIVE_ERROR``) and ``answer`` (0 at first), and may
    ``break`` when it knows the answer.

    Args:
        ndim: Dimension n of the object.
        body: Native source.

    Returns:
        A snippet for ``func_native``, over arrays ``x``, ``map``, ``out`` and integers ``count``, ``block``.
    """
    return f"""
constexpr int N = {ndim};
constexpr double rho = {RELATIVE_ERROR.hex()};
{COORDINATE}
#if defined(__CUDA_ARCH__)
const int begin = block; const int end = block < count ? block + 1 : count;
#else
const int begin = block * {BLOCK}; const int end = begin + {BLOCK} < count ? begin + {BLOCK} : count;
#endif
for (int i = begin; i < end; ++i) {{
    const float* q = x.data + (size_t)i * (2 * N);
    unsigned char answer = 0;
    bool finite = true;
    for (int k = 0; k < 2 * N; ++k) finite &= q[k] - q[k] == 0.0f;
    while (finite) {{
        {body}
        break;
    }}
    out.data[i] = answer;
}}
"""


def cell_coordinates(grid: IndicatorGrid, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The twin of the kernels' ``Coordinate``: t and its rounding error.

    Args:
        grid: The object.
        x: ``(..., n)`` float32, finite.

    Returns:
        Two arrays ``(..., n)`` float64 whose sum is the exact cell coordinate.
    """
    product = np.asarray(x, dtype=np.float32).astype(np.float64) * grid.cells_per_unit
    t = product - grid.offset
    back = t - product
    return t, (product - (t - back)) + (-grid.offset - back)


def rational_map(grid: IndicatorGrid, x: np.ndarray) -> list[Fraction]:
    """Exact cell coordinates of one float32 point.

    Args:
        grid: The object.
        x: ``(n,)`` float32, finite.

    Returns:
        n rational numbers.
    """
    return [
        Fraction(float(v)) * Fraction(float(s)) - Fraction(float(o))
        for v, s, o in zip(x, grid.cells_per_unit, grid.offset, strict=True)
    ]


def integers(values: list[Fraction]) -> tuple[list[int], int]:
    """Numerators over the least common denominator.

    Args:
        values: Rational numbers.

    Returns:
        The numerators, and the denominator.
    """
    denominator = lcm(*(v.denominator for v in values))
    return [v.numerator * (denominator // v.denominator) for v in values], denominator


class RegionOracle:
    """The exact truth for regions of 2n numbers. A kind sets its kernel and arrays, and decides single queries exactly.

    Attributes:
        grid: The object.
        ndim: Its dimension n.
        device: Where the kernel runs.
        undecided: How many queries of the last call went to the host.
    """

    kind = ""

    def __init__(self, grid: IndicatorGrid, device: str | None = None):
        self.grid, self.ndim, self.device, self.undecided = grid, grid.ndim, wp.get_device(device), 0
        values = np.concatenate([grid.cells_per_unit, grid.offset, np.array(grid.shape, dtype=np.float64)])
        self._map = self._array(values, wp.float64)

    def _array(self, values: np.ndarray, dtype) -> wp.array:
        return wp.array(values.reshape(-1), dtype=dtype, device=self.device)

    def _launch(self, kernel: wp.Kernel, q: np.ndarray, inputs: list) -> np.ndarray:
        out = wp.empty(len(q), dtype=wp.uint8, device=self.device)
        flat = wp.array(q.reshape(-1), dtype=wp.float32, device=self.device, copy=not self.device.is_cpu)
        launch_blocks(kernel, len(q), [flat, len(q), 0, self._map, *inputs], [out], self.device, first_index=2)
        return out.numpy()

    def _checked(self, q: np.ndarray) -> np.ndarray:
        with np.errstate(over="ignore"):
            q = np.ascontiguousarray(q, dtype=np.float32)
        if q.ndim != 2 or q.shape[1] != 2 * self.ndim:
            raise QueryError(f"a {self.kind} query must have shape (N, {2 * self.ndim}), got {q.shape}")
        return q

    def _kernel_answers(self, q: np.ndarray) -> np.ndarray:
        """``(N,)`` uint8: 0, 1, or 2 for undecided."""
        raise NotImplementedError

    def _decide(self, q: np.ndarray) -> bool:
        """The exact truth of one valid query, in rational arithmetic."""
        raise NotImplementedError

    def __call__(self, q: np.ndarray) -> np.ndarray:
        """Truth for regions.

        Args:
            q: ``(N, 2n)`` float32, object space. Invalid queries (NaN, infinity, zero direction or normal, min > max)
                meet nothing here; bounders answer *maybe* to them.

        Returns:
            ``(N,)`` bool.

        Raises:
            QueryError: For another shape.
        """
        q = self._checked(q)
        if len(q) == 0:
            return np.zeros(0, dtype=bool)
        answer = self._kernel_answers(q)
        undecided = np.flatnonzero(answer == 2)
        self.undecided = len(undecided)
        truth = answer == 1
        for index in undecided:
            truth[index] = self._decide(q[index])
        return truth
