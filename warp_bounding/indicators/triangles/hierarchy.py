"""A hierarchy of boxes over triangles: a balanced binary tree, walked in one direction and without a stack.

Triangles are sorted so that every node of level l holds a stretch of them, halved at the median along the longest side
of the box around its triangles' centres. Nodes lie in the order in which a walk meets them: a node's first child comes
right after it, and each node tells where a walk goes on that leaves its children out. So a walk is a loop over one
number, the same on a CPU and on CUDA. Boxes are those of float32 vertices, so they are exact.
"""

from dataclasses import dataclass

import numpy as np
import warp as wp

__all__ = [
    "Hierarchy",
    "Triangles",
    "build",
    "corner",
    "float_above",
    "floats_above",
    "floats_below",
    "near_leaf",
    "next_leaf",
    "nodes_of",
    "sorted_order",
    "squared_reach",
    "wide",
]

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
    cycles: wp.array(dtype=wp.uint64)  # of a triangle: see ``cycles.py``


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
    """``(F,)`` int64: level by level, each node's stretch is sorted along the longest side of the box of its centres ``(F, n)``."""
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
    """Boxes and links of all nodes, in the order of a walk, for the float32 boxes ``(F, n)`` of sorted triangles, or of other things."""
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
