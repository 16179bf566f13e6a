"""How far the positive regions of an object reach in the space of their own numbers, proven from above.

In parametric space a ray is the point ``v = (a, w)`` of R^2n, a plane ``(u, a)``, a box ``(low, high)`` (``regions``), and P is
the set of all v that the pipeline can make of a region that meets the object S, rounding included. A volume around P needs
``max g . v`` over P for its faces, and ``max |A v + b|^2`` for its radius. With h(m) the support of S widened by ``delta``,
h_D that of the domain:

* box: ``low_k`` and ``high_k`` only have to leave a point p of S between them, so the maximum over P is linear in p:
  ``g = (x, y)`` gives ``h(x+ - y-) + (x- + y+) . limit``, exactly.
* ray, plane: duality, and branch and bound over directions (``parametric_rays``, ``parametric_planes``).

Every number is a bound, whatever a search finds: a bad search costs tightness, never soundness. Squared lengths are convex, so they are
largest at corners of what holds P; these bounds are coarser.
"""

from functools import cached_property

import numpy as np

from warp_bounding.arithmetic import UNIT64, gamma
from warp_bounding.coordinates.base import direction_rounding
from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.errors import BounderError
from warp_bounding.geometry.direction_patches import DirectionPatches
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.support_functions.object import ObjectSupport
from warp_bounding.support_functions.plane import PlaneSupport
from warp_bounding.support_functions.ray import RaySupport

__all__ = ["ParametricSupport"]

CHUNK = 1 << 22  # numbers of an intermediate array
PATCHES = {1: 1, 2: 16, 3: 8, 4: 6}  # of directions, per edge of a cube's face, for squared lengths


