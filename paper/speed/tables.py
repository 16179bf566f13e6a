"""What the page of ``speed`` shows, as numbers: means over objects on one device, gains of early exits, break-evens."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from paper.columns import COLUMNS, VARIANTS, Column, Variant
from paper.speed.figures import QUERIES, TABLE_2, BreakEven, break_even
from paper.speed.rows import SpeedRow
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.bounders.mlp_early import MlpEarly
from warp_bounding.bounders.volumes import Aabb

__all__ = ["EARLY", "MOST_LOSS", "Cell", "EarlyOut", "OnDevice", "by_device"]

WHOLE, EARLY, BOX = Variant(Mlp.method), Variant(MlpEarly.method), Variant(Aabb.method)
MOST_LOSS = 1.2  # exits pay where false positives are at most so many times as many
TRAINED = 0.9  # a network with more than this share of the box's false positives has learnt nothing


@dataclass(frozen=True)
class Cell:
    """A method in a column: means over objects."""

    ns: float  # a query; the geometric mean over objects
    ratio: float  # its time over that of ``mlp`` in the same rounds; the geometric mean over objects
    fp_rate: float  # per cent
    fn: int  # in all
    objects: int  # number of these
    nbytes: float

    @property
    def ms(self) -> float:
        """Milliseconds for ``QUERIES`` queries."""
        return self.ns * QUERIES / 1e6

    @property
    def billions(self) -> float:
        """Queries a second, in billions."""
        return 1 / self.ns


@dataclass(frozen=True)
class EarlyOut:
    """What early exits gain in a column."""

    column: Column
    gain: float  # time of ``mlp`` over that of ``mlp-early``
    fp_whole: float  # false positives of ``mlp``, per cent
    fp_early: float  # of ``mlp-early``
    fp_box: float | None  # of the box, where it was raced

    @property
    def trained(self) -> bool:
        """Whether the fit had time to learn: a network that is no tighter than a box says *maybe* nearly everywhere."""
        return self.fp_box is None or self.fp_whole < TRAINED * self.fp_box

    @property
    def pays(self) -> bool:
        """Whether exits gain time of a network that has learnt something, and cost few false positives."""
        return self.gain > 1 and self.trained and self.fp_early <= MOST_LOSS * self.fp_whole


class OnDevice:
    """All means on one device.

    Attributes:
        device: Its alias.
        name: What it is.
        rows: What they are means of.
        columns: That have any, in order.
        variants: That have any, in order.
        cells: By row and column.
    """

    def __init__(self, rows: Iterable[SpeedRow], device: str):
        self.device, self.rows = device, [row for row in rows if row.device == device]
        self.name = self.rows[0].device_name
        groups: dict[tuple[Variant, Column], list[SpeedRow]] = {}
        for row in self.rows:
            groups.setdefault((row.variant, row.column), []).append(row)
        self.cells = {key: _mean(group) for key, group in groups.items()}
        self.columns = [c for c in COLUMNS if any(c == column for _, column in self.cells)]
        self.variants = [v for v in VARIANTS if any(v == variant for variant, _ in self.cells)]

    def early_out(self) -> list[EarlyOut]:
        """Of each column that both networks were raced in, the largest gain last; of rows of the same objects."""
        found = []
        for column in self.columns:
            whole, early = self.cells.get((WHOLE, column)), self.cells.get((EARLY, column))
            if whole and early:
                box = self.cells.get((BOX, column))
                rates = (whole.fp_rate, early.fp_rate, box.fp_rate if box else None)
                found.append(EarlyOut(column, whole.ratio / early.ratio, *rates))
        return sorted(found, key=lambda each: each.gain)

    def break_even(self, variant: Variant, column: Column = TABLE_2) -> BreakEven | None:
        """When ``mlp-early`` pays in comparison with another row; prices in milliseconds for ``QUERIES`` tests.

        Times are those of the reference, from which all others follow by their ratios within a round.
        """
        whole, ours, other = (self.cells.get((v, column)) for v in (WHOLE, EARLY, variant))
        if whole is None or ours is None or other is None:
            return None
        times = (cell.ratio * whole.ms for cell in (ours, other))
        (time, other_time), (rate, other_rate) = times, (ours.fp_rate / 100, other.fp_rate / 100)
        return break_even(time, rate, other_time, other_rate)

    def missed(self) -> int:
        """False negatives of methods that promise none."""
        return sum(row.fn for row in self.rows if row.variant.conservative)


def _mean(group: list[SpeedRow]) -> Cell:
    return Cell(
        ns=float(np.exp(np.mean(np.log([row.ns for row in group])))),
        ratio=float(np.exp(np.mean(np.log([row.ratio for row in group])))),
        fp_rate=float(np.mean([row.fp_rate for row in group])),
        fn=sum(row.fn for row in group),
        objects=len(group),
        nbytes=float(np.mean([row.nbytes for row in group])),
    )


def by_device(rows: Iterable[SpeedRow]) -> list[OnDevice]:
    """Of each device that anything was measured on, in the order of the measurements."""
    rows = list(rows)
    return [OnDevice(rows, device) for device in dict.fromkeys(row.device for row in rows)]
