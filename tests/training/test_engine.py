"""What trains: gradients, and weights that are copied."""

import numpy as np
import pytest
import torch
from bounding_shapes import shape

from warp_bounding.bounders.mlp import Mlp
from warp_bounding.queries.domain import Domain
from warp_bounding.training.engine import Evaluator, TrainableNetwork

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


def generator(seed):
    return torch.Generator().manual_seed(seed)
