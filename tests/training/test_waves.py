"""The waves of an arm: angles of joints about parallel axes add up, and a network may begin with their sines and cosines."""

import numpy as np
import pytest
import torch

import warp_bounding as wb
from sims.arm.robots import CELLS
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.training.recipes.default import WAVE_DECAY, NetworkTrainer
from warp_bounding.training.samples import samples_of


def arm(axes, slides=()):
    joints = [wb.arms.Joint(axis=axis, slides=i in slides, lower=-1, upper=1) for i, axis in enumerate(axes)]
    bodies = [wb.arms.Body.sphere([0.5, 0, 0], 0.1, link=len(axes) - 1)]
    return wb.arms.Arm(joints, bodies)


@pytest.mark.parametrize(
    ("axes", "slides", "angles"),
    [
        (["z", "z", "z"], (), [[1, 0, 0], [1, 1, 0], [1, 1, 1]]),
        (["z", "-z", "z"], (), [[1, 0, 0], [-1, 1, 0], [1, -1, 1]]),
        (["z", "y", "y"], (), [[1, 0, 0], [0, 1, 0], [0, 1, 1]]),
        (["z", "x", "z"], (1,), [[1, 0, 0], [1, 0, 1]]),
        (["z"], (0,), np.zeros((0, 1))),
    ],
)
def test_angles(axes, slides, angles):
    named = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1), "-z": (0, 0, -2)}
    assert np.array_equal(arm([named[axis] for axis in axes], slides).angles, angles)


def test_places_in_an_arm_are_made_of_the_angles_alone(rng):
    """Turning joints so that no angle changes by more than whole turns leaves a planar arm where it is."""
    one = CELLS["planar-4"].arm
    q = rng.uniform(-3, 3, (50, 4))
    turned = q + 2 * np.pi * rng.integers(-2, 3, q.shape)
    assert np.allclose(one.angles, np.tril(np.ones((4, 4))))
    assert np.allclose(one.frames(q), one.frames(turned))
    assert CELLS["six"].arm.angles.shape == (6, 6)
    assert CELLS["six"].arm.angles[3].tolist() == [0, 1, 1, 1, 0, 0]


def test_a_first_layer_begins_with_them(rng):
    shape = CELLS["planar-2"].shape()
    domain = domain_of(shape, "point")
    samples = samples_of(shape, domain)
    trainer = NetworkTrainer(samples, (4, 8), "sin")
    x = rng.uniform(shape.lower, shape.upper, (200, 2))
    v = torch.from_numpy(domain.to_local(x).T).float()
    layer = trainer.network.layers[0]
    values = torch.sin(layer[:, :-1] @ v + layer[:, -1:]).numpy()
    angles = x / shape.weights @ shape.arm.angles.T
    assert np.allclose(values, np.concatenate([np.sin(angles), np.cos(angles)], axis=1).T, atol=1e-5)
    assert trainer.decay == WAVE_DECAY
    for hidden, activation in (((6, 8), "sin"), ((4, 8), "relu")):
        assert NetworkTrainer(samples_of(shape, domain), hidden, activation).decay == 0


def test_it_is_proven():
    shape = CELLS["planar-2"].shape()
    bounder = wb.fit(shape, hidden=(4, 16, 16), steps=300, device="cpu", progress=False)
    assert bounder.certificate.proven
    assert wb.certify(bounder, shape).proven
    assert wb.evaluate(bounder, shape, samples=20_000).fn == 0
