"""The mutation fuzzer: ``certify`` must not call a spoilt file proven unless it bounds its shape.

An honest bounder's file is spoilt (``mutations``), its digest, description and certificate are made right again, and it
is loaded. What ``certify`` then calls proven against the true shape is attacked (``attack``). A denied positive is a
lie that was accepted; the file and the query are kept. Errors other than the one that ``load`` promises, and work that
does not end, are kept, too.

Everything depends on the seed and the number of the iteration, so any iteration can be repeated by itself.
"""

import json
import os
import signal
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from attack import attack
from mutations import File, mutate, spoil_checkpoint, tighten
from subjects import Subject, subjects

import warp_bounding as wb
from warp_bounding.bounders import DistanceBounder
from warp_bounding.certificates.claim import as_fitted, mismatch
from warp_bounding.errors import BoundingError, FileFormatError
from warp_bounding.proof import check
from warp_bounding.proof.stress import Missed
from warp_bounding.runtime.launch import working_seconds

# for a certificate; all times but that of the whole run are those that the process computes, so that nothing depends on
# the machine's load
SECONDS = 1.0
STUCK = 60.0  # after so long an iteration counts as one that does not end; compiling kernels is not counted
CHECKPOINTS = (
    0.25  # share of the iterations of a distance that is searched for in which its proof's checkpoint is spoilt instead
)
WALKED = 0.05  # share of the proven files that are walked downhill
TIGHTENED = 0.6  # share of the files
MOST_MARGIN = 0.05  # of files that claim more the cells are not made


@dataclass
class Tally:
    """Figures of a run.

    Attributes:
        counts: Files mutated, refused on load, not proven, still proven, hard queries asked, lies, crashes and stuck
            ones.
        proven: Still proven, by subject.
        found: What was found, as it is written to the record.
    """

    counts: Counter = field(default_factory=Counter)
    proven: Counter = field(default_factory=Counter)
    found: list[dict] = field(default_factory=list)

    def __str__(self) -> str:
        names = ("files", "refused", "not proven", "proven", "queries", "lies", "crashes", "stuck")
        return ", ".join(f"{name} {self.counts[name]:,}" for name in names)


class _StuckError(Exception):
    pass


@contextmanager
def undistracted():
    """Without the search for a refutation (it takes a second and decides nothing here), without NumPy's warnings, and
    by the process's own clock."""
    positives, check.POSITIVES = check.POSITIVES, 0
    clock, time.perf_counter = time.perf_counter, time.process_time
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            yield
    finally:
        check.POSITIVES, time.perf_counter = positives, clock


@contextmanager
def limited(seconds: float):
    """Raise in the main thread when the process has computed for longer, compiling not counted."""
    started = working_seconds()

    def stop(*_):
        left = seconds - (working_seconds() - started)
        if left <= 0:
            raise _StuckError
        signal.setitimer(signal.ITIMER_PROF, left)

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def judge(
    path: Path, subject: Subject, rng: np.random.Generator, tally: Tally, count: int = 4096, quick: bool = False
) -> Missed | None:
    """Load, certify and attack one file; counts what came of it."""
    try:
        bounder = wb.load(path, device="cpu")
    except FileFormatError as error:
        if "\n" in str(error):
            raise AssertionError(f"more than one line: {error}") from error
        tally.counts["refused"] += 1
        return None
    if not (bounder.info.get("margin") or 0.0) <= MOST_MARGIN:
        tally.counts["not proven"] += 1
        return None
    proof = wb.certify(bounder, subject.grid, seconds=SECONDS)
    if not proof.proven:
        tally.counts["not proven"] += 1
        return None
    tally.counts["proven"] += 1
    tally.proven[subject.name] += 1
    if (proof.margin or 0.0, proof.length) != (bounder.info.get("margin") or 0.0, bounder.domain.length):
        raise AssertionError(
            f"the certificate is about margin {proof.margin} and length {proof.length}, the bounder is not"
        )
    claimed = as_fitted(bounder, subject.grid)
    claimed = subject.grid if claimed.digest == subject.grid.digest else claimed
    queried, denied = attack(bounder, claimed, rng, count, walk=rng.random() < WALKED and not quick, quick=quick)
    tally.counts["queries"] += queried
    return denied


