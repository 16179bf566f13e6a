"""A resumable run: fit, save, measure, write a row at once; what is in the folder is not done again.

A fit that fails is reported at the end and the others go on. An interruption is never taken for a result: Ctrl-C makes
``fit`` end its training early and return what it has, which is thrown away here.
"""

import contextlib
import platform
import signal
import subprocess
import threading
import time
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from paper.columns import DISTANCE_STEPS, Variant
from paper.folder import Folder
from paper.plan import KDOP_SECONDS, Job, Selection, TimeLeft, plan
from paper.rows import Line
from paper.shapes import Shape
from warp_bounding.bounders import METHODS, DistanceBounder
from warp_bounding.bounders.bounder import taken
from warp_bounding.certificates.claim import as_fitted
from warp_bounding.errors import BoundingError, FileFormatError, IndicatorError
from warp_bounding.queries.distance import DISTANCE, METRICS
from warp_bounding.runtime.launch import cpu_threads
from warp_bounding.version import __version__

__all__ = ["Outcome", "Run", "TableRun", "interruptions", "reason_of", "versions"]

DIGEST = 16  # characters of the SHA-256 of an object's cells


@dataclass
class Outcome:
    """How a run ended."""

    total: int  # cells that were asked for
    done: int  # cells that are in the table
    failed: list[str] = field(default_factory=list)  # a line for each cell whose fit or measurement failed
    interrupted: bool = False  # by Ctrl-C


class Run(ABC):
    """What the runs that fit bounders have in common.

    Attributes:
        jobs: What is missing in the folder.
        outcome: So far.
    """

    def __init__(self, folder: Folder, selection: Selection, grids: Mapping[Shape, Any], reporter: Any):
        """Find out which cells of a selection are missing.

        Args:
            folder: Where rows and bounders go.
            selection: What is to be in it.
            grids: Its objects, as read.
            reporter: Told of each step: has ``begin``, ``start``, ``within``, ``row`` and ``say``.

        Raises:
            BoundingError: If there is nothing to do at all, or an object is not the one that was measured before.
        """
        self.jobs, total = plan(selection, folder.rows)
        for shape in {j.shape for j in self.jobs}:
            known = {r.indicator for r in folder.rows.values() if (r.dimension, r.object) == (shape.ndim, shape.name)}
            if known - {grids[shape].digest[:DIGEST]}:
                raise IndicatorError(
                    f"{shape.path}: not the object that {folder.table} was measured on; choose another --out"
                )
        self.folder, self.reporter, self._grids = folder, reporter, grids
        self.outcome = Outcome(total, total - sum(len(j.protocols) for j in self.jobs))
        self._interrupted = threading.Event()

    @abstractmethod
    def measure(self, job: Job, grid: Any) -> None:
        """Do one job; a failure may be any exception."""

    def cells(self, job: Job) -> list[str]:
        """The cells of a job, for people."""
        return [job.title]

    def fail(self, job: Job, reason: str) -> None:
        """Note that a job has failed."""
        self.outcome.failed += [f"{cell}: {reason}" for cell in self.cells(job)]
        self.reporter.say(f"failed: {job.title}: {reason}")

    def go(self, command: str) -> Outcome:
        """Do all jobs.

        Args:
            command: The command line, to be remembered.

        Raises:
            BoundingError: If the folder cannot be written to: it is no use going on then.
        """
        self.reporter.begin(self)
        if self.jobs:
            self.folder.remember(command)
        with interruptions(self._interrupted):
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
            self.fail(job, reason_of(error))

    def add(self, job: Job, bounder: Any, **measured: Any) -> None:
        """Write a row: what was measured, and what the job, the bounder and the settings say."""
        certificate = bounder.certificate
        row: Line = self.folder.kind(
            dimension=job.shape.ndim,
            object=job.shape.name,
            query=job.column.query,
            method=job.variant.method,
            certificate=certificate.kind if certificate else "",
            threads=cpu_threads(),
            indicator=self._grids[job.shape].digest[:DIGEST],
            versions=versions(),
            **self.folder.settings.of_row(job.column, job.variant),
            **measured,
        )
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
        fitted = as_fitted(bounder, grid) if isinstance(bounder, DistanceBounder) else grid
        if (bounder.info.get("indicator"), bounder.info.get("seed")) == (fitted.digest, settings.seed):
            return bounder
        self.reporter.say(f"{path}: fitted to another object or with another seed; fitted again")
        return None

    def fit(self, job: Job, grid: Any, progress: Callable[..., None], last: Any | None = None) -> Any:
        """Fit the bounder of a job, a cascade's from its ``last`` part, and keep it; this imports torch."""
        from warp_bounding import training
        from warp_bounding.bounders import save

        settings, query, made = self.folder.settings.fits, job.column.kind, job.variant.fitted
        method, hidden = made.method, tuple(width // made.narrower for width in job.column.hidden)
        told = {"hidden": hidden, "activation": settings.activation, "leaves": job.variant.leaves}
        of_distances, about = job.variant.of_distances, {"query": query.name, "method": method}
        if of_distances:
            known = [option.name for option in of_distances.options_taken()]
            about = {"query": DISTANCE.name, "method": of_distances.method, "metric": METRICS[1]}
        else:
            known = taken((METHODS[name] for name in method.split("+")), query.name)
        options = {name: value for name, value in told.items() if name in known and value is not None} | made.options
        if not of_distances:
            options |= {"last": last} if last is not None else {}
            options |= {"length": settings.length} if query.has_length else {}
        maker = getattr(training, made.by)
        about |= {"budget": settings.budget_of(job.column, job.variant), "seed": settings.seed}
        bounder = maker(grid, **about, device=settings.device, progress=progress, **options)
        self.heed()
        save(bounder, self.folder.bounder(job.file))
        return bounder


@contextlib.contextmanager
def interruptions(event: threading.Event) -> Iterator[None]:
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


def reason_of(error: BaseException) -> str:
    """A failure in one line; of what is no error of ours, also its type and where it was raised."""
    reason = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, BoundingError):
        return reason
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {reason}{where}"


