"""What positives show: the statistical test, the adversarial search, the stress test."""

from dataclasses import replace

import numpy as np
import pytest
from bounding_shapes import CONSERVATIVE, fitted_query, random_mlp, reloaded, shape
from region_cases import placed
from scipy.stats import beta

import warp_bounding as wb
from warp_bounding.bounders import supports
from warp_bounding.errors import BounderError, QueryError
from warp_bounding.proof import attempt_confidence, fn_rate_bound, prove, statistical_test, stress_test, try_positives
from warp_bounding.proof.stress import CYCLE, QUERY_BATCH, Walk, descend, random_world
from warp_bounding.queries import QUERIES, QUERY_KINDS, oracle
from warp_bounding.queries.boundary import FORMS, HardPositives, draw_positives
from warp_bounding.shapes import Function

LENGTH = 0.75


# --- the positives ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["c", "blob", "animated", "mesh", "anisotropic", "half"])
@pytest.mark.parametrize("query", QUERY_KINDS)
def test_hard_positives_are_positives_in_every_form(query, name, device):
    """Streams are the same each time; of regions some begin or reach outside, or are given by a point outside."""
    grid, kind = shape(name), QUERIES[query]
    positives = HardPositives(query, grid, LENGTH, device)
    x = positives.draw(3, 0, 20_000)
    assert len(x) > 4000
    assert kind.truth(grid, x[:100], LENGTH).all()
    assert (x == positives.draw(3, 0, 20_000)).all()
    double = positives.draw(3, 0, 20_000, "float64")
    assert (double != double.astype(np.float32)).any()
    assert kind.truth(grid, double[:100], LENGTH).all()
    parts, truth = list(draw_positives(query, grid, 20_000, 3, "cpu", LENGTH)), oracle(query, grid, "cpu", LENGTH)
    assert sum(map(len, parts)) >= 20_000
    assert all(truth(part).all() for part in parts)
    assert (next(draw_positives(query, grid, 20_000, 3, "cpu", LENGTH)) == parts[0]).all()
    for of in (x, parts[0]) if kind.is_region else ():
        n = grid.ndim
        points = {"ray": of[:, :n], "plane": of[:, n:], "box": of.reshape(-1, n)}[query]
        assert 0.05 < ((points < grid.lower - 1e-3) | (points > grid.upper + 1e-3)).any(axis=1).mean() < 0.95


@pytest.mark.parametrize("name", ["c", "animated"])
@pytest.mark.parametrize("query", QUERY_KINDS)
def test_placed_positives_meet_the_placed_object(query, name):
    """Moved back in float64, which is exact for regions."""
    grid, kind, first = shape(name), QUERIES[query], int(shape(name).time)
    world, options = random_world(grid, np.random.default_rng(4), exact=kind.is_region)
    x, n, xform = HardPositives(query, grid, LENGTH).draw(3, 0, 5000, "placed", world), grid.ndim, options["xform"]
    assert np.allclose(world.forward[first:, first:], xform[:-1, :-1] * options["scale"])
    back = placed(query, x, n, xform[:-1, :-1], xform[:-1, -1], options["scale"], back=True, time=first)
    if query == "box":
        back = np.hstack([np.minimum(back[:, :n], back[:, n:]), np.maximum(back[:, :n], back[:, n:])])
    assert len(back) > 1000
    if kind.is_region:
        assert kind.oracle(grid, "cpu", LENGTH)(back.astype(np.float32)).all()
    else:
        assert kind.truth(grid, back[:300], LENGTH).all()


@pytest.mark.parametrize("query", QUERY_KINDS)
def test_hard_positives_are_hard(query):
    """A step to the next floats leaves the object."""
    x = HardPositives(query, shape("blob"), LENGTH, "cpu").draw(3, 0, 20_000)
    side = np.where(np.random.default_rng(0).random(x.shape) < 0.5, -np.inf, np.inf).astype(np.float32)
    assert (~oracle(query, shape("blob"), "cpu", LENGTH)(np.nextafter(x, side))).mean() > 0.005


# --- the statistical test --------------------------------------------------------------------------------------------


def test_the_bound_is_clopper_and_pearsons_and_restarts_spend_no_more_than_the_risk():
    """Thresholds of which each misses a rate of its own: claims below the true rate are rarer than the risk."""
    for count, confidence in ((1, 0.95), (3000, 0.999), (1_000_000, 0.95)):
        assert fn_rate_bound(count, confidence) == pytest.approx(beta.ppf(confidence, 1, count), rel=1e-9)
    spent = [1 - attempt_confidence(i) for i in range(60)]
    assert sum(spent) <= 0.05 * (1 + 1e-9)
    rng, wrong, count, runs = np.random.default_rng(0), 0, 100, 20_000
    rates = 0.3 * 0.7 ** np.arange(20)  # every restart lowers the threshold, none misses nothing
    for _ in range(runs):
        failures = rng.binomial(count, rates)
        attempt = int(np.argmax(failures == 0))
        if failures[attempt] == 0:
            wrong += fn_rate_bound(count, attempt_confidence(attempt)) < rates[attempt]
    assert wrong / runs <= 0.05
    seeds = {wb.proof.fresh_seed() for _ in range(20)}
    assert len(seeds) == 20
    assert all(0 <= seed < 2**63 for seed in seeds)


