"""How far the positive regions of an object reach in the space of their own numbers, proven from above.

In parametric space a ray is the point ``v = (a, w)`` of R^2n, a plane ``(u, a)``, a box ``(low, high)`` (``regions``), and P is
the set of all v that the pipeline can make of a region that meets the object S, rounding included. A volume around P needs
``max g . v`` over P for its faces, and ``max |A v + b|^2`` for its radius. With h(m) the support of S widened by ``delta``,
h_D that of the domain:

* box: ``low_k`` and ``high_k`` only have to leave a point p of S between them, so the maximum over P is linear in p:
  ``g = (x, y)`` gives ``h(x+ - y-) + (x- + y+) . limit``, exactly.
* ray: ``a = p - t w`` lies in D, so for *any* m: ``x . a + y . w = (x - m) . a + m . p + (y - t m) . w`` is at most
  ``h_D(x - m) + h(m) + max(|y|, |y - m|)`` in the metric in which w is a unit vector. This is convex in m; the least is looked for.
* plane: ``u . p = u . a`` (in local units), so for any number l: ``x . u + h_D(y - l u) + h(l u)`` is a bound. It is convex in u, so over
  a patch of directions it is largest at the patch's corners, pushed out to hold the sphere; branch and bound over patches.

Every number is a bound whatever the search for m or l finds: a bad search costs tightness, never soundness.
"""

from functools import cached_property

import numpy as np

from warp_bounding.arithmetic import TINY, UNIT64, gamma
from warp_bounding.bounders.direction_patches import DirectionPatches
from warp_bounding.bounders.domain import Domain
from warp_bounding.bounders.regions import RegionDomain, direction_rounding
from warp_bounding.errors import BounderError
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.hull import hull_corners

__all__ = ["ObjectSupport", "ParametricSupport"]

ROUNDS = 24  # of the search for m; its step halves in each
CHUNK = 1 << 22  # numbers of an intermediate array
TOLERANCE = 2e-3  # of the branch and bound over directions, relative to the functional's size
MOST_PATCHES = 60_000  # alive at once, a functional
PATCHES = {1: 1, 2: 16, 3: 8, 4: 6}  # per edge of a cube's face, where patches are not split further


