"""Triangles in float64 with error bounds: one against a box or a segment, a hierarchy of many, and its walks."""

from dataclasses import dataclass

import numpy as np
import warp as wp

from warp_bounding.runtime.native import STRICT

# --- One triangle -----------------------------------------------------------------------------------------------------
#
# One triangle against one box, in float64: axes that prove them apart, and the closest point, up to rounding.
#
# A box is certified to be free of a triangle for one reason only: there is an axis on which the triangle and the box,
# grown by a ball of the margin's radius, do not overlap. That is a proof for *any* axis, however it was computed, so
# the search for one may be as careless as it likes and only ``separated`` has to be right. The axes tried are those of
# the separating axis theorem for a box and a triangle (three face normals, the triangle's normal, nine products of
# edges; complete for a margin of 0) and, for a margin, the directions between the closest points of box and triangle
# that alternating projections find (they are missing from the 13 where a corner is closest). A degenerate triangle
# needs no case of its own: its null axes separate nothing.
#
# The box is always |x_k| <= half_k, and the corners a, b, c are relative to its centre. Who asks knows how large they
# are, and gives the ``slack``: a length that outweighs all rounding (``triangles.cells.SLACK`` for cells,
# ``rounding_slack`` for boxes of any size).
#
# Source: Akenine-Moeller, "Fast 3D triangle-box overlap testing" (2001) for the axes.

SHORTEST = 2.0**-400  # axes shorter than this are not used: the squares of their components may underflow
PROJECTIONS = 16  # alternating projections; what is neither near nor proven far by then is left to the axes
# Relative to the largest absolute coordinate M of corners and box and to the margin: with u = 2^-53, for an axis d with
# the sum |d| of its absolute components, float64 errs by less than
#   a corner relative to the centre (one rounding)                              u M |d|
#   its dot product with d, three products and two sums                         3 u M |d|
#   half * |d|, margin * length(d) and their sum                                6 u 2 M |d|
# together less than 2^-49 M |d|; this is 4 times that.
ROUNDING = 2.0**-47
SHORTER = 1.0 - 2.0**-50  # outweighs the rounding of a length and of a division by it, four units
# Largest coordinate under which its cube might underflow: that a triangle crosses a box or a segment is not certain
# there.
SMALLEST = 2.0**-300
LEAST = 2.0**-500  # slack that outweighs underflow: times an axis of SHORTEST it is far above 2^-1074

_SHORTEST = wp.constant(wp.float64(SHORTEST))
_PROJECTIONS = wp.constant(PROJECTIONS)
_ROUNDING = wp.constant(wp.float64(ROUNDING))
_SHORTER = wp.constant(wp.float64(SHORTER))
_LEAST = wp.constant(wp.float64(LEAST))
_NEAR, _FREE, _UNDECIDED = wp.constant(0), wp.constant(1), wp.constant(2)


@wp.func_native(STRICT + "return size;")
def _by_ieee(size: wp.float64) -> wp.float64:  # a kernel that asks for this does not compile without IEEE arithmetic
    ...


@wp.func
def largest(x: wp.vec3d) -> wp.float64:
    """The largest absolute coordinate."""
    return wp.max(wp.abs(x[0]), wp.max(wp.abs(x[1]), wp.abs(x[2])))


@wp.func
def rounding_slack(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, half: wp.vec3d, margin: wp.float64) -> wp.float64:
    """A length that outweighs the rounding of ``separated`` for these numbers, each rounded once."""
    size = wp.max(wp.max(largest(a), largest(b)), wp.max(largest(c), largest(half)))
    return _ROUNDING * wp.max(_by_ieee(size), margin) + _LEAST


@wp.func
def separated(
    d: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, half: wp.vec3d, margin: wp.float64, slack: wp.float64
) -> bool:
    """Is the triangle further than ``margin`` from the box |x_k| <= half_k, as axis d can tell? NaN cannot."""
    size = _by_ieee(wp.abs(d[0]) + wp.abs(d[1]) + wp.abs(d[2]))
    if not size > _SHORTEST:
        return False
    pa, pb, pc = wp.dot(d, a), wp.dot(d, b), wp.dot(d, c)
    reach = wp.dot(half, wp.abs(d)) + slack * size + margin * wp.length(d)
    return wp.min(pa, wp.min(pb, pc)) > reach or wp.max(pa, wp.max(pb, pc)) < -reach


