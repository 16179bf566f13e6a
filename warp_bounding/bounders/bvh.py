"""``bvh``: a hierarchy of axis-aligned boxes over the object's cells (the paper's BVH), built by ``bvh.build``.

Nodes lie in depth-first order, each with the index behind its subtree: a query that misses a box goes on there, one
that hits it goes on with the next node, and no stack is needed (Smits 1998). The lanes of a vector share one walk; a
lane that has skipped a subtree waits until the walk leaves it. Queries of points and boxes are only compared with a
node, which cannot round; a ray is clipped by each node's box (Kay and Kajiya 1986), a plane is compared with the box's
two supports, both with room for their rounding. Boxes are moved out by twice ``CLEARANCE`` for rays that run along a
face, and for all other queries alike. f is 0 where a leaf is hit, else -1.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from heapq import heapify, heappop, heappush
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from warp_bounding.bounders.bounder import Bounder, Option, whole
from warp_bounding.bounders.distance import NOISE, Form, VolumeDistance
from warp_bounding.bounders.mlp import HIDDEN
from warp_bounding.bounders.volumes import CLEARANCE, SLOW, text
from warp_bounding.errors import BounderError
from warp_bounding.kernels.distances import DistanceSource
from warp_bounding.kernels.source import Lanes, Source
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.queries import QUERIES
from warp_bounding.queries.base import GUARD, PARALLEL
from warp_bounding.queries.distance import DistanceDomain
from warp_bounding.queries.plane import PLANE
from warp_bounding.queries.region_domain import AnyDomain
from warp_bounding.rounding import TINY, UNIT32, gamma, round_down, round_up
from warp_bounding.runtime.native import constants, fill, literal
from warp_bounding.shapes.grid import Grid

_POINT = "(v[{k}] >= b[{k}]) & (v[{k}] <= b[N + {k}])"  # of axis k
_BOX = "(v[N + {k}] >= b[{k}]) & (v[{k}] <= b[N + {k}])"


def _along(n: int, axis: str) -> str:
    """C text of a test of all axes in one expression, which compiles to less than a loop does."""
    return f"Mask hit = {' & '.join(axis.format(k=k) for k in range(n))};"


# What is done before the walk, and at a node, in n dimensions.
TOUCHES = {
    "point": lambda n: ("", _along(n, _POINT)),
    "ray": lambda n: (fill(text.BVH_SPEEDS, slow=SLOW), fill(text.BVH_RAY, clip=text.CLIP, guard=literal(GUARD))),
    "plane": lambda n: (text.BVH_SIGNS, text.BVH_PLANE),
    "box": lambda n: ("", _along(n, _BOX)),
}


# --- build -----------------------------------------------------------------------------------------------------------
#
# Hierarchies of boxes over the cells of a grid: which cells a leaf holds, and which nodes lie above it.
#
# Every split is the plane across an axis that leaves the least volume on its two sides, weighted by a power of their
# numbers of cells (with power 1, the surface area heuristic of Goldsmith and Salmon 1987, for points), down to several
# times as many leaves as wanted; of this tree the cut whose leaves have the least volume is taken, exactly, by dynamic
# programming.
#
# A binary tree has as many inner nodes as leaves. Two thirds of them are taken out again, those that save the fewest
# tests, which leaves memory for more leaves; so a node has ``ARITY`` children on average.

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


def build(grid: Grid, leaves: int, seconds: float = math.inf) -> Hierarchy:
    """Arrange the occupied cells in so many leaf boxes; fewer where the object consists of fewer.

    Where the seconds for splits are over, boxes stay as large as they are; the emptiest are split first.
    """
    started = time.perf_counter()
    shares = [started + seconds * (index + 1) / len(POWERS) for index in range(len(POWERS))]
    found = [_tight(grid.occupied, leaves, power, until) for power, until in zip(POWERS, shares, strict=True)]
    root = min(found, key=lambda pair: pair[0])[1]
    inner = -(-(leaves - 1) // (ARITY - 1))  # nodes above the leaves, at most
    _flatten(root, inner, np.array(grid.shape, dtype=np.float64))
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
    """Cut a tree to ``leaves`` leaves at most whose sizes have the least sum; returns that.

    Parents are listed before children.
    """
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

    A test of a node is spent where its parent is hit; it saves the tests of its children where the parent is hit and it
    is not.
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


LEAVES = 64  # of ``Bvh.fit`` where it is called directly, as in tests; ``fit`` always passes the option's value
# Local units, of a node's corners: divided by ``PARALLEL``, as rays may be clipped, it stays under 2^127.
LARGEST = 2.0**40
_leaves = whole("leaves", 1)
LEADING = 2  # of the method's numbers, before the nodes: how many nodes there are, and the room of a plane


def leaves_for_bytes(nbytes: int, ndim: int) -> int:
    """The most leaves of a hierarchy in n dimensions whose ``Bounder.nbytes`` are at most so many; at least 1.

    Of rays and planes about a moving object these are 4 bytes more.
    """
    before = 3 * ndim + 1 + ndim + LEADING  # header and threshold; ``extra``, where it is longest; the method's own
    nodes = max((nbytes // 4 - before) // (2 * ndim + 1), 1)
    return nodes - -(-(nodes - 1) // ARITY)  # with the nodes above them, they are just so many nodes or one less


def _network_bytes(domain: AnyDomain, hidden: tuple[int, ...]) -> int:
    """Memory of the network of these widths that the same queries would have."""
    sizes = [domain.ndim, *hidden, 1]
    numbers = sum(k * h + h for k, h in pairwise(sizes))
    return 4 * (numbers + len(domain.header) + 1 + len(domain.extra))


@dataclass(frozen=True)
class BvhSource(Source):
    """Native code of the traversal. Numbers: number of nodes, a plane's room; per node low, high and past."""

    packed = True

    def body(self, lanes: Lanes) -> str:
        prepare, touches = TOUCHES[self.query](self.ndim)
        walk = fill(text.BVH_TOGETHER if lanes.vector else text.BVH_ALONE, prepare=prepare, touches=touches)
        return f"{{ {constants(N=self.ndim, LEADING=LEADING)}{walk}}}\n"


