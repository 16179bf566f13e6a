"""Bounds of distances hold in rational arithmetic, from both sides, and are a few roundings apart."""

from fractions import Fraction

import numpy as np
import pytest
from bounding_shapes import shape
from distances import squared_distance_to_cells
from exact_mesh import in_tetrahedron, squared_distance

import warp_bounding as wb

TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0.1], [0, 1.2, 0], [0.2, 0, 0.7]], np.float32)
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
SLIVER = np.array([[0, 0, 0], [1, 1e-6, 0], [2, 0, 0], [0.3, 0.2, 1]], np.float32)


def square(x: float) -> Fraction:
    return Fraction(float(x)) ** 2


@pytest.mark.parametrize(("corners", "offset"), [(TETRAHEDRON, 0.0), (TETRAHEDRON, 1000.0), (SLIVER, 0.0)])
def test_mesh(corners, offset, rng):
    corners = (corners + np.float32(offset)).astype(np.float32)
    mesh = wb.IndicatorMesh(corners, FACES)
    x = corners[rng.integers(4, size=60)] + rng.normal(size=(60, 3)) * np.exp2(rng.uniform(-30, 4, (60, 1)))
    x = np.concatenate([x, corners.astype(np.float64), corners[FACES].mean(axis=1).astype(np.float64)])
    bounds = mesh.distances(x)
    assert (bounds[:, 0] <= bounds[:, 1]).all()
    assert (mesh.distance(x) == bounds[:, 0]).all()
    for point, (low, high) in zip(x, bounds, strict=True):
        truth = Fraction(0) if in_tetrahedron(corners, point) else squared_distance(corners, FACES, point)
        assert square(low) <= truth
        assert truth <= square(high)
    near = 2.0**-44 * (np.abs(x).max() + 1)
    known = bounds[:, 0] > 0
    assert (bounds[known, 1] - bounds[known, 0] <= near).all()


def test_a_margin_is_taken_off(rng):
    mesh = wb.IndicatorMesh(TETRAHEDRON, FACES)
    x = rng.uniform(-1, 2, (2000, 3))
    bounds, dilated = mesh.distances(x), mesh.dilated(0.25).distances(x)
    assert (dilated[:, 0] <= np.maximum(bounds[:, 1] - 0.25, 0)).all()
    assert (dilated[:, 1] >= np.maximum(bounds[:, 0] - 0.25, 0)).all()
    assert (dilated[:, 1] - dilated[:, 0] < 1e-12).all()


def test_an_open_mesh_has_no_inside(rng):
    mesh = wb.IndicatorMesh(TETRAHEDRON, FACES[:3])
    x = np.array([[0.3, 0.3, 0.2]])
    low, high = mesh.distances(x)[0]
    assert 0 < low <= high
    assert square(low) <= squared_distance(TETRAHEDRON, FACES[:3], x[0]) <= square(high)


def test_no_numbers():
    mesh = wb.IndicatorMesh(TETRAHEDRON, FACES)
    bounds = mesh.distances(np.array([[np.nan, 0, 0], [np.inf, 0, 0], [0, 0, 1e250], [0, -np.inf, np.nan]]))
    assert (bounds[[0, 3]] == [0, np.inf]).all()
    assert bounds[2, 0] > 1e249
    assert np.isinf(bounds[:, 1]).all()
    grid = shape("blob").distances(np.array([[np.nan, 0, 0], [np.inf, 0, 0]]))
    assert (grid == [0, np.inf]).all()


@pytest.mark.parametrize("name", ["line", "c", "blob", "anisotropic", "mesh", "five", "single"])
def test_grid(name, rng):
    grid = shape(name)
    size = grid.upper - grid.lower
    x = rng.uniform(grid.lower - size, grid.upper + size, (30, grid.ndim))
    x = np.concatenate([x, grid.position(grid.occupied[:10] - 0.5)])
    for point, (low, high) in zip(x, grid.distances(x), strict=True):
        truth = squared_distance_to_cells(grid, point)
        assert square(low) <= truth <= square(high)
        assert high - low <= 2.0**-40 * (np.abs(point).max() + 1 + high)


def test_animated_grids_at_a_time(rng):
    grid = shape("animated")
    x = rng.uniform(-0.5, 1.5, (60, 4))
    for point, (low, high) in zip(x, grid.distances(x), strict=True):
        if not grid.lower[0] <= point[0] <= grid.upper[0]:
            assert (low, high) == (0, np.inf)
            continue
        cells = grid.occupied
        there = np.abs(grid.cell_coordinate(point[None])[0, 0] - cells[:, 0]) <= 0.5
        still = np.zeros(grid.shape[1:], bool)
        still[tuple(cells[there][:, 1:].T)] = True
        then = wb.IndicatorGrid(still, cells_per_unit=grid.cells_per_unit[1:], offset=grid.offset[1:])
        assert square(low) <= squared_distance_to_cells(then, point[1:]) <= square(high)


def test_motions_at_a_time(rng):
    """As the mesh that the motion is then, but for the rounding of its vertices."""
    frames = np.stack([TETRAHEDRON, TETRAHEDRON + np.float32(0.5), TETRAHEDRON * np.float32(2)])
    motion = wb.IndicatorMotion(frames, FACES, times=[0.0, 1.0, 3.0], margin=0.05)
    for time in (0.0, 0.3, 1.0, 2.5, 3.0):
        x = np.column_stack([np.full(1000, time), rng.uniform(-2, 4, (1000, 3))])
        bounds = motion.distances(x)
        still = wb.IndicatorMesh(motion.vertices_at(time), FACES, margin=0.05).distances(x[:, 1:])
        assert (bounds[:, 0] <= bounds[:, 1]).all()
        assert (bounds[:, 0] <= still[:, 1] + 1e-6).all()  # the mesh then is rounded to float32
        assert (bounds[:, 1] >= still[:, 0] - 1e-6).all()
        assert (bounds[:, 1] - bounds[:, 0] < 1e-5).mean() > 0.99
    outside = motion.distances(np.array([[-1.0, 0, 0, 0], [4.0, 0, 0, 0], [np.nan, 0, 0, 0], [1.0, np.inf, 0, 0]]))
    assert (outside == [0, np.inf]).all()
    assert (motion.distance(x) == motion.distances(x)[:, 0]).all()


def test_solids_and_functions(rng):
    ball = wb.solids.Sphere([0, 0], 1.0)
    x = rng.uniform(-2, 2, (500, 2))
    bounds, truth = ball.distances(x), np.maximum(np.linalg.norm(x, axis=1) - 1, 0)
    assert (bounds[:, 0] <= truth + 1e-15).all()
    assert (bounds[truth == 0, 1] == 0).all()
    assert np.isinf(bounds[truth > 0, 1]).all()
    assert wb.IndicatorFunction(lambda x: x[:, 0] < 0, [-1], [1]).distances(np.zeros((1, 1))) is None
