"""Solids: what they certify of boxes is true of every point, in exact arithmetic, and the algebra keeps it so."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import warp_bounding as wb
from warp_bounding.shapes.formula import Interval, norm, widened
from warp_bounding.shapes.shape import IN, OUT, UNDECIDED

DIMENSIONS = (1, 2, 3, 5)
S = wb.shapes


def exact(x) -> list[Fraction]:
    return [p if isinstance(p, Fraction) else Fraction(float(p)) for p in x]


def squared(a, b) -> Fraction:
    return sum((p - q) ** 2 for p, q in zip(a, b, strict=True))


def in_sphere(s, x, margin=0):
    return squared(exact(x), exact(s.center)) <= (Fraction(s.radius) + Fraction(margin)) ** 2


def in_box(s, x, margin=0):
    sides = zip(exact(x), exact(s._bounds[0]), exact(s._bounds[1]), strict=True)
    return sum(max(a - p, p - b, 0) ** 2 for p, a, b in sides) <= Fraction(margin) ** 2


def in_capsule(s, x, margin=0):
    p, a, b = exact(x), exact(s.start), exact(s.end)
    way = [v - u for u, v in zip(a, b, strict=True)]
    length = sum(w * w for w in way)
    share = sum((q - u) * w for q, u, w in zip(p, a, way, strict=True)) / length if length else 0
    near = [u + min(max(share, 0), 1) * w for u, w in zip(a, way, strict=True)]
    return squared(p, near) <= (Fraction(s.radius) + Fraction(margin)) ** 2


def in_half_space(s, x, margin=0):
    return in_box(s, x) and sum(n * p for n, p in zip(exact(s.normal), exact(x), strict=True)) <= Fraction(s.offset)


def in_torus(s, x, margin=0):
    about = [p - c for p, c in zip(exact(x), exact(s.center), strict=True)]
    along, major, minor = about.pop(s.axis), Fraction(s.major), Fraction(s.minor) + Fraction(margin)
    rho2 = sum(p * p for p in about)
    left = rho2 + major**2 + along**2 - minor**2  # <= 2 major rho
    return left <= 0 or left**2 <= 4 * major**2 * rho2


def in_transform(t, x, margin=0):
    about = [p - q for p, q in zip(exact(x), exact(t.translation), strict=True)]
    own = [sum(r * p for r, p in zip(exact(c), about, strict=True)) / Fraction(t.scale) for c in t.rotation.T]
    return truth(t.parts[0], own)


def in_extrusion(e, x, margin=0):
    (time, *place), times = exact(x), exact(e.times)
    if not times[0] <= time <= times[-1]:
        return False
    k = max(k for k in range(len(times) - 1) if times[k] <= time)
    share = (time - times[k]) / (times[k + 1] - times[k])
    ways = zip(place, exact(e.offsets[k]), exact(e.offsets[k + 1]), strict=True)
    return truth(e.parts[0], [p - a - share * (b - a) for p, a, b in ways])


TRUTH = {
    S.Sphere: in_sphere,
    S.Box: in_box,
    S.Capsule: in_capsule,
    S.HalfSpace: in_half_space,
    S.Torus: in_torus,
    S.Transform: in_transform,
    S.Extrusion: in_extrusion,
}
PRIMITIVES = list(TRUTH)[:5]
SQUARE = S.Box([0, 0], [1, 1])


def truth(s, x, margin=0):
    return TRUTH[type(s)](s, x, margin)


def rotation(n, rng):
    return np.linalg.qr(rng.normal(size=(n, n)))[0]


def example(kind, n, rng):
    a, b = rng.uniform(-1, 1, (2, n))
    if kind is S.Sphere:
        return S.Sphere(a, 0.7)
    if kind is S.Box:
        return S.Box(np.minimum(a, b) - 0.1, np.maximum(a, b))
    if kind is S.Capsule:
        return S.Capsule(a, b, 0.3)
    if kind is S.HalfSpace:
        return S.HalfSpace(rng.normal(size=n), 0.2, [-1.0] * n, [1.0] * n)
    if kind is S.Torus:
        return S.Torus(a, 0.8, 0.3, axis=int(rng.integers(n)))
    base = example([S.Sphere, S.Box][rng.integers(2)], n, rng)
    if kind is S.Extrusion:
        times = [[0.0, 0.3, 1.0], [-2.0, 5.0]][rng.integers(2)]
        return S.Extrusion(base, times, rng.uniform(-1, 1, (len(times), n)))
    turns = [rotation(n, rng), rotation(n, rng).astype("f4"), None, np.roll(np.eye(n), 1, axis=0) * -1]
    return S.Transform(base, turns[rng.integers(4)], b, [1.7, 0.3][rng.integers(2)])


def cases(kind, n, rng, count=12):
    if kind is not S.Torus or n > 1:
        yield from (example(kind, n, rng) for _ in range(count))


def near_border(s, rng, count):
    """Float64 points within a few units of the border, by bisection of the float64 answers."""
    x = rng.uniform(s.sample_lower, s.sample_upper, (40 * count, s.ndim))
    held = s.decide(x) == IN
    if not held.any() or held.all():
        return x[:count]
    a, b = (side[rng.integers(0, len(side), count)] for side in (x[held], x[~held]))
    for _ in range(60):
        middle = a + (b - a) / 2
        inside = (s.decide(middle) == IN)[:, None]
        a, b = np.where(inside, middle, a), np.where(inside, b, middle)
    return np.concatenate([a, b])


def boxes(s, rng, count):
    """Boxes of all sizes about a shape, some of them points and some flat."""
    lower = rng.uniform(s.sample_lower, s.sample_upper, (count, s.ndim))
    sides = 10.0 ** rng.uniform(-6, 0.3, (count, 1)) * rng.random(lower.shape)
    sides *= rng.random(lower.shape) < 0.9
    sides[rng.random(count) < 0.1] = 0
    return lower, lower + sides


def points_of(lower, upper, rng, each=4):
    """Points of boxes, most of them at corners; ``(N, each, n)``."""
    shares = rng.random((len(lower), each, lower.shape[1]))
    shares = np.where(rng.random(shares.shape) < 0.7, np.round(shares), shares)
    a, b = lower[:, None], upper[:, None]
    return np.clip(a + shares * (b - a), a, b)


@pytest.mark.parametrize("n", DIMENSIONS)
@pytest.mark.parametrize("kind", TRUTH)
def test_points_and_boxes(kind, n, rng):
    """Points are decided exactly, boxes are certified truly, and no distance is above that to a point of the object."""
    certified = np.zeros(2, dtype=int)
    for s in cases(kind, n, rng, count=6):
        held = near_border(s, rng, 100)
        x = np.concatenate([rng.uniform(s.sample_lower, s.sample_upper, (40, s.ndim)), held[::10]])
        answer, real = s.decide(x), np.array([truth(s, each) for each in x])
        assert not (real & (answer == OUT)).any()
        assert not (~real & (answer == IN)).any()
        assert (answer[:40] != UNDECIDED).all(), "random points are decided"
        assert kind is not S.Box or (answer != UNDECIDED).all(), "a box is decided exactly"
        y = rng.uniform(s.lower - 1, s.upper + 1, (500, s.ndim))
        assert not s.contains(y[((y < s.lower) | (y > s.upper)).any(axis=1)]).any()
        if not s.time and len(held := held[s.decide(held) == IN]):
            apart = np.linalg.norm(y[:, None] - held[None], axis=2).min(axis=1) * (1 + 1e-12)
            assert (s.distance(y) <= apart).all()
        assert (s.distance(y)[s.decide(y) == IN] == 0).all()
        lower, upper = boxes(s, rng, 400)
        lower[:50, 0] -= 0.5 * s.time
        empty, inside, low = s.empty(lower, upper), s.inside(lower, upper), s.clearance(lower, upper)
        certified += [empty.sum(), inside.sum()]
        x = points_of(lower, upper, rng)
        flat = x.reshape(-1, s.ndim)
        answer, distance = (found.reshape(x.shape[:2]) for found in (s.decide(flat), s.distance(flat)))
        assert (answer[empty] == OUT).all()
        assert not (answer[inside] == OUT).any()
        high = s.gap(flat, flat)[1].reshape(x.shape[:2])  # enclosed twice: no bound passes the upper one
        assert (low[:, None] <= np.maximum(high, 0)).all()
        assert (distance <= np.maximum(high, 0)).all()
        for row in np.flatnonzero(empty)[:10]:
            assert not any(truth(s, each) for each in x[row])
        for row in np.flatnonzero(inside)[:10]:
            assert all(truth(s, each) for each in x[row])
        assert (
            kind not in PRIMITIVES or not len(s.landmarks()) or (s.gap(s.landmarks(), s.landmarks())[0] <= 1e-12).all()
        )
    assert certified.all() or (kind is S.Torus and n == 1)


@pytest.mark.parametrize("n", DIMENSIONS)
@pytest.mark.parametrize("kind", [S.Sphere, S.Box, S.Capsule, S.Torus])
def test_dilation_is_exact(kind, n, rng):
    margin = 0.125
    for s in cases(kind, n, rng, count=6):
        wide = s.dilated(margin)
        x = np.concatenate([rng.uniform(s.lower - 0.3, s.upper + 0.3, (40, n)), near_border(wide, rng, 10)])
        answer, real = wide.decide(x), np.array([truth(s, each, margin) for each in x])
        assert not (real & (answer == OUT)).any()
        assert not (~real & (answer == IN)).any()
        assert (answer[:40] != UNDECIDED).all()
        assert ((wide.lower <= s.lower - margin) & (wide.upper >= s.upper + margin)).all()
        again = S.Dilation(s, 0.0625).dilated(0.0625)
        assert not (real & (again.decide(x) == OUT)).any()
        assert not (~real & (again.decide(x) == IN)).any()
        assert wide.geometry == s.geometry
        assert wide.digest != s.digest
        assert wide.margin == margin
        assert again.digest != s.digest


@pytest.mark.parametrize("n", DIMENSIONS)
def test_combinations_are_those_of_sets(n, rng):
    pick = [kind for kind in PRIMITIVES if n > 1 or kind is not S.Torus]
    for turn in range(10):
        a, b, c = (example(pick[(turn + k) % len(pick)], n, rng) for k in range(3))
        try:
            s = ((a | b) - c) if turn % 2 else (a & (b | c))
        except wb.ShapeError:
            continue  # the parts lie apart
        x = np.concatenate([rng.uniform(s.sample_lower, s.sample_upper, (100, n)), near_border(s, rng, 20)])
        p, q, r = (np.array([truth(part, each) for each in x]) for part in (a, b, c))
        real = ((p | q) & ~r) if turn % 2 else (p & (q | r))
        answer = s.decide(x)
        low, high = c.gap(x, x)
        sure = (answer != UNDECIDED) & ((low > 0) | (high < 0))  # the border of what is taken away stays
        assert (real[sure] == (answer[sure] == IN)).all()
        assert sure[:100].all()


BAD = (
    (lambda: S.Sphere([0, 0], 0), "sphere: radius must be finite and above 0, got 0"),
    (lambda: S.Box([0, 0], [1, 0]), "box: lower must be below upper in each coordinate"),
    (lambda: S.Capsule([0, 0], [1, 0, 0], 1), "capsule: expected two ends of one length, got 2 and 3"),
    (lambda: S.HalfSpace([0, 0], 1, [0, 0], [1, 1]), "half-space: expected a normal of 2 numbers, not all 0"),
    (lambda: S.Union(S.Sphere([0], 1), 3), "nothing but shapes, got Sphere, int"),
    (lambda: S.Sphere([0], 1) | S.Sphere([0, 0], 1), r"same coordinates, got sphere \(1D\), sphere \(2D\)"),
    (lambda: S.Sphere([0, 0], 1) & S.Sphere([5, 0], 1), "intersection: there is nothing to bound"),
    (lambda: S.Sphere([0] * 5, 1).to_grid(resolution=4), "sphere: a grid has at most 4 coordinates, got 5"),
    (lambda: S.Transform(SQUARE, [[1, 0], [0, 2]]), r"rotation must be orthogonal, got a matrix R with .* = 3"),
    (lambda: S.Transform(SQUARE, scale=-1), "scale must be finite and above 0, got -1"),
    (lambda: S.Transform(S.Extrusion(SQUARE, [0, 1], np.zeros((2, 2)))), "a shape of time cannot be turned"),
    (lambda: S.Extrusion(SQUARE, [0, 0], np.zeros((2, 2))), "two or more ascending float32 times"),
    (lambda: S.Extrusion(SQUARE, [0, 1], np.zeros((2, 2))) | S.Sphere([0, 0, 0], 1), "3D, time first"),
)


@pytest.mark.parametrize(("make", "message"), BAD)
def test_bad_input(make, message):
    with np.errstate(over="ignore"), pytest.raises(wb.ShapeError, match=message):
        make()


NUMBERS = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False),
    st.floats(-4, 4),
    st.sampled_from([0.0, -0.0, 5e-324, -5e-324, 1e-200, 1e200, 1.7976931348623157e308, 2.0**-1022, 1.0, 0.1]),
)
PAIRS = st.tuples(NUMBERS, NUMBERS).map(sorted)


def interval(pair) -> Interval:
    return Interval(np.array([pair[0]]), np.array([pair[1]]))


def ends_and_middle(pair) -> list[Fraction]:
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
    for x in ends_and_middle(p):
        for y in ends_and_middle(q):
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
