"""Planes of a network: bounds over boxes of normals hold with zero slack, and no plane that meets the object is
denied."""

from types import SimpleNamespace

import numpy as np
import pytest
from bounding_shapes import random_mlp, random_supports, shape
from plain_shapes import TETRAHEDRON
from rewriting import check_refuted

import warp_bounding as wb
from warp_bounding.proof import certify, minimum, prove
from warp_bounding.proof.planes import SupportGap
from warp_bounding.queries import oracle
from warp_bounding.queries.hard import draw_positives
from warp_bounding.queries.region_domain import domain_of


def test_planes_have_no_bound_where_their_networks_have_none():
    grid = shape("c")
    nothing = SimpleNamespace(level=np.full(8, np.nan), slope=np.zeros((8, 2)), bound=lambda *_: nothing)
    gap = SupportGap(SimpleNamespace(networks=[nothing, nothing], domain=domain_of(grid, "plane")), grid)
    gap.reference = lambda m: np.zeros(len(m))
    assert not (gap.bound(*gap.boxes()).lower > 0).any()


@pytest.mark.parametrize(("name", "activation"), [("c", "relu"), ("blob", "sin"), ("animated", "sin")])
def test_bounds_hold_on_boxes_of_normals_and_what_is_proven_denies_no_plane(name, activation):
    grid, rng = shape(name), np.random.default_rng(1)
    bounder = random_supports(grid, 3, activation)
    gap = SupportGap(bounder, grid)
    lower, upper = gap.boxes()
    pick, part = rng.integers(len(lower), size=300), rng.random((300, 1)) ** 3
    center = lower[pick] + rng.random((300, grid.ndim)) * (upper - lower)[pick]
    low = np.maximum(center - part * (upper - lower)[pick], lower[pick])
    high = np.minimum(center + part * (upper - lower)[pick], upper[pick])
    bounds = gap.bound(low, high)
    for _ in range(60):
        m = low + np.round(rng.random(low.shape) * 2) / 2 * (high - low)
        assert (gap.reference(m) >= bounds.lower).all()
    assert (bounds.value >= bounds.lower).all()
    cut = minimum(gap, lower, upper, eps=0.001, boxes=10)
    search = prove(bounder, grid, eps=0.05)
    assert cut.lower_bound <= search.upper_bound
    assert bounder.query(next(iter(draw_positives("plane", grid, 100_000, 2, "cpu")))).numpy().all()
    assert certify(bounder, grid).proven
    check_refuted(bounder.freeze(search.upper_bound + 0.3, None), grid)


@pytest.mark.parametrize("margin", [0.0, 5e-324, 1e-200, 1e-100])
def test_a_margin_of_next_to_nothing_leaves_planes_a_proof(margin):
    """Its square is 0 in float64, also where a hull of few corners is rounded up by the least number above 0."""
    mesh = wb.shapes.Mesh(*TETRAHEDRON).dilated(margin)
    bounder = random_mlp(mesh, domain=domain_of(mesh, "plane"))
    assert prove(bounder, mesh, eps=0.1).lower_bound > -100
    assert bounder.certificate.proven


def test_touching_planes_meet_the_object_and_have_the_gap_as_f(rng):
    grid = shape("c")
    bounder = random_supports(grid, 5, "sin")
    gap = SupportGap(bounder, grid)
    lower, upper = gap.boxes()
    m = lower + rng.random(lower.shape) * (upper - lower)
    v = gap.touching(m)
    values = bounder.reference(v).reshape(2, -1).min(axis=0) - gap.rounding
    np.testing.assert_allclose(values, gap.reference(m), atol=1e-9)
    inward = v - np.sign(v[:, -1:]) * np.eye(v.shape[1])[-1] * 1e-3  # both supports are beyond the domain's middle
    assert oracle("plane", grid, "cpu", 1.0)(bounder.domain.to_object(inward)).mean() > 0.9
