"""A UR5 among meshes, and which of its configurations may collide, by pairs of meshes: a kernel ends at the first pair.

Links move by float64 kinematics, and are placed in float32: ``GAP`` is more than that rounds.
"""

import numpy as np
import trimesh
import warp as wp

import warp_bounding as wb
from sims.arm.meshes import mesh_of
from sims.arm.robots import HELD_WRIST, ROBOTS, robots, ur5
from sims.pile import shapes

GAP = 1e-5  # metres
PLACES = {"bunny": (0.28, (-0.45, -0.35, 0.11)), "ring": (0.45, (-0.35, 0.1, 0.6))}  # metres: size, and where


def solid(mesh: trimesh.Trimesh, name: str) -> wb.shapes.Mesh:
    return wb.shapes.Mesh(mesh.vertices.astype(np.float32), np.asarray(mesh.faces), name=name)


def linked(arm: wb.arms.Arm) -> list[wb.shapes.Mesh]:
    """The meshes whose hulls are the arm's bodies, in the frames of its joints."""
    import yourdfpy

    own = ROBOTS["ur5"]
    urdf = yourdfpy.URDF.load(str(robots() / own.urdf), load_meshes=False)
    urdf.update_cfg({name: HELD_WRIST.get(name, 0.0) for name in urdf.actuated_joint_names})
    frames, found = arm.frames(np.zeros((1, len(arm.free))))[0], []
    parts = [(name, part) for name, link in urdf.link_map.items() for part in link.collisions]
    for body in arm.bodies:
        name, part = next(each for each in parts if each[0] == body.part)
        parts.remove((name, part))
        if part.geometry.mesh is None:
            mesh = trimesh.creation.box(part.geometry.box.size)
        else:
            mesh = trimesh.load(robots() / part.geometry.mesh.filename.split("robots/")[-1], force="mesh")
            mesh.merge_vertices()
        to = urdf.get_transform(name) @ (np.eye(4) if part.origin is None else part.origin)
        mesh.apply_transform(to if body.link < 0 else np.linalg.inv(frames[body.link]) @ to)
        assert np.abs(mesh.bounds - [body.points.min(axis=0), body.points.max(axis=0)]).max() < 1e-4, name
        found.append(solid(mesh, body.name))
    return found


def cell() -> tuple[list[wb.shapes.Mesh], list[wb.arms.Body]]:
    """The obstacles as meshes, and their hulls."""
    table, shelf, back, post = (solid(mesh_of(body), body.name) for body in ur5().obstacles)
    meshes = [table, together([shelf, back]), post]
    for name, (size, place) in PLACES.items():
        own = shapes()[f"pile-{name}"]
        turn = trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0])[:3, :3]
        meshes.append(wb.shapes.Mesh((size * own.vertices @ turn.T + place).astype(np.float32), own.faces, name=name))
    return meshes, [wb.arms.Body.hull(mesh.vertices.astype(float), name=mesh.name) for mesh in meshes]


def together(meshes: list[wb.shapes.Mesh]) -> wb.shapes.Mesh:
    """Meshes as one."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]
    return wb.shapes.Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces), name="united")


@wp.kernel(enable_backward=False)
def poses(
    first: int,
    parents: wp.array(dtype=int),
    origins: wp.array(dtype=wp.transformd),
    axes: wp.array(dtype=wp.vec3d),
    q: wp.array2d(dtype=float),
    out: wp.array2d(dtype=wp.transform),
):
    """Poses of links, of joints that turn, parents first; the last one is the world's."""
    i = first + wp.tid()
    count = parents.shape[0]
    out[i, count] = wp.transform_identity()
    at = wp.transform_identity(dtype=wp.float64)
    for k in range(count):
        at = at * origins[k] * wp.transformd(wp.vec3d(), wp.quat_from_axis_angle(axes[k], wp.float64(q[i, k])))
        x, r = wp.transform_get_translation(at), wp.transform_get_rotation(at)
        turn = wp.quat(float(r[0]), float(r[1]), float(r[2]), float(r[3]))
        out[i, k] = wp.transform(wp.vec3(float(x[0]), float(x[1]), float(x[2])), turn)


class ByPairs:
    """Which configurations may collide: for each pair of bodies, the one with the distance first."""

    def __init__(self, arm: wb.arms.Arm, pairs: list[tuple[wb.pairs.Pair, int, int]]):
        """Pairs, and the links on which the two lie."""
        assert not any(joint.slides for joint in arm.joints)
        assert list(arm.parents) == list(range(-1, len(arm.joints) - 1)), "expected a chain"
        self._kept, self.count = [pair.data for pair, *_ in pairs], len(arm.joints)
        self._data = wp.array(self._kept, dtype=wb.pairs.PairData, device="cpu")
        links = np.array([[a, b] for _, a, b in pairs])
        self._links = wp.array(np.where(links < 0, self.count, links), dtype=wp.vec2i, device="cpu")
        origins = [wp.transform_from_matrix(wp.mat44d(joint.origin)) for joint in arm.joints]
        self._chain = [
            wp.array(np.array(arm.parents), dtype=int, device="cpu"),
            wp.array(origins, dtype=wp.transformd, device="cpu"),
            wp.array([joint.axis for joint in arm.joints], dtype=wp.vec3d, device="cpu"),
        ]
        ask = pairs[0][0].func
        assert all(pair.func is ask for pair, *_ in pairs)

        @wp.kernel(module="unique", enable_backward=False)
        def near(
            first: int,
            data: wp.array(dtype=wb.pairs.PairData),
            links: wp.array(dtype=wp.vec2i),
            x: wp.array2d(dtype=wp.transform),
            maybe: wp.array(dtype=wp.bool),
        ):
            i = first + wp.tid()
            found = wp.bool(False)
            for p in range(data.shape[0]):
                if not found:
                    found = ask(data[p], x[i, links[p][0]], x[i, links[p][1]], float(wp.static(GAP)))
            maybe[i] = found

        self._near = near

    def __call__(self, q: np.ndarray) -> np.ndarray:
        q = wp.array(q, dtype=float, device="cpu")
        x = wp.empty((len(q), self.count + 1), dtype=wp.transform, device="cpu")
        maybe = wp.empty(len(q), dtype=wp.bool, device="cpu")
        wb.launch_on_cores(poses, len(q), [*self._chain, q], [x], "cpu")
        wb.launch_on_cores(self._near, len(q), [self._data, self._links, x], [maybe], "cpu")
        return maybe.numpy()
