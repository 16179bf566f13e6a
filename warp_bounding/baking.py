"""``bake``: a bounder for each shape of a folder, on many processes, and the folder as a mapping, ``BounderLibrary``.

What is finished is not done again. A task is a shape. The worker itself writes the bounder, then a record of what is
known of it, each whole or not at all, under a name that is a hash of shape, settings and version. Whatever is wrong
with a shape becomes a record with an error. The manifest is made of the records. Workers are processes of this machine,
with one thread each, or those of any Dask scheduler.
"""

import contextlib
import csv
import hashlib
import io
import json
import os
import re
import time
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from inspect import signature
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from warp_bounding.bounders import Bounder, load
from warp_bounding.errors import BounderError, BoundingError, BoundingWarning, FileFormatError, ShapeError
from warp_bounding.runtime.arrays import Picklable
from warp_bounding.runtime.progress import Progress, quiet_warp, reported
from warp_bounding.runtime.whole_file import BOUNDER, check_writable, file_path, write_whole
from warp_bounding.runtime.workers import ONE_THREAD, connected
from warp_bounding.shapes import load_shape
from warp_bounding.shapes.formats.load import READERS
from warp_bounding.shapes.formats.meshes import referred_buffers
from warp_bounding.shapes.formats.usd import USD_SUFFIXES
from warp_bounding.version import __version__

__all__ = ["Baked", "BounderLibrary", "bake"]

SAMPLES = 100_000  # random queries of a shape that false positives are counted on
MANIFEST, RECORDS = "manifest.csv", "records"  # in the folder of a bake
HASH_DIGITS = 12  # hexadecimal: two of 10^5 shapes share them with a probability of 2e-5
KEY = re.compile(rf"(.+)-([0-9a-f]{{{HASH_DIGITS}}})")  # name-hash, of a baked file

# --- what is known of a shape, and the folder of a bake ---------------------------------------------------------------


