"""The adversarial search finds what random positives do not, and is repeatable where it is told its rounds."""

import pytest
import torch
from bounding_shapes import shape

from warp_bounding.queries.region_domain import domain_of
from warp_bounding.training import engine
from warp_bounding.training.engine import (
    TrainableNetwork,
    adversarial_minimum,
)
from warp_bounding.training.samples import samples_of


@pytest.fixture(autouse=True)
def _small(monkeypatch):
    for name, value in {"STARTS": 4096, "WALKED": 1024, "KEPT": 512}.items():
        monkeypatch.setattr(engine, name, value)


def problem(name, query, seed=0):
    grid = shape(name)
    samples = samples_of(grid, domain_of(grid, query), seed)
    network = TrainableNetwork(samples.ndim, (12, 12), "sin", 0)
    network.initialise(2.0, 2.0, samples.generator)
    return samples, network


def values(network, v):
    h = network.encode(v)
    for layer in network.layers[:-1]:
        h = torch.cat([torch.sin(layer @ h), torch.ones(1, h.shape[1])])
    return (network.layers[-1] @ h)[0]


@pytest.mark.parametrize("query", ["point", "ray", "box"])
@pytest.mark.parametrize("name", ["line", "c", "blob", "animated"])
def test_it_beats_random_positives(name, query):
    samples, network = problem(name, query)
    found = adversarial_minimum(samples, network, 1e9, rounds=20)
    fresh = values(network, samples.coordinates(samples.positives(50_000)))
    assert found.value <= float(fresh.min()) + 1e-5
    assert found.worst.shape == (found.states.shape[1], samples.ndim)
    again = values(network, samples.coordinates(found.states))
    assert torch.allclose(again, found.values, atol=1e-4)
    assert found.values[0] == found.value
    assert (found.values.diff() >= 0).all()


def test_rounds_are_repeatable():
    first, second = (adversarial_minimum(*problem("c", "ray"), 1e9, rounds=3) for _ in range(2))
    assert torch.equal(first.states, second.states)
    assert first.rounds == 3
    assert not first.complete


def test_it_begins_at_known_states():
    samples, network = problem("c", "box")
    best = adversarial_minimum(samples, network, 1e9, rounds=10)
    found = adversarial_minimum(samples, network, 0.0, states=best.states[:, :1])
    assert found.rounds == 1
    assert found.value <= best.value + 1e-5
