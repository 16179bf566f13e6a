"""Transforms and extrusions: what is certified of boxes is true of every point, in exact arithmetic."""

from fractions import Fraction

import numpy as np
import pytest

import warp_bounding as wb
from warp_bounding.indicators.shape import IN, OUT, UNDECIDED

S = wb.solids
DIMENSIONS = (1, 2, 3, 4, 5, 6)


def rotation(n, rng, digits=None):
    q = np.linalg.qr(rng.normal(size=(n, n)))[0]
    return q.astype(digits) if digits else q


def in_solid(s, x):
    """Whether a rational point is in a sphere or a box."""
    if isinstance(s, S.Sphere):
        return sum((p - Fraction(float(c))) ** 2 for p, c in zip(x, s.center, strict=True)) <= Fraction(s.radius) ** 2
    sides = zip(x, s.lower, s.upper, strict=True)
    return all(Fraction(float(a)) <= p <= Fraction(float(b)) for p, a, b in sides)


def in_transform(t, x):
    about = [Fraction(float(p)) - Fraction(float(q)) for p, q in zip(x, t.translation, strict=True)]
    columns = t.rotation.T
    own = [sum(Fraction(float(r)) * p for r, p in zip(c, about, strict=True)) / Fraction(t.scale) for c in columns]
    return in_solid(t.parts[0], own)


def in_extrusion(e, x):
    time, times = Fraction(float(x[0])), [Fraction(float(t)) for t in e.times]
    if not times[0] <= time <= times[-1]:
        return False
    k = max(k for k in range(len(times) - 1) if times[k] <= time)
    share = (time - times[k]) / (times[k + 1] - times[k])
    own = []
    for p, a, b in zip(x[1:], e.offsets[k], e.offsets[k + 1], strict=True):
        a, b = Fraction(float(a)), Fraction(float(b))
        own.append(Fraction(float(p)) - a - share * (b - a))
    return in_solid(e.parts[0], own)


def examples(n, rng):
    a, b = rng.uniform(-1, 1, (2, n))
    for base in (S.Sphere(a, 0.6), S.Box(np.minimum(a, b) - 0.2, np.maximum(a, b) + 0.1)):
        yield S.Transform(base, rotation(n, rng), a, 1.7), in_transform
        yield S.Transform(base, rotation(n, rng, "f4"), b, 0.3), in_transform
        yield S.Transform(base, None, b, 0.5), in_transform
        yield S.Transform(base, np.roll(np.eye(n), 1, axis=0) * -1), in_transform
        yield S.Extrusion(base, [0.0, 0.3, 1.0], rng.uniform(-1, 1, (3, n))), in_extrusion
        yield S.Extrusion(base, [-2.0, 5.0], np.zeros((2, n))), in_extrusion


def border(s, rng, count):
    x = rng.uniform(s.sample_lower, s.sample_upper, (4000, s.ndim))
    held = s.decide(x) == IN
    a, b = (side[rng.integers(0, len(side), count)] for side in (x[held], x[~held]))
    for _ in range(60):
        middle = a + (b - a) / 2
        inside = (s.decide(middle) == IN)[:, None]
        a, b = np.where(inside, middle, a), np.where(inside, b, middle)
    return np.concatenate([a, b])


@pytest.mark.parametrize("n", DIMENSIONS)
def test_points_and_boxes_are_decided_truly(n, rng):
    seen = np.zeros(2, dtype=int)
    for s, truth in examples(n, rng):
        x = np.concatenate([rng.uniform(s.sample_lower, s.sample_upper, (40, s.ndim)), border(s, rng, 10)])
        if s.time:
            x = np.concatenate([x, [np.r_[t, s.offsets[k]] for k, t in enumerate(s.times)]])
        answer, real = s.decide(x), np.array([truth(s, each) for each in x])
        assert not (real & (answer == OUT)).any()
        assert not (~real & (answer == IN)).any()
        assert (answer[:40] != UNDECIDED).all()
        lower = rng.uniform(s.sample_lower, s.sample_upper, (500, s.ndim))
        lower[:100, 0] -= 0.5 * s.time
        upper = lower + 10.0 ** rng.uniform(-6, 0, (500, 1)) * rng.random(lower.shape)
        empty, inside, low = s.empty(lower, upper), s.inside(lower, upper), s.clearance(lower, upper)
        seen += [empty.sum(), inside.sum()]
        shares = rng.random((500, 6, s.ndim))
        shares = np.where(rng.random(shares.shape) < 0.7, np.round(shares), shares)
        x = np.clip(lower[:, None] + shares * (upper - lower)[:, None], lower[:, None], upper[:, None])
        answer = s.decide(x.reshape(-1, s.ndim)).reshape(x.shape[:2])
        assert (answer[empty] == OUT).all()
        assert not (answer[inside] == OUT).any()
        assert (low >= 0).all()
        assert np.isfinite(low).all()
        distance = s.gap(x.reshape(-1, s.ndim), x.reshape(-1, s.ndim))[1].reshape(x.shape[:2])
        assert (low[:, None] <= np.maximum(distance, 0)).all()
        for row in np.flatnonzero(empty)[:10]:
            assert not any(truth(s, each) for each in x[row])
        for row in np.flatnonzero(inside)[:10]:
            assert all(truth(s, each) for each in x[row])
        x = rng.uniform(s.lower - 1, s.upper + 1, (2000, s.ndim))
        assert not s.contains(x[((x < s.lower) | (x > s.upper)).any(axis=1)]).any()
    assert seen.all()


