"""Interval arithmetic: the exact result of any two numbers of the operands lies in the computed interval."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from warp_bounding.indicators.formula import Interval, norm, widened

NUMBERS = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False),
    st.floats(-4, 4),
    st.sampled_from([0.0, -0.0, 5e-324, -5e-324, 1e-200, 1e200, 1.7976931348623157e308, 2.0**-1022, 1.0, 0.1]),
)
PAIRS = st.tuples(NUMBERS, NUMBERS).map(sorted)


def interval(pair) -> Interval:
    return Interval(np.array([pair[0]]), np.array([pair[1]]))


def points(pair) -> list[Fraction]:
    """The ends of an interval, and what lies in the middle."""
    low, high = map(Fraction, pair)
    return [low, high, (low + high) / 2]


def holds(found: Interval, value: Fraction) -> bool:
    low, high = float(found.low[0]), float(found.high[0])
    assert not np.isnan([low, high]).any()
    assert low < math.inf
    assert high > -math.inf
    return (low == -math.inf or Fraction(low) <= value) and (high == math.inf or value <= Fraction(high))


def holds_root(found: Interval, square: Fraction) -> bool:
    low, high = float(found.low[0]), float(found.high[0])
    return Fraction(low) ** 2 <= square and (high == math.inf or square <= Fraction(high) ** 2)


@given(PAIRS, PAIRS)
def test_operations_hold_the_exact_results(p, q):
    a, b = interval(p), interval(q)
    with np.errstate(all="ignore"):
        total, difference, product = a + b, a - b, a * b
        most, least, square, size = a.maximum(b), a.minimum(b), a.square(), a.magnitude()
        positive = Interval(*(np.maximum(side, 1e-300) for side in (b.low, b.high)))
        quotient, length, root = a / positive, norm([a, b]), size.root()
    for x in points(p):
        for y in points(q):
            assert holds(total, x + y)
            assert holds(difference, x - y)
            assert holds(product, x * y)
            assert holds(most, max(x, y))
            assert holds(least, min(x, y))
            assert holds_root(length, x * x + y * y)
            assert holds(quotient, x / max(y, Fraction(1e-300)))
        assert holds(square, x * x)
        assert holds(size, abs(x))
        assert holds_root(root, abs(x))


@given(NUMBERS, NUMBERS)
def test_the_sign_of_a_difference_is_exact(x, y):
    with np.errstate(all="ignore"):
        gap = Interval(np.array([x])) - y
    assert (gap.low[0] > 0) <= (x > y)
    if abs(x - y) > 5e-324 and math.isfinite(x - y):
        assert (gap.low[0] > 0) == (x > y)
        assert (gap.high[0] < 0) == (x < y)
    if x == y:
        assert gap.low[0] == gap.high[0] == 0


@given(NUMBERS, st.floats(0, 1e300), st.sampled_from([-1, 1]))
def test_corners_move_outwards(corner, step, sign):
    found = float(widened(np.array([corner]), step, sign)[0])
    exact = Fraction(corner) + sign * Fraction(step)
    if math.isfinite(found):
        assert sign * (Fraction(found) - exact) >= 0
        if Fraction(float(exact) if abs(exact) < 2**1023 else 0) == exact:
            assert found == exact, "what float64 holds is kept"


def test_coordinates_of_a_norm_may_be_one():
    found = norm([Interval(np.array([-3.0]), np.array([2.0]))])
    assert (found.low[0], found.high[0]) == (0.0, 3.0)
    with pytest.raises(ValueError, match="unpack"):
        norm([])
