"""The sine is within its bound, fused or not."""

import numpy as np
import pytest
from fused_activations import fused_sine

from warp_bounding.activations import SINE, SINE_LIMIT

F32 = np.float32
sine, sine_error = SINE.value32, SINE.error


@pytest.mark.parametrize("evaluate", [sine, fused_sine], ids=["unfused", "fused"])
@pytest.mark.parametrize("limit", [0.5, 1.6, 10.0, 300.0, SINE_LIMIT])
def test_sine_stays_within_its_bound(evaluate, limit, rng):
    dense = np.linspace(-limit, limit, 400_001).astype(F32)
    multiples = np.arange(-int(limit / np.pi * 2) - 1, int(limit / np.pi * 2) + 2) * (np.pi / 2)
    near = np.float32(multiples)[:, None].view(np.int32) + np.arange(-40, 41, dtype=np.int32)
    near = near.view(F32).ravel()
    random = (rng.choice([-1, 1], 100_000) * limit * 10 ** rng.uniform(-12, 0, 100_000)).astype(F32)
    z = np.concatenate([dense, near, random, F32([0.0, -0.0, limit, -limit])])
    z = z[np.isfinite(z) & (np.abs(z) <= limit)]
    truth = np.sin(z.astype(np.longdouble))
    error = np.abs(evaluate(z).astype(np.longdouble) - truth).max()
    assert error <= sine_error(limit)
    assert sine_error(limit) < 4 * max(error, 1e-7) + 1e-6  # and the bound is worth something


def test_sine_error_grows_with_the_limit_and_ends_somewhere():
    limits = np.linspace(0, SINE_LIMIT, 50)
    errors = [sine_error(float(limit)) for limit in limits]
    assert errors == sorted(errors)
    for wrong in (-1.0, SINE_LIMIT * 1.001, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="certified"):
            sine_error(wrong)
