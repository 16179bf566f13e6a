"""What all file readers share: one clear error for whatever goes wrong inside somebody else's reader."""

import contextlib
import importlib
import os
import signal
import threading
from collections.abc import Iterator
from types import ModuleType

from warp_bounding.errors import IndicatorError

__all__ = ["import_optional", "reading"]

LONGEST_REASON = 200  # characters of a foreign error message that go into ours


@contextlib.contextmanager
def reading(path: str | os.PathLike, expected: str) -> Iterator[None]:
    """Turn every exception of a foreign reader into one ``IndicatorError`` of one line.

    The readers of the file formats raise dozens of exception types on damaged input (``SyntaxError``, ``KeyError``,
    ``struct.error``, ...), none of them documented; hence the broad catch, which hides nothing: the cause is chained.

    Args:
        path: The file, for the message.
        expected: What the file should hold.

    Raises:
        IndicatorError: Naming the file, what was expected and what came.
    """
    try:
        yield
    except IndicatorError:
        raise
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        reason = f"{reason} is missing" if isinstance(error, KeyError) else reason
        reason = reason if len(reason) <= LONGEST_REASON else reason[: LONGEST_REASON - 3] + "..."
        raise IndicatorError(f"{path}: expected {expected}, but it cannot be read: {reason}") from error


@contextlib.contextmanager
def _interrupts_held() -> Iterator[None]:
    """Keep Ctrl-C until the end: packages that look for optional parts of their own swallow whatever is raised meanwhile."""
    handler, held = signal.getsignal(signal.SIGINT), []
    if threading.current_thread() is not threading.main_thread() or not callable(handler):
        yield
        return
    signal.signal(signal.SIGINT, lambda *caught: held.append(caught))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
    if held:
        handler(*held[0])


def import_optional(module: str, package: str, path: str | os.PathLike) -> ModuleType:
    """Import a module of an optional dependency.

    Args:
        module: Such as ``"PIL.Image"``.
        package: The name that pip knows, for the message.
        path: The file that needs it, for the message.

    Raises:
        IndicatorError: Where it is not installed, with the command that installs it.
    """
    try:
        with _interrupts_held():
            return importlib.import_module(module)
    except ImportError as error:
        hint = "pip install 'warp-bounding[train]'"
        raise IndicatorError(f"{path}: reading it needs {package}, which is not installed; run {hint}") from error
