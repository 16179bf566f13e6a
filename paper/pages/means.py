"""Means over objects: the numbers of the table, and which of them is the best of its column."""

from collections.abc import Iterable
from dataclasses import dataclass

from paper.columns import COLUMNS, NETWORKS, VARIANTS, Column, Variant
from paper.rows import Row

__all__ = ["Mean", "Means"]


@dataclass(frozen=True)
class Mean:
    """A cell of the table."""

    fp_rate: float  # false positives, per cent, mean over objects
    fn: int  # false negatives in all
    samples: int  # in all
    objects: int  # number of objects
    complete: bool  # whether these are all objects that any row of the column was measured on
    kinds: frozenset[str]  # kinds of certificate
    unproven: int  # number of objects whose bounder is not proven

    @property
    def proven(self) -> bool:
        """Whether every bounder of it is proven."""
        return self.kinds == {"proven"}

    @property
    def certified(self) -> bool:
        """Whether every bounder of it is proven or has at least a statistical bound."""
        return self.kinds <= {"proven", "statistical"}

    @property
    def fn_rate(self) -> float:
        """False negatives, per cent of all samples."""
        return 100 * self.fn / self.samples


class Means:
    """All means under one protocol.

    Attributes:
        protocol: Which.
        rows: What they are means of.
        objects: Names of the objects of each column that has any, in the table's order of columns.
        cells: By row and column.
    """

    def __init__(self, rows: Iterable[Row], protocol: str):
        self.protocol = protocol
        self.rows = [r for r in rows if r.protocol == protocol]
        self.objects = {c: sorted({r.object for r in self.rows if r.column == c}) for c in COLUMNS}
        self.objects = {c: names for c, names in self.objects.items() if names}
        groups: dict[tuple[Variant, Column], list[Row]] = {}
        for row in self.rows:
            groups.setdefault((row.variant, row.column), []).append(row)
        self.cells = {key: self._mean(group) for key, group in groups.items()}

    def _mean(self, group: list[Row]) -> Mean:
        return Mean(
            fp_rate=sum(r.fp_rate for r in group) / len(group),
            fn=sum(r.fn for r in group),
            samples=sum(r.samples for r in group),
            objects=len(group),
            complete=len(group) == len(self.objects[group[0].column]),
            kinds=frozenset(r.certificate for r in group),
            unproven=sum(r.certificate != "proven" for r in group),
        )

    @property
    def variants(self) -> list[Variant]:
        """Rows that have any number, in the table's order."""
        return [v for v in VARIANTS if any(v == row for row, _ in self.cells)]

    def best(self, column: Column) -> list[Variant]:
        """The tightest rows among those that are ranked, certified, without a false negative, and measured on every object."""
        able = {
            v: m.fp_rate
            for (v, c), m in self.cells.items()
            if c == column and v.ranked and m.complete and m.certified and m.fn == 0
        }
        return [v for v, rate in able.items() if rate == min(able.values())] if len(able) > 1 else []

    def best_network(self, column: Column) -> tuple[Variant, Mean] | None:
        """The tightest network that was measured on every object, if there is one."""
        able = [(v, m) for (v, c), m in self.cells.items() if c == column and v.method in NETWORKS and m.complete]
        return min(able, key=lambda pair: pair[1].fp_rate, default=None)

    def missed(self, variant: Variant) -> tuple[int, int]:
        """False negatives and samples of a row, in all."""
        own = [m for (v, _), m in self.cells.items() if v == variant]
        return sum(m.fn for m in own), sum(m.samples for m in own)

    def broken_promises(self) -> list[str]:
        """A line for each bounder that promised to have no false negative and has."""
        return [
            f"{r.column.name} {r.object}: {r.variant.label} ({r.protocol}): {r.fn} false negatives"
            for r in self.rows
            if r.fn and r.variant.conservative
        ]

    def to_dict(self) -> dict[str, dict]:
        """JSON-ready: by column and row."""
        return {
            column.name: {
                variant.label: {
                    "fp_rate": round(mean.fp_rate, 4),
                    "fn": mean.fn,
                    "objects": mean.objects,
                    "proven": mean.proven,
                    "paper": variant.paper(column),
                }
                for variant in self.variants
                if (mean := self.cells.get((variant, column))) is not None
            }
            for column in self.objects
        }
