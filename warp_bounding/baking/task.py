"""What a worker does with one shape: read it, make its bounder, measure it, draw it, and write the file and then the record.

Files are written by the worker itself, to a folder that it shares with whoever asked: if that one is killed, what is done stays done. Whatever is
wrong with a shape becomes a record with an error; only a folder that cannot be written to ends the bake.
"""

import base64
import hashlib
import os
import time
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from warp_bounding.baking.pictures import picture
from warp_bounding.baking.record import Record
from warp_bounding.baking.settings import Settings
from warp_bounding.errors import BoundingError, BoundingWarning
from warp_bounding.indicators import load_indicator
from warp_bounding.runtime.quiet import quiet_warp
from warp_bounding.runtime.whole_file import BOUNDER_FILE
from warp_bounding.version import __version__

__all__ = ["ONE_THREAD", "Job", "bake_shape", "looked_at"]

# Each task has one core: the library's own threads, and those of the libraries below it.
ONE_THREAD = dict.fromkeys(
    ("WARP_BOUNDING_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"
)


@dataclass(frozen=True)
class Job:
    """One shape to bake.

    Attributes:
        path: The shape's file, absolute.
        out: The folder of the bake, absolute.
        record: What is known of it before.
        settings: How.
    """

    path: str
    out: str
    record: Record
    settings: Settings

    @property
    def bounder_path(self) -> Path:
        """Where the bounder goes."""
        return Path(self.out) / f"{self.record.key}{BOUNDER_FILE.suffix}"

    @property
    def record_path(self) -> Path:
        """Where the record goes."""
        return self.record.path_in(Path(self.out))

    def done(self) -> Record | None:
        """Its record, if it was baked without an error and its bounder's file is still what was written; else ``None``."""
        record = Record.read(self.record_path)
        if record is None or record.error:
            return None
        if record.file:
            try:
                content = self.bounder_path.read_bytes()
            except OSError:
                return None
            if hashlib.sha256(content).hexdigest() != record.sha256:
                return None
        return record


def bake_shape(job: Job) -> dict[str, Any]:
    """Bake one shape, unless that has been done; it runs on a worker.

    Dask asks again for what a worker had finished and told nobody when it died.

    Returns:
        The record, without the picture, which only the file has.

    Raises:
        FileFormatError: If the folder cannot be written to.
    """
    if (before := job.done()) is not None:
        return vars(replace(before, picture=""))
    started = time.perf_counter()
    os.environ.update(ONE_THREAD)
    quiet_warp()
    bounder, record = _made(job)
    if bounder is not None:
        bounder.save(job.bounder_path)
        content = job.bounder_path.read_bytes()
        record = replace(record, file=job.bounder_path.name, sha256=hashlib.sha256(content).hexdigest())
    record = replace(record, seconds=round(time.perf_counter() - started, 3))
    record.write(job.record_path)
    return vars(replace(record, picture=""))


def _made(job: Job) -> tuple[Any, Record]:
    """The bounder, or ``None``, and what is known of it before it is written."""
    from warp_bounding.evaluation import evaluate

    settings, record = job.settings, job.record
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", BoundingWarning)
        try:
            shape = load_indicator(job.path, **settings.reading)
            bounder = settings.bounder(shape)
            if bounder is None:
                return None, replace(record, method="none", note="no bounder pays")
            rates = evaluate(bounder, shape, samples=settings.samples)
            drawn = base64.b64encode(picture(bounder, shape)).decode()
        except (
            Exception
        ) as error:  # whatever a file makes a reader, a fit or a proof do: it is told, and the others go on
            return None, replace(record, error=_one_line(error, job.path))
    notes = dict.fromkeys(" ".join(str(w.message).split()) for w in caught if issubclass(w.category, BoundingWarning))
    return bounder, replace(
        record,
        method=bounder.method,
        query=bounder.query_kind,
        bytes=bounder.nbytes,
        certificate=bounder.certificate.kind if bounder.certificate else "",
        fp_rate=round(rates.fp_rate, 4),
        note="; ".join(notes),
        picture=drawn,
    )


def _one_line(error: Exception, path: str) -> str:
    """What went wrong, without the shape's path, which the record has."""
    text = " ".join(str(error).split()).removeprefix(f"{path}: ").removeprefix(f"{Path(path).name}: ")
    return text if isinstance(error, BoundingError) and text else f"{type(error).__name__}: {text}".rstrip(": ")


def looked_at(folders: list[str]) -> dict[str, Any]:
    """What a worker says before the first task: its version of the library, and which of the folders it cannot see."""
    return {"version": __version__, "missing": [folder for folder in folders if not Path(folder).exists()]}
