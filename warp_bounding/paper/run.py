"""The resumable run: fit, save, measure under each protocol, write the row at once; what is in the folder is not done again.

A fit that fails is reported at the end and the others go on. An interruption is never taken for a result: Ctrl-C makes
``fit`` end its training early and return what it has, which is thrown away here.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from warp_bounding.errors import FileFormatError, IndicatorError
from warp_bounding.paper.columns import Column, Variant
from warp_bounding.paper.fitting import FAILURES, fit_bounder, interruptions, load_bounder, reason_of
from warp_bounding.paper.folder import Folder
from warp_bounding.paper.plan import Job, TimeLeft, plan
from warp_bounding.paper.rows import Row
from warp_bounding.paper.shapes import Shape
from warp_bounding.paper.tools import Tools, versions
from warp_bounding.runtime.launch import cpu_threads

__all__ = ["Outcome", "Reporter", "run"]

DIGEST = 16  # characters of the SHA-256 of an object's cells


class Reporter(Protocol):
    """Who is told how the run goes."""

    def begin(self, total: int, done: int, left: TimeLeft) -> None:
        """The run begins: cells in all, cells done before."""

    def start(self, job: Job) -> None:
        """A job begins."""

    def within(self, done: float, total: float = 1.0, note: str = "") -> None:
        """How far a fit or a measurement has come."""

    def row(self, row: Row) -> None:
        """A cell is done, its row written."""

    def fail(self, job: Job, reason: str) -> None:
        """A job has failed."""

    def say(self, text: str) -> None:
        """Something people should know."""


@dataclass
class Outcome:
    """How a run ended.

    Attributes:
        total: Cells that were asked for.
        done: Cells that are in the table.
        failed: A line for each cell that is not, because its fit or measurement failed.
        interrupted: Whether Ctrl-C ended it.
    """

    total: int
    done: int
    failed: list[str] = field(default_factory=list)
    interrupted: bool = False


def run(
    folder: Folder,
    columns: Sequence[Column],
    variants: Sequence[Variant],
    grids: Mapping[Shape, Any],
    protocols: Sequence[str],
    *,
    command: str,
    tools: Tools,
    reporter: Reporter,
) -> Outcome:
    """Measure every cell that is not in the folder yet.

    Args:
        folder: Where rows and bounders go.
        columns: Selected.
        variants: Selected rows.
        grids: Selected objects, as read.
        protocols: Selected.
        command: The command line, to be remembered.
        tools: The library, or its stand-in.
        reporter: Told of each step.

    Returns:
        How it ended.

    Raises:
        BoundingError: If an object is not the one that was measured before, or the folder cannot be written to.
    """
    jobs, total = plan(columns, variants, list(grids), protocols, tools.supports, folder.rows)
    for shape in {j.shape for j in jobs}:
        _check_known(shape, grids[shape], folder)
    if jobs:
        folder.remember(command)
    outcome = Outcome(total, total - sum(len(j.protocols) for j in jobs))
    left = TimeLeft(jobs, folder.settings, {j.name for j in jobs if folder.bounder(j.name).exists()})
    reporter.begin(total, outcome.done, left)
    with interruptions() as interrupted:
        try:
            for job in jobs:
                reporter.start(job)
                _work(job, grids[job.shape], folder, tools, reporter, outcome, left, interrupted)
        except KeyboardInterrupt:
            outcome.interrupted = True
    return outcome


def _check_known(shape: Shape, grid: Any, folder: Folder) -> None:
    """Refuse an object that has changed since its other rows were measured."""
    known = {r.indicator for r in folder.rows.values() if (r.dimension, r.object) == (shape.ndim, shape.name)}
    if known - {grid.digest[:DIGEST]}:
        raise IndicatorError(f"{shape.path}: not the object that {folder.table} was measured on; choose another --out")


def _work(job, grid, folder, tools, reporter, outcome, left, interrupted) -> None:
    """One job: its rows, or a failure."""
    try:
        bounder, seconds, spent = _bounder(job, grid, folder, tools, reporter, interrupted)
        started, rates = time.perf_counter(), {}
        for protocol in job.protocols:
            s = folder.settings
            progress = _note(reporter, f"measuring, {protocol}")
            rates[protocol] = tools.evaluate(bounder, grid, s.samples, protocol, seed=s.sample_seed, progress=progress)
            if interrupted.is_set():
                raise KeyboardInterrupt
    except FileFormatError:  # the folder cannot be written to: no use going on
        raise
    except FAILURES as error:
        reason = reason_of(error)
        outcome.failed += [f"{job.title} ({p}): {reason}" for p in job.protocols]
        left.drop(job)
        reporter.fail(job, reason)
        return
    left.finish(job, spent, time.perf_counter() - started)
    for protocol in job.protocols:
        row = _row(job, protocol, grid, bounder, seconds, rates[protocol], folder)
        folder.append(row)
        outcome.done += 1
        reporter.row(row)


def _bounder(job, grid, folder, tools, reporter, interrupted) -> tuple[Any, float | None, float]:
    """The bounder of a job, the seconds that its fit took, and those that it took now."""
    s, path = folder.settings, folder.bounder(job.name)
    if path.exists():
        bounder = load_bounder(path, grid, s, tools, reporter.say)
        if bounder is not None:
            return bounder, _recorded(job, bounder, folder), 0.0
    started = time.perf_counter()
    last = _last(job, grid, folder, tools, reporter)
    bounder = fit_bounder(job, grid, s, tools, _note(reporter, "fitting"), last)
    seconds = time.perf_counter() - started
    if interrupted.is_set():
        raise KeyboardInterrupt
    tools.save(bounder, path)
    before = 0.0 if last is None else (last.info.get("training") or {}).get("seconds", 0.0)
    return bounder, seconds + before, seconds


def _last(job: Job, grid: Any, folder: Folder, tools: Tools, reporter) -> Any | None:
    """Of a cascade the last part, which is the same by itself, if this folder has it."""
    if job.variant.last == job.variant.method:
        return None
    path = folder.bounder(replace(job, variant=Variant(job.variant.last)).name)
    if not path.exists():
        return None
    return load_bounder(path, grid, folder.settings, tools, reporter.say)


def _recorded(job: Job, bounder: Any, folder: Folder) -> float | None:
    """Seconds that an earlier fit took: from its rows, or else as it says itself."""
    about = job.key("")[:-1]
    known = [r.fit_seconds for key, r in folder.rows.items() if key[:-1] == about and r.fit_seconds is not None]
    return known[0] if known else (bounder.info.get("training") or {}).get("seconds")


def _row(job: Job, protocol: str, grid: Any, bounder: Any, seconds: float | None, rates: Any, folder: Folder) -> Row:
    s, certificate = folder.settings, bounder.certificate
    return Row(
        dimension=job.shape.ndim,
        object=job.shape.name,
        query=job.column.query,
        method=job.variant.method,
        space=job.space,
        leaves=job.variant.leaves,
        protocol=protocol,
        fp_rate=float(rates.fp_rate),
        fn=int(rates.fn),
        positives=float(rates.positives),
        certificate=certificate.kind if certificate else "",
        fit_seconds=None if seconds is None else round(seconds, 3),
        proof_seconds=round(float(certificate.seconds), 3) if certificate else None,
        nbytes=int(bounder.nbytes),
        hidden="-".join(map(str, job.column.hidden)),
        activation=s.activation,
        budget=s.budget_of(job.column, job.variant),
        samples=s.samples,
        seed=s.seed,
        length=s.length,
        device=s.device,
        threads=cpu_threads(),
        indicator=grid.digest[:DIGEST],
        versions=versions(),
    )


def _note(reporter: Reporter, what: str):
    """A progress callback that says what is going on where the callee does not."""
    return lambda done, total=1.0, note="": reporter.within(done, total, f"{what}, {note}" if note else what)
