"""The paper's figures of speed, measured on an RTX 3090, and what Eq. 6 makes of times and rates.

Source: Liu, Fischer, Yoo, Ritschel, *Neural Bounding* (SIGGRAPH 2024), Table 2, Eq. 6 and Section *Early-out*; and the
table of all queries of its supplement.

The column *Ratio* of Table 2 is what Eq. 6 says of the times in that table, so it is a time: milliseconds that ten
million tests of the geometry must take at least. (In the row of the box it has been computed with the k-DOP's false
positives.) ``BreakEven.factor`` is the same as a multiple of a query of the other method.
"""

import math
from dataclasses import dataclass

from paper.columns import COLUMNS, Column
from warp_bounding.queries.ray import RAY

__all__ = [
    "PAPER_DEVICE",
    "PAPER_MEAN_GAIN",
    "PAPER_MS",
    "PAPER_RATIO",
    "QUERIES",
    "TABLE_2",
    "BreakEven",
    "break_even",
    "paper_early_out",
    "paper_ms",
]

PAPER_DEVICE = "RTX 3090"
QUERIES = 10_000_000  # that a time in milliseconds is for
TABLE_2 = Column(3, RAY.name)  # the column of Table 2
PAPER_MEAN_GAIN = 24.3  # per cent, of the early exits, as Section *Early-out* states it
PAPER_MS = {  # for ``QUERIES`` queries; columns as in ``COLUMNS``
    "aabb": (1.03, 2.08, 2.08, 2.08, 1.27, 2.58, 2.58, 2.58, 2.04, 4.21, 4.21, 4.20),
    "obb": (1.03, 2.08, 2.09, 2.09, 1.27, 2.58, 2.59, 2.60, 2.06, 4.22, 4.24, 3.42),
    "sphere": (1.06, 1.85, 1.85, 1.85, 1.31, 2.36, 2.36, 2.38, 1.83, 3.43, 3.43, 3.42),
    "ellipsoid": (1.07, 1.86, 1.86, 1.86, 1.33, 2.39, 2.39, 2.44, 1.84, 3.46, 3.46, 3.46),
    "oriented-ellipsoid": (1.07, 1.87, 1.86, 1.87, 1.33, 2.39, 2.45, 2.43, 1.84, 3.46, 3.47, 3.47),
    "kdop": (12.42, 14.36, 14.37, 14.35, 10.61, 41.27, 41.40, 41.39, 14.06, 54.84, 54.87, 54.66),
    "bvh": (18.06, 23.28, 22.96, 23.42, 17.40, 25.67, 26.35, 26.13, 24.52, 29.17, 27.09, 25.10),
    "learned-kdop": (4.41, 7.73, 7.72, 7.72, 5.64, 11.84, 11.76, 11.70, 7.79, 16.58, 16.56, 16.53),
    "mlp": (28.14, 28.43, 28.44, 28.43, 70.32, 70.82, 70.74, 70.69, 111.90, 113.08, 112.79, 112.58),
    "mlp-early": (24.55, 29.26, 32.39, 30.71, 35.97, 46.30, 74.70, 50.90, 64.86, 96.15, 135.08, 101.95),
}
PAPER_RATIO = {  # the last column of Table 2, against the network with exits
    "aabb": 78.78,
    "obb": 103.08,
    "sphere": 74.15,
    "ellipsoid": 74.10,
    "oriented-ellipsoid": 83.07,
    "kdop": 9.06,
    "bvh": 84.82,
    "learned-kdop": 114.92,
}


def paper_ms(method: str, column: Column) -> float | None:
    """Milliseconds for ``QUERIES`` queries in the supplement, or ``None``."""
    return PAPER_MS[method][COLUMNS.index(column)] if method in PAPER_MS else None


def paper_early_out() -> dict[Column, float]:
    """Time of the network over that of the one with exits, by column."""
    whole, early = PAPER_MS["mlp"], PAPER_MS["mlp-early"]
    return {column: a / b for column, a, b in zip(COLUMNS, whole, early, strict=True)}


@dataclass(frozen=True)
class BreakEven:
    """When a method pays in comparison with another one, by what a test of the geometry costs (Eq. 6).

    Attributes:
        least: It pays where a test costs more than this; 0 where it always may.
        most: It pays where a test costs less than this; infinite where no price is too high.
        factor: ``least`` as a multiple of a query of the other method.
    """

    least: float
    most: float
    factor: float

    @property
    def always(self) -> bool:
        """Whether it pays at any price."""
        return self.least == 0 and self.most == math.inf

    @property
    def never(self) -> bool:
        """Whether it pays at no price."""
        return self.least >= self.most


def break_even(time: float, rate: float, other_time: float, other_rate: float) -> BreakEven:
    """Eq. 6: ``time + rate t < other_time + other_rate t`` for a price t of one test of the geometry, solved for t.

    Args:
        time: Of one query, in any unit; prices are in the same.
        rate: False positives as a share of all queries.
        other_time: Of one query of the method that it is compared with.
        other_rate: Its false positives.
    """
    if rate < other_rate:
        least, most = max((time - other_time) / (other_rate - rate), 0.0), math.inf
    elif rate > other_rate:
        least, most = 0.0, max((other_time - time) / (rate - other_rate), 0.0)
    else:
        least, most = 0.0, math.inf if time < other_time else 0.0
    return BreakEven(least, most, least / other_time)
