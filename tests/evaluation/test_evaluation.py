"""Rates are counts of what oracle and bounder say, of points, regions and distances."""

import numpy as np
import pytest
from bounding_shapes import fitted, fitted_query, shape
from distances import far, thing

import warp_bounding as wb
from warp_bounding import evaluation
from warp_bounding.errors import QueryError
from warp_bounding.queries import oracle, sample


def test_progress_and_chunks(monkeypatch):
    seen = []
    monkeypatch.setattr(evaluation, "QUERIES_AT_ONCE", 1000)
    wb.evaluate(fitted("aabb", "c"), shape("c"), samples=2500, progress=lambda *a: seen.append(a))
    assert seen == [(1000, 2500), (2000, 2500), (2500, 2500)]


def test_a_path_is_taken_for_a_bounder_and_what_is_none_is_told(tmp_path):
    fitted("aabb", "c").save(tmp_path / "b.safetensors")
    grid = shape("c")
    for path in (tmp_path / "b.safetensors", str(tmp_path / "b.safetensors")):
        rates = wb.evaluate(path, grid, samples=1000)
        assert rates == wb.evaluate(fitted("aabb", "c"), grid, samples=1000)
        assert rates.indicator == grid.digest == wb.load(path).info["indicator"]
        assert wb.certify(path, grid).proven
    with pytest.raises(QueryError, match="3D"):
        wb.evaluate(fitted("aabb", "c"), shape("blob"))
    for wrong in (grid, grid.occupancy, None, 5):
        for call in (wb.evaluate, wb.certify):
            with pytest.raises(wb.BounderError, match="first, then the shape, got"):
                call(wrong, fitted("aabb", "c"))
    for options in (*({"samples": n} for n in ("many", 0, 1.5, True)), {"seed": -1}):
        with pytest.raises(QueryError):
            wb.evaluate(fitted("aabb", "c"), grid, **options)


@pytest.mark.parametrize("method", ["kdop", "voxels", "mlp"])
def test_quick_rates_are_those_of_the_kernels(method):
    bounder, grid = fitted(method, "blob"), shape("blob")
    quick, told = evaluation.quick_rates(bounder, grid), {"samples": evaluation.QUICK, "seed": evaluation.QUICK_SEED}
    exact = [wb.evaluate(b, grid, **told).fp_rate for b in (bounder, fitted("aabb", "blob"))]
    assert [quick["fp_rate"], quick["fp_rate_aabb"]] == pytest.approx(exact, abs=0.05)
    assert bounder.info["rates"] == quick


@pytest.mark.parametrize(("method", "told"), [("kdop", {}), ("voxels", {"resolution": 16})])
def test_the_stored_rate_of_a_mesh_is_against_the_mesh_itself(method, told):
    import trimesh

    bar = trimesh.creation.box((1.0, 0.3, 0.2))
    bar.apply_transform(trimesh.transformations.rotation_matrix(0.7, (1, 2, 3)))
    mesh = wb.shapes.Mesh(bar.vertices, bar.faces)
    bounder = wb.fit(mesh, method=method, margin=0.05, device="cpu", progress=False, **told)
    queried = wb.evaluate(bounder, mesh, samples=100_000)
    assert queried.truth == "of the shape itself"
    assert bounder.info["rates"]["fp_rate"] == pytest.approx(queried.fp_rate, abs=0.7)


REGIONS = ("ray", "plane", "box")
SAMPLES = 20_000
COUNTED = [*((method, "point") for method in ("aabb", "bvh", "mlp"))]
COUNTED += [("kdop", "ray"), ("aabb", "plane"), ("bvh", "box")]


@pytest.mark.parametrize(("method", "query"), COUNTED)
def test_rates_are_what_a_count_gives(method, query, device):
    bounder = fitted(method, "star") if query == "point" else fitted_query("star", method, query, 0.6)
    bounder, grid = bounder.to(device), shape("star")
    x = sample(query, grid, SAMPLES, np.random.default_rng(5))
    truth = oracle(query, grid, "cpu", 0.6)(x)
    for threshold in (float(bounder.threshold), float("inf")):
        bounder.freeze(threshold, None)
        rates, maybe = wb.evaluate(bounder, grid, samples=SAMPLES, seed=5), bounder.query(x).numpy().astype(bool)
        counted = ((truth & ~maybe).sum(), 100 * (maybe & ~truth).sum() / SAMPLES, 100 * truth.sum() / SAMPLES)
        assert (rates.fn, rates.fp_rate, rates.positives) == counted
        assert (rates.samples, rates.seed) == (SAMPLES, 5)
        assert (rates.fn > 0) == np.isinf(threshold)
    assert wb.evaluate(bounder, grid, samples=SAMPLES, seed=4) != rates


ASKED = {
    "point": (lambda b, x: b.query(x), {}),
    "ray": (lambda b, x: b.rays(x, length=0.6, steps=12)[0], {"length": 0.6, "steps": 12}),
    "box": (lambda b, x: b.boxes(*np.split(x, 2, axis=1), steps=20), {"steps": 20}),
}


@pytest.mark.parametrize("query", ASKED)
def test_rates_of_distances_are_what_a_count_gives(query):
    bounder, grid, (ask, told) = far("bvh", "blob"), thing("blob"), ASKED[query]
    rates = wb.evaluate(bounder, grid, samples=SAMPLES, seed=5, query=query, **told)
    x = sample(query, grid, SAMPLES, np.random.default_rng(5))
    truth, maybe = oracle(query, grid, "cpu", told.get("length", 1.0))(x), ask(bounder, x).numpy().astype(bool)
    assert (rates.fp_rate, rates.fn) == (100 * (maybe & ~truth).sum() / SAMPLES, 0)
    assert rates.fp_rate < 100
    assert (rates.query, rates.positives) == (query, 100 * truth.sum() / SAMPLES)
    near = wb.evaluate(bounder, grid, samples=SAMPLES, radius=0.3)
    assert (near.fn, near.radius) == (0, 0.3)
    assert near.positives > 0


def test_what_makes_no_sense_is_refused():
    for told in (
        *({"query": "plane"}, {"query": "point", "length": 1.0}, {"query": "point", "steps": 8}),
        *({"radius": True}, {"radius": -1}, {"radius": float("nan")}, {"radius": "far"}),
        *({"query": "ray", "radius": 0.1}, {"query": "box", "length": 1.0}, {"query": "ray", "length": float("nan")}),
        *({"query": "ray", "steps": 0}, {"query": "box", "steps": 1.5}),
    ):
        with pytest.raises(QueryError):
            wb.evaluate(far("bvh", "c"), thing("c"), samples=100, **told)
    for name, value in (("query", "point"), ("length", 1.0), ("steps", 3), ("radius", 0.0)):
        with pytest.raises(QueryError, match=f"{name} is for distances"):
            wb.evaluate(fitted("aabb", "c"), shape("c"), samples=100, **{name: value})