def judge_checkpoint(path: Path, subject: Subject, rng: np.random.Generator, tally: Tally, record: dict) -> None:
    """Spoil the checkpoint of a proof that was stopped: what was not signed anew is refused, and nothing crashes.

    A checkpoint that is signed is believed, so its proof shows nothing.
    """
    path.unlink(missing_ok=True)
    wb.certify(subject.bounder, subject.grid, seconds=0.0, checkpoint=path)
    if not path.is_file():  # the proof has ended
        return
    what, signed = spoil_checkpoint(path, rng)
    record["mutations"].append(what)
    content = path.read_bytes()
    try:
        wb.certify(subject.bounder, subject.grid, seconds=SECONDS, checkpoint=path)
    except FileFormatError as error:
        if "\n" in str(error) or path.read_bytes() != content:
            raise AssertionError(f"more than one line, or the file was not kept: {error}") from error
        tally.counts["refused"] += 1
        return
    if not signed:
        raise AssertionError("a checkpoint that was not signed anew was taken")
    tally.counts["not proven"] += 1


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
    progress: Callable[[Tally, int, float], None] | None = None,
) -> Tally:
    """Spoil files until time or number are used up, or Ctrl-C.

    Args:
        seed: Of everything.
        iterations: Files.
        seconds: Time.
        first: Number of the first iteration.
        among: Subjects; all if ``None``.
        out: Folder for what is found: ``found.jsonl`` and the files.
        count: Positives of a kind that a proven file is attacked with.
        quick: See ``attack``.
        progress: Called after each iteration with the figures, its number and the seconds so far.
    """
    among, tally, started, number = among or subjects(), Tally(), time.monotonic(), first
    honest: dict[str, File] = {}
    memory = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None  # a disk may take longer than all the rest
    with TemporaryDirectory(dir=memory) as folder, undistracted():
        path = Path(folder) / "spoilt.safetensors"
        try:
            while number < first + iterations and time.monotonic() - started < seconds:
                rng = np.random.default_rng([seed, number])
                subject = among[rng.integers(len(among))]
                if subject.name not in honest:
                    honest[subject.name] = File.of(subject.bounder, path)
                file = honest[subject.name].copy()
                searched = isinstance(subject.bounder, DistanceBounder) and subject.bounder.volume is None
                done = [] if searched and rng.random() < CHECKPOINTS else mutate(file, rng)
                record = {"seed": seed, "iteration": number, "subject": subject.name, "mutations": done}
                _one(file, path, subject, tally, record, out, rng=rng, count=count, quick=quick)
                number += 1
                if progress:
                    progress(tally, number, time.monotonic() - started)
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
    kind = None
    try:
        with limited(STUCK):
            if not record["mutations"]:
                judge_checkpoint(path, subject, options["rng"], tally, record)
                return
            _write(file, path, subject, rng=options["rng"], record=record)
            denied = judge(path, subject, tally=tally, **options)
        if denied is not None:
            kind = "lies"
            record |= {"denied": denied._asdict()}
    except _StuckError:
        kind = "stuck"
    except Exception:
        kind = "crashes"
        record |= {"error": traceback.format_exc()}
    if kind is None:
        return
    tally.counts[kind] += 1
    record |= {"kind": kind}
    tally.found.append(record)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        name = f"{kind}-{record['seed']}-{record['iteration']}.safetensors"
        (out / name).write_bytes(path.read_bytes() if path.is_file() else b"")
        with (out / "found.jsonl").open("a") as lines:
            lines.write(json.dumps(record | {"file": name}) + "\n")
