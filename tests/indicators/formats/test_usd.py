"""USD: prims in their places, polygons, orientation; and the bunny that ships with Warp."""

import numpy as np
import pytest

from warp_bounding.indicators import load_indicator

pytest.importorskip("pxr", reason="usd-core is not installed")

QUAD = """
    uniform token subdivisionScheme = "none"
    point3f[] points = [(0,0,0), (1,0,0), (1,1,0), (0,1,0), (2,0,0)]
    int[] faceVertexCounts = [4, 3]
    int[] faceVertexIndices = [0, 1, 2, 3, 1, 4, 2]
"""


def load(tmp_path, text):
    (tmp_path / "a.usda").write_text("#usda 1.0\n" + text)
    return load_indicator(tmp_path / "a.usda")


def test_polygons_become_fans(tmp_path):
    mesh = load(tmp_path, f'def Mesh "m" {{{QUAD}}}')
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [1, 4, 2]]
    assert mesh.note == ""
    assert not mesh.watertight


def test_transforms_of_all_ancestors(tmp_path):
    mesh = load(
        tmp_path,
        f"""def Xform "a" {{
            double3 xformOp:translate = (10, 0, 0)
            uniform token[] xformOpOrder = ["xformOp:translate"]
            def Mesh "m" {{{QUAD}
                double3 xformOp:scale = (2, 3, 4)
                uniform token[] xformOpOrder = ["xformOp:scale"]
            }}
        }}
        def Mesh "n" {{{QUAD}}}""",
    )
    assert mesh.bounds.tolist() == [[0, 0, 0], [14, 3, 0]]
    assert len(mesh.faces) == 6
    assert mesh.faces.max() == 9


@pytest.mark.parametrize("left", [False, True])
@pytest.mark.parametrize("mirror", [False, True])
def test_orientation(tmp_path, left, mirror):
    orientation = 'uniform token orientation = "leftHanded"' if left else ""
    transform = f"""double3 xformOp:scale = ({-1 if mirror else 1}, 1, 1)
                    uniform token[] xformOpOrder = ["xformOp:scale"]"""
    mesh = load(tmp_path, f'def Mesh "m" {{{QUAD}\n{orientation}\n{transform}\n}}')
    a, b, c = mesh.vertices[mesh.faces[0]]
    # A right-handed face looks towards +z, a left-handed one to -z; a mirror changes neither.
    assert np.cross(b - a, c - a)[2] * (-1 if left else 1) > 0


def test_instances_are_read_once_each(tmp_path):
    mesh = load(
        tmp_path,
        f"""class Xform "proto" {{
            def Mesh "m" {{{QUAD}}}
        }}
        def Xform "one" (
            instanceable = true
            inherits = </proto>
        ) {{}}
        def Xform "two" (
            instanceable = true
            inherits = </proto>
        ) {{
            double3 xformOp:translate = (0, 0, 5)
            uniform token[] xformOpOrder = ["xformOp:translate"]
        }}""",
    )
    assert len(mesh.faces) == 6
    assert mesh.bounds[1].tolist() == [2, 1, 5]


def test_what_is_left_out_is_noted(tmp_path):
    mesh = load(tmp_path, f'def Mesh "m" {{{QUAD}}}\ndef Points "c" {{}}')
    assert "/c" in mesh.note


def test_animation_is_noted(tmp_path):
    text = (
        QUAD
        + "point3f[] points.timeSamples = {1: [(0,0,0), (1,0,0), (1,1,0), (0,1,0), (2,0,0)], "
        + ("2: [(9,0,0), (1,0,0), (1,1,0), (0,1,0), (2,0,0)]}")
    )
    mesh = load(tmp_path, f'def Mesh "m" {{{text}\n}}')
    assert "animated" in mesh.note
    assert mesh.bounds[1].tolist() == [2, 1, 0]


def test_usdz(tmp_path):
    from pxr import Sdf, UsdUtils

    (tmp_path / "a.usda").write_text(f'#usda 1.0\ndef Mesh "m" {{{QUAD}}}')
    assert UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(tmp_path / "a.usda")), str(tmp_path / "a.usdz"))
    assert len(load_indicator(tmp_path / "a.usdz").faces) == 3


def test_the_bunny_that_ships_with_warp(bunny_path):
    mesh = load_indicator(bunny_path)
    assert mesh.vertices.shape == (6102, 3)
    assert mesh.faces.shape == (12200, 3)
    assert mesh.watertight
    assert mesh.note == ""
    grid = mesh.to_grid()
    assert grid.resolution == 64
    assert max(grid.shape) in range(65, 69)
    assert grid.note == ""
    # the cells cover the mesh: the volume of the solid, by the divergence theorem, is less than theirs
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    volume = abs(np.linalg.det(corners).sum() / 6)
    cells = grid.occupancy.sum() / np.prod(grid.cells_per_unit)
    assert volume < cells < 1.15 * volume
    assert grid.contains(mesh.vertices).all()
    assert grid.contains(corners.mean(axis=1)).all()
