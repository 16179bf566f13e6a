"""Fits to the queries that a caller asks: fewer false positives there, and no false negative anywhere."""

import numpy as np
import pytest

import warp_bounding as wb
from warp_bounding.errors import BounderError, QueryError
from warp_bounding.solids import Sphere
from warp_bounding.training.samples import CallersQueries, samples_of

BALL = Sphere([0.0, 0.0, 0.0], 1.0)


def above(rng, count: int) -> np.ndarray:
    """Points around the upper cap of the ball."""
    return rng.uniform([-1.3, -1.3, 0.4], [1.3, 1.3, 1.3], (count, 3)).astype(np.float32)


def wrong(bounder: wb.Bounder, x: np.ndarray) -> float:
    """Share of false positives."""
    return float(((bounder.query(x).numpy() == 1) & ~BALL.contains(x)).mean())


# a network's worst positive sets its threshold, and is another one with each seed: it takes many steps until what is asked outweighs that
MLP = pytest.param("mlp", {"hidden": (12, 12), "steps": 6000}, marks=pytest.mark.slow)


@pytest.mark.parametrize(("method", "options"), [("learned-kdop", {"k": 14, "steps": 900}), MLP])
def test_false_positives_are_fewer_where_it_is_asked(method, options, rng):
    """In the mean of two fits, since one is tighter than another by itself."""
    asked, others = above(rng, 20_000), above(rng, 50_000)
    rates = []
    for queries in (None, asked):
        for seed in range(2):
            own = options | {"queries": queries, "seed": seed}
            bounder = wb.fit(BALL, method=method, device="cpu", progress=False, **own)
            assert bounder.certificate.proven
            assert wb.evaluate(bounder, BALL, samples=50_000).fn == 0
            rates.append(wrong(bounder, others))
    assert sum(rates[2:]) < 0.9 * sum(rates[:2])


def test_negatives_lie_where_it_is_asked(rng):
    """Of what a network learns from, whatever the machine's rounding makes of it."""
    domain = wb.fit(BALL, method="aabb", device="cpu").domain
    samples, shares = samples_of(BALL, domain, 0), []
    below = domain.to_local(np.array([[0.0, 0.0, 0.4]], np.float32))[0, 2]
    for samples.callers in (None, CallersQueries(above(rng, 5000), BALL, domain)):
        shares.append(float((samples.negatives(4000)[2] < below).float().mean()))
    assert shares[0] > 0.4
    assert shares[1] < 0.5 * shares[0]


def test_rays_of_a_grid(rng):
    grid = BALL.to_grid(resolution=8)
    x = np.concatenate([above(rng, 3000), rng.normal(size=(3000, 3))], axis=1)
    bounder = wb.fit(grid, "ray", queries=x, hidden=(12, 12), steps=200, length=0.5, device="cpu", progress=False)
    assert wb.evaluate(bounder, grid, samples=20_000).fn == 0


@pytest.mark.parametrize("method", ["aabb", "relu-field", "mlp-early", "occupancy", "kdop+mlp"])
def test_every_method_takes_them(method, rng):
    options = {} if method in ("aabb", "relu-field") else {"hidden": (12, 12), "steps": 60}
    bounder = wb.fit(
        BALL, method=method, queries=above(rng, 500), resolution=8, device="cpu", progress=False, **options
    )
    if bounder.conservative:
        assert wb.evaluate(bounder, BALL.to_grid(resolution=8), samples=20_000).fn == 0


def test_queries_that_tell_nothing_leave_the_usual_fit(rng):
    """All far away, or all in the object: there are no negatives of theirs to learn from."""
    for x in (np.full((50, 3), 9.0), rng.uniform(-0.4, 0.4, (50, 3))):
        bounder = wb.fit(BALL, queries=x, hidden=(12, 12), steps=60, device="cpu", progress=False)
        assert bounder.certificate.proven


@pytest.mark.parametrize(
    ("queries", "told"),
    [
        (np.zeros((0, 3)), r"at least one of them, got \(0, 3\)"),
        (np.zeros((5, 2)), r"must be \(Q, 3\) point queries.*got \(5, 2\)"),
        (np.full((5, 3), np.nan), "5 of 5 with NaN"),
        ("rain", "must be numbers"),
    ],
)
def test_what_are_no_queries_is_refused_in_one_line(queries, told):
    with pytest.raises(QueryError, match=told) as error:
        wb.fit(BALL, queries=queries, device="cpu")
    assert "\n" not in str(error.value)


def test_a_distance_takes_none():
    with pytest.raises(BounderError, match="queries are not for distances"):
        wb.fit(BALL, "distance", queries=np.zeros((5, 3)), device="cpu")
