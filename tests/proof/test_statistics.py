"""Statistical certificates: the bound's arithmetic, thresholds that start too high, and what they may not claim."""

from dataclasses import replace

import numpy as np
import pytest
from bounding_shapes import shape
from scipy.stats import beta

import warp_bounding as wb
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.errors import BounderError
from warp_bounding.indicators import IndicatorGrid
from warp_bounding.proof import attest, certify, fn_rate_bound, try_positives
from warp_bounding.queries import oracle
from warp_bounding.queries.positives import draw_positives


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


def fitted(query, name="c"):
    return wb.fit(shape(name), query=query, hidden=(8,), steps=60, device="cpu")


@pytest.mark.parametrize("query", ["ray", "box"])
def test_fits_without_a_proof_say_so(query, tmp_path):
    bounder = fitted(query)
    certificate = bounder.certificate
    assert certificate.kind == "statistical"
    assert not certificate.proven
    assert certificate.samples >= 1_000_000
    assert certificate.fn_rate_bound == fn_rate_bound(certificate.samples)
    assert certificate.worst_margin >= 0
    assert "not proven" in certificate.message
    assert wb.evaluate(bounder, shape("c"), samples=200_000).fn == 0
    bounder.save(tmp_path / "s.safetensors")
    again = wb.load(tmp_path / "s.safetensors", device="cpu")
    assert again.certificate == certificate
    assert certify(again, shape("c")).kind == "statistical"


def test_a_threshold_that_starts_too_high_is_lowered_until_none_is_missed():
    bounder = fitted("box")
    high = float(bounder.threshold) + 0.5 * abs(float(bounder.threshold)) + 1.0
    certificate = attest(bounder, shape("c"), least=high, room=0.0, count=100_000, seed=4)
    assert certificate.restarts > 0
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
    with pytest.raises(BounderError, match="counts as outside"):
        attest(wrong, shape("c"), least=-1e3, room=0.0, count=1000)
    assert certify(wrong, shape("c")).kind != "proven"
