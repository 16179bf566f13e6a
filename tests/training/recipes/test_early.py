"""Exits in training: they leave finished layers alone, deny negatives, and come with what a threshold's search needs."""

import numpy as np
import pytest
from bounding_shapes import shape

torch = pytest.importorskip("torch", reason="torch is not installed")

from warp_bounding.bounders.neural.mlp_early import MlpEarly  # noqa: E402
from warp_bounding.coordinates.region_domain import domain_of  # noqa: E402
from warp_bounding.queries import oracle, sample  # noqa: E402
from warp_bounding.training.engine.clock import Clock  # noqa: E402
from warp_bounding.training.engine.team import single_threaded_torch  # noqa: E402
from warp_bounding.training.recipes.default import Trainer  # noqa: E402
from warp_bounding.training.recipes.early import EarlyTrainer, train_exits  # noqa: E402
from warp_bounding.training.recipes.plane import SupportTrainer  # noqa: E402
from warp_bounding.training.samples import samples_of  # noqa: E402

HIDDEN = (12, 10)


def trained(kind, query="point", name="c", hidden=HIDDEN, steps=60, exit_steps=12):
    """The network's tensors, its exits, and its domain."""
    grid = shape(name)
    domain = domain_of(grid, query)
    with single_threaded_torch():
        if kind is SupportTrainer:
            trainer = SupportTrainer(grid, domain, hidden, "sin", 0)
        else:
            trainer = kind(samples_of(grid, domain, 0), hidden, "sin", 0)
        trainer.run(Clock(1.0, steps))
        tensors = trainer.tensors() if kind is SupportTrainer else trainer.network.tensors(trainer.best())
        notes = []
        exits = train_exits(trainer, tensors, 1.0, exit_steps, progress=lambda used, note: notes.append((used, note)))
    assert notes
    assert all(0 <= used <= 1 and note.startswith("exit") for used, note in notes)
    return tensors, exits, domain


def assembled(tensors, exits, domain, hidden=HIDDEN) -> MlpEarly:
    sizes = {"hidden": list(hidden), "activation": "sin", "octaves": 0}
    return MlpEarly(domain, tensors | exits.tensors, sizes, "cpu")


@pytest.mark.parametrize("kind", [Trainer, EarlyTrainer])
def test_exits_deny_negatives(kind):
    tensors, exits, domain = trained(kind, steps=150, exit_steps=24)
    first = assembled(tensors, exits, domain).parts[0]
    x = sample("point", shape("c"), 20_000, np.random.default_rng(1))
    truth = oracle("point", shape("c"), "cpu")(x)
    values = first.reference(domain.to_local(x))
    least = min(values[truth].min(), first.reference(exits.points[0]).min())
    denied = (values < least)[~truth].mean()
    assert denied > 0.1
    assert exits.networks[0].tensors()["layers.0.weight"].tobytes() == tensors["layers.0.weight"].tobytes()
    assert exits.networks[0].tensors()["layers.1.weight"].tobytes() == exits.tensors["exits.0.weight"].tobytes()
    assert exits.states[0].shape[1] > 0


def test_every_layer_but_the_last_has_one():
    hidden = (8, 7, 6)
    tensors, exits, domain = trained(EarlyTrainer, hidden=hidden, steps=20, exit_steps=3)
    bounder = assembled(tensors, exits, domain, hidden)
    assert [part.hidden for part in bounder.parts] == [(8,), (8, 7), (8, 7, 6)]
    assert len(exits.networks) == len(exits.states) == len(exits.points) == 2


def test_runs_in_steps_repeat():
    first, second = (trained(EarlyTrainer, steps=30, exit_steps=5) for _ in range(2))
    for one, other in ((first[0], second[0]), (first[1].tensors, second[1].tensors)):
        assert all(one[name].tobytes() == other[name].tobytes() for name in one)


@pytest.mark.parametrize("query", ["ray", "box"])
def test_regions(query):
    tensors, exits, domain = trained(EarlyTrainer, query, steps=20, exit_steps=4)
    bounder = assembled(tensors, exits, domain)
    assert np.isfinite(bounder.parts[0].reference(exits.points[0])).all()


def test_planes_have_two_outputs():
    tensors, exits, domain = trained(SupportTrainer, "plane", steps=60, exit_steps=30)
    bounder = assembled(tensors, exits, domain)
    assert exits.tensors["exits.0.weight"].shape == (2, HIDDEN[0])
    x = sample("plane", shape("c"), 20_000, np.random.default_rng(1))
    truth = oracle("plane", shape("c"), "cpu")(x)
    values = bounder.parts[0].reference(domain.to_local(x))
    assert (values < values[truth].min())[~truth].any()


def test_one_hidden_layer_has_none():
    _, exits, _ = trained_alone((6,))
    assert exits.tensors == {}


def trained_alone(hidden):
    grid = shape("c")
    domain = domain_of(grid, "point")
    with single_threaded_torch():
        trainer = EarlyTrainer(samples_of(grid, domain, 0), hidden, "sin")
        trainer.run(Clock(1.0, 5))
        tensors = trainer.network.tensors(trainer.best())
        return tensors, train_exits(trainer, tensors, 1.0, 2), domain
