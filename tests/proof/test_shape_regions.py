"""Rays, planes and boxes of a mesh itself, without cells: volumes over its hull, supports, a monotone network."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import trimesh

import warp_bounding as wb
from warp_bounding.errors import BounderError, QueryError
from warp_bounding.geometry import few_points, hull_of
from warp_bounding.indicators.shape import IN, OUT
from warp_bounding.proof import prove, soak
from warp_bounding.proof.attest.soak import CHUNK
from warp_bounding.proof.covers.plane import SupportGap
from warp_bounding.proof.shape_regions import ShapeRegions, coarse_cells
from warp_bounding.queries import QUERIES
from warp_bounding.queries.boundary import border_points

VOLUMES = ("aabb", "obb", "sphere", "ellipsoid", "oriented-ellipsoid", "kdop", "learned-kdop")
REGIONS = ("ray", "plane", "box")
MARGIN = 0.03


def mesh(margin: float = 0.0) -> wb.IndicatorMesh:
    """A ball and a bar that sticks out of it, in coordinates far from 0 and with unequal sides."""
    ball, bar = trimesh.creation.icosphere(2, 0.4), trimesh.creation.box((1.6, 0.2, 0.3))
    both = trimesh.util.concatenate([ball, bar])
    return wb.IndicatorMesh(np.asarray(both.vertices) + np.array([3.0, -2.0, 0.5]), both.faces).dilated(margin)


def cloud(name: str) -> np.ndarray:
    """Points ``(P, 3)`` that are float32 numbers."""
    rng = np.random.default_rng(1)
    if name == "ball":
        return rng.integers(-(2**12), 2**12, (2000, 3)) / 2.0**12
    if name == "sphere":
        return trimesh.creation.icosphere(4).vertices.astype(np.float32).astype(np.float64)
    if name == "cube":  # most points lie in faces
        x = rng.random((1500, 3)).astype(np.float32).astype(np.float64)
        x[np.arange(1500), rng.integers(3, size=1500)] = rng.integers(2, size=1500)
        return x
    if name == "flat":
        return np.pad(rng.random((500, 2)).astype(np.float32).astype(np.float64), ((0, 0), (0, 1)))
    return (rng.normal(size=(3000, 3)) * [1e3, 1.0, 1e-3]).astype(np.float32).astype(np.float64)  # a needle


@cache
def border() -> np.ndarray:
    return border_points(mesh(MARGIN), 20_000, np.random.default_rng(4))


def positives(query: str) -> np.ndarray:
    """Random queries that certainly meet the dilated mesh, and others that barely do."""
    shape, kind, rng = mesh(MARGIN), QUERIES[query], np.random.default_rng(5)
    x = np.concatenate([kind.sample(shape, 20_000, rng), kind.barely(shape, border(), rng, 1.0, True)]).astype(
        np.float32
    )
    x = x[kind.decide(shape, x) == IN]
    assert len(x) > 15_000
    return x


@pytest.mark.parametrize("name", ["ball", "sphere", "cube", "flat", "needle"])
def test_few_points_hold_every_support(name):
    points, rng = cloud(name), np.random.default_rng(2)
    kept, missed = few_points(points)
    assert 0 <= missed <= 1e-8 * np.ptp(points, axis=0).max()
    if name in ("ball", "needle"):
        assert len(kept) < 0.3 * len(points)
    normals = rng.integers(-9, 10, (4000, 3)).astype(np.float64)  # few bits: the products of "ball" are exact
    short = (points @ normals.T).max(axis=0) - (kept @ normals.T).max(axis=0)
    assert (short <= missed * np.linalg.norm(normals, axis=1)).all()


def test_the_hull_of_a_mesh_holds_it_with_its_margin():
    shape = mesh(MARGIN)
    hull = hull_of(shape)
    assert hull.radius >= MARGIN
    assert hull_of(shape) is hull
    x = shape.points(100_000, np.random.default_rng(0))
    m = np.random.default_rng(1).normal(size=(50, 3))
    reach = (hull.points @ m.T).max(axis=0) + hull.radius * np.linalg.norm(m, axis=1)
    assert ((x @ m.T).max(axis=0) <= reach).all()
    assert hull_of(wb.solids.Sphere([0, 0, 0], 1.0)) is None


@pytest.mark.parametrize("query", REGIONS)
@pytest.mark.parametrize("method", VOLUMES)
def test_volumes_of_a_mesh_are_proven_for_regions(method, query):
    shape = mesh()
    options = {"steps": 100} if method == "learned-kdop" else {}
    bounder = wb.fit(shape, query, method, margin=MARGIN, device="cpu", progress=False, **options)
    assert bounder.certificate.proven
    assert bounder.info["resolution"] is None
    assert bounder.certificate.cells == 0
    assert (bounder.query(positives(query)).numpy() == 1).all()
    assert wb.certify(bounder, shape).proven
    rates = wb.evaluate(bounder, shape, samples=20_000)
    assert rates.fn == 0
    assert rates.fp_rate_cells is None
    assert "shape itself" in rates.truth
    larger = replace(shape, vertices=(shape.vertices - [3.0, -2.0, 0.5]) * np.float32(1.2) + [3.0, -2.0, 0.5])
    assert wb.certify(bounder, larger).kind != "proven"  # a larger object does not fit into the volume


@pytest.mark.parametrize("margin", [0.0, MARGIN])
def test_bounds_of_supports_hold_on_boxes_of_normals(margin):
    shape, rng = mesh(margin), np.random.default_rng(1)
    bounder = wb.fit(mesh(), "plane", hidden=(8,), steps=40, margin=margin, device="cpu", progress=False)
    gap = SupportGap(bounder, shape)
    lower, upper = gap.boxes()
    pick, part = rng.integers(len(lower), size=300), rng.random((300, 1)) ** 3
    center = lower[pick] + rng.random((300, 3)) * (upper - lower)[pick]
    low = np.maximum(center - part * (upper - lower)[pick], lower[pick])
    high = np.minimum(center + part * (upper - lower)[pick], upper[pick])
    bounds = gap.bound(low, high)
    for _ in range(60):
        m = low + np.round(rng.random(low.shape) * 2) / 2 * (high - low)
        assert (gap.reference(m) >= bounds.lower).all()


def test_planes_of_a_mesh_are_proven_and_a_raised_threshold_is_refuted():
    shape = mesh()
    bounder = wb.fit(shape, "plane", hidden=(8,), steps=60, margin=MARGIN, device="cpu", progress=False)
    assert bounder.certificate.proven
    assert bounder.info["resolution"] is None
    assert (bounder.query(positives("plane")).numpy() == 1).all()
    assert wb.certify(bounder, shape).proven
    raised = bounder.freeze(float(bounder.threshold) + 0.2, None)
    proof = wb.certify(raised, shape)
    assert proof.kind == "refuted"
    found = np.array([proof.counterexample], np.float32)
    assert raised.query(found).numpy()[0] == 0
    assert QUERIES["plane"].decide(shape.dilated(MARGIN), found)[0] == IN


def test_boxes_of_a_monotone_network_are_proven_over_the_points_of_a_mesh(tmp_path):
    shape = mesh()
    bounder = wb.fit(shape, "box", "monotone-mlp", hidden=(8,), steps=60, margin=MARGIN, device="cpu", progress=False)
    assert bounder.certificate.proven
    assert bounder.info["resolution"] is None
    assert (bounder.query(positives("box")).numpy() == 1).all()
    bounder.save(tmp_path / "b.safetensors")
    assert wb.certify(wb.load(tmp_path / "b.safetensors", device="cpu"), shape).proven
    gap = bounder.info["training"]["gap"]  # between what is proven and the least f that was found
    raised = bounder.freeze(float(bounder.threshold) + gap + 0.5, None)
    assert wb.certify(raised, shape).kind == "refuted"


@pytest.mark.slow
@pytest.mark.parametrize("query", REGIONS)
def test_a_soak_asks_certain_positives_only(query):
    shape = mesh()
    bounder = wb.fit(shape, query, "sphere", margin=MARGIN, device="cpu", progress=False)
    result = soak(bounder, shape, 7 * CHUNK, seed=2)  # the seventh chunk is of float64
    assert result.missed is None
    assert result.forms["float64"]
    assert result.forms["placed"] == 0
    raised = bounder.freeze(float(bounder.threshold) + 0.2, None)
    assert soak(raised, shape, 300_000, seed=2).missed is not None


@pytest.mark.parametrize("query", ["ray", "box"])
def test_networks_of_regions_are_fitted_to_the_mesh_itself(query, tmp_path):
    shape = mesh()
    told = {"length": 0.7} if query == "ray" else {}
    bounder = wb.fit(shape, query, hidden=(8,), steps=60, margin=MARGIN, device="cpu", progress=False, **told)
    assert bounder.info["resolution"] is None
    assert bounder.certificate.kind in ("proven", "statistical")
    assert " cells" not in bounder.certificate.message
    found = wb.evaluate(bounder, shape, samples=20_000)
    assert found.fn == 0
    assert found.fp_rate < 90
    bounder.save(tmp_path / "b.safetensors")
    assert wb.load(tmp_path / "b.safetensors", device="cpu").info["resolution"] is None


def test_boxes_of_a_network_are_proven_over_the_mesh_itself():
    shape = mesh()
    bounder = wb.fit(shape, "box", hidden=(8,), steps=60, margin=MARGIN, device="cpu", progress=False)
    assert bounder.certificate.proven
    assert wb.certify(bounder, shape).proven
    assert (bounder.query(positives("box")).numpy() == 1).all()
    least = float(bounder.reference(bounder.domain.to_local(positives("box"))).min())
    raised = bounder.freeze(least + 0.5, None)
    proof = wb.certify(raised, shape)
    assert proof.kind == "refuted"
    found = np.array([proof.counterexample], np.float32)
    assert raised.query(found).numpy()[0] == 0
    assert QUERIES["box"].decide(shape.dilated(MARGIN), found)[0] == IN


@pytest.mark.parametrize("query", ["ray", "box"])
def test_no_positive_is_in_a_box_that_is_called_vacant(query):
    shape, rng = mesh().dilated(MARGIN), np.random.default_rng(1)
    told = {"length": 0.7} if query == "ray" else {}
    bounder = wb.fit(mesh(), query, hidden=(8,), steps=2, margin=MARGIN, device="cpu", progress=False, **told)
    regions = ShapeRegions(bounder, shape, coarse_cells(shape, 0.25))
    lower, upper = regions.boxes()
    count, n = 4000, shape.ndim
    chosen = rng.integers(len(lower), size=count)
    z = lower[chosen] + rng.random((count, lower.shape[1])) * (upper - lower)[chosen]
    size = np.exp2(rng.uniform(-12, -1, (count, 1)))
    low = np.maximum(z - size * rng.random(z.shape), lower[chosen])
    high = np.minimum(z + size * rng.random(z.shape), upper[chosen])
    vacant = regions.vacant(low, high)
    assert vacant.any()
    assert not vacant.all()
    v = regions.coordinates(z[vacant])
    if query == "ray":  # from p on: before it there are no cells, or others tell of them
        p, t, w = z[vacant, :n], z[vacant, n : n + 1], v[:, n:]
        to_object = bounder.domain.base.to_object
        assert (shape.decide_segments(to_object(p), to_object(p + (1 - t) * w)) == OUT).all()
    else:
        assert (QUERIES["box"].decide(shape, bounder.domain.to_object(v)) == OUT).all()


@pytest.mark.parametrize("query", ["ray", "box"])
def test_a_claim_over_cells_is_none_about_the_shape(query):
    shape = mesh()
    bounder = wb.fit(shape, query, "bvh", resolution=8, device="cpu", progress=False)
    bounder.info["resolution"] = None
    found = wb.certify(bounder, shape)
    assert found.kind == "inapplicable"
    assert "cells" in found.message
    with pytest.raises(BounderError, match="give a resolution"):
        prove(bounder, shape)


def test_what_no_shape_can_tell_needs_cells():
    solid = wb.solids.Sphere([0, 0], 1.0)
    assert wb.fit(solid, "plane", "aabb", device="cpu", progress=False).info["resolution"] is not None
    with pytest.raises(QueryError, match="give a resolution"):
        QUERIES["plane"].decide(solid, np.ones((1, 4), np.float32))


def test_undecided_regions_count_as_object():
    shape = mesh()
    edge = np.array([[0.0, 0.0, 1.0, 3.0, -2.0, shape.upper[2]]], np.float32)  # touches the ball at its top vertex
    told = QUERIES["plane"].decide(shape, edge)[0]
    assert QUERIES["plane"].oracle(shape)(edge)[0] == (told != OUT)
