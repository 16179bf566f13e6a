"""The ray oracle is the rational twin, ray by ray, above all where segments only touch."""

import numpy as np
import pytest
from bounding_shapes import object_points, shape
from region_queries import SHAPES, lattice_points, odd_queries, one_cell, small_vectors, sparse_grid

from warp_bounding.errors import QueryError
from warp_bounding.indicators import IndicatorGrid
from warp_bounding.queries.ray import MOST_JUMP, RAY, empty_distance

LOW, HIGH = np.float32(0.375), np.float32(0.625)  # of one_cell


def rays_of_all_kinds(grid, count, rng):
    n, unit = grid.ndim, np.float32(1 / grid.cells_per_unit)
    plain = RAY.sample(grid, count, rng)
    snapped = np.concatenate([lattice_points(grid, count, rng), small_vectors(n, count, rng) * unit], axis=1)
    inside = object_points(grid, rng, 10)[:count]
    away = np.concatenate([inside, small_vectors(n, len(inside), rng)], axis=1)
    mixed = np.concatenate([snapped[:, :n], plain[:, n:] * unit], axis=1)
    return np.concatenate([plain, snapped, away, mixed, odd_queries(grid, plain, rng), odd_queries(grid, snapped, rng)])


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("length", [1.0, 0.3])
def test_oracle_is_the_rational_truth(name, length, device, rng):
    grid = shape(name)
    q = rays_of_all_kinds(grid, 80, rng)
    truth = RAY.truth(grid, q, length)
    np.testing.assert_array_equal(RAY.oracle(grid, device, length)(q), truth)
    assert truth.any()
    assert not truth.all()


@pytest.mark.parametrize("length", [0.7, 1e6])
@pytest.mark.parametrize("cells", [(40, 25, 30), (120, 40), (3, 90), (7, 9, 8, 11)])
def test_jumps_over_empty_space_miss_nothing(cells, length, device, rng):
    grid = sparse_grid(cells, 12)
    q = RAY.sample(grid, 600, rng)
    target = grid.position(grid.occupied[rng.integers(12, size=300)] + rng.uniform(-0.6, 0.6, (300, grid.ndim)))
    q[:300, grid.ndim :] = target - q[:300, : grid.ndim]
    q[300:450, grid.ndim] *= 30  # along the first axis
    truth = RAY.truth(grid, q, length)
    np.testing.assert_array_equal(RAY.oracle(grid, device, length)(q), truth)
    assert 20 < truth.sum() < 580


@pytest.mark.parametrize("occupied", [(60, 90), (0, 0), (119, 3)])
def test_distance_counts_cells_along_the_farthest_axis(occupied):
    occupancy = np.zeros((120, 100), dtype=bool)
    occupancy[occupied] = occupancy[30, 40] = True
    cells = np.stack(np.indices(occupancy.shape), axis=-1)
    exact = np.minimum(*(np.abs(cells - at).max(axis=-1) for at in (occupied, (30, 40))))
    np.testing.assert_array_equal(empty_distance(occupancy), np.minimum(exact, MOST_JUMP))


@pytest.mark.parametrize("d", [(1, 0, 0), (0, 0, -1), (0, 1, 0)])
@pytest.mark.parametrize("side", [LOW, HIGH])
def test_rays_along_faces_and_edges_touch(d, side, device):
    oracle = RAY.oracle(one_cell(), device, 2.0)
    d, across = np.float32(d), np.abs(d) == 0
    start = np.float32(0.5) - d
    for axis in np.flatnonzero(across):
        face = start.copy()
        face[axis] = side
        beside = face.copy()
        beside[axis] = np.nextafter(side, np.float32(side * 4 - 1.5))  # outwards
        np.testing.assert_array_equal(oracle(np.float32([[*face, *d], [*beside, *d]])), [True, False])
    edge = np.where(across, side, start)
    assert oracle(np.float32([[*edge, *d]]))[0]
    assert oracle.undecided == 0


def test_rays_through_edges_and_corners_touch(device):
    oracle = RAY.oracle(one_cell(), device)
    through = [
        [0.125, 0.375, 0.5, 1, -1, 0],  # the edge x = y = 3/8 is behind; passes (3/8, 1/8): misses
        [0.25, 0.5, 0.5, 1, -1, 0],  # the edge at (3/8, 3/8)
        [0.25, 0.5, 0.25, 1, -1, 1],  # the corner (3/8, 3/8, 3/8)
        [0.25, 0.25, 0.25, 1, 1, 1],  # the corner and the inside
        [0.25, 0.5, 0.25, 1, -1, 1.0000002],  # z is over 3/8 at that edge
        [0.25, 0.5, 0.25, 1, -1, 0.9999999],  # z is under 3/8 at that edge
        [0.625, 0.625, 0.625, 1, 2, 3],  # starts at a corner, goes away
        [0.625, 0.5, 0.5, 1, 0, 0],  # starts on a face, goes away
        [np.nextafter(HIGH, np.float32(1)), 0.5, 0.5, 1, 0, 0],
    ]
    expected = [False, True, True, True, True, False, True, True, False]
    q = np.float32(through)
    np.testing.assert_array_equal(RAY.truth(one_cell(), q), expected)
    np.testing.assert_array_equal(oracle(q), expected)


