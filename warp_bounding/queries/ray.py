"""Ray queries: 2n numbers, an origin o and a direction d in object space: the segment o + t d / |d|, 0 <= t <= length.

The kernel walks the slabs of cells across the segment's steepest axis. Inside a slab every other coordinate moves by
at most one cell, so a few cells are looked at; the Chebyshev distance of a cell to the nearest occupied one says how
many slabs hold nothing and are jumped over. Which cells are looked at is rounded outwards; an occupied one is then
*certainly* met, certainly not, or too close to say, by the parameters at which the segment passes the cell's faces.
These are differences and quotients of exactly known numbers, so their relative error is a few roundings, and zeros are
exact: an axis-parallel ray along a face is decided in the kernel. What is too close goes to integers on the host
(``truth``), where the end of the segment is compared as t^2 |d|^2 <= length^2, without a root; the rounding of the
kernel's own root is within its relative error.

Rays: ``v = (a, w)``, 2n numbers in local space: the segment ``a + t w``, 0 <= t <= 1.

a is the origin, and w the displacement over the ray's whole length. Kernels replace an origin outside the domain by
the point where the ray enters the domain, and keep w. The tested segment then begins later and ends as much beyond the
ray's end: it holds the part of the ray inside the domain and more, so the answer stays conservative. ``to_local``,
which makes samples and serves tests, does not move the origin.
"""

from fractions import Fraction
from math import prod

import numpy as np

from warp_bounding.queries.base import FAR, FARTHEST_SUM, GUARD, LATER, PARALLEL, Query, WorldMap, direction_rounding
from warp_bounding.queries.directions import (
    FAR_POINT,
    MOVING,
    SLOPE,
    STEEPEST,
    UNIT,
    alpha_beta,
    far_point_error,
    hard_directions,
    hard_lengths,
    nudged_directions,
    origin_rounding,
    sample_directions,
    turn,
)
from warp_bounding.queries.domain import GROWTH, Domain
from warp_bounding.queries.exact import RELATIVE_ERROR, cell_coordinates, integers, rational_map
from warp_bounding.queries.point import POINT
from warp_bounding.rounding import TINY, UNIT32, gamma, round_up
from warp_bounding.runtime.native import literal
from warp_bounding.shapes.grid import Grid

AT_END, AT_START = 0.3, 0.2  # shares of the hard rays that end, and that begin, at their point of the object
ALMOST = 1 - 2e-7  # of the length: a ray that ends at a point still reaches it after its numbers are rounded to float32
FROM_OUTSIDE = 0.5  # share of the hard rays with an origin outside the domain that keep it; others begin at their point
MOST_JUMP = 32  # cells that one jump may cover: more would cost more passes over the grid than it saves


def empty_distance(occupancy: np.ndarray) -> np.ndarray:
    """uint8, of each cell: the largest distance on an axis, in cells, to the nearest occupied one, or ``MOST_JUMP``."""
    from scipy import ndimage

    return np.minimum(ndimage.distance_transform_cdt(~occupancy, metric="chessboard"), MOST_JUMP).astype(np.uint8)


