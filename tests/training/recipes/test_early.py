"""Exits in training: they leave finished layers alone, deny negatives, and come with what a threshold's search needs."""

import numpy as np
import pytest
from bounding_shapes import shape

from warp_bounding.bounders.mlp_early import MlpEarly
from warp_bounding.queries import oracle, sample
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.training.engine import (
    Clock,
    single_threaded_torch,
)
from warp_bounding.training.recipes.default import NetworkTrainer
from warp_bounding.training.recipes.early import EarlyTrainer, train_exits
from warp_bounding.training.recipes.plane import SupportTrainer
from warp_bounding.training.samples import (
    Problem,
    samples_of,
)

HIDDEN = (12, 10)


def trained(kind, query="point", name="c", hidden=HIDDEN, steps=60, exit_steps=12):
    """The network's tensors, its exits and their trainers, and its domain."""
    grid = shape(name)
    domain = domain_of(grid, query)
    with single_threaded_torch():
        if kind is SupportTrainer:
            trainer = SupportTrainer(Problem(grid, domain, query, 0, "cpu"), hidden, "sin")
        else:
            trainer = kind(samples_of(grid, domain, 0), hidden, "sin", 0)
        trainer.run(Clock(1.0, steps))
        tensors = trainer.finish()
        exits, trainers = train_exits(trainer, tensors, 1.0, exit_steps)
    return tensors, exits, trainers, domain


def assembled(tensors, exits, domain, hidden=HIDDEN) -> MlpEarly:
    sizes = {"hidden": list(hidden), "activation": "sin", "octaves": 0}
    return MlpEarly(domain, tensors | exits, sizes, "cpu")


@pytest.mark.parametrize("kind", [NetworkTrainer, EarlyTrainer])
def test_exits_deny_negatives(kind):
    tensors, exits, trainers, domain = trained(kind, steps=150, exit_steps=24)
    first = assembled(tensors, exits, domain).parts[0]
    x = sample("point", shape("c"), 20_000, np.random.default_rng(1))
    truth = oracle("point", shape("c"), "cpu")(x)
    values = first.reference(domain.to_local(x))
    least = min(values[truth].min(), first.reference(trainers[0].worst_points()).min())
    denied = (values < least)[~truth].mean()
    assert denied > 0.1
    assert trainers[0].network.tensors()["layers.0.weight"].tobytes() == tensors["layers.0.weight"].tobytes()
    assert trainers[0].network.tensors()["layers.1.weight"].tobytes() == exits["exits.0.weight"].tobytes()
    assert trainers[0].hard.shape[1] > 0


def test_every_layer_but_the_last_has_one():
    hidden = (8, 7, 6)
    tensors, exits, trainers, domain = trained(EarlyTrainer, hidden=hidden, steps=20, exit_steps=3)
    bounder = assembled(tensors, exits, domain, hidden)
    assert [part.hidden for part in bounder.parts] == [(8,), (8, 7), (8, 7, 6)]
    assert len(trainers) == 2


def test_runs_in_steps_repeat():
    first, second = (trained(EarlyTrainer, steps=30, exit_steps=5) for _ in range(2))
    for one, other in ((first[0], second[0]), (first[1], second[1])):
        assert all(one[name].tobytes() == other[name].tobytes() for name in one)


@pytest.mark.parametrize("query", ["ray", "box"])
def test_regions(query):
    tensors, exits, trainers, domain = trained(EarlyTrainer, query, steps=20, exit_steps=4)
    bounder = assembled(tensors, exits, domain)
    assert np.isfinite(bounder.parts[0].reference(trainers[0].worst_points())).all()


def test_planes_have_two_outputs():
    tensors, exits, _, domain = trained(SupportTrainer, "plane", steps=60, exit_steps=30)
    bounder = assembled(tensors, exits, domain)
    assert exits["exits.0.weight"].shape == (2, HIDDEN[0])
    x = sample("plane", shape("c"), 20_000, np.random.default_rng(1))
    truth = oracle("plane", shape("c"), "cpu")(x)
    values = bounder.parts[0].reference(domain.to_local(x))
    assert (values < values[truth].min())[~truth].any()


def test_one_hidden_layer_has_none():
    _, exits, trainers, _ = trained(EarlyTrainer, hidden=(6,), steps=5, exit_steps=2)
    assert (exits, trainers) == ({}, [])