@dataclass(frozen=True)
class Record:
    """What is known of one shape under one set of settings, kept as a file of its own in the folder of a bake."""

    name: str  # the shape's file without its extension
    source: str  # its path, relative to the folder that was baked
    hash: str  # of shape, settings and version
    settings: str  # hash of the settings alone
    file: str = ""  # the bounder's, in the folder of the bake; empty where there is none
    method: str = ""  # "none" where a choice said that none pays; empty after an error
    query: str = ""  # the kind of query that the bounder answers
    bytes: int = 0  # that one query can read (``Bounder.nbytes``)
    certificate: str = ""  # its kind; empty where there is none
    fp_rate: float | None = None  # false positives, per cent of the samples; ``None`` where they were not counted
    seconds: float = 0.0  # that the task took, all in all
    error: str = ""  # why there is no bounder, in one line
    note: str = ""  # what the library warned of, in one line

    @classmethod
    def read(cls, path: Path) -> "Record | None":
        """The record of a file; ``None`` if there is none, and the shape is then baked anew."""
        try:
            return cls(**json.loads(path.read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError):
            return None

    @classmethod
    def all_of(cls, folder: Path) -> "list[Record]":
        """Those in the folder of a bake, by source."""
        found = filter(None, map(cls.read, (folder / RECORDS).glob("*.json")))
        return sorted(found, key=lambda record: (record.source, record.settings, record.hash))


class BounderLibrary(Picklable, Mapping):
    """The bounders of a folder, by name.

    A name is that of the shape's file without its extension; where several bounders have it (of other settings, or of
    shapes in other folders), each is called ``name-hash``. What is listed is what lies in the folder when the library
    is made: files are whole or not there, so a bake may still be running.

    Args:
        folder: That ``bake`` wrote, or any other with bounders' files.
        device: Warp device of the bounders; the default device if ``None``.

    Raises:
        FileFormatError: If there is no such folder.

    Example:
        >>> bounder.save("bounders/ball.safetensors")
        >>> library = wb.baking.BounderLibrary("bounders", device="cpu")
        >>> library.names, len(library), "ball" in library
        (['ball'], 1, True)
        >>> library["ball"].certificate.proven
        True
    """

    def __init__(self, folder, device: str | None = None):
        self.folder = file_path(folder)
        if not self.folder.is_dir():
            is_what = "a file, expected a folder of bounders" if self.folder.exists() else "no such folder"
            raise FileFormatError(f"{self.folder}: {is_what}")
        self.device = device
        keys = sorted(file.stem for file in self.folder.glob(f"*{BOUNDER}") if not file.name.startswith("."))
        names = {key: found[1] if (found := KEY.fullmatch(key)) else key for key in keys}
        count = Counter(names.values())
        self._keys = {key if count[name] > 1 else name: key for key, name in names.items()}
        self._loaded: dict[str, Bounder] = {}

    @property
    def names(self) -> list[str]:
        """All names, sorted.

        Example:
            >>> bounder.save("bounders/ball.safetensors")
            >>> wb.baking.BounderLibrary("bounders").names
            ['ball']
        """
        return list(self._keys)

    def path(self, name: str) -> Path:
        """The file of a bounder; raises ``KeyError`` for no name.

        Example:
            >>> bounder.save("bounders/ball.safetensors")
            >>> wb.baking.BounderLibrary("bounders").path("ball").name
            'ball.safetensors'
        """
        return self.folder / f"{self._keys[name]}{BOUNDER}"

    def __getitem__(self, name: str) -> Bounder:
        if name not in self._loaded:
            self._loaded[name] = load(self.path(name), self.device)
        return self._loaded[name]

    def __contains__(self, name: object) -> bool:
        return name in self._keys  # without loading it

    def __iter__(self) -> Iterator[str]:
        return iter(self._keys)

    def __len__(self) -> int:
        return len(self._keys)

    @cached_property
    def manifest(self) -> list[dict[str, Any]]:
        """A row for each shape that was baked, those with an error too; fields as in ``library.Record``.

        Example:
            >>> bounder.save("bounders/ball.safetensors")
            >>> wb.baking.BounderLibrary("bounders").manifest  # of a folder that no bake wrote
            []
        """
        return [asdict(record) for record in Record.all_of(self.folder)]

    def __repr__(self) -> str:
        return f"<library of {len(self)} bounders in {self.folder}>"


# --- settings and jobs -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Settings:
    """How each shape is baked: a method is fitted to all of them, or a bounder is chosen for each."""

    arguments: Mapping[str, Any]  # of ``fit``, or with ``narrow_ns`` of ``choose``
    reading: Mapping[str, Any]  # keyword arguments of ``load_shape``
    workload: str | None  # a .npy file of the caller's own queries, absolute, which every worker can read
    samples: int  # random queries that false positives are counted on

    def bounder(self, shape):
        """Make the bounder of a shape; ``None`` where none is the best choice. Raises as ``fit`` and ``choose`` do."""
        import warp_bounding

        name = "choose" if "narrow_ns" in self.arguments else "fit"
        function = getattr(warp_bounding, name)
        try:
            signature(function).bind(shape, **self.arguments)
            workload = None if self.workload is None else np.load(self.workload, allow_pickle=False)
        except (TypeError, OSError, ValueError) as error:
            raise BounderError(f"{name}: {error}") from error
        found = function(shape, workload=workload, progress=False, **self.arguments)
        return found if name == "fit" else found.bounder

    @property
    def digest(self) -> str:
        """Of all that makes a difference to what is baked; of a file of queries its content."""
        queried = None if self.workload is None else hashlib.sha256(Path(self.workload).read_bytes()).hexdigest()
        try:
            return short_digest([__version__, dict(self.arguments), dict(self.reading), queried, self.samples])
        except (TypeError, ValueError) as error:
            raise BounderError(f"options of a bake must be numbers, texts and lists of them: {error}") from error


class Job(NamedTuple):
    """One shape to bake."""

    path: str  # the shape's file, absolute
    out: Path  # the folder of the bake, absolute
    record: Record  # what is known of it before
    settings: Settings

    @property
    def key(self) -> str:
        """The stem of its files."""
        return f"{self.record.name}-{self.record.hash}"

    def done(self) -> Record | None:
        """Its record, if it was baked without an error and its bounder is there; else ``None``."""
        record = Record.read(self.out / RECORDS / f"{self.key}.json")
        finished = record and not record.error and (not record.file or (self.out / record.file).exists())
        return record if finished else None

    def end(self, record: Record) -> Record:
        """Write its record, whole or not at all; raises ``FileFormatError`` if it cannot be written."""
        write_whole(self.out / RECORDS / f"{self.key}.json", json.dumps(asdict(record), indent=1).encode())
        return record


def jobs_of(folder: Path, out: Path, settings: Settings) -> tuple[list[Job], int]:
    """A job for each file of a folder, folders inside it included, whose extension ``load_shape`` reads.

    Hidden folders and ``out`` are left out. Returns also the number of files of other kinds. Raises ``ShapeError`` if
    there is no such folder, or no shape in it.
    """
    if not folder.is_dir():
        raise ShapeError(f"{folder}: {'a file, expected a folder' if folder.exists() else 'no such folder'}")
    jobs, foreign, about, out = {}, 0, settings.digest, out.resolve()
    for where, folders, names in os.walk(folder):
        inside = Path(where)
        folders[:] = sorted(f for f in folders if not f.startswith(".") and (inside / f).resolve() != out)
        for path in (inside / name for name in sorted(names) if not name.startswith(".")):
            if not path.is_file() or path.suffix.lower() not in READERS:
                foreign += path.is_file()
                continue
            own = short_digest([shape_digest(path), about])
            job = Job(str(path.resolve()), out, Record(path.stem, str(path.relative_to(folder)), own, about), settings)
            jobs[job.key] = job  # the same file under the same name twice is one
    if not jobs:
        expected = f"expected files of {' '.join(READERS)}; got {foreign} of other kinds"
        raise ShapeError(f"{folder}: no shapes, {expected}")
    return list(jobs.values()), foreign


def short_digest(value: Any) -> str:
    """``HASH_DIGITS`` hexadecimal digits of what is JSON-ready."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:HASH_DIGITS]


def shape_digest(path: Path) -> str:
    """SHA-256 of all bytes that a shape is read from: the file's, and of files that a glTF or USD file refers to."""
    others, suffix = set(), path.suffix.lower()
    if suffix == ".gltf":
        with contextlib.suppress(OSError, ValueError, AttributeError, TypeError):  # the task says what is damaged
            others = referred_buffers(path)
    if suffix in USD_SUFFIXES:
        with contextlib.suppress(ImportError):  # the task says what is not installed
            from pxr import Tf, UsdUtils

            with contextlib.suppress(Tf.ErrorException):
                layers = UsdUtils.ComputeAllDependencies(str(path))[0]
                others = {Path(layer.realPath) for layer in layers if layer.realPath} - {path.resolve()}
    sha = hashlib.sha256(suffix.encode())
    for file in (path, *sorted(others)):
        with contextlib.suppress(OSError):  # the task finds out why
            sha.update(hashlib.sha256(file.read_bytes()).digest())
    return sha.hexdigest()


# --- what a worker does ----------------------------------------------------------------------------------------------


def bake_shape(job: Job) -> Record:
    """Bake one shape, unless that has been done: Dask repeats tasks whose results were lost when a worker died.

    Returns the record. Raises ``FileFormatError`` if the folder cannot be written to.
    """
    if (record := job.done()) is None:
        started = time.perf_counter()
        os.environ.update(ONE_THREAD)
        quiet_warp()
        bounder, record = _made(job)
        if bounder is not None:
            record = replace(record, file=f"{job.key}{BOUNDER}")
            bounder.save(job.out / record.file)
        record = job.end(replace(record, seconds=round(time.perf_counter() - started, 3)))
    return record


def _made(job: Job) -> tuple[Any, Record]:
    """The bounder, or ``None``, and what is known of it before it is written."""
    from warp_bounding.evaluation import evaluate

    settings, record = job.settings, job.record
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", BoundingWarning)
        try:
            shape = load_shape(job.path, **settings.reading)
            bounder = settings.bounder(shape)
            if bounder is None:
                return None, replace(record, method="none", note="no bounder pays")
            rates = evaluate(bounder, shape, samples=settings.samples)
        except Exception as error:  # whatever a file makes a reader, a fit or a proof do: the others go on
            text = " ".join(str(error).split()).removeprefix(f"{job.path}: ")
            known = isinstance(error, BoundingError) and text
            return None, replace(record, error=text if known else f"{type(error).__name__}: {text}".rstrip(": "))
    notes = dict.fromkeys(" ".join(str(w.message).split()) for w in caught if issubclass(w.category, BoundingWarning))
    found = {"method": bounder.method, "query": bounder.query_kind, "bytes": bounder.nbytes, "note": "; ".join(notes)}
    found |= {"certificate": bounder.certificate.kind if bounder.certificate else ""}
    return bounder, replace(record, fp_rate=round(rates.fp_rate, 4), **found)


# --- the folder of a bake --------------------------------------------------------------------------------------------


def write_manifest(out: Path, records: list[Record]) -> None:
    """Write a row for each record, for people and their spreadsheets."""
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, [each.name for each in fields(Record)])
    writer.writeheader()
    writer.writerows(map(asdict, records))
    write_whole(out / MANIFEST, text.getvalue().encode())


