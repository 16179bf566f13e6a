"""Rates are counts of what oracle and bounder say, over the promised samples."""

import numpy as np
import pytest
from bounding_shapes import CONSERVATIVE, fitted, random_bounder, shape

import warp_bounding as wb
from warp_bounding.errors import QueryError
from warp_bounding.queries.point import POINT


@pytest.mark.parametrize("method", CONSERVATIVE)
def test_rates_are_what_a_count_gives(method, device):
    bounder, grid = fitted(method, "star").to(device), shape("star")
    rates = wb.evaluate(bounder, grid, samples=30_000, seed=5)
    x = POINT.sample(grid, 30_000, np.random.default_rng(5))
    truth, maybe = grid.contains(x), bounder.query(x).numpy().astype(bool)
    assert rates.fn == 0
    assert rates.fp_rate == 100 * (maybe & ~truth).sum() / 30_000
    assert rates.positives == 100 * truth.sum() / 30_000
    assert (rates.samples, rates.protocol, rates.seed) == (30_000, "exact", 5)
    assert rates.to_dict()["fp_rate"] == rates.fp_rate


def test_false_negatives_are_counted():
    bounder = random_bounder("aabb", "star")
    bounder.freeze(0.3, None)
    assert wb.evaluate(bounder, shape("star"), samples=20_000).fn > 0


def test_samples_are_repeatable_and_protocols_agree_for_points():
    bounder, grid = fitted("sphere", "blob"), shape("blob")
    first = wb.evaluate(bounder, grid, samples=5000, seed=3)
    assert first == wb.evaluate(bounder, grid, samples=5000, seed=3)
    assert first.fp_rate == wb.evaluate(bounder, grid, samples=5000, seed=3, protocol="sampled").fp_rate
    assert first != wb.evaluate(bounder, grid, samples=5000, seed=4)


def test_progress_and_chunks(monkeypatch):
    from warp_bounding import evaluation

    bounder, grid, seen = fitted("aabb", "c"), shape("c"), []
    monkeypatch.setattr(evaluation, "CHUNK", 1000)
    wb.evaluate(bounder, grid, samples=2500, progress=lambda *a: seen.append(a))
    assert seen == [(1000, 2500), (2000, 2500), (2500, 2500)]


@pytest.mark.parametrize(
    "options", [{"samples": 0}, {"samples": -1}, {"samples": 1.5}, {"samples": True}, {"protocol": "guess"}], ids=str
)
def test_wrong_options(options):
    with pytest.raises(QueryError):
        wb.evaluate(fitted("aabb", "c"), shape("c"), **options)


def test_a_shape_of_another_dimension():
    with pytest.raises(QueryError, match="3D"):
        wb.evaluate(fitted("aabb", "c"), shape("blob"))
    with pytest.raises(wb.IndicatorError):
        wb.evaluate(fitted("aabb", "c"), "nowhere.npy")


def test_a_path_is_taken_for_a_bounder_and_what_is_none_is_told(tmp_path):
    fitted("aabb", "c").save(tmp_path / "b.safetensors")
    grid = shape("c")
    for path in (tmp_path / "b.safetensors", str(tmp_path / "b.safetensors")):
        rates = wb.evaluate(path, grid, samples=1000)
        assert rates == wb.evaluate(fitted("aabb", "c"), grid, samples=1000)
        assert rates.indicator == grid.digest == wb.load(path).info["indicator"]
        assert wb.certify(path, grid).proven
    for wrong in (grid, grid.occupancy, None, 5):
        for call in (wb.evaluate, wb.certify):
            with pytest.raises(wb.BounderError, match="first, then the shape, got"):
                call(wrong, fitted("aabb", "c"))
    for options in ({"samples": "many"}, {"seed": "a"}, {"seed": -1}, {"protocol": 5}):
        with pytest.raises(QueryError):
            wb.evaluate(fitted("aabb", "c"), grid, **options)


@pytest.mark.parametrize("method", CONSERVATIVE)
@pytest.mark.parametrize("name", ["c", "blob"])
def test_quick_rates_are_those_of_the_kernels(method, name):
    from warp_bounding import evaluation as module

    bounder, grid = fitted(method, name), shape(name)
    quick = module.quick_rates(bounder, grid)
    exact = [
        wb.evaluate(b, grid, samples=module.QUICK, seed=module.QUICK_SEED) for b in (bounder, fitted("aabb", name))
    ]
    assert quick["samples"] == module.QUICK
    assert quick["fp_rate"] == pytest.approx(exact[0].fp_rate, abs=0.05)
    assert quick["fp_rate_aabb"] == pytest.approx(exact[1].fp_rate, abs=0.05)
    assert bounder.info["rates"] == quick


@pytest.mark.parametrize(("method", "told"), [("kdop", {}), ("voxels", {"resolution": 16}), ("bvh", {"leaves": 16})])
def test_the_stored_rate_of_a_mesh_is_against_the_mesh_itself(method, told):
    import trimesh

    bar = trimesh.creation.box((1.0, 0.3, 0.2))
    bar.apply_transform(trimesh.transformations.rotation_matrix(0.7, (1, 2, 3)))
    mesh = wb.IndicatorMesh(bar.vertices, bar.faces)
    bounder = wb.fit(mesh, method=method, margin=0.05, device="cpu", progress=False, **told)
    asked = wb.evaluate(bounder, mesh, samples=100_000)
    assert asked.truth == "of the shape itself"
    assert bounder.info["rates"]["fp_rate"] == pytest.approx(asked.fp_rate, abs=0.7)
    assert "false positives against the shape itself (16,384 samples)" in repr(bounder)
    grid = mesh.to_grid(resolution=16, margin=0.05)
    assert "of its cells at resolution 16" in repr(wb.fit(grid, method="voxels", device="cpu", progress=False))