def test_the_end_of_the_segment_is_closed(device):
    grid = one_cell(2)
    q = np.float32([[0.0, 0.5, 1, 0], [0.375 - 0.1875, 0.375 - 0.25, 3e-20, 4e-20], [0.375 - 0.1875, 0.125, 3, 4]])
    lengths = [0.375, 0.3125, 0.3125]
    for ray_, length in zip(q, lengths, strict=True):
        answers = [RAY.oracle(grid, device, v)(ray_[None])[0] for v in (length, np.nextafter(length, 0))]
        exact = [RAY.truth(grid, ray_[None], v)[0] for v in (length, np.nextafter(length, 0))]
        assert answers == exact
    assert RAY.oracle(grid, device, 0.375)(q[:1])[0]
    assert RAY.oracle(grid, device, 0.3125)(q[2:])[0]
    assert not RAY.oracle(grid, device, np.nextafter(0.3125, 0))(q[2:])[0]


@pytest.mark.parametrize("name", ["c", "blob", "mesh"])
def test_a_ray_of_no_length_is_a_point(name, device, rng):
    grid = shape(name)
    x = np.concatenate([object_points(grid, rng, 500), lattice_points(grid, 500, rng)])
    q = np.concatenate([x, small_vectors(grid.ndim, len(x), rng)], axis=1)
    np.testing.assert_array_equal(RAY.oracle(grid, device, 0.0)(q), grid.contains(x))


def test_the_length_of_the_direction_does_not_matter(device, rng):
    grid, oracle = shape("blob"), RAY.oracle(shape("blob"), device)
    q = RAY.sample(grid, 500, rng)
    for power in (-100, -3, 90):
        scaled = q.copy()
        scaled[:, 3:] *= np.float32(2.0) ** power
        np.testing.assert_array_equal(oracle(scaled), oracle(q))


@pytest.mark.parametrize("name", ["c", "star", "mesh"])
def test_the_kernel_decides_nearly_all(name, device, rng):
    grid, oracle = shape(name), RAY.oracle(shape(name), device)
    oracle(RAY.sample(grid, 50_000, rng))
    assert oracle.undecided == 0
    axis = np.eye(grid.ndim, dtype=np.float32)[rng.integers(grid.ndim, size=2000)] * rng.choice([-1, 1], (2000, 1))
    oracle(np.concatenate([lattice_points(grid, 2000, rng), axis], axis=1))
    assert oracle.undecided <= 20  # those whose end is as near to a face as the length is exact


def test_invalid_rays_meet_nothing(device):
    q = np.float32([[0.5, 0.5, 0, 0], [0.5, 0.5, np.nan, 1], [np.inf, 0.5, 1, 0], [0.5, 0.5, np.inf, 1]])
    assert not RAY.oracle(one_cell(2), device)(q).any()


@pytest.mark.parametrize("count", [0, 1, 511, 513])
def test_any_number_of_rays(count, device, rng):
    grid = shape("c")
    q = RAY.sample(grid, count, rng)
    answer = RAY.oracle(grid, device)(q)
    assert answer.dtype == bool
    np.testing.assert_array_equal(answer, RAY.truth(grid, q))


@pytest.mark.parametrize("q", [np.zeros(6), np.zeros((4, 3)), np.zeros((1, 4, 6))])
def test_oracle_refuses_other_shapes(q):
    with pytest.raises(QueryError, match=r"\(N, 6\)"):
        RAY.oracle(shape("blob"), "cpu")(q)


@pytest.mark.parametrize("length", [-1.0, np.nan, np.inf])
def test_oracle_refuses_other_lengths(length):
    with pytest.raises(QueryError, match="length must be"):
        RAY.oracle(shape("blob"), "cpu", length)


@pytest.mark.parametrize("ndim", [1, 2, 3, 4])
def test_samples_are_the_papers(ndim, rng):
    occupancy = np.zeros((4,) * ndim, dtype=bool)
    occupancy.flat[0] = True
    q = RAY.sample(IndicatorGrid(occupancy), 20_000, rng)
    assert q.shape == (20_000, 2 * ndim)
    assert q.dtype == np.float32
    origin, d = q[:, :ndim], q[:, ndim:].astype(np.float64)
    assert ((origin >= 0) & (origin <= 1)).all()
    np.testing.assert_allclose((d * d).sum(axis=1), 1, atol=1e-6)
    if (
        ndim > 1
    ):  # the first angle is uniform, so the first coordinate is an arc sine variable, twice as often for n = 2
        angle = np.arccos(np.clip(d[:, 0], -1, 1)) / np.pi
        np.testing.assert_allclose(np.histogram(angle, 10, (0, 1))[0], 2000, atol=250)
        assert abs((d[:, -1] > 0).mean() - 0.5) < 0.02


def test_kernels_of_several_dimensions_do_not_mix(rng):
    kernels = [RAY.kernel(n) for n in (3, 2, 1)]
    assert len({kernel.key for kernel in kernels}) == 3
