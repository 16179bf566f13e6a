"""An arm and its surroundings as triangle meshes, as robot makers publish them, for Coal and Pinocchio.

These need ``pip install 'warp-bounding[arms]'``.
"""

from collections.abc import Sequence

import numpy as np
import trimesh

import warp_bounding as wb

__all__ = ["MeshModel", "mesh_of"]

SUBDIVISIONS = 3  # of the ball that rounds a body: 1,280 triangles
SHRUNK = 1 - 2.0**-30  # more than float64 rounds: meshes lie inside the bodies


def mesh_of(body: wb.arms.Body | wb.arms.Cylinder) -> trimesh.Trimesh:
    """A mesh inside a body, its corners on the body's surface: the hull of a triangulated ball around each point."""
    if isinstance(body, wb.arms.Cylinder):
        return trimesh.creation.cylinder(radius=body.radius * SHRUNK, height=body.length, transform=body.pose)
    if body.radius == 0:
        return trimesh.PointCloud(body.points).convex_hull
    ball = trimesh.creation.icosphere(subdivisions=SUBDIVISIONS, radius=body.radius * SHRUNK).vertices
    return trimesh.PointCloud((body.points[:, None] + ball).reshape(-1, 3)).convex_hull


class MeshModel:
    """A Pinocchio model of an arm, with a Coal mesh of each body.

    Args:
        shape: The arm, its obstacles, and which pairs of them are checked.
        meshes: Of the arm's bodies, then of the obstacles, in the frames of the bodies; made of these if ``None``.

    Attributes:
        triangles: How many there are.

    Raises:
        BoundingError: If Coal or Pinocchio is not installed.
    """

    def __init__(self, shape: wb.arms.ArmConfigurations, meshes: Sequence[trimesh.Trimesh] | None = None):
        try:
            import coal
            import pinocchio as pin
        except ImportError as error:
            raise wb.BoundingError(f"checks of meshes need {error.name}: pip install 'warp-bounding[arms]'") from error
        self._pin, self.triangles = pin, 0
        self.model, self.geometry, numbers = pin.Model(), pin.GeometryModel(), [0]
        for joint in shape.arm.joints:
            kind = pin.JointModelPrismaticUnaligned if joint.slides else pin.JointModelRevoluteUnaligned
            numbers.append(self.model.addJoint(numbers[-1], kind(joint.axis), pin.SE3(joint.origin), joint.name))
        for i, body in enumerate((*shape.arm.bodies, *shape.obstacles)):
            mesh = mesh_of(body) if meshes is None else meshes[i]
            self.triangles += len(mesh.faces)
            geometry = pin.GeometryObject(
                f"{i}: {body.name}", numbers[body.link + 1], pin.SE3.Identity(), _hierarchy(mesh, coal)
            )
            self.geometry.addGeometryObject(geometry)
        for one, other in shape.pairs:
            self.geometry.addCollisionPair(pin.CollisionPair(int(one), int(other)))
        self._data, self._found = self.model.createData(), pin.GeometryData(self.geometry)

    def hits(self, q: np.ndarray) -> np.ndarray:
        """Which joint values ``(N, n)`` float64 collide: ``(N,)`` bool; one after another, on one core."""
        ask = self._pin.computeCollisions
        model, data, geometry, found = self.model, self._data, self.geometry, self._found
        return np.fromiter((ask(model, data, geometry, found, row, True) for row in q), dtype=bool, count=len(q))


def _hierarchy(mesh: trimesh.Trimesh, coal):
    """Coal's hierarchy of oriented boxes over a mesh."""
    found, corners, faces = coal.BVHModelOBBRSS(), coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    corners.extend([np.array(corner) for corner in mesh.vertices])
    faces.extend([coal.Triangle(*map(int, face)) for face in mesh.faces])
    found.beginModel(len(faces), len(corners))
    found.addSubModel(corners, faces)
    found.endModel()
    return found