# See ``exact.loop_snippet``. Names that end in _sure are rounded inwards, those in _most outwards.
_BODY = """
const auto distance = cells.data;  // empty_distance: 0 in an occupied cell, else cells to the nearest one
const auto larger = [](double a, double b) { return a > b ? a : b; };
const auto smaller = [](double a, double b) { return a < b ? a : b; };
double v[N], inverse[N], ratio[N];
Coordinate o[N];
int size[N], stride[N], first[N], last[N], cell[N];
double square = 0.0, fastest = 0.0, largest = 0.0;
int steepest = 0;
for (int k = N - 1, step = 1; k >= 0; --k) {
    o[k] = Coordinate(q[k], map.data[k], map.data[N + k]);
    v[k] = (double)q[N + k] * map.data[k];
    square += (double)q[N + k] * (double)q[N + k];
    size[k] = (int)map.data[2 * N + k];
    stride[k] = step;
    step *= size[k];
    if (fabs(v[k]) > fastest) fastest = fabs(v[k]), steepest = k;
    if (fabs(o[k].t) + size[k] > largest) largest = fabs(o[k].t) + size[k];
}
if (!(fastest > 0.0)) break;
{   // the steepest axis comes first
    const Coordinate c = o[0]; o[0] = o[steepest]; o[steepest] = c;
    const double e = v[0]; v[0] = v[steepest]; v[steepest] = e;
    int i = size[0]; size[0] = size[steepest]; size[steepest] = i;
    i = stride[0]; stride[0] = stride[steepest]; stride[steepest] = i;
}
// the parameter s is the distance along the steepest axis, in cells
const double s_length = length * fastest / sqrt(square);
double s_first = 0.0, s_last = s_length + s_length * rho;
bool outside = false;
for (int k = 0; k < N; ++k) {
    if (v[k] == 0.0) {
        outside |= !(o[k].hi >= 0.0 && o[k].lo < size[k]);
        first[k] = o[k].lo > 0.0 && o[k].lo < size[k] ? (int)o[k].lo : 0;
        last[k] = o[k].hi >= 0.0 && o[k].hi < size[k] ? (int)o[k].hi : size[k] - 1;
        inverse[k] = ratio[k] = 0.0;
        continue;
    }
    inverse[k] = fastest / v[k];
    ratio[k] = v[k] / fastest;
    const double u0 = o[k].to(-0.5) * inverse[k], u1 = o[k].to(size[k] - 0.5) * inverse[k];
    const double a = v[k] > 0.0 ? u0 : u1, b = v[k] > 0.0 ? u1 : u0;
    s_first = larger(s_first, a - fabs(a) * rho);
    s_last = smaller(s_last, b + fabs(b) * rho);
}
if (outside || !(s_first <= s_last)) break;
if (!(largest < 0x1p36)) { answer = 2; break; }  // position_error would reach 2^-8 of a cell
// positions y = t + s ratio, s in [s_first, s_last], are wrong by under 20 roundings of 2 * largest
const double position_error = 0x1p-44 * (largest + 1.0);
const int sign = v[0] > 0.0 ? 1 : -1;
const double y_first = o[0].t + sign * s_first, y_last = o[0].t + sign * s_last;
const double i_first = sign > 0 ? ceil(y_first - position_error - 0.5) : floor(y_first + position_error + 0.5);
const double i_last = sign > 0 ? floor(y_last + position_error + 0.5) : ceil(y_last - position_error - 0.5);
const int begin_slab = i_first < 0.0 ? 0 : i_first > size[0] - 1 ? size[0] - 1 : (int)i_first;
const int end_slab = i_last < 0.0 ? 0 : i_last > size[0] - 1 ? size[0] - 1 : (int)i_last;
const double certain_length = s_length - s_length * rho;
for (int left = (end_slab - begin_slab) * sign, slab = begin_slab; left >= 0 && answer != 1; ) {
    const double s_middle = ((double)slab - o[0].t) * sign;
    int index = slab * stride[0];
    for (int k = 1; k < N; ++k) {
        const double y = floor(o[k].t + s_middle * ratio[k] + 0.5);
        index += (y < 0.0 ? 0 : y > size[k] - 1 ? size[k] - 1 : (int)y) * stride[k];
    }
    // Until slab j ahead (this one: 0) is left, y moves by at most j + 1/2 cells, so the ray meets cells at most j + 1 from
    // the one at its middle here: distance - 1 slabs hold nothing. A y that is cut off at the border only comes nearer.
    const int jump = distance[index] - 1;
    if (jump > 0) { left -= jump; slab += sign * jump; continue; }
    const double s0 = larger(s_first, s_middle - 0.5), s1 = smaller(s_last, s_middle + 0.5);
    bool none = false;
    for (int k = 1; k < N; ++k) {
        if (v[k] != 0.0) {
            const double y0 = o[k].t + s0 * ratio[k], y1 = o[k].t + s1 * ratio[k];
            const double lo = ceil(smaller(y0, y1) - position_error - 0.5);
            const double hi = floor(larger(y0, y1) + position_error + 0.5);
            none |= !(hi >= 0.0 && lo < size[k]);
            first[k] = lo > 0.0 && lo < size[k] ? (int)lo : 0;
            last[k] = hi >= 0.0 && hi < size[k] ? (int)hi : size[k] - 1;
        }
        cell[k] = first[k];
    }
    cell[0] = slab;
    while (!none) {
        int at = 0;
        for (int k = 0; k < N; ++k) at += cell[k] * stride[k];
        if (distance[at] == 0) {
            double a_sure = 0.0, b_sure = certain_length, a_most = 0.0, b_most = s_length + s_length * rho;
            for (int k = 0; k < N; ++k) {
                if (v[k] == 0.0) continue;
                const double u0 = o[k].to(cell[k] - 0.5) * inverse[k], u1 = o[k].to(cell[k] + 0.5) * inverse[k];
                const double a = v[k] > 0.0 ? u0 : u1, b = v[k] > 0.0 ? u1 : u0;
                a_sure = larger(a_sure, a + fabs(a) * rho), a_most = larger(a_most, a - fabs(a) * rho);
                b_sure = smaller(b_sure, b - fabs(b) * rho), b_most = smaller(b_most, b + fabs(b) * rho);
            }
            if (a_sure <= b_sure) { answer = 1; break; }
            if (a_most <= b_most) answer = 2;
        }
        int k = 1;
        for (; k < N; ++k) {
            if (++cell[k] <= last[k]) break;
            cell[k] = first[k];
        }
        none = k >= N;
    }
    left -= 1; slab += sign;
}
"""  # noqa: E501


