"""Surfaces of tests and of cells: where they are, closed, and turned outwards."""

import numpy as np
import pytest
from bounding_shapes import shape

from warp_bounding.views.view import HALVINGS, Section, Surface, cell_surface, level_surface, object_surface

pytest.importorskip("pyvista")


def volume(surface: Surface) -> float:
    """The enclosed volume, positive where the surface is turned outwards."""
    a, b, c = (surface.vertices[surface.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def closed(surface: Surface) -> bool:
    """Whether each edge is passed as often one way as the other."""
    edges = np.concatenate([surface.faces[:, [0, 1]], surface.faces[:, [1, 2]], surface.faces[:, [2, 0]]])
    count = len(surface.vertices)
    forth, back = edges[:, 0] * count + edges[:, 1], edges[:, 1] * count + edges[:, 0]
    return bool((np.sort(forth) == np.sort(back)).all())


def test_vertices_lie_where_the_answer_changes():
    centre, radius, cells = np.array([0.1, -0.2, 0.3]), 0.7, 24
    lower, upper = np.full(3, -1.0), np.array([1.0, 1.0, 1.5])
    found = level_surface(lambda x: np.linalg.norm(x - centre, axis=1) < radius, lower, upper, cells)
    edge = (upper - lower).max() / cells
    away = np.abs(np.linalg.norm(found.vertices - centre, axis=1) - radius)
    assert away.max() < edge / 2**HALVINGS  # a vertex is in the middle of the last half
    assert closed(found)
    ball = 4 / 3 * np.pi * radius**3
    assert 0.98 * ball < volume(found) < ball


def test_a_surface_is_closed_where_the_box_ends():
    found = level_surface(lambda x: x[:, 0] < 0.25, np.zeros(3), np.ones(3), 8)
    assert closed(found)
    assert volume(found) == pytest.approx(0.25, rel=1e-3)
    np.testing.assert_allclose(found.vertices[:, 1:].min(axis=0), 0.0)
    np.testing.assert_allclose(found.vertices[:, 1:].max(axis=0), 1.0)


def test_nothing_has_no_surface():
    found = level_surface(lambda x: np.zeros(len(x), bool), np.zeros(3), np.ones(3), 4)
    assert len(found.faces) == 0


def test_cells_are_enclosed_with_every_face_turned_outwards():
    occupied = np.random.default_rng(0).random((4, 3, 5)) < 0.4
    edges = [np.linspace(0, 1, 5), np.linspace(-1, 2, 4), np.linspace(0, 10, 6)]
    found = cell_surface(occupied, edges)
    assert closed(found)
    assert volume(found) == pytest.approx(occupied.sum() * 0.25 * 1 * 2)
    for axis in range(3):  # the squares at right angles to an axis enclose the volume by themselves
        a, b, c = (found.vertices[found.faces[:, k]] for k in range(3))
        flux = np.cross(b - a, c - a)[:, axis] / 2 * a[:, axis]
        assert flux.sum() == pytest.approx(volume(found))


def test_cells_of_a_grid_lie_where_the_grid_has_them():
    grid = shape("star")
    found = object_surface(grid, Section(3, {}), 8)
    low, high = grid.occupied.min(axis=0) - 0.5, grid.occupied.max(axis=0) + 0.5
    np.testing.assert_allclose(found.vertices.min(axis=0), grid.position(low))
    np.testing.assert_allclose(found.vertices.max(axis=0), grid.position(high))
    assert volume(found) == pytest.approx(len(grid.occupied) / np.prod(grid.cells_per_unit))


def test_cells_at_a_time_are_those_of_the_nearest_frame():
    grid = shape("animated")
    for frame in range(grid.shape[0]):
        time = float(grid.position(np.full((1, 4), float(frame)))[0, 0])
        found = object_surface(grid, Section(4, {0: time}, True), 8)
        cells = grid.occupancy[frame].sum()
        assert volume(found) == pytest.approx(cells / np.prod(grid.cells_per_unit[1:]))
