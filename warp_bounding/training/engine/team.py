"""Plain threads that each run torch on one core.

Torch's own thread pool spins at its barriers, which costs a multiple of these short steps wherever another process uses
a core; threads that sleep in the operating system do not.
"""

import contextlib
import queue
import threading
from collections.abc import Callable, Iterator

import torch

__all__ = ["Team", "single_threaded_torch"]


class Team:
    """Run ``job(k)`` for k in 0 .. size - 1, job 0 on the caller's thread.

    Args:
        size: Number of threads, the caller's included.
    """

    def __init__(self, size: int):
        self.size = size
        self._inboxes = [queue.SimpleQueue() for _ in range(size - 1)]
        self._results = queue.SimpleQueue()
        self._threads = [threading.Thread(target=self._serve, args=(k,), daemon=True) for k in range(1, size)]
        for thread in self._threads:
            thread.start()

    def _serve(self, index: int) -> None:
        torch.set_num_threads(1)
        torch.set_grad_enabled(False)
        while (job := self._inboxes[index - 1].get()) is not None:
            try:
                job(index)
                self._results.put(None)
            except BaseException as error:  # handed to the caller, who raises it
                self._results.put(error)

    def run(self, job: Callable[[int], None]) -> None:
        """Run a job on every thread and wait for all; an error in one is raised here."""
        for inbox in self._inboxes:
            inbox.put(job)
        try:
            job(0)
        finally:
            errors = [error for error in (self._results.get() for _ in self._inboxes) if error is not None]
        if errors:
            raise errors[0]

    def share(self, index: int, count: int) -> slice:
        """Thread ``index``'s part of ``count`` things."""
        return slice(*(count * k // self.size for k in (index, index + 1)))

    def over(self, count: int, job: Callable[[int, slice], None], chunk: int) -> None:
        """Run ``job(k, part)`` over ``count`` things: thread k goes through its share in parts of at most ``chunk``."""

        def go(index: int) -> None:
            own = self.share(index, count)
            for start in range(own.start, own.stop, chunk):
                job(index, slice(start, min(start + chunk, own.stop)))

        self.run(go)

    def __enter__(self) -> "Team":
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def close(self) -> None:
        """End the threads."""
        for inbox in self._inboxes:
            inbox.put(None)
        for thread in self._threads:
            thread.join()


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
