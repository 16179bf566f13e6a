"""Planes: the support gap is a lower bound over all normals, with zero slack, and no plane through the object is denied."""

import numpy as np
import pytest
from bounding_shapes import shape
from random_networks import random_supports

import warp_bounding as wb
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.errors import BounderError
from warp_bounding.geometry import hull_corners
from warp_bounding.proof import certify, minimum, prove
from warp_bounding.proof.covers.plane import SupportGap
from warp_bounding.queries.hard import draw_positives
from warp_bounding.queries.region_domain import domain_of

SHAPES = ("c", "blob", "anisotropic", "animated")


@pytest.mark.parametrize("name", ["c", "blob", "star", "single", "anisotropic", "animated"])
def test_hull_corners_hold_every_support(name):
    grid, rng = shape(name), np.random.default_rng(0)
    corners = hull_corners(grid.occupied) - 0.5
    steps = np.stack(np.meshgrid(*[[-0.5, 0.5]] * grid.ndim, indexing="ij"), -1).reshape(-1, grid.ndim)
    every = (grid.occupied[:, None] + steps).reshape(-1, grid.ndim)
    normals = np.concatenate([rng.normal(size=(500, grid.ndim)), rng.integers(-3, 4, (500, grid.ndim))])
    assert ((corners @ normals.T).max(axis=0) >= (every @ normals.T).max(axis=0) - 1e-12 * np.abs(every).max()).all()
    integers = normals[500:]  # exact: multiples of 1/2
    assert ((corners @ integers.T).max(axis=0) == (every @ integers.T).max(axis=0)).all()


@pytest.mark.parametrize("activation", ["sin", "relu"])
@pytest.mark.parametrize("name", SHAPES)
def test_bounds_hold_on_boxes_of_normals(name, activation):
    grid, rng = shape(name), np.random.default_rng(1)
    gap = SupportGap(random_supports(grid, 3, activation), grid)
    lower, upper = gap.boxes()
    pick = rng.integers(len(lower), size=300)
    part = rng.random((300, 1)) ** 3
    center = lower[pick] + rng.random((300, grid.ndim)) * (upper - lower)[pick]
    low = np.maximum(center - part * (upper - lower)[pick], lower[pick])
    high = np.minimum(center + part * (upper - lower)[pick], upper[pick])
    bounds = gap.bound(low, high)
    for _ in range(60):
        m = low + np.round(rng.random(low.shape) * 2) / 2 * (high - low)
        assert (gap.reference(m) >= bounds.lower).all()
    assert (bounds.value >= bounds.lower).all()


@pytest.mark.parametrize("name", SHAPES)
def test_a_proven_network_denies_no_plane_through_the_object(name):
    grid, bounder = shape(name), random_supports(shape(name), 5)
    prove(bounder, grid, eps=0.05)
    assert bounder.certificate.proven
    for x in draw_positives("plane", grid, 100_000, 2, "cpu"):
        assert (bounder.query(x).numpy() == 1).all()
    assert certify(bounder, grid).proven


def test_a_raised_threshold_is_refuted():
    grid = shape("blob")
    bounder = random_supports(grid, 5)
    prove(bounder, grid, eps=0.01)
    raised = bounder.freeze(float(bounder.threshold) + 0.3, None)
    proof = certify(raised, grid)
    assert proof.kind == "refuted"
    assert raised.query(np.array([proof.counterexample], np.float32)).numpy()[0] == 0


def test_a_search_cut_short_is_sound():
    grid = shape("animated")
    gap = SupportGap(random_supports(grid, 6), grid)
    short, long = (minimum(gap, *gap.boxes(), eps=e, boxes=b) for e, b in ((0.001, 10), (0.02, 1e6)))
    assert short.lower_bound <= long.upper_bound


def test_a_fit_of_planes_is_proven_and_kept(tmp_path):
    grid = shape("c")
    bounder = wb.fit(grid, query="plane", hidden=(8,), steps=60, activation="relu", device="cpu")
    assert bounder.certificate.proven
    rates = wb.evaluate(bounder, grid, samples=100_000)
    assert rates.fn == 0
    bounder.save(tmp_path / "p.safetensors")
    again = wb.load(tmp_path / "p.safetensors", device="cpu")
    assert wb.evaluate(again, grid, samples=100_000) == rates
    assert wb.certify(again, grid).proven


def test_what_has_no_proof_is_not_proven(monkeypatch):
    monkeypatch.setattr(Mlp, "provable", False)
    domain = domain_of(shape("c"), "ray")
    tensors = {"layers.0.weight": np.ones((2, 4), np.float32), "layers.0.bias": np.zeros(2, np.float32)}
    tensors |= {"layers.1.weight": np.ones((1, 2), np.float32), "layers.1.bias": np.zeros(1, np.float32)}
    sizes = {"hidden": [2], "activation": "sin", "octaves": 0}
    with pytest.raises(BounderError, match="no proof"):
        prove(Mlp(domain, tensors, sizes, "cpu"), shape("c"))
