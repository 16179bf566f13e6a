"""How far the positive regions of an object reach in the space of their own numbers, bounded from above.

In parametric space a ray is the point ``v = (a, w)`` of R^2n, a plane ``(u, a)``, a box ``(low, high)``, and P is the set of all v of
regions that meet the object S. A volume around P needs ``max g . v`` over P for its faces, and ``max |A v + b|^2`` for its radius: for
boxes exactly, for rays and planes by duality, and branch and bound over directions.

*Rays.* The origin ``a = p - t w`` lies in the domain, p in the object, 0 <= t <= 1, so for *any* vector m

    x . a + y . w = (x - m) . a + m . p + (y - t m) . w  <=  h_D(x - m) + h(m) + y . w + max(0, -m . w)

with h and h_D the supports of the object and of the domain. That is convex in w, so over a patch of directions it is
largest at the patch's corners; and it is convex in m, which is looked for by trial, patch by patch. With one direction
a patch the best m would give the exact maximum over the object's hull (linear programming duality).

*Planes.* A plane passes a point p of the object where ``u . p = u . a`` (in local units), so for any number l ``x . u + y . a``
is at most ``x . u + h_D(y - l u) + h(l u)``, with h and h_D the supports of the object and of the domain. That is
convex in u, so over a patch of directions it is largest at the patch's corners, pushed out to hold the sphere. Branch
and bound over patches; l is one of the n + 1 numbers at which the bound has a kink at the patch's centre, where one of
them is best.

*Boxes.* ``low_k`` and ``high_k`` only have to leave a point p of the object S between them, up to delta each. With ``x+ =
max(x, 0)``, ``x- = max(-x, 0)`` and h_S the support of S itself, the maximum of ``x . low + y . high`` is exactly
``h_S(x+ - y-) + (x+ + y-) . delta + (x- + y+) . limit``.

Every number is a bound, whatever a search finds: a bad search costs tightness, never soundness.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from paper.parametric.direction_patches import DirectionPatches
from warp_bounding.arithmetic import UNIT64, gamma, round_up
from warp_bounding.errors import BounderError
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.queries.base import UNIT_LIMIT, direction_rounding
from warp_bounding.queries.boundary import CHUNK, ObjectSupport
from warp_bounding.queries.region_domain import RegionDomain

__all__ = ["ParametricSupport", "directed", "limit_of", "to_local", "v_per_unit"]

TOLERANCE = 2e-3  # relative to the functional's size: a patch whose bound is this near to a value in reach is not split
PATCHES = {1: 1, 2: 16, 3: 8, 4: 6}  # of directions, along an edge of a cube's face, by n
PATCHES_BEYOND = 3  # the same in more dimensions, where their number grows with the power n - 1
ROUNDING = gamma(256, UNIT64)  # more roundings than any sum goes through, over 2n numbers with n <= 64
AT_ONCE_OF_PLANES, STEPS_OF_PLANES = 64, 60  # patches that are split in a step; steps of splitting, at most
EDGE = {1: 1, 2: 8, 3: 4, 4: 3}  # of rays, by n: patches along an edge of a cube's face, to begin with
AT_ONCE, STEPS = 24, 200  # of rays: patches that are worked on in a step; steps of splitting, at most
ROUNDS = 9  # of the search for m; its step halves in each
FEWER_POINTS = 160  # points of the object that the search for m looks at


def directed(domain: RegionDomain) -> tuple[bool, bool]:
    """Of both halves of a region's numbers, whether they are a direction without a length; else they are a point."""
    return {"ray": (False, True), "plane": (True, False), "box": (False, False)}[domain.query]


def limit_of(domain: RegionDomain) -> np.ndarray:
    """``(2 n,)`` float64: P lies in the box ``|v| <= limit``."""
    ends = domain.base.limit, round_up(domain.stretch * UNIT_LIMIT)
    return np.concatenate([ends[turned] for turned in directed(domain)]).astype(np.float64)


def v_per_unit(domain: RegionDomain) -> np.ndarray:
    """``(2 n,)`` float64: v per unit of a region's own numbers."""
    return np.concatenate([(domain.base.scale, domain.stretch)[turned] for turned in directed(domain)]).astype(
        np.float64
    )