@wp.func
def _edge_separated(
    e: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, half: wp.vec3d, margin: wp.float64, slack: wp.float64
) -> bool:
    """Try the three axes that are products of a triangle's edge with the box's edges."""
    zero = wp.float64(0.0)
    if separated(wp.vec3d(zero, -e[2], e[1]), a, b, c, half, margin, slack):
        return True
    if separated(wp.vec3d(e[2], zero, -e[0]), a, b, c, half, margin, slack):
        return True
    return separated(wp.vec3d(-e[1], e[0], zero), a, b, c, half, margin, slack)


@wp.func
def apart(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, half: wp.vec3d, margin: wp.float64, slack: wp.float64) -> bool:
    """Does one of the 13 axes separate the triangle from the box around 0, grown by the margin?"""
    zero, one = wp.float64(0.0), wp.float64(1.0)
    if separated(wp.vec3d(one, zero, zero), a, b, c, half, margin, slack):
        return True
    if separated(wp.vec3d(zero, one, zero), a, b, c, half, margin, slack):
        return True
    if separated(wp.vec3d(zero, zero, one), a, b, c, half, margin, slack):
        return True
    if separated(wp.cross(b - a, c - a), a, b, c, half, margin, slack):
        return True
    if _edge_separated(b - a, a, b, c, half, margin, slack):
        return True
    if _edge_separated(c - b, a, b, c, half, margin, slack):
        return True
    return _edge_separated(a - c, a, b, c, half, margin, slack)


@wp.func
def closest_on_segment(p: wp.vec3d, a: wp.vec3d, b: wp.vec3d) -> wp.vec3d:
    """Find a point of the segment nearest to p up to rounding."""
    length2 = wp.dot(b - a, b - a)
    if not length2 > wp.float64(0.0):
        return a
    return a + (b - a) * wp.clamp(wp.dot(p - a, b - a) / length2, wp.float64(0.0), wp.float64(1.0))


@wp.func
def closest_on_triangle(p: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d) -> wp.vec3d:
    """Find a point of the triangle, also of a degenerate one, nearest to p up to rounding.

    It is a sum of corners whose weights are at least 0 and sum up to 1, so it lies in the triangle whatever the
    rounding made of the weights, but for a few roundings of the largest coordinate.
    """
    zero = wp.float64(0.0)
    n = wp.cross(b - a, c - a)
    n2 = wp.dot(n, n)
    if n2 > zero:
        u = wp.dot(wp.cross(b - a, p - a), n)
        v = wp.dot(wp.cross(c - b, p - b), n)
        w = wp.dot(wp.cross(a - c, p - c), n)
        area = u + v + w
        if u >= zero and v >= zero and w >= zero and area > zero:
            return a * (v / area) + b * (w / area) + c * (u / area)
    best = closest_on_segment(p, a, b)
    q = closest_on_segment(p, b, c)
    if wp.length_sq(q - p) < wp.length_sq(best - p):
        best = q
    q = closest_on_segment(p, c, a)
    if wp.length_sq(q - p) < wp.length_sq(best - p):
        best = q
    return best


@wp.func
def _side(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, half: wp.vec3d, margin: wp.float64, slack: wp.float64) -> int:
    """Alternating projections: the points tell that the box is near, or their direction proves that it is free."""
    q = closest_on_triangle(wp.vec3d(), a, b, c)
    for _ in range(_PROJECTIONS):
        d = q - wp.vec3d(
            wp.clamp(q[0], -half[0], half[0]), wp.clamp(q[1], -half[1], half[1]), wp.clamp(q[2], -half[2], half[2])
        )
        if wp.length_sq(d) <= margin * margin:
            return _NEAR
        if separated(d, a, b, c, half, margin, slack):
            return _FREE
        q = closest_on_triangle(q - d, a, b, c)
    return _UNDECIDED


@wp.func
def free(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, half: wp.vec3d, margin: wp.float64, slack: wp.float64) -> bool:
    """Is it proven that the triangle is further than the margin from the box around 0?"""
    if margin > wp.float64(0.0):  # the direction decides most boxes at once, the 13 axes those that it leaves
        side = _side(a, b, c, half, margin, slack)
        if side != _UNDECIDED:
            return side == _FREE
    return apart(a, b, c, half, margin, slack)


