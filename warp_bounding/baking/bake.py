"""``bake``: a bounder for each shape of a folder, on many processes, resumable whatever is killed.

A task is a shape. What a task has done is on disk before anybody hears of it, under a name that is a hash of shape, settings and version, so a bake that
is started again does what is missing and nothing else. The client hands out at most ``WINDOW`` tasks at a time, tells of what has ended, and keeps the manifest current.
"""

import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from warp_bounding.baking.cluster import SchedulerError, check_workers, connected, dashboard, gone
from warp_bounding.baking.folder import BakeFolder
from warp_bounding.baking.manifest import write_manifest
from warp_bounding.baking.names import short_digest
from warp_bounding.baking.record import Record
from warp_bounding.baking.settings import SAMPLES, ChooseSettings, FitSettings, Settings
from warp_bounding.baking.shapes import Found, find_shapes, shape_digest
from warp_bounding.baking.task import Job, bake_shape
from warp_bounding.errors import BounderError, BoundingError
from warp_bounding.runtime.progress import Progress, reported

__all__ = ["LARGEST", "Baked", "bake", "bake_with"]

LARGEST = 500.0  # megabytes of a shape's file: reading one takes some ten times as much memory
WINDOW = 10_000  # tasks that the scheduler knows at a time
MANIFEST_SECONDS, MANIFEST_SHARE = (
    5.0,
    0.02,
)  # how often the manifest is written: not oftener, and not for a larger share of the time


@dataclass
class Baked:
    """What a bake has done.

    Attributes:
        folder: Where the results are.
        records: One for each shape of the folder, those that were there before included.
        baked: Shapes that this run baked.
        kept: Shapes that had been baked already.
        failed: Shapes with an error.
        foreign: Files of the folder that are no shapes.
        too_large: Files that were left out for their size.
        seconds: Of this run.
        task_seconds: Of all tasks of this run together.
        running_seconds: From the first task's start to the last one's end; without the start of workers.
        workers: How many threads of workers there were when the first task was handed out.

    Example:
        >>> wb.bake("no such folder", "bounders")
        Traceback (most recent call last):
        ...
        warp_bounding.errors.IndicatorError: no such folder: no such folder
    """

    folder: Path
    records: list[Record] = field(default_factory=list)
    baked: int = 0
    kept: int = 0
    failed: int = 0
    foreign: int = 0
    too_large: list[str] = field(default_factory=list)
    seconds: float = 0.0
    task_seconds: float = 0.0
    running_seconds: float = 0.0
    workers: int = 0


def bake(
    folder: str | Path,
    out: str | Path,
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    largest: float = LARGEST,
    samples: int = SAMPLES,
    queries: str | Path | None = None,
    reading: dict[str, Any] | None = None,
    progress: Progress | bool | None = None,
    **options,
) -> Baked:
    """Fit a bounder to each shape of a folder, on several processes, and keep them in another folder.

    The same call goes on where one that was stopped or killed has ended: what is there is not done again. In a script it must stand behind
    ``if __name__ == "__main__":``, because the workers import the script.

    Args:
        folder: With shapes of any kind that ``load_indicator`` reads, in folders inside, too.
        out: Where bounders, records, ``manifest.csv`` and ``contact-sheet.html`` go; ``BounderLibrary`` opens it.
        jobs: Worker processes of this machine; one a core if ``None``.
        scheduler: Address of a Dask scheduler, whose workers see both folders under the same paths; ``None`` for processes of this machine.
        largest: Megabytes; larger files are left out, and told.
        samples: Random queries of each shape that false positives are counted on.
        queries: A ``.npy`` file of queries as of ``fit`` and ``choose``, the same for all shapes.
        reading: Keyword arguments of ``load_indicator``.
        progress: Called with done, total and a note. ``None`` shows a bar on standard error if that is a terminal, ``False`` nothing.
        **options: Of ``fit`` for each shape, its ``budget`` and ``method`` among them; with ``narrow_ns`` those of ``choose``.

    Returns:
        What was done. A shape that could not be baked is a record with an error, and does not end the others.

    Raises:
        BoundingError: If there is nothing to bake, Dask is not installed, the folder cannot be written to, another bake has it, or the
            scheduler goes away.

    Example:
        >>> import os
        >>> os.makedirs("shapes"), np.save("shapes/ball.npy", ball)  # doctest: +ELLIPSIS
        (None, None)
        >>> done = wb.bake("shapes", "bounders", jobs=1, samples=1000, method="kdop", progress=False)
        >>> done.baked, done.failed, wb.BounderLibrary("bounders", device="cpu").names
        (1, 0, ['ball'])
    """
    kind = ChooseSettings if "narrow_ns" in options else FitSettings
    asked = None if queries is None else str(Path(queries).resolve())
    settings = kind(options, reading or {}, asked, samples)
    return bake_with(settings, folder, out, jobs=jobs, scheduler=scheduler, largest=largest, progress=progress)


