"""Shapes without cells: fitted, proven, attacked, certified; and what is refused."""

import numpy as np
import pytest

import warp_bounding as wb
from warp_bounding.indicators.shape import IN, OUT
from warp_bounding.proof import soak
from warp_bounding.proof.search.vacancy import ShapePositives
from warp_bounding.queries.boundary import border_points

Sphere, Box, Torus = wb.solids.Sphere, wb.solids.Box, wb.solids.Torus
CLOSED_FORMS = ("aabb", "obb", "sphere", "ellipsoid", "oriented-ellipsoid", "kdop")


def balls(ndim: int) -> wb.IndicatorFunction:
    """Three overlapping balls."""
    rng = np.random.default_rng(ndim)
    shape = Sphere(rng.uniform(-0.4, 0.4, ndim), 0.3)
    for _ in range(2):
        shape = shape | Sphere(rng.uniform(-0.4, 0.4, ndim), rng.uniform(0.2, 0.35))
    return shape


def denied_positives(bounder: wb.Bounder, shape, count: int = 200_000) -> int:
    """False negatives among random points and points of the border."""
    rng = np.random.default_rng(3)
    x = rng.uniform(shape.sample_lower, shape.sample_upper, (count, shape.ndim))
    x = np.concatenate([x, border_points(shape, count // 10, rng)]).astype(np.float32)
    return int((shape.contains(x) & (bounder.query(x).numpy() == 0)).sum())


@pytest.mark.parametrize("ndim", [2, 3])
@pytest.mark.parametrize("method", CLOSED_FORMS)
def test_closed_forms_of_functions_are_proven(method, ndim):
    shape = balls(ndim)
    bounder = wb.fit(shape, method=method, device="cpu", progress=False)
    assert bounder.certificate.proven
    assert denied_positives(bounder, shape) == 0
    assert wb.certify(bounder, shape).kind == "proven"


@pytest.mark.slow
@pytest.mark.parametrize("ndim", [4, 5, 6])
@pytest.mark.parametrize("method", ["aabb", "sphere"])
def test_closed_forms_in_many_dimensions(method, ndim):
    shape = balls(ndim)
    bounder = wb.fit(shape, method=method, device="cpu", progress=False)
    assert bounder.certificate.proven
    assert denied_positives(bounder, shape) == 0
    assert wb.certify(bounder, shape).kind == "proven"


@pytest.mark.parametrize("ndim", [2, 3, pytest.param(4, marks=pytest.mark.slow)])
def test_networks_of_functions_are_proven(ndim):
    shape = balls(ndim)
    bounder = wb.fit(shape, hidden=(16, 16), steps=300, device="cpu", progress=False)
    assert bounder.certificate.proven
    assert denied_positives(bounder, shape) == 0
    assert wb.certify(bounder, shape).kind == "proven"
    assert (
        wb.evaluate(bounder, shape, 50_000).fp_rate
        < wb.evaluate(wb.fit(shape, method="aabb", device="cpu"), shape, 50_000).fp_rate
    )


@pytest.mark.parametrize("method", ["mlp-early", "learned-kdop", "aabb+mlp"])
def test_other_learned_methods(method):
    shape = Torus([0, 0, 0], 0.7, 0.2)
    bounder = wb.fit(shape, method=method, steps=100, device="cpu", progress=False)
    assert bounder.certificate.proven
    assert denied_positives(bounder, shape) == 0
    assert wb.certify(bounder, shape).kind == "proven"


def test_certify_refutes_what_is_too_tight():
    shape = balls(3)
    bounder = wb.fit(shape, method="sphere", device="cpu", progress=False)
    certificate = wb.certify(bounder, Sphere([0.9, 0.0, 0.0], 0.6))
    assert certificate.kind in ("refuted", "undecided")
    larger = shape.dilated(0.01)
    bounder.freeze(float(bounder.threshold) + 0.02, bounder.certificate)
    certificate = wb.certify(bounder, shape)
    assert certificate.kind == "refuted"
    point = np.array([certificate.counterexample], np.float32)
    assert shape.contains(point)[0]
    assert not bounder.query(point).numpy()[0]
    assert larger.contains(point)[0]


def test_a_mesh_is_bounded_itself(tmp_path):
    mesh = wb.IndicatorMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    bounder = wb.fit(mesh, hidden=(12, 12), steps=300, margin=0.02, device="cpu", progress=False)
    assert bounder.certificate.proven
    assert bounder.info["resolution"] is None
    assert bounder.certificate.margin == 0.02
    assert bounder.certificate.cells == 0
    assert denied_positives(bounder, mesh.dilated(0.02)) == 0
    bounder.save(tmp_path / "b.safetensors")
    assert wb.certify(tmp_path / "b.safetensors", mesh, margin=0.02).kind == "proven"
    assert wb.certify(tmp_path / "b.safetensors", mesh, margin=0.01).kind == "inapplicable"
    rates = wb.evaluate(bounder, mesh, 100_000)
    assert rates.truth == "of the shape itself"
    assert rates.fn == 0
    result = soak(bounder, mesh, 2_000_000, seed=2)
    assert result.missed is None
    assert all(result.forms.values())


def test_cells_are_laid_where_they_are_asked_for():
    mesh = wb.IndicatorMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    for options in (
        {"method": "bvh", "leaves": 8},
        {"method": "aabb", "resolution": 16},
        {"query": "box", "method": "bvh", "leaves": 8},
    ):
        bounder = wb.fit(mesh, margin=0.2, device="cpu", progress=False, **options)
        assert bounder.info["resolution"] is not None
        assert bounder.certificate.cells > 0
    rates = wb.evaluate(wb.fit(mesh, method="bvh", leaves=8, margin=0.2, device="cpu"), mesh, 50_000)
    assert rates.fp_rate_cells < rates.fp_rate
    assert rates.fn == 0


def test_a_function_that_certifies_nothing_is_attested():
    shape = wb.IndicatorFunction(lambda x: np.linalg.norm(x, axis=1) <= 0.5, [-0.5, -0.5], [0.5, 0.5])
    for options in ({"method": "sphere"}, {"hidden": (12, 12), "steps": 100}):
        bounder = wb.fit(shape, device="cpu", progress=False, **options)
        assert bounder.certificate.kind == "statistical"
        assert wb.certify(bounder, shape).kind == "statistical"


def test_a_lie_is_an_error():
    def empty(lower, upper):
        return np.linalg.norm((lower + upper) / 2, axis=1) > 0.2

    lie = wb.IndicatorFunction(lambda x: np.linalg.norm(x, axis=1) <= 0.5, [-0.5, -0.5], [0.5, 0.5], empty=empty)
    with pytest.raises(wb.IndicatorError, match="function: "):
        wb.fit(lie, method="sphere", device="cpu", progress=False)


def test_vacant_boxes_hold_nothing():
    shape = balls(3)
    bounder = wb.fit(shape, method="aabb", device="cpu", progress=False)
    positives, rng = ShapePositives(bounder, shape), np.random.default_rng(0)
    lower = rng.uniform(-1, 1, (20_000, 3))
    upper = lower + rng.uniform(0, 0.3, (20_000, 3)) ** 2
    vacant = positives.vacant(lower, upper)
    assert 0.1 < vacant.mean() < 0.9
    for share in rng.random((20, 1, 3)):
        x = bounder.domain.to_object(lower + share * (upper - lower))[vacant]
        assert (shape.decide(x) == OUT).all()


@pytest.mark.filterwarnings("ignore:.*surface only:warp_bounding.errors.BoundingWarning")
def test_an_open_surface_is_bounded():
    sheet = wb.IndicatorMesh([[0, 0, 0], [1, 0, 0.2], [0, 1, 0.1], [1, 1, 0.4]], [[0, 1, 2], [2, 1, 3]])
    for margin in (0.0, 0.01):
        for options in ({"method": "obb"}, {"hidden": (12, 12), "steps": 200}):
            bounder = wb.fit(sheet, margin=margin, device="cpu", progress=False, **options)
            assert bounder.certificate.proven
            x = sheet.points(100_000, np.random.default_rng(0)).astype(np.float32)
            x = np.concatenate([x, sheet.vertices])
            held = sheet.dilated(margin).decide(x) == IN
            assert not (held & (bounder.query(x).numpy() == 0)).any()


def test_what_fills_its_box_is_bounded():
    box = wb.solids.Box([0, 0, 0], [1, 2, 3])
    bounder = wb.fit(box, method="aabb", device="cpu", progress=False)
    assert wb.evaluate(bounder, box, 100_000).fp_rate < 0.1
    assert wb.fit(box, hidden=(12, 12), steps=50, device="cpu", progress=False).certificate.proven


def test_rates_of_regions_are_those_of_the_mesh():
    mesh = wb.IndicatorMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    for query in ("ray", "plane", "box"):
        bounder = wb.fit(mesh, query, "kdop", resolution=24, device="cpu", progress=False)
        rates = wb.evaluate(bounder, mesh, 50_000)
        assert rates.truth == "of the shape itself"
        assert rates.fn == 0
        assert rates.fp_rate_cells < rates.fp_rate


def test_a_mesh_far_from_the_origin_is_bounded_as_well_as_float32_allows(tmp_path):
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float64)
    faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]
    mesh = wb.IndicatorMesh(16 * vertices + 1e6, faces)
    bounder = wb.fit(mesh, method="kdop", device="cpu", progress=False)
    assert bounder.certificate.proven
    assert denied_positives(bounder, mesh) == 0
    bounder.save(tmp_path / "far.safetensors")
    assert wb.certify(tmp_path / "far.safetensors", mesh).kind == "proven"
    with pytest.raises(wb.IndicatorError, match="move the shape to its origin"):
        wb.fit(wb.IndicatorMesh(vertices + 1e6, faces), method="kdop", device="cpu", progress=False)
