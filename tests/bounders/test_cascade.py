"""A cascade answers maybe iff all its parts do: in batches, in other kernels, from a file, on CUDA; and is proven part by part."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from asking import ask, check_compiles
from bounding_shapes import domain_points, fitted, object_points, shape, told_of

import warp_bounding as wb
from warp_bounding.bounders import Cascade
from warp_bounding.bounders.mlp_early import MlpEarly
from warp_bounding.errors import BounderError
from warp_bounding.kernels.functions import batch_kernel
from warp_bounding.kernels.source import DENIED, GRANTED

CHAINS = [
    ("aabb", "kdop", "mlp"),
    ("sphere", "aabb", "mlp-early"),
    ("voxels", "mlp"),
    ("mlp", "aabb"),
]
QUERIES = ("ray", "plane", "box")


def raised(bounder: wb.Bounder, x: np.ndarray, share: float) -> wb.Bounder:
    """A bounder that denies a share of some points, so that every part of a cascade has something to do."""
    if isinstance(bounder, MlpEarly):  # what an exit grants has no f
        bounder = bounder.granting([], [GRANTED] * (len(bounder.hidden) - 1))
    values = bounder.values(x).numpy()
    return bounder.to("cpu").freeze(float(np.quantile(values[np.isfinite(values)], share)), None)


@pytest.mark.parametrize("name", ["blob", *(pytest.param(name, marks=pytest.mark.slow) for name in ("c", "animated"))])
@pytest.mark.parametrize("methods", CHAINS, ids="+".join)
def test_all_parts_must_pass(methods, name, device, rng):
    grid, x = shape(name), domain_points(shape(name), 5000, rng)
    parts = [
        raised(fitted(m, name), x, 0.3 + 0.1 * i) if m != "voxels" else fitted(m, name) for i, m in enumerate(methods)
    ]
    whole = wb.cascade(*parts).to(device)
    near = [np.abs(p.values(x).numpy() - float(p.threshold)) <= 2 * p.rounding_bound() for p in parts]
    x = x[~np.any(near, axis=0)]  # kernels may differ within rounding of a threshold
    assert len(x) > 4500
    answers = np.stack([part.to(device).query(x).numpy() for part in parts])
    assert (whole.query(x).numpy() == answers.all(axis=0)).all()
    assert (ask(whole, x) == answers.all(axis=0)).all()
    values, last = whole.values(x).numpy(), parts[-1].to(device).values(x).numpy()
    assert (values[answers[:-1].all(axis=0)] == last[answers[:-1].all(axis=0)]).all()
    assert (values[~answers[:-1].all(axis=0)] <= DENIED).all()
    assert grid.ndim == whole.ndim


@pytest.mark.parametrize("methods", CHAINS, ids="+".join)
def test_what_is_proven_of_the_parts_is_proven_of_all(methods, tmp_path, rng):
    whole = wb.cascade(*(fitted(m, "blob") for m in methods))
    assert whole.certificate.proven
    inside = object_points(shape("blob"), rng)
    assert whole.query(inside).numpy().all()
    assert ask(whole, inside).all()
    whole.save(tmp_path / "c.safetensors")
    again = wb.load(tmp_path / "c.safetensors", device="cpu")
    assert again.certificate == whole.certificate
    x = domain_points(shape("blob"), 3000, rng)
    assert (again.query(x).numpy() == whole.query(x).numpy()).all()
    assert wb.certify(again, shape("blob")).proven
    assert wb.evaluate(again, shape("blob"), samples=20_000).fn == 0


def test_a_part_that_denies_a_part_of_the_object_is_found_out(rng):
    x = object_points(shape("blob"), rng)
    wrong = raised(fitted("aabb", "blob"), x, 0.2)
    for parts in ((wrong, fitted("mlp", "blob")), (fitted("mlp", "blob"), wrong)):
        whole = wb.cascade(*parts)
        assert whole.certificate is None
        certificate = wb.certify(whole, shape("blob"))
        assert certificate.kind == "refuted"
        assert shape("blob").contains(np.float64([certificate.counterexample])).all()


@pytest.mark.parametrize("query", QUERIES)
def test_regions(query, rng):
    grid = shape("c")
    small = {"hidden": (8,), "steps": 3}
    parts = [wb.fit(grid, query, m, device="cpu", **told_of(m, query, **small)) for m in ("aabb", "kdop", "mlp")]
    whole = wb.cascade(*parts)
    x = np.concatenate(
        [domain_points(grid, 4000, rng), domain_points(grid, 4000, rng) - (query != "box") * 0.5], axis=1
    )
    x = np.concatenate([x, np.sort(x.reshape(-1, 2, 2), axis=1).reshape(-1, 4)]) if query == "box" else x
    answers = np.stack([part.query(x).numpy() for part in parts])
    assert (whole.query(x).numpy() == answers.all(axis=0)).all()
    assert whole.certificate.kind == parts[-1].certificate.kind
    if whole.certificate.proven:
        assert wb.certify(whole, grid).proven


def test_bounds_are_those_of_the_conjunction(rng):
    whole = wb.cascade(fitted("aabb", "blob"), fitted("mlp", "blob"))
    low = rng.uniform(-1, 1, (500, 3))
    high = low + 10 ** rng.uniform(-4, 0, (500, 1))
    bounds = whole.bound(low, high)
    for t in rng.random((20, 1, 3)):
        assert (whole.reference(low + t * (high - low)) >= bounds.lower).all()


def test_a_cascade_within_a_cascade(tmp_path, rng):
    parts = [fitted(method, "blob") for method in ("sphere", "aabb", "voxels", "kdop")]
    whole = wb.cascade(parts[0], wb.cascade(parts[1], wb.cascade(*parts[2:])))
    whole.save(tmp_path / "c.safetensors")
    again, x = wb.load(tmp_path / "c.safetensors", device="cpu"), domain_points(shape("blob"), 3000, rng)
    answers = wb.cascade(*parts).query(x).numpy()
    assert 0 < answers.sum() < len(x)
    for each in (whole, again):
        assert (each.query(x).numpy() == answers).all()
    assert (ask(whole, x) == answers).all()
    assert wb.certify(again, shape("blob")).proven


def test_several_parts_may_have_bit_fields(tmp_path, device, rng):
    grid, x = shape("blob"), domain_points(shape("blob"), 5000, rng)
    parts = [fitted("voxels", "blob"), fitted("aabb", "blob"), other_bits(fitted("voxels", "blob"), 3, rng)]
    expected = np.all([part.query(x).numpy() for part in parts], axis=0)
    assert 0 < expected.sum() < parts[0].query(x).numpy().sum()
    nested = wb.cascade(parts[0], wb.cascade(*parts[1:]))
    for whole in (wb.cascade(*parts), wb.cascade(*parts[::-1]), nested):
        whole.save(tmp_path / "c.safetensors")
        for each in (whole, wb.load(tmp_path / "c.safetensors", device=device)):
            assert (each.query(x).numpy() == expected).all()
        assert (ask(whole.to(device), x) == expected).all()
    assert wb.certify(wb.cascade(parts[0], parts[0]), grid).proven
    assert wb.certify(wb.cascade(parts[0], parts[2]), grid).kind == "refuted"


def other_bits(bounder: wb.Bounder, every: int, rng: np.random.Generator) -> wb.Bounder:
    """A bit field of which some words are lost, so that it denies some of the object."""
    bits = bounder.tensors["bits"] * (rng.integers(every, size=len(bounder.tensors["bits"])) > 0).astype(np.uint32)
    changed = type(bounder)(bounder.domain, bounder.tensors | {"bits": bits}, bounder.sizes, "cpu")
    changed.info = bounder.info
    return changed.freeze(bounder.threshold, None)


def test_cuda_source_compiles(tmp_path):
    if not hasattr(wp, "compile_aot_module"):
        pytest.skip("this Warp cannot compile ahead of time")
    whole = wb.cascade(fitted("aabb", "blob"), fitted("voxels", "blob"), fitted("mlp", "blob"))
    check_compiles(batch_kernel(whole.source, True, False), tmp_path)


def test_bad_parts():
    aabb, mlp = fitted("aabb", "blob"), fitted("mlp", "blob")
    with pytest.raises(BounderError, match="2 to 8"):
        wb.cascade(aabb)
    with pytest.raises(BounderError, match="same queries and domain"):
        wb.cascade(aabb, fitted("mlp", "c"))
    with pytest.raises(BounderError, match="not conservative"):
        wb.cascade(aabb, fitted("occupancy", "blob"))
    with pytest.raises(BounderError, match="exits"):
        wb.cascade(fitted("mlp-early", "blob"), mlp)
    other = aabb.to("cpu")
    other.info = aabb.info | {"indicator": "another"}
    with pytest.raises(BounderError, match="same object"):
        wb.cascade(other, mlp)
    other.info = dict(aabb.info)
    other.freeze(float(aabb.threshold), replace(aabb.certificate, indicator="0" * 64))
    with pytest.raises(BounderError, match="certificates of the same object"):
        wb.cascade(other, mlp)
    whole = wb.cascade(aabb, mlp)
    with pytest.raises(BounderError, match="tensors"):
        Cascade(whole.domain, dict(whole.tensors) | {"9.low": np.zeros(3, np.float32)}, whole.sizes, "cpu")
    with pytest.raises(BounderError, match="parts"):
        Cascade(whole.domain, dict(whole.tensors), {"parts": []}, "cpu")
