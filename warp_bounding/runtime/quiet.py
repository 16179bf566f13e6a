"""Warp without its own messages: they would stand between a command's own, or in what a program reads."""

import contextlib
import os
import sys
from collections.abc import Iterator

import warp as wp

__all__ = ["quiet_warp"]


def quiet_warp() -> None:
    """Start Warp, if it has not been started, and keep its messages off standard output and standard error from here on."""
    wp.config.log_level = getattr(wp, "LOG_ERROR", 40)
    wp.config.quiet = True
    with _silent_errors():  # a machine without a GPU is no news
        wp.init()


@contextlib.contextmanager
def _silent_errors() -> Iterator[None]:
    """Discard what native code writes to standard error."""
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
