"""Points: ``v = (x - center) * scale``, inside where ``|v| <= limit``; see ``domain`` for what that rounds."""

import numpy as np

from warp_bounding.arithmetic import TINY, UNIT32
from warp_bounding.coordinates.base import Coordinates, WorldMap
from warp_bounding.coordinates.domain import GROWTH, Domain, rounding_of_map
from warp_bounding.coordinates.placement_rounding import at_points

__all__ = ["POINT"]


class PointCoordinates(Coordinates):
    """The coordinates of points."""

    name = "point"
    directed = (False,)
    text = """
for (int k = 0; k < AXES; ++k) {
    v[k] = (q[k] - center[k]) * scale[k];
    const auto within = (v[k] <= limit[k]) & (v[k] >= -limit[k]);
    inside = inside & within;
    if (k < FREE) testable = testable & within;  // outside, the object may be anywhere
}
"""
    moving = """
V d[AXES];
for (int k = 0; k < AXES; ++k) d[k] = q[k] - place[k];
for (int k = 0; k < AXES; ++k) {
    V x = d[0] * place[AXES + AXES * k];
    for (int j = 1; j < AXES; ++j) x = x + d[j] * place[AXES + AXES * k + j];
    q[k] = x;
}
"""

    def extra_count(self, n: int, time: bool) -> int:
        return 0

    def rounding(self, base: Domain, length: float | None) -> np.ndarray:
        return rounding_of_map(base.limit.astype(np.float64))

    def placed_rounding(self, domain: Domain, world: WorldMap, input_unit: float) -> np.ndarray:
        moved = at_points(domain, world, input_unit) * domain.scale.astype(np.float64) * (1 + 4 * UNIT32)
        return (moved + self.rounding(domain, None) + TINY) * GROWTH


POINT = PointCoordinates()