# --- the client ------------------------------------------------------------------------------------------------------


@dataclass
class Baked:
    """What a bake has done.

    Example:
        >>> wb.baking.bake("no such folder", "bounders")
        Traceback (most recent call last):
        ...
        warp_bounding.errors.ShapeError: no such folder: no such folder
    """

    folder: Path  #: Where the results are
    records: list[Record] = field(default_factory=list)  #: One for each shape, those that were there before included
    baked: int = 0  #: Shapes that this run baked
    kept: int = 0  #: Shapes that had been baked already
    failed: int = 0  #: Shapes with an error
    foreign: int = 0  #: Files of the folder that are no shapes
    seconds: float = 0.0  #: Of this run
    task_seconds: float = 0.0  #: Of all tasks of this run together


def bake(
    folder: str | Path,
    out: str | Path,
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    samples: int = SAMPLES,
    workload: str | Path | None = None,
    reading: dict[str, Any] | None = None,
    progress: Progress | bool | None = None,
    **options,
) -> Baked:
    """Fit a bounder to each shape of a folder, on several processes, and keep them in another folder.

    The same call goes on where one that was stopped or killed has ended: what is there is not done again. In a script
    it must stand behind ``if __name__ == "__main__":``, because the workers import the script.

    Args:
        folder: With shapes of any kind that ``load_shape`` reads, in folders inside, too.
        out: Where bounders, records and ``manifest.csv`` go; ``BounderLibrary`` opens it.
        jobs: Worker processes of this machine; one a core if ``None``.
        scheduler: Address of a Dask scheduler, whose workers see both folders under the same paths; ``None`` for
            processes of this machine.
        samples: Random queries of each shape that false positives are counted on.
        workload: A ``.npy`` file of queries as in ``fit`` and ``choose``, the same for all shapes.
        reading: Keyword arguments of ``load_shape``.
        progress: Called with done, total and a note. ``None`` shows a bar on standard error if that is a terminal,
            ``False`` nothing.
        **options: Of ``fit`` for each shape, its ``budget`` and ``method`` among them; with ``narrow_ns`` those of
            ``choose``.

    Returns:
        What was done. A shape that could not be baked is a record with an error, and does not end the others.

    Raises:
        BoundingError: If there is nothing to bake, Dask is not installed, the folder cannot be written to, or the
            scheduler goes away.

    Example:
        >>> import os
        >>> os.makedirs("shapes"), np.save("shapes/ball.npy", ball)  # doctest: +ELLIPSIS
        (None, None)
        >>> done = wb.baking.bake("shapes", "bounders", jobs=1, samples=1000, method="kdop", progress=False)
        >>> done.baked, done.failed, wb.baking.BounderLibrary("bounders", device="cpu").names
        (1, 0, ['ball'])
    """
    folder, out, started = Path(folder), Path(out).resolve(), time.perf_counter()
    if jobs is not None and (isinstance(jobs, bool) or not isinstance(jobs, int) or jobs < 1):
        raise BounderError(f"jobs must be a whole number of at least 1, got {jobs!r}")
    if folder.resolve() == out:
        raise BounderError(f"{out}: expected another folder than that of the shapes")
    settings = Settings(options, reading or {}, None if workload is None else str(Path(workload).resolve()), samples)
    with contextlib.suppress(ShapeError):  # a folder is no shape; what else is wrong would be so for every shape
        settings.bounder(".")
    every, foreign = jobs_of(folder, out, settings)
    if out.exists() and not (out / RECORDS).is_dir() and (not out.is_dir() or any(out.iterdir())):
        raise FileFormatError(f"{out}: holds other files, expected a new folder or one of a bake")
    check_writable(out / MANIFEST)
    (out / RECORDS).mkdir(parents=True, exist_ok=True)
    open_ = [job for job in every if job.done() is None]
    done = Baked(out, kept=len(every) - len(open_), foreign=foreign)
    with reported(progress, "bake") as update:
        try:
            for record in _ended(open_, jobs, scheduler) if open_ else ():
                done.task_seconds += record.seconds
                done.failed, done.baked = done.failed + bool(record.error), done.baked + (not record.error)
                if update:
                    update(done.baked + done.failed, len(open_), f"{record.source}: {record.error or record.method}")
        finally:  # Ctrl-C, and whatever else ends it: what is there is listed, of other settings, too
            records = Record.all_of(out)
            found = {(record.name, record.hash): record for record in records}
            done.records = [found.get((job.record.name, job.record.hash), job.record) for job in every]
            done.seconds = time.perf_counter() - started
            write_manifest(out, records)
    return done


def _ended(open_: list[Job], jobs: int | None, scheduler: str | None) -> Iterator[Record]:
    """Hand out jobs; the records, as they end."""
    with connected(jobs if scheduler is None else scheduler) as client:
        import distributed

        by_key = {f"bake-{job.key}": job for job in open_}
        for future in distributed.as_completed(client.map(bake_shape, open_, key=list(by_key), pure=False)):
            error = future.exception() if future.status == "error" else None
            if future.status == "finished":
                yield future.result()
            elif isinstance(error, distributed.KilledWorker):
                job, why = by_key[future.key], "every worker that fitted it died (killed, out of memory, or a crash)"
                yield job.end(replace(job.record, error=why))
            elif isinstance(error, BoundingError):
                raise error  # the folder cannot be written to
            else:
                reason = f"{type(error).__name__}: {error}" if error else "the scheduler has gone away"
                raise BoundingError(f"{' '.join(reason.split())}; what is baked stays, and the same command goes on")
            future.release()  # else Dask would do it again if the worker that has its result died
