"""Shapes that the indicator tests share."""

from collections.abc import Callable
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@pytest.fixture
def blob(rng: np.random.Generator) -> np.ndarray:
    """An asymmetric 3-D occupancy: no two axes can be swapped unnoticed."""
    return rng.random((4, 5, 6)) < 0.4


@pytest.fixture(scope="session")
def bunny_path() -> Path:
    warp = pytest.importorskip("warp")
    pytest.importorskip("pxr", reason="usd-core is not installed")
    return Path(warp.__file__).parent / "examples" / "assets" / "bunny.usd"


def _write_binvox(path: Path, occupancy: np.ndarray) -> None:
    """Write ``(X, Y, Z)`` bool in the file's own order x, z, y, in runs of at most 255."""
    x, y, z = occupancy.shape
    data = bytearray()
    for value, run in groupby(occupancy.transpose(0, 2, 1).ravel().tolist()):
        left = len(list(run))
        while left:
            data += bytes([value, min(left, 255)])
            left -= min(left, 255)
    header = f"#binvox 1\ndim {x} {z} {y}\ntranslate -0.5 0 1e-3\nscale 1.5\ndata\n"
    path.write_bytes(header.encode() + bytes(data))


@pytest.fixture(scope="session")
def write_binvox() -> Callable[[Path, np.ndarray], None]:
    return _write_binvox
