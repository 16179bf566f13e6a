"""The plane oracle is the rational twin, and hulls lose no corner."""

from types import SimpleNamespace

import numpy as np
import pytest
from bounding_shapes import object_points, shape
from region_queries import SHAPES, lattice_points, odd_queries, one_cell, small_vectors, sparse_grid

from warp_bounding.errors import QueryError
from warp_bounding.geometry import components, connected_labels, hull_corners
from warp_bounding.queries.directions import sample_directions
from warp_bounding.queries.plane import PLANE


def planes_of_all_kinds(grid, count, rng):
    n, scale = grid.ndim, np.float32(grid.cells_per_unit)
    plain = PLANE.sample(grid, count, rng)
    snapped = np.concatenate([small_vectors(n, count, rng) * scale, lattice_points(grid, count, rng)], axis=1)
    through = np.concatenate([sample_directions(n, count, rng) * scale, lattice_points(grid, count, rng)], axis=1)
    return np.concatenate(
        [plain, snapped, through, odd_queries(grid, plain, rng), odd_queries(grid, snapped, rng)], dtype=np.float32
    )


@pytest.mark.parametrize("name", [*SHAPES, "star"])
def test_oracle_is_the_rational_truth(name, device, rng):
    grid = shape(name)
    q = planes_of_all_kinds(grid, 150, rng)
    truth = PLANE.truth(grid, q)
    np.testing.assert_array_equal(PLANE.oracle(grid, device)(q), truth)
    assert truth.any()
    assert not truth.all()


@pytest.mark.parametrize("cells", [(40, 25, 30), (120, 40), (7, 9, 8, 11)])
def test_planes_between_components_miss(cells, device, rng):
    grid = sparse_grid(cells, 6)
    q = planes_of_all_kinds(grid, 300, rng)
    truth = PLANE.truth(grid, q)
    np.testing.assert_array_equal(PLANE.oracle(grid, device)(q), truth)
    assert 100 < truth.sum() < len(q) - 100


@pytest.mark.parametrize("n", [2, 3, 4])
def test_planes_touch_faces_and_corners(n, device, rng):
    """Supporting planes of one cell, through its own corner: at it, and one float outside of it."""
    grid, oracle = one_cell(n), PLANE.oracle(one_cell(n), device)
    normal = np.abs(sample_directions(n, 500, rng)) + np.float32(1e-3)
    normal[:n] = np.eye(n)
    normal[n : n + 50] = rng.integers(1, 4, (50, n))
    corner = np.full_like(normal, 0.625)
    outside = np.where(normal > 0, np.nextafter(corner, np.float32(1)), corner)
    touching, missing = (np.concatenate([normal, point], axis=1) for point in (corner, outside))
    assert oracle(touching).all()
    assert oracle.undecided == 0
    assert not oracle(missing).any()
    assert PLANE.truth(grid, touching[:100]).all()
    assert not PLANE.truth(grid, missing[:100]).any()


def test_supporting_planes_of_a_shape_are_decided_by_the_kernel(device, rng):
    grid, oracle = shape("star"), PLANE.oracle(shape("star"), device)
    corners = components(grid.occupancy)[0].corners
    normal = sample_directions(3, 2000, rng)
    extreme = corners[(normal.astype(np.float64) @ corners.T).argmax(axis=1)]
    point = grid.position(extreme - 0.5).astype(np.float32)
    q = np.concatenate([normal, point], axis=1)
    truth = PLANE.truth(grid, q[:200])
    np.testing.assert_array_equal(oracle(q)[:200], truth)
    assert oracle.undecided < 20


def test_invalid_planes_meet_nothing(device):
    q = np.float32([[0, 0, 0.5, 0.5], [np.nan, 1, 0.5, 0.5], [1, 0, np.inf, 0.5], [np.inf, 1, 0.5, 0.5]])
    assert not PLANE.oracle(one_cell(2), device)(q).any()


