"""Do planes meet a dilated mesh? For certain, or undecided where rounding could have made the difference.

A plane meets the object exactly if it comes within the margin of a face: it is unbounded, so it does not lie inside
without a crossing of the surface. Of a face only the least and the greatest height of its corners over the plane count.
"""

import warp as wp

from warp_bounding.indicators.shape import IN, OUT, UNDECIDED
from warp_bounding.indicators.triangles.answers import LIMIT, Mesh
from warp_bounding.indicators.triangles.arithmetic import largest, rounding_slack
from warp_bounding.indicators.triangles.hierarchy import Triangles, corner, wide

__all__ = ["decide_planes"]

SHORTEST, LONGEST = 2.0**-200, 2.0**200  # of a normal that is computed with

_SHORTEST, _LONGEST = wp.constant(wp.float64(SHORTEST)), wp.constant(wp.float64(LONGEST))
_LIMIT = wp.constant(wp.float64(LIMIT))
_HALF = wp.constant(wp.float64(0.5))
_IN, _OUT, _UNDECIDED = wp.constant(IN), wp.constant(OUT), wp.constant(UNDECIDED)


@wp.func
def _passes(t: Triangles, node: int, normal: wp.vec3d, point: wp.vec3d, margin: wp.float64) -> bool:
    """Could the plane come within the margin of a node's box?"""
    low, high = wide(t.lower[node]) - point, wide(t.upper[node]) - point
    slack = rounding_slack(low, high, high, high, margin)
    height = wp.dot(normal, low * _HALF + high * _HALF)
    reach = wp.dot(wp.abs(normal), (high - low) * _HALF + wp.vec3d(slack, slack, slack)) + margin * wp.length(normal)
    return wp.abs(height) <= reach


@wp.func
def _decide(t: Triangles, normal: wp.vec3d, point: wp.vec3d, margin: wp.float64) -> int:
    reach = margin * wp.length(normal)
    size = wp.abs(normal[0]) + wp.abs(normal[1]) + wp.abs(normal[2])
    answer, node = wp.int32(_OUT), wp.int32(0)
    while node < t.count:
        if _passes(t, node, normal, point, margin):
            link = t.links[node]
            for i in range(link[0], link[1]):
                a, b, c = corner(t, i, 0, point), corner(t, i, 1, point), corner(t, i, 2, point)
                room = rounding_slack(a, b, c, a, margin) * size
                pa, pb, pc = wp.dot(normal, a), wp.dot(normal, b), wp.dot(normal, c)
                least, most = wp.min(pa, wp.min(pb, pc)), wp.max(pa, wp.max(pb, pc))
                if least <= reach - room and most >= room - reach:
                    return _IN
                if least <= reach + room and most >= -(reach + room):
                    answer = _UNDECIDED
            node += 1
        else:
            node = t.links[node][2]
    return answer


@wp.kernel(enable_backward=False)
def decide_planes(
    first: int,
    # inputs
    m: Mesh,
    normals: wp.array(dtype=wp.vec3d),
    points: wp.array(dtype=wp.vec3d),
    # outputs
    answers: wp.array(dtype=wp.uint8),
):
    """Does a plane meet the object? One without a normal, or with numbers that are not finite, does not."""
    i = first + wp.tid()
    normal, point = normals[i], points[i]
    length = largest(normal)
    answer = _OUT
    if length > _SHORTEST and length < _LONGEST and largest(point) < _LIMIT:
        answer = _decide(m.faces, normal, point, m.margin)
    elif wp.isfinite(normal) and wp.isfinite(point) and length > wp.float64(0.0):
        answer = _UNDECIDED
    answers[i] = wp.uint8(answer)
