import numpy as np
import pytest

from sims.shadows.chair import HEIGHT, chair, tube
from sims.shadows.scene import corner_normals, objects


def volume(vertices, faces):
    a, b, c = np.asarray(vertices, dtype=np.float64)[faces].transpose(1, 0, 2)
    return np.einsum("ij,ij->", a, np.cross(b, c)) / 6


def test_a_tube_is_closed_and_faces_outwards():
    import warp_bounding as wb

    path = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 2.0, 0.1]])
    vertices, faces = tube(path, np.array([0.5, 0.5, 0.5]), sides=24)
    assert wb.IndicatorMesh(vertices, faces).watertight
    assert volume(vertices, faces) == pytest.approx(np.pi * 0.25 * 2.0, rel=0.05)


def test_the_chair_is_closed_and_stands_on_the_floor():
    mesh = chair((1.0, 0.5, -2.0), turn=0.7)
    assert mesh.watertight
    assert mesh.bounds[0, 1] == pytest.approx(0.5, abs=0.01)
    assert mesh.bounds[1, 1] - 0.5 == pytest.approx(HEIGHT, abs=0.02)
    assert volume(mesh.vertices, mesh.faces) > 0
    assert np.allclose(mesh.bounds.mean(axis=0)[[0, 2]], (1.0, -2.0), atol=0.15)
    assert len(np.unique(np.rint(mesh.vertices * 2**14) - mesh.vertices * 2**14)) == 1  # no vertex between the grains


def test_the_chair_is_the_same_each_time():
    assert chair().digest == chair().digest


@pytest.mark.parametrize("name", ["bunny", "chair"])
def test_normals_of_corners_lie_near_their_faces(name):
    mesh = objects()[name]
    corners = mesh.vertices.astype(np.float64)[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1)
    smooth = corner_normals(mesh).reshape(-1, 3, 3)
    assert np.allclose(np.linalg.norm(smooth, axis=2), 1.0, atol=1e-5)
    cosines = np.einsum("ij,ikj->ik", normals / area[:, None], smooth)
    assert cosines.min() > 0.5