@wp.func
def segment_separated(
    d: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, s: wp.vec3d, margin: wp.float64, slack: wp.float64
) -> bool:
    """Is the triangle further than ``margin`` from the segment from 0 to s, as axis d can tell? NaN cannot."""
    size = wp.abs(d[0]) + wp.abs(d[1]) + wp.abs(d[2])
    if not size > _SHORTEST:
        return False
    pa, pb, pc, ps = wp.dot(d, a), wp.dot(d, b), wp.dot(d, c), wp.dot(d, s)
    reach = slack * size + margin * wp.length(d)
    zero = wp.float64(0.0)
    return (
        wp.min(pa, wp.min(pb, pc)) > wp.max(ps, zero) + reach or wp.max(pa, wp.max(pb, pc)) < wp.min(ps, zero) - reach
    )


@wp.func
def segment_free(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, s: wp.vec3d, margin: wp.float64, slack: wp.float64) -> bool:
    """Is it proven, by the axes that are complete in general position, that the segment from 0 to s is far enough?"""
    zero, one = wp.float64(0.0), wp.float64(1.0)
    if segment_separated(wp.cross(b - a, c - a), a, b, c, s, margin, slack):
        return True
    if segment_separated(wp.cross(b - a, s), a, b, c, s, margin, slack):
        return True
    if segment_separated(wp.cross(c - b, s), a, b, c, s, margin, slack):
        return True
    if segment_separated(wp.cross(a - c, s), a, b, c, s, margin, slack):
        return True
    if segment_separated(wp.vec3d(one, zero, zero), a, b, c, s, margin, slack):
        return True
    if segment_separated(wp.vec3d(zero, one, zero), a, b, c, s, margin, slack):
        return True
    return segment_separated(wp.vec3d(zero, zero, one), a, b, c, s, margin, slack)


@wp.func
def distance_along(d: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, half: wp.vec3d, slack: wp.float64) -> wp.float64:
    """Lower bound of the distance from the box |x_k| <= half_k to the triangle by axis d; 0 where it cannot tell."""
    size = wp.abs(d[0]) + wp.abs(d[1]) + wp.abs(d[2])
    if not size > _SHORTEST:
        return wp.float64(0.0)
    pa, pb, pc = wp.dot(d, a), wp.dot(d, b), wp.dot(d, c)
    gap = wp.max(wp.min(pa, wp.min(pb, pc)), -wp.max(pa, wp.max(pb, pc)))
    gap -= wp.dot(half, wp.abs(d)) + slack * size
    return wp.max(gap / wp.length(d) * _SHORTER, wp.float64(0.0))


# --- The hierarchy ----------------------------------------------------------------------------------------------------
#
# A hierarchy of boxes over triangles: a balanced binary tree, walked in one direction and without a stack.
#
# Triangles are sorted so that every node of level l holds a stretch of them, halved at the median along the longest
# side of the box around its triangles' centres. Nodes lie in the order in which a walk meets them: a node's first child
# comes right after it, and each node tells where a walk goes on that leaves its children out. So a walk is a loop over
# one number, the same on a CPU and on CUDA. Boxes are those of float32 vertices, so they are exact.

LEAF = 4  # triangles of a leaf at most; 2 and 8 were slower for boxes near a bunny
STEP = 2.0**-22  # relative: twice what rounding a float64 number to float32 may change
TINIEST = 2.0**-140  # and where that is subnormal
WIDER = 1.0 + 2.0**-18  # relative: far more than a squared gap's rounding in float32, 2^-21

_FAR = wp.constant(wp.float64(2.0**127))
_STEP = wp.constant(STEP)
_WIDER = wp.constant(WIDER)
_TINIEST = wp.constant(TINIEST)


@wp.struct
class Triangles:
    """What a kernel walks over. An empty hierarchy has a count of 0."""

    count: int  # nodes
    lower: wp.array(dtype=wp.vec3)  # of the nodes' boxes
    upper: wp.array(dtype=wp.vec3)
    links: wp.array(
        dtype=wp.vec3i
    )  # first triangle, one past the last (none but in leaves), the node after the subtree
    corners: wp.array(dtype=wp.vec3)  # three a triangle
    cycles: wp.array(dtype=wp.uint64)  # of a triangle: see ``surfaces.py``


@wp.func
def float_below(x: wp.float64) -> float:
    """A float32 number, or minus infinity, that is not above x, and near it, where x is under 2^127."""
    y = float(wp.min(x, _FAR))
    return y - (wp.abs(y) * _STEP + _TINIEST)