class Bvh(Bounder):
    """Hierarchy of boxes.

    Tensors: ``low`` and ``high`` ``(M, n)`` and ``past`` ``(M,)``, whole numbers: the index of the node behind the
        subtree.
    """

    method = "bvh"
    lays_cells = of_volume = True
    takes_seconds = True
    options = (
        Option("leaves", None, "leaf boxes; by default as many as take a network's memory", _leaves, int),
        replace(HIDDEN, help="of the network whose memory sets the leaves"),
    )

    @classmethod
    def supports(cls, query: str, ndim: int) -> bool:
        return query in TOUCHES and (ndim >= 2 or not QUERIES[query].is_region)

    @classmethod
    def fit(
        cls,
        grid: Grid,
        domain: AnyDomain,
        *,
        leaves: int | None = LEAVES,
        hidden: tuple[int, ...] = HIDDEN.default,
        seconds: float = math.inf,
        device: str | None = None,
    ) -> "Bvh":
        """Arrange a grid's occupied cells in so many leaf boxes, or fewer where the object consists of fewer.

        ``None`` are as many as the memory of a network with layers of widths ``hidden`` holds. The fewer ``seconds``,
        the looser the boxes.
        """
        leaves = leaves_for_bytes(_network_bytes(domain, hidden), grid.ndim) if leaves is None else _leaves(leaves)
        tree = build(grid, leaves, seconds)
        lower, upper = domain.base.widened(grid.position(tree.first - 0.5), grid.position(tree.last + 0.5))
        low = np.nextafter(round_down(lower - 2 * CLEARANCE), np.float32(-np.inf))
        high = np.nextafter(round_up(upper + 2 * CLEARANCE), np.float32(np.inf))
        return cls(domain, {"low": low, "high": high, "past": tree.past.astype(np.float32)}, {}, device)

    def check_tensors(self) -> None:
        n, count = self.ndim, max(len(self.tensors.get("past", ())), 1)
        self.expect_shapes({"low": (count, n), "high": (count, n), "past": (count,)})
        if not count < 2**24:
            raise BounderError(f"bvh: expected under 2^24 nodes, got {count} nodes")
        self.past = self.tensors["past"].astype(np.int64)
        parent = self._parents()
        low, high = self.tensors["low"], self.tensors["high"]
        if (low < low[parent]).any() or (high > high[parent]).any() or (low > high).any():
            raise BounderError("bvh: a box does not hold its children")
        if not max(np.abs(low).max(), np.abs(high).max()) < LARGEST:
            raise BounderError("bvh: numbers are so large that float32 products may overflow")

    def _parents(self) -> np.ndarray:
        """Index of each node's parent (the root's: its own), if ``past`` describes a tree."""
        past, count = self.tensors["past"], len(self.tensors["past"])
        parent, stack = np.zeros(count, dtype=np.int64), []
        sound = past[0] == count
        for index, behind in enumerate(past.tolist()):
            while stack and past[stack[-1]] <= index:
                stack.pop()
            sound = sound and behind == int(behind) and index < behind <= (past[stack[-1]] if stack else count)
            if not sound or (index and not stack):
                raise BounderError("bvh: the nodes' order is no tree's")
            parent[index] = stack[-1] if stack else 0
            stack.append(index)
        return parent

    @property
    def leaves(self) -> np.ndarray:
        """Indices of the leaf nodes."""
        return np.flatnonzero(self.past == np.arange(len(self.past)) + 1)

    @property
    def source(self) -> BvhSource:
        return self.source_of(BvhSource)

    def weights(self) -> np.ndarray:
        low, high, n, room = self.tensors["low"], self.tensors["high"], self.ndim, 0.0
        if QUERIES[self.query_kind] is PLANE:
            # A plane m . y = c, no entry of m above 1. A support is 2 n products and their sums, and c -+ room one sum
            # more: 2 n + 1 roundings, 2 n + 4 to be safe. Under 16 (n + 1) results and factors, each times at most 1 +
            # size, may be set to zero.
            corner = np.maximum(np.abs(low), np.abs(high)).astype(np.float64)
            size = float(corner.sum(axis=1).max()) + float(self.domain.limit[-1])
            room = float(round_up(gamma(2 * n + 4) * size * (1 + 1e-9) + 16 * (n + 1) * (1 + size) * TINY))
        nodes = np.concatenate([low, high, self.tensors["past"][:, None]], axis=1)
        return np.concatenate([[len(nodes), room], nodes.reshape(-1)]).astype(np.float32)

    @property
    def nbytes(self) -> int:
        return super().nbytes + 4 * LEADING  # which are in no tensor

    def _in_leaf(self, count: int, meets: Callable[[int, np.ndarray], np.ndarray]) -> np.ndarray:
        """0 for which of ``count`` rows meet a leaf and its ancestors, else -1; ``meets`` tests rows and a node."""
        met, nodes, index = np.zeros(count, dtype=bool), len(self.past), 0
        stack = [(nodes, np.arange(count))]
        while index < nodes:
            while stack[-1][0] <= index:
                stack.pop()
            rows, past = stack[-1][1], int(self.past[index])
            rows = rows[~met[rows]]
            rows = rows[meets(index, rows)]
            if past == index + 1:
                met[rows] = True
            if len(rows):
                stack.append((past, rows))
            index = index + 1 if len(rows) else past
        return np.where(met, 0.0, -1.0)

    def reference(self, v: np.ndarray) -> np.ndarray:
        """See ``Bounder``; without room for rounding.

        Float64 rounds monotonically: what touches a box touches those that hold it.
        """
        v, touching = np.asarray(v, dtype=np.float64), TOUCHING[self.query_kind]
        low, high = self.tensors["low"].astype(np.float64), self.tensors["high"].astype(np.float64)
        return self._in_leaf(len(v), lambda node, rows: touching(v[rows], low[node], high[node]))

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """See ``Bounder``: 0 where one leaf, and so all above it, holds the box with a ``CLEARANCE``, else -1."""
        if self.volume is not None:
            raise BounderError(f"{self.method}: {self.query_kind} queries are proven by their volume")
        low, high = self.tensors["low"].astype(np.float64), self.tensors["high"].astype(np.float64)

        def hold(node: int, rows: np.ndarray) -> np.ndarray:
            # Strictly: where float64 loses CLEARANCE, its numbers are farther apart than that.
            return ((low[node] < lower[rows] - CLEARANCE) & (high[node] > upper[rows] + CLEARANCE)).all(axis=1)

        least, center = self._in_leaf(len(lower), hold), (lower + upper) / 2
        return BoxBounds(least, np.argmax(upper - lower, axis=1), center, self.reference(center))

    def rounding_bound(self) -> float:
        """See ``Bounder``; none: what rounds is paid for by room around the boxes, and f is 0 or -1."""
        return 0.0


