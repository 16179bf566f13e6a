"""Segments of points: ``z = (a, w, t)``, the points ``a + t w`` of one segment for t in an interval.

Of a box only t has a width; halving it halves the segment. The inputs are linear in t, so there is one column of
generators, and the only noise is rounding.
"""

from dataclasses import dataclass

import numpy as np

from warp_bounding.networks.charts.base import Chart

__all__ = ["SegmentChart"]

ROUNDING = 2.0**-50  # relative, of a product and three sums in float64


@dataclass(frozen=True)
class SegmentChart(Chart):
    """K inputs, ``2 K + 1`` numbers; see module."""

    expand = f"""
dead = zero;
const V middle_ = (low[2 * K] + high[2 * K]) * 0.5, half_ = (high[2 * K] - low[2 * K]) * 0.5;
for (int k = 0; k < K; ++k) {{
    center[k] = low[k] + low[K + k] * middle_;
    gen[k] = low[K + k] * half_;
    rest[k] = noise[k] = (absolute(low[k]) + absolute(low[K + k])) * {ROUNDING.hex()};
}}
"""
    realize = """
for (int k = 0; k < 2 * K; ++k) z[k] = low[k];
z[2 * K] = slope[0] > zero ? low[2 * K] : high[2 * K];
valid = zero + 1.0;
for (int k = 0; k < K; ++k) h[k] = z[k] + z[K + k] * z[2 * K];
"""
    owners = "owner[0] = zero + 2.0 * K;"

    @property
    def size(self) -> int:
        return 2 * self.inputs + 1

    @property
    def columns(self) -> int:
        return 1

    @property
    def pairs(self) -> list[tuple[int, int]]:
        return [(k, 0) for k in range(self.inputs)]

    def coordinates(self, z: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        n = self.inputs
        return z[:, :n] + z[:, n : 2 * n] * z[:, 2 * n :]
