"""Pieces of a mesh that is far from convex hold all of it, and less around it."""

import numpy as np
import pytest
import trimesh
from scipy.optimize import linprog

import warp_bounding as wb
from warp_bounding.arms.pieces import hulls_of

RING = trimesh.creation.annulus(0.9, 1.0, 0.5, sections=32)
MESHES = {
    "angle": trimesh.util.concatenate(
        [
            trimesh.creation.box(bounds=[[0, 0, 0], [1, 0.2, 0.1]]),
            trimesh.creation.box(bounds=[[0, 0, 0], [0.1, 0.2, 1]]),
        ]
    ),
    "fork": trimesh.util.concatenate(
        [trimesh.creation.box(bounds=[[x, 0, 0], [x + 0.2, 0.2, 1]]) for x in (0, 0.9)]
        + [trimesh.creation.box(bounds=[[0, 0, -0.2], [1.1, 0.2, 0]])]
    ),
    "half a ring": RING.submesh([RING.triangles_center[:, 0] > 0], append=True),
}


def blocks(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices and faces of a solid of cubes, and the middles of these."""
    rng, solid = np.random.default_rng(seed), np.zeros((10, 10, 10), dtype=bool)
    solid[3:7, 3:7, 3:7] = True
    for _ in range(4):
        axis, low = rng.integers(3), rng.integers(1, 6, 3)
        high = low + rng.integers(2, 5, 3)
        low[axis], high[axis] = 1, 9
        solid[tuple(map(slice, low, high))] = True
    corners = []
    for axis, side in np.ndindex(3, 2):
        open_ = np.argwhere(solid & ~np.roll(solid, 1 - 2 * side, axis)) + side * np.eye(3, dtype=int)[axis]
        a, b = np.delete(np.eye(3, dtype=int), axis, axis=0)
        corners += [np.stack([open_, open_ + a, open_ + a + b], axis=1), np.stack([open_, open_ + b, open_ + a + b], 1)]
    vertices, faces = np.unique(np.concatenate(corners).reshape(-1, 3), axis=0, return_inverse=True)
    return vertices.astype(float), faces.reshape(-1, 3), np.argwhere(solid) + 0.5


def held(body: wb.arms.Body, x: np.ndarray) -> bool:
    """Whether a point is in a body's hull."""
    p = body.points
    options = {"A_eq": np.vstack([p.T, np.ones(len(p))]), "b_eq": np.append(x, 1.0), "bounds": (0, None)}
    return linprog(np.zeros(len(p)), **options).status == 0


@pytest.mark.parametrize("name", MESHES)
def test_pieces_hold_the_mesh(name, rng):
    mesh = MESHES[name]
    bodies = hulls_of(np.asarray(mesh.vertices), np.asarray(mesh.faces), 8, name=name, link=2)
    assert 1 < len(bodies) <= 8
    assert {(body.link, body.name) for body in bodies} == {(2, name)}
    corners = mesh.triangles[rng.integers(len(mesh.faces), size=150)]
    eighths = np.sort(rng.integers(9, size=(150, 2)), axis=1)
    shares = np.diff(eighths, axis=1, prepend=0, append=8) / 8
    points = np.concatenate([(shares[:, :, None] * corners).sum(axis=1), mesh.vertices[:50]])
    assert all(any(held(body, x) for body in bodies) for x in points)
    volumes = [trimesh.PointCloud(body.points).convex_hull.volume for body in bodies]
    assert sum(volumes) < 0.75 * mesh.convex_hull.volume


def test_convex_and_flat_meshes_stay_whole():
    ball = trimesh.creation.icosphere(2)
    assert len(hulls_of(np.asarray(ball.vertices), np.asarray(ball.faces), 8)) == 1
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    assert len(hulls_of(flat, np.array([[0, 1, 2], [0, 2, 3]]), 8)) == 1


@pytest.mark.parametrize("seed", [22, 30, 31])
def test_pieces_hold_what_a_mesh_encloses(seed, rng):
    vertices, faces, middles = blocks(seed)
    bodies = hulls_of(vertices, faces, 12)
    assert len(bodies) > 1
    assert all(any(held(body, x) for body in bodies) for x in middles)