class TableRun(Run):
    """Measures cells of Table 1.

    Attributes:
        left: How long the rest will take.
    """

    def __init__(self, *inputs):
        super().__init__(*inputs)
        self.left = TimeLeft(self.jobs, self.folder.settings, self.folder.fitted)

    def measure(self, job: Job, grid: Any) -> None:
        from paper.parametric import volumes
        from warp_bounding.evaluation import evaluate

        s = self.folder.settings
        bounder, seconds, spent = self._parametric(job, grid) if job.variant.parametric else self._bounder(job, grid)
        started, found = time.perf_counter(), {}
        for protocol in job.protocols:
            about = {"seed": s.sample_seed, "progress": self._note(f"measuring, {protocol}")}
            if job.variant.parametric:
                found[protocol] = volumes.rates(bounder, grid, s.samples, protocol, **about, device=s.device)
            else:
                found[protocol] = evaluate(bounder, grid, s.samples, protocol, **about, **self._asked(job))
            self.heed()
        self.left.finish(job, spent, time.perf_counter() - started)
        about = {
            "space": job.space,
            "leaves": job.variant.leaves,
            "fit_seconds": None if seconds is None else round(seconds, 3),
            "proof_seconds": round(float(bounder.certificate.seconds), 3) if bounder.certificate else None,
            "nbytes": int(bounder.nbytes),
        }
        for protocol, rates in found.items():
            measured = {"fp_rate": float(rates.fp_rate), "fn": int(rates.fn), "positives": float(rates.positives)}
            self.add(job, bounder, protocol=protocol, **measured, **about)

    def cells(self, job: Job) -> list[str]:
        return [f"{job.title} ({protocol})" for protocol in job.protocols]

    def fail(self, job: Job, reason: str) -> None:
        self.left.drop(job)
        super().fail(job, reason)

    def _bounder(self, job: Job, grid: Any) -> tuple[Any, float | None, float]:
        """The bounder of a job, the seconds that its fit took, and those that it took now."""
        bounder = self.load(self.folder.bounder(job.file), grid)
        if bounder is not None:  # its seconds are those of its rows, or else what it says itself
            about, rows = job.key("")[:-1], self.folder.rows.items()
            known = [r.fit_seconds for key, r in rows if key[:-1] == about and r.fit_seconds is not None]
            return bounder, known[0] if known else (bounder.info.get("training") or {}).get("seconds"), 0.0
        started, last = time.perf_counter(), None
        if job.variant.last != job.variant.method:  # the last part of a cascade is the same by itself, if it is there
            last = self.load(self.folder.bounder(replace(job, variant=Variant(job.variant.last)).file), grid)
        bounder = self.fit(job, grid, self._note("fitting"), last)
        seconds = time.perf_counter() - started
        before = 0.0 if last is None else (last.info.get("training") or {}).get("seconds", 0.0)
        return bounder, seconds + before, seconds

    def _parametric(self, job: Job, grid: Any) -> tuple[Any, float, float]:
        """The volume around the numbers of regions of a job, which no file keeps, and the seconds that its fit took."""
        from paper.parametric.volumes import fit

        s, started = self.folder.settings, time.perf_counter()
        seconds = min(s.budget_of(job.column, job.variant), KDOP_SECONDS) if job.variant.learned else 0.0
        volume = fit(grid, job.column.query, job.variant.method, length=s.length, seed=s.seed, seconds=seconds)
        self.heed()
        return volume, *[time.perf_counter() - started] * 2

    def _asked(self, job: Job) -> dict[str, Any]:
        """What a bounder of distances is asked; others have one kind of query."""
        if not job.variant.of_distances:
            return {}
        query, kind = job.column.query, job.column.kind
        length = {"length": self.folder.settings.length} if kind.has_length else {}
        steps = {"steps": DISTANCE_STEPS[query]} if query in DISTANCE_STEPS else {}
        return {"query": query} | length | steps

    def _note(self, what: str) -> Callable[..., None]:
        """A progress callback that says what is going on where the callee does not."""
        return lambda done, total=1.0, note="": self.reporter.within(f"{what}, {note}" if note else what)


@cache
def versions() -> str:
    """Versions of this library (with its commit, where it is run from a checkout) and of what it stands on."""
    root, commit = Path(__file__).parents[2], ""
    if (root / ".git").exists():
        git = ["git", "rev-parse", "--short=9", "HEAD"]
        with contextlib.suppress(OSError, subprocess.SubprocessError):  # no git there
            found = subprocess.run(git, cwd=root, capture_output=True, text=True, timeout=10, check=True)
            commit = f" ({found.stdout.strip()})"

    def version(package: str) -> str:
        try:
            return metadata.version(package)
        except metadata.PackageNotFoundError:
            return "none"

    own = f"warp-bounding {__version__}{commit}, warp {version('warp-lang')}, torch {version('torch')}"
    return f"{own}, Python {platform.python_version()}"