def test_a_threshold_that_starts_too_high_is_lowered_and_what_was_sampled_may_be_proven(ticking):
    bounder, grid = made("mlp", "point", "c"), shape("c")
    proven = float(bounder.threshold)
    high = proven + 0.5 * abs(proven) + 1.0
    certificate = statistical_test(bounder, grid, least=high, below=0.0, count=100_000, seed=4)
    assert certificate.restarts > 0
    assert certificate.fn_rate_bound == fn_rate_bound(certificate.samples, attempt_confidence(certificate.restarts))
    assert bounder.threshold < high
    assert try_positives(bounder, grid, 300_000, 99)[2] is None or certificate.worst_margin < 1e-2
    assert statistical_test(bounder, grid, least=proven + 2 * bounder.rounding_bound(), below=0.0).kind == "statistical"
    assert bounder.threshold <= proven
    assert wb.certify(bounder, grid).proven
    assert try_positives(bounder, grid, 1_000_000, 1, budget=0.0) == (0, np.inf, None)
    clock = ticking(0.05)
    done, _, missed = try_positives(bounder, grid, 10**9, 1, budget=0.5)
    assert clock.seconds <= 0.5 + 2 * clock.tick  # the looks at the clock before and after
    assert missed is None
    assert 0 < done < 10**9


def test_networks_without_a_proof_say_so(tmp_path):
    ball = Function(lambda x: np.linalg.norm(x, axis=1) < 0.5, [-1, -1], [1, 1])  # no box is certified to be empty
    bounder = random_mlp(ball, seed=3)
    bounder.info = {"indicator": ball.digest, "margin": 0.0, "seed": 0}
    certificate = statistical_test(bounder, ball, least=10.0, below=0.0, count=100_000)
    assert certificate.kind == "statistical"
    assert certificate.samples >= 100_000
    judged = attempt_confidence(certificate.restarts)
    assert certificate.fn_rate_bound == fn_rate_bound(certificate.samples, judged) > fn_rate_bound(certificate.samples)
    assert certificate.worst_margin >= 0
    assert "not proven" in certificate.message
    assert wb.evaluate(bounder, ball, samples=200_000).fn == 0
    again = reloaded(bounder, tmp_path)
    # far below any value: no fresh positive refutes it
    statistical_test(again, ball, least=0.0, below=20.0, count=10_000)
    assert wb.certify(again, ball).kind == "statistical"
    with pytest.raises(BounderError, match="no proof"):
        prove(bounder, ball)


def test_a_positive_that_counts_as_outside_is_an_error_and_no_threshold():
    """It is denied whatever the threshold is, so lowering that would only hide it."""
    bounder = made("kdop", "box", "c")
    narrow = replace(bounder.domain.base, limit=bounder.domain.base.limit / 4)
    wrong = type(bounder)(replace(bounder.domain, base=narrow), bounder.tensors, bounder.sizes, "cpu")
    with pytest.raises(BounderError, match="limit does not fit its corners"):
        statistical_test(wrong, shape("c"), least=-1e3, below=0.0, count=1000)
    assert wb.certify(wrong, shape("c")).kind != "proven"


