"""The mutation fuzzer: ``certify`` must not call a spoilt file proven unless it bounds its shape.

An honest bounder's file is spoilt (``mutations``), its digest, description and certificate are made right again, and it
is loaded. What ``certify`` then calls proven against the true shape is attacked (``attack``). A denied positive is a
lie that was accepted; the file and the query are kept. Errors other than the one that ``load`` promises, and work that
does not end, are kept, too. Everything depends on the seed and the number of the iteration, so any iteration can be
repeated by itself. Spoilt checkpoints of proofs are the matter of ``tests/proof/test_checkpoint.py``.
"""

import copy
import json
import signal
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from asking import ask
from bounding_shapes import object_points
from mutations import File, mutate, tighten
from region_cases import hard_regions
from subjects import Subject, subjects

import warp_bounding as wb
from warp_bounding.bounders import Bounder
from warp_bounding.certificates.claim import as_fitted, mismatch
from warp_bounding.errors import BoundingError, FileFormatError
from warp_bounding.proof import check
from warp_bounding.proof.stress import DistancePositives, HardStream, Missed
from warp_bounding.queries import oracle
from warp_bounding.queries.boundary import FORMS, HardPositives
from warp_bounding.shapes import Grid
from warp_bounding.shapes.shape import OUT, Shape

# for a certificate; all times but that of the whole run are those that the process computes, so that nothing depends on
# the machine's load
SECONDS = 1.0
STUCK = 300.0  # after so long an iteration, kernels that it compiles included, counts as one that does not end
TIGHTENED = 0.6  # share of the files
MOST_MARGIN = 0.05  # of files that claim more the cells are not made

# --- the attack ------------------------------------------------------------------------------------------------------


def attack(
    bounder: Bounder, shape: Shape, rng: np.random.Generator, count: int = 4096, *, quick: bool = False
) -> tuple[int, Missed | None]:
    """Put some ``4 count`` certain positives to a bounder, in every form that is deployed: none may be denied.

    They are those of the stress test's stream, and regions on corners, faces and hulls, nudged by single floats; with
    ``quick`` batches of float32 only. Returns how many were queried, and the first that was denied.
    """
    queried, far = 0, bounder.of_distances
    if far:
        stream, seed = DistancePositives(bounder, shape), int(rng.integers(2**62))
        chunks = range(2 * len(stream.forms))
    else:
        query, length = bounder.query_kind, bounder.domain.oracle_length
        stream, seed = HardStream(bounder, shape, _positives(query, shape, length)), 0  # of which a shape has one pool
        stream.cycle = ("float32",) if quick else FORMS
        first = int(rng.integers(2**30)) * len(stream.cycle)
        chunks = range(first, first + len(stream.cycle))
    for chunk in chunks:
        _, there, missed = stream.ask(seed, chunk, count)
        queried += there
        if missed is not None:
            return queried, missed
    if far:
        return queried, None
    if isinstance(shape, Grid):
        near = _near(query, shape, length, int(rng.integers(4)))
    else:
        near = _regions_through(query, _held(shape, rng, count), rng, float(shape.extent.max()))
    answers = {"float32": bounder.query(near).numpy()} | ({} if quick else {"function": ask(bounder, near)})
    for form, answer in answers.items():
        missed, queried = np.flatnonzero(answer == 0), queried + len(near)
        if len(missed):
            return queried, Missed(near[missed[0]].tolist(), form)
    return queried, None


def _held(shape: Shape, rng: np.random.Generator, count: int) -> np.ndarray:
    """``(N, n)`` float32 points of a shape: inside, on its box's faces, and, where it has no end, far away or late."""
    x = shape.lower + (shape.upper - shape.lower) * rng.uniform(-0.1, 1.1, (4 * count, shape.ndim))
    on = rng.random(x.shape) < 0.1
    x = np.where(on, np.where(rng.random(x.shape) < 0.5, shape.lower, shape.upper), x)
    if shape.unbounded:
        x *= np.exp2(rng.uniform(0, 60, (len(x), 1)) * (rng.random((len(x), 1)) < 0.5))
    x = x.astype(np.float32)
    x = x[shape.decide(x.astype(np.float64)) != OUT][:count]
    if shape.time:  # what is not known is *maybe*
        late = shape.upper[0] + np.exp2(rng.uniform(-20, 20, len(x)))
        x[::3, 0] = np.nextafter(late.astype(np.float32), np.float32(np.inf))[::3]
    return x


def _regions_through(query: str, p: np.ndarray, rng: np.random.Generator, size: float) -> np.ndarray:
    """Queries that hold these float32 points exactly: rays that begin there, planes through them, boxes around them."""
    if query == "point":
        return p
    if query == "box":
        around = (np.exp2(rng.uniform(-30, 1, p.shape)) * size * (rng.random(p.shape) < 0.7)).astype(np.float32)
        lower = np.where(rng.random(p.shape) < 0.5, p - around, p)
        return np.concatenate([lower, np.maximum(p, p + around)], axis=1).astype(np.float32)
    way = rng.normal(size=p.shape).astype(np.float32)
    return np.concatenate([p, way] if query == "ray" else [way, p], axis=1)


_KNOWN: dict[tuple, HardPositives] = {}


def _positives(query: str, shape: Shape, length: float) -> HardPositives:
    """One stream for all shapes that are the same; a shape's pool of border points takes a while."""
    key = query, shape.digest, shape.margin, shape.unbounded, length
    if key not in _KNOWN:
        _KNOWN[key] = HardPositives(query, shape, length, "cpu")
    return _KNOWN[key]


