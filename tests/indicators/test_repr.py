"""A shape in one line, whatever it holds."""

import numpy as np
import pytest
import trimesh

from warp_bounding.indicators import IndicatorGrid, IndicatorMesh, IndicatorMotion, load_indicator

BOX = trimesh.creation.box(extents=(1, 2, 3))
FRAMES = np.stack([BOX.vertices, BOX.vertices + np.array([1, 0, 0])])


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        (
            load_indicator(np.arange(3 * 1000 * 1000).reshape(3, 1000, 1000) % 2 == 0),
            "<IndicatorGrid array: 3D, 3 x 1000 x 1000 cells, 1,500,000 occupied, extent 1.5 x 1.001 x 1.001>",
        ),
        (
            load_indicator(np.arange(16).reshape(2, 2, 2, 2) > 3),
            "<IndicatorGrid array: 4D, 2 x 2 x 2 x 2 cells, 12 occupied, extent 2 x 2 x 2, time first>",
        ),
        (
            load_indicator(BOX).to_grid(resolution=6, margin=0.1),
            "<IndicatorGrid trimesh: 3D, 5 x 7 x 9 cells, 105 occupied, extent 2.667 x 3.733 x 4.8, margin 0.1, resolution 6>",
        ),
        (load_indicator(BOX), "<IndicatorMesh trimesh: 3D, 8 vertices, 12 faces, extent 1 x 2 x 3, closed>"),
        (
            IndicatorMesh(
                BOX.vertices, BOX.faces[1:], name="hole.obj", note="animated: only its first pose is bounded"
            ),
            "<IndicatorMesh hole.obj: 3D, 8 vertices, 11 faces, extent 1 x 2 x 3, animated: only its first pose is bounded; "
            "surface only: the mesh is open, so just the surface and the margin around it are bounded, and what lies deeper inside "
            "counts as outside>",
        ),
        (
            IndicatorMotion(FRAMES, BOX.faces),
            "<IndicatorMotion motion: 4D, 2 keyframes of 8 vertices, 12 faces, extent 2 x 2 x 3, times 0 to 1 in 32 cells, closed>",
        ),
    ],
    ids=["grid", "time", "voxelised", "closed", "open", "motion"],
)
def test_repr(shape, expected):
    assert repr(shape) == str(shape) == expected


def test_the_note_of_a_grid_is_told():
    assert "surface only" in repr(IndicatorMesh(BOX.vertices, BOX.faces[1:]).to_grid(resolution=4))
    assert isinstance(IndicatorMesh(BOX.vertices, BOX.faces).to_grid(resolution=4), IndicatorGrid)
