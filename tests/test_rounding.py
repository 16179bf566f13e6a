"""Rounding is on the safe side."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from warp_bounding import rounding
from warp_bounding.rounding import UNIT32, UNIT64, gamma, round_down, round_up

F32 = np.float32
DOUBLES = st.floats(allow_nan=False, allow_infinity=False)


@settings(deadline=None, max_examples=300)
@given(DOUBLES)
def test_a_number_is_rounded_to_its_nearest_float32_below_and_above(value):
    below, above = round_down(value)[()], round_up(value)[()]
    assert below.dtype == above.dtype == F32
    assert float(below) <= value <= float(above)
    with np.errstate(over="ignore"):
        assert float(np.nextafter(below, F32(np.inf))) > value > float(np.nextafter(above, F32(-np.inf)))


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
    allowed = gamma(len(a) + 1) * float((np.abs(a.astype(float)) * np.abs(b)).sum()) + len(a) * 2 * rounding.TINY
    for _ in range(5):
        order, total = rng.permutation(len(a)), F32(0)
        for i in order:
            total = F32(total + a[i] * b[i])
        assert abs(float(total) - exact) <= allowed
