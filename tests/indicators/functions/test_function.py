"""Functions as shapes: what they certify is true if what is claimed of them is, and lies are found."""

import numpy as np
import pytest

import warp_bounding as wb
from warp_bounding.indicators.shape import IN, OUT

DIMENSIONS = (1, 2, 3, 4, 5, 6)


def ball_distance(x):
    return np.linalg.norm(x, axis=1) - 1.0


def ball_empty(lower, upper):
    near = np.maximum(np.maximum(lower, -upper), 0.0)
    return (near**2).sum(axis=1) > 1.0 + 1e-9


def ball(n, **options):
    return wb.IndicatorFunction(None, [-1.0] * n, [1.0] * n, **({"distance": ball_distance} | options))


def boxes(n, rng, count):
    lower = rng.uniform(-1.5, 1.5, (count, n))
    return lower, lower + 10.0 ** rng.uniform(-7, 0, (count, 1)) * rng.random(lower.shape)


@pytest.mark.parametrize("margin", [0.0, 0.1])
@pytest.mark.parametrize("n", DIMENSIONS)
def test_a_distance_certifies_boxes(n, margin, rng):
    shape = ball(n).dilated(margin)
    assert shape.certified
    lower, upper = boxes(n, rng, 20000)
    x = lower + rng.random(lower.shape) * (upper - lower)
    x[::2] = np.where(rng.random(lower.shape) < 0.5, lower, upper)[::2]
    answer = shape.decide(x)
    empty, inside = shape.empty(lower, upper), shape.inside(lower, upper)
    assert empty.any()
    assert inside.any()
    assert (answer[empty] == OUT).all()
    assert (answer[inside] == IN).all()
    true = np.maximum(ball_distance(x) - margin, 0)
    assert (shape.distance(x) <= true).all()
    assert (shape.distance(x) >= true - 1e-12).all()
    assert (shape.clearance(lower, upper) <= true).all()
    assert ((shape.lower <= -1 - margin) & (shape.upper >= 1 + margin)).all()


def test_a_lipschitz_constant_scales(rng):
    shape = ball(3, distance=lambda x: 4 * ball_distance(x), lipschitz=4.0)
    plain = ball(3)
    lower, upper = boxes(3, rng, 5000)
    assert (shape.empty(lower, upper) == plain.empty(lower, upper)).mean() > 0.999
    x = rng.uniform(-2, 2, (1000, 3))
    assert (shape.dilated(0.25).contains(x) == plain.dilated(0.25).contains(x)).all()


def test_empty_of_the_author_is_asked(rng):
    asked = []

    def empty(lower, upper):
        asked.append(len(lower))
        return ball_empty(lower, upper)

    shape = wb.IndicatorFunction(lambda x: ball_distance(x) <= 0, [-1] * 3, [1] * 3, empty=empty)
    assert shape.certified
    lower, upper = boxes(3, rng, 1000)
    found = shape.empty(lower, upper)
    assert (found >= ball_empty(lower, upper)).all()
    assert max(asked) < 1000, "boxes beyond lower and upper are not asked about"
    assert shape.distance(lower) is None
    with pytest.raises(wb.IndicatorError, match="a function is dilated by its distance, and this one has none"):
        shape.dilated(0.1)
    with pytest.raises(wb.IndicatorError, match="a function is dilated by its distance, and this one has none"):
        shape.to_grid(resolution=8, margin=0.1)


def test_with_neither_nothing_is_certified(rng):
    shape = wb.IndicatorFunction(lambda x: ball_distance(x) <= 0, [-1] * 2, [1] * 2)
    assert not shape.certified
    lower, upper = boxes(2, rng, 100)
    assert not (shape.empty(lower, upper) & ((lower <= 1) & (upper >= -1)).all(axis=1)).any()
    with pytest.raises(wb.IndicatorError, match="cells need a shape that certifies boxes empty"):
        shape.to_grid(resolution=8)


def test_what_is_no_point_or_box_is_not_asked():
    def contains(x):
        assert np.isfinite(x).all()
        return ball_distance(x) <= 0

    shape = wb.IndicatorFunction(contains, [-1] * 2, [1] * 2, distance=ball_distance)
    assert shape.decide(np.array([[np.nan, 0], [0, np.inf], [0, 0]])).tolist() == [OUT, OUT, IN]
    lower = np.array([[np.nan, 5.0], [6.0, 5.0], [5.0, 5.0]])
    upper = np.array([[6.0, 6.0], [5.0, 6.0], [np.inf, 6.0]])
    assert not shape.empty(lower, upper).any()
    assert not shape.clearance(lower, upper).any()
    assert shape.decide(np.empty((0, 2))).shape == (0,)
    assert shape.empty(np.empty((0, 2)), np.empty((0, 2))).shape == (0,)


def test_functions_may_write_to_what_they_get(rng):
    def contains(x):
        x *= 0.5
        return (x**2).sum(axis=1) <= 0.25

    shape = wb.IndicatorFunction(contains, [-1] * 2, [1] * 2)
    x = rng.uniform(-1, 1, (100, 2))
    before = x.copy()
    shape.contains(x)
    assert (x == before).all()


