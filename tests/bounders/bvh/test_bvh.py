"""Hierarchies of boxes: how they are built, that they hold every cell, and that Warp's own finds the same candidates."""

import numpy as np
import pytest
import warp as wp
from bounding_shapes import SHAPES, domain_points, object_points, shape
from region_cases import cases, fitted_region

from warp_bounding.bounders.bvh import Bvh, build, inner_nodes, leaves_for_bytes
from warp_bounding.errors import BounderError
from warp_bounding.queries.region_domain import domain_of


def leaf_cells(tree, shape_of_grid) -> np.ndarray:
    covered = np.zeros(shape_of_grid, bool)
    for index in np.flatnonzero(tree.past == np.arange(len(tree.past)) + 1):
        covered[tuple(slice(a, b + 1) for a, b in zip(tree.first[index], tree.last[index], strict=True))] = True
    return covered


@pytest.mark.parametrize("leaves", [1, 2, 3, 7, 64])
@pytest.mark.parametrize("name", SHAPES)
def test_every_cell_in_a_leaf(name, leaves):
    grid = shape(name)
    tree = build(grid, leaves)
    at = np.flatnonzero(tree.past == np.arange(len(tree.past)) + 1)
    assert len(at) <= leaves
    assert len(tree.past) - len(at) <= inner_nodes(leaves)
    covered = leaf_cells(tree, grid.shape)
    assert covered[tuple(grid.occupied.T)].all()
    if len(at) < leaves:  # nothing is left to cut off
        assert covered.sum() == len(grid.occupied)


@pytest.mark.parametrize("ndim", [2, 3, 4])
@pytest.mark.parametrize("nbytes", [0, 100, 1000, 11_204, 50_000])
def test_leaves_for_bytes(nbytes, ndim):
    leaves = leaves_for_bytes(nbytes, ndim)
    grid = shape({2: "c", 3: "star", 4: "animated"}[ndim])
    bounder = Bvh.fit(grid, domain_of(grid, "ray"), leaves=leaves, device="cpu")
    assert leaves == 1 or bounder.nbytes <= nbytes
    nodes = leaves + 1 + inner_nodes(leaves + 1)
    assert 4 * (4 * ndim + 3 + nodes * (2 * ndim + 1)) > nbytes


@pytest.mark.parametrize("leaves", [1, 2, 5, 300])
def test_points(leaves, device, rng):
    grid = shape("blob")
    bounder = fitted_region("bvh", "point", grid, device, leaves=leaves)
    assert bounder.least(grid) == (0.0, len(grid.occupied))
    assert bounder.query(object_points(grid, rng)).numpy().all()
    x = domain_points(grid, 20_000, rng)
    answers = bounder.query(x).numpy().astype(bool)
    expected = leaf_cells(build(grid, leaves), grid.shape)
    cell = np.clip(np.round(grid.cells_per_unit * x + grid.offset), 0, np.array(grid.shape) - 1).astype(int)
    inside = ((x >= grid.lower) & (x <= grid.upper)).all(axis=1)
    assert (answers != (expected[tuple(cell.T)] & inside)).mean() < 5e-3  # cells are widened by a 4096th
    assert (bounder.reference(bounder.domain.to_local(x))[inside] == 0).mean() == pytest.approx(
        answers[inside].mean(), abs=1e-4
    )


@pytest.mark.parametrize("query", ["ray", "plane", "box"])
@pytest.mark.parametrize("leaves", [1, 3, 300])
def test_regions(query, leaves, device, rng):
    grid = shape("blob")
    q, truth = cases(query, grid, rng)
    bounder = fitted_region("bvh", query, grid, device, leaves=leaves)
    answers = bounder.query(q).numpy().astype(bool)
    assert (answers >= truth).all()
    if leaves == 300:
        assert answers[:6000].mean() < truth[:6000].mean() + 0.01


def test_what_is_no_hierarchy():
    bounder = fitted_region("bvh", "box", shape("c"), leaves=5)
    for name, change in (
        ("past", lambda t: t[::-1]),
        ("past", lambda t: t + np.float32(0.5)),
        ("past", lambda t: np.zeros_like(t)),
        ("low", lambda t: t - np.arange(len(t), dtype=np.float32)[:, None]),
        ("high", lambda t: t[:-1]),
        ("low", lambda t: t * np.float32(np.nan)),
    ):
        with pytest.raises(BounderError):
            Bvh(bounder.domain, bounder.tensors | {name: change(bounder.tensors[name])}, {}, "cpu")
    for options in ({"leaves": 0}, {"leaves": 2.5}):
        with pytest.raises(BounderError, match="must be"):
            Bvh.fit(shape("c"), bounder.domain, **options)


