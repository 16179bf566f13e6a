"""Rounded hulls: what the links of an arm and the things around it are made of.

A body is the convex hull of a few points and everything within a radius of it: a point with a radius is a ball, two are a capsule,
eight without a radius are a box. One test tells all of them apart from each other (``separation``).
"""

from dataclasses import dataclass, replace

import numpy as np

from warp_bounding.errors import IndicatorError
from warp_bounding.runtime.pickling import Picklable

__all__ = ["MOST_POINTS", "WORLD", "Body", "ball_of", "checked_pose"]

WORLD = -1  # the link that does not move
MOST_POINTS = 512  # of a body
LARGEST = 1e6  # metres: a coordinate or radius


@dataclass(frozen=True, eq=False)
class Body(Picklable):
    """The convex hull of points, and all within a radius of it.

    Attributes:
        points: ``(P, 3)`` float64, at most ``MOST_POINTS``; metres, in the frame of the link.
        radius: Metres.
        link: Number of the joint that moves it last, from 0; ``WORLD`` where none does.
        name: For people.

    Raises:
        IndicatorError: For points or a radius that are none.

    Example:
        >>> forearm = wb.arms.Body.capsule([0, 0, 0], [0.4, 0, 0], 0.05, link=1)
        >>> table = wb.arms.Body.box([-1, -1, -0.1], [1, 1, 0])
        >>> len(forearm.points), len(table.points), table.link == wb.arms.WORLD
        (2, 8, True)
    """

    points: np.ndarray
    radius: float = 0.0
    link: int = WORLD
    name: str = "body"

    def __post_init__(self):
        points = np.array(self.points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1:] != (3,) or not 1 <= len(points) <= MOST_POINTS:
            raise IndicatorError(f"{self.name}: expected 1 to {MOST_POINTS} points of 3 numbers, got {points.shape}")
        if not (np.abs(points) <= LARGEST).all():
            raise IndicatorError(f"{self.name}: expected points of finite numbers up to {LARGEST:g}")
        radius = float(self.radius)
        if not 0 <= radius <= LARGEST:
            raise IndicatorError(f"{self.name}: expected a radius from 0 to {LARGEST:g}, got {self.radius!r}")
        points.setflags(write=False)
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "radius", radius)

    @classmethod
    def sphere(cls, center, radius: float, *, link: int = WORLD, name: str = "sphere") -> "Body":
        """All points within a radius of a centre ``(3,)``."""
        return cls([center], radius, link, name)

    @classmethod
    def capsule(cls, start, end, radius: float, *, link: int = WORLD, name: str = "capsule") -> "Body":
        """All points within a radius of a segment, given by its ends ``(3,)``."""
        return cls([start, end], radius, link, name)

    @classmethod
    def box(cls, lower, upper, *, pose=None, radius: float = 0.0, link: int = WORLD, name: str = "box") -> "Body":
        """A box between two corners ``(3,)``, rounded by a radius, at a ``(4, 4)`` pose."""
        corners = np.array([lower, upper], dtype=np.float64)
        if corners.shape != (2, 3) or not (corners[0] <= corners[1]).all():
            raise IndicatorError(
                f"{name}: expected two corners of 3 numbers, the lower one first, got {lower} and {upper}"
            )
        index = np.indices((2, 2, 2)).reshape(3, -1).T
        return cls(corners[index, np.arange(3)], radius, link, name).moved(pose)

    def moved(self, pose) -> "Body":
        """This body at a pose ``(4, 4)``; itself for ``None``."""
        if pose is None:
            return self
        pose = checked_pose(pose, self.name)
        return replace(self, points=self.points @ pose[:3, :3].T + pose[:3, 3])

    def grown(self, radius: float) -> "Body":
        """This body and all within a further radius of it."""
        return replace(self, radius=self.radius + radius)


def ball_of(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre ``(3,)`` and radius of a ball that holds points ``(P, 3)``, up to rounding."""
    center = (points.min(axis=0) + points.max(axis=0)) / 2
    return center, float(np.linalg.norm(points - center, axis=1).max())


RIGID = 1e-6  # by how much a pose's rotation may miss being one; files give six digits or so


def checked_pose(pose, name: str) -> np.ndarray:
    """A rigid motion ``(4, 4)``, its rotation made exactly one, up to float64.

    Raises:
        IndicatorError: If it is none.
    """
    pose = np.array(pose, dtype=np.float64)
    if pose.shape != (4, 4) or not np.isfinite(pose).all() or not (pose[3] == [0, 0, 0, 1]).all():
        raise IndicatorError(f"{name}: expected a pose of shape (4, 4) with the last row 0 0 0 1, got {pose.tolist()}")
    u, _, v = np.linalg.svd(pose[:3, :3])
    rotation = u @ v
    if np.abs(rotation - pose[:3, :3]).max() > RIGID or np.linalg.det(rotation) < 0:
        raise IndicatorError(f"{name}: expected a rotation without a scale or a mirror, got {pose[:3, :3].tolist()}")
    pose[:3, :3] = rotation
    return pose
