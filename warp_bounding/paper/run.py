"""A resumable run: fit, save, measure, write a row at once; what is in the folder is not done again.

A fit that fails is reported at the end and the others go on. An interruption is never taken for a result: Ctrl-C makes
``fit`` end its training early and return what it has, which is thrown away here.
"""

import contextlib
import signal
import threading
import time
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from warp_bounding.bounders import METHODS
from warp_bounding.bounders.options import taken
from warp_bounding.errors import BoundingError, FileFormatError, IndicatorError
from warp_bounding.paper.columns import Column, Variant
from warp_bounding.paper.folder import Folder
from warp_bounding.paper.plan import Job, TimeLeft, plan
from warp_bounding.paper.rows import Row
from warp_bounding.paper.shapes import Shape
from warp_bounding.paper.versions import versions
from warp_bounding.runtime.launch import cpu_threads

__all__ = ["DIGEST", "Outcome", "Run", "run"]

DIGEST = 16  # characters of the SHA-256 of an object's cells


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


class Run(ABC):
    """What the runs that fit bounders have in common.

    Attributes:
        folder: Where rows and bounders go.
        jobs: What is missing in it.
        outcome: So far.
    """

    def __init__(self, folder: Folder, grids: Mapping[Shape, Any], jobs: Sequence[Job], total: int, reporter: Any):
        """Begin.

        Args:
            folder: Where rows and bounders go.
            grids: Objects, as read.
            jobs: What is missing in the folder.
            total: Cells in all.
            reporter: Told of each step; has ``start``, ``row`` and ``say``.
        """
        self.folder, self.jobs, self.reporter, self._grids = folder, jobs, reporter, grids
        self.outcome = Outcome(total, total - sum(len(j.protocols) for j in jobs))
        self._interrupted = threading.Event()

    @abstractmethod
    def measure(self, job: Job, grid: Any) -> None:
        """Do one job; a failure may be any exception."""

    @abstractmethod
    def fail(self, job: Job, reason: str) -> None:
        """Note that a job has failed."""

    def go(self, command: str) -> Outcome:
        """Do all jobs.

        Args:
            command: The command line, to be remembered.

        Raises:
            BoundingError: If the folder cannot be written to: it is no use going on then.
        """
        if self.jobs:
            self.folder.remember(command)
        with _interruptions(self._interrupted):
            try:
                for job in self.jobs:
                    self.reporter.start(job)
                    self._try(job)
            except KeyboardInterrupt:
                self.outcome.interrupted = True
        return self.outcome

    def _try(self, job: Job) -> None:
        try:
            self.measure(job, self._grids[job.shape])
        except FileFormatError:
            raise
        except Exception as error:  # whatever ends one cell of a long run is reported, and the others go on
            self.fail(job, _reason(error))

    def add(self, row: Any) -> None:
        """Write a row."""
        self.folder.append(row)
        self.outcome.done += 1
        self.reporter.row(row)

    def heed(self) -> None:
        """End the run if it was interrupted: a callee may have swallowed that, and returned early."""
        if self._interrupted.is_set():
            raise KeyboardInterrupt

    def load(self, path: Path, grid: Any) -> Any | None:
        """The bounder that an earlier run fitted, unless there is none, or it is damaged or of something else; then people are told."""
        from warp_bounding.bounders import load

        if not path.exists():
            return None
        settings = self.folder.settings.fits
        try:
            bounder = load(path, device=settings.device)
        except BoundingError as error:
            self.reporter.say(f"{error}; fitted again")
            return None
        if (bounder.info.get("indicator"), bounder.info.get("seed")) == (grid.digest, settings.seed):
            return bounder
        self.reporter.say(f"{path}: fitted to another object or with another seed; fitted again")
        return None

    def fit(self, job: Job, grid: Any, progress: Callable[..., None], last: Any | None = None) -> Any:
        """Fit the bounder of a job, a cascade's from its ``last`` part, and keep it; this imports torch."""
        from warp_bounding.bounders import save
        from warp_bounding.training import fit

        settings, method, query = self.folder.settings.fits, job.variant.method, job.column.kind
        told = {"hidden": job.column.hidden, "activation": settings.activation, "leaves": job.variant.leaves}
        known = taken((METHODS[name] for name in method.split("+")), query.name)
        options = {name: value for name, value in told.items() if name in known and value is not None}
        options |= {"last": last} if last is not None else {}
        options |= {"length": settings.length} if query.has_length else {}
        options |= {"space": job.space} if query.is_region else {}
        about = {"query": query.name, "method": method, "budget": settings.budget_of(job.column, job.variant)}
        bounder = fit(grid, **about, seed=settings.seed, device=settings.device, progress=progress, **options)
        self.heed()
        save(bounder, self.folder.bounder(job.name))
        return bounder


