"""Where tasks run: processes of this machine, or any Dask cluster by the address of its scheduler.

Local workers are processes with one thread each, started again when they die; they end with the process that started them, however it ends.
"""

import contextlib
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from warp_bounding.baking import worker
from warp_bounding.baking.task import ONE_THREAD, looked_at
from warp_bounding.errors import BoundingError
from warp_bounding.runtime.launch import cpu_threads
from warp_bounding.version import __version__

__all__ = ["SchedulerError", "check_workers", "connected", "dashboard", "gone"]

DEATHS = 10  # of workers under the same task, after which it is given up: a shape that ends every process would go on for ever
CONNECT_SECONDS = 15


class SchedulerError(BoundingError):
    """The scheduler of a bake has gone away, or its workers cannot do the work; what was baked stays."""


@contextlib.contextmanager
def connected(jobs: int | None, scheduler: str | None) -> Iterator[Any]:
    """A Dask client of local workers, or of a scheduler.

    Args:
        jobs: Local workers; one a core if ``None``.
        scheduler: Address such as ``tcp://host:8786``; ``None`` for local workers.

    Raises:
        BoundingError: If Dask is not installed, or there is no such scheduler.
    """
    try:
        import dask
        import distributed
    except ImportError as error:
        raise BoundingError("baking needs Dask: pip install 'warp-bounding[bake]'") from error
    own = {
        "distributed.scheduler.allowed-failures": DEATHS,
        "distributed.scheduler.worker-saturation": 1.0,  # else a death also counts against the task that waits behind
        "logging.distributed": "critical",
    }
    with contextlib.ExitStack() as stack:
        stack.enter_context(_silent_logs())  # first, so that what is said while all else ends is kept off, too
        stack.enter_context(dask.config.set(own))
        try:
            if scheduler is None:
                cluster = stack.enter_context(
                    distributed.LocalCluster(
                        n_workers=jobs or cpu_threads(),
                        threads_per_worker=1,
                        processes=True,
                        memory_limit=0,
                        dashboard_address="127.0.0.1:0" if _has_dashboard() else None,
                        silence_logs=logging.CRITICAL,
                        env=ONE_THREAD,
                        preload=worker.__name__,
                    )
                )
                client = distributed.Client(cluster)
            else:
                client = distributed.Client(scheduler, timeout=CONNECT_SECONDS)
        except (OSError, TimeoutError, ValueError) as error:
            raise BoundingError(f"{scheduler or 'local workers'}: no scheduler answers ({_reason(error)})") from error
        stack.callback(client.close, timeout=2)
        yield client


def gone(client: Any) -> SchedulerError:
    """What to say when the connection to the scheduler is lost."""
    where = client.scheduler.address if client.scheduler else "the scheduler"
    return SchedulerError(f"{where} has gone away; what is baked stays, and the same command goes on")


def check_workers(client: Any, folders: list[Path]) -> None:
    """Find out before the first task whether the workers that are there can do the work.

    Raises:
        SchedulerError: If the scheduler has gone away, or a worker has another version of the library, or does not see a folder.
    """
    try:
        answers = client.run(looked_at, [str(folder) for folder in folders], on_error="return")
    except OSError as error:
        raise gone(client) from error
    for address, answer in answers.items():
        if isinstance(answer, OSError):
            continue  # a worker that dies meanwhile says nothing, and another one will do its tasks
        if isinstance(answer, Exception):
            raise SchedulerError(f"worker {address} cannot run warp-bounding: {_reason(answer)}")
        if answer["version"] != __version__:
            raise SchedulerError(f"worker {address} has warp-bounding {answer['version']}, expected {__version__}")
        if answer["missing"]:
            raise SchedulerError(
                f"worker {address} sees no {answer['missing'][0]}; expected folders that all workers share"
            )


def dashboard(client: Any) -> str | None:
    """The link of the scheduler's dashboard; ``None`` where it has none."""
    return client.dashboard_link if client.scheduler_info().get("services", {}).get("dashboard") else None


@contextlib.contextmanager
def _silent_logs() -> Iterator[None]:
    """Keep what Dask says of workers that die and connections that are lost off standard error; what matters is told."""
    loggers = [
        logging.getLogger(name) for name in list(logging.root.manager.loggerDict) if name.startswith("distributed")
    ]
    levels = [logger.level for logger in loggers]
    try:
        for logger in loggers:
            logger.setLevel(logging.CRITICAL)
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


def _has_dashboard() -> bool:
    try:
        import bokeh
    except ImportError:
        return False
    return bool(bokeh.__version__)


def _reason(error: BaseException) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__
