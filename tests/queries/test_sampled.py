"""The paper's labels: a subset of the exact ones, the same for a query in any batch, as often as volumes say."""

import numpy as np
import pytest
from bounding_shapes import shape
from region_queries import lattice_points, one_cell, small_vectors

from warp_bounding.queries import SampledOracle, oracle, sample
from warp_bounding.queries.registry import points_per_region

KINDS = ["ray", "plane", "box"]


@pytest.mark.parametrize("query", KINDS)
@pytest.mark.parametrize("name", ["c", "blob", "mesh", "animated"])
def test_sampled_hits_are_hits(query, name, device, rng):
    grid = shape(name)
    n = grid.ndim
    ends = np.sort(np.stack([lattice_points(grid, 1000, rng), lattice_points(grid, 1000, rng)]), axis=0)
    snapped = {
        "ray": np.concatenate([lattice_points(grid, 1000, rng), small_vectors(n, 1000, rng)], axis=1),
        "plane": np.concatenate([small_vectors(n, 1000, rng), lattice_points(grid, 1000, rng)], axis=1),
        "box": np.concatenate([*ends], axis=1),
    }[query]
    q = np.concatenate([sample(query, grid, 2000, rng), snapped])
    exact, labels = oracle(query, grid, device)(q), SampledOracle(query, grid, device)(q)
    assert not (labels & ~exact).any()
    assert labels.any()
    assert (labels[:2000] != exact[:2000]).mean() < {"ray": 0.1, "plane": 0.7, "box": 0.05}[query]


@pytest.mark.parametrize("query", KINDS)
def test_a_query_has_one_label(query, device, rng):
    grid = shape("mesh")
    q = sample(query, grid, 3000, rng)
    first, again = SampledOracle(query, grid, device), SampledOracle(query, grid, device, seed=1)
    labels = first(q)
    np.testing.assert_array_equal(first(q[::-1])[::-1], labels)
    np.testing.assert_array_equal(first(q[1000:1700]), labels[1000:1700])
    assert (again(q) != labels).any()


def hit_rate(query, q, device, seeds=600):
    labels = SampledOracle(query, one_cell(2), device)
    hits = 0
    for labels.seed in range(seeds):
        hits += labels(np.float32([q]))[0]
    return hits / seeds


@pytest.mark.parametrize(
    ("query", "q", "share"),
    [
        ("box", [0, 0, 0.375 + 0.03, 0.375 + 0.03], (0.03 / 0.405) ** 2),
        ("box", [0, 0.5, 0.375 + 0.001, 0.5], 0.001 / 0.376),
        ("ray", [0.374, 0.5, -1e-3, 0], 0.0),
        ("ray", [0.624, 0.5, 5, 0], 0.001),
        ("plane", [1, -100, 0.5, 0.625], 0.00125 / 6),  # of the free y: those with x >= 3/8, y <= 5/8
    ],
)
def test_labels_are_as_frequent_as_volumes_say(query, q, share, device):
    expected = 1 - (1 - share) ** points_per_region(2)
    assert abs(hit_rate(query, q, device) - expected) < 5 * np.sqrt(max(expected * (1 - expected), 1e-9) / 600)
