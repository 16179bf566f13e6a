"""Every activation in float32, in training, and in every network: fitted, certified, stored, and asked hard
positives."""

import numpy as np
import pytest
import warp as wp
from bounding_shapes import EARLY, HIDDEN, object_points, report_of, shape
from fused_activations import PLAIN, fused_sine, plain_sine
from region_cases import hard_regions, ray_length

import warp_bounding as wb
from warp_bounding.activations import ACTIVATIONS, SINE, SINE_LIMIT
from warp_bounding.bounders import METHODS
from warp_bounding.bounders.mlp_early import MlpEarly
from warp_bounding.queries import oracle, sample
from warp_bounding.training import fit_network as networks

F32 = np.float32
CASES = [  # each method with each query, with each activation, and in each dimension
    *(("mlp", "point", name, act) for name, act in (("c", "sin"), ("animated", "relu"), ("blob", "sin"))),
    *(("mlp", "ray", "c", "relu"), ("mlp", "plane", "c", "relu"), ("mlp", "box", "c", "sin")),
    *(("mlp-early", "point", "animated", "sin"), ("mlp-early", "ray", "c", "relu")),
    *(("mlp-early", "plane", "c", "sin"), ("mlp-early", "box", "c", "relu")),
    *(("occupancy", "point", "c", "relu"), ("occupancy", "ray", "c", "sin"), ("occupancy", "plane", "c", "relu")),
]


@pytest.mark.parametrize(("method", "query", "name", "activation"), CASES)
def test_every_activation_in_every_network(method, query, name, activation, monkeypatch, tmp_path):
    monkeypatch.setattr(networks, "PROOF_BOXES", 100_000)  # these are hardly trained: a proof holds wherever it ends
    monkeypatch.setattr(networks, "REGION_PROOF_BOXES", 100_000)
    grid, kind = shape(name), METHODS[method]
    hidden, length = EARLY if issubclass(kind, MlpEarly) else HIDDEN, ray_length(grid)
    reported = report_of(method, query, activation=activation, hidden=hidden, steps=3, length=length)
    bounder = wb.fit(grid, query, method, device="cpu", **reported)
    assert bounder.activation == activation
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


@pytest.mark.parametrize("name", ACTIVATIONS)
def test_what_the_registry_says_of_an_activation(name):
    """Slopes from -1 to 1, values within ``largest``."""
    activation, x = ACTIVATIONS[name], np.linspace(-30, 30, 600_001)
    y = activation.value(x)
    assert activation.name == name
    assert (np.abs(np.diff(y)) <= np.diff(x) * (1 + 1e-9)).all()
    assert (np.abs(y) <= (np.abs(x) if activation.largest is None else activation.largest)).all()
    assert activation.error(1.0) < 1e-5


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
    assert np.abs(PLAIN[name](z) - h.numpy()).max() <= 2 * activation.error(limit)


@pytest.mark.parametrize("evaluate", [plain_sine, fused_sine], ids=["unfused", "fused"])
@pytest.mark.parametrize("limit", [0.5, 1.6, 10.0, 300.0, SINE_LIMIT])
def test_sine_stays_within_its_bound(evaluate, limit, rng):
    dense = np.linspace(-limit, limit, 400_001).astype(F32)
    multiples = np.arange(-int(limit / np.pi * 2) - 1, int(limit / np.pi * 2) + 2) * (np.pi / 2)
    near = np.float32(multiples)[:, None].view(np.int32) + np.arange(-40, 41, dtype=np.int32)
    near = near.view(F32).ravel()
    random = (rng.choice([-1, 1], 100_000) * limit * 10 ** rng.uniform(-12, 0, 100_000)).astype(F32)
    z = np.concatenate([dense, near, random, F32([0.0, -0.0, limit, -limit])])
    z = z[np.isfinite(z) & (np.abs(z) <= limit)]
    truth = np.sin(z.astype(np.longdouble))
    error = np.abs(evaluate(z).astype(np.longdouble) - truth).max()
    assert error <= SINE.error(limit)
    assert SINE.error(limit) < 4 * max(error, 1e-7) + 1e-6  # and the bound is worth something


def test_sine_error_grows_with_the_limit_and_ends_somewhere():
    limits = np.linspace(0, SINE_LIMIT, 50)
    errors = [SINE.error(float(limit)) for limit in limits]
    assert errors == sorted(errors)
    for wrong in (-1.0, SINE_LIMIT * 1.001, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="certified"):
            SINE.error(wrong)
