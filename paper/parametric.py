"""The paper's volumes around the *numbers* of regions, in plain NumPy.

In parametric space a ray is the point ``v = (a, w)`` of R^2n, a plane ``(u, a)``, a box ``(low, high)``, and P is the
set of all v of regions that meet the object S. The paper fits a volume to 20,000 positive regions. Its form is taken
from such samples here too; its faces, or its radius, are then set by upper bounds of ``max g . v`` and ``max |A v +
b|^2`` over P, so that it has no false negative beyond the samples either. Every number is a bound, whatever a search
finds: a bad search costs tightness only.

*Rays.* The origin ``a = p - t w`` lies in the domain D, p in the object, 0 <= t <= 1, so for *any* vector m

    x . a + y . w = (x - m) . a + m . p + (y - t m) . w  <=  h_D(x - m) + h(m) + y . w + max(0, -m . w)

with h and h_D the supports of the object and of the domain. With one direction w the best m would give the exact
maximum over the object's hull (linear programming duality); it is looked for by trial.

*Planes.* A plane passes a point p of the object where ``u . p = u . a`` (in local units), so for any number m ``x . u
+ y . a`` is at most ``x . u + h_D(y - m u) + h(m u)``. The best m is one of n + 1 kinks.

Both are convex in the direction: over a patch of directions they are largest at its corners, and patches are split by
branch and bound.

*Boxes.* ``low`` and ``high`` only have to leave a point of S between them, up to delta each: with ``x+ = max(x, 0)``,
``x- = max(-x, 0)`` the maximum of ``x . low + y . high`` is exactly ``h_S(x+ - y-) + (x+ + y-) . delta + (x- + y+) .
limit``.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_bounding.bounders import METHODS
from warp_bounding.bounders.ellipsoids import QuadricBounder
from warp_bounding.bounders.learned_kdop import LearnedKdop
from warp_bounding.bounders.volumes import kdop_directions
from warp_bounding.errors import BounderError
from warp_bounding.evaluation import Rates, counted, truth_by
from warp_bounding.geometry import enclosing_of_points
from warp_bounding.queries import oracle, sample
from warp_bounding.queries.base import UNIT_LIMIT, direction_rounding
from warp_bounding.queries.boundary import CHUNK, ObjectSupport
from warp_bounding.queries.hard import draw_positives
from warp_bounding.queries.region_domain import RegionDomain, domain_of
from warp_bounding.rounding import UNIT64, gamma, round_up

SAMPLES = 20_000  # queries that a volume's form follows from
TOLERANCE = 2e-3  # relative to the functional's size: a patch whose bound is so near to that at its centre is not split
ROUNDING = gamma(256, UNIT64)  # more roundings than any sum goes through, over 2n numbers with n <= 64
EDGE = {1: 1, 2: 8, 3: 4, 4: 3}  # by n: patches along an edge of a cube's face, to begin with
FINER = {1: 1, 2: 16, 3: 8, 4: 6}
AT_ONCE, STEPS = 24, 200  # patches that are worked on in a step; steps of splitting, at most
ROUNDS, FEW = 9, 160  # of the search for a ray's m, whose step halves in each; points of the object that it looks at
NARROWEST = 1e-6  # edge length, on a cube of edge 2, under which patches are not split
SHRUNK = 1 - 1e-12  # factor that covers the float64 rounding of cosines
DIRECTIONS = {"ray": (False, True), "plane": (True, False), "box": (False, False)}  # halves of v without a length

# --- the numbers of a region ------------------------------------------------------------------------------------------


def limit_of(domain: RegionDomain) -> np.ndarray:
    """``(2 n,)`` float64: P lies in the box ``|v| <= limit``."""
    ends = domain.base.limit, round_up(domain.stretch * UNIT_LIMIT)
    return np.concatenate([ends[turned] for turned in DIRECTIONS[domain.query]]).astype(np.float64)


def v_per_unit(domain: RegionDomain) -> np.ndarray:
    """``(2 n,)`` float64: v per unit of a region's own numbers."""
    scales = domain.base.scale, domain.stretch
    return np.concatenate([scales[turned] for turned in DIRECTIONS[domain.query]]).astype(np.float64)


