"""Dask workers for this process: processes of this machine, or the workers of a running scheduler."""

import contextlib
import logging
import os
import pickle
import signal
from collections.abc import Callable, Iterator
from typing import Any

from warp_bounding.errors import BoundingError
from warp_bounding.runtime.launch import cpu_threads
from warp_bounding.runtime.progress import quiet_warp

DEATHS = 10  # workers that may die during the same task before it fails, so that retries end
CONNECT_SECONDS = 15
# A worker uses one core: the variables that limit this library's threads, and those of the libraries below it.
THREADS = ("WARP_BOUNDING_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
ONE_THREAD = dict.fromkeys(THREADS, "1")


def dask_setup(worker: object) -> None:
    """Dask calls this in a new worker: it ignores Ctrl-C, and prints to standard error, which spares ``--json``."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.dup2(2, 1)


@contextlib.contextmanager
def connected(scheduler: str | int | None) -> Iterator[Any]:
    """A Dask client of the scheduler at an address, or of a number of local workers (``None``: one a core).

    Dask restarts workers that die. Raises ``BoundingError`` without Dask, or if no scheduler answers.
    """
    whole = isinstance(scheduler, int) and not isinstance(scheduler, bool) and scheduler >= 1
    if not (scheduler is None or isinstance(scheduler, str) or whole):
        raise BoundingError(f"scheduler must be an address or a number of processes, got {scheduler!r}")
    try:
        import dask
        import distributed
    except ImportError as error:
        raise BoundingError("work on many processes needs Dask: pip install 'warp-bounding[bake]'") from error
    own = {
        "distributed.scheduler.allowed-failures": DEATHS,
        "distributed.scheduler.worker-saturation": 1.0,  # else a death also counts against the worker's queued task
        "logging.distributed": "critical",
    }
    with contextlib.ExitStack() as stack:
        stack.enter_context(dask.config.set(own))
        try:
            if isinstance(scheduler, str):
                client = distributed.Client(scheduler, timeout=CONNECT_SECONDS)
            else:
                workers = {"n_workers": scheduler or cpu_threads(), "threads_per_worker": 1, "memory_limit": 0}
                workers |= {"silence_logs": logging.CRITICAL, "env": ONE_THREAD, "preload": __name__}
                cluster = distributed.LocalCluster(**workers, dashboard_address="127.0.0.1:0")
                client = distributed.Client(stack.enter_context(cluster))
        except (OSError, TimeoutError, ValueError) as error:
            reason = " ".join(str(error).split())[:200] or type(error).__name__
            name = scheduler if isinstance(scheduler, str) else "local workers"
            raise BoundingError(f"{name}: no scheduler answers ({reason})") from error
        stack.callback(client.close, timeout=2)
        client.run(os.getpid, on_error="return")  # Dask restarts no worker that dies before its first answer
        yield client


class Workers:
    """A context in which Dask workers run functions; arguments as in ``connected``."""

    def __init__(self, scheduler: str | int):
        self._connected, self._running = connected(scheduler), {}

    def __enter__(self) -> "Workers":
        self._client = self._connected.__enter__()
        return self

    def __exit__(self, kind: Any, error: Any, trace: Any) -> None:
        with contextlib.suppress(OSError, RuntimeError):  # the scheduler may be gone
            self._client.cancel(list(self._running.values()))
            self._connected.__exit__(kind, error, trace)
        if isinstance(error, OSError):
            raise BoundingError("the scheduler has gone away") from error

    @property
    def count(self) -> int:
        """Tasks that the workers can run at the same time now; at least 1."""
        return max(1, sum(self._client.nthreads().values()))

    def held(self, value: Any) -> Any:
        """A future of a value that tasks take as an argument; it is sent to each worker once."""
        return self._client.submit(pickle.loads, pickle.dumps(value), pure=False)

    def submit(self, function: Callable, *arguments: Any) -> str:
        """Run a function in a worker; returns the task's key."""
        future = self._client.submit(_alone, function, *arguments, pure=False)
        self._running[future.key] = future
        return future.key

    def ended(self, seconds: float) -> list[tuple[str, Any]]:
        """Keys and results of the tasks that have ended; waits up to some seconds for the first of them.

        Raises ``BoundingError`` if a task fails.
        """
        import distributed

        with contextlib.suppress(TimeoutError):
            distributed.wait(list(self._running.values()), timeout=seconds, return_when="FIRST_COMPLETED")
        done = []
        for key, future in list(self._running.items()):
            if future.status == "pending":
                continue
            if future.status != "finished":
                error = future.exception() if future.status == "error" else None
                reason = f"{type(error).__name__}: {error}" if error else "the scheduler has gone away"
                raise BoundingError(" ".join(reason.split())[:300])
            done.append((key, future.result()))
            del self._running[key]
            future.release()  # else Dask repeats it if the worker that holds its result dies: others refer to it, too
        return done


def _alone(function: Callable, *arguments: Any) -> Any:
    """Runs a function in a worker, on one core and without Warp's messages."""
    os.environ.update(ONE_THREAD)
    quiet_warp()
    return function(*arguments)
