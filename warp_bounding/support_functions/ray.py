"""Upper bounds of linear functions of a ray's numbers ``(a, w)`` over all rays that meet an object.

The origin ``a = p - t w`` lies in the domain, p in the object, 0 <= t <= 1, so for *any* vector m

    x . a + y . w = (x - m) . a + m . p + (y - t m) . w  <=  h_D(x - m) + h(m) + y . w + max(0, -m . w)

with h and h_D the supports of the object and of the domain. That is convex in w, so over a patch of directions it is
largest at the patch's corners; and it is convex in m, which is looked for by trial, patch by patch. With one direction
a patch the best m would give the exact maximum over the object's hull (linear programming duality).
"""

from dataclasses import dataclass

import numpy as np

from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.geometry.direction_patches import DirectionPatches
from warp_bounding.support_functions.base import CHUNK, TOLERANCE, ObjectSupport, RegionSupport, corner_square

__all__ = ["RaySupport"]

EDGE = {1: 1, 2: 8, 3: 4, 4: 3}  # by n: patches along an edge of a cube's face, to begin with
AT_ONCE = 24  # patches that are worked on in a step
STEPS = 200  # of splitting, at most
ROUNDS = 9  # of the search for m; its step halves in each
FEWER_POINTS = 160  # points of the object that the search for m looks at


@dataclass
class _Patches:
    """Patches, their multipliers ``m`` and bounds, and which have been searched already."""

    patches: DirectionPatches
    vertices: np.ndarray  # (N, V, n), values of w
    m: np.ndarray  # (N, n)
    upper: np.ndarray  # (N,)
    searched: np.ndarray  # (N,) bool

    def take(self, which: np.ndarray) -> "_Patches":
        return _Patches(
            self.patches.take(which), self.vertices[which], self.m[which], self.upper[which], self.searched[which]
        )

    def joined(self, other: "_Patches") -> "_Patches":
        rest = [np.concatenate([getattr(self, k), getattr(other, k)]) for k in ("vertices", "m", "upper", "searched")]
        return _Patches(self.patches.joined(other.patches), *rest)