def raising(x):
    raise KeyError("no such\nthing")


def growing():
    calls = []

    def contains(x):
        calls.append(0)
        return x[:, 0] > 0.1 * len(calls)

    return contains


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda f: f(None, [0], [1]), "function: expected contains, or a distance"),
        (lambda f: f(3, [0], [1]), "function: contains must be a function of arrays, got 3"),
        (lambda f: f(raising, [0], [1]), "function: contains raised KeyError for 64 points: 'no such"),
        (lambda f: f(lambda x: x[:, 0] > 0, [1], [0]), "function: lower must be below upper in each coordinate"),
        (lambda f: f(lambda x: x[:, 0] > 0, [0, 0], [1]), "function: lower must be below upper in each coordinate"),
        (lambda f: f(lambda x: x[:, 0] > 0, [np.nan], [1]), "function: lower must be finite numbers"),
        (lambda f: f(lambda x: x[:, 0] > 0, [], []), "function: lower must be finite numbers"),
        (
            lambda f: f(lambda x: x > 0, [0, 0], [1, 1]),
            r"must return bool of shape \(64,\), got bool of shape \(64, 2\)",
        ),
        (lambda f: f(lambda x: 1 * (x[:, 0] > 0), [0], [1]), "contains must return bool of shape .* got int64"),
        (lambda f: f(lambda x: None, [0], [1]), "contains must return bool of shape .* got object"),
        (lambda f: f(None, [0], [1], distance=lambda x: x[:, 0] * np.nan), "distance must return numbers, got NaN at"),
        (lambda f: f(None, [0], [1], distance=lambda x: x[:, 0].astype("f4")), "return float64 .* got float32"),
        (lambda f: f(None, [0], [1], distance=ball_distance, lipschitz=0), "lipschitz must be finite and above 0"),
        (lambda f: f(lambda x: x[:, 0] > 0, [0], [1], lipschitz=1), "lipschitz is that of a distance"),
        (lambda f: f(growing(), [-1], [1]), "contains must answer each point on its own and always the same"),
        (lambda f: f(lambda x: x[:, 0] > x[:, 0].mean() * np.arange(64), [0], [1]), "each point on its own"),
        (lambda f: f(None, [0], [1], distance=lambda x: x[:, 0] - x[0, 0]), "each point on its own"),
        (lambda f: f(lambda x: x[:, 0] > 0, [0], [1], empty=lambda a: a > 0), "empty raised TypeError for 64 points"),
    ],
)
def test_bad_functions_are_refused(make, message):
    with pytest.raises(wb.IndicatorError, match=message):
        make(wb.IndicatorFunction)


def test_the_authors_exception_is_chained():
    with pytest.raises(wb.IndicatorError) as caught:
        wb.IndicatorFunction(raising, [0], [1])
    assert isinstance(caught.value.__cause__, KeyError)
    assert "\n" not in str(caught.value)


def test_answers_that_change_later_are_noticed():
    state = {"level": 0.0}

    def contains(x):
        state["level"] += state.get("step", 0.0)
        return x[:, 0] > state["level"]

    shape = wb.IndicatorFunction(contains, [-1], [1])
    state["step"] = 1e-3
    x = np.linspace(-1, 1, 4001)[:, None]
    for _ in range(62):
        shape.contains(x)
    with pytest.raises(wb.IndicatorError, match="always the same"):
        shape.contains(x), shape.contains(x)


# --- lies ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", DIMENSIONS)
def test_the_truth_is_not_refuted(n):
    assert ball(n).refute() is None
    assert ball(n).dilated(0.1).refute() is None
    ball(n).check()
    ball(n).check_contents()
    honest = wb.IndicatorFunction(lambda x: ball_distance(x) <= 0, [-1] * n, [1] * n, empty=ball_empty)
    assert honest.refute(seed=1) is None
    infinite = ball(n, distance=lambda x: np.where(ball_distance(x) > 3, np.inf, ball_distance(x)), lipschitz=1e9)
    infinite.refute()


def lie_about_bounds(n):
    return ball(n, distance=lambda x: np.linalg.norm(x, axis=1) - 1.05)


def lie_about_empty(n):
    """Boxes are called empty whose points are a little inside."""

    def empty(lower, upper):
        return (np.maximum(np.maximum(lower, -upper), 0.0) ** 2).sum(axis=1) > 0.99

    return wb.IndicatorFunction(lambda x: ball_distance(x) <= 0, [-1] * n, [1] * n, empty=empty)


def lie_about_large_boxes(n):
    """Only the corners of boxes are asked."""

    def empty(lower, upper):
        return (ball_distance(lower) > 0) & (ball_distance(upper) > 0)

    return wb.IndicatorFunction(lambda x: ball_distance(x) <= 0, [-1] * n, [1] * n, empty=empty)


def lie_about_the_constant(n):
    return ball(n, distance=lambda x: 1.05 * ball_distance(x))


def lie_about_the_sign(n):
    return wb.IndicatorFunction(
        lambda x: ball_distance(x) <= 0, [-1] * n, [1] * n, distance=lambda x: ball_distance(x) + 0.01
    )


