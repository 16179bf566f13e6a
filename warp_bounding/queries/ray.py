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
from warp_bounding.runtime.native import literal, native_text
from warp_bounding.shapes.grid import Grid

text = native_text("truth.h")
AT_END, AT_START = 0.3, 0.2  # shares of the hard rays that end, and that begin, at their point of the object
ALMOST = 1 - 2e-7  # of the length: a ray that ends at a point still reaches it after its numbers are rounded to float32
FROM_OUTSIDE = 0.5  # share of the hard rays with an origin outside the domain that keep it; others begin at their point
MOST_JUMP = 32  # cells that one jump may cover: more would cost more passes over the grid than it saves


def empty_distance(occupancy: np.ndarray) -> np.ndarray:
    """uint8, of each cell: the largest distance on an axis, in cells, to the nearest occupied one, or ``MOST_JUMP``."""
    from scipy import ndimage

    return np.minimum(ndimage.distance_transform_cdt(~occupancy, metric="chessboard"), MOST_JUMP).astype(np.uint8)


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
    oracle_body = text.RAY

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
