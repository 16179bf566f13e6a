"""Functions as shapes: what they certify is true if what is claimed of them is, and false claims are found."""

import math
from contextlib import suppress
from fractions import Fraction
from itertools import count

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import warp_bounding as wb
from warp_bounding.shapes.function import _above, _below, _length, _widened
from warp_bounding.shapes.shape import IN, OUT

DIMENSIONS = (1, 2, 3, 5)


def ball_distance(x):
    return np.linalg.norm(x, axis=1) - 1.0


def ball_empty(lower, upper):
    near = np.maximum(np.maximum(lower, -upper), 0.0)
    return (near**2).sum(axis=1) > 1.0 + 1e-9


def ball(n, **options):
    return wb.shapes.Function(None, [-1.0] * n, [1.0] * n, **({"distance": ball_distance} | options))


def in_ball(x):
    assert np.isfinite(x).all(), "only finite points are asked about"
    return ball_distance(x) <= 0


def test_what_the_author_knows_of_boxes(rng):
    """``empty`` is asked about boxes that meet the shape's; without it or a distance nothing is certified."""
    asked = []

    def empty(lower, upper):
        asked.append(len(lower))
        return ball_empty(lower, upper)

    lower = rng.uniform(-1.5, 1.5, (1000, 3))
    upper = lower + 10.0 ** rng.uniform(-7, 0, (1000, 1)) * rng.random(lower.shape)
    shape = wb.shapes.Function(in_ball, [-1] * 3, [1] * 3, empty=empty)
    assert (shape.empty(lower, upper) >= ball_empty(lower, upper)).all()
    assert max(asked) < 1000
    assert shape.distance(lower) is None
    for ask in (lambda: shape.dilated(0.1), lambda: shape.to_grid(resolution=8, margin=0.1)):
        with pytest.raises(wb.ShapeError, match="a function is dilated by its distance, and this one has none"):
            ask()
    bare = wb.shapes.Function(in_ball, [-1] * 3, [1] * 3)
    assert (shape.certified, bare.certified) == (True, False)
    assert not (bare.empty(lower, upper) & ((lower <= 1) & (upper >= -1)).all(axis=1)).any()
    with pytest.raises(wb.ShapeError, match="cells need a shape that certifies boxes empty"):
        bare.to_grid(resolution=8)
    assert bare.decide(np.array([[np.nan, 0, 0], [0, np.inf, 0], [0, 0, 0]])).tolist() == [OUT, OUT, IN]


def raising(x):
    raise KeyError("no such\nthing")


F, POSITIVE, CALLS = wb.shapes.Function, lambda x: x[:, 0] > 0, count()
BAD = (
    (lambda: F(None, [0], [1]), "function: expected contains, or a distance"),
    (lambda: F(3, [0], [1]), "function: contains must be a function of arrays, got 3"),
    (lambda: F(raising, [0], [1]), "function: contains raised KeyError for 64 points: 'no such"),
    (lambda: F(POSITIVE, [1], [0]), "function: lower must be below upper in each coordinate"),
    (lambda: F(lambda x: x > 0, [0, 0], [1, 1]), r"must return bool of shape \(64,\), got bool of shape \(64, 2\)"),
    (lambda: F(None, [0], [1], distance=lambda x: x[:, 0] * np.nan), "distance must return numbers, got NaN at"),
    (lambda: F(None, [0], [1], distance=ball_distance, lipschitz=0), "lipschitz must be finite and above 0"),
    (lambda: F(POSITIVE, [0], [1], lipschitz=1), "lipschitz is that of a distance"),
    (lambda: F(lambda x: x[:, 0] > 0.1 * next(CALLS), [-1], [1]), "each point on its own and always the same"),
    (lambda: F(None, [0], [1], distance=lambda x: x[:, 0] - x[0, 0]), "each point on its own"),
    (lambda: F(POSITIVE, [0], [1], empty=lambda a: a > 0), "empty raised TypeError for 64 points"),
)


@pytest.mark.parametrize(("make", "message"), BAD)
def test_bad_functions_are_refused(make, message):
    with pytest.raises(wb.ShapeError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)


def test_answers_that_change_later_are_noticed():
    state = {"level": 0.0}

    def contains(x):
        state["level"] += state.get("step", 0.0)
        return x[:, 0] > state["level"]

    shape = wb.shapes.Function(contains, [-1], [1])
    state["step"] = 1e-3
    x = np.linspace(-1, 1, 4001)[:, None]
    for _ in range(62):
        shape.contains(x)
    with pytest.raises(wb.ShapeError, match="always the same"):
        shape.contains(x), shape.contains(x)


@pytest.mark.parametrize("n", DIMENSIONS)
def test_the_truth_is_not_refuted(n):
    ball(n).check()
    ball(n).dilated(0.1).check()
    ball(n).check_contents()
    honest = wb.shapes.Function(lambda x: ball_distance(x) <= 0, [-1] * n, [1] * n, empty=ball_empty)
    honest.check(seed=1)
    infinite = ball(n, distance=lambda x: np.where(ball_distance(x) > 3, np.inf, ball_distance(x)), lipschitz=1e9)
    with suppress(wb.ShapeError):  # it jumps, which may be found
        infinite.check()


def claiming(empty):
    """A ball whose author certifies boxes."""
    return lambda n: wb.shapes.Function(in_ball, [-1] * n, [1] * n, empty=empty)


