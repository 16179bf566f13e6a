"""The tanh is within its bound, fused or not."""

import numpy as np
import pytest
from fused_activations import fused_tanh

from warp_bounding.activations import TANH, TANH_DENOMINATOR, TANH_END, TANH_NUMERATOR

F32 = np.float32
tanh32 = TANH.value32


def tanh_error() -> float:
    return TANH.error(1e30)


@pytest.mark.parametrize("evaluate", [tanh32, fused_tanh], ids=["unfused", "fused"])
def test_tanh_stays_within_its_bound(evaluate, rng):
    end = np.float32([TANH_END, -TANH_END])[:, None].view(np.int32) + np.arange(-400, 401, dtype=np.int32)
    random = (rng.choice([-1, 1], 200_000) * 10 ** rng.uniform(-38, 37, 200_000)).astype(F32)
    z = np.concatenate([np.linspace(-12, 12, 1_000_001).astype(F32), end.view(F32).ravel(), random, F32([0.0, -0.0])])
    error = np.abs(evaluate(z).astype(np.longdouble) - np.tanh(z.astype(np.longdouble))).max()
    assert error <= tanh_error()
    assert tanh_error() < 3e-6  # and the bound is worth something


def test_coefficients_of_the_tanh_are_float32_and_positive():
    """The proof of ``tanh_error`` builds on it."""
    for c in (*TANH_NUMERATOR, *TANH_DENOMINATOR):
        assert c > 0
        assert float(F32(c)) == c
    assert TANH_DENOMINATOR[0] == 1
