"""Hierarchies of boxes over the cells of a grid: which cells a leaf holds, and which nodes lie above it.

Every split is the plane across an axis that leaves the least volume on its two sides, weighted by a power of their numbers of
cells (with power 1, the surface area heuristic of Goldsmith and Salmon 1987, for points), down to several times as many leaves
as wanted; of this tree the cut whose leaves have the least volume is taken, exactly, by dynamic programming.

A binary tree has as many inner nodes as leaves. Two thirds of them are taken out again, those that save the fewest tests, which
leaves memory for more leaves; so a node has ``ARITY`` children on average.
"""

import math
import time
from heapq import heapify, heappop, heappush
from typing import NamedTuple

import numpy as np

from warp_bounding.indicators.grid import IndicatorGrid

__all__ = ["ARITY", "Hierarchy", "build", "inner_nodes"]

ARITY = 4
SPARE = 4  # times the wanted leaves: of the tree that is cut
POWERS = (0.0, 0.5)  # of the numbers of cells; all are tried
BALANCE = 1e-9  # decides between splits that leave the same volume
GROWN = 0.1  # domain widths: by how much a query's own size makes a node's box larger


class Hierarchy(NamedTuple):
    """Nodes in depth-first order."""

    first: np.ndarray  # (M, n) int, lowest cell
    last: np.ndarray  # (M, n) int, highest cell
    past: np.ndarray  # (M,) int, the first node behind i's subtree; leaves have ``past[i] == i + 1``


class Node:
    """The box around cells ``(N, n)`` and what lies below it; size: the cells in it, occupied or not."""

    def __init__(self, cells: np.ndarray):
        self.first, self.last = cells.min(axis=0), cells.max(axis=0)
        self.size = float((self.last - self.first + 1).prod(dtype=np.float64))
        self.children: list[Node] = []


def inner_nodes(leaves: int) -> int:
    """Largest number of nodes above so many leaves."""
    return -(-(leaves - 1) // (ARITY - 1))


def build(grid: IndicatorGrid, leaves: int, seconds: float = math.inf) -> Hierarchy:
    """Arrange the occupied cells in so many leaf boxes; fewer where the object consists of fewer.

    Where the seconds for splits are over, boxes stay as large as they are; the emptiest are split first.
    """
    started = time.perf_counter()
    shares = [started + seconds * (index + 1) / len(POWERS) for index in range(len(POWERS))]
    found = [_tight(grid.occupied, leaves, power, until) for power, until in zip(POWERS, shares, strict=True)]
    root = min(found, key=lambda pair: pair[0])[1]
    _flatten(root, inner_nodes(leaves), np.array(grid.shape, dtype=np.float64))
    return _depth_first(root)


def _tight(cells: np.ndarray, leaves: int, power: float, until: float) -> tuple[float, Node]:
    """The least sum of leaf sizes that was found, and its tree; no box is split any more at the time ``until``."""
    root = Node(cells)
    waiting, nodes, count = [(0.0, 0, root, cells)] if root.size > len(cells) else [], [root], 1
    while waiting and count < SPARE * leaves and time.perf_counter() < until:
        _, _, node, held = heappop(waiting)
        for part in _best_split(held, power):
            child = Node(part)
            node.children.append(child)
            nodes.append(child)
            if child.size > len(part):  # something in it is empty
                heappush(waiting, (len(part) - child.size, len(nodes), child, part))
        count += 1
    return _cut(nodes, leaves), root


def _best_split(cells: np.ndarray, power: float) -> tuple[np.ndarray, np.ndarray]:
    """The two parts of several cells on either side of the best plane across an axis."""
    best, chosen, n = np.inf, (), len(cells)
    for axis in range(cells.shape[1]):
        index = cells[:, axis]
        short = index.astype(np.uint16) if index.max() < 2**16 else index  # NumPy sorts 16 bits in linear time
        order = np.argsort(short, kind="stable")
        ordered = cells[order]
        starts = np.flatnonzero(np.diff(ordered[:, axis], prepend=-1))
        if len(starts) < 2:
            continue
        first, last = np.minimum.reduceat(ordered, starts), np.maximum.reduceat(ordered, starts)
        below = _sizes(np.minimum.accumulate(first), np.maximum.accumulate(last))[:-1]
        above = _sizes(np.minimum.accumulate(first[::-1]), np.maximum.accumulate(last[::-1]))[::-1][1:]
        share = starts[1:] / n
        cost = below * share**power + above * (1 - share) ** power + BALANCE * np.abs(share - 0.5)
        at = int(np.argmin(cost))
        if cost[at] < best:
            best, chosen = float(cost[at]), (ordered[: starts[at + 1]], ordered[starts[at + 1] :])
    return chosen


def _sizes(first: np.ndarray, last: np.ndarray) -> np.ndarray:
    return (last - first + 1).prod(axis=1, dtype=np.float64)


def _cut(nodes: list[Node], leaves: int) -> float:
    """Cut a tree (parents listed before children) so that the sizes of its leaves, ``leaves`` at most, sum to the least; that sum."""
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
    return float(table[id(nodes[0])][-1])


def _flatten(root: Node, allowed: int, shape: np.ndarray) -> None:
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
    chance = {id(node): float(((node.last - node.first + 1) / shape + GROWN).prod()) for node in inner}

    def saved(node: Node) -> float:
        above = chance[id(parents[id(node)])]
        return len(node.children) * (above - chance[id(node)]) - above

    known = {id(node): saved(node) for node in inner if node is not root}
    heap = [(known[id(node)], index, node) for index, node in enumerate(inner) if node is not root]
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
        parents |= {id(child): parent for child in children}
        for changed in [parent, *children]:
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
