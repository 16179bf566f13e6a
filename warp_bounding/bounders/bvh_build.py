"""Hierarchies of boxes over the cells of a grid: which cells a leaf holds, and which nodes lie above it.

* ``median``: cells in Morton order (Morton 1966), halved again and again: the linear hierarchy (Lauterbach et al. 2009), whose
  splits need no search.
* ``sah``: every split is the best plane across an axis, by the surface area heuristic's sum of size times cells (Goldsmith and Salmon
  1987), down to several times as many leaves as wanted; of this tree the best cut with the wanted number of leaves is taken,
  exactly, by dynamic programming.

A binary tree has as many inner nodes as leaves. Two thirds of them are taken out again, those that save the fewest tests, which
leaves memory for more leaves; so a node has ``ARITY`` children on average.
"""

from dataclasses import dataclass, field
from heapq import heapify, heappop, heappush
from typing import NamedTuple

import numpy as np

from warp_bounding.indicators.grid import IndicatorGrid

__all__ = ["ARITY", "Hierarchy", "build", "inner_nodes", "morton_order"]

ARITY = 4
SPARE = 8  # times the wanted leaves: of the tree that ``sah`` cuts
QUERY_SIZE = {
    "point": 0.0,
    "ray": 0.25,
    "plane": 1.0,
    "box": 0.25,
}  # domain widths: a node's size is its box grown by this


class Hierarchy(NamedTuple):
    """Nodes in depth-first order; ``past[i]`` is the first node behind i's subtree, so that leaves have ``past[i] == i + 1``.

    Attributes:
        first: ``(M, n)`` int, lowest cell.
        last: ``(M, n)`` int, highest cell.
        past: ``(M,)`` int.
    """

    first: np.ndarray
    last: np.ndarray
    past: np.ndarray


@dataclass
class Node:
    """A box of cells and what lies below it."""

    first: np.ndarray
    last: np.ndarray
    size: float
    children: list["Node"] = field(default_factory=list)


