"""Monotone networks: by their signs alone, on every device within the rounding bound, and no box is missed."""

import numpy as np
import pytest
import warp as wp
from bounding_shapes import shape
from random_networks import random_monotone
from region_cases import cases
from rewriting import check_refused, rewrite

import warp_bounding as wb
from warp_bounding.bounders.mlp import MonotoneMlp
from warp_bounding.errors import BounderError
from warp_bounding.proof import prove
from warp_bounding.queries.domain import Domain
from warp_bounding.queries.region_domain import domain_of

ACTIVATIONS = ("tanh", "relu")
SHAPES = ("c", "blob", "animated")  # 2D, 3D, 4D


def spoilt(bounder, name, index, value) -> dict[str, np.ndarray]:
    tensors = {k: t.copy() for k, t in bounder.tensors.items()}
    tensors[name][index] = value
    return tensors


@pytest.mark.parametrize("layer", [0, 1, 2])
@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_one_weight_of_the_wrong_sign_is_refused(layer, activation):
    bounder, name = random_monotone(shape("c"), (5, 4), activation, dense=True), f"layers.{layer}.weight"
    for index in np.ndindex(bounder.tensors[name].shape):
        tensors = spoilt(bounder, name, index, -bounder.tensors[name][index])
        with pytest.raises(BounderError, match=r"layers\.\d\.weight has the wrong sign"):
            MonotoneMlp(bounder.domain, tensors, bounder.sizes, "cpu")
        MonotoneMlp(bounder.domain, spoilt(bounder, name, index, 0.0), bounder.sizes, "cpu")


def test_what_has_no_say_may_have_any_sign():
    bounder = random_monotone(shape("c"), (5, 4))
    tensors = spoilt(bounder, "layers.2.weight", (0, 1), 0.0)
    tensors["layers.1.weight"][1] = [1.0, -1.0, 1.0, -1.0, 1.0]
    assert MonotoneMlp(bounder.domain, tensors, bounder.sizes, "cpu").signs[1][1] == 0


def test_other_kinds_are_refused():
    bounder = random_monotone(shape("c"), (5,))
    for sizes in ({"activation": "sin"}, {"octaves": 1}):
        with pytest.raises(BounderError):
            MonotoneMlp(bounder.domain, bounder.tensors, bounder.sizes | sizes, "cpu")
    for domain in (Domain.of(shape("c")), domain_of(shape("c"), "ray")):
        assert not MonotoneMlp.supports(domain.query, 2)
    with pytest.raises(BounderError, match="does not bound ray queries"):
        MonotoneMlp(domain_of(shape("c"), "ray"), bounder.tensors, bounder.sizes, "cpu")


@pytest.mark.parametrize("activation", ACTIVATIONS)
@pytest.mark.parametrize("falling", [0.0, 0.5])
@pytest.mark.parametrize("name", SHAPES)
def test_f_never_falls_as_a_box_grows(activation, falling, name, rng):
    for seed in range(4):
        bounder = random_monotone(shape(name), activation=activation, falling=falling, seed=seed)
        n = bounder.ndim
        limit = bounder.domain.limit.astype(np.float64)
        v = rng.uniform(-limit, limit, (4000, 2 * n))
        step = 10.0 ** rng.uniform(-9, 0, (4000, 1)) * rng.random(v.shape) * (rng.random(v.shape) < 0.5)
        larger = v + step * np.repeat([-1.0, 1.0], n)
        f, more = bounder.reference(v), bounder.reference(larger)
        assert (more >= f - 1e-12 * (1 + np.abs(f))).all()  # float64
        assert (more > f).any()


@pytest.mark.parametrize("activation", ACTIVATIONS)
@pytest.mark.parametrize("name", SHAPES)
def test_the_point_network_is_below_every_box_that_holds_the_point(activation, name, rng):
    """Every box that rounding can make of one that holds p: corners up to delta inside of it."""
    for seed in range(4):
        bounder = random_monotone(shape(name), activation=activation, seed=seed)
        base, delta = bounder.domain.base, bounder.domain.base.delta
        p = rng.uniform(-1, 1, (3000, base.ndim)) * (base.limit - delta)
        reach = rng.random((2, *p.shape)) * rng.choice([0.0, 0.0, 1e-6, 1.0], size=(2, len(p), 1))
        inside = rng.choice([0.0, 1.0], size=(2, *p.shape), p=[0.3, 0.7])
        low, high = p - reach[0] + inside[0] * delta, p + reach[1] - inside[1] * delta
        assert (bounder.reference(np.concatenate([low, high], axis=1)) >= bounder.point_network(p)).all()
        # and it is no lower than it needs to be
        tight = bounder.reference(np.concatenate([p + delta, p - delta], axis=1))
        assert np.abs(tight - bounder.point_network(p)).max() < 1e-8


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_devices_stay_within_the_rounding_bound(activation, device, rng):
    grid = shape("blob")
    bounder = random_monotone(grid, activation=activation).to(device)
    low = rng.random((5000, 3)).astype(np.float32)
    q = np.concatenate([low, low + (rng.random((5000, 3)) * (1 - low)).astype(np.float32)], axis=1)
    base = bounder.domain.base
    v = ((q.reshape(-1, 3) - base.center) * base.scale).reshape(-1, 6).astype(np.float64)
    values = bounder.values(q).numpy()
    assert np.abs(values - bounder.reference(v)).max() <= bounder.rounding_bound()
    answers, expected = wp.empty(len(q), dtype=wp.uint8, device=device), values >= 0.3
    bounder.freeze(0.3, None).query(q, out=answers)
    assert (answers.numpy() == expected).all()


@pytest.mark.parametrize(
    ("name", "activation"), [("c", "relu"), ("blob", "tanh"), ("animated", "tanh"), ("single", "relu")]
)
def test_no_box_is_missed(name, activation, rng):
    grid = shape(name)
    q, truth = cases("box", grid, rng)
    for seed in range(3):
        bounder = random_monotone(grid, activation=activation, seed=seed)
        prove(bounder, grid)
        assert bounder.query(q).numpy()[truth].all()


def test_files_come_back_and_hand_edited_ones_do_not(tmp_path, rng):
    grid, path = shape("c"), tmp_path / "c.safetensors"
    bounder = random_monotone(grid, (5, 4), dense=True)
    prove(bounder, grid)
    bounder.save(path)
    twin = wb.load(path, device="cpu")
    assert type(twin) is MonotoneMlp
    assert twin.certificate == bounder.certificate
    assert twin.certificate.proven
    q = cases("box", grid, rng)[0]
    assert (twin.query(q).numpy() == bounder.query(q).numpy()).all()
    held = {k: t.copy() for k, t in bounder.tensors.items()}
    held["layers.0.weight"][0, 0] *= -1
    rewrite(path, lambda document: None, held)
    check_refused(path, "wrong sign")