def test_boxes_that_lose_a_cell_prove_nothing():
    grid = shape("c")
    bounder = fitted_region("bvh", "box", grid, leaves=5)
    smaller = bounder.tensors["high"].copy()
    smaller[-1] = np.nextafter(bounder.tensors["high"][-1], np.float32(-1)) - np.float32(1e-3)
    assert Bvh(bounder.domain, bounder.tensors | {"high": smaller}, {}, "cpu").least(grid)[0] == -1.0


@wp.kernel(enable_backward=False)
def count_boxes(
    tree: wp.uint64, low: wp.array(dtype=wp.vec3), high: wp.array(dtype=wp.vec3), out: wp.array(dtype=wp.uint8)
):
    i = wp.tid()
    query = wp.bvh_query_aabb(tree, low[i], high[i])
    index = wp.int32(0)
    if wp.bvh_query_next(query, index):
        out[i] = wp.uint8(1)


@wp.kernel(enable_backward=False)
def count_rays(
    tree: wp.uint64,
    start: wp.array(dtype=wp.vec3),
    along: wp.array(dtype=wp.vec3),
    low: wp.array(dtype=wp.vec3),
    high: wp.array(dtype=wp.vec3),
    out: wp.array(dtype=wp.uint8),
):
    """Warp's rays have no end: each box that it names is clipped again, in float64."""
    i = wp.tid()
    query = wp.bvh_query_ray(tree, start[i], along[i])
    index = wp.int32(0)
    while wp.bvh_query_next(query, index):
        near, away = wp.float64(0.0), wp.float64(1.0)
        for k in range(3):
            one = (wp.float64(low[index][k]) - wp.float64(start[i][k])) / wp.float64(along[i][k])
            two = (wp.float64(high[index][k]) - wp.float64(start[i][k])) / wp.float64(along[i][k])
            near, away = wp.max(near, wp.min(one, two)), wp.min(away, wp.max(one, two))
        if near <= away:
            out[i] = wp.uint8(1)
            break


@pytest.mark.parametrize("query", ["ray", "box"])
def test_as_warps_own_hierarchy(query, device, rng):
    """The same candidates as ``wp.Bvh`` over the same leaves, but for regions that graze one within float32 rounding."""
    grid = shape("star")
    bounder = fitted_region("bvh", query, grid, device, leaves=100)
    domain, n = bounder.domain, 50_000
    a, b = ((rng.random((n, 3)) * 2 - 1).astype(np.float32) * np.float32(0.98) for _ in range(2))
    if query == "box":
        b = a + (b - a) * np.float32(0.2)
        a, b = np.minimum(a, b), np.maximum(a, b)
        v = np.concatenate([a, b], axis=1)
    else:
        b = (b - a) * (np.linalg.norm(domain.stretch) / 4 / np.linalg.norm(b - a, axis=1))[:, None]
        q = domain.to_object(np.concatenate([a, b], axis=1))
        v = domain.to_local(q).astype(np.float32)
    q = domain.to_object(v).astype(np.float32)
    v = domain.to_local(q).astype(np.float32)  # what is asked, within the rounding of one map
    ours = bounder.query(q).numpy().astype(bool)
    ends = [wp.array(bounder.tensors[k][bounder.leaves], dtype=wp.vec3, device=device) for k in ("low", "high")]
    tree = wp.Bvh(*ends)
    first, second = (
        wp.array(np.ascontiguousarray(part), dtype=wp.vec3, device=device) for part in (v[:, :3], v[:, 3:])
    )
    out = wp.zeros(n, dtype=wp.uint8, device=device)
    kernel, more = (count_boxes, []) if query == "box" else (count_rays, ends)
    wp.launch(kernel, dim=n, inputs=[tree.id, first, second, *more], outputs=[out], device=device)
    theirs = out.numpy().astype(bool)
    assert 0.1 < theirs.mean() < 0.95
    assert (ours & ~theirs).mean() < 2e-4
    assert (theirs & ~ours).mean() < 2e-4  # v was rounded once more here