# what the texts of ``directions`` read
_PLACES = "enum { POINT_AT = 0, DIRECTION_AT = AXES, MATRIX_AT = AXES };\n"


class DirectedQuery(Query):
    """Rays and planes: a point, given from any distance, and a direction without a length of its own."""

    def valid(self, q: np.ndarray) -> np.ndarray:
        direction = np.split(q, 2, axis=1)[self.directed.index(True)]
        return super().valid(q) & (direction != 0).any(axis=1)

    def sample(self, grid: Grid, count: int, rng: np.random.Generator) -> np.ndarray:
        """Point uniform in [0, 1]^n, direction of length 1 up to rounding, by uniform spherical angles."""
        size = count, rng
        parts = [sample_directions(grid.ndim, *size) if each else POINT.sample(grid, *size) for each in self.directed]
        return np.concatenate(parts, axis=1)

    def nudged(self, grid: Grid, x: np.ndarray, move: np.ndarray) -> np.ndarray:
        halves = zip(self.directed, np.split(x, 2, axis=1), np.split(move, 2, axis=1), strict=True)
        return np.concatenate(
            [nudged_directions(a, by) if each else POINT.nudged(grid, a, by) for each, a, by in halves], axis=1
        )

    def extra_count(self, n: int, time: bool) -> int:
        return n + time


