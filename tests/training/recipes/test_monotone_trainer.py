"""Training of monotone networks: signs survive it, positives are points of the object, and what comes out is proven."""

import numpy as np
import pytest
import torch
from bounding_shapes import shape

import warp_bounding as wb
from warp_bounding.bounders.mlp import MonotoneMlp
from warp_bounding.errors import BounderError
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.training.engine import (
    Clock,
    single_threaded_torch,
)
from warp_bounding.training.recipes.monotone import MonotoneTrainer
from warp_bounding.training.samples import LeastBoxes


def samples_of(name, seed=0):
    return LeastBoxes(shape(name), domain_of(shape(name), "box"), torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("name", ["c", "blob", "animated"])
def test_positives_are_points_of_the_object_wherever_they_walk(name):
    samples, n = samples_of(name), shape(name).ndim
    state = samples.positives(3000)
    for _ in range(4):
        v = samples.coordinates(state)
        assert (v[:n] == v[n:]).all()
        x = samples.domain.base.to_object(v[:n].T.numpy()).astype(np.float32)
        centre = samples.domain.base.to_object(samples.cells.to_local(state[:n]).T.numpy())
        inner = (x + 1e-4 * (centre - x)).astype(np.float32)  # off the faces, where float32 decides
        assert shape(name).contains(inner).all()
        state = samples.move(state, torch.randn(2 * n, 3000, generator=samples.generator), 0.3)
    found = samples.locate(v[:n].T.double().numpy())
    assert (samples.coordinates(found)[:n] - samples.coordinates(found)[n:] == 0).all()
    assert samples.vertices.shape[0] == 2 * n


@pytest.mark.parametrize("activation", ["tanh", "relu"])
def test_training_keeps_the_signs_and_lowers_the_false_positives(activation):
    with single_threaded_torch():
        trainer = MonotoneTrainer(samples_of("c"), (8, 6), activation)
        sizes = {"hidden": [8, 6], "activation": activation, "octaves": 0}
        domain = trainer.samples.domain
        before = MonotoneMlp(domain, trainer.network.tensors(), sizes, "cpu")
        trainer.run(Clock(1.0, 120))
    after = MonotoneMlp(domain, trainer.network.tensors(), sizes, "cpu")
    assert not np.array_equal(before.tensors["layers.0.weight"], after.tensors["layers.0.weight"])
    assert trainer.worst_points().shape[1] == 2
    assert trainer._best[0] < 0.5


@pytest.mark.parametrize(("name", "activation"), [("c", "sin"), ("c", "relu"), ("animated", "tanh")])
def test_fits_are_proven(name, activation):
    grid = shape(name)
    options = {"query": "box", "method": "monotone-mlp", "hidden": (8, 6), "steps": 20, "device": "cpu"}
    bounder = wb.fit(grid, activation=activation, **options)
    assert type(bounder) is MonotoneMlp
    assert bounder.activation == ("relu" if activation == "relu" else "tanh")
    assert bounder.certificate.proven
    assert wb.certify(bounder, grid).proven
    assert wb.evaluate(bounder, grid, samples=20_000).fn == 0
    twin = wb.fit(grid, activation=activation, **options)
    assert all(twin.tensors[k].tobytes() == t.tobytes() for k, t in bounder.tensors.items())
    assert twin.threshold == bounder.threshold


def test_what_it_does_not_take():
    for options in ({"octaves": 2}, {"recipe": "paper"}, {"activation": "gelu"}, {"query": "ray"}, {"query": "point"}):
        with pytest.raises(BounderError):
            wb.fit(shape("c"), **({"query": "box", "method": "monotone-mlp", "steps": 3} | options))
