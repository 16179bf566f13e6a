"""Training has each activation of the registry: its value, its slope, and exits on the features of the network itself."""

import numpy as np
import pytest
import torch
from bounding_shapes import shape

from warp_bounding.activations import ACTIVATIONS
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.training.engine import (
    Evaluator,
    single_threaded_torch,
)
from warp_bounding.training.recipes.default import NetworkTrainer
from warp_bounding.training.recipes.early import _ExitTrainer
from warp_bounding.training.recipes.plane import SupportTrainer
from warp_bounding.training.samples import (
    Problem,
    samples_of,
)

HIDDEN = (7, 6)


@pytest.mark.parametrize("name", ACTIVATIONS)
def test_values_are_those_of_the_bounder_and_slopes_are_autograds(name):
    act = ACTIVATIONS[name]
    z = torch.linspace(-6, 6, 400, dtype=torch.float64, requires_grad=True)
    h = act.torch_value(z)
    assert np.allclose(h.detach().numpy(), ACTIVATIONS[name].value(z.detach().numpy()), atol=1e-12)
    (slope,) = torch.autograd.grad(h.sum(), z)
    with torch.no_grad():
        out, value = torch.empty_like(z), torch.empty_like(z)
        act.torch_value(z, out=value)
        act.torch_slope(z, value, out)
    assert torch.equal(value, h.detach())
    assert torch.allclose(out, slope, atol=1e-12)


def bounder_of(domain, tensors, hidden, activation) -> Mlp:
    return Mlp(domain, tensors, {"hidden": list(hidden), "activation": activation, "octaves": 0}, "cpu")


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_an_exit_sees_the_features_of_its_network(activation):
    """What an exit's training takes for its output is what the exit will compute."""
    domain = domain_of(shape("c"), "point")
    with single_threaded_torch():
        trainer = NetworkTrainer(samples_of(shape("c"), domain, 0), HIDDEN, activation)
        trainer.network.initialise(3.0, 1.5, trainer.generator)
        own = _ExitTrainer(trainer, [trainer.network.layers[0]])
        x = own.network.encode(torch.rand(2, 300) * 2 - 1)
        seen = own._activations(x) @ own.network.layers[-1][0]
        assert torch.allclose(seen, Evaluator(own.network).forward(x), atol=1e-5)
    computed = bounder_of(domain, own.network.tensors(), HIDDEN[:1], activation).reference(x[:2].T.numpy())
    assert np.allclose(seen.numpy(), computed, atol=1e-5)


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_an_exit_of_planes_sees_the_features_of_its_network(activation):
    domain = domain_of(shape("c"), "plane")
    trainer = SupportTrainer(Problem(shape("c"), domain, "plane", 0, "cpu"), HIDDEN, activation)
    own = trainer.behind([layer.detach() for layer in trainer.network.layers[:1]])
    m = torch.rand(300, 2) * 2 - 1
    seen = own.network(m).detach().numpy()
    tensors = trainer.finish()
    first = {name: tensors[name] for name in ("layers.0.weight", "layers.0.bias")}
    head = {name.replace("layers.0", "layers.1"): value for name, value in own.finish().items()}
    parts = bounder_of(domain, first | head, HIDDEN[:1], activation).networks
    computed = np.stack([part(m.double().numpy()) for part in parts], axis=1)
    assert np.allclose(seen, computed, atol=1e-5)
