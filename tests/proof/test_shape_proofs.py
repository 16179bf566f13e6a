"""Shapes without cells: points and regions are fitted, proven, attacked and certified, also over a hull."""

from functools import cache

import numpy as np
import pytest
import trimesh
from plain_shapes import TETRAHEDRON, ball_at, balls_at, box_of, torus_at
from rewriting import check_refuted

import warp_bounding as wb
from warp_bounding.errors import BounderError, QueryError
from warp_bounding.geometry import few_points, hull_of
from warp_bounding.proof import least_value, minimum, prove, stress_test
from warp_bounding.proof.search import ShapePositives
from warp_bounding.proof.stress import QUERY_BATCH
from warp_bounding.queries import QUERIES
from warp_bounding.queries.boundary import border_points
from warp_bounding.shapes.shape import IN, OUT

VOLUMES = ("aabb", "obb", "sphere", "ellipsoid", "oriented-ellipsoid", "kdop", "learned-kdop")
REGIONS = ("ray", "plane", "box")
MARGIN = 0.03
MIDDLE = np.array([3.0, -2.0, 0.5])  # of the mesh
CERTAIN = 1e-9  # of f: what float64 makes of values that are compared


def fit(shape, query="point", method="mlp", **told) -> wb.Bounder:
    told |= {"hidden": (8,)} if method == "mlp" else {}
    told |= {"steps": 50} if method == "learned-kdop" else {}
    return wb.fit(shape, query, method, device="cpu", progress=False, **told)


def three(ndim: int) -> wb.shapes.Function:
    """Three overlapping balls."""
    rng = np.random.default_rng(ndim)
    return balls_at(*((rng.uniform(-0.4, 0.4, ndim), rng.uniform(0.2, 0.35)) for _ in range(3)))


@cache
def mesh(margin: float = 0.0) -> wb.shapes.Mesh:
    """A ball and a turned bar that sticks out of it, in coordinates far from 0 and with unequal sides."""
    ball, bar = trimesh.creation.icosphere(2, 0.4), trimesh.creation.box((1.6, 0.2, 0.3))
    bar.apply_transform(trimesh.transformations.rotation_matrix(0.7, (1, 2, 3)))
    both = trimesh.util.concatenate([ball, bar])
    return wb.shapes.Mesh(np.asarray(both.vertices) + MIDDLE, both.faces).dilated(margin)