SAID = {
    "bounds": "the point .* not between lower and upper",
    "empty": "the point .* called empty",
    "sign": "the point .* above 0",
    "lipschitz": "the distance changes",
}
CLAIMS = {
    "bounds": (lambda n: ball(n, distance=lambda x: np.linalg.norm(x, axis=1) - 1.05), {"bounds"}),
    "empty": (claiming(lambda a, b: (np.maximum(np.maximum(a, -b), 0.0) ** 2).sum(axis=1) > 0.99), {"empty"}),
    "large boxes": (claiming(lambda a, b: (ball_distance(a) > 0) & (ball_distance(b) > 0)), {"empty"}),
    "constant": (lambda n: ball(n, distance=lambda x: 1.05 * ball_distance(x)), {"empty", "lipschitz"}),
    "sign": (
        lambda n: wb.shapes.Function(in_ball, [-1] * n, [1] * n, distance=lambda x: ball_distance(x) + 0.01),
        {"empty", "sign"},
    ),
    "corner": (  # too steep in one
        lambda n: ball(n, distance=lambda x: ball_distance(x) + 0.5 * np.maximum(x.min(axis=1) - 0.9, 0)),
        {"empty", "lipschitz"},
    ),
}


@pytest.mark.parametrize("n", DIMENSIONS)
@pytest.mark.parametrize("claim", CLAIMS)
def test_false_claims_are_found(claim, n):
    if claim == "corner" and n > 3:
        pytest.skip("so small a part of space is rarely sampled")
    make, broken = CLAIMS[claim]
    with pytest.raises(wb.ShapeError, match="|".join(SAID[word] for word in broken)):
        make(n).check(seed=n)


def test_nothing_and_everything_are_refused_when_asked():
    nothing = wb.shapes.Function(lambda x: x[:, 0] > 5, [0, 0], [1, 1])
    with pytest.raises(wb.ShapeError, match="there is nothing to bound"):
        nothing.check_contents()
    everything = wb.shapes.Function(lambda x: x[:, 0] > -5, [0, 0], [1, 1])
    with pytest.raises(wb.ShapeError, match="there is nothing to leave out"):
        everything.check_contents()
    speck = wb.shapes.Function(None, [-9] * 3, [9] * 3, distance=lambda x: np.linalg.norm(x - [1, 2, 3], axis=1) - 1e-3)
    speck.check_contents()


def test_time_is_what_the_shape_says():
    still = ball(3)
    timed = ball(3, time=True)
    assert wb.load_shape(timed, time=True) is timed
    with pytest.raises(wb.ShapeError, match="coordinate 0 of this Function is time, got time=False"):
        wb.load_shape(timed, time=False)
    with pytest.raises(wb.ShapeError, match="this Function has no time coordinate, got time=True"):
        wb.load_shape(still, time=True)
    with pytest.raises(wb.ShapeError, match="a function of time cannot be dilated in space"):
        timed.dilated(0.1)


NUMBERS = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False),
    st.floats(-4, 4),
    st.sampled_from([0.0, -0.0, 5e-324, -5e-324, 1e-200, 1e200, 1.7976931348623157e308, 2.0**-1022, 1.0, 0.1]),
)


@given(NUMBERS, NUMBERS)
def test_sums_and_lengths_are_rounded_outwards(x, y):
    with np.errstate(over="ignore"):
        total = np.array([x]) + y
        low, high = float(_below(total)[0]), float(_above(total)[0])
        length, one = (float(_length(np.abs([sides]))[0]) for sides in ([x, y], [x]))
    exact = Fraction(x) + Fraction(y)
    assert low == -math.inf or Fraction(low) <= exact
    assert high == math.inf or exact <= Fraction(high)
    assert math.isinf(total[0]) or exact or low == high == 0, "the sign of a difference is exact"
    assert length == math.inf or Fraction(x) ** 2 + Fraction(y) ** 2 <= Fraction(length) ** 2
    assert one == abs(x)


@given(NUMBERS, st.floats(0, 1e300), st.sampled_from([-1, 1]))
def test_corners_move_outwards(corner, step, sign):
    found = float(_widened(np.array([corner]), step, sign)[0])
    exact = Fraction(corner) + sign * Fraction(step)
    if math.isfinite(found):
        assert sign * (Fraction(found) - exact) >= 0
        if Fraction(float(exact) if abs(exact) < 2**1023 else 0) == exact:
            assert found == exact, "what float64 holds is kept"


@given(st.lists(st.floats(-2, 2), min_size=3, max_size=3), st.floats(0, 1), st.floats(0, 1))
def test_bounds_of_boxes_are_those_of_the_nearest_and_the_farthest_point(center, side, margin):
    """The distance is one coordinate, so its range over a box is known up to the allowance for rounding."""
    shape = wb.shapes.Function(None, [-9] * 3, [9] * 3, distance=lambda x: 2 * x[:, 0], lipschitz=2.0).dilated(margin)
    lower, upper = np.array([center]), np.array([[center[0] + side, *center[1:]]])
    least, most = Fraction(float(lower[0, 0])) - Fraction(margin), Fraction(float(upper[0, 0])) - Fraction(margin)
    assert Fraction(float(shape.distance(lower)[0])) <= max(least, 0)
    assert not shape.empty(lower, upper)[0] or least > 0
    assert not shape.inside(lower, upper)[0] or most <= 0
    assert shape.empty(lower, upper)[0] or least < 1e-9
    assert shape.inside(lower, upper)[0] or most > -1e-9