def to_local(domain: RegionDomain, q: np.ndarray) -> np.ndarray:
    """V ``(N, 2 n)`` float64 of regions that begin in the domain: local points, and directions of a ray's length."""
    parts = np.split(np.asarray(q, dtype=np.float64), 2, axis=1)
    for k, turned in enumerate(DIRECTIONS[domain.query]):
        unit = parts[k] / np.linalg.norm(parts[k], axis=1, keepdims=True) if turned else None
        parts[k] = unit * domain.stretch.astype(np.float64) if turned else domain.base.to_local(parts[k])
    return np.concatenate(parts, axis=1)


# --- directions -------------------------------------------------------------------------------------------------------


class Patches:
    """Patches of the unit sphere in n dimensions, as cells of a cube's faces seen from its centre; and their data.

    A unit vector of a patch is ``f y``, where y is a mean of the patch's unit vertices ``u_i`` and ``1 <= f <= outer``;
    so a convex function is largest, over the patch, at some ``u_i`` or ``outer u_i``. The arrays have N rows: ``axis``
    of the cube's face, ``sign`` of its side, ``lower`` and ``upper`` corners of the cell ``(N, n - 1)``; in a search
    also ``vertices``, what is ``known`` of these, multipliers ``m``, bounds ``most``, and ``searched``.
    """

    def __init__(self, **arrays: np.ndarray):
        self.arrays = arrays

    def __getattr__(self, name: str) -> np.ndarray:
        return self.__dict__["arrays"][name]

    @classmethod
    def cover(cls, ndim: int, edge: int) -> "Patches":
        """The whole sphere, ``edge`` patches along each edge of a face."""
        cells = np.array(list(np.ndindex((edge,) * (ndim - 1))), dtype=np.float64).reshape(edge ** (ndim - 1), ndim - 1)
        faces = [(axis, sign) for axis in range(ndim) for sign in (1.0, -1.0)]
        axis, sign = (np.repeat(column, len(cells)) for column in zip(*faces, strict=True))
        lower, upper = (np.tile(-1 + 2 * (cells + k) / edge, (len(faces), 1)) for k in (0, 1))
        return cls(axis=axis, sign=sign, lower=lower, upper=upper)

    def __len__(self) -> int:
        return len(self.axis)

    @property
    def ndim(self) -> int:
        """Dimension n."""
        return self.lower.shape[1] + 1

    @property
    def finest(self) -> bool:
        """Whether no patch is worth splitting."""
        return self.ndim == 1 or float((self.upper - self.lower).max(initial=0.0)) < NARROWEST

    def _on_sphere(self, cell: np.ndarray) -> np.ndarray:
        others = np.array([[k for k in range(self.ndim) if k != axis] for axis in range(self.ndim)], dtype=np.int64)
        full, row = np.empty((len(self), self.ndim)), np.arange(len(self))
        full[row, self.axis] = self.sign
        full[row[:, None], others[self.axis].reshape(len(self), -1)] = cell
        return full / np.linalg.norm(full, axis=1, keepdims=True)

    @property
    def centers(self) -> np.ndarray:
        """``(N, n)`` unit vectors."""
        return self._on_sphere((self.lower + self.upper) / 2)

    def hulls(self, slack: float) -> np.ndarray:
        """``(N, 2^n, n)``: ``u_i (1 - slack)`` and ``outer u_i (1 + slack)`` in turn.

        Their hull holds all vectors in the directions of the patch whose length is within ``slack`` of 1.
        """
        choices = np.ndindex((2,) * (self.ndim - 1))
        u = np.stack([self._on_sphere(np.where(c, self.upper, self.lower)) for c in choices], axis=1)
        outer = 1 / (np.einsum("nvk,nk->nv", u, self.centers).min(axis=1) * SHRUNK)
        ends = [u * (1 - slack), u * outer[:, None, None] * (1 + slack)]
        return np.stack(ends, axis=2).reshape(len(self), -1, self.ndim)

    def having(self, **arrays: np.ndarray) -> "Patches":
        """The same patches with other arrays."""
        return Patches(**self.arrays | arrays)

    def take(self, which: np.ndarray) -> "Patches":
        """The patches at these indices, or where a mask is true."""
        return Patches(**{name: array[which] for name, array in self.arrays.items()})

    def joined(self, other: "Patches") -> "Patches":
        """These patches, then those of another set."""
        return Patches(**{name: np.concatenate([own, other.arrays[name]]) for name, own in self.arrays.items()})

    def split(self) -> "Patches":
        """Each patch in ``2^(n-1)`` parts, of which nothing is known."""
        middle, choices = (self.lower + self.upper) / 2, list(np.ndindex((2,) * (self.ndim - 1)))
        lower = np.concatenate([np.where(choice, middle, self.lower) for choice in choices])
        upper = np.concatenate([np.where(choice, self.upper, middle) for choice in choices])
        sides = {name: np.tile(getattr(self, name), len(choices)) for name in ("axis", "sign")}
        return Patches(**sides, lower=lower, upper=upper)