def denied_positives(bounder: wb.Bounder, shape, count: int = 100_000) -> int:
    """False negatives among random points and points of the border."""
    rng = np.random.default_rng(3)
    x = rng.uniform(shape.sample_lower, shape.sample_upper, (count, shape.ndim))
    x = np.concatenate([x, border_points(shape, count // 10, rng)]).astype(np.float32)
    return int((shape.contains(x) & (bounder.query(x).numpy() == 0)).sum())


def check_proven(bounder: wb.Bounder, shape) -> None:
    assert bounder.certificate.proven
    assert bounder.info["resolution"] is None
    assert denied_positives(bounder, shape) == 0
    assert wb.certify(bounder, shape).kind == "proven"


# --- points ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("method", "ndim"),
    [
        *((method, 2) for method in VOLUMES[:-1]),
        *((method, 3) for method in ("aabb", "mlp")),
        *(pytest.param(method, 3, marks=pytest.mark.slow) for method in VOLUMES[1:-1]),
        *(pytest.param(method, 5, marks=pytest.mark.slow) for method in ("aabb", "sphere", "mlp")),
    ],
)
def test_functions_are_proven(method, ndim):
    check_proven(fit(three(ndim), method=method, **({"steps": 100} if method == "mlp" else {})), three(ndim))


def test_other_learned_methods():
    shape = torus_at([0, 0, 0], 0.7, 0.2)
    for method, hidden in (("mlp", (6, 5)), ("aabb+mlp", (8,))):
        check_proven(fit(shape, method=method, steps=50, hidden=hidden), shape)


def test_certify_refutes_what_is_too_tight():
    shape = three(2)
    bounder = fit(shape, method="sphere")
    assert wb.certify(bounder, ball_at([0.9, 0.0], 0.6)).kind in ("refuted", "undecided")
    check_refuted(bounder.freeze(float(bounder.threshold) + 0.02, bounder.certificate), shape)


def test_a_mesh_is_bounded_itself(tmp_path):
    shape = wb.shapes.Mesh(*TETRAHEDRON)
    bounder = fit(shape, steps=100, margin=0.02)
    assert bounder.certificate.proven
    assert (bounder.certificate.margin, bounder.certificate.cells) == (0.02, 0)
    assert denied_positives(bounder, shape.dilated(0.02)) == 0
    bounder.save(tmp_path / "b.safetensors")
    assert wb.certify(tmp_path / "b.safetensors", shape, margin=0.02).kind == "proven"
    assert wb.certify(tmp_path / "b.safetensors", shape, margin=0.01).kind == "inapplicable"
    rates = wb.evaluate(bounder, shape, 50_000)
    assert rates.truth == "of the shape itself"
    assert rates.fn == 0
    result = stress_test(bounder, shape, 2_000_000, seed=2)
    assert result.missed is None
    assert all(result.forms.values())


def test_cells_are_laid_where_they_are_asked_for():
    shape = wb.shapes.Mesh(*TETRAHEDRON)
    for query, method, told in (("point", "aabb", {"resolution": 16}), ("box", "bvh", {"leaves": 8})):
        bounder = fit(shape, query, method, margin=0.2, **told)
        assert bounder.info["resolution"] is not None
        assert bounder.certificate.cells > 0
        rates = wb.evaluate(bounder, shape, 20_000)
        assert rates.fn == 0
        assert rates.fp_rate_cells <= rates.fp_rate
    assert fit(ball_at([0, 0], 1.0), "plane", "aabb").info["resolution"] is not None


def test_a_function_that_certifies_nothing_is_attested_and_a_false_one_is_an_error():
    def contains(x):
        return np.linalg.norm(x, axis=1) <= 0.5

    shape = wb.shapes.Function(contains, [-0.5, -0.5], [0.5, 0.5])
    for bounder in (fit(shape, method="sphere"), fit(shape, steps=100)):
        assert bounder.certificate.kind == "statistical"
        assert wb.certify(bounder, shape).kind == "statistical"

    def empty(lower, upper):
        return np.linalg.norm((lower + upper) / 2, axis=1) > 0.2

    with pytest.raises(wb.ShapeError, match="function: "):
        fit(wb.shapes.Function(contains, [-0.5, -0.5], [0.5, 0.5], empty=empty), method="sphere")


def test_vacant_boxes_hold_nothing():
    shape = three(2)
    bounder = fit(shape, method="aabb")
    positives, rng = ShapePositives(bounder, shape), np.random.default_rng(0)
    lower = rng.uniform(-1, 1, (20_000, 2))
    upper = lower + rng.uniform(0, 0.3, (20_000, 2)) ** 2
    vacant = positives.vacant(lower, upper)
    assert 0.1 < vacant.mean() < 0.9
    for share in rng.random((20, 1, 2)):
        x = bounder.domain.to_object(lower + share * (upper - lower))[vacant]
        assert (shape.decide(x) == OUT).all()


@pytest.mark.filterwarnings("ignore:.*surface only:warp_bounding.errors.BoundingWarning")
def test_open_surfaces_and_what_fills_its_box_are_bounded():
    sheet = wb.shapes.Mesh([[0, 0, 0], [1, 0, 0.2], [0, 1, 0.1], [1, 1, 0.4]], [[0, 1, 2], [2, 1, 3]])
    for margin, method in ((0.0, "obb"), (0.01, "obb"), (0.01, "mlp")):
        bounder = fit(sheet, method=method, margin=margin, **({"steps": 100} if method == "mlp" else {}))
        assert bounder.certificate.proven
        x = np.concatenate([sheet.points(100_000, np.random.default_rng(0)).astype(np.float32), sheet.vertices])
        held = sheet.dilated(margin).decide(x) == IN
        assert not (held & (bounder.query(x).numpy() == 0)).any()
    box = box_of([0, 0, 0], [1, 2, 3])
    assert wb.evaluate(fit(box, method="aabb"), box, 100_000).fp_rate < 0.1
    assert fit(box, steps=50).certificate.proven


# --- volumes over the hull of a mesh ---------------------------------------------------------------------------------


def test_the_hull_of_a_mesh_holds_it_with_its_margin():
    for points in (np.random.default_rng(1).integers(-(2**12), 2**12, (2000, 3)) / 2.0**12, mesh().corners()):
        kept, missed = few_points(points)
        assert 0 <= missed <= 1e-8 * np.ptp(points, axis=0).max()
        normals = np.random.default_rng(2).integers(-9, 10, (4000, 3)).astype(np.float64)  # few bits
        short = (points @ normals.T).max(axis=0) - (kept @ normals.T).max(axis=0)
        assert (short <= missed * np.linalg.norm(normals, axis=1)).all()
    shape = mesh(MARGIN)
    hull = hull_of(shape)
    assert hull.radius >= MARGIN
    x = shape.points(100_000, np.random.default_rng(0))
    m = np.random.default_rng(1).normal(size=(50, 3))
    reach = (hull.points @ m.T).max(axis=0) + hull.radius * np.linalg.norm(m, axis=1)
    assert ((x @ m.T).max(axis=0) <= reach).all()
    bounder = fit(mesh(), method="kdop")
    assert bounder.exact_on_hull(mesh())
    for other in (ball_at([0, 0, 0], 1.0), wb.shapes.Complement(mesh())):
        assert hull_of(other) is None or not bounder.exact_on_hull(other)


@pytest.mark.parametrize(
    ("method", "margin"), [*((method, MARGIN) for method in VOLUMES), ("aabb", 0.0), ("oriented-ellipsoid", 0.0)]
)
def test_the_hull_decides_what_a_search_brackets(method, margin, monkeypatch):
    bounder, shape = fit(mesh(), method=method, margin=margin), mesh(margin)
    positives = ShapePositives(bounder, shape)
    points = bounder.domain.to_local(border_points(shape, 4096, np.random.default_rng(1)))
    found = minimum(positives, *positives.boxes(), eps=2e-3, points=points, boxes=50_000)
    hull = least_value(bounder, shape)
    assert found.lower_bound <= hull.lower_bound <= found.upper_bound + CERTAIN
    assert bounder.certificate.lower_bound == hull.lower_bound
    rounding, left = bounder.rounding_bound(), bounder.certificate.lower_bound - float(bounder.threshold)
    assert rounding <= left <= rounding * 1.01 + 2e-7  # nothing but rounding
    rng = np.random.default_rng(2)
    corner = shape.corners()[rng.integers(len(shape.corners()), size=20_000)]
    away = rng.normal(size=corner.shape)
    far = corner + margin * (1 - 1e-6) * away / np.linalg.norm(away, axis=1, keepdims=True)
    x = np.concatenate([far, shape.points(20_000, rng)]).astype(np.float32)
    x = x[shape.contains(x)]
    assert len(x) > 20_000
    assert bounder.query(x).numpy().all()
    if method in ("sphere", "ellipsoid", "oriented-ellipsoid"):  # they touch the dilated hull
        assert -1.001 < float(bounder.threshold) <= -0.99
    check_refuted(bounder.to("cpu").freeze(float(bounder.threshold) + 0.05, None), mesh(), budget=60)

    def refuse(*_):
        raise AssertionError("a box was asked about")

    monkeypatch.setattr(wb.shapes.Mesh, "empty", refuse)
    assert wb.certify(bounder, mesh()).proven


# --- regions ---------------------------------------------------------------------------------------------------------


@cache
def positives_of(query: str) -> np.ndarray:
    """Random queries that certainly meet the dilated mesh, and others that barely do."""
    shape, kind, rng = mesh(MARGIN), QUERIES[query], np.random.default_rng(5)
    border = border_points(shape, 20_000, np.random.default_rng(4))
    x = np.concatenate([kind.sample(shape, 20_000, rng), kind.barely(shape, border, rng, 1.0, True)])
    x = x.astype(np.float32)
    x = x[kind.decide(shape, x) == IN]
    assert len(x) > 15_000
    return x


@pytest.mark.parametrize("query", REGIONS)
@pytest.mark.parametrize(
    "method",
    ["obb", "kdop", *(pytest.param(m, marks=pytest.mark.slow) for m in ("aabb", "learned-kdop"))],
)
def test_volumes_of_a_mesh_are_proven_for_regions(method, query):
    bounder = fit(mesh(), query, method, margin=MARGIN)
    assert bounder.certificate.proven
    assert bounder.info["resolution"] is None
    assert bounder.query(positives_of(query)).numpy().all()
    assert wb.certify(bounder, mesh()).proven
    larger = wb.shapes.Mesh((mesh().vertices - MIDDLE) * 1.2 + MIDDLE, mesh().faces)
    assert wb.certify(bounder, larger).kind != "proven"  # a larger object does not fit into the volume


@pytest.mark.slow
@pytest.mark.parametrize("query", REGIONS)
def test_a_stress_test_asks_certain_positives_only(query):
    bounder = fit(mesh(), query, "sphere", margin=MARGIN)
    result = stress_test(
        bounder, mesh(), 7 * QUERY_BATCH, seed=2
    )  # the seventh chunk is of float64, the eighth is placed
    assert result.missed is None
    assert result.forms["float64"]
    assert result.forms["placed"]
    raised = bounder.freeze(float(bounder.threshold) + 0.2, None)
    assert stress_test(raised, mesh(), 300_000, seed=2).missed is not None


def test_what_needs_cells_and_what_is_undecided():
    bounder = fit(mesh(), "box", "bvh", resolution=8)
    bounder.info["resolution"] = None  # a claim over cells is none about the shape
    found = wb.certify(bounder, mesh())
    assert found.kind == "inapplicable"
    assert "cells" in found.message
    with pytest.raises(BounderError, match="give a resolution"):
        prove(bounder, mesh())
    with pytest.raises(QueryError, match="give a resolution"):
        QUERIES["plane"].decide(ball_at([0, 0], 1.0), np.ones((1, 4), np.float32))
    edge = np.array([[0.0, 0.0, 1.0, 3.0, -2.0, mesh().upper[2]]], np.float32)  # touches the mesh at its top vertex
    told = QUERIES["plane"].decide(mesh(), edge)[0]
    assert QUERIES["plane"].oracle(mesh())(edge)[0] == (told != OUT)
