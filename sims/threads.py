"""How many threads of a CPU batch queries take for a while, for times that can be compared."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["threads_of"]

VARIABLE = "WARP_BOUNDING_THREADS"  # of the environment


@contextmanager
def threads_of(count: int) -> Iterator[None]:
    """Let batch queries use at most so many threads; what was before is restored."""
    before = os.environ.get(VARIABLE)
    os.environ[VARIABLE] = str(count)
    try:
        yield
    finally:
        del os.environ[VARIABLE]
        if before is not None:
            os.environ[VARIABLE] = before
