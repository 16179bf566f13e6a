"""Fixtures and options that all tests share, and how many processes they run in."""

import os
import time
from collections.abc import Callable

import numpy as np
import pytest
import warp as wp

# the cores are shared out already: torch's own threads would only wait for each other
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("OMP_NUM_THREADS", "1")

wp.config.log_level = getattr(wp, "LOG_ERROR", 40)
wp.config.quiet = True
wp.init()

CUDA = "cuda:0"
MOST_WORKERS = 8  # a worker holds about a gigabyte


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """What ``-n auto`` means: a worker for each core of this process; with one core all runs in this process."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(cores, MOST_WORKERS) if cores > 1 else 0


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--slow", action="store_true", help="run the tests that take minutes, too")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--slow"):
        return
    skip = pytest.mark.skip(reason="takes minutes; run with --slow")
    for item in items:
        if "slow" in item.keywords:
            item.add_marker(skip)


@pytest.fixture(params=["cpu", CUDA])
def device(request: pytest.FixtureRequest) -> str:
    if request.param == CUDA and not wp.get_cuda_device_count():
        pytest.skip("there is no CUDA device")
    return request.param


class Ticking:
    """A clock that goes on by ``tick`` seconds whenever it is looked at: the same on every machine."""

    def __init__(self, tick: float):
        self.tick, self.seconds = tick, 0.0

    def __call__(self) -> float:
        self.seconds += self.tick
        return self.seconds


@pytest.fixture
def ticking(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], Ticking]:
    """Called with a tick: the package's own clock is such a one for the rest of the test."""

    def start(tick: float) -> Ticking:
        clock = Ticking(tick)
        monkeypatch.setattr(time, "perf_counter", clock)
        return clock

    return start


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)
