"""Statistical certificates: the bound's arithmetic, thresholds that start too high, and what they may not claim."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from bounding_shapes import shape, without_proof
from scipy.stats import beta

import warp_bounding as wb
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.errors import BounderError
from warp_bounding.indicators import IndicatorGrid
from warp_bounding.proof import attempt_confidence, attest, certify, fn_rate_bound, fresh_seed, prove, try_positives
from warp_bounding.queries import QUERIES, oracle
from warp_bounding.queries.hard import draw_positives


@pytest.mark.parametrize("count", [1, 10, 3000, 1_000_000])
@pytest.mark.parametrize("confidence", [0.95, 0.999])
def test_the_bound_is_clopper_and_pearsons(count, confidence):
    assert fn_rate_bound(count, confidence) == pytest.approx(beta.ppf(confidence, 1, count), rel=1e-9)


@pytest.mark.parametrize("query", ["point", "ray", "plane", "box"])
@pytest.mark.parametrize("name", ["c", "blob", "anisotropic", "mesh", "animated"])
def test_positives_are_positive_and_enough(query, name):
    grid = shape(name)
    parts = list(draw_positives(query, grid, 20_000, 3, "cpu", 0.7))
    assert sum(map(len, parts)) >= 20_000
    truth = oracle(query, grid, "cpu", 0.7)
    assert all(truth(part).all() for part in parts)
    again = next(draw_positives(query, grid, 20_000, 3, "cpu", 0.7))
    assert (again == parts[0]).all()


@pytest.mark.parametrize("name", ["c", "blob", "animated"])
@pytest.mark.parametrize("query", ["ray", "plane", "box"])
def test_what_is_clipped_is_among_the_positives(query, name):
    """Rays from outside, boxes that reach outside, planes given by a point outside; not where they are not wanted."""
    grid = shape(name)

    def outside(x):
        points = {"ray": x[:, : grid.ndim], "plane": x[:, grid.ndim :], "box": x.reshape(-1, grid.ndim)}[query]
        return float(((points < grid.lower - 1e-3) | (points > grid.upper + 1e-3)).any(axis=1).mean())

    assert outside(next(draw_positives(query, grid, 20_000, 3, "cpu", 1.0))) > 0.05
    assert outside(next(draw_positives(query, grid, 20_000, 3, "cpu", 1.0, outside=False))) == 0.0 or query == "plane"
    assert "outside" in QUERIES[query].distribution or "away" in QUERIES[query].distribution


def test_directions_of_any_length_are_among_the_positives():
    for query, columns in (("ray", slice(3, 6)), ("plane", slice(0, 3))):
        x = next(draw_positives(query, shape("blob"), 20_000, 3, "cpu", 1.0))
        length = np.linalg.norm(x[:, columns].astype(np.float64), axis=1)
        assert (length > 8).any()
        assert (length < 1 / 8).any()


def test_attempts_together_spend_no_more_than_the_risk():
    spent = [1 - attempt_confidence(i) for i in range(60)]
    assert sum(spent) <= 0.05 * (1 + 1e-9)
    assert attempt_confidence(0) == pytest.approx(0.975)
    assert all(a > b for a, b in pairwise(spent[:30]))


def test_a_procedure_that_restarts_keeps_its_confidence():
    """Thresholds of which each misses a rate of its own: claims below the true rate are rarer than the risk."""
    rng, wrong, count, runs = np.random.default_rng(0), 0, 100, 20_000
    rates = 0.3 * 0.7 ** np.arange(20)  # every restart lowers the threshold, none misses nothing
    for _ in range(runs):
        failures = rng.binomial(count, rates)
        attempt = int(np.argmax(failures == 0))
        if failures[attempt] == 0:
            wrong += fn_rate_bound(count, attempt_confidence(attempt)) < rates[attempt]
    assert wrong / runs <= 0.05


def test_seeds_are_fresh():
    seeds = {fresh_seed() for _ in range(20)}
    assert len(seeds) == 20
    assert all(0 <= seed < 2**63 for seed in seeds)
    one, other = (next(draw_positives("point", shape("c"), 100, seed, "cpu")) for seed in list(seeds)[:2])
    assert len(one) != len(other) or (one != other).any()


def test_the_time_allowed_is_kept_and_what_was_done_is_told(ticking):
    bounder, grid = fitted("box"), shape("c")
    assert try_positives(bounder, grid, 1_000_000, 1, seconds=0.0) == (0, np.inf, None)
    told, clock = [], ticking(0.05)
    done, _, missed = try_positives(bounder, grid, 10**9, 1, lambda *a: told.append(a), seconds=0.5)
    assert clock.seconds <= 0.5 + 2 * clock.tick  # the looks at the clock before and after
    assert missed is None
    assert 0 < done < 10**9
    assert told[-1] == (done, 10**9)
    certificate = attest(bounder, grid, least=float(bounder.threshold), room=0.0, seconds=0.0)
    assert (certificate.samples, certificate.fn_rate_bound, certificate.worst_margin) == (0, 1.0, None)


@cache
def _fitted(query, name):
    return wb.fit(shape(name), query=query, hidden=(8,), steps=60, device="cpu")


def fitted(query, name="c"):
    """A copy, which may be changed."""
    made = _fitted(query, name)
    twin = type(made)(made.domain, made.tensors, made.sizes, "cpu")
    twin.info = dict(made.info)
    return twin.freeze(float(made.threshold), made.certificate)


def test_networks_without_a_proof_say_so(tmp_path, monkeypatch):
    bounder = without_proof(monkeypatch)
    certificate = attest(bounder, shape("c"), least=10.0, room=0.0)
    assert certificate.kind == "statistical"
    assert not certificate.proven
    assert certificate.samples >= 1_000_000
    assert certificate.confidence == 0.95
    judged = attempt_confidence(certificate.restarts)
    assert certificate.fn_rate_bound == fn_rate_bound(certificate.samples, judged) > fn_rate_bound(certificate.samples)
    assert certificate.worst_margin >= 0
    assert "not proven" in certificate.message
    assert wb.evaluate(bounder, shape("c"), samples=200_000).fn == 0
    bounder.save(tmp_path / "s.safetensors")
    again = wb.load(tmp_path / "s.safetensors", device="cpu")
    assert again.certificate == certificate
    attest(again, shape("c"), least=0.0, room=20.0, count=10_000)  # far below any value: no fresh positive refutes it
    assert certify(again, shape("c")).kind == "statistical"
    with pytest.raises(BounderError, match="no proof"):
        prove(bounder, shape("c"))


@pytest.mark.parametrize("query", ["ray", "box"])
def test_what_was_only_sampled_may_be_proven_later(query):
    bounder = fitted(query)
    assert bounder.certificate.proven
    threshold = float(bounder.threshold)
    certificate = attest(bounder, shape("c"), least=threshold + 2 * bounder.rounding_bound(), room=0.0)
    assert certificate.kind == "statistical"
    assert bounder.threshold <= threshold
    assert certify(bounder, shape("c")).proven


def test_a_threshold_that_starts_too_high_is_lowered_until_none_is_missed():
    bounder = fitted("box")
    high = float(bounder.threshold) + 0.5 * abs(float(bounder.threshold)) + 1.0
    certificate = attest(bounder, shape("c"), least=high, room=0.0, count=100_000, seed=4)
    assert certificate.restarts > 0
    assert certificate.fn_rate_bound == fn_rate_bound(certificate.samples, attempt_confidence(certificate.restarts))
    assert certificate.fn_rate_bound > fn_rate_bound(certificate.samples, attempt_confidence(0))
    assert f"attempt {certificate.restarts + 1}" in certificate.message
    assert "missed one" in certificate.message
    assert bounder.threshold < high
    assert try_positives(bounder, shape("c"), 300_000, 99)[2] is None or certificate.worst_margin < 1e-2


def test_certify_finds_what_a_raised_threshold_misses():
    bounder = fitted("ray")
    raised = bounder.freeze(float(bounder.threshold) + 2.0, None)
    proof = certify(raised, shape("c"))
    assert proof.kind == "refuted"
    query = np.array([proof.counterexample], np.float32)
    assert oracle("ray", shape("c"), "cpu")(query).all()
    assert raised.query(query).numpy()[0] == 0


@pytest.mark.parametrize("query", ["ray", "plane", "box"])
def test_positives_of_an_object_that_is_hardly_ever_met(query):
    """Few uniform queries meet it; one does not wait for half a million of them."""
    occupancy = np.zeros((64, 64, 64), dtype=bool)
    occupancy[30, 31, 32] = True
    grid = IndicatorGrid(occupancy)
    parts = []
    for part in draw_positives(query, grid, 200_000, 0, "cpu", 1.0):
        parts.append(len(part))
        assert len(parts) < 6
    assert sum(parts) >= 200_000


def test_a_positive_that_counts_as_outside_is_an_error_and_no_threshold():
    """It is denied whatever the threshold is, so lowering that would only hide it."""
    bounder = fitted("box")
    narrow = replace(bounder.domain.base, limit=bounder.domain.base.limit / 4)
    wrong = Mlp(replace(bounder.domain, base=narrow), bounder.tensors, bounder.sizes, "cpu")
    with pytest.raises(BounderError, match="limit does not fit its corners"):
        attest(wrong, shape("c"), least=-1e3, room=0.0, count=1000)
    assert certify(wrong, shape("c")).kind != "proven"