def bake_with(
    settings: Settings,
    folder: str | Path,
    out: str | Path,
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    largest: float = LARGEST,
    progress: Progress | bool | None = None,
    tell: Callable[[str], None] = lambda text: None,
) -> Baked:
    """``bake`` with settings; ``tell`` is called with lines for people: the dashboard's link, and each error as it happens."""
    folder, out = Path(folder), Path(out)
    if jobs is not None and (isinstance(jobs, bool) or not isinstance(jobs, int) or jobs < 1):
        raise BounderError(f"jobs must be a whole number of at least 1, got {jobs!r}")
    if not largest > 0:
        raise BounderError(f"largest must be a positive number of megabytes, got {largest!r}")
    if folder.resolve() == out.resolve():
        raise BounderError(f"{out}: expected another folder than that of the shapes")
    settings.check(bake)
    started = time.perf_counter()
    found = find_shapes(folder, largest, out)
    kept = BakeFolder(out.resolve())
    with kept.locked(), reported(progress, "bake") as update:
        kept.clean()
        kept.keep_settings(settings)
        update = update or (lambda *told: None)
        update(0, 1, "what is there is read")
        state = _State(kept, folder, found, settings)
        try:
            if state.open:
                _run(state, jobs, scheduler, update, tell)
        finally:  # Ctrl-C, and whatever else ends it: what is there is listed
            state.done.seconds = time.perf_counter() - started
            state.done.records = list(state.records.values())
            kept.conclude(state.ready)
    return state.done


class _State:
    """What is done, what is open, and what the folder held before."""

    def __init__(self, kept: BakeFolder, folder: Path, found: Found, settings: Settings):
        self.kept = kept
        self.done = Baked(
            kept.path, foreign=found.foreign, too_large=[str(p.relative_to(folder)) for p in found.too_large]
        )
        self.records: dict[str, Record] = {}
        self.open: deque[Job] = deque()
        for job in _jobs(folder, found, settings, kept):
            if job.record.key in self.records:  # the same file twice, under the same name: one bounder is enough
                continue
            before = job.done()
            self.records[job.record.key] = before or job.record
            if before is None:
                self.open.append(job)
            else:
                self.done.kept += 1
        self.others = {r.key: r for r in kept.records() if r.key not in self.records}
        self.total = len(self.open)
        self._written, self._pause = time.perf_counter(), MANIFEST_SECONDS

    @property
    def ready(self) -> list[Record]:
        """Everything that the folder has, without shapes that are still open."""
        return [*self.others.values(), *(r for r in self.records.values() if r.method or r.error)]

    def ended(self, record: Record) -> None:
        """Count a shape, and write the manifest if it is time to."""
        self.records[record.key] = record
        self.done.task_seconds += record.seconds
        self.done.failed += bool(record.error)
        self.done.baked += not record.error
        now = time.perf_counter()
        if now - self._written > self._pause:
            write_manifest(self.kept.path, self.ready)
            self._written = time.perf_counter()
            self._pause = max(MANIFEST_SECONDS, (self._written - now) / MANIFEST_SHARE)


def _jobs(folder: Path, found: Found, settings: Settings, kept: BakeFolder) -> Iterator[Job]:
    about = settings.digest
    for path in found.shapes:
        try:
            digest = shape_digest(path)
        except OSError:
            digest = "unreadable"  # the task finds out why
        record = Record(path.stem, str(path.relative_to(folder)), short_digest([digest, about]), about)
        yield Job(str(path.resolve()), str(kept.path), record, settings)


def _run(state: _State, jobs: int | None, scheduler: str | None, update: Progress, tell: Callable[[str], None]) -> None:
    """Hand out the open jobs until there are none."""
    update(0, state.total, "workers start")
    with connected(jobs, scheduler) as client:
        import distributed

        if link := dashboard(client):
            tell(f"dashboard: {link}")
        check_workers(client, [state.kept.path, Path(state.open[0].path).parent])
        clock, state.done.workers = _Clock(state.total), sum(client.nthreads().values())
        futures: dict[Any, Job] = {}
        running = distributed.as_completed()

        def hand_out() -> None:
            batch = [state.open.popleft() for _ in range(min(WINDOW - len(futures), len(state.open)))]
            keys = [f"bake-{job.record.key}" for job in batch]
            for future, job in zip(client.map(bake_shape, batch, key=keys, pure=False), batch, strict=True):
                futures[future.key] = job
                running.add(future)

        hand_out()
        while futures:
            future = next(running)
            job = futures.pop(future.key)
            record = _outcome(future, job, client, state.kept)
            del future  # else Dask would do it again if the worker that has its result died
            state.ended(record)
            if record.error:
                tell(f"{record.source}: {record.error}")
            state.done.running_seconds = clock.seconds
            update(state.total - len(state.open) - len(futures), state.total, clock.note(state.done))
            if len(state.open) and len(futures) < WINDOW // 2:
                hand_out()


def _outcome(future, job: Job, client, kept: BakeFolder) -> Record:
    """What became of a task: a record, or an error that ends the bake."""
    import distributed

    if future.status == "finished":
        return Record(**future.result())
    error = future.exception() if future.status == "error" else None
    if isinstance(error, distributed.KilledWorker):
        record = replace(job.record, error="every worker that fitted it died (killed, out of memory, or a crash)")
        record.write(kept.record_path(record))
        return record
    if isinstance(error, BoundingError):
        raise error  # the folder cannot be written to
    if error is not None:
        raise SchedulerError(f"a task failed: {type(error).__name__}: {' '.join(str(error).split())}")
    raise gone(client)


class _Clock:
    """How long the rest may take, by what has ended so far."""

    def __init__(self, total: int):
        self._started, self._total = time.perf_counter(), total

    @property
    def seconds(self) -> float:
        """Since the first task was handed out."""
        return time.perf_counter() - self._started

    def note(self, done: Baked) -> str:
        """Counts and the time that is left."""
        ended = done.baked + done.failed
        left = self.seconds / ended * (self._total - ended)
        failed = f", {done.failed} failed" if done.failed else ""
        return f"{ended:,} of {self._total:,} shapes{failed}, {_told(left)} left"


def _told(seconds: float) -> str:
    """A time in words that a person reads at a glance."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 120 else f"{minutes // 60} h {minutes % 60:02d} min"