@wp.func
def float_above(x: wp.float64) -> float:
    """A float32 number, or infinity, that is not below x, and near it, where x is above -2^127."""
    y = float(wp.max(x, -_FAR))
    return y + (wp.abs(y) * _STEP + _TINIEST)


@wp.func
def squared_reach(margin: wp.float64) -> float:
    """A float32 number above the square of the margin, by more than what float32 makes of a squared gap."""
    return float_above(margin * margin) * _WIDER


@wp.func
def _gap(low: wp.vec3, high: wp.vec3, lower: wp.vec3, upper: wp.vec3) -> float:
    """The squared distance of two boxes."""
    gap = wp.max(wp.max(low - upper, lower - high), wp.vec3())
    return wp.dot(gap, gap)


@wp.func
def next_leaf(t: Triangles, start: int, lower: wp.vec3, upper: wp.vec3, reach: float) -> int:
    """Go on with a walk: the first leaf from node ``start`` whose box is near enough, or the number of nodes.

    Args:
        t: The hierarchy.
        start: Where the walk goes on.
        lower: Of the box that is asked about, rounded outwards.
        upper: Of that box.
        reach: ``squared_reach`` of the margin.
    """
    node = wp.int32(start)
    while node < t.count:
        if _gap(t.lower[node], t.upper[node], lower, upper) <= reach:
            if t.links[node][1] > 0:
                return node
            node += 1
        else:
            node = t.links[node][2]
    return node


@wp.func
def near_leaf(t: Triangles, lower: wp.vec3, upper: wp.vec3) -> int:
    """A leaf near a box: from the top, always the child that is nearer. There is at least one triangle."""
    node = wp.int32(0)
    while t.links[node][1] == 0:
        left = node + 1
        right = t.links[left][2]
        node = left
        if _gap(t.lower[right], t.upper[right], lower, upper) < _gap(t.lower[left], t.upper[left], lower, upper):
            node = right
    return node


@wp.func
def wide(x: wp.vec3) -> wp.vec3d:
    """The same numbers in float64."""
    return wp.vec3d(wp.float64(x[0]), wp.float64(x[1]), wp.float64(x[2]))


@wp.func
def corner(t: Triangles, triangle: int, k: int, origin: wp.vec3d) -> wp.vec3d:
    """A triangle's corner, relative to a point: each coordinate is rounded once."""
    return wide(t.corners[3 * triangle + k]) - origin


@wp.func
def floats_below(x: wp.vec3d) -> wp.vec3:
    """``float_below`` of each coordinate."""
    return wp.vec3(float_below(x[0]), float_below(x[1]), float_below(x[2]))


@wp.func
def floats_above(x: wp.vec3d) -> wp.vec3:
    """``float_above`` of each coordinate."""
    return wp.vec3(float_above(x[0]), float_above(x[1]), float_above(x[2]))


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """A built hierarchy.

    Attributes:
        order: ``(F,)`` int, which of the given triangles stands at each place.
        arrays: Of the fields of ``Triangles``, by name.
    """

    order: np.ndarray
    arrays: dict[str, np.ndarray]

    def on(self, device: str | wp.Device) -> Triangles:
        """The struct that kernels take, on a Warp device."""
        types = {"lower": wp.vec3, "upper": wp.vec3, "links": wp.vec3i, "corners": wp.vec3, "cycles": wp.uint64}
        made = Triangles()
        made.count = len(self.arrays["links"])
        for name, dtype in types.items():
            setattr(made, name, wp.array(self.arrays[name], dtype=dtype, device=device))
        return made


def build(corners: np.ndarray, cycles: np.ndarray | None = None) -> Hierarchy:
    """Sort triangles into a hierarchy.

    Args:
        corners: ``(F, 3, 3)`` float32: triangle, corner, coordinate.
        cycles: ``(F,)`` uint64; zeros if ``None``.
    """
    count = len(corners)
    cycles = np.zeros(count, dtype=np.uint64) if cycles is None else cycles
    if count == 0:
        nothing = np.zeros((0, 3), dtype=np.float32)
        empty = {"lower": nothing, "upper": nothing, "links": nothing.astype(np.int32), "corners": nothing}
        return Hierarchy(np.zeros(0, dtype=np.int64), {**empty, "cycles": cycles})
    order = sorted_order(corners.min(axis=1) / np.float32(2) + corners.max(axis=1) / np.float32(2))
    corners = corners[order]
    lower, upper, links = nodes_of(corners.min(axis=1), corners.max(axis=1))
    arrays = {
        "lower": lower,
        "upper": upper,
        "links": links,
        "corners": corners.reshape(-1, 3),
        "cycles": cycles[order],
    }
    return Hierarchy(order, arrays)


