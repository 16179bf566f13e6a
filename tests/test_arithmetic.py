"""Rounding helpers are on the safe side, and the sine and the tanh are within their bounds, fused or not."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from warp_bounding import arithmetic
from warp_bounding.arithmetic import (
    SINE_LIMIT,
    TANH_DENOMINATOR,
    TANH_END,
    TANH_NUMERATOR,
    UNIT32,
    UNIT64,
    gamma,
    round_down,
    round_up,
    sine,
    sine_error,
    tanh32,
    tanh_error,
)

F32 = np.float32
DOUBLES = st.floats(allow_nan=False, allow_infinity=False)


@settings(deadline=None, max_examples=300)
@given(DOUBLES)
def test_round_down_is_the_largest_float32_below(value):
    below = round_down(value)[()]
    assert below.dtype == F32
    assert float(below) <= value
    with np.errstate(over="ignore"):
        assert float(np.nextafter(below, F32(np.inf))) > value


@settings(deadline=None, max_examples=300)
@given(DOUBLES)
def test_round_up_is_the_smallest_float32_above(value):
    above = round_up(value)[()]
    assert float(above) >= value
    with np.errstate(over="ignore"):
        assert float(np.nextafter(above, F32(-np.inf))) < value


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_float32_numbers_stay(value):
    assert round_down(value) == value == round_up(value)


def test_rounding_works_on_arrays_and_at_the_ends():
    values = np.array([1 / 3, -1 / 3, 1e300, -1e300, 1e-300, -1e-300])
    down, up = round_down(values), round_up(values)
    assert down.dtype == up.dtype == F32
    assert (down.astype(float) < values).all()
    assert (up.astype(float) > values).all()


@settings(deadline=None, max_examples=200)
@given(st.integers(0, 10**6), st.sampled_from([UNIT32, UNIT64]))
def test_gamma_bounds_the_growth_of_roundings(count, unit):
    from fractions import Fraction

    k = Fraction(count) * Fraction(unit)
    assert Fraction(gamma(count, unit)) >= k / (1 - k)


def test_gamma_refuses_what_has_no_bound():
    with pytest.raises(ValueError, match="count="):
        gamma(2**23)


@settings(deadline=None, max_examples=100)
@given(st.lists(st.floats(-1e3, 1e3, width=32), min_size=1, max_size=40), st.integers(0, 2**32 - 1))
def test_gamma_bounds_a_float32_sum_of_products(values, seed):
    rng = np.random.default_rng(seed)
    a, b = np.array(values, dtype=F32), rng.normal(size=len(values)).astype(F32)
    exact = float((a.astype(np.longdouble) * b.astype(np.longdouble)).sum())
    allowed = gamma(len(a) + 1) * float((np.abs(a.astype(float)) * np.abs(b)).sum()) + len(a) * 2 * arithmetic.TINY
    for _ in range(5):
        order, total = rng.permutation(len(a)), F32(0)
        for i in order:
            total = F32(total + a[i] * b[i])
        assert abs(float(total) - exact) <= allowed


def fused_sine(z: np.ndarray) -> np.ndarray:
    """The kernels' sine with every multiply-add fused: float64 holds such products exactly, one rounding follows.

    The sum is rounded twice (to float64, then to float32); that differs from a true fused operation at exact ties only,
    and by no more than one unit in 2^29 of the last place.
    """

    def fma(a, b, c):
        return (a.astype(np.float64) * np.float64(b) + np.asarray(c, dtype=np.float64)).astype(F32)

    def fma_array(a, b, c):
        return (a.astype(np.float64) * b.astype(np.float64) + np.asarray(c, dtype=np.float64)).astype(F32)

    q = fma(z, F32(arithmetic.SINE_INVERSE_PI), arithmetic.SINE_MAGIC)
    n = q - F32(arithmetic.SINE_MAGIC)
    r = fma(n, -F32(arithmetic.SINE_PI_LOW), fma(n, -F32(arithmetic.SINE_PI_HIGH), z))
    r2 = r * r
    s1, s2, s3 = (F32(c) for c in arithmetic.SINE_COEFFICIENTS)
    inner = fma_array(r2, fma(r2, s3, s2), s1)
    p = fma_array(r * r2, inner, r)
    return np.where(q.view(np.int32) & 1, -p, p)


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


def fused_tanh(z: np.ndarray) -> np.ndarray:
    """The kernels' tanh with every multiply-add fused; see ``fused_sine``."""
    z = np.clip(z, F32(-TANH_END), F32(TANH_END))
    s = z * z
    numerator, denominator = (np.full_like(z, c[-1]) for c in (TANH_NUMERATOR, TANH_DENOMINATOR))
    for c in TANH_NUMERATOR[-2::-1]:
        numerator = (s.astype(np.float64) * numerator + c).astype(F32)
    for c in TANH_DENOMINATOR[-2::-1]:
        denominator = (s.astype(np.float64) * denominator + c).astype(F32)
    return z * numerator / denominator


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
