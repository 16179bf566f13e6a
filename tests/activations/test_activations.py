"""Every activation in every network, through the registries: fitted, certified, stored, and asked hard positives."""

import numpy as np
import pytest
import warp as wp
from bounding_shapes import EARLY, HIDDEN, object_points, shape, told_of
from region_cases import hard_regions, ray_length

import warp_bounding as wb
from warp_bounding.activations import ACTIVATIONS
from warp_bounding.bounders import METHODS
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.bounders.mlp_early import MlpEarly
from warp_bounding.errors import BounderError
from warp_bounding.queries import QUERY_KINDS, oracle, sample
from warp_bounding.training import fit_network as networks

NETWORKS = tuple(name for name, kind in METHODS.items() if issubclass(kind, Mlp))
SHAPES = ("c", "blob", "animated")  # 2D, 3D, 4D


def cases() -> list:
    """All of them with ``--slow``; else each method with each query, with each activation, and in each dimension, in turns.

    ``mlp``, whose kernels other tests need as well, has points in every activation.
    """
    params = []
    for i, method in enumerate(NETWORKS):
        for j, query in enumerate(QUERY_KINDS):
            for k, activation in enumerate(ACTIVATIONS):
                for turn, name in enumerate(SHAPES):
                    if METHODS[method].supports(query, shape(name).ndim):
                        usual = turn == ((i + 2 * k) % len(SHAPES) if query == "point" else 0)
                        if (method, query) != ("mlp", "point"):
                            usual &= (i + j + k) % len(ACTIVATIONS) == 0
                        marks = () if usual else pytest.mark.slow
                        params.append(pytest.param(method, query, name, activation, marks=marks))
    return params


@pytest.mark.parametrize(("method", "query", "name", "activation"), cases())
def test_every_activation_in_every_network(method, query, name, activation, monkeypatch, tmp_path):
    monkeypatch.setattr(networks, "PROOF_BOXES", 100_000)  # these are hardly trained: a proof holds wherever it ends
    monkeypatch.setattr(networks, "REGION_PROOF_BOXES", 100_000)
    grid, kind = shape(name), METHODS[method]
    hidden, length = EARLY if issubclass(kind, MlpEarly) else HIDDEN, ray_length(grid)
    told = told_of(method, query, activation=activation, hidden=hidden, steps=3, length=length)
    bounder = wb.fit(grid, query, method, device="cpu", **told)
    assert bounder.activation in (activation, ACTIVATIONS[activation].monotone.name)
    bounder.save(tmp_path / "b.safetensors")
    loaded = wb.load(tmp_path / "b.safetensors")
    assert loaded.activation == bounder.activation
    rng = np.random.default_rng(0)
    hard = object_points(grid, rng) if query == "point" else hard_regions(query, grid, rng, length)
    q = np.concatenate([sample(query, grid, 4000, rng), hard]).astype(np.float32)
    truth = oracle(query, grid, "cpu", length)(q)
    answers = loaded.query(q).numpy().astype(bool)
    assert (answers == bounder.query(q).numpy()).all()
    assert truth.sum() > 1000
    # the proof may end where that of the fit had too few boxes, never the other way round
    held = {bounder.certificate.kind, "proven"} if kind.conservative else {"inapplicable"}
    assert wb.certify(loaded, grid).kind in held
    assert answers[truth].all() or not (kind.conservative and bounder.certificate.proven)


@pytest.mark.parametrize("name", ["softplus", "", None, 1, ["sin"], {"sin": 1}])
def test_what_is_no_activation(name):
    bounder = METHODS["mlp"]
    with pytest.raises(BounderError, match=r"activation must be one of sin, relu, tanh, got .*") as error:
        bounder(wb.fit(shape("c"), method="aabb", device="cpu").domain, {}, {"hidden": [3], "activation": name}, "cpu")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", ACTIVATIONS)
def test_what_the_registry_says_of_an_activation(name):
    """Slopes from -1 to 1, values within ``largest``, monotone ones never fall."""
    activation, x = ACTIVATIONS[name], np.linspace(-30, 30, 600_001)
    y = activation.value(x)
    assert activation.name == name
    assert (np.abs(np.diff(y)) <= np.diff(x) * (1 + 1e-9)).all()
    assert (np.abs(y) <= (np.abs(x) if activation.largest is None else activation.largest)).all()
    twin = activation.monotone
    assert twin.monotone is twin
    assert (np.diff(twin.value(x)) >= 0).all()
    assert activation.error(1.0) < 1e-5
    near, noise = np.full((1, len(x)), 0.1), np.full((1, len(x)), 1e-3)
    if activation.bends:
        assert (activation.curve(x[None], near, noise, noise).bend != 0).any()
        with pytest.raises(NotImplementedError, match=f"{name}: .*defines `relax`"):
            activation.relax(x[None], near, noise)
    else:
        assert (activation.relax(x[None], near, noise)[2] == 0).all()
        with pytest.raises(NotImplementedError, match=f"{name}: .*defines `curve`"):
            activation.curve(x[None], near, noise, noise)


def plain_kernel(activation):
    @wp.kernel(module="unique", enable_backward=False)
    def values(z: wp.array(dtype=float), h: wp.array(dtype=float)):
        h[wp.tid()] = wp.static(activation.plain)(z[wp.tid()])

    return values


@pytest.mark.parametrize("name", ACTIVATIONS)
def test_plain_values_are_within_the_error(name, device):
    activation, limit = ACTIVATIONS[name], min(ACTIVATIONS[name].limit, 1e3)
    z = np.linspace(-limit, limit, 200_001).astype(np.float32)
    h = wp.empty(len(z), dtype=float, device=device)
    wp.launch(plain_kernel(activation), len(z), [wp.array(z, dtype=float, device=device)], [h], device=device)
    error = np.abs(h.numpy() - activation.value(z.astype(np.float64)))
    assert error.max() <= activation.error(limit)
    assert np.abs(activation.value32(z) - h.numpy()).max() <= 2 * activation.error(limit)
