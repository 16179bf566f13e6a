"""What all demos print and return: one table of runs, a verdict, a row a bounder, and progress on standard error."""

import os
import platform
import sys
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field
from itertools import groupby
from typing import TypeVar

import warp as wp
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

import warp_bounding as wb
from sims.assets import Shape
from sims.versions import versions
from warp_bounding.runtime.progress import bar

__all__ = ["CHOSEN", "UNPROVEN", "Run", "bounder_rows", "kept", "output", "result", "run_table", "shown", "verdict"]

CHOSEN = "chosen"  # the row of what ``choose`` takes, beside the very bounder's own
UNPROVEN = ("occupancy",)  # what is shown to go wrong; every other run must keep the promise
SAMPLES = 400_000  # random queries of a rate of false positives
WIDTH = 140  # columns of a line where standard output is no terminal
T = TypeVar("T")


@dataclass
class Run:
    """What one run of a demo cost, and what it lost.

    Runs of one section have one reference, the first of them. Calls of the narrow phase are those of all steps
    together, milliseconds medians over the steps.
    """

    bounder: str  # the broad phase; ``"none"`` for the reference
    narrow_calls: int  # queries that met the narrow phase
    ms_broad: float  # all that the broad phase costs: queries, refits, masks, compaction
    ms_narrow: float  # the narrow phase
    ms_step: float  # a whole step
    missed: int  # contacts (or hits, or collisions) that the reference has and this run lacks
    identical: bool  # whether the result is the reference's, to the bit
    fp_rate: float | None = None  # against the shape itself, per cent of random queries; ``None`` for the reference
    fp_rate_cells: float | None = None  # the same against the cells that are bounded, where a shape's cells are
    certificate: str = (
        ""  # its kind; empty where it has none; ``"by construction"`` of what is no bounder, and needs none
    )
    section: str = ""  # empty where a demo has only one
    extra: dict = field(
        default_factory=dict
    )  # more numbers of the demo's own, by name; they become keys beside the others

    @property
    def conservative(self) -> bool:
        """Whether this run must keep the promise: what has neither a proof nor need of one promises nothing."""
        return self.bounder not in UNPROVEN and self.certificate != "statistical"

    def to_dict(self) -> dict:
        """JSON-ready."""
        values = asdict(self)
        return values | values.pop("extra")


def output(stderr: bool = False) -> Console:
    """The console for tables and sentences; where it is no terminal, lines are as wide as tables need."""
    console = Console(stderr=stderr, highlight=False, soft_wrap=True)
    return console if console.is_terminal else Console(stderr=stderr, highlight=False, soft_wrap=True, width=WIDTH)


def shown(items: Iterable[T], description: str) -> Iterator[T]:
    """The same items one after another, with progress on standard error: a bar in a terminal, elsewhere a few lines.

    Nothing where something has taken the place of standard error, as in a notebook.
    """
    items = list(items)
    if sys.stderr is sys.__stderr__ and not Console(stderr=True).is_terminal:
        print(f"{description} ...", file=sys.stderr, flush=True)
    with bar(description) as update:
        for number, item in enumerate(items):
            update(number, len(items))
            yield item


def bounder_rows(
    bounders: dict[str, wb.Bounder], shape: Shape, samples: int = SAMPLES, distances: dict | None = None
) -> list[dict]:
    """How tight each bounder of a shape is: its false positives against the shape itself.

    Args:
        bounders: By name.
        shape: The shape that they bound.
        samples: Random queries of each.
        distances: What ``warp_bounding.evaluate`` is told of bounders of distances besides; points at radius 0 if
            ``None``.

    Returns:
        Per bounder: ``bounder``, ``query``, ``fp_rate`` (per cent of random queries), ``fp_rate_cells`` (the same
        against the cells that it bounds; ``None`` where it bounds the shape), ``undecided`` (per cent; counted as
        positives), ``fn`` (a count), ``bytes``, ``certificate`` (its kind).
    """
    rows = []
    for name, bounder in shown(bounders.items(), "measuring bounders"):
        queried = (distances or {}) if bounder.of_distances else {}
        rates = wb.evaluate(bounder, shape, samples=samples, **queried)
        row = {"bounder": name, "query": bounder.query_kind, "fp_rate": rates.fp_rate}
        row |= {"fp_rate_cells": rates.fp_rate_cells, "undecided": rates.undecided, "fn": rates.fn}
        kind = bounder.certificate.kind if bounder.certificate else "none"
        rows.append(row | {"bytes": bounder.nbytes, "certificate": kind})
    return rows


