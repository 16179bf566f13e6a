"""Positives of arms at their limits, and fits to the queries that a caller asks."""

import numpy as np
import pytest
from plain_shapes import ball_at

import warp_bounding as wb
from sims.arm.robots import CELLS
from warp_bounding.errors import BounderError, QueryError
from warp_bounding.training import fit_network as networks
from warp_bounding.training.samples import samples_of


def test_some_positives_of_joints_lie_at_limits():
    shape = CELLS["planar-3"].shape()
    bounder = wb.fit(shape, method="aabb", device="cpu")
    positives = samples_of(shape, bounder.domain).positives(4096)
    x = bounder.domain.to_object(positives.numpy().T.astype(np.float64)).clip(shape.lower, shape.upper)
    ends = np.isclose(x, shape.lower, rtol=1e-6) | np.isclose(x, shape.upper, rtol=1e-6)
    assert len(x) == 4096
    assert ends.any(axis=1).mean() > 0.03  # of random points next to none
    assert shape.contains(x).mean() > 0.999  # but for what float32 rounds


BALL = ball_at([0.0, 0.0, 0.0], 1.0)


STEPS = 20


@pytest.fixture
def short_trials(monkeypatch):
    monkeypatch.setattr(networks, "FEWEST_STEPS", STEPS * networks.TRIAL_SHARE)


def test_half_spaces_are_in_front_of_a_solids_network(short_trials):
    bounder = wb.fit(BALL, hidden=(8, 8), steps=STEPS, device="cpu", progress=False)
    assert [part.method for part in bounder.parts] == ["learned-kdop", "mlp"]
    assert set(bounder.info["training"]["parts"][1]["trials"]) == {"sin", "relu"}
    assert bounder.certificate.proven
    assert wb.evaluate(bounder, BALL, samples=20_000).fn == 0


def test_an_interrupt_of_a_trial_keeps_the_half_spaces(short_trials):
    notes = []

    def interrupt(done, total, note):
        notes.append(note)
        if note.startswith("FP ") and sum(each.startswith("FP ") for each in notes) == 1:
            raise KeyboardInterrupt

    bounder = wb.fit(BALL, hidden=(8, 8), steps=STEPS, device="cpu", progress=interrupt)
    assert [part.method for part in bounder.parts] == ["learned-kdop", "mlp"]
    assert bounder.info["training"]["parts"][1]["interrupted"]
    assert wb.evaluate(bounder, BALL, samples=20_000).fn == 0


@pytest.mark.parametrize("own", [{"method": "mlp"}, {"activation": "relu"}, {"side": "inside"}, {"steps": STEPS - 1}])
def test_nothing_is_put_in_front_of_a_network_that_was_asked_for(own, short_trials):
    bounder = wb.fit(BALL, **{"hidden": (8, 8), "steps": STEPS, "device": "cpu", "progress": False} | own)
    assert bounder.method == "mlp"


@pytest.mark.parametrize("shape", [BALL, BALL.to_grid(resolution=12)], ids=["shape", "grid"])
def test_a_network_behind_others_learns_what_they_leave(shape):
    box = wb.fit(shape, method="sphere", device="cpu", progress=False)
    samples = samples_of(shape, box.domain, 0, lambda x: box.query(x).numpy())
    v = samples.negatives(4096).numpy().T.astype(np.float64)
    assert box.query(box.domain.to_object(v).astype(np.float32)).numpy().mean() > 0.99  # but for what float32 rounds


def above(rng, count: int) -> np.ndarray:
    """Points around the upper cap of the ball."""
    return rng.uniform([-1.3, -1.3, 0.4], [1.3, 1.3, 1.3], (count, 3)).astype(np.float32)


def wrong(bounder: wb.Bounder, x: np.ndarray) -> float:
    """Share of false positives."""
    return float(((bounder.query(x).numpy() == 1) & ~BALL.contains(x)).mean())


@pytest.mark.slow
def test_false_positives_are_fewer_where_it_is_asked(rng):
    """In the mean of two fits, since one is tighter than another by itself."""
    queried, others = above(rng, 20_000), above(rng, 50_000)
    rates = []
    for queries in (None, queried):
        for seed in range(2):
            own = {"k": 14, "steps": 150, "workload": queries, "seed": seed}
            bounder = wb.fit(BALL, method="learned-kdop", device="cpu", progress=False, **own)
            assert bounder.certificate.proven
            assert wb.evaluate(bounder, BALL, samples=20_000).fn == 0
            rates.append(wrong(bounder, others))
    assert sum(rates[2:]) < 0.9 * sum(rates[:2])


@pytest.mark.parametrize("method", ["aabb", "kdop+mlp"])
def test_every_method_takes_own_queries(method, rng):
    options = {} if method == "aabb" else {"hidden": (8,), "steps": 60}
    bounder = wb.fit(
        BALL, method=method, workload=above(rng, 500), resolution=8, device="cpu", progress=False, **options
    )
    if bounder.conservative:
        assert wb.evaluate(bounder, BALL.to_grid(resolution=8), samples=20_000).fn == 0


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
        wb.fit(BALL, workload=queries, device="cpu")
    assert "\n" not in str(error.value)


def test_a_distance_takes_no_queries():
    with pytest.raises(BounderError, match="a workload is not for distances"):
        wb.fit(BALL, "distance", workload=np.zeros((5, 3)), device="cpu")
