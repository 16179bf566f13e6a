"""What the pictures of the demo ``shadows`` show: a bunny and a chair on a floor, a camera, and a sun that moves.

A pixel that shows a surface which faces the sun sends one ray towards it, from ``LIFT`` above the surface. It lies in
shadow if the narrow phase finds that an object stops the ray. With a bounder, the narrow phase is asked about those
pairs of ray and object only which the object's bounder does not deny. The picture must be the same, *pixel for pixel*.
Why it is:

* Both are asked about the same ray: the same six float32 numbers. So the lift need not be covered by anything, nor
  what rounding did when the ray was made. World and object coordinates are the same: there is no placement either.
* A ray counts as stopped only where ``mesh_query_ray`` names a face, a point of it (u, v) and a time t, *and* this
  point, with u and v cut to the face, lies within ``TOLERANCE`` of o + t d. So it is of no account which ray-triangle
  test it is, how it rounds and on which machine, nor how thin the faces are. What is left is the rounding of this
  check: with w = 2^-24, c the largest coordinate of the mesh and t <= LENGTH, the point of the face is off by 7 w c per
  axis, o + t d by w (c + LENGTH), difference and length by 4 w of a distance that is small: under 16 w (c + LENGTH) in
  all. Twice that is allowed for (``Scene.margin``). The check denies no true hit: these are off by 1e-6 or so.
* So a stopped ray passes within ``Scene.margin`` of the mesh at a time 0 <= t <= ``REACH``, in multiples of the length
  of d, which is 1 up to four roundings: before ``LENGTH``, which is longer than ``REACH`` by a thousandth. And the
  bounder is proven for segments of that length, and for the object dilated by that margin.

``LENGTH`` covers every shadow ray to where it has left all objects: it has risen above them by then, since the sun
never stands lower than ``LOWEST``; ``Scene`` checks that.

A bounder without a proof (``occupancy``, or a network whose proof did not end in its time: *statistical*) promises
nothing of this.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import warp as wp

import warp_bounding as wb
from sims.assets import asset_mesh, surface
from sims.shadows.chair import chair
from sims.shadows.kernels import Camera, see_floor, see_mesh

__all__ = [
    "LENGTH",
    "LIFT",
    "REACH",
    "RESOLUTION",
    "SCENES",
    "TOLERANCE",
    "Scene",
    "Seen",
    "look",
    "margin_of",
    "shapes",
]

LENGTH = 3.0  # of the shadow rays that bounders are proven for, world units
REACH = 0.999 * LENGTH  # of the narrow phase
LOWEST = np.deg2rad(38.0)  # the sun's height, where it is least
HIGHEST = np.deg2rad(47.0)
MORNING, EVENING = np.deg2rad(-40.0), np.deg2rad(80.0)  # where the sun stands, from +x towards -z, first and last
LIFT = 1e-3  # of a shadow ray's origin off its surface, world units: so that a surface does not shade itself
TOLERANCE = 1e-4  # world units: how far a ray may pass from a point that it is said to hit
ROUNDING = 32 * 2.0**-24  # of that distance, relative to coordinates and length
RESOLUTION = 48  # cells along the longest side of an object: rays are proven for cells
FARTHEST = 40.0  # that the floor is seen, world units
CREASE = np.cos(np.deg2rad(40.0))  # faces that meet at more than that are not shaded as one surface
SCENES = "shadows-"  # what the files of bounders begin with


@dataclass(frozen=True)
class Seen:
    """What each of W x H pixels shows, row by row from the top, and the place and normals where it is a surface.

    Attributes:
        things: ``(H, W)`` int8: -1 nothing, 0 the floor, k the k-th object.
        depths: ``(H, W)`` float32, distance from the eye.
        smooth: ``(H, W, 3)`` float32, unit normals for shading.
        pixels: ``(N,)`` int32, the pixels that show a surface.
        points: ``(N,)`` vec3, where.
        normals: ``(N,)`` vec3, unit normals of their faces, towards the eye.
    """

    things: np.ndarray
    depths: np.ndarray
    smooth: np.ndarray
    pixels: np.ndarray
    points: wp.array
    normals: wp.array


@dataclass(frozen=True, eq=False)
class Scene:
    """What all pictures share. World and object coordinates are the same, y is up.

    Attributes:
        shapes: The objects by name; each throws shadows on all.
        floor: Height of the floor.
        camera: From where they are seen.
        device: Warp device.

    Raises:
        BoundingError: If a shadow ray may meet an object farther away than ``REACH``.
    """

    shapes: dict[str, wb.shapes.Mesh]
    floor: float
    camera: Camera
    device: wp.Device

    def __post_init__(self) -> None:
        top = max(float(shape.bounds[1, 1]) for shape in self.shapes.values())
        needed = (top + TOLERANCE - self.floor) / np.sin(LOWEST)
        if not needed < REACH:
            raise wb.BoundingError(
                f"shadow rays are followed for {REACH:g}, expected objects that need no more, got {needed:g}"
            )

    @classmethod
    def still_life(cls, width: int = 640, height: int = 480, device: str | None = None) -> "Scene":
        """The bunny that ships in warp-lang, and a chair.

        Args:
            width: Of a picture, pixels.
            height: Of a picture, pixels.
            device: Warp device; the default device if ``None``.

        Raises:
            DeviceError: If there is no such device.
        """
        shapes = objects()
        camera = look((0.9, 2.45, 5.0), (0.5, 0.66, 0.0), 33.0, width, height)
        return cls(shapes, float(shapes["bunny"].bounds[0, 1]), camera, wb.device_of(device))

    def margin(self, name: str) -> float:
        """By what the bounder of an object must dilate it, world units: a hit's tolerance, and its check's rounding."""
        return margin_of(self.shapes[name])

    def suns(self, shares: np.ndarray) -> np.ndarray:
        """Directions towards the sun.

        Args:
            shares: ``(S,)``, times of the day: 0 the first, 1 the last.

        Returns:
            ``(S, 3)`` float32, of length 1, never lower than ``LOWEST``.
        """
        azimuth = MORNING + (EVENING - MORNING) * np.asarray(shares)
        least = 1.001 * LOWEST  # so that rounding to float32 does not bring it under that
        rise = least + (HIGHEST - least) * np.sin(np.pi * np.asarray(shares))
        towards = [np.cos(rise) * np.cos(azimuth), np.sin(rise), -np.cos(rise) * np.sin(azimuth)]
        return np.stack(towards, axis=1).astype(np.float32)

    @cached_property
    def meshes(self) -> dict[str, wp.Mesh]:
        """The narrow phase's meshes."""
        return {name: surface(shape.vertices, shape.faces, self.device) for name, shape in self.shapes.items()}

    @cached_property
    def seen(self) -> Seen:
        """What the camera sees: the same in all pictures, since it stands still."""
        height, width = self.camera.height, self.camera.width
        count, device = height * width, self.device
        depths, things = wp.empty(count, dtype=float, device=device), wp.empty(count, dtype=wp.int8, device=device)
        points, normals, smooth = (wp.zeros(count, dtype=wp.vec3, device=device) for _ in range(3))
        outputs = [depths, things, points, normals, smooth]
        wb.launch_on_cores(see_floor, count, [self.camera, self.floor, FARTHEST], outputs, device)
        for thing, (name, mesh) in enumerate(self.meshes.items(), 1):
            corners = wp.array(corner_normals(self.shapes[name]), dtype=wp.vec3, device=device)
            wb.launch_on_cores(see_mesh, count, [self.camera, mesh.id, thing, corners], outputs, device)
        shown = things.numpy()
        pixels = np.flatnonzero(shown >= 0).astype(np.int32)
        return Seen(
            shown.reshape(height, width).copy(),
            depths.numpy().reshape(height, width).copy(),
            smooth.numpy().reshape(height, width, 3).copy(),
            pixels,
            wp.array(points.numpy()[pixels], dtype=wp.vec3, device=device),
            wp.array(normals.numpy()[pixels], dtype=wp.vec3, device=device),
        )


