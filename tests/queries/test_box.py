"""The box oracle is the rational twin, box by box, also for boxes without a size."""

import numpy as np
import pytest
from bounding_shapes import object_points, shape
from region_queries import SHAPES, lattice_points, odd_queries, one_cell, sparse_grid

from warp_bounding.errors import QueryError
from warp_bounding.indicators import IndicatorGrid
from warp_bounding.queries import check_query, oracle, sample
from warp_bounding.queries.box import BOX
from warp_bounding.queries.point import POINT


def boxes_of_all_kinds(grid, count, rng):
    plain = BOX.sample(grid, count, rng)
    a, b = lattice_points(grid, count, rng), lattice_points(grid, count, rng)
    b[::3] = a[::3]
    snapped = np.concatenate([np.minimum(a, b), np.maximum(a, b)], axis=1)
    backwards = np.concatenate([a, b], axis=1)
    return np.concatenate(
        [plain, snapped, backwards, odd_queries(grid, plain, rng), odd_queries(grid, snapped, rng)], dtype=np.float32
    )


@pytest.mark.parametrize("name", SHAPES)
def test_oracle_is_the_rational_truth(name, device, rng):
    grid, boxes = shape(name), BOX.oracle(shape(name), device)
    q = boxes_of_all_kinds(grid, 400, rng)
    truth = BOX.truth(grid, q)
    np.testing.assert_array_equal(boxes(q), truth)
    assert boxes.undecided == 0
    assert truth.any()
    assert not truth.all()


def test_rounding_onto_a_face_is_noticed(device):
    """The cell coordinate of a tiny number rounds onto the face at 3/2, but the point is on one side of it."""
    occupancy = np.zeros((4,), dtype=bool)
    for cell in (1, 2):
        occupancy[:] = False
        occupancy[cell] = True
        grid = IndicatorGrid(occupancy, cells_per_unit=[3.0], offset=[-1.5])
        q = np.float32([[x, x] for x in (-1e-30, 0.0, 1e-30)])
        expected = [cell == 1, True, cell == 2]
        np.testing.assert_array_equal(BOX.truth(grid, q), expected)
        np.testing.assert_array_equal(BOX.oracle(grid, device)(q), expected)


@pytest.mark.parametrize("name", ["c", "blob", "mesh", "animated"])
def test_a_box_of_no_size_is_a_point(name, device, rng):
    grid = shape(name)
    x = np.concatenate([object_points(grid, rng, 500), lattice_points(grid, 2000, rng)])
    np.testing.assert_array_equal(
        BOX.oracle(grid, device)(np.concatenate([x, x], axis=1)), POINT.oracle(grid, device)(x)
    )


@pytest.mark.parametrize("cells", [(40, 25, 30), (300,), (200, 5)])
def test_few_cells_in_a_large_grid(cells, device, rng):
    grid = sparse_grid(cells, 4)
    q = boxes_of_all_kinds(grid, 400, rng)
    np.testing.assert_array_equal(BOX.oracle(grid, device)(q), BOX.truth(grid, q))


def test_boxes_touch_and_miss(device):
    boxes = BOX.oracle(one_cell(2), device)
    above, huge = np.nextafter(np.float32(0.625), np.float32(1)), np.float32(3e38)
    q = [
        [0.625, 0.625, 0.9, 0.9],  # corner to corner
        [above, 0.625, 0.9, 0.9],
        [0.1, 0.625, 0.9, 0.7],  # edge to edge
        [0.4, 0.4, 0.5, 0.5],  # inside
        [0.1, 0.1, 0.9, 0.9],  # around
        [-huge, -huge, huge, huge],
        [-huge, 0.7, huge, huge],
        [1.2, 0.5, 2.0, 0.5],  # outside the domain
        [-9, 0.5, 0.375, 0.5],  # partly
        [0.6, 0.5, 0.4, 0.5],  # min > max
        [0.1, 0.1, np.inf, 0.9],
        [np.nan, 0.1, 0.9, 0.9],
    ]
    expected = [True, False, True, True, True, True, False, False, True, False, False, False]
    np.testing.assert_array_equal(boxes(np.float32(q)), expected)


@pytest.mark.parametrize("count", [0, 1, 511, 513])
def test_any_number_of_boxes(count, device, rng):
    grid = shape("c")
    q = BOX.sample(grid, count, rng)
    np.testing.assert_array_equal(BOX.oracle(grid, device)(q), BOX.truth(grid, q))


@pytest.mark.parametrize("q", [np.zeros(6), np.zeros((4, 3)), np.zeros((1, 4, 6))])
def test_oracle_refuses_other_shapes(q):
    with pytest.raises(QueryError, match=r"\(N, 6\)"):
        BOX.oracle(shape("blob"), "cpu")(q)


@pytest.mark.parametrize("name", ["c", "mesh", "anisotropic"])
def test_samples_are_the_papers(name, rng):
    grid = shape(name)
    q = BOX.sample(grid, 20_000, rng)
    lower, upper = q[:, : grid.ndim], q[:, grid.ndim :]
    assert q.dtype == np.float32
    assert (lower <= upper).all()
    frame = grid.sample_upper - grid.sample_lower
    np.testing.assert_allclose(((lower - grid.sample_lower) / frame).mean(axis=0), 0.5, atol=0.01)
    np.testing.assert_allclose(((upper - grid.sample_lower) / frame).mean(axis=0), 0.75, atol=0.01)


@pytest.mark.parametrize("query", ["point", "ray", "plane", "box"])
def test_one_door_for_all_kinds(query, device, rng):
    grid = shape("blob")
    q = sample(query, grid, 1000, rng)
    assert q.shape == (1000, 3 if query == "point" else 6)
    answer = oracle(query, grid, device)(q)
    assert 0 < answer.sum() <= 1000
    assert check_query(query) == query


@pytest.mark.parametrize("door", [lambda g: oracle("cone", g), lambda g: sample("cone", g, 1, None)])
def test_unknown_kinds_are_refused(door):
    with pytest.raises(QueryError, match="point, ray, plane, box, got 'cone'"):
        door(shape("blob"))
