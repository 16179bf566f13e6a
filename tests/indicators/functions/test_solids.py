"""Solids: what they certify of boxes is true of every point, in exact arithmetic, and the algebra keeps it so."""

from fractions import Fraction

import numpy as np
import pytest

import warp_bounding as wb
from warp_bounding.indicators.shape import IN, OUT, UNDECIDED

DIMENSIONS = (1, 2, 3, 4, 5, 6)
S = wb.solids


def exact(x) -> list[Fraction]:
    return [Fraction(float(each)) for each in x]


def squared(a, b) -> Fraction:
    return sum((p - q) ** 2 for p, q in zip(a, b, strict=True))


def in_sphere(s, x, margin=0):
    return squared(exact(x), exact(s.center)) <= (Fraction(s.radius) + Fraction(margin)) ** 2


def in_box(s, x, margin=0):
    lower, upper = exact(s._bounds[0]), exact(s._bounds[1])
    return (
        sum(max(a - p, p - b, 0) ** 2 for p, a, b in zip(exact(x), lower, upper, strict=True)) <= Fraction(margin) ** 2
    )


def in_capsule(s, x, margin=0):
    p, a, b = exact(x), exact(s.start), exact(s.end)
    way = [v - u for u, v in zip(a, b, strict=True)]
    length = sum(w * w for w in way)
    share = sum((q - u) * w for q, u, w in zip(p, a, way, strict=True)) / length if length else 0
    share = min(max(share, 0), 1)
    near = [u + share * w for u, w in zip(a, way, strict=True)]
    return squared(p, near) <= (Fraction(s.radius) + Fraction(margin)) ** 2


def in_half_space(s, x, margin=0):
    assert not margin
    return in_box(s, x) and sum(n * p for n, p in zip(exact(s.normal), exact(x), strict=True)) <= Fraction(s.offset)


def in_torus(s, x, margin=0):
    about = [p - c for p, c in zip(exact(x), exact(s.center), strict=True)]
    along, major, minor = about.pop(s.axis), Fraction(s.major), Fraction(s.minor) + Fraction(margin)
    rho2 = sum(p * p for p in about)
    left = rho2 + major**2 + along**2 - minor**2  # <= 2 major rho
    return left <= 0 or left**2 <= 4 * major**2 * rho2


TRUTH = {S.Sphere: in_sphere, S.Box: in_box, S.Capsule: in_capsule, S.HalfSpace: in_half_space, S.Torus: in_torus}
KINDS = list(TRUTH)


def truth(s, x, margin=0):
    return TRUTH[type(s)](s, x, margin)


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
    return S.Torus(a, 0.8, 0.3, axis=int(rng.integers(n)))


def cases(kind, n, rng, count=12):
    if kind is S.Torus and n == 1:
        return
    for _ in range(count):
        yield example(kind, n, rng)


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
@pytest.mark.parametrize("kind", KINDS)
def test_decide_is_exact_where_it_is_certain(kind, n, rng):
    for s in cases(kind, n, rng):
        x = np.concatenate([rng.uniform(s.sample_lower, s.sample_upper, (40, n)), near_border(s, rng, 10)])
        answer = s.decide(x)
        real = np.array([truth(s, each) for each in x])
        assert not (real & (answer == OUT)).any()
        assert not (~real & (answer == IN)).any()
        assert (answer[:40] != UNDECIDED).all(), "random points are decided"
        if kind is S.Box:
            assert (answer != UNDECIDED).all(), "a box is decided exactly"


@pytest.mark.parametrize("n", DIMENSIONS)
@pytest.mark.parametrize("kind", KINDS)
def test_boxes_are_certified_truly(kind, n, rng):
    certified = np.zeros(2, dtype=int)
    for s in cases(kind, n, rng):
        lower, upper = boxes(s, rng, 400)
        empty, inside, low = s.empty(lower, upper), s.inside(lower, upper), s.clearance(lower, upper)
        certified += [empty.sum(), inside.sum()]
        x = points_of(lower, upper, rng)
        answer = s.decide(x.reshape(-1, n)).reshape(x.shape[:2])
        assert (answer[empty] == OUT).all()
        assert not (answer[inside] == OUT).any()
        distance = s.distance(x.reshape(-1, n)).reshape(x.shape[:2])
        # The gap of a point is enclosed twice; the bound of the box must not pass the upper one.
        high = s.gap(x.reshape(-1, n), x.reshape(-1, n))[1].reshape(x.shape[:2])
        assert (low[:, None] <= np.maximum(high, 0)).all()
        assert (distance <= np.maximum(high, 0)).all()
        for row in np.flatnonzero(empty)[:20]:
            assert not any(truth(s, each) for each in x[row])
        for row in np.flatnonzero(inside)[:20]:
            assert all(truth(s, each) for each in x[row])
    assert certified.all() or (kind is S.Torus and n == 1)


