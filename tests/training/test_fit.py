"""``fit``: the loop runs, is repeatable, keeps its budget and survives Ctrl-C."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from bounding_shapes import HIDDEN, few, object_points, shape

import warp_bounding as wb
from warp_bounding.proof import Search
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.training import fit_network as networks
from warp_bounding.training.engine import (
    Clock,
    single_threaded_torch,
)
from warp_bounding.training.fit_network import DECAY, DECAY_ABOVE, MOST_DECAY, PROOF_GROWTH, UNTOLD
from warp_bounding.training.recipes.default import recipe_of
from warp_bounding.training.recipes.paper import PaperTrainer
from warp_bounding.training.samples import samples_of


@pytest.fixture(autouse=True)
def _short_proofs(monkeypatch):
    """Three layers of sines that are hardly trained can keep a proof busy for long; it holds wherever it ends."""
    monkeypatch.setattr(networks, "MINE_POINTS_BOXES", 100_000)
    monkeypatch.setattr(networks, "PROOF_BOXES", 100_000)


def same(a, b) -> bool:
    return all(a.tensors[k].tobytes() == b.tensors[k].tobytes() for k in a.tensors) and a.threshold == b.threshold


OPTIONS = {
    "sin": {},
    "relu": {"activation": "relu"},
    "octaves": {"octaves": 2},
    "three": {"hidden": (13, 30, 5), "activation": "relu"},
    "paper": {"recipe": "paper"},
}


@pytest.mark.parametrize(
    ("name", "options"),
    [("line", "sin"), ("c", "octaves"), ("animated", "relu"), *(("blob", each) for each in OPTIONS)],
)
def test_it_runs(name, options, monkeypatch, rng):
    options = OPTIONS[options]
    monkeypatch.setattr(PaperTrainer, "paper", replace(PaperTrainer.paper, batch=2000, stage=2, stable=2))
    bounder = few(name, **options)
    assert bounder.certificate.proven
    grid = shape(name)
    values = bounder.reference(bounder.domain.to_local(object_points(grid, rng, 1000)))
    asked = values[np.isfinite(values)]
    assert (asked >= bounder.threshold).all()
    record = bounder.info["training"]
    assert 1 <= record["steps"] <= 3
    assert record["recipe"] == options.get("recipe", "default")
    assert bounder.info["indicator"] == grid.digest
    assert bounder.info["seed"] == 0


@pytest.mark.parametrize("recipe", ["default", "paper"])
def test_steps_are_repeatable_and_seeds_differ(recipe, monkeypatch):
    monkeypatch.setattr(PaperTrainer, "paper", replace(PaperTrainer.paper, batch=2000, stage=2, stable=2))
    first = few(recipe=recipe, steps=8, seed=4)
    assert same(first, few(recipe=recipe, steps=8, seed=4))
    assert not same(first, few(recipe=recipe, steps=8, seed=5))


def test_it_learns():
    """A few hundred steps leave fewer false positives than none, in the mean of some fits."""
    means = []
    for steps in (1, 300):
        fits = [few("star", hidden=(25, 25), steps=steps, seed=seed) for seed in range(3)]
        rates = [wb.evaluate(bounder, shape("star"), samples=50_000) for bounder in fits]
        assert not any(each.fn for each in rates)
        means.append(np.mean([each.fp_rate for each in rates]))
    assert means[1] < 0.6 * means[0]


def test_the_budget_is_kept(ticking):
    clock = ticking(0.02)
    bounder = few("star", steps=None, budget=3.0)
    assert clock.seconds < 3.0 * 1.1 + 0.5  # a proof may be late by a tenth, and something comes before and after
    assert bounder.certificate.proven
    assert bounder.info["training"]["steps"] > 10


def test_a_tiny_budget_is_enough_for_a_proof():
    assert few(steps=None, budget=1e-3).certificate.proven


@pytest.mark.parametrize("recipe", ["default", "paper"])
def test_an_interrupt_keeps_the_best_so_far(recipe, monkeypatch):
    monkeypatch.setattr(PaperTrainer, "paper", replace(PaperTrainer.paper, batch=2000, note_every=1))
    calls = []

    def interrupt(done, total, note):
        calls.append((done, total, note))
        if len(calls) == 2:
            raise KeyboardInterrupt

    bounder = few(recipe=recipe, steps=10_000, progress=interrupt)
    assert bounder.certificate.proven
    assert bounder.info["training"]["interrupted"]
    assert bounder.info["training"]["steps"] < 10_000
    assert wb.certify(bounder, shape("blob")).proven
    assert not same(bounder, few(recipe=recipe, steps=1))  # not the weights that it began with


def test_an_interrupt_before_the_first_step():
    def interrupt(*_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):  # the second one, while the proof runs, is heard
        few(progress=interrupt)


def test_counterexamples_enter_the_training(monkeypatch):
    added = []
    original = networks.NetworkTrainer.add

    def add(self, v):
        added.append(len(v))
        return original(self, v)

    monkeypatch.setattr(networks.NetworkTrainer, "add", add)
    monkeypatch.setattr(networks, "MINE_POINTS_AT", (0.0, 0.4))
    bounder = few(steps=250)
    assert len(added) == 2
    assert all(count > 0 for count in added)
    assert bounder.info["training"]["boxes_in_training"] > 0


def test_progress_goes_up():
    seen = []
    few(steps=250, progress=lambda *a: seen.append(a))
    shares = [done / total for done, total, _ in seen]
    assert shares == sorted(shares)
    assert seen[-1][2] == "proof"
    assert "FP" in seen[0][2]


def test_the_margin_and_a_mesh_like_grid():
    bounder = few("mesh", method="kdop", margin=0.03)
    assert bounder.info["margin"] == 0.03
    assert bounder.info["grid_shape"] > list(shape("mesh").shape)
    assert wb.certify(bounder, shape("mesh")).proven


def test_almost_full_and_almost_empty_shapes():
    full = np.ones((40, 40, 40), bool)
    full[0, 0, 0] = False  # a sample hardly ever meets it
    assert wb.fit(full, hidden=HIDDEN, steps=2).certificate.proven
    empty = np.zeros((40, 40, 40), bool)
    empty[5, 6, 7] = True
    assert wb.fit(empty, hidden=HIDDEN, steps=2).certificate.proven


def test_the_last_proof_is_expected_to_take_longer_than_the_looks_at_earlier_networks(monkeypatch, ticking):
    look, kept = 0.05, []
    ticking(0.02)

    def least_value(bounder, grid, **_):
        return Search(0.0, 1.0, np.zeros((0, grid.ndim)), 1, 0.01, complete=False, needed=look)

    def reserve(clock, seconds, used=None):
        kept.append((clock.fraction(), seconds))

    monkeypatch.setattr(networks, "least_value", least_value)
    monkeypatch.setattr(Clock, "reserve", reserve)
    assert few("star", steps=None, budget=6.0).certificate.proven
    assert kept
    for used, seconds in kept:
        assert look * PROOF_GROWTH[1] <= seconds <= look * PROOF_GROWTH[0]
        assert used == 1.0 or seconds > look * PROOF_GROWTH[1]
    assert [seconds for _, seconds in kept] == sorted((seconds for _, seconds in kept), reverse=True)


@pytest.mark.parametrize("share", [0.1, 1.0, 2.0, 100.0])
def test_weights_decay_by_as_much_as_the_proof_of_rays_is_too_long(monkeypatch, ticking, share):
    """``share``: of the time that a proof may take without decay, by the looks at what is trained."""
    made, budget = [], 4.0
    ticking(0.02)

    class Watched(networks.RECIPE_TRAINERS["default"]):
        def __init__(self, *args, **options):
            super().__init__(*args, **options)
            made.append(self)

    needed = share * DECAY_ABOVE * budget / PROOF_GROWTH[1] / UNTOLD  # so that what is expected is at least that share

    real = networks.least_value

    def least_value(bounder, grid, **_):
        numbers = real(bounder, grid, boxes=1).numbers
        return Search(0.0, 1.0, np.zeros((0, 4)), 1, 0.01, complete=False, needed=needed, numbers=numbers)

    monkeypatch.setattr(networks, "least_value", least_value)
    monkeypatch.setattr(networks, "WORTH_PROVING", 1.0)
    monkeypatch.setitem(networks.RECIPE_TRAINERS, "default", Watched)
    few("c", query="ray", steps=None, budget=budget)
    (trainer,) = made
    most = min(share * DECAY * PROOF_GROWTH[0] / PROOF_GROWTH[1], MOST_DECAY)
    assert trainer.decay <= most
    assert trainer.decay >= (min(share * DECAY, MOST_DECAY) if share > 1 else 0.0)


def test_weights_decay():
    trained = {}
    for decay in (0.0, 1.0):
        trainer = networks.RECIPE_TRAINERS["default"](
            samples_of(shape("c"), domain_of(shape("c"), "point"), 0), HIDDEN, "sin"
        )
        trainer.decay = decay
        with single_threaded_torch():
            trainer.run(Clock(0.0, steps=30))
        trained[decay] = [float(layer.abs().mean()) for layer in trainer.network.layers[:-1]]
    assert all(less < more for less, more in zip(trained[1.0], trained[0.0], strict=True))


def test_recipes_by_query_and_coordinates():
    far = recipe_of("ray", 8)
    assert far.hard > recipe_of("ray", 6).hard == recipe_of("point", 8).hard
    assert far.sharpness > recipe_of("ray", 6).sharpness


@pytest.mark.parametrize("hopeful", [True, False])
def test_a_proof_may_be_late_and_a_fit_that_gave_it_up_may_not(monkeypatch, hopeful):
    budget, used, adversary, given = 10.0, 8.0, 0.5, []

    def decide(part, problem, found, limits, report):
        given.append(limits["seconds"])
        return real(part, problem, found, None, report)

    def adversarial_minimum(*args, **options):
        return replace(search(*args, **options), seconds=adversary)

    class Watched(networks._Fit):
        def _decide(self, *args):  # as it is when training ends in time, on a clock that stands still
            self.proof_worthwhile, self.final_search_limit, self.clock = (
                hopeful,
                adversary,
                SimpleNamespace(seconds=used, timed=True, tell=lambda *_: None),
            )
            return super()._decide(*args)

    real, search = networks.decide, networks.adversarial_minimum
    monkeypatch.setattr(networks, "decide", decide)
    monkeypatch.setattr(networks, "adversarial_minimum", adversarial_minimum)
    monkeypatch.setattr(networks, "_Fit", Watched)
    monkeypatch.setattr(networks, "OVERTIME_SHARE", 0.5)
    monkeypatch.setattr(networks, "attest_seconds", lambda budget, little: 0.0)
    few("c", query="ray", budget=budget)
    late = 0.5 * budget if hopeful else 0.0
    assert given == [pytest.approx(budget + late - used - adversary)]