@pytest.mark.parametrize("n", [2, 3])
def test_margins_are_those_of_space(n, rng):
    for s, _ in examples(n, rng):
        wide, space = s.dilated(0.1), slice(1 if s.time else 0, None)
        x = border(s, rng, 200)
        x = x[s.contains(x)]
        around = x.copy()
        step = rng.normal(size=around[:, space].shape)
        around[:, space] += 0.1 * (1 - 1e-12) * step / np.linalg.norm(step, axis=1, keepdims=True)
        assert wide.contains(around).all()
        assert ((around >= wide.lower) & (around <= wide.upper)).all()
        assert (wide.lower[space] <= s.lower[space] - 0.1).all()
        if s.time:
            assert (wide.lower[0], wide.upper[0]) == (s.lower[0], s.upper[0])
        y = rng.uniform(s.lower, s.upper, (3000, s.ndim))
        far = s.distance(y) > 0.1 + 1e-9
        assert not wide.contains(y[far]).any()


def test_a_transform_is_as_exact_as_its_part(rng):
    ball = S.Sphere([0.5, 0.0, 0.0], 1.0)
    turned = S.Transform(ball, rotation(3, rng), [1.0, 2.0, 3.0], 2.0)
    center = turned.rotation @ (ball.center * 2.0) + turned.translation
    x = rng.uniform(-5, 8, (1000, 3))
    expected = np.maximum(np.linalg.norm(x - center, axis=1) - 2.0, 0)
    assert np.abs(turned.distance(x) - expected).max() < 1e-12


def test_any_shape_is_placed(rng):
    def distance(x):
        return np.linalg.norm(x, axis=1) - 1.0

    ball = wb.IndicatorFunction(None, [-1.0] * 3, [1.0] * 3, distance=distance)
    placed = S.Transform(ball, rotation(3, rng), [1.0, 0.0, 0.0], 2.0)
    moving = S.Extrusion(ball, [0, 1], [[0, 0, 0], [3, 0, 0]])
    x = rng.uniform(-4, 4, (2000, 3))
    for margin in (0.0, 0.2):
        held = np.linalg.norm(x - [1, 0, 0], axis=1) <= 2.0 + margin
        assert (placed.dilated(margin).contains(x) == held).all()
        assert (placed.dilated(margin).decide(x) != UNDECIDED).all()
        held = np.linalg.norm(x - [1.5, 0, 0], axis=1) <= 1.0 + margin
        assert (moving.dilated(margin).contains(np.insert(x, 0, 0.5, axis=1)) == held).all()
    assert placed.empty(np.array([[3.5, 0, 0]]), np.array([[4.0, 0.5, 0.5]])).all()


def test_cells_of_moving_solids_hold_them(rng):
    moving = S.Extrusion(S.Torus([0, 0, 0], 0.6, 0.2), [0, 1, 3], [[0, 0, 0], [1, 0, 0], [1, 1, 1]])
    both = moving - S.Extrusion(S.Box([-1, -1, -1], [0, 1, 1]), [0, 3], np.zeros((2, 3)))
    grid = both.to_grid(resolution=16, margin=0.05)
    assert grid.time
    x = rng.uniform(grid.lower, grid.upper, (20000, 4)).astype(np.float32)
    wide = both.dilated(0.05)
    assert wide.contains(x).any()
    assert not (wide.contains(x) & ~grid.contains(x)).any()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda b: S.Transform(b, [[1, 0], [0, 2]]), r"rotation must be orthogonal, got a matrix R with .* = 3"),
        (lambda b: S.Transform(b, np.eye(3)), r"rotation must be finite numbers of shape \(2, 2\)"),
        (lambda b: S.Transform(b, "turned"), r"rotation must be finite numbers of shape \(2, 2\), got 'turned'"),
        (lambda b: S.Transform(b, translation=[1]), "translation must have 2 numbers, got 1"),
        (lambda b: S.Transform(b, scale=-1), "scale must be finite and above 0, got -1"),
        (lambda b: S.Transform(S.Extrusion(b, [0, 1], np.zeros((2, 2)))), "a shape of time cannot be turned"),
        (lambda b: S.Extrusion(b, [0, 0], np.zeros((2, 2))), "two or more ascending float32 times"),
        (lambda b: S.Extrusion(b, [0], np.zeros((1, 2))), "two or more ascending float32 times"),
        (lambda b: S.Extrusion(b, [0, 1], np.zeros((2, 3))), r"finite offsets of shape \(2, 2\)"),
        (lambda b: S.Extrusion(b, [0, 1], [[0, 0], [0, np.nan]]), "finite offsets of shape"),
        (lambda b: S.Extrusion(b, [0, 1], np.zeros((2, 2))) | S.Sphere([0, 0, 0], 1), "3D, time first"),
        (lambda b: S.Transform(3), "nothing but shapes, got int"),
    ],
)
def test_bad_input(make, message):
    with pytest.raises(wb.IndicatorError, match=message):
        make(S.Box([0, 0], [1, 1]))
