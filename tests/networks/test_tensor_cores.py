"""Networks on tensor cores: their text run on a CPU, 32 lanes in lockstep; what it may err by."""

import numpy as np
import pytest
import warp as wp
from bounding_shapes import domain_points, random_layers, random_mlp, shape
from distances import far, points_around, thing
from lockstep import lockstep

from warp_bounding.activations import SINE
from warp_bounding.networks import tensor_cores
from warp_bounding.networks.inference import MlpSource
from warp_bounding.networks.network import Network


@pytest.mark.parametrize(("ndim", "hidden"), [(3, (24, 9)), (6, (9, 5))])
def test_emulated_lanes_stay_within_the_rounding_bound(ndim, hidden):
    source, rng = MlpSource(ndim, False, hidden, "sin"), np.random.default_rng(1)
    layers = random_layers((source.coordinates, *hidden, 1), rng)
    network = Network(layers, SINE.name, np.ones(source.coordinates))
    v = rng.uniform(-1, 1, (32, source.coordinates)).astype(np.float32)
    numbers = tensor_cores.numbers(source, layers, np.float32(0.5))
    exact, bound = network(v), tensor_cores.rounding(network)
    for cuts in (0, 1):
        numbers[7] = cuts
        assert np.abs(lockstep(source, numbers, v) - exact).max() <= bound
    assert bound < 1e-2


@pytest.fixture
def card():
    """A card that was verified."""
    if not wp.get_cuda_device_count() or wp.get_device("cuda:0").arch not in tensor_cores.VERIFIED:
        pytest.skip("there is no card on which tensor cores were verified")
    return "cuda:0"


@pytest.mark.parametrize("name", ["c", "blob", "animated"])
@pytest.mark.parametrize("count", [1, 33, 100_003])
def test_cuda_answers_are_those_of_values(card, name, count, rng):
    grid = shape(name)
    bounder, x = random_mlp(grid, (24, 24), gain=2.0).to(card), domain_points(grid, count, rng)
    values = bounder.values(x).numpy().astype(np.float64)
    bounder.freeze(float(np.median(bounder.reference(np.zeros((1, bounder.domain.ndim))))), None)
    assert bounder.tensor_numbers is not None
    answers, own = bounder.query(x).numpy() == 1, tensor_cores.rounding(bounder.network)
    assert answers[values >= bounder.threshold + 2 * bounder.rounding_bound()].all()
    assert not answers[values < bounder.threshold - 2 * own].any()
    assert count < 100 or 0 < answers.mean() < 1


@pytest.mark.parametrize("name", ["blob", "five"])
def test_cuda_distances_are_those_in_float32(card, name, rng):
    bounder, x = far("mlp", name), points_around(thing(name), 20_001, rng)
    there = bounder.to(card)
    assert there.tensor_numbers is not None
    own = 4 * tensor_cores.rounding(bounder.network) / float(bounder.domain.scale.min())
    assert np.abs(there.distance(x).numpy() - bounder.distance(x).numpy()).max() <= own
    start, end = x[:10_000], x[10_000:20_000]
    (maybe, t), (expected, when) = (
        [part.numpy() for part in b.segments(start, end, radius=0.01)] for b in (there, bounder)
    )
    assert (maybe == expected).mean() > 0.99
    assert (np.abs(t - when) < 1e-3).mean() > 0.99
