"""Upper bounds of linear functions of a plane's numbers ``(u, a)`` over all planes that meet an object.

A plane passes a point p of the object where ``u . p = u . a`` (in local units), so for any number l ``x . u + y . a``
is at most ``x . u + h_D(y - l u) + h(l u)``, with h and h_D the supports of the object and of the domain. That is
convex in u, so over a patch of directions it is largest at the patch's corners, pushed out to hold the sphere. Branch
and bound over patches; l is one of the n + 1 numbers at which the bound has a kink at the patch's centre, where one of
them is best.
"""

import numpy as np

from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.geometry.direction_patches import DirectionPatches
from warp_bounding.support_functions.base import TOLERANCE, ObjectSupport, RegionSupport, corner_square

__all__ = ["PlaneSupport"]

AT_ONCE = 64  # patches that are split in a step
STEPS = 60  # of splitting, at most


class PlaneSupport(RegionSupport):
    """Planes; see the module.

    Attributes:
        scale: ``(n,)``, that of the domain of points; a plane's normal in local space is u / scale.
    """

    name = "plane"

    def __init__(self, support: ObjectSupport, domain: RegionDomain):
        super().__init__(support, domain)
        self.scale = domain.base.scale.astype(np.float64)
        self.patches = self.direction_patches()
        self.vertices = PlaneVertices(self, self.patches)

    def bound(self, x: np.ndarray, y: np.ndarray) -> float:
        """Bound of ``x . u + y . a``: the highest patches are split until they are near the highest value found."""
        patches, upper, lowest = self.patches, self.vertices.bound(x, y), self.vertices.value(x, y)
        tolerance = TOLERANCE * float(np.abs(x).sum() + np.abs(y) @ self.limit)
        done = -np.inf
        for _ in range(STEPS):
            open_ = upper > max(lowest + tolerance, done)
            done = max(done, float(upper[~open_].max(initial=-np.inf)))
            patches, upper = patches.take(open_), upper[open_]
            if not len(upper) or patches.finest:
                break
            top = np.zeros(len(upper), dtype=bool)
            top[np.argsort(-upper)[:AT_ONCE]] = True
            parts = patches.take(top).split()
            vertices = PlaneVertices(self, parts)
            lowest = max(lowest, vertices.value(x, y))
            patches = patches.take(~top).joined(parts)
            upper = np.concatenate([upper[~top], vertices.bound(x, y)])
        return max(done, float(upper.max(initial=-np.inf)))

    def square(self, matrix: np.ndarray, offset: np.ndarray) -> float:
        n, u = self.ndim, self.patches.vertices(self.slack)
        limit = np.broadcast_to(self.limit, (len(u), n))
        return float(corner_square(-limit, limit, u, matrix[:, n:], matrix[:, :n], offset).max())


class PlaneVertices:
    """What of the bound is the same for every functional: vertices of patches, and supports there."""

    def __init__(self, support, patches: DirectionPatches):
        self.support, self.finest = support, patches.finest
        u = patches.vertices(0.0)[:, ::2]  # on the sphere; factors follow
        inner, outer = 1 - support.slack, patches.outer * (1 + support.slack)
        self.u, self.center = u, patches.centers
        self.local, self.local_center = u / support.scale, patches.centers / support.scale
        self.high, self.low = support.support(self.local), support.support(-self.local)
        self.high_center, self.low_center = (support.support(s * self.local_center) for s in (1, -1))
        self.factors = np.stack([np.full(len(u), inner), outer], axis=1)  # (N, 2)

    def multipliers(self, y: np.ndarray) -> np.ndarray:
        """``(N, n + 1)``, kinks of the bound at the patches' centres: its minimum is at one of them."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            kinks = y / self.local_center
        kinks = np.where(np.abs(kinks) < 1e6, kinks, 0.0)
        return np.concatenate([kinks, np.zeros((len(kinks), 1))], axis=1)

    def value(self, x: np.ndarray, y: np.ndarray) -> float:
        """The largest, over centres, of the least bound there."""
        kinks = self.multipliers(y)
        rest = np.abs(y - kinks[:, :, None] * self.local_center[:, None]) @ self.support.limit
        hull = np.maximum(kinks * self.high_center[:, None], -kinks * self.low_center[:, None])
        return float(((rest + hull).min(axis=1) + self.center @ x).max())

    def bound(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """``(N,)`` upper bounds over the patches."""
        best = np.full(len(self.u), np.inf)
        for kink in self.multipliers(y).T:
            most = np.full(len(self.u), -np.inf)
            hull = np.maximum(kink[:, None] * self.high, -kink[:, None] * self.low)
            along = self.u @ x
            for factor in self.factors.T:
                tilted = (factor * kink)[:, None, None] * self.local
                rest = np.abs(y - tilted) @ self.support.limit
                most = np.maximum(most, (factor[:, None] * (along + hull) + rest).max(axis=1))
            best = np.minimum(best, most)
        return best
