"""``bake``: a bounder for each shape of a folder, on many processes, resumable whatever is killed.

A task is a shape. The worker itself writes the bounder, then a record of what is known of it, each whole or not at all,
under a name that is a hash of shape, settings and version: whatever is killed, nothing that is done is lost, and
nothing is done again. Whatever is wrong with a shape becomes a record with an error. Manifest and contact sheet are
made of the records. Workers are processes of this machine, with one thread each, or those of any Dask scheduler.
"""

import base64
import contextlib
import csv
import hashlib
import html
import io
import json
import logging
import os
import signal
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from importlib.util import find_spec
from inspect import signature
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from warp_bounding.baking.library import COLUMNS, HASH_DIGITS, MANIFEST
from warp_bounding.errors import BounderError, BoundingError, BoundingWarning, FileFormatError, ShapeError
from warp_bounding.queries.distance import DISTANCE
from warp_bounding.runtime.launch import cpu_threads
from warp_bounding.runtime.progress import Progress, quiet_warp, reported
from warp_bounding.runtime.whole_file import BOUNDER_FILE, PAGE_FILE, FileKind, write_whole
from warp_bounding.shapes import load_shape
from warp_bounding.shapes.formats.gltf import referred_buffers
from warp_bounding.shapes.formats.load import READERS
from warp_bounding.shapes.formats.usd import USD_SUFFIXES
from warp_bounding.version import __version__

__all__ = ["LARGEST", "SAMPLES", "SHEET", "Baked", "Job", "Record", "SchedulerError", "Settings", "bake", "bake_with"]

