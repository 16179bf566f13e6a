"""The clock of budgets, which stands still while kernels are compiled, and limits of time for work that has none of its own.

A kernel is compiled, or loaded from Warp's cache, before its first launch. That takes seconds of which a budget should know nothing.
"""

import contextlib
import math
import time
from collections.abc import Iterator
from threading import local

__all__ = ["OutOfTimeError", "compile_seconds", "compiled_for", "limited", "working_seconds"]


class OutOfTimeError(Exception):
    """Work in ``limited`` has taken longer than it may."""


class _Own(local):
    """What each thread has for itself: another one's compiling would turn its clock back."""

    compiling = 0.0  # seconds that it has spent on compiling
    end = math.inf  # of its work, by its own clock


_own = _Own()


def compiled_for(seconds: float) -> None:
    """Tell the clock that this thread has just compiled for so long."""
    _own.compiling += seconds


def compile_seconds() -> float:
    """Time that this thread has spent on compiling and loading the library's kernels."""
    return _own.compiling


def working_seconds() -> float:
    """The clock of budgets: ``time.perf_counter``, but it stands still while this thread compiles kernels.

    Raises:
        OutOfTimeError: In ``limited``, after its time.
    """
    now = time.perf_counter() - _own.compiling
    if now > _own.end:
        raise OutOfTimeError
    return now


@contextlib.contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Work of this thread that may take so many ``working_seconds``, for what has no limit of its own, such as proofs of closed forms.

    It ends at its first look at that clock, or its first launch of a kernel for one use, after this time. A limit within another one ends no
    later than that.

    Raises:
        OutOfTimeError: Where the work did not end in time; what it was making is lost.
    """
    before = _own.end
    _own.end = min(before, working_seconds() + seconds)
    try:
        yield
    finally:
        _own.end = before
