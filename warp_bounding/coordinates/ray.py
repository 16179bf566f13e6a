"""Rays: ``v = (a, w)``, 2n numbers in local space: the segment ``a + t w``, 0 <= t <= 1.

a is the origin, and w the displacement over the ray's whole length. Kernels replace an origin outside the domain by
the point where the ray enters the domain, and keep w. The tested segment then begins later and ends as much beyond the
ray's end: it holds the part of the ray inside the domain and more, so the answer stays conservative. ``to_local``,
which makes samples and serves tests, does not move the origin.
"""

import numpy as np

from warp_bounding.arithmetic import TINY, UNIT32, gamma, round_up
from warp_bounding.coordinates import direction
from warp_bounding.coordinates.base import (
    FAR,
    FARTHEST_SUM,
    GUARD,
    LATER,
    PARALLEL,
    Coordinates,
    WorldMap,
    direction_rounding,
    literal,
)
from warp_bounding.coordinates.domain import GROWTH, Domain
from warp_bounding.coordinates.placement_rounding import SLOPE, STEEPEST, alpha_beta, far_point_error, turn

__all__ = ["RAY"]

# what direction.py's texts read
_PLACES = "constexpr int POINT_AT = 0, DIRECTION_AT = AXES, MATRIX_AT = AXES;\n"


class RayCoordinates(Coordinates):
    """The coordinates of rays."""

    name = "ray"
    directed = (False, True)
    moving = _PLACES + direction.MOVING
    text = f"""{_PLACES}{direction.FAR_POINT}{direction.UNIT}
V w[AXES], enter = zero, leave = zero + 1.0f;  // the parameters t between which the ray is in the widened domain
#pragma unroll
for (int k = 0; k < AXES; ++k) {{
    w[k] = u[k] * extra[k];
    V room = zero + limit[k] + size[k] * {literal(GUARD)};
    if (PLACED) room = room + beyond * place[AXES + AXES * AXES + k];
    const V speed = w[k] < zero ? -w[k] : w[k], cross = speed > {literal(PARALLEL)} ? w[k] : zero + 1.0f;
    const V low = over(-room - a[k], cross), high = over(room - a[k], cross);  // t at the two faces
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

    def extra_count(self, n: int, time: bool) -> int:
        return n + time

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
        return direction.origin_rounding(base) + moved + turned + 4 * TINY

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


RAY = RayCoordinates()
