"""Progress of long work: a bar or line on standard error if that is a terminal, or a function that the caller gives."""

import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from threading import Timer
from types import SimpleNamespace
from typing import Any

from warp_bounding.errors import BounderError
from warp_bounding.runtime import VERBOSE

Progress = Callable[[float, float, str], None]  # called with done and total, in any unit, and a note


@contextlib.contextmanager
def bar(description: str) -> Iterator[Any]:
    """A bar on standard error, where that is a terminal.

    Yields ``update(done, total, note="")``, with done in any unit.
    """
    from rich.console import Console
    from rich.progress import Progress, TextColumn

    columns = (*Progress.get_default_columns(), TextColumn("{task.fields[note]}"))
    err = Console(stderr=True)
    with Progress(*columns, console=err, transient=True, disable=not err.is_terminal) as progress:
        task = progress.add_task(description, total=1.0, note="")

        def update(done: float, total: float = 1.0, note: str = "") -> None:
            progress.update(task, completed=done / total if total else 0, note=note)

        yield update


@contextlib.contextmanager
def reported(progress: Progress | bool | None, description: str) -> Iterator[Progress | None]:
    """The function to call with done, total and a note, or ``None``; ``BounderError`` where ``progress`` is neither.

    ``progress`` is a function; ``None`` for a bar with this description, if standard error is a terminal; ``False`` for
    nothing.
    """
    if callable(progress):
        yield progress
    elif progress is None and sys.stderr is not None and sys.stderr.isatty():
        with bar(description) as update:
            yield update
    elif progress is None or progress is False:
        yield None
    else:
        raise BounderError(f"progress must be a function, None or False, got {progress!r}")


SLOW = 2.0  # seconds after which work that has no bar is reported


@contextlib.contextmanager
def slow(what: str, after: float = SLOW) -> Iterator[None]:
    """Report work that takes more than so many seconds, while it runs: a line on standard error, if that is a terminal.

    ``what`` names the work, as in "reading room.yaml".
    """

    def report() -> None:
        if sys.stderr is not None and sys.stderr.isatty():
            print(f"warp-bounding: {what}", file=sys.stderr, flush=True)

    timer = Timer(after, report)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


# Warp without its own messages: they would stand between a command's own, or in what a program reads.


def quiet_warp(device: str | None = None) -> None:
    """Start Warp once, and divert its messages: to standard error where ``VERBOSE`` is set, elsewhere to nowhere.

    Raises ``DeviceError`` if there is no such device.
    """
    import warp as wp  # here, so that a command line need not wait for it to show its help

    from warp_bounding.runtime.launch import device_of

    if os.environ.get(VERBOSE):

        def told(message: str, *_: Any, **__: Any) -> None:
            print(message, file=sys.stderr, flush=True)

        wp.set_logger(SimpleNamespace(debug=told, info=told, warning=told, error=told))
    else:
        wp.config.log_level, wp.config.quiet = wp.LOG_ERROR, True
    with silent_errors():  # a machine without a GPU is no news
        wp.init()
    device_of(device)


@contextlib.contextmanager
def silent_errors() -> Iterator[None]:
    """Discard what native code writes to standard error."""
    if sys.stderr is not None:
        sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