# --- bounds over all positive regions ---------------------------------------------------------------------------------


class Support:
    """Upper bounds of linear functions and of squared lengths over P; a subclass for each kind of region."""

    def __init__(self, grid: Any, domain: RegionDomain):
        self.hull, self.domain, self.ndim = ObjectSupport(grid, domain.base), domain, domain.base.ndim
        self.points, self.delta = self.hull.points, self.hull.delta
        self.reach, self.limit = limit_of(domain), domain.base.limit.astype(np.float64)  # P lies in |v| <= reach
        self.slack = 2 * direction_rounding(self.ndim)  # the computed unit directions have lengths within this of 1

    def __call__(self, functionals: np.ndarray) -> np.ndarray:
        """``(K,)`` upper bounds of ``g . v`` over P, of g ``(K, 2 n)``, the rounding of this evaluation included."""
        g = np.asarray(functionals, dtype=np.float64)
        value, plain = self.linear(g[:, : self.ndim], g[:, self.ndim :]), np.abs(g) @ self.reach
        if not (np.isfinite(value) & np.isfinite(plain)).all():
            raise BounderError("numbers are so large that a support cannot be bounded")
        return np.minimum(value, plain) + ROUNDING * (1 + np.abs(value) + plain)

    def square(self, matrix: np.ndarray, offset: np.ndarray) -> float:
        """Upper bound of ``|A v + b|^2`` over P, A ``(r, 2 n)`` and b ``(r,)``, rounding included."""
        reach = np.abs(matrix) @ self.reach + np.abs(offset)
        return self.most_square(matrix, offset) + ROUNDING * (1 + float(reach @ reach))

    def linear(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """``(K,)`` bounds of ``x . first + y . second`` over the halves of v, by branch and bound over directions."""
        first = self.begun(Patches.cover(self.ndim, self.edge.get(self.ndim, 2)))
        return np.array([self._branched(a, b, first) for a, b in zip(x, y, strict=True)])

    def _branched(self, x: np.ndarray, y: np.ndarray, first: Patches) -> float:
        """One such bound: the highest patches are searched for a better m, and then split."""
        sizes = (self.limit, self.stretch) if self.domain.query == "ray" else (1.0, self.limit)
        tolerance = TOLERANCE * float((np.abs(x) * sizes[0]).sum() + (np.abs(y) * sizes[1]).sum())
        state, done = self.opened(x, y, first), -np.inf
        for _ in range(STEPS):
            chosen = np.zeros(len(state), dtype=bool)
            chosen[np.argsort(-state.most)[:AT_ONCE]] = True
            chosen &= state.most > done
            part, state = state.take(chosen), state.take(~chosen)
            if not len(part):
                break
            fresh = part.take(~part.searched)
            part = part.take(part.searched).joined(self.better(x, y, fresh) if len(fresh) else fresh)
            flat = part.most <= self.middle(x, y, part) + tolerance
            done = max(done, float(part.most[flat].max(initial=-np.inf)))
            part = part.take(~flat & (part.most > done))
            if len(part) and not part.finest:
                halves = self.begun(part.split(), np.tile(part.m, (2 ** (self.ndim - 1), 1)))
                state = state.joined(self.opened(x, y, halves))
            elif len(part):
                done = max(done, float(part.most.max()))
            if not len(state) or state.most.max() <= done:
                break
        return max(done, float(state.most.max(initial=-np.inf)))

    def begun(self, patches: Patches, m: np.ndarray | None = None) -> Patches:
        """Patches of which no bound is known, with an ``m`` from their parents, if they have any."""
        m = np.full((len(patches), self.ndim), np.nan) if m is None else m
        vertices = self.vertices_of(patches)
        return patches.having(vertices=vertices, known=self.known_of(vertices), m=m)

    def known_of(self, vertices: np.ndarray) -> np.ndarray:
        """``(N, ...)``: what does not depend on the functional."""
        return np.empty((len(vertices), 0))

    def vertices_of(self, patches: Patches) -> np.ndarray:
        """``(N, V, n)`` vectors whose hull holds all directions of a patch, as they stand in v."""
        return patches.hulls(self.slack)


def _corner_square(lower, upper, directions, on_box, on_direction, offset) -> np.ndarray:
    """``(N,)``: the largest ``|on_box y + on_direction d + offset|^2`` of y in box i and d in patch i ``(N, V, n)``."""
    most, moved = np.zeros(len(lower)), directions @ on_direction.T + offset
    for corner in np.ndindex((2,) * lower.shape[1]):
        y = (np.where(corner, upper, lower) @ on_box.T)[:, None] + moved
        most = np.maximum(most, (y * y).sum(axis=2).max(axis=1))
    return most


class BoxSupport(Support):
    """Boxes; see the module."""

    def linear(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        rise, fall = np.maximum(x, 0), np.maximum(-y, 0)  # low pushed up to p + delta, high pushed down to p - delta
        free = np.maximum(-x, 0) + np.maximum(y, 0)  # each pulled to the domain's border
        # the support of the widened object has |rise - fall| . delta already, which is taken out
        return self.hull(rise - fall) + (rise + fall - np.abs(rise - fall)) @ self.delta + free @ self.limit

    def most_square(self, matrix: np.ndarray, offset: np.ndarray) -> float:
        n, most = self.ndim, 0.0
        for choice in np.ndindex((2,) * (2 * n)):
            near = np.array(choice, dtype=bool)
            low = np.where(near[:n], self.points + self.delta, -self.limit)
            high = np.where(near[n:], self.points - self.delta, self.limit)
            y = np.concatenate([low, high], axis=1) @ matrix.T + offset
            most = max(most, float((y * y).sum(axis=1).max()))
        return most


class PlaneSupport(Support):
    """Planes; see the module. A plane's normal in local space is u / scale; known are h there and at its opposite."""

    edge = FINER

    def __init__(self, grid: Any, domain: RegionDomain):
        super().__init__(grid, domain)
        self.scale = domain.base.scale.astype(np.float64)

    def known_of(self, vertices: np.ndarray) -> np.ndarray:
        return np.stack([self.hull(vertices / self.scale), self.hull(-vertices / self.scale)], axis=1)

    def _values(self, x, y, u, known, m) -> np.ndarray:
        """The bound at directions u ``(N, V, n)`` with multipliers ``(N,)``; h is homogeneous."""
        hull = np.maximum(m[:, None] * known[:, 0], -m[:, None] * known[:, 1])
        return u @ x + np.abs(y - m[:, None, None] * (u / self.scale)) @ self.limit + hull

    def _kinks(self, y, patches: Patches) -> np.ndarray:
        """``(N, n + 1)``, kinks of the bound at the patches' centres: its minimum is at one of them."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            kinks = y / (patches.centers / self.scale)
        kinks = np.where(np.abs(kinks) < 1e6, kinks, 0.0)
        return np.concatenate([kinks, np.zeros((len(kinks), 1))], axis=1)

    def opened(self, x, y, state: Patches) -> Patches:
        about = (state.vertices, state.known)
        most = np.stack([self._values(x, y, *about, m).max(axis=1) for m in self._kinks(y, state).T]).min(axis=0)
        return state.having(most=most, searched=np.ones(len(most), dtype=bool))

    def middle(self, x, y, state: Patches) -> np.ndarray:
        about = (centers := state.centers[:, None]), self.known_of(centers)
        return np.stack([self._values(x, y, *about, m)[:, 0] for m in self._kinks(y, state).T]).min(axis=0)

    def most_square(self, matrix: np.ndarray, offset: np.ndarray) -> float:
        n, u = self.ndim, self.vertices_of(Patches.cover(self.ndim, FINER.get(self.ndim, 3)))
        limit = np.broadcast_to(self.limit, (len(u), n))
        return float(_corner_square(-limit, limit, u, matrix[:, n:], matrix[:, :n], offset).max())


class RaySupport(Support):
    """Rays; see the module. ``stretch`` ``(n,)``: w is this times a unit vector."""

    edge = EDGE

    def __init__(self, grid: Any, domain: RegionDomain):
        super().__init__(grid, domain)
        self.stretch = domain.stretch.astype(np.float64)
        rng, unit = np.random.default_rng(0), np.eye(self.ndim)
        moves = rng.normal(size=(8, self.ndim))
        self._moves = np.concatenate([unit, -unit, moves / np.abs(moves).max(axis=1, keepdims=True)])
        self._few = self.points
        if len(self.points) > FEW:  # those that are farthest in some direction
            far = np.unique(np.argmax(self.points @ rng.normal(size=(self.ndim, 4 * FEW)), axis=0))
            self._few = self.points[far[:: max(1, len(far) // FEW)]]

    def vertices_of(self, patches: Patches) -> np.ndarray:
        return patches.hulls(self.slack) * self.stretch

    def _constant(self, x: np.ndarray, m: np.ndarray) -> np.ndarray:
        """``h_D(x - m) + h(m)``."""
        return np.abs(x - m) @ self.limit + self.hull(m)

    def opened(self, x, y, state: Patches) -> Patches:
        """With the best of some multipliers, the same for all, where they have none."""
        along, m = state.vertices @ y, state.m
        if np.isnan(m).any():
            shares = np.array(list(np.ndindex((2,) * self.ndim)), dtype=np.float64)
            tried = x * np.concatenate([shares, shares / 2])
            turned = np.maximum(0, -np.einsum("nvk,ck->ncv", state.vertices, tried)) + along[:, None]
            m = tried[np.argmin(self._constant(x, tried) + turned.max(axis=2), axis=1)]
        turned = np.maximum(0, -np.einsum("nvk,nk->nv", state.vertices, m)) + along
        most = self._constant(x, m) + turned.max(axis=1)
        return state.having(m=m, most=most, searched=np.zeros(len(most), dtype=bool))

    def middle(self, x, y, state: Patches) -> np.ndarray:
        centers = state.centers * self.stretch
        return self._constant(x, state.m) + centers @ y + np.maximum(0, -(centers * state.m).sum(axis=1))

    def better(self, x, y, state: Patches) -> Patches:
        """Better multipliers: a pattern search looks at some of the object's points, the bound at all of them."""
        along, m = state.vertices @ y, state.m

        def value(tried: np.ndarray) -> np.ndarray:  # (N, C, n)
            hull = (tried @ self._few.T).max(axis=2) + np.abs(tried) @ self.delta
            turned = np.maximum(0, -(tried @ state.vertices.transpose(0, 2, 1))) + along[:, None]
            return np.abs(x - tried) @ self.limit + hull + turned.max(axis=2)

        row, best, step = np.arange(len(m)), value(m[:, None])[:, 0], 0.5 * max(np.abs(x).max(), np.abs(y).max())
        for _ in range(ROUNDS):
            for _ in range(3):
                at = m[:, None]
                tried = np.concatenate([at + step * self._moves, at + 0.5 * (x - at), at / 2], axis=1)
                values = value(tried)
                index = np.argmin(values, axis=1)
                better = values[row, index] < best
                if not better.any():
                    break
                m = np.where(better[:, None], tried[row, index], m)
                best = np.where(better, values[row, index], best)
            step = step / 2
        found = self.opened(x, y, state.having(m=m))
        m, most = np.where((found.most > state.most)[:, None], state.m, m), np.minimum(found.most, state.most)
        return state.having(m=m, most=most, searched=np.ones(len(m), dtype=bool))

    def most_square(self, matrix: np.ndarray, offset: np.ndarray) -> float:
        """Of each patch the smaller of two: a = p - t w with p in the object, or a in the box of all of these."""
        n, w = self.ndim, self.vertices_of(Patches.cover(self.ndim, FINER.get(self.ndim, 3)))  # (N, V, n)
        origins, most_origin = matrix[:, :n], np.zeros(w.shape[:2])
        rows = self.points @ origins.T + offset
        widened = np.linalg.norm(np.abs(origins) @ self.delta)  # |A (p + e)| <= |A p| + widened
        squares = (rows * rows).sum(axis=1)
        for t in (0.0, 1.0):  # the square is convex in t, so largest at an end
            shift = (w @ (matrix[:, n:] - t * origins).T).reshape(-1, len(offset))
            size = max(1, CHUNK // len(rows))
            parts = (shift[start : start + size] for start in range(0, len(shift), size))
            best = np.concatenate([(2 * p @ rows.T + squares).max(axis=1) + (p * p).sum(axis=1) for p in parts])
            most_origin = np.maximum(most_origin, np.sqrt(np.maximum(best, 0)).reshape(w.shape[:2]) + widened)
        low, high = self.points.min(axis=0) - self.delta, self.points.max(axis=0) + self.delta
        lower = np.maximum(low - np.maximum(w, 0).max(axis=1), -self.limit)
        upper = np.minimum(high - np.minimum(w, 0).min(axis=1), self.limit)
        second = _corner_square(lower, upper, w, matrix[:, :n], matrix[:, n:], offset)
        return float(np.minimum(most_origin.max(axis=1) ** 2, second).max())


SUPPORTS: dict[str, type[Support]] = {"ray": RaySupport, "plane": PlaneSupport, "box": BoxSupport}


def support_of(grid: Any, domain: Any) -> Support:
    """The bounds of a kind of region; ``BounderError`` for points."""
    if domain.query not in SUPPORTS:
        raise BounderError(f"expected regions, got {domain.query} queries")
    return SUPPORTS[domain.query](grid, domain)


# --- volumes ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ParametricVolume:
    """``low <= D v <= high``, or ``|A v + b|^2 <= high``; v are a region's numbers (``to_local``)."""

    domain: RegionDomain
    matrix: np.ndarray  # D ``(k, 2 n)``, or A
    low: np.ndarray | None  # ``(k,)``, minus infinity for half-spaces without another side; ``None`` of an ellipsoid
    high: np.ndarray | float
    offset: np.ndarray | None  # b; ``None`` of faces
    numbers: int  # that a query reads of the volume

    certificate = None

    def query(self, q: np.ndarray) -> np.ndarray:
        """``(N,)`` bool, *maybe*, of regions that begin in the domain; a plane with a point outside is *maybe*."""
        v = to_local(self.domain, q)
        beyond = (np.abs(v) > limit_of(self.domain)).any(axis=1) if self.domain.query == "plane" else False
        if self.offset is not None:
            y = v @ self.matrix.T + self.offset
            return ((y * y).sum(axis=1) <= self.high) | beyond
        y = v @ self.matrix.T
        return ((y >= self.low) & (y <= self.high)).all(axis=1) | beyond

    @property
    def nbytes(self) -> int:
        """Bytes that a query reads: the map to v, a threshold, and the volume."""
        own = 0 if self.domain.query == "box" else self.domain.space_ndim
        return 4 * (3 * self.domain.space_ndim + 1 + own + int(self.domain.time) + self.numbers)


def fit(grid, query, method, *, length=1.0, seed=0, seconds=10.0, steps=None) -> ParametricVolume:
    """The volume of a method around the numbers of all regions of a kind that meet a grid.

    Seed, seconds and steps, instead of seconds, are those of samples and training.
    """
    domain, cls = domain_of(grid, query, length), METHODS[method]
    support, scale = support_of(grid, domain), v_per_unit(domain)
    if issubclass(cls, LearnedKdop):
        normals = learned_normals(grid, support, seed=seed, seconds=seconds, steps=steps)
        none = np.full(len(normals), -np.inf)
        return ParametricVolume(domain, normals, none, support(normals), None, normals.size + len(normals))
    x = sample(query, grid, SAMPLES, np.random.default_rng(seed))
    x = x[oracle(query, grid, "cpu", domain.oracle_length)(x)]
    if len(x) < 2:  # positives are rare: hard ones stand in
        x = next(draw_positives(query, grid, SAMPLES, seed, "cpu", domain.oracle_length, outside=False))
    samples = to_local(domain, x) / scale  # in a query's own units, as in the paper's code
    if issubclass(cls, QuadricBounder):
        matrix, center = enclosing_of_points(samples, cls.family)
        matrix, offset = matrix / scale, -matrix @ center
        numbers = len(offset) + (len(offset) if cls.diagonal else matrix.size)
        return ParametricVolume(domain, matrix, None, support.square(matrix, offset), offset, numbers)
    directions = np.eye(len(scale)) if cls.diagonal else cls.sampled_directions(samples) / scale
    low, high = -support(-directions), support(directions)
    numbers = 2 * len(low) + (0 if cls.diagonal else directions.size)
    return ParametricVolume(domain, directions, low, high, None, numbers)


def rates(volume: ParametricVolume, grid: Any, samples: int, protocol: str, *, seed: int, device: Any = "cpu") -> Rates:
    """False positives and false negatives of random queries: the very queries that ``evaluate`` asks."""
    query, length, rng = volume.domain.query, volume.domain.oracle_length, np.random.default_rng(seed)
    truth = truth_by(protocol, query, grid, device, length, seed)
    reported = {"protocol": protocol, "seed": int(seed), "truth": "cells", "indicator": grid.digest}
    return counted(lambda count: sample(query, grid, count, rng), truth, volume.query, int(samples), None, **reported)


# --- learning half-spaces ---------------------------------------------------------------------------------------------

SIDES = {2: 64, 3: 12, 4: 4}  # by dimension: directions along an edge of a cube's face, of those that set faces
ENDS, FARTHEST = 150, 64  # points where rays begin or end; positive rays that set each normal, between two refreshes
TILTS = (1.0, 0.6, 1.6)  # weights of u relative to those of a in the first half-spaces around planes


def learned_normals(grid: Any, support: Support, *, seed: int, seconds: float, steps: int | None) -> np.ndarray:
    """``(k, 2 n)`` normals, the paper's OurkDOP: of ``kdop``'s and learned ones the best by negatives inside."""
    import torch

    from warp_bounding.training import learned_kdop as train
    from warp_bounding.training.engine import Clock, interrupts, single_threaded_torch

    domain, rng, problem = support.domain, np.random.default_rng(seed), _problem_of(support)
    truth, found, count, total = oracle(domain.query, grid, "cpu", domain.oracle_length), [], 0, 0
    while count < train.FEW * train.SAMPLES and total < train.MOST_SAMPLES:
        x = sample(domain.query, grid, train.SAMPLES, rng)
        found.append(x[~truth(x)])
        count, total = count + len(found[-1]), total + train.SAMPLES
    negatives = train.tensor(to_local(domain, np.concatenate(found) if count else x[:64]))
    clock, generator = Clock(seconds, steps, None), torch.Generator().manual_seed(seed)
    directions = kdop_directions(problem.columns) / v_per_unit(domain)
    classic, best = np.concatenate([directions, -directions]), []
    start = train.of_length_1(train.tensor(classic))

    def learn() -> None:
        for index in range(train.STARTS):
            normals = start + train.JITTER * torch.randn(start.shape, generator=generator)
            normals = problem.start(len(start), generator) if index % 2 == 1 else normals
            best.append((np.inf, start))
            share = ((index + 1) / train.STARTS, index / train.STARTS)
            train.descend(problem, negatives, train.of_length_1(normals), clock, share, generator, best)
            if clock.fraction() >= 1:
                break

    with single_threaded_torch():
        interrupts(learn)
    best.sort(key=lambda pair: pair[0])
    tried = [classic, *(normals.double().numpy() for _, normals in best[: train.FINALISTS])]
    v = negatives.double().numpy()
    return min(tried, key=lambda normals: float((v @ normals.T <= support(normals)).all(axis=1).mean()))


def _problem_of(support: Support) -> Any:
    """Half-spaces in R^2n, whose faces, which steer the search only, depend on the kind of region."""
    import torch

    from warp_bounding.training.learned_kdop import HalfSpaceProblem, tensor

    n, limit, u = support.ndim, tensor(support.limit), Patches.cover(support.ndim, SIDES.get(support.ndim, 3)).centers

    class Boxes(HalfSpaceProblem):
        def __init__(self):
            self.domain, self.support, self.columns = support.domain, support, 2 * n
            self.points = tensor(support.points)

        def offsets(self, normals):
            x, y = normals.chunk(2, dim=1)
            free = (-x).clamp(min=0) + y.clamp(min=0)
            return super().offsets(x.clamp(min=0) - (-y).clamp(min=0)) + free @ limit

    class Rays(Boxes):  # faces are set by the farthest of many extreme positives, which begin or end at the object
        def __init__(self):
            super().__init__()
            points = support.points
            if len(points) > ENDS:
                points = points[np.random.default_rng(0).choice(len(points), ENDS, replace=False)]
            p, w = (z.reshape(-1, n) for z in np.broadcast_arrays(points[:, None], (u * support.stretch)[None]))
            with np.errstate(divide="ignore", invalid="ignore"):
                exits = np.where(w == 0, np.inf, (p + np.sign(w) * support.limit) / w)
            back = np.minimum(exits.min(axis=1), 1)[:, None]
            ends = [np.concatenate([p - t * w, w], axis=1) for t in (0 * back, back)]
            self.points = self.all_points = tensor(np.concatenate(ends))

        def refresh(self, normals):
            near = [(self.all_points @ m).topk(min(FARTHEST, len(self.all_points))).indices for m in normals.detach()]
            self.points = self.all_points[torch.cat(near).unique()]

        def offsets(self, normals):
            return HalfSpaceProblem.offsets(self, normals)

    class Planes(Boxes):  # for each of many u the highest a is known, a linear program of n + 1 candidates
        def __init__(self):
            super().__init__()
            self.u, self.local = tensor(u), tensor(u / support.scale)
            self.high, self.low = (tensor(support.hull(side * u / support.scale)) for side in (1, -1))
            self.safe = torch.where(self.local.abs() < 1e-4, torch.full_like(self.local, 1e4), self.local)

        def start(self, count, generator):  # planes that cut off a corner of the domain, from either side
            corners = torch.tensor([[1.0 - 2.0 * k for k in row] for row in np.ndindex((2,) * n)])
            index = torch.arange(count)
            side, corner = 1.0 - 2.0 * (index // len(corners) % 2), corners[index % len(corners)]
            tilt = torch.tensor(TILTS)[index // (2 * len(corners)) % len(TILTS)]
            first = torch.cat([corner * (side * tilt)[:, None], corner], dim=1)
            return first + 0.05 * torch.randn(count, 2 * n, generator=generator)

        def offsets(self, normals):
            x, y = normals.chunk(2, dim=1)
            kinks = y[:, None] / self.safe  # (k, J, n)
            kinks = torch.cat([kinks, torch.zeros_like(kinks[:, :, :1])], dim=2)
            rest = (y[:, None, None] - kinks[..., None] * self.local[:, None]).abs() @ limit
            hull = torch.maximum(kinks * self.high[:, None], -kinks * self.low[:, None])
            return ((rest + hull).amin(dim=2) + x @ self.u.T).amax(dim=1)

    return {"box": Boxes, "ray": Rays, "plane": Planes}[support.domain.query]()