@pytest.mark.parametrize("n", DIMENSIONS)
@pytest.mark.parametrize("kind", KINDS)
def test_distances_are_not_above_those_to_points_of_the_object(kind, n, rng):
    for s in cases(kind, n, rng, count=4):
        x = rng.uniform(s.lower - 1, s.upper + 1, (200, n))
        held = near_border(s, rng, 100)
        held = held[s.decide(held) == IN]
        distance = s.distance(x)
        apart = np.linalg.norm(x[:, None] - held[None], axis=2).min(axis=1) * (1 + 1e-12)
        assert (distance <= apart).all()
        assert (distance[s.decide(x) == IN] == 0).all()


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


def test_bounds_hold_the_object(rng):
    for kind in KINDS:
        for n in DIMENSIONS:
            for s in cases(kind, n, rng, count=3):
                x = rng.uniform(s.lower - 1, s.upper + 1, (2000, n))
                out = ((x < s.lower) | (x > s.upper)).any(axis=1)
                assert not s.contains(x[out]).any()
                if len(s.landmarks()):
                    assert (s.gap(s.landmarks(), s.landmarks())[0] <= 1e-12).all(), "landmarks are in the object"


@pytest.mark.parametrize("n", DIMENSIONS)
def test_combinations_are_those_of_sets(n, rng):
    pick = [kind for kind in KINDS if n > 1 or kind is not S.Torus]
    seen = np.zeros(2, dtype=int)
    for turn in range(20):
        a, b, c = (example(pick[(turn + k) % len(pick)], n, rng) for k in range(3))
        try:
            s = ((a | b) - c) if turn % 2 else (a & (b | c))
        except wb.IndicatorError:
            continue  # the parts lie apart
        x = np.concatenate([rng.uniform(s.sample_lower, s.sample_upper, (100, n)), near_border(s, rng, 20)])
        p, q, r = (np.array([truth(part, each) for each in x]) for part in (a, b, c))
        real = ((p | q) & ~r) if turn % 2 else (p & (q | r))
        answer = s.decide(x)
        low, high = c.gap(x, x)
        sure = (answer != UNDECIDED) & ((low > 0) | (high < 0))  # the border of what is taken away stays
        assert (real[sure] == (answer[sure] == IN)).all()
        assert sure[:100].all()
        lower, upper = boxes(s, rng, 400)
        y = points_of(lower, upper, rng)
        each = s.decide(y.reshape(-1, n)).reshape(y.shape[:2])
        empty, inside = s.empty(lower, upper), s.inside(lower, upper)
        seen += [empty.sum(), inside.sum()]
        assert (each[empty] == OUT).all()
        assert not (each[inside] == OUT).any()
        held = x[real]
        wide = s.dilated(0.1)
        around = held + 0.1 * (1 - 1e-12) * unit(rng.normal(size=held.shape))
        assert wide.contains(around).all(), "the dilated object holds all that is near"
        assert ((around >= wide.lower) & (around <= wide.upper)).all()
        y = rng.uniform(s.lower - 1, s.upper + 1, (300, n))
        if len(held):
            apart = np.linalg.norm(y[:, None] - held[None], axis=2).min(axis=1) * (1 + 1e-12)
            assert (s.distance(y) <= apart).all()
            assert (wide.distance(y) <= np.maximum(apart - 0.1, 0) + 1e-12).all()
    assert seen.all()


