"""What trains: gradients, and an adversary that beats random positives."""

import numpy as np
import pytest
import torch
from bounding_shapes import shape

from warp_bounding.bounders.mlp import Mlp
from warp_bounding.queries.domain import Domain
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.training import engine
from warp_bounding.training.engine import (
    Evaluator,
    TrainableNetwork,
    adversarial_minimum,
)
from warp_bounding.training.samples import samples_of

NETWORKS = [  # coordinates, hidden, activation
    (3, (7,), "sin"),
    (3, (6, 5), "relu"),
    (3, (6, 5, 4), "sin"),
    (8, (6,), "relu"),
]


def network_of(ndim, hidden, activation):
    network = TrainableNetwork(ndim, hidden, activation)
    network.initialise(3.0, 1.5, generator(0))
    return network


def autograd(network, v, flat):
    """The same network, written plainly."""
    h, layers = v, network.split(flat)
    for layer in layers[:-1]:
        z = layer[:, :-1] @ h + layer[:, -1:]
        h = {"sin": torch.sin, "relu": torch.relu}[network.activation](z)
    return (layers[-1][:, :-1] @ h + layers[-1][:, -1:])[0]


@pytest.mark.parametrize("sizes", NETWORKS)
def test_gradients_are_autograds(sizes):
    network = network_of(*sizes)
    v = torch.rand(sizes[0], 50, generator=generator(1)) * 2 - 1
    weight = torch.rand(50, generator=generator(2))
    flat, variable = network.flat.clone().requires_grad_(), v.clone().requires_grad_()
    f = autograd(network, variable, flat)
    (f * weight).sum().backward()
    per_sample = torch.autograd.grad(autograd(network, variable, flat).sum(), variable)[0]
    with torch.no_grad():
        worker, x = Evaluator(network), network.encode(v)
        assert torch.allclose(worker.forward(x, keep=True), f, atol=1e-5)
        worker.backward(x, weight.clone())
        assert torch.allclose(worker.gradient, flat.grad, atol=1e-4, rtol=1e-4)
        assert torch.allclose(worker.input_gradient(x), per_sample, atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("sizes", NETWORKS[:3])
def test_the_bounder_is_the_trained_network(sizes):
    network, domain = network_of(*sizes), Domain.of(shape("blob"))
    _, hidden, activation = sizes
    mlp = Mlp(domain, network.tensors(), {"hidden": list(hidden), "activation": activation}, "cpu")
    v = torch.rand(3, 200, generator=generator(1)) * 2 - 1
    f = autograd(network, v, network.flat).numpy()
    assert np.abs(mlp.reference(v.T.numpy()) - f).max() < 1e-4
    network.flat.zero_()  # weights are copied: an optimiser's step would void the proof
    assert np.abs(mlp.reference(v.T.numpy()) - f).max() < 1e-4


@pytest.fixture(autouse=True)
def _small(monkeypatch):
    for name, value in {"STARTS": 4096, "WALKED": 1024, "KEPT": 512}.items():
        monkeypatch.setattr(engine, name, value)


def problem(name, query, seed=0):
    grid = shape(name)
    samples = samples_of(grid, domain_of(grid, query), seed)
    network = TrainableNetwork(samples.ndim, (12, 12), "sin")
    network.initialise(2.0, 2.0, samples.generator)
    return samples, network


def values(network, v):
    h = network.encode(v)
    for layer in network.layers[:-1]:
        h = torch.cat([torch.sin(layer @ h), torch.ones(1, h.shape[1])])
    return (network.layers[-1] @ h)[0]


@pytest.mark.parametrize("query", ["point", "ray", "box"])
@pytest.mark.parametrize("name", ["c", "blob"])
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


def generator(seed):
    return torch.Generator().manual_seed(seed)
