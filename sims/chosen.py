"""The row ``chosen`` of a demo: what ``wb.choose`` takes of the demo's own bounders.

It is told what a simulation's author can tell: some of the queries of a run without a broad phase, and what a call of
the narrow phase takes there. Nothing is fitted.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import inf
from typing import Any

import numpy as np

import warp_bounding as wb
from sims.assets import Shape
from sims.report import CHOSEN, UNPROVEN
from warp_bounding.choice import Row

__all__ = ["Taken", "take", "time_own_code"]

MOST = 100_000  # queries that are told: half of them are measured
CALLS = 5  # of one's own code, that are timed: the fastest counts


@dataclass
class Taken:
    """Choices, one a shape.

    Attributes:
        choices: By name of the shape.
    """

    choices: dict[str, wb.Choice] = field(default_factory=dict)

    @property
    def bounders(self) -> dict[str, wb.Bounder] | None:
        """By name of the shape; ``None`` where no broad phase is the answer for some of them: then all do without."""
        found = {name: choice.bounder for name, choice in self.choices.items()}
        return None if None in found.values() else found

    def rows(self, rows: list[dict], name: str) -> list[dict]:
        """What is known of the bounder of a shape, among these, as a row of its own."""
        return [row | {"bounder": CHOSEN} for row in rows if row["bounder"] == self.choices[name].label]

    def sentence(self, where: str = "") -> str:
        """What was taken, and at which price."""
        reported = [
            f"{choice.label}{f' for {name}' if len(self.choices) > 1 else ''} at {choice.narrow_ns:.3g} ns a call"
            for name, choice in self.choices.items()
        ]
        return f"{where}: choose takes {', '.join(reported)}." if where else f"choose takes {', '.join(reported)}."

    def to_dict(self) -> dict:
        """All rows of all choices, JSON-ready."""
        return {name: choice.to_dict() for name, choice in self.choices.items()}


def take(
    shapes: Mapping[str, Shape],
    bounders: Mapping[str, Mapping[str, wb.Bounder]],
    asked: Mapping[str, np.ndarray],
    narrow_ns: float,
    query: str = "point",
    *,
    device: str = "cpu",
    **options,
) -> Taken:
    """Choose for each shape, among the proven bounders of a demo.

    Args:
        shapes: What is bounded, by name.
        bounders: By name of the method, then of the shape; those of other queries are no candidates.
        asked: ``(Q, m)`` queries of each shape.
        narrow_ns: What a call of the narrow phase takes.
        query: Kind of query.
        device: Warp device.
        options: More of what ``wb.choose`` takes.
    """
    taken = Taken()
    for name, shape in shapes.items():
        x = asked[name]
        if len(x) > MOST:
            x = x[np.sort(np.random.default_rng(0).permutation(len(x))[:MOST])]
        own = {
            method: found[name]
            for method, found in bounders.items()
            if method not in UNPROVEN and found[name].query_kind == query
        }
        taken.choices[name] = wb.choose(
            shape,
            query,
            workload=x,
            narrow_ns=narrow_ns,
            methods=(),
            bounders=own,
            device=device,
            progress=False,
            **options,
        )
    return taken


def time_own_code(asked: Mapping[str, Callable[[], Any]], queries: int, narrow_ns: float) -> wb.Choice:
    """Time broad phases that are more than one bounder, all overhead included, and take the cheapest.

    Args:
        asked: Functions without arguments by label; each answers the same queries and returns ``(queries,)`` numbers,
            not zero where the narrow phase is needed.
        queries: How many these are.
        narrow_ns: What the narrow phase takes for one query, nanoseconds.

    Returns:
        The choice; its ``bounder`` is ``None``, its ``label`` says which.
    """
    rows = [Row("none", 0, 0.0, 1.0, 1.0, narrow_ns)]
    for label, ask in asked.items():
        share, seconds = float(np.count_nonzero(ask())) / queries, inf  # the first call loads kernels
        for _ in range(CALLS):
            start = time.perf_counter()
            ask()
            seconds = min(seconds, time.perf_counter() - start)
        taken = 1e9 * seconds / queries
        rows.append(Row(label, 0, taken, share, share, taken + share * narrow_ns))
    rows.sort(key=lambda row: row.cost)
    return wb.Choice(None, tuple(rows), narrow_ns, min(row.share for row in rows), queries)
