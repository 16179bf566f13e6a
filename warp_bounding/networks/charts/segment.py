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

    @property
    def size(self) -> int:
        return 2 * self.inputs + 1

    @property
    def columns(self) -> int:
        return 1

    @property
    def pairs(self) -> list[tuple[int, int]]:
        return [(k, 0) for k in range(self.inputs)]

    def expand(self) -> str:
        n = self.inputs
        lines = [
            f"dead = zero; const V middle_ = (low[{2 * n}] + high[{2 * n}]) * 0.5, half_ = (high[{2 * n}] - low[{2 * n}]) * 0.5;"
        ]
        for k in range(n):
            a, w = f"low[{k}]", f"low[{n + k}]"
            size = f"(({a} < zero ? -{a} : {a}) + ({w} < zero ? -{w} : {w}))"
            lines.append(
                f"center[{k}] = {a} + {w} * middle_; gen[{k}] = {w} * half_; rest[{k}] = noise[{k}] = {size} * {ROUNDING.hex()};"
            )
        return "\n".join(lines)

    def realize(self) -> str:
        n = self.inputs
        lines = [f"z[{k}] = low[{k}];" for k in range(2 * n)]
        lines.append(f"z[{2 * n}] = slope[0] > zero ? low[{2 * n}] : high[{2 * n}]; valid = zero + 1.0;")
        lines += [f"h[{k}] = z[{k}] + z[{n + k}] * z[{2 * n}];" for k in range(n)]
        return "\n".join(lines)

    def owners(self) -> str:
        return f"owner[0] = zero + {2 * self.inputs}.0;"

    def coordinates(self, z: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        n = self.inputs
        return z[:, :n] + z[:, n : 2 * n] * z[:, 2 * n :]
