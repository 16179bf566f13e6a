"""The parts of training against plain twins: gradients, clock, team."""

import numpy as np
import pytest
import torch
from bounding_shapes import shape

from warp_bounding.bounders.mlp import Mlp
from warp_bounding.queries.domain import Domain
from warp_bounding.training.engine import (
    Clock,
    Evaluator,
    Team,
    TrainableNetwork,
    single_threaded_torch,
)

NETWORKS = [  # coordinates, hidden, activation, octaves
    (3, (7,), "sin", 0),
    (3, (6, 5), "relu", 0),
    (3, (6, 5), "tanh", 0),
    (3, (6, 5, 4), "sin", 1),
    (8, (6,), "relu", 0),
]


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def network_of(ndim, hidden, activation, octaves):
    network = TrainableNetwork(ndim, hidden, activation, octaves)
    network.initialise(3.0, 1.5, generator())
    return network


def autograd(network, v, flat):
    """The same network, written plainly."""
    h = v
    if network.encoding:
        h = torch.cat(
            [h, torch.sin(network.encoding["encoding.weight"] @ v + network.encoding["encoding.bias"][:, None])]
        )
    layers = network.split(flat)
    for layer in layers[:-1]:
        z = layer[:, :-1] @ h + layer[:, -1:]
        h = {"sin": torch.sin, "relu": torch.relu, "tanh": torch.tanh}[network.activation](z)
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
        assert torch.allclose(network.decode_gradient(worker.input_gradient(x), v), per_sample, atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("sizes", NETWORKS[:4])
def test_the_bounder_is_the_trained_network(sizes):
    network, domain = network_of(*sizes), Domain.of(shape("blob"))
    _, hidden, activation, octaves = sizes
    mlp = Mlp(domain, network.tensors(), {"hidden": list(hidden), "activation": activation, "octaves": octaves}, "cpu")
    v = torch.rand(3, 200, generator=generator(1)) * 2 - 1
    f = autograd(network, v, network.flat).numpy()
    assert np.abs(mlp.reference(v.T.numpy()) - f).max() < 1e-4
    network.flat.zero_()  # weights are copied: an optimiser's step would void the proof
    assert np.abs(mlp.reference(v.T.numpy()) - f).max() < 1e-4


def test_clocks():
    steps = Clock(1.0, 4)
    assert not steps.timed
    for expected in (0, 0.25, 0.5, 0.75, 1.0):
        assert steps.fraction() == expected
        steps.count += 1
    timed = Clock(1e6)
    assert timed.timed
    assert timed.fraction() < 0.01
    assert Clock(1e-9).fraction() >= 1


def test_reserves_do_not_make_schedules_jump():
    clock = Clock(100.0)
    clock.started -= 20.0
    assert clock.fraction() == pytest.approx(0.2, abs=1e-3)
    clock.reserve(39.0)
    assert (clock.fraction(), clock.reserved) == (pytest.approx(0.2, abs=1e-3), 39.0)
    clock.started -= 20.0
    assert clock.fraction() == pytest.approx(0.2 + 0.8 * 20 / 41, abs=1e-3)
    clock.reserve(90.0)  # more than there is: what is left of training goes on twice as fast
    assert clock.fraction() == pytest.approx(0.2 + 0.8 * 20 / 41, abs=1e-3)
    assert clock.reserved == pytest.approx(49.5, abs=1e-2)
    clock.started -= 5.0
    clock.reserve(0.0)
    assert clock.fraction() == pytest.approx(1 - 0.8 * 21 / 41 * 5.5 / 10.5, abs=1e-3)
    clock.started -= 55.0
    assert clock.fraction() == pytest.approx(1.0, abs=1e-3)


def test_what_is_reserved_after_the_end_does_not_begin_it_anew():
    clock = Clock(1.0)
    clock.started -= 1.2  # a look that took longer than it was given
    for seconds, used in ((0.5, None), (0.0, None), (0.5, 0.9), (0.0, 1.3)):
        clock.reserve(seconds, used)
        clock.started -= 0.1
        assert clock.fraction() == 1.0
    early = Clock(1.0)
    early.reserve(0.9, 1.2)  # out of time, as more was reserved than expected
    assert early.fraction() >= 1.0


@pytest.mark.parametrize("size", [1, 2, 4])
def test_teams(size):
    team, seen = Team(size), []
    team.run(seen.append)
    assert sorted(seen) == list(range(size))

    def fail(index):
        if index == size - 1:
            raise RuntimeError("one of us")

    with pytest.raises(RuntimeError, match="one of us"):
        team.run(fail)
    team.run(seen.append)
    assert len(seen) == 2 * size


def test_torch_is_left_as_it_was():
    threads = torch.get_num_threads()
    with single_threaded_torch():
        assert torch.get_num_threads() == 1
        assert not torch.is_grad_enabled()
    assert torch.get_num_threads() == threads
    assert torch.is_grad_enabled()
