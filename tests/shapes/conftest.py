"""Shapes that the shape tests share."""

import numpy as np
import pytest


@pytest.fixture
def blob(rng: np.random.Generator) -> np.ndarray:
    """An asymmetric 3-D occupancy: no two axes can be swapped unnoticed."""
    return rng.random((4, 5, 6)) < 0.4