# --- the adversarial search ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("query", QUERY_KINDS)
def test_a_walk_goes_down_over_positives(query):
    grid = shape("c")
    bounder = random_mlp(grid, seed=5) if query == "point" else made("kdop", query, "c")
    x = next(draw_positives(query, grid, 64, 5, "cpu", bounder.domain.oracle_length))[:64]
    found, values = Walk(bounder, grid, seed=1).down(x, rounds=60)
    assert found.dtype == np.float32
    assert (np.diff(values) >= 0).all()
    assert values[0] <= bounder.values(x).numpy().min()
    assert oracle(query, grid, bounder.device, bounder.domain.oracle_length)(found).all()
    np.testing.assert_array_equal(bounder.values(found).numpy(), values)
    np.testing.assert_array_equal(found, Walk(bounder, grid, seed=1).down(x, rounds=60)[0])
    negatives = np.tile(grid.upper + 9.0, len(x[0]) // 2 or 1).astype(np.float32)[None]
    if query in ("point", "box"):
        assert len(Walk(bounder, grid).around(negatives)[0]) == len(Walk(bounder, grid).down(negatives)[0]) == 0


# --- the stress test -------------------------------------------------------------------------------------------------


def made(method, query, name="blob", raised=0.0):
    bounder = fitted_query(name, method, query, LENGTH, 20).to("cpu")
    return bounder.freeze(float(bounder.threshold) + raised, None if raised else bounder.certificate)


@pytest.mark.parametrize("query", QUERY_KINDS)
def test_what_is_proven_is_not_contradicted(query):
    reported = []
    result = stress_test(
        made("kdop", query),
        shape("blob"),
        8 * QUERY_BATCH - 100_000,
        seed=1,
        progress=lambda *a: reported.append(a),
    )
    assert result.missed is None
    assert all(result.forms[form] > 0 for form in FORMS)
    assert sum(result.forms.values()) == result.done >= result.wanted
    assert reported[-1][:2] == (result.wanted, result.wanted)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["c", "blob", "animated"])
@pytest.mark.parametrize("query", QUERY_KINDS)
@pytest.mark.parametrize("method", CONSERVATIVE)
def test_no_method_misses_any(method, query, name):
    if not supports(method, query, shape(name).ndim):
        pytest.skip("not of this dimension")
    assert stress_test(made(method, query, name), shape(name), 16 * QUERY_BATCH, seed=2).missed is None


@pytest.mark.parametrize("query", QUERY_KINDS)
def test_a_raised_threshold_is_caught(query):
    raised = made("kdop", query, raised=2e-2)
    result = stress_test(raised, shape("blob"), 4 * QUERY_BATCH, seed=1)
    assert result.missed is not None
    x = np.array([result.missed], np.float32)
    assert oracle(query, shape("blob"), "cpu", LENGTH)(x).all()
    assert raised.query(x).numpy()[0] == 0


@pytest.mark.parametrize("form", ["float64", "placed"])
def test_a_false_negative_in_each_form_is_caught(form, monkeypatch):
    assert set(CYCLE) == set(FORMS)
    monkeypatch.setattr("warp_bounding.proof.stress.CYCLE", (form,))
    raised = made("kdop", "ray", raised=1e-2)
    result = stress_test(raised, shape("blob"), 4 * QUERY_BATCH, seed=1)
    assert result.missed_form == form
    options = result.missed_world or {}
    assert bool(options) == (form == "placed")
    x = np.array([result.missed], np.float64 if form == "float64" else np.float32)
    assert raised.query(x, **options).numpy()[0] == 0


def test_it_ends_where_it_is_told_to_and_refuses_what_makes_no_sense():
    bounder = made("aabb", "point")

    def stop(done, wanted, note):
        raise KeyboardInterrupt

    assert stress_test(bounder, shape("blob"), 10**9, seed=1, progress=stop).interrupted
    assert stress_test(bounder, shape("blob"), 1000, budget=0).done == 0
    for of, reported in (("blob", {"count": 0}), ("blob", {"count": 1.5}), ("blob", {"seed": -1}), ("c", {})):
        with pytest.raises(QueryError):
            stress_test(bounder, shape(of), **{"count": 10, **reported})


# --- the descent into open boxes -----------------------------------------------------------------------------------


def with_a_grain(at: np.ndarray | None) -> Function:
    """A ball and a grain. The grain is so small that millions of random points miss it."""

    def distance(x: np.ndarray) -> np.ndarray:
        ball = np.linalg.norm(x, axis=1) - 0.5
        return ball if at is None else np.minimum(ball, np.linalg.norm(x - at, axis=1) - 2.0**-9)

    return Function(None, np.full(3, -1.0), np.full(3, 1.0), distance=distance, name="a ball and a grain")


def test_a_descent_finds_what_no_sample_meets(rng):
    bounder = wb.fit(with_a_grain(None), hidden=(8,), steps=100, device="cpu")
    x = rng.uniform(-0.9, 0.9, (1_000_000, 3)).astype(np.float32)
    grain = with_a_grain(x[np.argmin(bounder.values(x).numpy())])
    found, boxes = descend(bounder, grain, 0)
    assert len(found)
    assert boxes > 100
    assert grain.contains(found).all()
    assert not bounder.query(found).numpy().any()
    # lowered until it finds none; and where all is proven there is nothing to find
    certificate = statistical_test(bounder, grain, least=float(bounder.threshold), below=0.0, count=10_000)
    assert certificate.restarts >= 1
    assert "open boxes" in certificate.message
    assert not len(descend(bounder, grain, 1)[0])
    assert bounder.query(found).numpy().all()
    assert not len(descend(wb.fit(grain, method="aabb", device="cpu"), grain, 0)[0])