def unit(v):
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def test_cells_hold_the_solid(rng):
    for n in (1, 2, 3, 4):
        for kind in KINDS:
            for s in cases(kind, n, rng, count=1):
                grid = s.to_grid(resolution=12, margin=0.05)
                wide = s.dilated(0.05)
                x = rng.uniform(wide.sample_lower, wide.sample_upper, (5000, n)).astype(np.float32)
                assert not (wide.contains(x) & ~grid.contains(x)).any()
                assert grid.margin == 0.05
                # A cell is occupied only where the solid does not certify it empty.
                edge = grid.boundary
                low, high = grid.position(edge - 0.5), grid.position(edge + 0.5)
                room = (high - low) * 1e-9
                assert not wide.empty(low + room, high - room).all(axis=0).any() or len(edge) == 0


def test_operators_take_any_shape():
    ball = S.Sphere([0.0, 0.0], 1.0)
    foreign = wb.IndicatorFunction(
        lambda x: x[:, 0] >= 0, [0, -2], [2, 2], empty=lambda a, b: b[:, 0] < 0, name="right"
    )
    for made in (ball & foreign, foreign & ball):
        assert made.decide(np.array([[0.5, 0.0], [-0.5, 0.0], [1.5, 0.0]])).tolist() == [IN, OUT, OUT]
        assert made.empty(np.array([[-1.0, -1.0], [-1.0, -1.0]]), np.array([[-0.1, 1.0], [0.1, 1.0]])).tolist() == [
            True,
            False,
        ]
    assert (ball - foreign).decide(np.array([[0.5, 0.0], [-0.5, 0.0]])).tolist() == [OUT, IN]
    assert (foreign | ball).upper.tolist() == [2, 2]
    with pytest.raises(TypeError):
        _ = ball | 3


def test_meshes_are_parts_of_solids(rng):
    mesh = wb.IndicatorMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    bitten = mesh - S.Sphere([0, 0, 0], 0.5)
    x = rng.uniform(-0.3, 1.2, (5000, 3))
    away = np.linalg.norm(x, axis=1) >= 0.5
    assert (bitten.contains(x) == (mesh.contains(x) & away)).all()
    wide = bitten.dilated(0.1)
    held = x[bitten.contains(x)]
    around = held + 0.1 * (1 - 1e-12) * unit(rng.normal(size=held.shape))
    assert wide.contains(around).all()
    lower = rng.uniform(-0.3, 1.1, (2000, 3))
    upper = lower + 0.2 * rng.random((2000, 1)) * rng.random(lower.shape)
    for shape in (bitten, wide, mesh | S.Box([2, 2, 2], [3, 3, 3]), S.Transform(mesh, np.eye(3)[[1, 0, 2]], scale=1.5)):
        y = points_of(lower, upper, rng)
        answer = shape.decide(y.reshape(-1, 3)).reshape(y.shape[:2])
        empty, inside = shape.empty(lower, upper), shape.inside(lower, upper)
        assert empty.any()
        assert inside.any()
        assert (answer[empty] == OUT).all()
        assert not (answer[inside] == OUT).any()
    grid = bitten.to_grid(resolution=24, margin=0.05)
    x = x.astype(np.float32)
    assert not (bitten.dilated(0.05).contains(x) & ~grid.contains(x)).any()


def test_nothing_is_certified_of_what_is_no_box():
    ball = S.Sphere([0.0, 0.0], 1.0)
    lower = np.array([[np.nan, 5.0], [6.0, 5.0], [5.0, 5.0], [-np.inf, 5.0]])
    upper = np.array([[6.0, 6.0], [5.0, 6.0], [np.inf, 6.0], [0.0, 6.0]])
    assert not ball.empty(lower, upper).any()
    assert not ball.inside(lower, upper).any()
    assert not ball.clearance(lower, upper).any()
    assert ball.decide(np.array([[np.nan, 0], [np.inf, 0], [1e300, 1e300]])).tolist() == [OUT] * 3


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: S.Sphere([0, 0], 0), "sphere: radius must be finite and above 0, got 0"),
        (lambda: S.Sphere([0, np.nan], 1), "sphere: center must be finite numbers"),
        (lambda: S.Sphere([], 1), "sphere: center must be finite numbers"),
        (lambda: S.Box([0, 0], [1, 0]), "box: lower must be below upper in each coordinate"),
        (lambda: S.Capsule([0, 0], [1, 0, 0], 1), "capsule: expected two ends of one length, got 2 and 3"),
        (lambda: S.HalfSpace([0, 0], 1, [0, 0], [1, 1]), "half-space: expected a normal of 2 numbers, not all 0"),
        (lambda: S.Torus([0], 1, 1), "torus: expected 2 coordinates or more"),
        (lambda: S.Torus([0, 0, 0], 1, 1, axis=3), "torus: expected 2 coordinates or more"),
        (lambda: S.Union(), "union: expected at least one shape, and nothing but shapes, got none"),
        (lambda: S.Union(S.Sphere([0], 1), 3), "nothing but shapes, got Sphere, int"),
        (lambda: S.Sphere([0], 1) | S.Sphere([0, 0], 1), r"same coordinates, got sphere \(1D\), sphere \(2D\)"),
        (lambda: S.Sphere([0, 0], 1) & S.Sphere([5, 0], 1), "intersection: there is nothing to bound"),
        (lambda: S.Dilation(S.Sphere([0], 1), -1), "margin must be finite and non-negative, got -1"),
        (lambda: S.Sphere([0], 1).dilated(0.1).dilated(0.2), "sphere: the shape is dilated by 0.1 already"),
        (lambda: S.Sphere([0] * 5, 1).to_grid(resolution=4), "sphere: a grid has at most 4 coordinates, got 5"),
        (lambda: S.Sphere([1e308], 1e308), "sphere: expected a solid of finite size"),
    ],
)
def test_bad_input(make, message):
    with np.errstate(over="ignore"), pytest.raises(wb.IndicatorError, match=message):
        make()