class RayQuery(DirectedQuery):
    """Ray queries."""

    name = "ray"
    decider = "decide_segments"
    has_length = True
    every = (
        "every segment o + t d/|d|, 0 <= t <= {length} (object units): any origin o, inside or outside, any direction d"
    )
    hard_positives = (
        "rays that pass, begin or end at such points, mostly on faces, edges and corners of boundary cells, many of "
        "them from outside the domain"
    )
    oracle_body = _BODY
    sampled_point = """
const double along = length * uniform() / size;
for (int k = 0; k < N; ++k) y[k] = (double)q[k] + along * (double)q[N + k];
"""

    def halves(self, q: np.ndarray, length: float) -> list[np.ndarray]:
        """Both ends of segments, the second one rounded to float64."""
        origin, direction = np.split(np.asarray(q, dtype=np.float64), 2, axis=1)
        size = np.linalg.norm(direction, axis=1, keepdims=True)
        return [origin, origin + length * direction / np.where(self.valid(q)[:, None], size, 1.0)]

    def truth(self, grid: Grid, q: np.ndarray, length: float = 1.0, cells: np.ndarray | None = None) -> np.ndarray:
        n, truth = grid.ndim, self.valid(q)
        cells = (grid.occupied if cells is None else cells).astype(object)
        for index in np.flatnonzero(truth):
            d = [Fraction(float(v)) for v in q[index, n:]]
            # With t the origin in cells and c its velocity: origin = t origin_unit, half = origin_unit / 2 and velocity
            # = c velocity_unit are integers. The face at f is met at u = (f - t) / c, the integer start or end times
            # velocity_unit / (common origin_unit).
            origin, origin_unit = integers([*rational_map(grid, q[index, :n]), Fraction(1, 2)])
            half = origin.pop()
            scaled = [v * Fraction(float(s)) for v, s in zip(d, grid.cells_per_unit, strict=True)]
            velocity, velocity_unit = integers(scaled)
            common = prod(abs(v) or 1 for v in velocity)
            start, end, fits = np.zeros(len(cells), dtype=object), None, np.ones(len(cells), dtype=bool)
            for k, v in enumerate(velocity):
                near, far = ((2 * cells[:, k] + side) * half - origin[k] for side in (-1, 1))
                if v == 0:
                    fits &= ((near <= 0) & (far >= 0)).astype(bool)
                    continue
                share = common // v
                a, b = (near * share, far * share) if v > 0 else (far * share, near * share)
                start, end = np.maximum(start, a), b if end is None else np.minimum(end, b)
            # start^2 at most, for u |d| <= length
            end_squared = (
                Fraction(length) ** 2 / sum(v * v for v in d) * Fraction(origin_unit, velocity_unit) ** 2 * common**2
            )
            inside = (start <= end) & (start * start * end_squared.denominator <= end_squared.numerator)
            truth[index] = (fits & inside.astype(bool)).any()
        return truth

    def near(self, grid: Grid, q: np.ndarray) -> np.ndarray:
        """Those that the whole line meets or nearly meets: the kernel's widened test, without its walk."""
        cells, n = grid.occupied, grid.ndim
        t, rest = cell_coordinates(grid, q[:n])
        velocity = q[n:].astype(np.float64) * grid.cells_per_unit
        start, end = np.zeros(len(cells)), np.full(len(cells), np.inf)
        for k in range(n):
            near, far = ((cells[:, k] + side) - t[k] - rest[k] for side in (-0.5, 0.5))
            if velocity[k] == 0:
                start = np.where((near <= 0) & (far >= 0), start, np.inf)
                end = np.where(np.isinf(start), -1.0, end)
                continue
            a, b = (near, far) if velocity[k] > 0 else (far, near)
            a, b = a / velocity[k], b / velocity[k]
            start = np.maximum(start, a - np.abs(a) * RELATIVE_ERROR)
            end = np.minimum(end, b + np.abs(b) * RELATIVE_ERROR)
        return cells[start <= end]

    def arrays(self, grid: Grid) -> dict[str, np.ndarray]:
        return {"cells": empty_distance(grid.occupancy)}

    def barely(self, grid: Grid, p: np.ndarray, rng: np.random.Generator, length: float, outside: bool) -> np.ndarray:
        d = hard_directions(p.shape, rng)
        t = rng.random((len(p), 1)) * length
        chosen = rng.random((len(p), 1))
        t = np.where(chosen < AT_END, length * ALMOST, np.where(chosen < AT_END + AT_START, 0.0, t))
        origin = p - t * d
        stays = ((origin >= grid.lower) & (origin <= grid.upper)).all(axis=1, keepdims=True)
        if outside:
            stays |= rng.random((len(p), 1)) < FROM_OUTSIDE
        return np.concatenate([np.where(stays, origin, p), d * hard_lengths(len(p), rng)], axis=1)

    # --- the map to coordinates v ------------------------------------------------------------------------------------

    directed, ends = (False, True), ((True, True), (False, False))
    placed_text = _PLACES + MOVING
    map_text = f"""{_PLACES}{FAR_POINT}{UNIT}
V w[AXES], enter = zero, leave = zero + 1.0f;  // the parameters t between which the ray is in the widened domain
#pragma unroll
for (int k = 0; k < AXES; ++k) {{
    w[k] = u[k] * extra[k];
    V room = zero + limit[k] + size[k] * {literal(GUARD)};
    if (PLACED) room = room + beyond * place[AXES + AXES * AXES + k];
    const V speed = w[k] < zero ? -w[k] : w[k], cross = speed > {literal(PARALLEL)} ? w[k] : zero + 1.0f;
    const V low = wb_over(-room - a[k], cross), high = wb_over(room - a[k], cross);  // t at the two faces
    // parallel to the faces: between them for all t in [0, 1], or for no t, which the empty interval [2, -1] says
    const V parallel_first = size[k] <= room ? zero : zero + 2.0f;
    const V parallel_last = size[k] <= room ? zero + 1.0f : zero - 1.0f;
    const V first = speed > {literal(PARALLEL)} ? (low < high ? low : high) : parallel_first;
    const V last = speed > {literal(PARALLEL)} ? (low < high ? high : low) : parallel_last;
    enter = first > enter ? first : enter;
    leave = last < leave ? last : leave;
}}
enter = enter * {literal(1 - GUARD)};
leave = leave * {literal(1 + GUARD)};
inside = enter <= leave;
testable = testable & (distance <= {literal(FARTHEST_SUM)}) & ((distance <= {literal(FAR)}) | (enter > leave));
#pragma unroll
for (int k = 0; k < AXES; ++k) {{
    const V top = zero + limit[k], at = a[k] + enter * w[k];
    v[k] = at < -top ? -top : at;
    v[k] = v[k] > top ? top : v[k];
    v[AXES + k] = w[k];
}}
if (TIME) {{
    const V top = zero + extra[AXES] - size[0] * {literal(LATER)}, end = a[0] + w[0];
    testable = testable & ((a[0] <= top) | (end <= top)) & ((a[0] >= -top) | (end >= -top));
}}
"""

    def extra(self, domain) -> np.ndarray:
        return domain.stretch

    def stretch(self, base: Domain, length: float | None) -> np.ndarray:
        with np.errstate(over="ignore"):
            return (base.scale.astype(np.float64) * length).astype(np.float32)

    def rounding(self, base: Domain, length: float | None) -> np.ndarray:
        # The origin moves by enter w, on each axis by no more than FAR, its distance, and 2, the largest limit. That is
        # one product and one sum of a quotient; and enter is early, by the factor 1 - GUARD and by the widened faces.
        moved = (gamma(8) + 3 * GUARD) * (FAR + 2)
        # w itself is off by its direction's rounding, and by that of stretch; at t = 1 all of this counts.
        turned = (direction_rounding(base.ndim) + gamma(4)) * base.scale.astype(np.float64) * length
        return origin_rounding(base) + moved + turned + 4 * TINY

    def placed_values(self, domain, world: WorldMap) -> list[np.ndarray]:
        base, scale = domain.base, domain.base.scale.astype(np.float64)
        _, beta = alpha_beta(base, world, UNIT32)
        return [round_up(scale * (beta + turn(world, base.ndim, UNIT32) / scale.min()) * SLOPE)]

    def placed_rounding(self, domain, world: WorldMap, input_unit: float) -> np.ndarray:
        base, scale = domain.base, domain.base.scale.astype(np.float64)
        point_error, farthest = far_point_error(base, world, input_unit)
        epsilon = turn(world, base.ndim, input_unit)
        if not (np.isfinite(farthest) and epsilon < STEEPEST):
            return np.full(base.ndim, np.inf)
        limit = base.limit.astype(np.float64)
        way = min(domain.length * (1 + 4 * UNIT32), float((limit / scale).sum() + farthest / scale.min()))
        return ((point_error + scale * epsilon * (1 + epsilon) * way) * (1 + 4 * UNIT32) + TINY) * GROWTH


RAY = RayQuery()