class ParametricSupport:
    """Certified maxima over P of linear functions and of squared lengths.

    Args:
        grid: The object.
        domain: Of a kind of region, ``space="parametric"``.

    Attributes:
        object_support: ``h``, see ``ObjectSupport``.
        limit: ``(n,)``, half-widths of D.
        stretch: ``(n,)``, w is this times a unit vector, or the plane's normal in local space is u over this.
        slack: A direction's length is within this of 1.
    """

    def __init__(self, grid: IndicatorGrid, domain: RegionDomain):
        if domain.query == "point" or domain.space != "parametric":
            raise BounderError(f"expected regions in parametric space, got {domain.query}, {domain.space}")
        base = domain.base
        self.domain, self.query, self.ndim = domain, domain.query, base.ndim
        self.object_support = ObjectSupport(grid, base)
        self.points, self.delta = self.object_support.points, self.object_support.delta
        self.limit = base.limit.astype(np.float64)
        self.stretch = (domain.stretch if domain.query == "ray" else base.scale).astype(np.float64)
        self.slack = 2 * direction_rounding(self.ndim)
        search = {"ray": RaySupport, "plane": PlaneSupport}.get(self.query)
        self._search = search and search(self.object_support, self.limit, self.stretch, self.slack)

    @cached_property
    def reach(self) -> np.ndarray:
        """``(2 n,)``, largest ``|v|`` on P, roughly."""
        return self.domain.limit.astype(np.float64)

    # --- linear functions --------------------------------------------------------------------------------------------

    def __call__(self, functionals: np.ndarray) -> np.ndarray:
        """Upper bounds of ``g . v`` over P.

        Args:
            functionals: ``(K, 2 n)`` float64.

        Returns:
            ``(K,)`` float64, rounding of this evaluation included.
        """
        g = np.asarray(functionals, dtype=np.float64)
        x, y = g[:, : self.ndim], g[:, self.ndim :]
        value = (
            self._box(x, y)
            if self.query == "box"
            else np.array([self._search.bound(*z) for z in zip(x, y, strict=True)])
        )
        plain = np.abs(g) @ self.reach  # P lies inside this box
        if not (np.isfinite(value) & np.isfinite(plain)).all():
            raise BounderError("numbers are so large that a support cannot be bounded")
        return np.minimum(value, plain) + gamma(256, UNIT64) * (1 + np.abs(value) + plain)

    def _box(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        rise, fall = np.maximum(x, 0), np.maximum(-y, 0)  # of low upwards, of high downwards
        free = np.maximum(-x, 0) + np.maximum(y, 0)
        # low <= p + delta and p - delta <= high
        return (
            self.object_support(rise - fall)
            - np.abs(rise - fall) @ self.delta
            + (rise + fall) @ self.delta
            + free @ self.limit
        )

    # --- squared lengths ---------------------------------------------------------------------------------------------

    def square(self, matrix: np.ndarray, offset: np.ndarray) -> float:
        """Upper bound of ``|A v + b|^2`` over P: a convex function, so largest at corners of what holds P.

        Args:
            matrix: ``(r, 2 n)`` float64, A.
            offset: ``(r,)`` float64, b.
        """
        most = {"box": self._box_square, "ray": self._ray_square, "plane": self._plane_square}[self.query](
            matrix, offset
        )
        size = float((np.abs(matrix) @ self.reach + np.abs(offset)) @ (np.abs(matrix) @ self.reach + np.abs(offset)))
        return most + gamma(256, UNIT64) * (1 + size)

    def _box_square(self, matrix: np.ndarray, offset: np.ndarray) -> float:
        n, most = self.ndim, 0.0
        for choice in np.ndindex((2,) * (2 * n)):
            near = np.array(choice, dtype=bool)
            low = np.where(near[:n], self.points + self.delta, -self.limit)
            high = np.where(near[n:], self.points - self.delta, self.limit)
            y = np.concatenate([low, high], axis=1) @ matrix.T + offset
            most = max(most, float((y * y).sum(axis=1).max()))
        return most

    def _ray_square(self, matrix: np.ndarray, offset: np.ndarray) -> float:
        """Per patch of directions the smaller of two bounds: a = p - t w for p in S, or a in the box that holds all of these in D."""
        n, patches = self.ndim, DirectionPatches.cover(self.ndim, PATCHES.get(self.ndim, 3))
        w = patches.vertices(self.slack) * self.stretch  # (N, V, n)
        origins, most_origin = matrix[:, :n], np.zeros(w.shape[:2])
        rows = self.points @ origins.T + offset
        widened = np.linalg.norm(np.abs(origins) @ self.delta)  # |A (p + e)| <= |A p| + this
        squares = (rows * rows).sum(axis=1)
        for moved in (0.0, 1.0):
            shift = (w @ (matrix[:, n:] - moved * origins).T).reshape(-1, len(offset))
            size, best = max(1, CHUNK // len(rows)), np.empty(len(shift))
            for start in range(0, len(shift), size):
                part = shift[start : start + size]
                best[start : start + size] = (2 * part @ rows.T + squares).max(axis=1) + (part * part).sum(axis=1)
            most_origin = np.maximum(most_origin, np.sqrt(np.maximum(best, 0)).reshape(w.shape[:2]) + widened)
        first = most_origin.max(axis=1) ** 2
        low, high = self.points.min(axis=0) - self.delta, self.points.max(axis=0) + self.delta
        lower = np.maximum(low - np.maximum(w, 0).max(axis=1), -self.limit)
        upper = np.minimum(high - np.minimum(w, 0).min(axis=1), self.limit)
        second = self._corner_square(lower, upper, w, matrix[:, :n], matrix[:, n:], offset)
        return float(np.minimum(first, second).max())

    def _plane_square(self, matrix: np.ndarray, offset: np.ndarray) -> float:
        n, patches = self.ndim, DirectionPatches.cover(self.ndim, PATCHES.get(self.ndim, 3))
        u = patches.vertices(self.slack)
        limit = np.broadcast_to(self.limit, (len(u), n))
        return float(self._corner_square(-limit, limit, u, matrix[:, n:], matrix[:, :n], offset).max())

    @staticmethod
    def _corner_square(lower, upper, directions, on_box, on_direction, offset) -> np.ndarray:
        """``(N,)`` maximum over corners of the N boxes and vertices ``(N, V, n)`` of the patches."""
        most = np.zeros(len(lower))
        moved = directions @ on_direction.T + offset
        for corner in np.ndindex((2,) * lower.shape[1]):
            y = (np.where(corner, upper, lower) @ on_box.T)[:, None] + moved
            most = np.maximum(most, (y * y).sum(axis=2).max(axis=1))
        return most
