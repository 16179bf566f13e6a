"""Points: ``v = (x - center) * scale``, inside where ``|v| <= limit``; see ``domain`` for what that rounds."""

import numpy as np
import warp as wp

from warp_bounding.arithmetic import TINY, UNIT32
from warp_bounding.coordinates.base import Coordinates, Numbers, WorldMap, vector_type
from warp_bounding.coordinates.domain import GROWTH, Domain, rounding_of_map
from warp_bounding.coordinates.placement_rounding import at_points
from warp_bounding.runtime.native import named

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

    def plain(self, n: int, free: int, placed: bool, begin: int) -> wp.Function:
        vector = vector_type(n)

        @named(f"wb_plain_point_{n}_{free:d}_{begin}").func
        def locate(p: Numbers, place: Numbers, q: vector):
            v, testable, inside = vector(), wp.bool(True), wp.bool(True)
            for k in range(n):
                v[k] = (q[k] - p[begin + k]) * p[begin + n + k]
                inside = inside and v[k] <= p[begin + 2 * n + k] and v[k] >= -p[begin + 2 * n + k]
            for k in range(free):  # outside, the object may be anywhere
                testable = testable and v[k] <= p[begin + 2 * n + k] and v[k] >= -p[begin + 2 * n + k]
            return v, testable, inside

        return locate

    def plain_move(self, n: int) -> wp.Function:
        vector = vector_type(n)

        @named(f"wb_plain_move_point_{n}").func
        def move(place: Numbers, q: vector):
            x = vector()
            for k in range(n):
                for j in range(n):
                    x[k] += (q[j] - place[j]) * place[n + n * k + j]
            return x, True

        return move


POINT = PointCoordinates()