def to_local(domain: RegionDomain, q: np.ndarray) -> np.ndarray:
    """V ``(N, 2 n)`` float64 of regions that begin in the domain: points in local space, unit directions times the ray's length there."""
    parts = np.split(np.asarray(q, dtype=np.float64), 2, axis=1)
    for k, turned in enumerate(directed(domain)):
        unit = parts[k] / np.linalg.norm(parts[k], axis=1, keepdims=True) if turned else None
        parts[k] = unit * domain.stretch.astype(np.float64) if turned else domain.base.to_local(parts[k])
    return np.concatenate(parts, axis=1)


class RegionSupport(ABC):
    """Upper bounds over all regions of a kind that meet an object.

    Args:
        support: Of the object.
        domain: Of the kind of region.

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


class BoxSupport(RegionSupport):
    """Boxes; see the module."""

    name = "box"

    def linear(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        rise, fall = np.maximum(x, 0), np.maximum(-y, 0)  # low pushed up to p + delta, high pushed down to p - delta
        free = np.maximum(-x, 0) + np.maximum(y, 0)  # each pulled to the domain's border
        # the support of the widened object has |rise - fall| . delta already, which is taken out
        return (
            self.support(rise - fall)
            - np.abs(rise - fall) @ self.support.delta
            + (rise + fall) @ self.support.delta
            + free @ self.limit
        )

    def square(self, matrix: np.ndarray, offset: np.ndarray) -> float:
        n, most = self.ndim, 0.0
        for choice in np.ndindex((2,) * (2 * n)):
            near = np.array(choice, dtype=bool)
            low = np.where(near[:n], self.support.points + self.support.delta, -self.limit)
            high = np.where(near[n:], self.support.points - self.support.delta, self.limit)
            y = np.concatenate([low, high], axis=1) @ matrix.T + offset
            most = max(most, float((y * y).sum(axis=1).max()))
        return most


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
        for _ in range(STEPS_OF_PLANES):
            open_ = upper > max(lowest + tolerance, done)
            done = max(done, float(upper[~open_].max(initial=-np.inf)))
            patches, upper = patches.take(open_), upper[open_]
            if not len(upper) or patches.finest:
                break
            top = np.zeros(len(upper), dtype=bool)
            top[np.argsort(-upper)[:AT_ONCE_OF_PLANES]] = True
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


SUPPORTS: dict[str, type[RegionSupport]] = {kind.name: kind for kind in (RaySupport, PlaneSupport, BoxSupport)}


class ParametricSupport:
    """Certified maxima over P of linear functions and of squared lengths.

    Args:
        grid: The object.
        domain: Of a kind of region.

    Attributes:
        ndim: Dimension n of the object.
        object_support: ``h``, the support of the widened object.
        points: ``(C, n)``, those of ``object_support``.
        region: The bounds of this kind of region.
        reach: ``(2 n,)``: P lies in the box ``|v| <= reach``.
    """

    def __init__(self, grid: IndicatorGrid, domain: RegionDomain):
        if domain.query not in SUPPORTS:
            raise BounderError(f"expected regions, got {domain.query} queries")
        self.domain, self.ndim, self.reach = domain, domain.base.ndim, limit_of(domain)
        self.object_support = ObjectSupport(grid, domain.base)
        self.points = self.object_support.points
        self.region = SUPPORTS[domain.query](self.object_support, domain)

    def __call__(self, functionals: np.ndarray) -> np.ndarray:
        """Upper bounds of ``g . v`` over P.

        Args:
            functionals: ``(K, 2 n)`` float64.

        Returns:
            ``(K,)`` float64, rounding of this evaluation included.
        """
        g = np.asarray(functionals, dtype=np.float64)
        x, y = g[:, : self.ndim], g[:, self.ndim :]
        value = self.region.linear(x, y)
        plain = np.abs(g) @ self.reach  # P lies inside this box
        if not (np.isfinite(value) & np.isfinite(plain)).all():
            raise BounderError("numbers are so large that a support cannot be bounded")
        return np.minimum(value, plain) + ROUNDING * (1 + np.abs(value) + plain)

    def square(self, matrix: np.ndarray, offset: np.ndarray) -> float:
        """Upper bound of ``|A v + b|^2`` over P, the rounding of this evaluation included.

        Args:
            matrix: ``(r, 2 n)`` float64, A.
            offset: ``(r,)`` float64, b.
        """
        most = self.region.square(matrix, offset)
        reach = np.abs(matrix) @ self.reach + np.abs(offset)
        size = float(reach @ reach)
        return most + ROUNDING * (1 + size)
