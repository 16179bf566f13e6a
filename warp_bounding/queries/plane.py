"""Plane queries: 2n numbers, a normal (of any length but zero) and a point in object space: a whole hyperplane.

A plane meets a connected closed set exactly if it meets its convex hull: if the signed distances of the hull's
vertices do not all have one sign (the hyperplane separation theorem). So the kernel asks each connected component of
the closed cells: first its bounding box, then the least and the greatest ``normal . (vertex - point)`` of its
``hull_corners``, in float64 with an error bound. Planes along the axes compare one coordinate, exactly; of the others
those closer to a sign change than the bound are looked at again corner by corner (a plane through its own point, a
corner, is then decided), and what is left goes to integers on the host. Many small components are slower, not wrong.

Planes: ``v = (m, c)``, all y with ``m . y = c``; the entry of m that is largest in absolute value is exactly 1.

That is n + 1 numbers in local space. The normals m lie on the faces of a cube, and each plane has one pair (m, c), not
two.
"""

from fractions import Fraction

import numpy as np

from warp_bounding.geometry import components
from warp_bounding.queries.base import (
    DIRECTION_LARGEST,
    DIRECTION_SMALLEST,
    FAR,
    FARTHEST_SUM,
    GUARD,
    SUMMED,
    WorldMap,
)
from warp_bounding.queries.directions import (
    FAR_POINT,
    MOVING,
    SLOPE,
    STEEPEST,
    alpha_beta,
    far_point_error,
    hard_directions,
    hard_lengths,
    origin_rounding,
    tilt,
)
from warp_bounding.queries.domain import GROWTH, Domain
from warp_bounding.queries.exact import RELATIVE_ERROR, cell_coordinates, integers, rational_map
from warp_bounding.queries.point import POINT
from warp_bounding.queries.ray import DirectedQuery
from warp_bounding.rounding import TINY, UNIT32, gamma, round_up
from warp_bounding.runtime.native import constants, literal, native_text
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.shape import Shape

text = native_text("truth.h")
AWAY = 8.0  # a hard plane's given point is up to so many times as far from the object's as a random point of the domain
TANGENT = 0.6  # share of the hard planes of a grid that are tangent to a hull, or nearly
SMALLEST_STEP = 26  # these are a quarter to 2^-26 of a cell from being tangent
AT_ONCE = 1024  # tangents that are laid to one component's hull
LANES = 8  # hull corners that one vector instruction takes
GROUPS = 4  # groups of LANES corners after which the kernel looks whether it knows enough


def _outermost_first(corners: np.ndarray) -> np.ndarray:
    """The corners, those that are extreme along an axis or a diagonal first: so most planes are decided early."""
    n = corners.shape[1]
    diagonals = 2 * np.array(list(np.ndindex((2,) * n))) - 1
    reach = corners @ np.concatenate([diagonals, np.eye(n, dtype=int), -np.eye(n, dtype=int)]).T
    first = np.unique(reach.argmax(axis=0))
    return np.concatenate([corners[first], np.delete(corners, first, axis=0)])


# what the texts of ``directions`` read
_PLACES = "enum { POINT_AT = AXES, DIRECTION_AT = 0, MATRIX_AT = 2 * AXES + AXES * AXES };\n"


