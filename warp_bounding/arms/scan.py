"""Obstacles that are far from convex: meshes, points and height fields as they are, and fields of proven distances."""

from dataclasses import dataclass, field, replace

import numpy as np

from warp_bounding.arms.arm import LARGEST, checked_pose
from warp_bounding.errors import ShapeError
from warp_bounding.rigid import matmul, moved
from warp_bounding.runtime.arrays import Picklable
from warp_bounding.shapes.mesh import Mesh

FITTING = 1e-5  # of a box: by how much the last nodes of a field may miss its end, as float32 tells their spacing


@dataclass(frozen=True, eq=False)
class Scan(Picklable):
    """Triangles or points, and all within a radius of them; an obstacle of ``Motions``, whose tree finds what is near.

    Where the triangles are those of a mesh with closed parts, their inside counts, too.

    Attributes:
        corners: ``(K, P, 3)`` float64, in the scan's frame: of K points (P = 1) or triangles (P = 3).
        radius: Metres.
        pose: ``(4, 4)``, of the scan's frame.
        name: For people.
        solid: The mesh whose inside counts, in the scan's frame; ``None`` for a surface or points.

    Raises:
        ShapeError: For corners or a radius that are none.

    Example:
        >>> floor = wb.arms.Scan.of_heights(np.zeros((3, 3)), [-1, -1], [1, 1], name="floor")
        >>> len(floor.corners), len(wb.arms.Scan.of_points(np.zeros((100, 3)), 0.01).corners)
        (8, 100)
    """

    corners: np.ndarray
    radius: float = 0.0
    pose: np.ndarray = field(default_factory=lambda: np.eye(4))
    name: str = "scan"
    solid: Mesh | None = None

    def __post_init__(self):
        corners, pose = np.array(self.corners, dtype=np.float64), checked_pose(self.pose, self.name)
        if corners.ndim != 3 or corners.shape[1] not in (1, 3) or corners.shape[2] != 3 or not len(corners):
            raise ShapeError(f"{self.name}: expected points (K, 1, 3) or triangles (K, 3, 3), got {corners.shape}")
        if not (np.abs(corners) <= LARGEST).all() or not 0 <= float(self.radius) <= LARGEST:
            raise ShapeError(f"{self.name}: expected finite numbers up to {LARGEST:g}, and a radius from 0")
        for name, value in (("corners", corners), ("pose", pose)):
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        object.__setattr__(self, "radius", float(self.radius))

    @classmethod
    def of_mesh(cls, mesh: Mesh, *, pose=None, name: str | None = None) -> "Scan":
        """All triangles of a mesh, as ``load_shape`` reads one, with its margin; closed parts have an inside."""
        if not isinstance(mesh, Mesh):
            raise ShapeError(f"expected a Mesh, as load_shape reads one, got {type(mesh).__name__}")
        corners, solid = mesh.vertices.astype(np.float64)[mesh.faces], mesh if mesh.surface.closed.any() else None
        return cls(corners, mesh.margin, np.eye(4) if pose is None else pose, name or mesh.name, solid)

    @classmethod
    def of_points(cls, points: np.ndarray, radius: float, *, pose=None, name: str = "points") -> "Scan":
        """Points ``(K, 3)``, such as a depth camera's, and all within a radius of them, metres."""
        points = np.asarray(points, dtype=np.float64)
        return cls(points[..., None, :], radius, np.eye(4) if pose is None else pose, name)

    @classmethod
    def of_heights(cls, heights: np.ndarray, lower, upper, *, pose=None, name: str = "heights") -> "Scan":
        """The surface over a grid of heights ``(X, Y)``, metres, between two corners ``(2,)``; two triangles a cell.

        What lies wholly beneath it is not told apart from what lies above.
        """
        z = np.asarray(heights, dtype=np.float64)
        if z.ndim != 2 or min(z.shape) < 2:
            raise ShapeError(f"{name}: expected heights (X, Y), at least 2 each way, got {z.shape}")
        axes = [np.linspace(low, high, count) for low, high, count in zip(lower, upper, z.shape, strict=True)]
        grid = np.stack([*np.meshgrid(*axes, indexing="ij"), z], axis=-1)
        a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[:-1, 1:], grid[1:, 1:]
        corners = np.stack([np.stack([a, b, d], axis=2), np.stack([a, d, c], axis=2)]).reshape(-1, 3, 3)
        return cls(corners, 0.0, np.eye(4) if pose is None else pose, name)

    @property
    def placed(self) -> np.ndarray:
        """``(K, P, 3)`` corners in the world."""
        return moved(self.corners.reshape(-1, 3), self.pose).reshape(self.corners.shape)

    @property
    def numbers(self) -> np.ndarray:
        """All that a digest needs to know."""
        return np.append(self.corners, [*self.pose.ravel(), self.radius, self.solid is not None])

    def moved(self, pose) -> "Scan":
        """This scan at a pose ``(4, 4)``; itself for ``None``."""
        return self if pose is None else replace(self, pose=matmul(checked_pose(pose, self.name), self.pose))

    def holds(self, points: np.ndarray) -> np.ndarray:
        """Which points ``(N, 3)`` of the world lie inside of closed parts, or so near to these that one cannot tell."""
        if self.solid is None or not len(points):
            return np.zeros(len(points), dtype=bool)
        return self.solid.contains(matmul(points - self.pose[:3, 3], self.pose[:3, :3]))