def lie_in_a_corner(n):
    """The distance is too steep in a small part of space."""

    def distance(x):
        return ball_distance(x) + 0.5 * np.maximum(x.min(axis=1) - 0.9, 0)

    return ball(n, distance=distance)


@pytest.mark.parametrize("n", DIMENSIONS)
@pytest.mark.parametrize(
    ("lie", "broken"),
    [
        (lie_about_bounds, {"bounds"}),
        (lie_about_empty, {"empty"}),
        (lie_about_large_boxes, {"empty"}),
        (lie_about_the_constant, {"empty", "lipschitz"}),
        (lie_about_the_sign, {"empty", "sign"}),
        (lie_in_a_corner, {"empty", "lipschitz"}),
    ],
)
def test_lies_are_found(lie, broken, n):
    if lie is lie_in_a_corner and n > 3:
        pytest.skip("so small a part of space is rarely sampled")
    shape = lie(n)
    found = shape.refute(seed=n)
    assert found is not None
    assert found.broken in broken
    x = found.points
    if found.broken == "empty":
        assert shape.contains(x[:1]).all()
        assert shape.empty(x[1:2], x[2:3]).all()
        assert ((x[0] >= x[1]) & (x[0] <= x[2])).all()
    elif found.broken == "bounds":
        assert shape.contains(x).all()
        assert ((x < shape.lower) | (x > shape.upper)).any()
    with pytest.raises(wb.IndicatorError, match=r"the point|the distance changes"):
        shape.check()


def test_nothing_and_everything_are_refused_when_asked():
    nothing = wb.IndicatorFunction(lambda x: x[:, 0] > 5, [0, 0], [1, 1])
    with pytest.raises(wb.IndicatorError, match="there is nothing to bound"):
        nothing.check_contents()
    everything = wb.IndicatorFunction(lambda x: x[:, 0] > -5, [0, 0], [1, 1])
    with pytest.raises(wb.IndicatorError, match="there is nothing to leave out"):
        everything.check_contents()
    speck = wb.IndicatorFunction(
        None, [-9] * 3, [9] * 3, distance=lambda x: np.linalg.norm(x - [1, 2, 3], axis=1) - 1e-3
    )
    speck.check_contents()


# --- what is made of them --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_cells_hold_the_object(n, rng):
    grid = ball(n).to_grid(resolution=16, margin=0.1)
    x = rng.uniform(-1.3, 1.3, (20000, n)).astype(np.float32)
    assert not (ball(n).dilated(0.1).contains(x) & ~grid.contains(x)).any()
    near = np.linalg.norm(x, axis=1) > 1.1 + 2 * np.sqrt(n) * 2.2 / 16
    assert not grid.contains(x[near]).any()
    assert grid.resolution == 16


def test_too_many_coordinates_for_a_grid():
    with pytest.raises(wb.IndicatorError, match="a grid has at most 4 coordinates, got 5"):
        ball(5).to_grid(resolution=4)


def test_digests_tell_functions_apart():
    digests = {ball(n).digest for n in (*DIMENSIONS, 16)}
    digests.add(ball(2, lipschitz=2.0).digest)
    digests.add(ball(2, distance=lambda x: ball_distance(x) + 0.1).digest)
    assert len(digests) == len(DIMENSIONS) + 3
    assert ball(2, name="other").digest == ball(2).digest != ball(2).dilated(0.1).digest


class Own:
    """An object that answers as a shape does."""

    ndim, lower, upper, name = 2, np.array([-1.0, -1.0]), np.array([1.0, 1.0]), "own"

    def contains(self, x):
        return ball_distance(x) <= 0

    def empty(self, lower, upper):
        return ball_empty(lower, upper)


def test_objects_that_answer_are_shapes():
    found = wb.load_indicator(Own())
    assert isinstance(found, wb.IndicatorFunction)
    assert (found.name, found.ndim, found.certified) == ("own", 2, True)
    assert found.contains(np.zeros((1, 2))).all()
    assert wb.load_indicator(found) is found
    wrong = Own()
    wrong.ndim = 3
    with pytest.raises(wb.IndicatorError, match="own: expected corners of ndim=3 numbers, got 2"):
        wb.load_indicator(wrong)
    with pytest.raises(wb.IndicatorError, match="expected a path"):
        wb.load_indicator(Own)


def test_time_is_what_the_shape_says():
    still = ball(3)
    moving = wb.solids.Extrusion(wb.solids.Sphere([0, 0], 1), [0, 1], np.zeros((2, 2)))
    timed = ball(3, time=True)
    for shape in (moving, timed):
        assert wb.load_indicator(shape, time=True) is shape
        with pytest.raises(wb.IndicatorError, match=r"coordinate 0 of this \w+ is time, got time=False"):
            wb.load_indicator(shape, time=False)
    with pytest.raises(wb.IndicatorError, match="this IndicatorFunction has no time coordinate, got time=True"):
        wb.load_indicator(still, time=True)
    with pytest.raises(wb.IndicatorError, match="a function of time cannot be dilated in space"):
        timed.dilated(0.1)