def objects() -> dict[str, wb.shapes.Mesh]:
    """The objects of the still life, in place."""
    bunny = asset_mesh("bunny")
    floor = float(bunny.bounds[0, 1])
    return {"bunny": bunny, "chair": chair((1.72, floor, 0.3), turn=np.deg2rad(118.0))}


def margin_of(shape: wb.shapes.Mesh) -> float:
    """See ``Scene.margin``."""
    return TOLERANCE + ROUNDING * (float(np.abs(shape.bounds).max()) + LENGTH)


def shapes(device: str = "cpu") -> dict[str, wb.shapes.Mesh]:
    """The objects, dilated, by the name that the files of their bounders begin with."""
    return {SCENES + name: shape.dilated(margin_of(shape)) for name, shape in objects().items()}


def look(eye, at, angle: float, width: int, height: int) -> Camera:
    """A camera at a place that looks at another, upright.

    Args:
        eye: ``(3,)``, world units.
        at: ``(3,)``.
        angle: Of the picture's height, degrees.
        width: Pixels.
        height: Pixels.
    """
    forward = np.subtract(at, eye, dtype=np.float64)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0.0, 1.0, 0.0))
    right /= np.linalg.norm(right)
    half = np.tan(np.deg2rad(angle) / 2)
    camera = Camera()
    camera.eye, camera.forward = wp.vec3(*map(float, eye)), wp.vec3(*forward.tolist())
    camera.right = wp.vec3(*(right * half * width / height).tolist())
    camera.up = wp.vec3(*(np.cross(right, forward) * half).tolist())
    camera.width, camera.height = int(width), int(height)
    return camera


def corner_normals(shape: wb.shapes.Mesh) -> np.ndarray:
    """A normal for each corner of each face: of the faces around its vertex that lie nearly as it does, by their area.

    Returns:
        ``(3 F, 3)`` float32, of length 1.
    """
    corners = shape.vertices.astype(np.float64)[shape.faces]
    weighted = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    unit = weighted / np.maximum(np.linalg.norm(weighted, axis=1, keepdims=True), 1e-30)
    _, merged = np.unique(shape.vertices, axis=0, return_inverse=True)
    vertex = merged.reshape(-1)[shape.faces.reshape(-1)]  # of each corner
    order = np.argsort(vertex, kind="stable")
    face = order // 3
    _, begin, around = np.unique(vertex[order], return_index=True, return_counts=True)
    summed = np.zeros((len(vertex), 3))
    for step in range(int(around.max())):  # each corner and the step-th face around its vertex
        other = face[np.repeat(begin + np.minimum(step, around - 1), around)]
        near = (np.einsum("ij,ij->i", unit[face], unit[other]) > CREASE) & np.repeat(step < around, around)
        summed[order] += np.where(near[:, None], weighted[other], 0.0)
    length = np.linalg.norm(summed, axis=1, keepdims=True)
    return np.where(length > 0, summed / np.maximum(length, 1e-30), np.repeat(unit, 3, axis=0)).astype(np.float32)