class ObjectSupport:
    """The support of an object widened by ``delta``, from above.

    Args:
        grid: The object.
        base: Its domain of points.

    Attributes:
        points: ``(C, n)`` float64, local space: every vertex of the object's hull, and some more.
        delta: ``(n,)``, the object is widened by this on every axis.
    """

    def __init__(self, grid: IndicatorGrid, base: Domain):
        corners = grid.position(hull_corners(grid.occupancy))
        lower, upper = base.widened(corners, corners)
        self.points, self.delta = (lower + upper) / 2, base.delta * (1 + 1e-6) + 1e-14

    def __call__(self, m: np.ndarray) -> np.ndarray:
        """``h(m)`` of ``(..., n)`` vectors; rounding of this evaluation included."""
        flat = m.reshape(-1, m.shape[-1])
        best = np.empty(len(flat))
        size = max(1, CHUNK // len(self.points))
        for start in range(0, len(flat), size):
            best[start : start + size] = (flat[start : start + size] @ self.points.T).max(axis=1)
        largest = np.abs(flat) @ (np.abs(self.points).max(axis=0) + self.delta)
        best += np.abs(flat) @ self.delta + gamma(2 * flat.shape[1] + 8, UNIT64) * largest
        return best.reshape(m.shape[:-1])


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
        value = {"box": self._box, "ray": self._ray, "plane": self._plane}[self.query](x, y)
        plain = np.abs(g) @ self.reach  # P lies inside this box
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

    def ray_value(self, x: np.ndarray, y: np.ndarray, m: np.ndarray) -> np.ndarray:
        """The bound for rays with multipliers ``m``, all ``(..., n)``."""
        still = np.linalg.norm(y * self.stretch, axis=-1)
        moved = np.linalg.norm((y - m) * self.stretch, axis=-1)
        return np.abs(x - m) @ self.limit + self.object_support(m) + (1 + self.slack) * np.maximum(still, moved)

    def ray_multipliers(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Multipliers ``(K, n)`` with a low bound, and the bound ``(K,)``: a search over masks of x, then along axes."""
        n = self.ndim
        shares = np.array(list(np.ndindex((2,) * n)), dtype=np.float64)
        shares = np.concatenate([shares, 0.5 * shares[1:], 0.25 * shares[-1:], 0.75 * shares[-1:]])
        m = x[:, None, :] * shares
        values = self.ray_value(x[:, None, :], y[:, None, :], m)
        best = np.argmin(values, axis=1)
        row = np.arange(len(x))
        m, value = m[row, best], values[row, best]
        moves = np.concatenate([np.eye(n), -np.eye(n)])
        step = 0.5 * np.abs(np.concatenate([x, y], axis=1)).max(axis=1)
        for _ in range(ROUNDS):
            for _ in range(4):
                extra = np.stack([x - m, y - m], axis=1)
                extra = extra / np.maximum(np.abs(extra).max(axis=2, keepdims=True), TINY)
                tried = m[:, None] + step[:, None, None] * np.concatenate(
                    [np.broadcast_to(moves, (len(x), *moves.shape)), extra, -extra], axis=1
                )
                values = self.ray_value(x[:, None], y[:, None], tried)
                best = np.argmin(values, axis=1)
                better = values[row, best] < value
                if not better.any():
                    break
                m = np.where(better[:, None], tried[row, best], m)
                value = np.where(better, values[row, best], value)
            step = step / 2
        return m, value

    def _ray(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return self.ray_multipliers(x, y)[1]

    # --- planes ------------------------------------------------------------------------------------------------------

    def _plane(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        patches = DirectionPatches.cover(self.ndim, PATCHES.get(self.ndim, 3))
        vertices = _PlaneVertices(self, patches)
        return np.array([self._plane_bound(a, b, patches, vertices) for a, b in zip(x, y, strict=True)])

    def _plane_bound(self, x: np.ndarray, y: np.ndarray, patches: DirectionPatches, vertices: "_PlaneVertices") -> float:
        """Branch and bound over patches of directions, one functional."""
        tolerance = TOLERANCE * float(np.abs(np.concatenate([x, y])) @ self.reach)
        done, lowest = -np.inf, -np.inf
        while True:
            upper = vertices.bound(x, y)
            lowest = max(lowest, vertices.value(x, y))
            open_ = upper > lowest + tolerance
            done = max(done, float(upper[~open_].max(initial=-np.inf)))
            parts = int(open_.sum()) << (self.ndim - 1)
            if not parts or parts > MOST_PATCHES or vertices.finest:
                return max(done, float(upper[open_].max(initial=-np.inf)))
            patches = patches.take(open_).split()
            vertices = _PlaneVertices(self, patches)

    # --- squared lengths ---------------------------------------------------------------------------------------------

    def square(self, matrix: np.ndarray, offset: np.ndarray) -> float:
        """Upper bound of ``|A v + b|^2`` over P: a convex function, so largest at corners of what holds P.

        Args:
            matrix: ``(r, 2 n)`` float64, A.
            offset: ``(r,)`` float64, b.
        """
        most = {"box": self._box_square, "ray": self._ray_square, "plane": self._plane_square}[self.query](matrix, offset)
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


class _PlaneVertices:
    """What the bound for planes needs of patches, whatever the functional."""

    def __init__(self, support: ParametricSupport, patches: DirectionPatches):
        self.support, self.finest = support, patches.finest
        u = patches.vertices(0.0)[:, ::2]  # on the sphere; factors follow
        inner, outer = 1 - support.slack, patches.outer * (1 + support.slack)
        self.u, self.center = u, patches.centers
        self.local, self.local_center = u / support.stretch, patches.centers / support.stretch
        self.high, self.low = support.object_support(self.local), support.object_support(-self.local)
        self.high_center, self.low_center = (support.object_support(s * self.local_center) for s in (1, -1))
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

