"""Scenes of MoveIt: obstacles from its ``.scene`` text and from the YAML of its planning scenes.

Boxes, spheres, cylinders and meshes are read, the latter as convex hulls, and cones as the cylinders around them.
Names, colours, subframes, matrices, and states of robots with what is attached to them place nothing. What fills space
and is not read (planes, octomaps) is refused.
"""

from collections.abc import Iterator, Mapping

import numpy as np

from warp_bounding.arms.arm import Body, Cylinder
from warp_bounding.arms.urdf import naming
from warp_bounding.errors import ShapeError
from warp_bounding.rigid import lengths, matmul, moved
from warp_bounding.runtime.whole_file import file_path
from warp_bounding.shapes.formats.reading import import_optional, reading

SIZES = {"box": 3, "sphere": 1, "cylinder": 2, "cone": 2}  # of a shape, how many numbers
KINDS = ("", "box", "sphere", "cylinder", "cone")  # as messages of ROS number them


def load_scene(path) -> list[Body | Cylinder]:
    r"""The obstacles of a scene of MoveIt, in the frame of the scene.

    Args:
        path: A ``.scene`` file, of either form that MoveIt writes, or ``.yaml`` or ``.yml``, a planning scene.

    Raises:
        ShapeError: For a file that cannot be read, numbers that are none, or a shape of another kind.

    Example:
        >>> from pathlib import Path
        >>> can = "cell\n* can\n1\ncylinder\n0.03 0.12\n0.5 0 0.1\n0 0 0 1\n0 0 0 0\n.\n"
        >>> _ = Path("cell.scene").write_text(can)
        >>> [(body.name, body.radius) for body in wb.arms.load_scene("cell.scene")]
        [('can', 0.03)]
    """
    path = file_path(path)
    with reading(path, "a scene of MoveIt"), naming(path):
        text = path.read_text(encoding="utf-8-sig")
        if path.suffix.lower() == ".scene":
            return list(_of_text(text))
        return list(_of_message(import_optional("yaml", "pyyaml", path).safe_load(text)))


def _of_text(text: str) -> Iterator[Body | Cylinder]:
    """Obstacles of ``.scene`` text; objects have poses and subframes where a line of one follows the first name."""
    lines = [line.strip() for line in text.split("\n")[1:]]
    if "." not in lines:
        raise ShapeError("expected a scene that ends with a line of one point, got a part of one")
    lines = lines[: lines.index(".")]
    starts = [i for i, line in enumerate(lines) if line.startswith("*")]
    posed = bool(starts) and len(lines[starts[0] + 1].split()) > 1
    for start, end in zip(starts, [*starts[1:], len(lines)], strict=True):
        name, words = lines[start][1:].strip(), iter(" ".join(lines[start + 1 : end]).split())

        def numbers(count: int, words=words) -> np.ndarray:
            return np.array([float(next(words, "nan")) for _ in range(count)])

        at = _pose(numbers(3), numbers(4), name) if posed else np.eye(4)
        for _ in range(int(numbers(1)[0])):
            kind, corners = next(words, "nothing"), None
            if kind == "mesh":
                vertices, triangles = numbers(2).astype(int)
                corners, _ = numbers(3 * vertices).reshape(-1, 3), numbers(3 * triangles)
            sizes = numbers(SIZES.get(kind, 0))
            sizes = sizes[::-1] if kind in ("cylinder", "cone") else sizes  # radius and length, as messages have not
            yield _obstacle(kind, sizes, corners, matmul(at, _pose(numbers(3), numbers(4), name)), name)
            numbers(4)
        for _ in range(int(numbers(1)[0]) if posed else 0):
            numbers(7 * bool(next(words)))
        if (more := next(words, None)) is not None:
            raise ShapeError(f"{name}: expected as many shapes as it says, got {more} after them")


def _of_message(scene: Mapping) -> Iterator[Body | Cylinder]:
    """Obstacles of a planning scene, or of its world."""
    world = scene.get("world", scene)
    if (world.get("octomap") or {}).get("octomap", {}).get("data"):
        raise ShapeError("expected boxes, spheres, cylinders, cones and meshes, got an octomap")
    frames = {(each.get("header") or {}).get("frame_id", "") for each in world["collision_objects"]}
    if len(frames) > 1:
        raise ShapeError(f"expected all objects in one frame, got {', '.join(sorted(map(repr, frames)))}")
    for each in world["collision_objects"]:
        name, at = str(each.get("id", "object")), _posed(each.get("pose"), each.get("id"))
        if each.get("planes"):
            raise ShapeError(f"{name}: expected boxes, spheres, cylinders, cones and meshes, got a plane")
        for shapes, poses in (("primitives", "primitive_poses"), ("meshes", "mesh_poses")):
            for shape, pose in zip(each.get(shapes) or (), each.get(poses) or (), strict=True):
                pose = matmul(at, _posed(pose, name))
                if shapes == "meshes":
                    yield _obstacle("mesh", (), np.array([_three(x) for x in shape["vertices"]]), pose, name)
                else:
                    kind = KINDS[shape["type"]] if isinstance(shape["type"], int) else shape["type"].lower()
                    yield _obstacle(kind, np.array(shape["dimensions"], dtype=float), None, pose, name)


def _three(x) -> list[float]:
    return [float(x[axis]) for axis in "xyzw" if axis in x] if isinstance(x, Mapping) else [float(each) for each in x]


def _posed(pose: Mapping | None, name: str) -> np.ndarray:
    if not pose:
        return np.eye(4)
    return _pose(np.array(_three(pose["position"])), np.array(_three(pose["orientation"])), name)


def _pose(place: np.ndarray, turn: np.ndarray, name: str) -> np.ndarray:
    """``(4, 4)`` of a place ``(3,)`` and a quaternion x, y, z, w, of any length but 0."""
    length = lengths(turn)
    if place.shape != (3,) or turn.shape != (4,) or not np.isfinite([*place, *turn]).all() or not length:
        raise ShapeError(
            f"{name}: expected a place of 3 finite numbers and a quaternion that is not 0, got {place} and {turn}"
        )
    (x, y, z, w), pose = turn / length, np.eye(4)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    pose[:3, :3] += 2 * (w * cross + matmul(cross, cross))
    pose[:3, 3] = place
    return pose


def _obstacle(kind: str, sizes, corners: np.ndarray | None, pose: np.ndarray, name: str) -> Body | Cylinder:
    """An obstacle of a shape; sizes as messages have them: a cylinder's length comes first."""
    if kind == "mesh":
        return Body.hull(moved(corners, pose), name=name)
    if kind not in SIZES or len(sizes) != SIZES[kind] or not (np.isfinite(sizes) & (sizes >= 0)).all():
        known = ", ".join(f"{each} with {count} sizes from 0" for each, count in SIZES.items())
        raise ShapeError(f"{name}: expected {known} or mesh, got {kind} with {list(map(float, sizes))}")
    if kind == "box":
        return Body.box(-sizes / 2, sizes / 2, pose=pose, name=name)
    if kind == "sphere":
        return Body.sphere(pose[:3, 3], sizes[0], name=name)
    return Cylinder(sizes[1], sizes[0], pose, name)
