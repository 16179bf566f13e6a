"""What all file readers share: one clear error for whatever goes wrong inside somebody else's reader."""

import contextlib
import importlib
import os
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
        reason = reason if len(reason) <= LONGEST_REASON else reason[: LONGEST_REASON - 3] + "..."
        raise IndicatorError(f"{path}: expected {expected}, but it cannot be read: {reason}") from error


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
        return importlib.import_module(module)
    except ImportError as error:
        hint = "pip install 'warp-bounding[train]'"
        raise IndicatorError(f"{path}: reading it needs {package}, which is not installed; run {hint}") from error