def test_what_holds_nothing_is_refused():
    apart = S.Sphere([0, 0], 1) & S.Sphere([1.5, 1.5], 1)
    with pytest.raises(wb.IndicatorError, match="nothing to bound"):
        apart.check_contents()
    (S.Sphere([0, 0], 1) & S.Sphere([1, 1], 1)).check_contents()
    speck = S.Sphere([0.3, 0.2, 0.1], 1e-3)
    (speck | (S.Box([-9, -9, -9], [9, 9, 9]) & S.Sphere([0.3, 0.2, 0.1], 1e-3))).check_contents()


def spikes():
    """Solids and functions whose gap is less than the distance somewhere, so that a level holds more than what is near;
    and the box of each."""
    corner = S.Intersection(S.Box([0, 0], [4, 1]), S.Transform(S.Box([0, 0], [4, 1]), rotated(0.1)))
    short = wb.IndicatorFunction(None, [-1, -1], [1, 1], distance=lambda x: 0.25 * (np.linalg.norm(x, axis=1) - 1))
    cells = wb.IndicatorGrid(np.eye(5, dtype=bool))
    for one in (corner, short, cells, S.Box([0, 0], [1, 1]) & S.Box([0, 0], [1, 1])):
        yield one
        yield S.Transform(one, rotated(np.pi / 4), [1, 2], 0.5)
        yield S.Union(one, S.Sphere([0, 0], 0.5))
        yield S.Difference(S.Box([-9, -9], [9, 9]), S.Dilation(one, 0.5))


def rotated(angle):
    return [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]


def test_a_dilation_lies_in_the_box_that_is_bounded(rng):
    """Whatever it is made of, it holds nothing beyond its box, and all that lies within the margin; so a bounder of it
    misses nothing."""
    margin = 0.25
    for number, one in enumerate(spikes()):
        wide = one.dilated(margin)
        x = rng.uniform(wide.lower - 2 * margin, wide.upper + 2 * margin, (1500, 2))
        beyond = ((x < wide.lower) | (x > wide.upper)).any(axis=1)
        assert beyond.any()
        assert not wide.contains(x[beyond]).any(), number
        assert wide.empty(x[beyond], x[beyond]).all()
        assert not wide.inside(x[beyond], x[beyond]).any()
        held = x[one.decide(x) == IN]
        angle = rng.uniform(0, 2 * np.pi, len(held))
        near = held + margin * (1 - 1e-9) * rng.random((len(held), 1)) * np.stack([np.cos(angle), np.sin(angle)], 1)
        assert wide.contains(near).all(), number
        assert not wide.empty(near, near).any()
    short = next(one for one in spikes() if isinstance(one, wb.IndicatorFunction))
    bounder = wb.fit(short, margin=margin, method="aabb", device="cpu", progress=False, force=True)
    assert wb.certify(bounder, short).proven
    assert wb.evaluate(bounder, short.dilated(margin), samples=20_000).fn == 0
