"""The mesh itself, and the grid that is laid around it."""

import numpy as np
import pytest
import trimesh

from warp_bounding.indicators import IndicatorMesh, load_indicator

BOX = trimesh.creation.box(extents=(1, 2, 3))


def test_digest_is_of_the_geometry():
    mesh = load_indicator(BOX)
    assert mesh.digest == load_indicator(BOX.copy()).digest
    assert mesh.digest == IndicatorMesh(mesh.vertices.copy(), mesh.faces.copy(), name="other", note="other").digest
    moved = mesh.vertices.copy()
    moved[3, 1] = np.nextafter(moved[3, 1], np.float32(9))
    assert IndicatorMesh(moved, mesh.faces).digest != mesh.digest
    assert IndicatorMesh(mesh.vertices, mesh.faces[:-1]).digest != mesh.digest


def test_arrays_are_our_own_and_read_only():
    vertices = BOX.vertices.astype(np.float32)
    mesh = IndicatorMesh(vertices, BOX.faces)
    vertices[:] = 0
    assert mesh.bounds[1].tolist() == [0.5, 1, 1.5]
    with pytest.raises(ValueError, match="read-only"):
        mesh.vertices[0] = 0
    with pytest.raises(ValueError, match="read-only"):
        mesh.faces[0] = 0


def test_bounds_ignore_vertices_of_no_face():
    mesh = IndicatorMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [99, 99, 99]], [[0, 1, 2]])
    assert mesh.bounds.tolist() == [[0, 0, 0], [1, 1, 0]]
    assert max(mesh.to_grid(resolution=8).shape) < 13


@pytest.mark.parametrize(
    ("mesh", "watertight"),
    [
        (BOX, True),
        (trimesh.Trimesh(BOX.triangles.reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False), True),
        (trimesh.Trimesh(BOX.vertices, BOX.faces[1:], process=False), False),
        (trimesh.util.concatenate([BOX, BOX]), True),
        (trimesh.creation.torus(1, 0.3), True),
    ],
    ids=["box", "unmerged", "hole", "twice", "torus"],
)
def test_watertight(mesh, watertight):
    assert load_indicator(mesh).watertight is watertight


def test_solids_that_touch_in_an_edge_are_watertight():
    other = BOX.copy()
    other.apply_translation([1, 2, 0])
    assert load_indicator(trimesh.util.concatenate([BOX, other])).watertight


def test_a_collapsed_face_leaves_a_surface_closed():
    faces = np.concatenate([BOX.faces, [[0, 1, 1]]])
    assert IndicatorMesh(BOX.vertices, faces).watertight


@pytest.mark.parametrize("resolution", [2, 3, 10, 64, 100])
@pytest.mark.parametrize("margin", [0.0, 0.01, 2.0])
def test_the_grid_around_a_mesh(resolution, margin):
    mesh = load_indicator(BOX)
    grid = mesh.to_grid(resolution=resolution, margin=margin)
    scale = grid.cells_per_unit
    assert (scale == scale[0]).all()
    mantissa, _ = np.frexp(scale[0])
    assert mantissa * 2**16 == int(mantissa * 2**16)
    asked = resolution / (3 + 2 * margin)
    assert asked * (1 - 2**-15) <= scale[0] <= asked
    assert (grid.offset == np.rint(grid.offset)).all()
    assert resolution + 2 <= max(grid.shape) <= resolution + 4
    assert (grid.margin, grid.resolution, grid.name, grid.note) == (margin, resolution, "trimesh", "")
    assert not grid.time
    # one empty cell on every side, and no more
    for axis in range(3):
        filled = np.flatnonzero(grid.occupancy.any(axis=tuple(k for k in range(3) if k != axis)))
        assert (filled[0], filled[-1]) == (1, grid.shape[axis] - 2)
    assert (grid.lower < mesh.bounds[0] - margin).all()
    assert (grid.upper > mesh.bounds[1] + margin).all()


def test_the_grid_is_the_same_every_time_whatever_the_order_of_faces(rng):
    mesh = load_indicator(trimesh.creation.icosphere(subdivisions=2))
    digest = mesh.to_grid(resolution=20, margin=0.05).digest
    assert (
        load_indicator(trimesh.creation.icosphere(subdivisions=2)).to_grid(resolution=20, margin=0.05).digest == digest
    )
    shuffled = IndicatorMesh(mesh.vertices, rng.permutation(mesh.faces))
    assert shuffled.to_grid(resolution=20, margin=0.05).digest == digest
    assert (
        mesh.to_grid(resolution=np.int64(20), margin=np.float32(0.05)).shape
        == mesh.to_grid(resolution=20, margin=0.05).shape
    )


def test_open_meshes_say_so():
    sheet = IndicatorMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], note="half a quad")
    assert sheet.to_grid(resolution=8).note.startswith("half a quad; surface only: the mesh is open")
