"""Fixtures and options that all tests share."""

import numpy as np
import pytest
import warp as wp

wp.config.log_level = getattr(wp, "LOG_ERROR", 40)
wp.config.quiet = True
wp.init()

CUDA = "cuda:0"


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


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)
