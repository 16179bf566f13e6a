"""Scenes of MoveIt: what fills space is read as it stands, in both formats, and nothing else counts."""

import numpy as np
import pytest

import warp_bounding as wb
from warp_bounding.errors import ShapeError

TURN = "0 0 0.7071067811865476 0.7071067811865476"  # by a quarter about z
OLD = f"""cell of mine
* a shelf
2
box
1.0 0.5 0.02
0 0 1
{TURN}
0.1 0.2 0.3 1
sphere
0.1
1 2 3
0 0 0 1
0 0 0 0
* can
1
cylinder
0.03 0.12
0.5 0 0
0 0 0 1
0 0 0 0
* wedge
1
mesh
4 2
0 0 0
1 0 0
0 1 0
0 0 1
0 1 2
0 2 3
0 0 1
0 0 0 1
0 0 0 0
.
"""
NEW = OLD
for NAME in ("a shelf", "can", "wedge"):
    NEW = NEW.replace(f"* {NAME}\n", f"* {NAME}\n0 0 0.5\n{TURN}\n")
NEW = (
    NEW.replace("* can", "1\ntop\n0 0 1\n0 0 0 1\n* can").replace("* wedge", "0\n* wedge").replace("\n.\n", "\n0\n.\n")
)
YAML = """
robot_model_name: any
allowed_collision_matrix: {entry_values: [[false]]}
world:
  collision_objects:
    - id: a shelf
      primitives: [{type: box, dimensions: [1.0, 0.5, 0.02]}, {type: 2, dimensions: [0.1]}]
      primitive_poses:
        - {position: [0, 0, 1], orientation: [0, 0, 0.7071067811865476, 0.7071067811865476]}
        - {position: {x: 1, y: 2, z: 3}, orientation: {x: 0, y: 0, z: 0, w: 1}}
    - id: can
      primitives: [{type: cylinder, dimensions: [0.12, 0.03]}]
      primitive_poses: [{position: [0.5, 0, 0], orientation: [0, 0, 0, 1]}]
    - id: wedge
      meshes: [{vertices: [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], triangles: []}]
      mesh_poses: [{position: [0, 0, 1], orientation: [0, 0, 0, 1]}]
"""


def load(folder, name, text):
    (folder / name).write_text(text)
    return wb.arms.load_scene(folder / name)


@pytest.mark.parametrize(("name", "text"), [("a.scene", OLD), ("b.scene", NEW), ("c.yaml", YAML)])
def test_a_scene_in_all_forms(tmp_path, name, text):
    shelf, ball, can, wedge = load(tmp_path, name, text)
    whole = np.eye(4)
    if text is NEW:
        whole[:3, :3], whole[2, 3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]], 0.5
    assert [each.name for each in (shelf, ball, can, wedge)] == ["a shelf", "a shelf", "can", "wedge"]
    turned = wb.arms.Body.box([-0.25, -0.5, 0.99], [0.25, 0.5, 1.01]).moved(whole)
    np.testing.assert_allclose(sorted(shelf.points.round(9).tolist()), sorted(turned.points.round(9).tolist()))
    np.testing.assert_allclose(ball.points[0], whole[:3, :3] @ [1, 2, 3] + whole[:3, 3], atol=1e-12)
    assert (ball.radius, can.radius, can.length) == (0.1, 0.03, 0.12)
    np.testing.assert_allclose(can.pose[:3, 3], whole[:3, :3] @ [0.5, 0, 0] + whole[:3, 3], atol=1e-12)
    assert len(wedge.points) == 4
    assert abs(wedge.points[:, 2].min() - 1 - whole[2, 3]) < 1e-12


BAD = [
    ("cylinder\n0.03 0.12", "cylinder\n0.03 x", "'x'"),
    ("cylinder\n0.03 0.12", "cylinder\n0.03 -1", "can: expected box with 3 sizes"),
    ("cylinder\n0.03 0.12", "plane\n0 0 1 0", "got plane"),
    ("0.5 0 0\n0 0 0 1", "0.5 0 0\n0 0 0 0", "quaternion that is not 0"),
    ("0 0 1\n0 0 0 1\n0 0 0 0\n.\n", "0 0\n.\n", "wedge: expected a place"),
    ("\n.\n", "\n", "ends with a line of one point"),
    ("* can\n1", "* can\n0", "as many shapes as it says"),
]


@pytest.mark.parametrize(("old", "new", "words"), BAD)
def test_bad_numbers_are_one_clear_error(tmp_path, old, new, words):
    with pytest.raises(ShapeError, match=words) as error:
        load(tmp_path, "a.scene", OLD.replace(old, new))
    assert "\n" not in str(error.value)


FRAMES = "collision_objects: [{header: {frame_id: a}}, {header: {frame_id: b}}]"


@pytest.mark.parametrize("text", ["- 1", "a: b", "world: {octomap: {octomap: {data: [1]}}}", "{", "", FRAMES])
def test_yaml_that_is_no_scene(tmp_path, text):
    with pytest.raises(ShapeError, match=r"a.yaml|octomap"):
        load(tmp_path, "a.yaml", text)
