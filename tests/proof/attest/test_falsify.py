"""Walks over real queries: valid, checked by oracle and kernel, lower than where they began."""

import numpy as np
import pytest

import warp_bounding as wb
from warp_bounding.errors import BounderError
from warp_bounding.indicators import IndicatorGrid
from warp_bounding.proof import prove
from warp_bounding.proof.attest.falsify import Walk, queries_at
from warp_bounding.queries import oracle
from warp_bounding.queries.hard import draw_positives

QUERIES = ("point", "ray", "plane", "box")


@pytest.fixture(scope="module")
def grid():
    occupancy = np.zeros((9, 8), bool)
    occupancy[2:5, 3:6] = occupancy[6, 1:4] = True
    return IndicatorGrid(occupancy)


@pytest.fixture(scope="module")
def networks(grid):
    return {q: wb.fit(grid, query=q, method="mlp", hidden=(12, 12), steps=30, device="cpu") for q in QUERIES}


@pytest.mark.parametrize("query", QUERIES)
def test_a_walk_goes_down_over_positives(grid, networks, query):
    network = networks[query]
    x = next(draw_positives(query, grid, 64, 5))[:64]
    walk = Walk(network, grid, seed=1)
    found, values = walk.down(x, rounds=60)
    assert found.dtype == np.float32
    assert (np.diff(values) >= 0).all()
    assert values[0] <= network.values(x).numpy().min()
    assert oracle(query, grid, network.device, 1.0)(found).all()
    np.testing.assert_array_equal(network.values(found).numpy(), values)
    again, _ = Walk(network, grid, seed=1).down(x, rounds=60)
    np.testing.assert_array_equal(found, again)
    n = grid.ndim
    if query == "ray":
        np.testing.assert_allclose(np.linalg.norm(found[:, n:], axis=1), 1, atol=1e-6)
    if query == "box":
        assert (found[:, :n] <= found[:, n:]).all()


def test_nothing_comes_of_negatives(grid, networks):
    walk = Walk(networks["point"], grid)
    outside = np.full((5, 2), grid.upper, np.float32)
    assert np.isinf(walk.values(outside)).all()
    assert len(walk.around(outside)[0]) == len(walk.down(outside)[0]) == 0


@pytest.mark.parametrize("query", ["point", "plane"])
def test_a_proofs_points_are_queries(grid, networks, query):
    network = networks[query].to("cpu")
    search = prove(network, grid, eps=1e-3)
    walk = Walk(network, grid)
    found, values = walk.around(queries_at(network, grid, search.worst))
    assert len(found)
    assert values[0] >= network.threshold
    assert values[0] == pytest.approx(search.upper_bound, abs=0.05 * (1 + abs(search.upper_bound)))


def test_rays_by_a_point_that_they_pass(grid, networks):
    domain = networks["ray"].domain
    x = next(draw_positives("ray", grid, 64, 6))[:64]
    v = domain.to_local(x)
    t = np.linspace(0, 1, len(v))[:, None]
    m = 3 * v[:, 2:] / domain.stretch
    z = np.concatenate([v[:, :2] + t * v[:, 2:], t, m], axis=1)
    np.testing.assert_allclose(queries_at(networks["ray"], grid, z), x, atol=1e-6)
    with pytest.raises(BounderError, match="4 coordinates, got 3"):
        queries_at(networks["ray"], grid, z[:, :3])
