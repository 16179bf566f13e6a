"""How far an object reaches in a direction, and what is asked of a kind of region in parametric space.

The bounds of regions hold but for the float64 rounding of their own sums, which ``ParametricSupport`` adds.
"""

from abc import ABC, abstractmethod

import numpy as np

from warp_bounding.arithmetic import UNIT64, gamma
from warp_bounding.coordinates.base import direction_rounding
from warp_bounding.coordinates.domain import Domain
from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.geometry.direction_patches import DirectionPatches
from warp_bounding.geometry.farthest_point import farthest
from warp_bounding.geometry.hull import Hull, hull_of
from warp_bounding.indicators.shape import Shape
from warp_bounding.queries.boundary import outline

__all__ = ["CHUNK", "TOLERANCE", "ObjectSupport", "RegionSupport", "corner_square"]

TOLERANCE = 2e-3  # relative to the functional's size: a patch whose bound is this near to a value in reach is not split
CHUNK = 1 << 22  # float64 numbers in an intermediate array: 32 MiB
PATCHES = {1: 1, 2: 16, 3: 8, 4: 6}  # of directions, along an edge of a cube's face, by n
PATCHES_BEYOND = 3  # the same in more dimensions, where their number grows with the power n - 1


class ObjectSupport:
    """The support of an object widened by ``delta``, from above; of a shape without a known hull that of its outline.

    Args:
        grid: The object.
        base: Its domain of points.
        hull: A convex set that holds it; ``hull_of(grid)`` if ``None``, which is found once and has few points.

    Attributes:
        points: ``(C, n)`` float64, local space: every vertex of the object's hull, and some more.
        ball: ``(n,)``, local units: half axes of the ellipsoid by which the points' hull is dilated.
        delta: ``(n,)``, the object is widened by this on every axis.
        certified: Whether the hull is known, so that all that is said of the support holds.
    """

    def __init__(self, grid: Shape, base: Domain, hull: Hull | None = None):
        hull = hull or hull_of(grid)
        self.certified = hull is not None
        hull = hull or Hull(outline(grid), 0.0)
        lower, upper = base.widened(hull.points, hull.points)
        self.points, self.delta = (lower + upper) / 2, base.delta * (1 + 1e-6) + 1e-14
        self.ball = hull.radius * base.scale.astype(np.float64) * (np.arange(base.ndim) >= int(grid.time))

    def __call__(self, m: np.ndarray) -> np.ndarray:
        """``h(m)`` of vectors ``(..., n)``, in local space; the rounding of this evaluation is included."""
        flat = m.reshape(-1, m.shape[-1])
        best = np.empty(len(flat))
        size = max(1, CHUNK // len(self.points))
        for start in range(0, len(flat), size):
            best[start : start + size] = (flat[start : start + size] @ self.points.T).max(axis=1)
        largest = np.abs(flat) @ (np.abs(self.points).max(axis=0) + self.ball + self.delta)
        best += np.linalg.norm(flat * self.ball, axis=1) + np.abs(flat) @ self.delta
        best += gamma(2 * flat.shape[1] + 8, UNIT64) * largest
        return best.reshape(m.shape[:-1])

    def square(self, matrix: np.ndarray, offset: np.ndarray) -> float:
        """Upper bound of ``|A p + b|^2`` over the widened object, A ``(r, n)`` and b ``(r,)``, rounding included."""
        most = farthest(self.points @ matrix.T + offset, matrix * self.ball)
        most += np.linalg.norm(np.abs(matrix) @ self.delta)
        reach = np.abs(matrix) @ (np.abs(self.points).max(axis=0) + self.ball + self.delta) + np.abs(offset)
        return float((most + gamma(8 * len(self.delta) + 64, UNIT64) * reach.sum()) ** 2 * (1 + 1e-12))


class RegionSupport(ABC):
    """Upper bounds over all regions of a kind that meet an object.

    Args:
        support: Of the object.
        domain: Of the kind of region, in parametric space.

    Attributes:
        limit: ``(n,)``, half-widths of the domain.
        slack: The computed unit directions have lengths within this of 1.
    """

    name: str

    def __init__(self, support: ObjectSupport, domain: RegionDomain):
        self.support, self.ndim = support, domain.base.ndim
        self.limit, self.slack = domain.base.limit.astype(np.float64), 2 * direction_rounding(self.ndim)

    def linear(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """``(K,)`` bounds of ``x . first + y . second`` over the halves of a region's numbers, x and y ``(K, n)``."""
        return np.array([self.bound(*z) for z in zip(x, y, strict=True)])

    def bound(self, x: np.ndarray, y: np.ndarray) -> float:
        """Bound of ``x . first + y . second`` for one x and y ``(n,)``."""
        raise NotImplementedError(self.name)

    @abstractmethod
    def square(self, matrix: np.ndarray, offset: np.ndarray) -> float:
        """Bound of ``|A v + b|^2``."""

    def direction_patches(self) -> DirectionPatches:
        """Patches of directions over which ``square`` looks at corners, and searches of planes begin."""
        return DirectionPatches.cover(self.ndim, PATCHES.get(self.ndim, PATCHES_BEYOND))


def corner_square(lower, upper, directions, on_box, on_direction, offset) -> np.ndarray:
    """``(N,)``: the largest ``|on_box y + on_direction d + offset|^2`` of y in box i and d in patch i of directions.

    A convex function is largest at corners: of the N boxes, and of the patches, whose vertices are ``directions``
    ``(N, V, n)``.
    """
    most = np.zeros(len(lower))
    moved = directions @ on_direction.T + offset
    for corner in np.ndindex((2,) * lower.shape[1]):
        y = (np.where(corner, upper, lower) @ on_box.T)[:, None] + moved
        most = np.maximum(most, (y * y).sum(axis=2).max(axis=1))
    return most