def _depth(count: int) -> int:
    """Levels below the root, of a hierarchy of so many triangles."""
    return max(0, int(np.ceil(np.log2(count / LEAF))))


def _edges(count: int, level: int) -> np.ndarray:
    """Where the stretches of a level's nodes begin, and the end."""
    return (np.arange(2**level + 1) * count) >> level


def sorted_order(centres: np.ndarray) -> np.ndarray:
    """``(F,)`` int64: by levels, each node's range is sorted by centres ``(F, n)`` along its box's longest side."""
    order = np.arange(len(centres))
    for level in range(_depth(len(centres))):
        first = _edges(len(order), level)
        node = np.repeat(np.arange(2**level), np.diff(first))
        there = centres[order]
        low, high = np.minimum.reduceat(there, first[:-1]), np.maximum.reduceat(there, first[:-1])
        axis = np.argmax(high - low, axis=1)[node]
        order = order[np.lexsort((there[np.arange(len(order)), axis], node))]
    return order


def nodes_of(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Boxes and links of all nodes, in the order of a walk, for float32 boxes ``(F, n)`` of sorted triangles."""
    depth = _depth(len(low))
    total = 2 ** (depth + 1) - 1
    lower, upper = (np.zeros((total, low.shape[1]), dtype=np.float32) for _ in "lu")
    links = np.zeros((total, 3), dtype=np.int32)
    place = np.zeros(1, dtype=np.int64)
    for level in range(depth + 1):
        first = _edges(len(low), level)
        subtree = 2 ** (depth - level + 1) - 1  # nodes of it
        lower[place] = np.minimum.reduceat(low, first[:-1])
        upper[place] = np.maximum.reduceat(high, first[:-1])
        links[place, 2] = place + subtree
        if level == depth:
            links[place, 0], links[place, 1] = first[:-1], first[1:]
        place = np.stack([place + 1, place + 1 + subtree // 2], axis=1).ravel()
    return lower, upper, links


# --- Walks ------------------------------------------------------------------------------------------------------------

FAR, NEAR, UNSURE = wp.constant(0), wp.constant(1), wp.constant(2)  # answers of ``nearness``


@wp.func
def _leaf_is_free(t: Triangles, leaf: int, centre: wp.vec3d, half: wp.vec3d, margin: wp.float64) -> bool:
    link = t.links[leaf]
    for i in range(link[0], link[1]):
        a, b, c = corner(t, i, 0, centre), corner(t, i, 1, centre), corner(t, i, 2, centre)
        if not free(a, b, c, half, margin, rounding_slack(a, b, c, half, margin)):
            return False
    return True


@wp.func
def box_is_free(t: Triangles, centre: wp.vec3d, half: wp.vec3d, margin: wp.float64) -> bool:
    """Is every triangle proven to be further than the margin from the closed box around the centre?"""
    lower, upper, reach = floats_below(centre - half), floats_above(centre + half), squared_reach(margin)
    leaf = next_leaf(t, 0, lower, upper, reach)
    near = leaf
    if leaf < t.count and margin > wp.float64(0.0):  # a near triangle tells most boxes that are not free at once
        near = near_leaf(t, lower, upper)
    if near < t.count and not _leaf_is_free(t, near, centre, half, margin):
        return False
    while leaf < t.count:
        if not _leaf_is_free(t, leaf, centre, half, margin):
            return False
        leaf = next_leaf(t, leaf + 1, lower, upper, reach)
    return True


@wp.func
def segment_is_free(t: Triangles, start: wp.vec3d, end: wp.vec3d, margin: wp.float64) -> bool:
    """Is every triangle proven to be further than the margin from the closed segment?"""
    lower, upper = floats_below(wp.min(start, end)), floats_above(wp.max(start, end))
    reach, s = squared_reach(margin), end - start
    leaf = next_leaf(t, 0, lower, upper, reach)
    while leaf < t.count:
        link = t.links[leaf]
        for i in range(link[0], link[1]):
            a, b, c = corner(t, i, 0, start), corner(t, i, 1, start), corner(t, i, 2, start)
            if not segment_free(a, b, c, s, margin, rounding_slack(a, b, c, s, margin)):
                return False
        leaf = next_leaf(t, leaf + 1, lower, upper, reach)
    return True


@wp.func
def _leaf_nearness(t: Triangles, leaf: int, x: wp.vec3d, margin: wp.float64) -> int:
    zero = wp.vec3d()
    answer = wp.int32(FAR)
    link = t.links[leaf]
    for i in range(link[0], link[1]):
        a, b, c = corner(t, i, 0, x), corner(t, i, 1, x), corner(t, i, 2, x)
        slack = rounding_slack(a, b, c, zero, margin)
        d = closest_on_triangle(zero, a, b, c)
        if not separated(d, a, b, c, zero, margin, slack):
            if wp.length(d) + slack <= margin:
                return NEAR
            if not free(a, b, c, zero, margin, slack):
                answer = UNSURE
    return answer


@wp.func
def nearness(t: Triangles, x: wp.vec3d, margin: wp.float64) -> int:
    """Is a triangle certainly within the margin of x (NEAR), is each one certainly beyond (FAR), or neither?"""
    lower, upper, reach = floats_below(x), floats_above(x), squared_reach(margin)
    answer = wp.int32(FAR)
    leaf = next_leaf(t, 0, lower, upper, reach)
    if leaf < t.count and margin > wp.float64(0.0):
        near = _leaf_nearness(t, near_leaf(t, lower, upper), x, margin)
        if near == NEAR:
            return NEAR
    while leaf < t.count:
        told = _leaf_nearness(t, leaf, x, margin)
        if told == NEAR:
            return NEAR
        answer = wp.max(answer, told)
        leaf = next_leaf(t, leaf + 1, lower, upper, reach)
    return answer


# --- Rays -------------------------------------------------------------------------------------------------------------
#
# Is a point enclosed by triangles for certain? Rays along the axes count what they cross (``surfaces.py``).
#
# Where faces are turned alike, so that each edge is run through as often one way as the other, the crossings with their
# signs add up to the winding number of the surface around the point, the same along every ray.
#
# Every sign is that of the exact number, or it is unknown, and then so is the answer of the ray.

UNWOUND = 2**30  # instead of a winding number that is not certain

# With u = 2^-53. A difference of two products of coordinates, each rounded once, errs by less than 4 u (|left| +
# |right|). A determinant n a, where n is the product of two edges as computed from coordinates up to M, errs by less
# than 80 u M^2 (|e| + |f|), where |e| and |f| are the edges' largest components. Of coordinates that are known up to a
# length L only, the difference errs by another L (sum of their absolute values + 2 L), and the determinant, the edges
# of which err by 2 L, by less than 18 L (M + L) (|e| + |f| + 8 L). What is added for that is more than 3 times as much.
TURN = 2.0**-50
HEIGHT = 2.0**-46
UNDERFLOW = 2.0**-1000  # outweighs products that are subnormal

_TURN = wp.constant(wp.float64(TURN))
_HEIGHT = wp.constant(wp.float64(HEIGHT))
_UNDERFLOW = wp.constant(wp.float64(UNDERFLOW))
_MORE, _LOOSE = wp.constant(wp.float64(8.0)), wp.constant(wp.float64(64.0))
_INFINITY = wp.constant(float("inf"))
_UNWOUND = wp.constant(UNWOUND)


@wp.func
def _turn(ax: wp.float64, ay: wp.float64, bx: wp.float64, by: wp.float64, loose: wp.float64) -> int:
    """On which side of the line from a to b is 0: 1, -1, or 0 where rounding could have decided?"""
    left, right = ax * by, ay * bx
    size = wp.abs(ax) + wp.abs(ay) + wp.abs(bx) + wp.abs(by)
    room = _TURN * (wp.abs(left) + wp.abs(right)) + _MORE * loose * (size + _MORE * loose) + _UNDERFLOW
    if left - right > room:
        return 1
    if left - right < -room:
        return -1
    return 0


@wp.func
def _above(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, axis: int, turn: int, loose: wp.float64) -> int:
    """Does a line through 0 along an axis cross a triangle of this turn: above 0 (1), below (-1), or unknown (0)?"""
    if wp.min(a[axis], wp.min(b[axis], c[axis])) > loose:
        return 1
    if wp.max(a[axis], wp.max(b[axis], c[axis])) < -loose:
        return -1
    e, f = b - a, c - a
    height = wp.dot(wp.cross(e, f), a)  # the plane's height over 0, times the triangle's turn
    size = wp.max(largest(a), wp.max(largest(b), largest(c))) + loose
    edges = largest(e) + largest(f)
    room = _HEIGHT * size * size * edges + _LOOSE * loose * size * (edges + _MORE * loose) + _UNDERFLOW
    if height > room:
        return turn
    if height < -room:
        return -turn
    return 0


@wp.func
def crossing(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, axis: int, loose: wp.float64) -> int:
    """Does the ray from 0 along an axis cross the triangle in its inside (1), does it miss it (0), or unknown (-1)?

    Args:
        a: A corner, each coordinate rounded once.
        b: Another one.
        c: Another one.
        axis: 0, 1 or 2; the ray goes upwards.
        loose: By how much each coordinate may be wrong beyond that; the answer holds for all that they may be.
    """
    i, j = (axis + 1) % 3, (axis + 2) % 3
    ab = _turn(a[i], a[j], b[i], b[j], loose)
    bc = _turn(b[i], b[j], c[i], c[j], loose)
    ca = _turn(c[i], c[j], a[i], a[j], loose)
    least, most = wp.min(ab, wp.min(bc, ca)), wp.max(ab, wp.max(bc, ca))
    if least < 0 and most > 0:
        return 0
    if least == 0 or most == 0:
        return -1
    side = _above(a, b, c, axis, ab, loose)
    if side == 0:
        return -1
    return wp.max(side, 0)


@wp.func
def _crossed_cycles(t: Triangles, x: wp.vec3d, axis: int) -> wp.uint64:
    """The exclusive or of the numbers of triangles that an axis ray from x crosses; 0 where that is uncertain."""
    lower, upper, reach = floats_below(x), floats_above(x), squared_reach(wp.float64(0.0))
    upper[axis] = _INFINITY
    crossed = wp.uint64(0)
    leaf = next_leaf(t, 0, lower, upper, reach)
    while leaf < t.count:
        link = t.links[leaf]
        for i in range(link[0], link[1]):
            if t.cycles[i] != wp.uint64(0):
                a, b, c = corner(t, i, 0, x), corner(t, i, 1, x), corner(t, i, 2, x)
                crosses = crossing(a, b, c, axis, wp.float64(0.0))
                if crosses < 0:
                    return wp.uint64(0)
                if crosses > 0:
                    crossed = crossed ^ t.cycles[i]
        leaf = next_leaf(t, leaf + 1, lower, upper, reach)
    return crossed


@wp.func
def is_enclosed(t: Triangles, x: wp.vec3d) -> bool:
    """Is it proven, by rays along the axes, that x is enclosed by the triangles?"""
    for axis in range(3):  # noqa: SIM110 (a kernel has no ``any``)
        if _crossed_cycles(t, x, axis) != wp.uint64(0):
            return True
    return False


@wp.func
def _winding_along(t: Triangles, x: wp.vec3d, axis: int) -> int:
    lower, upper, reach = floats_below(x), floats_above(x), squared_reach(wp.float64(0.0))
    upper[axis] = _INFINITY
    i, j, found = (axis + 1) % 3, (axis + 2) % 3, wp.int32(0)
    leaf = next_leaf(t, 0, lower, upper, reach)
    while leaf < t.count:
        link = t.links[leaf]
        for face in range(link[0], link[1]):
            a, b, c = corner(t, face, 0, x), corner(t, face, 1, x), corner(t, face, 2, x)
            crosses = crossing(a, b, c, axis, wp.float64(0.0))
            if crosses < 0:
                return _UNWOUND
            if crosses > 0:
                found += _turn(a[i], a[j], b[i], b[j], wp.float64(0.0))
        leaf = next_leaf(t, leaf + 1, lower, upper, reach)
    return found


@wp.func
def winding(t: Triangles, x: wp.vec3d) -> int:
    """How often triangles that are turned alike go around x, for certain; else UNWOUND."""
    for axis in range(3):
        found = _winding_along(t, x, axis)
        if found != _UNWOUND:
            return found
    return _UNWOUND
