"""What the runs that fit bounders have in common: fit one as a table's settings say, or load one that is fitted; Ctrl-C; failures."""

import contextlib
import signal
import threading
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from warp_bounding.bounders import METHODS
from warp_bounding.bounders.options import taken
from warp_bounding.errors import BoundingError
from warp_bounding.paper.plan import Job
from warp_bounding.paper.settings import Settings
from warp_bounding.paper.tools import Tools

__all__ = ["FAILURES", "fit_bounder", "interruptions", "load_bounder", "reason_of"]

FAILURES = (Exception,)  # whatever ends one cell of a long run is reported, and the others go on


def fit_bounder(
    job: Job, grid: Any, settings: Settings, tools: Tools, progress: Callable[..., None], last: Any | None = None
) -> Any:
    """Fit the bounder of a job, a cascade's from its ``last`` part; an interruption may end it early, see ``interruptions``."""
    method, query = job.variant.method, job.column.query
    told = {"hidden": job.column.hidden, "activation": settings.activation, "leaves": job.variant.leaves}
    known = taken((METHODS[name] for name in method.split("+")), query)
    options = {name: value for name, value in told.items() if name in known and value is not None}
    options |= {"last": last} if last is not None else {}
    options |= {"length": settings.length} if query == "ray" else {}
    options |= {"space": job.space} if query != "point" else {}
    return tools.fit(
        grid,
        query=query,
        method=method,
        budget=settings.budget_of(job.column, job.variant),
        seed=settings.seed,
        device=settings.device,
        progress=progress,
        **options,
    )


def load_bounder(path: Path, grid: Any, settings: Settings, tools: Tools, say: Callable[[str], None]) -> Any | None:
    """The bounder that an earlier run fitted, unless it is damaged or of something else; then people are told."""
    try:
        bounder = tools.load(path, device=settings.device)
    except BoundingError as error:
        say(f"{error}; fitted again")
        return None
    if (bounder.info.get("indicator"), bounder.info.get("seed")) == (grid.digest, settings.seed):
        return bounder
    say(f"{path}: fitted to another object or with another seed; fitted again")
    return None


def reason_of(error: BaseException) -> str:
    """A failure in one line; of what is no error of ours, also its type and where it was raised."""
    reason = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, BoundingError):
        return reason
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {reason}{where}"


@contextlib.contextmanager
def interruptions() -> Iterator[threading.Event]:
    """An event that Ctrl-C sets, besides raising ``KeyboardInterrupt``: a callee may swallow that and return early."""
    event = threading.Event()
    unheard = signal.getsignal(signal.SIGINT) == signal.SIG_IGN  # as in a shell's background jobs
    if unheard or threading.current_thread() is not threading.main_thread():
        yield event
        return

    def handler(number, frame):
        event.set()
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, handler)
    try:
        yield event
    finally:
        signal.signal(signal.SIGINT, before)
