"""A chart within a part of the network's inputs: only queries whose inputs lie between two corners count.

The part's sides are constraints, as linear as the chart's own. So the bound of a box that reaches beyond the part is
that of what lies in it, and a box whose inputs all lie outside holds no positive.
"""

from dataclasses import dataclass

import numpy as np

from warp_bounding.networks.charts.base import Chart

__all__ = ["FARTHEST", "PartChart"]

FARTHEST = 2.0**40  # stands for a side that the part does not have: far beyond all inputs
CLEAR = 1e-12  # relative: how far a box's inputs must lie outside, well above what float64 rounds here

_OUTSIDE = f"""
const double* part_lower = numbers.data + PART_AT; const double* part_upper = part_lower + K;
V reach[K];
for (int k = 0; k < K; ++k) reach[k] = noise[k];
REACH
for (int k = 0; k < K; ++k) {{
    const V room = reach[k] + (absolute(center[k]) + reach[k]) * {CLEAR};
    dead = center[k] + room < zero + part_lower[k] ? zero + 1.0 : dead;
    dead = center[k] - room > zero + part_upper[k] ? zero + 1.0 : dead;
}}
"""
# A positive that rounding may move into another part is none of this one.
_WITHIN = """
for (int k = 0; k < K; ++k) {
    valid = h[k] < zero + part_lower[k] ? zero : valid;
    valid = h[k] >= zero + part_upper[k] ? zero : valid;
}
"""


@dataclass(frozen=True)
class PartChart(Chart):
    """Another chart, within a part.

    ``numbers``: the chart's own, then the part's lower and upper corner, K numbers each.

    Attributes:
        chart: The other chart.
        count: How many numbers it has.
    """

    chart: Chart
    count: int

    @classmethod
    def of(cls, chart: Chart, numbers: np.ndarray) -> "PartChart":
        """A chart with these numbers of its own."""
        return cls(chart.inputs, chart, len(numbers))

    @property
    def noisy(self) -> bool:
        """The chart's own."""
        return self.chart.noisy

    @property
    def size(self) -> int:
        return self.chart.size

    @property
    def columns(self) -> int:
        return self.chart.columns

    @property
    def pairs(self) -> list[tuple[int, int]]:
        return self.chart.pairs

    @property
    def expand(self) -> str:
        """The chart's text, then the box is emptied where it lies outside the part."""
        reach = " ".join(f"reach[{i}] += absolute(gen[{at}]);" for at, (i, _) in enumerate(self.chart.pairs))
        return self.chart.expand + _OUTSIDE.replace("PART_AT", str(self.count)).replace("REACH", reach)

    @property
    def realize(self) -> str:
        """The chart's text, then what the part demands of a positive."""
        return self.chart.realize + _WITHIN

    @property
    def owners(self) -> str:
        """The chart's own."""
        return self.chart.owners

    @property
    def blame(self) -> str:
        """The chart's own."""
        return self.chart.blame

    @property
    def bend(self) -> str:
        """The chart's own."""
        return self.chart.bend

    @property
    def split(self) -> str:
        """The chart's own."""
        return self.chart.split

    def constraints(self) -> list[tuple[str, list[tuple[int, str]]]]:
        lower = [(f"part_lower[{k}] - center[{k}] - noise[{k}]", [(k, "-1.0")]) for k in range(self.inputs)]
        upper = [(f"center[{k}] - noise[{k}] - part_upper[{k}]", [(k, "1.0")]) for k in range(self.inputs)]
        return [*self.chart.constraints(), *lower, *upper]

    def middle(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return self.chart.middle(a, b)

    def coordinates(self, z: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        return self.chart.coordinates(z, numbers[: self.count])

    def hull(self, lower: np.ndarray, upper: np.ndarray, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.chart.hull(lower, upper, numbers[: self.count])