@dataclass(frozen=True, eq=False)
class DistanceField(Picklable):
    """Distances from an object at the nodes of a grid, proven; an obstacle of ``Motions`` of few bytes.

    The object lies in the grid's box, and in that box what is linear along each axis between nodes is nowhere more than
    the distance. ``DistanceGrid.field`` makes one. Balls hold the bodies of an arm, and are clear where the distance
    at the centre exceeds the radius.

    Attributes:
        values: ``(X, Y, Z)`` float64, metres, at least two along each axis.
        center: ``(3,)`` float64, of the box, in the field's frame.
        half: ``(3,)`` float64, half the sides of the box.
        spacing: ``(3,)`` float64, between nodes; the first ones lie in the box's lower corner, the last ones in the
            upper one or a little outside.
        pose: ``(4, 4)``, of the field's frame.
        name: For people.

    Raises:
        ShapeError: For numbers that are none.

    Example:
        >>> field = wb.fit(mesh, "distance", "distance-grid", nodes=12, device="cpu").field(name="rock")
        >>> field.values.ndim, field.name
        (3, 'rock')
    """

    values: np.ndarray
    center: np.ndarray
    half: np.ndarray
    spacing: np.ndarray
    pose: np.ndarray = field(default_factory=lambda: np.eye(4))
    name: str = "field"

    def __post_init__(self):
        for name in ("values", "center", "half", "spacing"):
            value = np.array(getattr(self, name), dtype=np.float64)
            three = value.shape == (3,) if name != "values" else value.ndim == 3 and min(value.shape) > 1
            if not three or not (np.abs(value) <= LARGEST).all():
                raise ShapeError(f"{self.name}: expected {name} of finite numbers up to {LARGEST:g}, got {value.shape}")
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        reached = self.spacing * (np.array(self.values.shape) - 1)
        if not (self.spacing > 0).all() or not (np.abs(reached - 2 * self.half) <= FITTING * self.half).all():
            raise ShapeError(f"{self.name}: expected nodes all over the box, got {reached} of {2 * self.half}")
        pose = checked_pose(self.pose, self.name)
        pose.setflags(write=False)
        object.__setattr__(self, "pose", pose)

    @property
    def lanes(self) -> np.ndarray:
        """As ``native/motions.h`` reads it."""
        return np.concatenate([self.half, 1 / self.spacing, self.values.shape, self.values.ravel()])

    @property
    def numbers(self) -> np.ndarray:
        """All that a digest needs to know."""
        return np.concatenate([self.lanes, self.center, self.spacing, self.pose.ravel()])

    def moved(self, pose) -> "DistanceField":
        """This field at a pose ``(4, 4)``; itself for ``None``."""
        return self if pose is None else replace(self, pose=matmul(checked_pose(pose, self.name), self.pose))