@pytest.mark.parametrize("count", [0, 1, 511, 513])
def test_any_number_of_planes(count, device, rng):
    grid = shape("c")
    q = PLANE.sample(grid, count, rng)
    np.testing.assert_array_equal(PLANE.oracle(grid, device)(q), PLANE.truth(grid, q))


@pytest.mark.parametrize("q", [np.zeros(6), np.zeros((4, 3)), np.zeros((1, 4, 6))])
def test_oracle_refuses_other_shapes(q):
    with pytest.raises(QueryError, match=r"\(N, 6\)"):
        PLANE.oracle(shape("blob"), "cpu")(q)


# --- components and hulls --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.01, 0.1, 0.3, 0.7])
@pytest.mark.parametrize("cells", [(200,), (20, 25), (7, 8, 6), (4, 5, 3, 4)])
def test_labels_are_those_of_a_plain_flood(cells, share, rng):
    occupancy = rng.random(cells) < share
    occupancy.flat[0] = True
    left, numbers = {tuple(cell) for cell in np.argwhere(occupancy).tolist()}, {}
    while left:
        front, number = [left.pop()], len(numbers)
        while front:
            cell = front.pop()
            numbers[cell] = number
            near = [tuple(a + s - 1 for a, s in zip(cell, step, strict=True)) for step in np.ndindex((3,) * len(cells))]
            front += left.intersection(near)
            left.difference_update(near)
    flood = [numbers[tuple(cell)] for cell in np.argwhere(occupancy).tolist()]
    labels = connected_labels(occupancy).tolist()
    assert len({*zip(labels, flood, strict=True)}) == len({*labels}) == len({*flood})


def ball(ndim, size):
    t = np.stack(np.meshgrid(*[np.arange(size) - (size - 1) / 2] * ndim, indexing="ij"))
    return np.argwhere((t * t).sum(axis=0) < (size / 2) ** 2)


def all_corners(cells):
    return np.unique((cells[:, None] + list(np.ndindex((2,) * cells.shape[1]))).reshape(-1, cells.shape[1]), axis=0)


@pytest.mark.parametrize(("ndim", "size"), [(1, 9), (2, 40), (3, 16), (4, 9), (5, 4)])
def test_hull_corners_support_in_every_direction(ndim, size, rng):
    cells = ball(ndim, size)
    cells = cells[rng.random(len(cells)) < 0.8]
    corners, kept = all_corners(cells), hull_corners(cells)
    directions = rng.integers(-9, 10, (3000, ndim))  # integers: exact, and many ties
    np.testing.assert_array_equal((directions @ kept.T).max(axis=1), (directions @ corners.T).max(axis=1))
    assert {*map(tuple, kept.tolist())} <= {*map(tuple, corners.tolist())}
    assert ndim == 1 or len(kept) < len(corners)


def test_a_hull_that_lost_a_corner_is_mended(rng, monkeypatch):
    """Corners that Qhull drops stay unless integers say that they are inside."""
    spatial = pytest.importorskip("scipy.spatial")
    cells, honest = ball(3, 14), spatial.ConvexHull
    corners = all_corners(cells)

    def careless(points):
        hull = honest(points[::3])
        return SimpleNamespace(simplices=hull.simplices * 3, neighbors=hull.neighbors)

    monkeypatch.setattr(spatial, "ConvexHull", careless)
    kept = hull_corners(cells)
    directions = rng.integers(-9, 10, (3000, 3))
    np.testing.assert_array_equal((directions @ kept.T).max(axis=1), (directions @ corners.T).max(axis=1))


def test_planes_near_the_object_count_with_any_length_of_normal(device, rng):
    grid, oracle = shape("blob"), PLANE.oracle(shape("blob"), device)
    q = PLANE.sample(grid, 500, rng)
    q[:, 3:] = object_points(grid, rng, 2000)[:500]
    for power in (-100, 0, 90):
        scaled = q.copy()
        scaled[:, :3] *= np.float32(2.0) ** power
        assert oracle(scaled).all()