def inner_nodes(leaves: int) -> int:
    """Largest number of nodes above so many leaves."""
    return -(-(leaves - 1) // (ARITY - 1))


def build(grid: IndicatorGrid, leaves: int, builder: str, query: str = "point") -> Hierarchy:
    """Arrange the occupied cells.

    Args:
        grid: The object.
        leaves: Number of leaf boxes; fewer where the object consists of fewer boxes.
        builder: ``"median"`` or ``"sah"``.
        query: What the hierarchy will be asked: what counts as a large box depends on it.
    """
    cells = grid.occupied
    measure = _Measure(np.array(grid.shape, dtype=np.float64), QUERY_SIZE[query])
    root = _median(cells[morton_order(cells)], leaves, measure) if builder == "median" else _sah(cells, leaves, measure)
    _flatten(root, inner_nodes(leaves))
    return _depth_first(root)


def morton_order(cells: np.ndarray) -> np.ndarray:
    """The order of cells ``(N, n)`` along the Z-curve."""
    n = cells.shape[1]
    bits = max(1, int(cells.max()).bit_length())
    code = np.zeros(len(cells), dtype=np.uint64)
    for bit in range(bits - 1, max(bits - 63 // n, 0) - 1, -1):
        for axis in range(n):
            code = (code << np.uint64(1)) | ((cells[:, axis] >> bit) & 1).astype(np.uint64)
    return np.argsort(code, kind="stable")


class _Measure:
    """The size of boxes of cells: their volume when grown by what is asked, as shares of the domain."""

    def __init__(self, shape: np.ndarray, grown: float):
        self.shape, self.grown = shape, grown

    def __call__(self, first: np.ndarray, last: np.ndarray) -> np.ndarray:
        return ((last - first + 1) / self.shape + self.grown).prod(axis=-1)

    def node(self, cells: np.ndarray) -> Node:
        first, last = cells.min(axis=0), cells.max(axis=0)
        return Node(first, last, float(self(first, last)))


def _median(cells: np.ndarray, leaves: int, measure: _Measure) -> Node:
    node = measure.node(cells)
    leaves = min(leaves, len(cells))
    if leaves > 1:
        left = leaves // 2
        split = min(max(round(len(cells) * left / leaves), left), len(cells) - (leaves - left))
        node.children = [_median(cells[:split], left, measure), _median(cells[split:], leaves - left, measure)]
    return node


def _sah(cells: np.ndarray, leaves: int, measure: _Measure) -> Node:
    root = measure.node(cells)
    waiting, nodes = [(-np.inf, 0, root, cells)], [root]
    count = 1
    while waiting and count < SPARE * leaves:
        _, _, node, held = heappop(waiting)
        split = _best_split(held, measure)
        if split is None:
            continue
        for part in split:
            child = measure.node(part)
            node.children.append(child)
            nodes.append(child)
            empty = float((child.last - child.first + 1).prod()) - len(part)
            if empty or (len(part) > 1 and measure.grown):
                heappush(waiting, (-empty, len(nodes), child, part))
        count += 1
    _cut(nodes, leaves)
    return root


def _best_split(cells: np.ndarray, measure: _Measure) -> tuple[np.ndarray, np.ndarray] | None:
    """The two parts on either side of the best plane across an axis; ``None`` for one cell."""
    best, chosen = np.inf, None
    for axis in range(cells.shape[1]):
        order = np.argsort(cells[:, axis], kind="stable")
        ordered = cells[order]
        starts = np.flatnonzero(np.diff(ordered[:, axis], prepend=-1))
        if len(starts) < 2:
            continue
        first, last = np.minimum.reduceat(ordered, starts), np.maximum.reduceat(ordered, starts)
        below = measure(np.minimum.accumulate(first), np.maximum.accumulate(last))[:-1]
        above = measure(np.minimum.accumulate(first[::-1]), np.maximum.accumulate(last[::-1]))[::-1][1:]
        cost = below * starts[1:] + above * (len(cells) - starts[1:])
        at = int(np.argmin(cost))
        if cost[at] < best:
            best, chosen = float(cost[at]), (ordered[: starts[at + 1]], ordered[starts[at + 1] :])
    return chosen


def _cut(nodes: list[Node], leaves: int) -> None:
    """Cut a tree (parents listed before children) so that the sizes of its leaves, ``leaves`` at most, sum to the least."""
    table: dict[int, np.ndarray] = {}  # least sum with 1, 2, ... leaves below a node
    for node in reversed(nodes):
        table[id(node)] = np.array([node.size])
        if node.children:
            a, b = (table[id(child)] for child in node.children)
            if len(a) > len(b):
                a, b = b, a
            sums = np.full(min(len(a) + len(b), leaves), np.inf)
            sums[0] = node.size
            for i, value in enumerate(a):
                reach = min(len(b), len(sums) - 1 - i)
                if reach > 0:
                    sums[i + 1 : i + 1 + reach] = np.minimum(sums[i + 1 : i + 1 + reach], value + b[:reach])
            table[id(node)] = sums
    stack = [(nodes[0], len(table[id(nodes[0])]))]
    while stack:
        node, count = stack.pop()
        if count == 1:
            node.children = []
            continue
        a, b = (table[id(child)] for child in node.children)
        share = np.arange(max(1, count - len(b)), min(len(a), count - 1) + 1)
        left = int(share[np.argmin(a[share - 1] + b[count - share - 1])])
        stack += [(node.children[0], left), (node.children[1], count - left)]


def _flatten(root: Node, allowed: int) -> None:
    """Take out inner nodes, first those whose test saves least, until ``allowed`` are left and each saves something.

    A test of a node is spent where its parent is hit; it saves the tests of its children where the parent is hit and it is not.
    """
    parents: dict[int, Node] = {}
    inner, stack = [], [root]
    while stack:
        node = stack.pop()
        if node.children:
            inner.append(node)
            stack += node.children
            parents |= {id(child): node for child in node.children}

    def saved(node: Node) -> float:
        above = parents[id(node)].size
        return len(node.children) * (above - node.size) - above

    known = {id(node): saved(node) for node in inner if node is not root}
    heap = [
        (value, index, inner[index])
        for index, value in enumerate([known.get(id(n)) for n in inner])
        if value is not None
    ]
    heapify(heap)
    left, ticket = len(inner), len(inner)
    while heap and (left > allowed or heap[0][0] < 0):
        value, _, node = heappop(heap)
        if known.get(id(node)) != value or not node.children:
            continue
        parent, children = parents[id(node)], node.children
        parent.children = [c for c in parent.children if c is not node] + children
        del known[id(node)]
        left -= 1
        for changed in [parent, *children]:
            if changed is not parent:
                parents[id(changed)] = parent
            if id(changed) in known:
                known[id(changed)] = saved(changed)
                ticket += 1
                heappush(heap, (known[id(changed)], ticket, changed))


def _depth_first(root: Node) -> Hierarchy:
    """Lay nodes out, large children first: a query that meets the object finds a leaf sooner."""
    nodes, past = [], []
    stack: list[tuple[Node, int]] = [(root, -1)]
    while stack:
        node, close = stack.pop()
        if close >= 0:
            past[close] = len(nodes)
            continue
        stack.append((node, len(nodes)))
        nodes.append(node)
        past.append(0)
        stack += [(child, -1) for child in sorted(node.children, key=lambda c: c.size)]
    first, last = (np.array([getattr(node, end) for node in nodes]) for end in ("first", "last"))
    return Hierarchy(first, last, np.array(past))
