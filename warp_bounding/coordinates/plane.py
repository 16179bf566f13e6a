"""Planes: ``v = (m, c)``, all y with ``m . y = c``; the entry of m that is largest in absolute value is exactly 1.

That is n + 1 numbers in local space. The normals m lie on the faces of a cube, and each plane has one pair (m, c), not two.
"""

import numpy as np

from warp_bounding.arithmetic import TINY, UNIT32, gamma, round_up
from warp_bounding.coordinates import direction
from warp_bounding.coordinates.base import (
    DIRECTION_LARGEST,
    DIRECTION_SMALLEST,
    FAR,
    FARTHEST_SUM,
    GUARD,
    SUMMED,
    Coordinates,
    WorldMap,
    literal,
)
from warp_bounding.coordinates.domain import GROWTH, Domain
from warp_bounding.coordinates.placement_rounding import SLOPE, STEEPEST, alpha_beta, far_point_error, tilt

__all__ = ["PLANE"]

# what direction.py's texts read
_PLACES = "constexpr int POINT_AT = AXES, DIRECTION_AT = 0, MATRIX_AT = 2 * AXES + AXES * AXES;\n"


class PlaneCoordinates(Coordinates):
    """The coordinates of planes."""

    name = "plane"
    directed = (True, False)
    moving = _PLACES + direction.MOVING
    text = f"""{_PLACES}{direction.FAR_POINT}
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
    v[k] = over(e[k], pivot);
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

    def ndim(self, n: int) -> int:
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

    def extra_count(self, n: int, time: bool) -> int:
        return n + time

    def extra(self, domain) -> np.ndarray:
        return (1 / domain.base.scale.astype(np.float64)).astype(np.float32)

    def rounding(self, base: Domain, length: float | None) -> np.ndarray:
        # The offset m . a: entries of m are off by gamma(7), of which 2 are float64 input's, and by numbers that are
        # subnormal or flushed; products and sum by gamma(n + 2).
        n, limit = base.ndim, base.limit.astype(np.float64)
        tilt = (gamma(7) + 4 * TINY / DIRECTION_SMALLEST) * (FAR * (1 + gamma(4)) + limit.sum()) + (2 * n + 4) * TINY
        origin = direction.origin_rounding(base).sum() * (1 + gamma(8))
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


PLANE = PlaneCoordinates()