def run_table(
    title: str, runs: list[Run], *, steps: int, calls: str = "narrow calls", extra: dict[str, str] | None = None
) -> Table:
    """The runs for people.

    Args:
        title: Of the table.
        runs: The reference first, or the reference of each section.
        steps: By which calls are divided.
        calls: What the narrow phase is called for, as a column's head.
        extra: Columns for keys of ``Run.extra``: head by key.
    """
    extra = extra or {}
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("broad phase", no_wrap=True)
    cells = ["of cells"] if any(run.fp_rate_cells is not None for run in runs) else []
    for head in (calls, "broad ms", "narrow ms", "step ms", *extra.values(), "missed", "FP %", *cells):
        table.add_column(head, justify="right", no_wrap=True)
    table.add_column("certificate", no_wrap=True)
    table.add_column("result", no_wrap=True)
    for section, members in groupby(runs, key=lambda run: run.section):
        if section:
            table.add_section()
            table.add_row(f"[bold]{escape(section)}[/]")
        for place, run in enumerate(members):
            outcome = "" if not place else "identical" if run.identical else "[bold red]differs[/]"
            missed = "" if not place else f"[bold red]{run.missed:,}[/]" if run.missed else "0"
            times = (f"{ms:.2f}" for ms in (run.ms_broad, run.ms_narrow, run.ms_step))
            more = [_cell(run.extra.get(key)) for key in extra]
            known = (run.fp_rate, run.fp_rate_cells)[: 1 + len(cells)]
            rates = ["" if rate is None else f"{rate:.2f}" for rate in known]
            proof = "" if not place else run.certificate or "[red]none[/]"
            table.add_row(
                run.bounder, f"{run.narrow_calls / steps:,.0f}", *times, *more, missed, *rates, proof, outcome
            )
    return table


def _cell(value) -> str:
    if value is None:
        return ""
    return value if isinstance(value, str) else f"{value:,}" if isinstance(value, int) else f"{value:.3g}"


def kept(runs: list[Run]) -> bool:
    """Whether every conservative run has missed nothing and ended as the reference."""
    return all(run.missed == 0 and run.identical for run in runs if run.conservative)


def verdict(runs: list[Run], what: str = "contacts") -> str:
    """A few sentences, with markup: what was kept, and what the unproven ones lost."""
    broken = [run for run in runs if run.conservative and (run.missed or not run.identical)]
    proven = sum(run.certificate == "proven" and run.bounder != CHOSEN for run in runs)  # which is one of the others
    lines = []
    if broken:
        names = ", ".join(_named(run) for run in broken)
        lines = [f"[bold red]Broken promise: {names} missed {what}, or ended differently.[/]"]
    elif proven:
        count = f"The {proven} run{'s' * (proven > 1)} with proven bounders missed none of the {what}"
        lines = [f"{count}; the results are identical, to the bit, to the one without."]
    for run in runs:
        if not run.conservative:
            proof = "which has no proof" if not run.certificate else "whose certificate is statistical"
            lost = f"missed {run.missed:,} {what}" if run.missed or not run.identical else f"missed none of the {what}"
            lines.append(f"[red]{_named(run)}[/], {proof}, {lost}.")
    return " ".join(lines)


def _named(run: Run) -> str:
    return f"{run.bounder} ({escape(run.section)})" if run.section else run.bounder


def result(demo: str, shape: str, steps: int, runs: list[Run], pictures: list, **more) -> dict:
    """What a demo returns, JSON-ready; ``identical`` is ``kept``: of the conservative runs."""
    head = {"demo": demo, "shape": shape, "steps": steps, "runs": [run.to_dict() for run in runs]}
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    head["versions"] = versions()
    head["machine"] = f"Python {platform.python_version()}, Warp {wp.__version__}, {cores} cores"
    return head | {"identical": kept(runs), "pictures": [str(p) for p in pictures]} | more
