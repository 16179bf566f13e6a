"""``fit`` of an arm's configurations: its network, its proof, and what is said where no proof fits the budget."""

from importlib import import_module

import numpy as np
import pytest

import warp_bounding as wb
from warp_bounding.proof import lowering

fitting = import_module("warp_bounding.training.fit")  # the package's ``fit`` is the function
OPTIONS = {"device": "cpu", "steps": 100}


@pytest.fixture(scope="module")
def colliding() -> wb.arms.ArmConfigurations:
    elbow = np.eye(4)
    elbow[0, 3] = 0.5
    links = [wb.arms.Body.capsule([0, 0, 0], [0.5, 0, 0], 0.05, link=i) for i in range(2)]
    arm = wb.arms.Arm([wb.arms.Joint(), wb.arms.Joint(elbow)], links)
    return wb.arms.ArmConfigurations(arm, [wb.arms.Body.box([0.6, -0.2, -0.5], [0.8, 0.2, 0.5])])


@pytest.fixture(scope="module")
def loose(colliding) -> wb.Bounder:
    return wb.fit(colliding, hidden=(8, 8), statistical=True, progress=False, **OPTIONS)


def test_an_arms_network_begins_with_its_angles_and_is_proven(colliding):
    notes = []
    bounder = wb.fit(colliding, progress=lambda done, total, note: notes.append(note), **OPTIONS)
    assert bounder.sizes["hidden"] == [2 * len(colliding.waves), *fitting.BEHIND_WAVES]
    assert bounder.certificate.proven
    assert wb.certify(bounder, colliding).proven
    assert wb.evaluate(bounder, colliding, samples=20_000).fn == 0
    rates = bounder.info["rates"]
    assert rates["fp_rate"] < rates["free"] / 2
    assert any("of the volume" in note for note in notes)  # the proof is alive


def test_where_no_proof_fits_the_budget_fit_says_how_long_one_takes_and_loses_nothing(colliding, monkeypatch):
    monkeypatch.setattr(lowering, "_expected", lambda *_: (1e12, 1e-3))
    text = r"80% of .* 10% .*about 1e\+09 s.*budget=.*scheduler=.*held=.*statistical=True"
    with pytest.raises(wb.ProofError, match=text) as error:
        wb.fit(colliding, hidden=(8, 8), progress=False, **OPTIONS)
    monkeypatch.undo()
    assert error.value.seconds == 1e9
    network = error.value.bounder
    assert network.certificate is None
    again = [wb.fit(colliding, hidden=(8, 8), progress=False, **OPTIONS) for _ in range(2)]
    assert again[0].certificate.proven
    assert again[0].threshold == again[1].threshold  # of steps, so that no clock enters
    assert wb.proof.make_proven(network, colliding, budget=600.0, progress=False).certificate.proven


def test_a_threshold_is_not_lowered_until_nothing_is_denied(colliding, loose):
    x = np.random.default_rng(1).uniform(colliding.lower, colliding.upper, (20_000, 2)).astype(np.float32)
    free = x[~colliding.contains(x)]
    for lower in lowering._lowered(loose, colliding):
        assert (lower.query(free).numpy() == 0).mean() > 0.9 * lowering.USEFUL


@pytest.mark.parametrize(("query", "method"), [("point", "aabb"), ("point", "kdop"), ("distance", "aabb")])
def test_a_bounder_that_denies_nearly_nothing_warns(query, method):
    corners = np.zeros((12, 12), dtype=bool)
    corners[:, 0] = corners[:, -1] = corners[0] = corners[-1] = True  # hollow: its box holds all that is free
    with pytest.warns(wb.BoundingWarning, match=r"denies 0\.0% of the free queries"):
        wb.fit(corners, query, method, device="cpu")


def test_what_was_spent_before_a_part_is_not_spent_again(colliding, monkeypatch):
    given = []

    def train(cls, problem, options, seconds, progress):
        given.append(seconds)
        return cls.fit(problem.grid, problem.domain, device=problem.device), {}

    monkeypatch.setitem(fitting.TRAINERS, wb.Bounder, fitting.Trainer(train))
    monkeypatch.setattr(fitting.Stopwatch, "working", property(lambda _: 7.0))
    proofs = []
    monkeypatch.setattr(fitting, "prove_or_test", lambda *_, **limits: proofs.append(limits["budget"]))
    wb.fit(colliding, method="aabb", budget=10.0, device="cpu")
    assert given == [pytest.approx(3.0 * (1 - fitting.PROOF_SHARE))]
    assert proofs == [pytest.approx(3.0)]


def test_a_statistical_test_keeps_its_time(colliding, loose, ticking):
    assert loose.certificate.samples >= 1_000_000
    ticking(0.5)
    least = float(loose.threshold)
    found = wb.proof.statistical_test(loose.to(), colliding, least=least, below=1e-3, budget=3.0)
    assert 0 < found.samples < 1_000_000