@lru_cache(maxsize=256)
def _near(query: str, grid: Grid, length: float, number: int, count: int = 2000) -> np.ndarray:
    """Corners, faces and hulls, float32 neighbours included; all of them positives."""
    rng = np.random.default_rng(number)
    if query == "point":
        return object_points(grid, rng, count)
    x = hard_regions(query, grid, rng, length, count)
    return x[oracle(query, grid, "cpu", length)(x)]


# --- the fuzzer ------------------------------------------------------------------------------------------------------


@dataclass
class Tally:
    """Figures of a run, and what was found, as it is written to the record."""

    counts: Counter = field(default_factory=Counter)
    found: list[dict] = field(default_factory=list)

    def __str__(self) -> str:
        names = ("files", "refused", "not proven", "proven", "queries", "lies", "crashes", "stuck")
        return ", ".join(f"{name} {self.counts[name]:,}" for name in names)


@contextmanager
def undistracted():
    """Without the search for a refutation (it decides nothing here) and warnings, and by the process's own clock."""
    positives, check.POSITIVES = check.POSITIVES, 0
    clock, time.perf_counter = time.perf_counter, time.process_time
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            yield
    finally:
        check.POSITIVES, time.perf_counter = positives, clock


class _StuckError(Exception):
    pass


@contextmanager
def _limited():
    """Raise in the main thread when the process has computed for ``STUCK`` seconds."""

    def stop(*_):
        raise _StuckError

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, STUCK)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def judge(path: Path, subject: Subject, rng, tally: Tally, count: int = 4096, quick: bool = False) -> Missed | None:
    """Load, certify and attack one file; counts what came of it."""
    try:
        bounder = wb.load(path, device="cpu")
    except FileFormatError as error:
        if "\n" in str(error):
            raise AssertionError(f"more than one line: {error}") from error
        tally.counts["refused"] += 1
        return None
    margin = bounder.info.get("margin") or 0.0
    proof = wb.certify(bounder, subject.grid, budget=SECONDS) if margin <= MOST_MARGIN else None
    if proof is None or not proof.proven:
        tally.counts["not proven"] += 1
        return None
    tally.counts["proven"] += 1
    if (proof.margin or 0.0, proof.length) != (margin, bounder.domain.length):
        raise AssertionError(f"the certificate is of margin {proof.margin}, length {proof.length}, the bounder is not")
    claimed = as_fitted(bounder, subject.grid)
    claimed = subject.grid if claimed.digest == subject.grid.digest else claimed
    queried, denied = attack(bounder, claimed, rng, count, quick=quick)
    tally.counts["queries"] += queried
    return denied


def fuzz(
    seed: int,
    *,
    iterations: float = float("inf"),
    seconds: float = float("inf"),
    first: int = 0,
    among: list[Subject] | None = None,
    out: Path | None = None,
    count: int = 4096,
    quick: bool = False,
    progress: Callable[[Tally, float], None] = lambda tally, seconds: None,
) -> Tally:
    """Spoil files until time or number are used up, or Ctrl-C; what is found is kept in the folder ``out``.

    A proven file is attacked with ``count`` positives of a kind.
    """
    among, tally, started, number = among or subjects(), Tally(), time.monotonic(), first
    honest: dict[str, File] = {}
    with TemporaryDirectory() as folder, undistracted():
        path = Path(folder) / "spoilt.safetensors"
        try:
            while number < first + iterations and time.monotonic() - started < seconds:
                rng = np.random.default_rng([seed, number])
                subject = among[rng.integers(len(among))]
                if subject.name not in honest:
                    honest[subject.name] = File.of(subject.bounder, path)
                file = copy.deepcopy(honest[subject.name])
                record = {"seed": seed, "iteration": number, "subject": subject.name, "mutations": mutate(file, rng)}
                _one(file, path, subject, tally, record, out, rng=rng, count=count, quick=quick)
                number += 1
                progress(tally, time.monotonic() - started)
        except KeyboardInterrupt:
            pass
    return tally


def _write(file: File, path: Path, subject: Subject, rng: np.random.Generator, record: dict) -> None:
    """With everything made right again; many at thresholds that make the most of the proof."""
    cells = len(getattr(subject.grid, "occupied", ()))
    file.agree(rng, cells)
    file.write(path)
    if rng.random() >= TIGHTENED:
        return
    try:
        bounder = wb.load(path, device="cpu")
        if not (bounder.info.get("margin") or 0.0) <= MOST_MARGIN:
            return
        grid = as_fitted(bounder, subject.grid)
        if mismatch(bounder, grid):
            return
        tighten(file, bounder, grid, rng)
    except BoundingError:  # there is no proof to make the most of
        return
    record["mutations"].append("tightened")
    file.agree(rng, cells)
    file.write(path)


def _one(file: File, path: Path, subject: Subject, tally: Tally, record: dict, out: Path | None, **options) -> None:
    """One iteration, and what is kept of it."""
    tally.counts["files"] += 1
    try:
        with _limited():
            _write(file, path, subject, options["rng"], record)
            denied = judge(path, subject, tally=tally, **options)
        if denied is None:
            return
        record |= {"kind": "lies", "denied": denied._asdict()}
    except _StuckError:
        record |= {"kind": "stuck"}
    except Exception:
        record |= {"kind": "crashes", "error": traceback.format_exc()}
    tally.counts[record["kind"]] += 1
    tally.found.append(record)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        name = f"{record['kind']}-{record['seed']}-{record['iteration']}.safetensors"
        (out / name).write_bytes(path.read_bytes())
        with (out / "found.jsonl").open("a") as lines:
            lines.write(json.dumps(record | {"file": name}) + "\n")