@contextlib.contextmanager
def _interruptions(event: threading.Event) -> Iterator[None]:
    """Ctrl-C sets an event, besides raising ``KeyboardInterrupt``."""
    unheard = signal.getsignal(signal.SIGINT) == signal.SIG_IGN  # as in a shell's background jobs
    if unheard or threading.current_thread() is not threading.main_thread():
        yield
        return

    def handler(number, frame):
        event.set()
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _reason(error: BaseException) -> str:
    """A failure in one line; of what is no error of ours, also its type and where it was raised."""
    reason = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, BoundingError):
        return reason
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {reason}{where}"


def run(
    folder: Folder,
    columns: Sequence[Column],
    variants: Sequence[Variant],
    grids: Mapping[Shape, Any],
    protocols: Sequence[str],
    *,
    command: str,
    reporter: Any,
) -> Outcome:
    """Measure every cell of Table 1 that is not in the folder yet.

    Args:
        folder: Where rows and bounders go.
        columns: Selected.
        variants: Selected rows.
        grids: Selected objects, as read.
        protocols: Selected.
        command: The command line, to be remembered.
        reporter: Told of each step, such as the command line's.

    Raises:
        BoundingError: If an object is not the one that was measured before, or the folder cannot be written to.
    """
    from warp_bounding.bounders import supports

    jobs, total = plan(columns, variants, list(grids), protocols, supports, folder.rows)
    for shape in {j.shape for j in jobs}:
        known = {r.indicator for r in folder.rows.values() if (r.dimension, r.object) == (shape.ndim, shape.name)}
        if known - {grids[shape].digest[:DIGEST]}:
            raise IndicatorError(
                f"{shape.path}: not the object that {folder.table} was measured on; choose another --out"
            )
    table = _Table(folder, grids, jobs, total, reporter)
    reporter.begin(total, table.outcome.done, table.left)
    return table.go(command)


class _Table(Run):
    """Table 1.

    Attributes:
        left: How long the rest will take.
    """

    def __init__(self, *inputs):
        super().__init__(*inputs)
        fitted = {j.name for j in self.jobs if self.folder.bounder(j.name).exists()}
        self.left = TimeLeft(self.jobs, self.folder.settings, fitted)

    def measure(self, job: Job, grid: Any) -> None:
        from warp_bounding.evaluation import evaluate

        s = self.folder.settings
        bounder, seconds, spent = self._bounder(job, grid)
        started, rates = time.perf_counter(), {}
        for protocol in job.protocols:
            progress = self._note(f"measuring, {protocol}")
            rates[protocol] = evaluate(bounder, grid, s.samples, protocol, seed=s.sample_seed, progress=progress)
            self.heed()
        self.left.finish(job, spent, time.perf_counter() - started)
        for protocol in job.protocols:
            self.add(_row(job, protocol, grid, bounder, seconds, rates[protocol], s))

    def fail(self, job: Job, reason: str) -> None:
        self.outcome.failed += [f"{job.title} ({p}): {reason}" for p in job.protocols]
        self.left.drop(job)
        self.reporter.fail(job, reason)

    def _bounder(self, job: Job, grid: Any) -> tuple[Any, float | None, float]:
        """The bounder of a job, the seconds that its fit took, and those that it took now."""
        bounder = self.load(self.folder.bounder(job.name), grid)
        if bounder is not None:
            return bounder, self._recorded(job, bounder), 0.0
        started, last = time.perf_counter(), None
        if job.variant.last != job.variant.method:  # the last part of a cascade is the same by itself, if it is there
            last = self.load(self.folder.bounder(replace(job, variant=Variant(job.variant.last)).name), grid)
        bounder = self.fit(job, grid, self._note("fitting"), last)
        seconds = time.perf_counter() - started
        before = 0.0 if last is None else (last.info.get("training") or {}).get("seconds", 0.0)
        return bounder, seconds + before, seconds

    def _recorded(self, job: Job, bounder: Any) -> float | None:
        """Seconds that an earlier fit took: from its rows, or else as it says itself."""
        about, rows = job.key("")[:-1], self.folder.rows.items()
        known = [r.fit_seconds for key, r in rows if key[:-1] == about and r.fit_seconds is not None]
        return known[0] if known else (bounder.info.get("training") or {}).get("seconds")

    def _note(self, what: str) -> Callable[..., None]:
        """A progress callback that says what is going on where the callee does not."""
        return lambda done, total=1.0, note="": self.reporter.within(f"{what}, {note}" if note else what)


def _row(job: Job, protocol: str, grid: Any, bounder: Any, seconds: float | None, rates: Any, s: Any) -> Row:
    certificate = bounder.certificate
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