LARGEST = 500.0  # megabytes of a shape's file: reading one takes some ten times as much memory
SAMPLES = 100_000  # random queries of a shape that false positives are counted on
MANIFEST_SHARE = 0.02  # the manifest is written for no larger share of the time while a bake runs
# of workers under the same task, after which it is given up: a shape that ends every process would go on for ever
DEATHS = 10
CONNECT_SECONDS = 15
# Each task has one core: the library's own threads, and those of the libraries below it.
THREADS = ("WARP_BOUNDING_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
ONE_THREAD = dict.fromkeys(THREADS, "1")
MARK, LOCK, RECORDS, SHEET = "bake.json", ".bake.lock", "records", "contact-sheet.html"  # in the folder of a bake
FORMAT = 1
RECORD_FILE, MANIFEST_FILE = FileKind(".json", 0, b"{"), FileKind(".csv", 0, b"name")


class SchedulerError(BoundingError):
    """The scheduler of a bake has gone away, or its workers cannot do the work; what was baked stays."""


# --- settings, records and jobs --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Settings:
    """How each shape is baked: a method is fitted to all of them, or a bounder is chosen for each."""

    arguments: Mapping[str, Any] = field(default_factory=dict)  # of ``fit``, or with ``narrow_ns`` of ``choose``
    reading: Mapping[str, Any] = field(default_factory=dict)  # keyword arguments of ``load_shape``
    workload: str | None = None  # a .npy file of the caller's own queries, absolute, which every worker can read
    samples: int = SAMPLES  # random queries that false positives are counted on

    @property
    def engine(self) -> str:
        """The name of the function that makes the bounders."""
        return "choose" if "narrow_ns" in self.arguments else "fit"

    def bounder(self, shape):
        """Make the bounder of a shape; ``None`` where none is the best choice. Raises as ``fit`` and ``choose`` do."""
        import warp_bounding

        function = getattr(warp_bounding, self.engine)
        try:
            signature(function).bind(shape, **self.arguments)
            workload = None if self.workload is None else np.load(self.workload, allow_pickle=False)
        except (TypeError, OSError, ValueError) as error:
            raise BounderError(f"{self.engine}: {error}") from error
        found = function(shape, workload=workload, progress=False, **self.arguments)
        return found if self.engine == "fit" else found.bounder

    def check(self) -> None:
        """Refuse what would be wrong for every shape, before any is read; raises as ``fit`` and ``choose`` do."""
        with contextlib.suppress(ShapeError):  # a folder is no shape, and nothing else is wrong
            Settings.bounder(self, ".")

    def to_dict(self) -> dict[str, Any]:
        """All that makes a difference to what is baked, JSON-ready; of a file of queries its content."""
        queried = None if self.workload is None else file_digest(Path(self.workload))
        about = {"version": __version__, "engine": self.engine, "arguments": dict(self.arguments)}
        about |= {"reading": dict(self.reading), "queries": queried, "samples": self.samples}
        try:
            return json.loads(json.dumps(about))
        except (TypeError, ValueError) as error:
            raise BounderError(f"options of a bake must be numbers, texts and lists of them: {error}") from error


@dataclass(frozen=True)
class Record:
    """What is known of one shape under one set of settings, kept as a file of its own."""

    name: str  # the shape's file without its extension
    source: str  # its path, relative to the folder that was baked
    hash: str  # of shape, settings and version
    settings: str  # hash of the settings alone; settings/HASH.json has them
    file: str = ""  # the bounder's, in the folder of the bake; empty where there is none
    method: str = ""  # "none" where a choice said that none pays; empty after an error
    query: str = ""  # the kind of query that the bounder answers
    bytes: int = 0  # that one query can read (``Bounder.nbytes``)
    certificate: str = ""  # its kind; empty where there is none
    fp_rate: float | None = None  # false positives, per cent of the samples; ``None`` where they were not counted
    seconds: float = 0.0  # that the task took, all in all
    error: str = ""  # why there is no bounder, in one line
    note: str = ""  # what the library warned of, in one line
    sha256: str = ""  # of the bounder's file
    picture: str = ""  # a PNG in base64

    def path_in(self, folder: Path) -> Path:
        """Where the record is, in the folder of a bake."""
        return folder / RECORDS / f"{self.name}-{self.hash}.json"

    def write(self, folder: Path) -> None:
        """Write it, whole or not at all; raises ``FileFormatError`` if it cannot be written."""
        write_whole(self.path_in(folder), json.dumps({"format": FORMAT} | asdict(self), indent=1).encode(), RECORD_FILE)

    @classmethod
    def read(cls, path: Path) -> "Record | None":
        """The record of a file; ``None`` if there is none of this version, and the shape is then baked anew."""
        try:
            values: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
            right = values.pop("format") == FORMAT and set(values) == {f.name for f in fields(cls)}
            return cls(**values) if right else None
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return None


@dataclass(frozen=True)
class Job:
    """One shape to bake."""

    path: str  # the shape's file, absolute
    out: str  # the folder of the bake, absolute
    record: Record  # what is known of it before
    settings: Settings

    @property
    def bounder_path(self) -> Path:
        """Where the bounder goes."""
        return Path(self.out) / f"{self.record.name}-{self.record.hash}{BOUNDER_FILE.suffix}"

    def done(self) -> Record | None:
        """Its record, if it was baked without an error and its bounder's file is unchanged; else ``None``."""
        record = Record.read(self.record.path_in(Path(self.out)))
        with contextlib.suppress(OSError):
            if record and not record.error and (not record.file or file_digest(self.bounder_path) == record.sha256):
                return record
        return None


def jobs_of(folder: Path, out: Path, settings: Settings, largest: float) -> tuple[list[Job], list[str], int]:
    """A job for each file of a folder, folders inside it included, whose extension ``load_shape`` reads.

    Hidden folders and ``out`` are left out. Returns also the paths of files above ``largest`` megabytes, relative to
    the folder, and the number of files of other kinds. Raises ``ShapeError`` if there is no such folder, or no shape in
    it.
    """
    if not folder.is_dir():
        raise ShapeError(f"{folder}: {'a file, expected a folder' if folder.exists() else 'no such folder'}")
    jobs, too_large, foreign, about = [], [], 0, short_digest(settings.to_dict())
    for where, folders, names in os.walk(folder):
        inside = Path(where)
        folders[:] = sorted(f for f in folders if not f.startswith(".") and (inside / f).resolve() != out.resolve())
        for path in (inside / name for name in sorted(names) if not name.startswith(".")):
            source = str(path.relative_to(folder))
            if not path.is_file() or path.suffix.lower() not in READERS:
                foreign += path.is_file()
            elif path.stat().st_size > largest * 1e6:
                too_large.append(source)
            else:
                record = Record(path.stem, source, short_digest([shape_digest(path), about]), about)
                jobs.append(Job(str(path.resolve()), str(out.resolve()), record, settings))
    if not jobs:
        others = f", {len(too_large)} above {largest:g} MB" if too_large else ""
        expected = f"expected files of {' '.join(READERS)}; got {foreign} of other kinds{others}"
        raise ShapeError(f"{folder}: no shapes, {expected}")
    return jobs, too_large, foreign


def short_digest(value: Any) -> str:
    """``HASH_DIGITS`` hexadecimal digits of what is JSON-ready."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:HASH_DIGITS]


def file_digest(path: Path) -> str:
    """SHA-256 of a file's bytes; raises ``OSError`` where it cannot be read."""
    sha = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            sha.update(block)
    return sha.hexdigest()


def shape_digest(path: Path) -> str:
    """SHA-256 of all bytes that a shape is read from.

    These are the file's, its extension, and those of files that a glTF or USD file refers to.
    """
    others, suffix = set(), path.suffix.lower()
    if suffix == ".gltf":
        with contextlib.suppress(OSError, ValueError, AttributeError, TypeError):  # too damaged to tell
            others = referred_buffers(path)
    if suffix in USD_SUFFIXES:
        with contextlib.suppress(ImportError):  # the task says what is not installed
            from pxr import Tf, UsdUtils

            with contextlib.suppress(Tf.ErrorException):
                layers = UsdUtils.ComputeAllDependencies(str(path))[0]
                others = {Path(layer.realPath) for layer in layers if layer.realPath} - {path.resolve()}
    parts = [suffix]
    for file in (path, *sorted(others)):
        try:
            parts.append(file_digest(file))
        except OSError:
            parts.append("")  # the task finds out why
    return hashlib.sha256("|".join(parts).encode()).hexdigest()


# --- what a worker does ----------------------------------------------------------------------------------------------


def bake_shape(job: Job) -> dict[str, Any]:
    """Bake one shape, unless that has been done: Dask repeats tasks whose results were lost when a worker died.

    Returns the record, without the picture, which only the file has. Raises ``FileFormatError`` if the folder cannot be
    written to.
    """
    if (record := job.done()) is None:
        started = time.perf_counter()
        os.environ.update(ONE_THREAD)
        quiet_warp()
        bounder, record = _made(job)
        if bounder is not None:
            bounder.save(job.bounder_path)
            record = replace(record, file=job.bounder_path.name, sha256=file_digest(job.bounder_path))
        record = replace(record, seconds=round(time.perf_counter() - started, 3))
        record.write(Path(job.out))
    return vars(replace(record, picture=""))


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
            rates, drawn = evaluate(bounder, shape, samples=settings.samples), picture(bounder, shape)
        except Exception as error:  # whatever a file makes a reader, a fit or a proof do: the others go on
            text = " ".join(str(error).split()).removeprefix(f"{job.path}: ").removeprefix(f"{Path(job.path).name}: ")
            known = isinstance(error, BoundingError) and text
            return None, replace(record, error=text if known else f"{type(error).__name__}: {text}".rstrip(": "))
    notes = dict.fromkeys(" ".join(str(w.message).split()) for w in caught if issubclass(w.category, BoundingWarning))
    found = {"method": bounder.method, "query": bounder.query_kind, "bytes": bounder.nbytes, "note": "; ".join(notes)}
    found |= {"certificate": bounder.certificate.kind if bounder.certificate else ""}
    found |= {"fp_rate": round(rates.fp_rate, 4), "picture": base64.b64encode(drawn).decode()}
    return bounder, replace(record, **found)


def looked_at(folders: list[str]) -> dict[str, Any]:
    """What a worker says before the first task: its version of the library, and which of the folders it cannot see."""
    return {"version": __version__, "missing": [folder for folder in folders if not Path(folder).exists()]}


def dask_setup(worker: object) -> None:
    """Called by Dask in a worker that starts: leaves Ctrl-C to the client, and standard output to its ``--json``."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.dup2(2, 1)


SIDE, WALL, ROOM = 72, 3, 0.08  # pixels of a slice, and between two; around the object, of its longest side
COLOURS = {"no": (0, 0, 0, 0), "maybe": (224, 122, 31, 255), "object": (45, 84, 122, 255)}  # RGBA; no is transparent


def picture(bounder, source) -> bytes:
    """A PNG of slices through the middle of a shape and its bound, in ``COLOURS``, for each pair of up to three axes.

    A pixel asks a point; of boxes one of the pixel's size, of rays the one that starts there, along the slice's normal,
    of planes the one through it, across the way from the middle. Empty for objects of one dimension.
    """
    from PIL import Image

    from warp_bounding.certificates.claim import as_fitted, in_local, of_side
    from warp_bounding.evaluation import PROTOCOLS, judge_of, truth_by
    from warp_bounding.shapes.shape import OUT

    bounder, source = in_local(bounder, source)
    shape = as_fitted(bounder, source)
    truth = shape.contains
    if bounder.query_kind != DISTANCE.name:
        shape = judge_of(of_side(bounder, source), shape, bounder.query_kind, PROTOCOLS[0])
        decide = truth_by(PROTOCOLS[0], bounder.query_kind, shape, bounder.device, bounder.domain.oracle_length, 0)
        truth = lambda q: np.asarray(decide(q)) != OUT  # noqa: E731
    axes, middle = list(range(int(shape.time), shape.ndim))[:3], (shape.lower + shape.upper) / 2
    if len(axes) < 2:
        return b""
    steps, slices = (np.arange(SIDE) + 0.5) / SIDE * 2 - 1, []
    for pair in combinations(axes, 2):
        half = (0.5 + ROOM) * max(float((shape.upper - shape.lower)[list(pair)].max()), 1e-30)
        x = np.tile(middle, (SIDE * SIDE, 1))
        x[:, pair[0]] += half * np.tile(steps, SIDE)
        x[:, pair[1]] += half * np.repeat(-steps, SIDE)  # the first row of a picture is the top one
        in_plane, along = np.isin(np.arange(shape.ndim), pair), np.zeros_like(x)
        along[:, next((axis for axis in axes if axis not in pair), pair[1])] = 1.0
        reach = in_plane * half / SIDE
        numbers = {"ray": [x, along], "box": [x - reach, x + reach], "plane": [x - middle + 1e-30 * along, x]}
        q = np.hstack(numbers.get(bounder.query_kind, [x])).astype(np.float32)
        seen = np.where(truth(q.astype(np.float64)), 2, bounder.query(q).numpy() != 0).reshape(SIDE, SIDE)
        slices += [seen, np.zeros((SIDE, WALL))]
    image, file = Image.fromarray(np.hstack(slices[:-1]).astype(np.uint8), mode="P"), io.BytesIO()
    image.putpalette([value for colour in COLOURS.values() for value in colour[:3]])
    image.save(file, "PNG", transparency=bytes(colour[3] for colour in COLOURS.values()), optimize=True)
    return file.getvalue()


# --- the folder of a bake --------------------------------------------------------------------------------------------


def prepare(out: Path) -> None:
    """Make the folder of a bake.

    Raises ``FileFormatError`` if it cannot be written to, or holds something else, and then leaves it as it is.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        marked = (out / MARK).exists()
        foreign = not marked and any(not file.name.startswith(".") for file in out.iterdir())
    except OSError as error:
        raise FileFormatError(f"{out}: cannot be used for a bake ({error.strerror or error})") from error
    if foreign:
        raise FileFormatError(f"{out}: holds other files, expected a new folder or one of a bake")
    if not marked:
        write_whole(out / MARK, json.dumps({"format": FORMAT, "contact_sheet": SHEET}).encode(), RECORD_FILE)


@contextlib.contextmanager
def locked(out: Path) -> Iterator[None]:
    """Keep other bakes out, with ``FileFormatError``; the system gives the lock back if this process is killed."""
    try:
        from filelock import FileLock, Timeout
    except ImportError as error:
        raise BoundingError("baking needs filelock: pip install 'warp-bounding[bake]'") from error
    try:
        with FileLock(out / LOCK, timeout=0):
            for folder in (out, out / RECORDS):  # what workers have left that were killed while they wrote
                for left in folder.glob(".*.*.*"):
                    if {BOUNDER_FILE.suffix, RECORD_FILE.suffix} & set(left.suffixes):
                        left.unlink(missing_ok=True)
            yield
    except Timeout:
        expected = "wait until it has ended, or give another folder"
        raise FileFormatError(f"{out}: another bake writes to it; {expected}") from None


def all_records(out: Path) -> list[Record]:
    """All records of a folder, of this bake and of those before, with other settings too."""
    found = (Record.read(path) for path in sorted((out / RECORDS).glob("*.json")))
    return [record for record in found if record is not None]


def write_manifest(out: Path, records: list[Record]) -> None:
    """Write a row for each record, by source and settings."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for record in sorted(records, key=lambda r: (r.source, r.settings, r.hash)):
        writer.writerow(["" if (value := getattr(record, name)) is None else value for name in COLUMNS])
    write_whole(out / MANIFEST, text.getvalue().encode(), MANIFEST_FILE)


PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>{head}</title><style>
body {{ font: 14px/1.4 system-ui, sans-serif; margin: 1.5rem; color-scheme: light dark }} h1 {{ font-size: 1.2rem }}
main {{ display: grid; gap: .8rem; grid-template-columns: repeat(auto-fill, minmax(250px, 1fr)) }}
article {{ border: 1px solid #8888; padding: .7rem; overflow-wrap: anywhere; content-visibility: auto;
  contain-intrinsic-size: 250px 190px }}
img {{ image-rendering: pixelated; max-width: 100% }} h2 {{ font-size: 1rem; margin: 0 }} .error {{ color: #c33 }}
</style></head><body><h1>{head}</h1><p>Slices through each object: <b style="color:{object}">object</b>,
<b style="color:{maybe}">maybe</b>, though no object is there, and certainly no.</p>
<main>
{cards}
</main></body></html>
"""


def write_sheet(out: Path, records: list[Record]) -> None:
    """Write the contact sheet of all records; shapes with an error come first."""
    baked = [record for record in records if record.file]
    failed, proven = sum(bool(r.error) for r in records), sum(r.certificate == "proven" for r in baked)
    head = f"{len(records)} shapes, {len(baked)} with a bounder, {proven} of them proven; {failed} failed"
    order = sorted(records, key=lambda r: (not r.error, r.source, r.settings))
    cards = "\n".join(_card(Record.read(record.path_in(out)) or record) for record in order)
    colours = {name: f"rgb{COLOURS[name][:3]}" for name in ("object", "maybe")}
    write_whole(out / SHEET, PAGE.format(head=head, cards=cards, **colours).encode(), PAGE_FILE)


def _card(record: Record) -> str:
    """A shape's part of the contact sheet."""
    drawn = f'<img src="data:image/png;base64,{record.picture}" alt="slices" loading="lazy">' if record.picture else ""
    rate = "" if record.fp_rate is None else f"{record.fp_rate:.2f} % false positives"
    told = (record.method, record.query, f"{record.bytes:,} bytes" if record.file else "", rate, record.certificate)
    lines = [", ".join(filter(None, told)), f"{record.seconds:.1f} s, settings {record.settings}", record.note]
    text = "".join(f"<div>{html.escape(line)}</div>" for line in filter(None, lines))
    error = f'<div class="error">{html.escape(record.error)}</div>' if record.error else ""
    return f"<article>{drawn}<h2>{html.escape(record.source)}</h2>{error}{text}</article>"


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
    too_large: list[str] = field(default_factory=list)  #: Files that were left out for their size
    seconds: float = 0.0  #: Of this run
    task_seconds: float = 0.0  #: Of all tasks of this run together
    running_seconds: float = 0.0  #: From the first task's start to the last one's end, without the start of workers
    workers: int = 0  #: Threads of workers when the first task was handed out


def bake(
    folder: str | Path,
    out: str | Path,
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    largest: float = LARGEST,
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
        out: Where bounders, records, ``manifest.csv`` and ``contact-sheet.html`` go; ``BounderLibrary`` opens it.
        jobs: Worker processes of this machine; one a core if ``None``.
        scheduler: Address of a Dask scheduler, whose workers see both folders under the same paths; ``None`` for
            processes of this machine.
        largest: Megabytes; larger files are left out, and told.
        samples: Random queries of each shape that false positives are counted on.
        workload: A ``.npy`` file of queries as of ``fit`` and ``choose``, the same for all shapes.
        reading: Keyword arguments of ``load_shape``.
        progress: Called with done, total and a note. ``None`` shows a bar on standard error if that is a terminal,
            ``False`` nothing.
        **options: Of ``fit`` for each shape, its ``budget`` and ``method`` among them; with ``narrow_ns`` those of
            ``choose``.

    Returns:
        What was done. A shape that could not be baked is a record with an error, and does not end the others.

    Raises:
        BoundingError: If there is nothing to bake, Dask is not installed, the folder cannot be written to, another bake
            has it, or the scheduler goes away.

    Example:
        >>> import os
        >>> os.makedirs("shapes"), np.save("shapes/ball.npy", ball)  # doctest: +ELLIPSIS
        (None, None)
        >>> done = wb.baking.bake("shapes", "bounders", jobs=1, samples=1000, method="kdop", progress=False)
        >>> done.baked, done.failed, wb.baking.BounderLibrary("bounders", device="cpu").names
        (1, 0, ['ball'])
    """
    settings = Settings(options, reading or {}, None if workload is None else str(Path(workload).resolve()), samples)
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
    """``bake`` with settings; calls ``tell`` with lines for people: the dashboard's link, and errors as they happen."""
    folder, out, started = Path(folder), Path(out), time.perf_counter()
    if jobs is not None and (isinstance(jobs, bool) or not isinstance(jobs, int) or jobs < 1):
        raise BounderError(f"jobs must be a whole number of at least 1, got {jobs!r}")
    if not largest > 0:
        raise BounderError(f"largest must be a positive number of megabytes, got {largest!r}")
    if folder.resolve() == out.resolve():
        raise BounderError(f"{out}: expected another folder than that of the shapes")
    settings.check()
    found, too_large, foreign = jobs_of(folder, out, settings, largest)
    out = out.resolve()
    prepare(out)
    with locked(out), reported(progress, "bake") as update:
        update, about = update or (lambda *told: None), settings.to_dict()
        path = out / "settings" / f"{short_digest(about)}.json"
        write_whole(path, json.dumps(about, indent=1).encode(), RECORD_FILE)
        update(0, 1, "what is there is read")
        every = {job.record.path_in(out): job for job in found}  # the same file under the same name twice is one
        records = {path: job.done() for path, job in every.items()}
        open_ = [job for path, job in every.items() if records[path] is None]
        done = Baked(out, kept=len(every) - len(open_), foreign=foreign, too_large=too_large)
        others = [record for record in all_records(out) if record.path_in(out) not in every]
        next_time = 0.0
        try:
            for record in _ended(open_, out, done, jobs, scheduler, update, tell) if open_ else ():
                records[record.path_in(out)] = record
                if (now := time.perf_counter()) > next_time:
                    write_manifest(out, [*others, *filter(None, records.values())])
                    next_time = now + (time.perf_counter() - now) / MANIFEST_SHARE
        finally:  # Ctrl-C, and whatever else ends it: what is there is listed
            done.seconds = time.perf_counter() - started
            done.records = [records[path] or job.record for path, job in every.items()]
            write_manifest(out, [*others, *filter(None, records.values())])
            write_sheet(out, [*others, *filter(None, records.values())])
    return done


def _ended(
    open_: list[Job], out: Path, done: Baked, jobs: int | None, scheduler: str | None, update: Progress, tell
) -> Iterator[Record]:
    """Hand out jobs; the records, as they end."""
    total = len(open_)
    update(0, total, "workers start")
    with _connected(jobs, scheduler) as client:
        import distributed

        if client.scheduler_info().get("services", {}).get("dashboard"):
            tell(f"dashboard: {client.dashboard_link}")
        _check_workers(client, [out, Path(open_[0].path).parent])
        started, done.workers = time.perf_counter(), sum(client.nthreads().values())
        by_key = {f"bake-{job.bounder_path.stem}": job for job in open_}
        running = distributed.as_completed(client.map(bake_shape, open_, key=list(by_key), pure=False))
        for future in running:
            record = _outcome(future, by_key[future.key], client)
            future.release()  # else Dask would do it again if the worker that has its result died
            done.task_seconds += record.seconds
            done.failed, done.baked = done.failed + bool(record.error), done.baked + (not record.error)
            if record.error:
                tell(f"{record.source}: {record.error}")
            ended, done.running_seconds = done.baked + done.failed, time.perf_counter() - started
            left = done.running_seconds / ended * (total - ended)
            failed = f", {done.failed} failed" if done.failed else ""
            told = f"{left:.0f} s" if left < 90 else f"{round(left / 60)} min"
            update(ended, total, f"{ended:,} of {total:,} shapes{failed}, {told} left")
            yield record


def _outcome(future, job: Job, client) -> Record:
    """What became of a task: a record, or an error that ends the bake."""
    import distributed

    if future.status == "finished":
        return Record(**future.result())
    error = future.exception() if future.status == "error" else None
    if isinstance(error, distributed.KilledWorker):
        record = replace(job.record, error="every worker that fitted it died (killed, out of memory, or a crash)")
        record.write(Path(job.out))
        return record
    if isinstance(error, BoundingError):
        raise error  # the folder cannot be written to
    if error is not None:
        raise SchedulerError(f"a task failed: {type(error).__name__}: {' '.join(str(error).split())}")
    raise _gone(client)


@contextlib.contextmanager
def _connected(jobs: int | None, scheduler: str | None) -> Iterator[Any]:
    """A Dask client of local workers that are restarted when they die, or of a scheduler.

    Raises ``BoundingError`` where there is none.
    """
    try:
        import dask
        import distributed
    except ImportError as error:
        raise BoundingError("baking needs Dask: pip install 'warp-bounding[bake]'") from error
    own = {
        "distributed.scheduler.allowed-failures": DEATHS,
        "distributed.scheduler.worker-saturation": 1.0,  # else a death also counts against the task that waits behind
        "logging.distributed": "critical",
    }
    with contextlib.ExitStack() as stack:
        for name in [n for n in logging.root.manager.loggerDict if n.startswith("distributed")]:
            logger = logging.getLogger(name)  # of workers that die and connections that are lost what matters is told
            stack.callback(logger.setLevel, logger.level)
            logger.setLevel(logging.CRITICAL)
        stack.enter_context(dask.config.set(own))
        try:
            if scheduler is None:
                workers = {"n_workers": jobs or cpu_threads(), "threads_per_worker": 1, "processes": True}
                workers |= {"memory_limit": 0, "silence_logs": logging.CRITICAL, "env": ONE_THREAD, "preload": __name__}
                workers |= {"dashboard_address": "127.0.0.1:0" if find_spec("bokeh") else None}
                client = distributed.Client(stack.enter_context(distributed.LocalCluster(**workers)))
            else:
                client = distributed.Client(scheduler, timeout=CONNECT_SECONDS)
        except (OSError, TimeoutError, ValueError) as error:
            reason = " ".join(str(error).split())[:200] or type(error).__name__
            raise BoundingError(f"{scheduler or 'local workers'}: no scheduler answers ({reason})") from error
        stack.callback(client.close, timeout=2)
        yield client


def _gone(client: Any) -> SchedulerError:
    """What to say when the connection to the scheduler is lost."""
    where = client.scheduler.address if client.scheduler else "the scheduler"
    return SchedulerError(f"{where} has gone away; what is baked stays, and the same command goes on")


def _check_workers(client: Any, folders: list[Path]) -> None:
    """Find out before the first task whether the workers that are there can do the work; raises ``SchedulerError``."""
    try:
        answers = client.run(looked_at, [str(folder) for folder in folders], on_error="return")
    except OSError as error:
        raise _gone(client) from error
    for address, answer in answers.items():
        if isinstance(answer, OSError):
            continue  # a worker that dies meanwhile says nothing, and another one will do its tasks
        if isinstance(answer, Exception):
            reason = " ".join(str(answer).split())[:200] or type(answer).__name__
            raise SchedulerError(f"worker {address} cannot run warp-bounding: {reason}")
        if answer["version"] != __version__:
            raise SchedulerError(f"worker {address} has warp-bounding {answer['version']}, expected {__version__}")
        if answer["missing"]:
            expected = "expected folders that all workers share"
            raise SchedulerError(f"worker {address} sees no {answer['missing'][0]}; {expected}")
