"""Boxes: ``v = (low, high)``, the corners in local space, cut at the domain; a moved box is the one around it."""

import numpy as np

from warp_bounding.arithmetic import TINY, UNIT32
from warp_bounding.coordinates.base import Coordinates, WorldMap
from warp_bounding.coordinates.domain import GROWTH, Domain, input_rounding
from warp_bounding.coordinates.placement_rounding import at_points

__all__ = ["BOX"]


class BoxCoordinates(Coordinates):
    """The coordinates of boxes."""

    name = "box"
    directed = (False, False)
    text = """
for (int k = 0; k < AXES; ++k) {
    const V low = (q[k] - center[k]) * scale[k], high = (q[AXES + k] - center[k]) * scale[k];
    const V top = zero + limit[k], bottom = zero - limit[k];
    testable = testable & (q[k] <= q[AXES + k]);
    const auto within = (low <= top) & (high >= bottom);
    inside = inside & within;
    v[k] = low < bottom ? bottom : low;
    v[k] = v[k] > top ? top : v[k];
    v[AXES + k] = high < bottom ? bottom : high;
    v[AXES + k] = v[AXES + k] > top ? top : v[AXES + k];
    if (TIME && k == 0) testable = testable & (low <= zero + extra[0]) & (high >= zero - extra[0]);
}
"""
    moving = """
V below[AXES], above[AXES];  // the box around the moved one (Arvo 1990)
for (int k = 0; k < AXES; ++k) {
    testable = testable & (q[k] <= q[AXES + k]);
    below[k] = q[k] - place[k], above[k] = q[AXES + k] - place[k];
    testable = testable & ((below[k] - below[k]) == zero) & ((above[k] - above[k]) == zero);
}
for (int k = 0; k < AXES; ++k) {
    V low = zero, high = zero;
    for (int j = 0; j < AXES; ++j) {
        const V s = below[j] * place[AXES + AXES * k + j], t = above[j] * place[AXES + AXES * k + j];
        low = low + (s < t ? s : t);
        high = high + (s < t ? t : s);
    }
    q[k] = low, q[AXES + k] = high;
    testable = testable & ((low - low) == zero) & ((high - high) == zero);  // an overflow
}
"""

    def rounding(self, base: Domain, length: float | None) -> np.ndarray:
        return input_rounding(base.center, base.scale, base.limit.astype(np.float64), base.lower, base.upper)

    def to_local(self, domain, q: np.ndarray) -> np.ndarray:
        limit = domain.limit.astype(np.float64)
        return np.clip(super().to_local(domain, q), -limit, limit)

    def placed_rounding(self, domain, world: WorldMap, input_unit: float) -> np.ndarray:
        base = domain.base
        return (at_points(base, world, input_unit) * base.scale.astype(np.float64) * (1 + 4 * UNIT32) + TINY) * GROWTH


BOX = BoxCoordinates()
