"""Shares of a job on the library's own threads, each of which runs torch on one core.

Torch's own thread pool spins at its barriers, which costs a multiple of these short steps wherever another process uses
a core; threads that sleep in the operating system do not.
"""

import contextlib
from collections.abc import Callable, Iterator
from functools import partial
from threading import local

import torch

from warp_bounding.runtime.launch import cpu_threads, run_shares

__all__ = ["Team", "single_threaded_torch"]

_own = local()  # of each thread
CHUNK = 1024  # things that a thread does at a time, such as samples that it evaluates


class Team:
    """Runs ``job(k)`` for k in 0 .. size - 1, the number of threads; as many as launches use if ``None``."""

    def __init__(self, size: int | None = None):
        self.size = size or cpu_threads()

    def run(self, job: Callable[[int], None]) -> None:
        """Run a job on every thread, without autograd, and wait for all; an error in one is raised here."""

        def share(index: int) -> None:
            if not hasattr(_own, "single"):  # torch keeps this number for each thread
                _own.single = torch.set_num_threads(1)
            with torch.no_grad():
                job(index)

        run_shares([partial(share, index) for index in range(self.size)])

    def share(self, index: int, count: int) -> slice:
        """Thread ``index``'s part of ``count`` things."""
        return slice(*(count * k // self.size for k in (index, index + 1)))

    def over(self, count: int, job: Callable[[int, slice], None]) -> None:
        """Run ``job(k, part)`` over ``count`` things: thread k goes through its share in parts of at most ``CHUNK``."""

        def go(index: int) -> None:
            own = self.share(index, count)
            for start in range(own.start, own.stop, CHUNK):
                job(index, slice(start, min(start + CHUNK, own.stop)))

        self.run(go)


@contextlib.contextmanager
def single_threaded_torch() -> Iterator[None]:
    """Torch on one thread and without autograd, as it was before afterwards."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with torch.no_grad():
            yield
    finally:
        torch.set_num_threads(threads)