class RaySupport(RegionSupport):
    """Rays; see the module.

    Attributes:
        stretch: ``(n,)``, w is this times a unit vector.
    """

    name = "ray"

    def __init__(self, support: ObjectSupport, domain: RegionDomain):
        super().__init__(support, domain)
        self.stretch = domain.stretch.astype(np.float64)
        self.patches = DirectionPatches.cover(self.ndim, EDGE.get(self.ndim, 2))
        self.vertices = self._vertices(self.patches)
        rng = np.random.default_rng(0)
        self._moves = rng.normal(size=(8, self.ndim))
        self._moves /= np.abs(self._moves).max(axis=1, keepdims=True)
        self._moves = np.concatenate([np.eye(self.ndim), -np.eye(self.ndim), self._moves])
        points = support.points
        if len(points) > FEWER_POINTS:  # those that are farthest in some direction
            far = np.unique(np.argmax(points @ rng.normal(size=(self.ndim, 4 * FEWER_POINTS)), axis=0))
            points = points[far[:: max(1, len(far) // FEWER_POINTS)]]
        self._few = points

    def _vertices(self, patches: DirectionPatches) -> np.ndarray:
        return patches.vertices(self.slack) * self.stretch

    def bound(self, x: np.ndarray, y: np.ndarray) -> float:
        """Bound of ``x . a + y . w``: the highest patches are searched for a better m, and then split."""
        tolerance = TOLERANCE * float(np.abs(x) @ self.limit + np.abs(y) @ self.stretch)
        shares = np.array(list(np.ndindex((2,) * self.ndim)), dtype=np.float64)
        candidates = x * np.concatenate([shares, shares / 2])
        state = self._with(x, y, self.patches, self.vertices, candidates)
        done = -np.inf
        for _ in range(STEPS):
            top = np.argsort(-state.upper)[:AT_ONCE]
            chosen = np.zeros(len(state.upper), dtype=bool)
            chosen[top] = state.upper[top] > done
            work, state = state.take(chosen), state.take(~chosen)
            if not len(work.upper):
                break
            fresh = work.take(~work.searched)
            searched = self._search(x, y, fresh) if len(fresh.upper) else fresh
            # One that has been searched and is nearly flat is done; the others are split.
            work = work.take(work.searched).joined(searched)
            centers = work.patches.centers * self.stretch
            middle = self._constant(x, work.m) + centers @ y + np.maximum(0, -(centers * work.m).sum(axis=1))
            flat = work.upper <= middle + tolerance
            done = max(done, float(work.upper[flat].max(initial=-np.inf)))
            work = work.take(~flat & (work.upper > done))
            if len(work.upper) and not work.patches.finest:
                parts = work.patches.split()
                m = np.tile(work.m, (2 ** (self.ndim - 1), 1))
                state = state.joined(self._with(x, y, parts, self._vertices(parts), None, m))
            elif len(work.upper):
                done = max(done, float(work.upper.max()))
            if not len(state.upper) or state.upper.max() <= done:
                break
        return max(done, float(state.upper.max(initial=-np.inf)))

    def _constant(self, x: np.ndarray, m: np.ndarray) -> np.ndarray:
        """``h_D(x - m) + h(m)``."""
        return np.abs(x - m) @ self.limit + self.support(m)

    def _with(self, x, y, patches, vertices, candidates, m=None) -> _Patches:
        """Patches with the best of some multipliers, the same for all, or one for each."""
        along = vertices @ y
        if m is None:
            turned = np.maximum(0, -np.einsum("nvk,ck->ncv", vertices, candidates)) + along[:, None]
            values = self._constant(x, candidates) + turned.max(axis=2)
            m = candidates[np.argmin(values, axis=1)]
        turned = np.maximum(0, -np.einsum("nvk,nk->nv", vertices, m)) + along
        upper = self._constant(x, m) + turned.max(axis=1)
        return _Patches(patches, vertices, m, upper, np.zeros(len(upper), dtype=bool))

    def _search(self, x: np.ndarray, y: np.ndarray, state: _Patches) -> _Patches:
        """Better multipliers: a pattern search looks at some of the object's points, the bound at all of them."""
        along, m = state.vertices @ y, state.m
        few = self._few

        def value(tried: np.ndarray) -> np.ndarray:  # (N, C, n)
            hull = (tried @ few.T).max(axis=2) + np.abs(tried) @ self.support.delta
            turned = np.maximum(0, -(tried @ state.vertices.transpose(0, 2, 1))) + along[:, None]
            return np.abs(x - tried) @ self.limit + hull + turned.max(axis=2)

        row, best = np.arange(len(m)), value(m[:, None])[:, 0]
        step = 0.5 * max(np.abs(x).max(), np.abs(y).max())
        for _ in range(ROUNDS):
            for _ in range(3):
                toward = (x - m)[:, None]
                tried = np.concatenate(
                    [m[:, None] + step * self._moves, m[:, None] + 0.5 * toward, m[:, None] / 2], axis=1
                )
                values = value(tried)
                index = np.argmin(values, axis=1)
                better = values[row, index] < best
                if not better.any():
                    break
                m = np.where(better[:, None], tried[row, index], m)
                best = np.where(better, values[row, index], best)
            step = step / 2
        found = self._with(x, y, state.patches, state.vertices, None, m)
        worse = found.upper > state.upper
        upper, m = np.minimum(found.upper, state.upper), np.where(worse[:, None], state.m, m)
        return _Patches(state.patches, state.vertices, m, upper, np.ones(len(m), dtype=bool))

    def square(self, matrix: np.ndarray, offset: np.ndarray) -> float:
        """Bound of ``|A v + b|^2``: of each patch of directions the smaller of two.

        Either a = p - t w with p in the object, or a in the box that holds all of these in the domain.
        """
        n, patches = self.ndim, self.direction_patches()
        w = patches.vertices(self.slack) * self.stretch  # (N, V, n)
        origins, most_origin = matrix[:, :n], np.zeros(w.shape[:2])
        rows = self.support.points @ origins.T + offset
        widened = np.linalg.norm(np.abs(origins) @ self.support.delta)  # |A (p + e)| <= |A p| + this
        squares = (rows * rows).sum(axis=1)
        for t in (0.0, 1.0):  # the square is convex in t, so largest at an end
            shift = (w @ (matrix[:, n:] - t * origins).T).reshape(-1, len(offset))
            size, best = max(1, CHUNK // len(rows)), np.empty(len(shift))
            for start in range(0, len(shift), size):
                part = shift[start : start + size]
                best[start : start + size] = (2 * part @ rows.T + squares).max(axis=1) + (part * part).sum(axis=1)
            most_origin = np.maximum(most_origin, np.sqrt(np.maximum(best, 0)).reshape(w.shape[:2]) + widened)
        first = most_origin.max(axis=1) ** 2
        low = self.support.points.min(axis=0) - self.support.delta
        high = self.support.points.max(axis=0) + self.support.delta
        lower = np.maximum(low - np.maximum(w, 0).max(axis=1), -self.limit)
        upper = np.minimum(high - np.minimum(w, 0).min(axis=1), self.limit)
        second = corner_square(lower, upper, w, matrix[:, :n], matrix[:, n:], offset)
        return float(np.minimum(first, second).max())
