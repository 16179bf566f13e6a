"""What rays and planes share: a point given from any distance, and a direction that has no length of its own.

Where a shape is placed, the point and the direction are both moved from the world into object space. What that rounds
grows with the distance ``|a|_1`` of the point from the domain's centre. Up to ``FAR`` the proof's delta covers it; for
a point from farther away the test against the domain is widened by ``drift |a|_1``, ``drift`` being numbers of the
placement.

The texts below read three constants of the kind (``_PLACES``): where the point and the direction begin in q
(``POINT_AT``, ``DIRECTION_AT``), and where the direction's matrix begins in ``place`` (``MATRIX_AT``; see
``Placement.values``).
"""

import numpy as np

from warp_bounding.arithmetic import gamma
from warp_bounding.coordinates.base import DIRECTION_LARGEST, DIRECTION_SMALLEST, FAR, literal
from warp_bounding.coordinates.domain import Domain, input_rounding

__all__ = ["FAR_POINT", "MOVING", "UNIT", "origin_rounding"]

# The largest entry of a direction, and whether it has a size that directions may have.
POSSIBLE = f"""
const auto largest = [&](const V* e) {{
    V most = zero;
    for (int k = 0; k < AXES; ++k) {{
        const V size = e[k] < zero ? -e[k] : e[k];
        most = size > most ? size : most;
    }}
    return most;
}};
const auto possible = [&](V most) {{
    return (most >= zero + {literal(DIRECTION_SMALLEST)}) & (most <= zero + {literal(DIRECTION_LARGEST)});
}};
"""

# The point in local space: a, |a| by axis, and its distance |a|_1 from the domain's centre. ``beyond`` is that
# distance where it is more than FAR, else 0.
FAR_POINT = f"""
V a[AXES], size[AXES], distance = zero;
for (int k = 0; k < AXES; ++k) {{
    a[k] = (q[POINT_AT + k] - center[k]) * scale[k];
    size[k] = a[k] < zero ? -a[k] : a[k];
    distance = distance + size[k];
}}
const V beyond = distance > {literal(FAR)} ? distance : zero;
"""

# u, the direction with Euclidean length 1. It is divided by its largest entry first, so that squares neither overflow
# nor vanish.
UNIT = f"""{POSSIBLE}
V longest = largest(q + DIRECTION_AT), u[AXES];
testable = testable & possible(longest);
longest = longest > zero ? longest : zero + 1.0f;  // no division by zero in lanes that are maybe
for (int k = 0; k < AXES; ++k) u[k] = over(q[DIRECTION_AT + k], longest);
V squares = u[0] * u[0];
for (int k = 1; k < AXES; ++k) squares = squares + u[k] * u[k];
const V norm = root(squares);
for (int k = 0; k < AXES; ++k) u[k] = over(u[k], norm);
"""

# Move the point by the matrix M, the direction by its own matrix. A direction whose entries are as small as the
# rounding of subnormal numbers, before or after the move, is *maybe*.
MOVING = f"""{POSSIBLE}
V d[AXES], e[AXES];
for (int k = 0; k < AXES; ++k) d[k] = q[POINT_AT + k] - place[k], e[k] = q[DIRECTION_AT + k];
testable = testable & possible(largest(e));
for (int k = 0; k < AXES; ++k) {{
    V moved = d[0] * place[AXES + AXES * k], turned = e[0] * place[MATRIX_AT + AXES * k];
    for (int j = 1; j < AXES; ++j) {{
        moved = moved + d[j] * place[AXES + AXES * k + j];
        turned = turned + e[j] * place[MATRIX_AT + AXES * k + j];
    }}
    q[POINT_AT + k] = moved, q[DIRECTION_AT + k] = turned;
}}
testable = testable & possible(largest(q + DIRECTION_AT));
for (int k = 0; k < 2 * AXES; ++k) testable = testable & ((q[k] - q[k]) == zero);  // an overflow
"""


def origin_rounding(base: Domain) -> np.ndarray:
    """``(n,)``, local units: error of the map to local space for a float64 point with ``|a|_1 <= FAR``."""
    extent = np.full(base.ndim, FAR * (1 + gamma(4)))
    around = extent / base.scale.astype(np.float64)
    return input_rounding(base.center, base.scale, extent, base.center - around, base.center + around)