# Which queries of v ``(N, m)`` meet a box, ``(n,)`` or ``(N, n)`` its corners, by their kind.


def _boxes_touch(v: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Points too: they are both of their corners."""
    n = low.shape[-1]
    return ((v[:, -n:] >= low) & (v[:, :n] <= high)).all(axis=1)


def _planes_touch(v: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    ends = np.sort(np.stack([v[:, :-1] * low, v[:, :-1] * high]), axis=0).sum(axis=2)
    return (ends[0] <= v[:, -1]) & (v[:, -1] <= ends[1])


def _rays_touch(v: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    origin, speed = np.split(v, 2, axis=1)
    cross = np.where(np.abs(speed) > PARALLEL, speed, PARALLEL)
    ends = np.sort(np.stack([(low - origin) / cross, (high - origin) / cross]), axis=0)
    return np.maximum(ends[0].max(axis=1), 0) <= np.minimum(ends[1].min(axis=1), 1)


TOUCHING = {"point": _boxes_touch, "ray": _rays_touch, "plane": _planes_touch, "box": _boxes_touch}


# --- distances to boxes ----------------------------------------------------------------------------------------------
#
# The distance to the leaves of a hierarchy of boxes: ``bvh``, exact but for rounding and for what rounds the boxes
# outwards.
#
# Nodes lie in depth-first order, each with the index behind its subtree, so that a walk is a loop over one number. A
# query first goes down to a leaf, always to the child that is nearest, and then through all nodes that are nearer than
# the nearest leaf so far. Lanes share both walks: they go down where the first lane goes, and leave out what is far for
# all of them.
#
# Every point of the object lies in a leaf *and* in all nodes above it, as the bounder of points denies nothing else. So
# where a node is not nearer than a leaf that was found, no point of the object below it is, either.
#
# *Rounding*: the way to a box is the larger of two differences on each axis, off by ``u (|v_k| + |corner|)``; n of them
# by ``root(n)`` times as much, and squares, sum and root by ``(n + 4) u`` of the result. That the way is short for some
# nodes decides only which are queried, up to a factor ``1 + 2 (n + 4) u`` that the result's own rounding has room for.

FARTHEST = 3e38  # a squared distance that nothing is farther than


@dataclass(frozen=True)
class BvhDistanceSource(DistanceSource):
    """Native code of the walk. Numbers: how many nodes; per node low, high and past."""

    def body(self, lanes: Lanes) -> str:
        first, none = (
            ("there[0]", "!__builtin_reduce_or(there < nearest)") if lanes.vector else ("there", "!(there < nearest)")
        )
        filled = fill(text.BVH_DISTANCE, first=first, none=none, farthest=literal(FARTHEST), way=text.BVH_WAY)
        return f"{{{filled}}}\n"


class BvhDistance(VolumeDistance):
    """The distance to the leaves; see module."""

    method, bounds = Bvh.method, Bvh

    @classmethod
    def form_of(cls, volume: Bounder, domain: DistanceDomain) -> Form:
        from warp_bounding.shapes.box_distances import BoxDistances  # with kernels that nothing else needs

        if not float(volume.threshold) > -1:
            raise BounderError(f"{cls.method}: the threshold leaves nothing out")
        n, own = domain.ndim, volume.domain
        per_unit, to_unit = own.scale.astype(np.float64), domain.scale.astype(np.float64)
        apart = own.center.astype(np.float64) - domain.center.astype(np.float64)
        low, high = (volume.tensors[name].astype(np.float64) / per_unit + apart for name in ("low", "high"))
        room = NOISE * (np.abs(low).max() + np.abs(high).max() + np.abs(apart).max())
        low, high = round_down((low - room) * to_unit), round_up((high + room) * to_unit)
        nodes = np.concatenate([low, high, volume.tensors["past"][:, None]], axis=1)
        numbers = np.concatenate([[len(nodes)], nodes.reshape(-1)]).astype(np.float32)
        leaves = volume.leaves
        distances = BoxDistances(low[leaves].astype(np.float64), high[leaves].astype(np.float64))
        largest, root = max(float(np.abs(low).max()), float(np.abs(high).max())), float(np.sqrt(n))

        def reference(v: np.ndarray) -> np.ndarray:
            return distances(v)[:, 0]

        return Form(BvhDistanceSource(n, False), numbers, root * 2 * UNIT32 * largest, root * 2 + 2 * n + 12, reference)
