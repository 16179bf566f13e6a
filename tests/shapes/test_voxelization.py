"""Voxelisation is conservative, with no tolerance at all, and tight."""

from itertools import product

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from warp_bounding.shapes import Mesh, load_shape
from warp_bounding.shapes.triangles.cells import surface_cells


def turned(mesh):
    """No face along an axis, no vertex on a round number."""
    mesh.apply_transform(trimesh.transformations.rotation_matrix(1.1, [1, 2, 3], [0.1, 0.2, 0.3]))
    return mesh


def open_box():
    box = trimesh.creation.box(extents=(1, 1, 1))
    return trimesh.Trimesh(box.vertices, box.faces[2:], process=False)


SHAPES = {
    "icosphere": lambda: trimesh.creation.icosphere(subdivisions=3),
    "box": lambda: trimesh.creation.box(extents=(1, 2, 0.5)),
    "turned box": lambda: turned(trimesh.creation.box(extents=(1, 2, 0.5))),
    "torus": lambda: trimesh.creation.torus(1, 0.3),
    "thin plate": lambda: turned(trimesh.creation.box(extents=(1, 1, 1e-4))),
    "open box": open_box,
    "turned open box": lambda: turned(open_box()),
    "needle": lambda: trimesh.Trimesh([[0, 0, 0], [1, 2, 3], [1, 2, 3.00001]], [[0, 1, 2]], process=False),
    "two spheres in one": lambda: trimesh.util.concatenate(
        [trimesh.creation.icosphere(subdivisions=2), trimesh.creation.icosphere(subdivisions=2, radius=0.8)]
    ),
}


def surface_points(mesh, rng, count):
    """Dense samples of every triangle, in its inside, on its edges and at its corners: float32 rounded and not."""
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    weights = rng.dirichlet(np.ones(3), size=(len(corners), count))
    weights[:, :3] = np.eye(3)
    weights[:, 3:6] = [[0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0, 0.5]]
    weights[:, 6 : 6 + count // 4, 0] = 0
    weights /= weights.sum(axis=-1, keepdims=True)
    return np.einsum("fkc,fcx->fkx", weights, corners).reshape(-1, 3)


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize(("resolution", "margin"), [(24, 0.0), (3, 0.11), (24, 0.11)])
def test_every_point_of_the_dilated_object_lies_in_an_occupied_cell(rng, name, resolution, margin):
    mesh = load_shape(SHAPES[name]())
    grid = mesh.to_grid(resolution=resolution, margin=margin)
    points = surface_points(mesh, rng, max(40, 20_000 // len(mesh.faces)))
    # Samples are rounded to float64, so they may lie off the triangle, by less than the slack of the cells.
    assert grid.contains(points).all()
    if margin:
        direction = rng.normal(size=points.shape)
        direction[::3] = rng.choice([-1.0, 0.0, 1.0], size=direction[::3].shape)  # along axes and diagonals
        length = np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-9)
        distance = margin * np.where(rng.random(len(points)) < 0.5, 1, rng.random(len(points)))[:, None]
        assert grid.contains(points + direction / length * distance).all()


def lattice_of(triangle, steps):
    """Points of a triangle, corners included; every other point of it is within its longest edge / steps of one."""
    i, j = (a.ravel() for a in np.mgrid[: steps + 1, : steps + 1])
    weights = np.stack([i, j, steps - i - j], axis=1)[i + j <= steps] / steps
    return weights @ triangle


@settings(deadline=None, max_examples=40)
@given(
    seed=st.integers(0, 2**32 - 1),
    margin=st.sampled_from([0.0, 0.01, 0.7, 2.5]),
    round_to=st.sampled_from([None, 1, 2]),
)
def test_cells_of_one_triangle_against_brute_force(seed, margin, round_to):
    """Neither too few nor too many, also for corners on faces of cells and for triangles that are a line or a point."""
    triangle = 5 + np.random.default_rng(seed).uniform(-2, 2, (3, 3))
    if round_to:
        triangle = np.round(triangle * round_to) / round_to
    steps = 40
    shape = (11, 11, 11)
    occupied = surface_cells(triangle, np.array([[0, 1, 2]]), shape, margin).reshape(-1)
    cells = np.indices(shape).reshape(3, -1).T
    distance = np.full(len(cells), np.inf)
    for point in lattice_of(triangle, steps):  # upper bounds of the distance between cell and triangle
        gap = np.maximum(np.abs(cells - point) - 0.5, 0)
        distance = np.minimum(distance, np.sqrt((gap**2).sum(axis=1)))
    spacing = np.linalg.norm(triangle - np.roll(triangle, 1, axis=0), axis=1).max() / steps
    assert occupied[distance <= margin].all()
    assert (distance[occupied] <= margin + spacing + 1e-6).all()


def test_slack_outweighs_rounding(rng):
    """An edge through the corner of cells touches all eight, exactly; in float64, only the slack can tell."""
    for _ in range(200):
        corner = np.full(3, 4.5)
        along = (rng.uniform(-1, 1, 3).astype(np.float32) / np.float32(3)).astype(np.float64)
        start, end = corner - 3 * along, corner + rng.integers(1, 8) * along  # exact: 24 bits and small factors
        triangle = np.array([start, end, rng.uniform(0, 9, 3)])
        occupied = surface_cells(triangle, np.array([[0, 1, 2]]), (10, 10, 10), 0.0)
        assert occupied[4:6, 4:6, 4:6].all()


@settings(deadline=None, max_examples=8)
@given(scale=st.floats(-20, 20), shift=st.floats(-60, 60), resolution=st.integers(2, 40), margin=st.floats(0, 1))
def test_any_size_and_place(scale, shift, resolution, margin):
    """Sizes from a millionth to a million, up to 60 sizes away from the origin: farther off, float32 is too coarse and
    the mesh refused."""
    size = 2.0**scale
    solid = trimesh.creation.icosphere(subdivisions=1, radius=size)
    mesh = Mesh(solid.vertices + shift * size, solid.faces)
    grid = mesh.to_grid(resolution=resolution, margin=margin * size)
    assert grid.contains(mesh.vertices).all()
    for axis, sign in product(range(3), [-1, 1]):
        reach = mesh.vertices[np.argmax(sign * mesh.vertices[:, axis])].astype(np.float64)
        reach[axis] += sign * margin * size
        assert grid.contains(reach[None])[0]