class PlaneQuery(DirectedQuery):
    """Plane queries."""

    name = "plane"
    decider = "decide_planes"
    every = "every plane: any normal, given by any of its points"
    hard_positives = (
        "planes through its points, mostly on faces, edges and corners of boundary cells, given by that point or one "
        "as far as several domains away"
    )
    oracle_body = constants(LANES=LANES, GROUPS=GROUPS) + text.PLANE

    def truth(self, grid: Grid, q: np.ndarray, length: float = 1.0, cells: np.ndarray | None = None) -> np.ndarray:
        n, truth = grid.ndim, self.valid(q)
        cells = (grid.occupied if cells is None else cells).astype(object)
        for index in np.flatnonzero(truth):
            scales = [Fraction(float(s)) for s in grid.cells_per_unit]
            normal, _ = integers([Fraction(float(v)) / s for v, s in zip(q[index, :n], scales, strict=True)])
            point, unit = integers([*rational_map(grid, q[index, n:]), Fraction(1, 2)])
            middle = 2 * (sum(m * (cells[:, k] * unit - point[k]) for k, m in enumerate(normal)))
            reach = sum(abs(m) for m in normal) * unit  # |normal|_1 is twice that of half a cell, as middle is doubled
            truth[index] = (abs(middle) <= reach).any()
        return truth

    def near(self, grid: Grid, q: np.ndarray) -> np.ndarray:
        cells, n = grid.occupied, grid.ndim
        t, _ = cell_coordinates(grid, q[n:])
        m = q[:n].astype(np.float64) / grid.cells_per_unit
        error = RELATIVE_ERROR * (np.abs(m) * (np.abs(t) + np.array(grid.shape) + 1)).sum()
        return cells[np.abs(cells @ m - t @ m) <= np.abs(m).sum() / 2 + error]

    def arrays(self, grid: Grid) -> dict[str, np.ndarray]:
        parts = components(grid.occupancy)
        lanes = []
        for part in parts:
            corners = _outermost_first(part.corners)
            corners = np.concatenate([corners, corners[[0] * (-len(corners) % LANES)]])
            lanes.append(np.moveaxis(corners.reshape(-1, LANES, grid.ndim), 1, 2) - 0.5)
        groups = np.cumsum([0, *(len(part) for part in lanes)])
        bounds = np.stack([np.stack([part.lower - 0.5, part.upper + 0.5]) for part in parts])
        return {"map": bounds, "indices": groups, "numbers": np.concatenate(lanes)}

    def barely(self, grid: Grid, p: np.ndarray, rng: np.random.Generator, length: float, outside: bool) -> np.ndarray:
        d = hard_directions(p.shape, rng)
        away = POINT.sample(grid, len(p), rng) - p  # another point of the same plane
        away -= (away * d).sum(axis=1, keepdims=True) * d
        chosen, far = rng.random((len(p), 1)), rng.uniform(1.0, AWAY if outside else 1.0, (len(p), 1))
        away *= np.where(chosen < 0.5, 0.0, np.where(chosen < 0.75, 1.0, far))
        return np.concatenate([d * hard_lengths(len(p), rng), p + away], axis=1)

    def hardest(
        self, grid: Shape, p: np.ndarray, rng: np.random.Generator, length: float, hulls: list[np.ndarray]
    ) -> np.ndarray:
        """Of a grid most are tangent to a component's hull, or a little inside of that."""
        q, n = super().hardest(grid, p, rng, length, hulls), grid.ndim
        tangent = np.flatnonzero(rng.random(len(q)) < TANGENT) if hulls else []
        for part in np.array_split(tangent, 1 + len(tangent) // AT_ONCE):
            if len(part):
                corners = hulls[rng.integers(len(hulls))]
                d = q[part, :n] / np.linalg.norm(q[part, :n], axis=1, keepdims=True)
                inwards = np.exp2(-rng.uniform(2, SMALLEST_STEP, (len(part), 1))) / grid.cells_per_unit.max()
                inwards = np.where(rng.random(inwards.shape) < 0.4, 0.0, inwards)
                best = corners[(d @ corners.T).argmax(axis=1)] - inwards * d
                q[part, n:] += ((best - q[part, n:]) * d).sum(axis=1, keepdims=True) * d
        return q

    def hulls(self, grid: Grid) -> list[np.ndarray]:
        return [grid.position(part.corners - 0.5) for part in components(grid.occupancy)]

    # --- the map to coordinates v ------------------------------------------------------------------------------------

    directed, ends = (True, False), ((False, False), (False, False))  # one through any point may meet the object
    placed_text = _PLACES + MOVING
    map_text = f"""{_PLACES}{FAR_POINT}
V e[AXES], d[AXES];  // the normal in local space, and |e|, whose largest entry is the pivot
for (int k = 0; k < AXES; ++k) {{
    e[k] = q[k] * extra[k];
    d[k] = e[k] < zero ? -e[k] : e[k];
}}
V pivot = e[0], longest = d[0];
for (int k = 1; k < AXES; ++k) {{
    pivot = d[k] > longest ? e[k] : pivot;
    longest = d[k] > longest ? d[k] : longest;
}}
// A subnormal q[k] may be flushed to 0, which errs by less than TINY * widest; longest is at least SMALLEST * widest.
float widest = 1.0f;
for (int k = 0; k < AXES; ++k) widest = extra[k] > widest ? extra[k] : widest;
testable = testable & (longest >= zero + {literal(DIRECTION_SMALLEST)} * widest);
testable = testable & (longest <= {literal(DIRECTION_LARGEST)});
pivot = longest > zero ? pivot : zero + 1.0f;
V offset = zero, summed = zero, reach = zero;
for (int k = 0; k < AXES; ++k) {{
    v[k] = wb_over(e[k], pivot);
    const V part = v[k] * a[k];
    offset = offset + part;
    summed = summed + (part < zero ? -part : part);
    reach = reach + (v[k] < zero ? -v[k] : v[k]) * limit[k];
}}
v[AXES] = offset;
const V away = offset < zero ? -offset : offset;
V room = reach * {literal(1 + GUARD)} + summed * {literal(SUMMED)};
if (PLACED) room = room + beyond * place[AXES + AXES * AXES];
inside = away <= room;
testable = testable & (distance <= {literal(FARTHEST_SUM)}) & ((distance <= {literal(FAR)}) | (away > room));
if (TIME) {{  // a plane of constant time, outside the range
    V still = zero;
    for (int k = 1; k < AXES; ++k) still = still + d[k];
    testable = testable & ((still > zero) | (size[0] <= zero + extra[AXES]));
}}
"""

    def coordinates(self, n: int) -> int:
        return n + 1

    def limit(self, domain) -> np.ndarray:
        n, base = domain.base.ndim, domain.base.limit.astype(np.float64)
        # The largest |offset| that passes the kernel's test: its reach is at most the sum of limits, its summed at most
        # FAR, since |m| <= 1 on every axis; gamma covers what the test itself rounds.
        offset = (base.sum() * (1 + GUARD) + FAR * SUMMED) * (1 + gamma(2 * n + 16))
        return np.concatenate([np.ones(n, np.float32), [round_up(offset)]]).astype(np.float32)

    def delta(self, domain) -> np.ndarray:
        # m counts as exact: what it rounds is charged to the offset, on which |m| <= 1 bounds each axis' share
        return np.concatenate([np.zeros(domain.base.ndim), [domain.base.delta.sum()]])

    def to_local(self, domain, q: np.ndarray) -> np.ndarray:
        n, base = domain.base.ndim, domain.base
        normal = q[:, :n] / base.scale.astype(np.float64)
        pivot = np.argmax(np.abs(normal), axis=1)
        normal = normal / normal[np.arange(len(q)), pivot][:, None]
        return np.concatenate([normal, (normal * base.to_local(q[:, n:])).sum(axis=1, keepdims=True)], axis=1)

    def to_object(self, domain, v: np.ndarray) -> np.ndarray:
        n, base = domain.base.ndim, domain.base
        normal = v[:, :n]
        foot = normal * (v[:, n:] / (normal * normal).sum(axis=1, keepdims=True))
        return np.concatenate([normal * base.scale.astype(np.float64), base.to_object(foot)], axis=1)

    def extra(self, domain) -> np.ndarray:
        return (1 / domain.base.scale.astype(np.float64)).astype(np.float32)

    def rounding(self, base: Domain, length: float | None) -> np.ndarray:
        # The offset m . a: entries of m are off by gamma(7), of which 2 are float64 input's, and by numbers that are
        # subnormal or flushed; products and sum by gamma(n + 2).
        n, limit = base.ndim, base.limit.astype(np.float64)
        tilt = (gamma(7) + 4 * TINY / DIRECTION_SMALLEST) * (FAR * (1 + gamma(4)) + limit.sum()) + (2 * n + 4) * TINY
        origin = origin_rounding(base).sum() * (1 + gamma(8))
        return np.full(n, float(tilt + gamma(n + 2) * FAR * (1 + gamma(8)) + origin))

    def placed_values(self, domain, world: WorldMap) -> list[np.ndarray]:
        base, scale = domain.base, domain.base.scale.astype(np.float64)
        _, beta = alpha_beta(base, world, UNIT32)
        drift = np.full(base.ndim, float((scale * beta).sum() + tilt(base, world, UNIT32).max()) * SLOPE)
        return [round_up(drift), world.forward.T.reshape(-1)]

    def placed_rounding(self, domain, world: WorldMap, input_unit: float) -> np.ndarray:
        base = domain.base
        point_error, farthest = far_point_error(base, world, input_unit)
        tau = tilt(base, world, input_unit)
        if not (np.isfinite(farthest) and tau.max() < STEEPEST):
            return np.full(base.ndim, np.inf)
        limit = base.limit.astype(np.float64)
        offset_error = float(point_error.sum() + (tau @ limit + tau.max() * farthest) / (1 - tau.max()))
        return (np.full(base.ndim, offset_error) * (1 + 4 * UNIT32) + TINY) * GROWTH


PLANE = PlaneQuery()
