"""``bvh``: a hierarchy of axis-aligned boxes over the object's cells (the paper's BVH), built by ``bvh.build``.

Nodes lie in depth-first order, each with the index behind its subtree: a query that misses a box goes on there, one that
hits it goes on with the next node, and no stack is needed (Smits 1998). The lanes of a vector share one walk; a lane
that has skipped a subtree waits until the walk leaves it. Queries of points and boxes are only compared with a node,
which cannot round; a ray is clipped by each node's box (Kay and Kajiya 1986), a plane is compared with the box's two
supports, both with room for their rounding. The boxes are moved out by twice ``ROOM`` for rays that run along a face,
and for all other queries alike. f is 0 where a leaf is hit, else -1.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from warp_bounding.arithmetic import TINY, gamma, round_down, round_up
from warp_bounding.bounders.base import Bounder, BoxBounds
from warp_bounding.bounders.bvh.build import ARITY, build
from warp_bounding.bounders.bvh.native import ALONE, TOGETHER, TOUCHES
from warp_bounding.bounders.neural.mlp import HIDDEN
from warp_bounding.bounders.options import Option, whole
from warp_bounding.bounders.slabs.regions import ROOM
from warp_bounding.coordinates.base import PARALLEL
from warp_bounding.coordinates.region_domain import AnyDomain
from warp_bounding.errors import BounderError
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.kernels.source import Lanes, Source, fill
from warp_bounding.queries import QUERIES
from warp_bounding.queries.plane import PLANE

__all__ = ["LARGEST", "TOUCHING", "Bvh", "BvhSource", "leaves_for_bytes", "plane_room"]

LEAVES = 64  # of ``Bvh.fit`` where it is called directly, as in tests; ``fit`` always passes the option's value
LARGEST = (
    2.0**40
)  # local units, of a node's corners: divided by ``PARALLEL``, as rays may be clipped, it stays under 2^127
_leaves = whole("leaves", 1)
LEADING = 2  # of the method's numbers, before the nodes: how many nodes there are, and the room of a plane


def leaves_for_bytes(nbytes: int, ndim: int) -> int:
    """The most leaves of a hierarchy in n dimensions whose ``Bounder.nbytes`` are at most so many; at least 1.

    Of rays and planes about a moving object these are 4 bytes more.
    """
    before = 3 * ndim + 1 + ndim + LEADING  # header and threshold; ``extra``, where it is longest; the method's own
    nodes = max((nbytes // 4 - before) // (2 * ndim + 1), 1)
    return nodes - -(-(nodes - 1) // ARITY)  # with their ``inner_nodes``, they are just so many nodes or one less


def _network_bytes(domain: AnyDomain, hidden: tuple[int, ...]) -> int:
    """Memory of the network of these widths that the same queries would have."""
    planes = domain.query == PLANE.name  # a network of planes has the normal's entries as inputs, and two outputs
    sizes = [domain.space_ndim if planes else domain.ndim, *hidden, 2 if planes else 1]
    numbers = sum(k * h + h for k, h in pairwise(sizes))
    return 4 * (numbers + len(domain.header) + 1 + len(domain.extra))


@dataclass(frozen=True)
class BvhSource(Source):
    """Native code of the traversal. Numbers: number of nodes, a plane's room; per node low, high and past."""

    packed = True

    def body(self, lanes: Lanes) -> str:
        prepare, touches = TOUCHES[self.query](self.ndim)
        walk = TOGETHER if lanes.vector else ALONE
        return fill(walk, prepare=prepare, touches=touches, leading=LEADING, n=self.ndim)


class Bvh(Bounder):
    """Hierarchy of boxes.

    Tensors: ``low`` and ``high`` ``(M, n)`` and ``past`` ``(M,)``, whole numbers: the index of the node behind the subtree.
    """

    method = "bvh"
    lays_cells = True
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
        grid: IndicatorGrid,
        domain: AnyDomain,
        *,
        leaves: int | None = LEAVES,
        hidden: tuple[int, ...] = HIDDEN.default,
        seconds: float = math.inf,
        device: str | None = None,
    ) -> "Bvh":
        """Arrange a grid's occupied cells in boxes.

        Args:
            grid: The object.
            domain: Its domain, or that of a region.
            leaves: Number of leaf boxes (fewer where the object consists of fewer); ``None`` for as many as a network's memory holds.
            hidden: Widths of that network's hidden layers.
            seconds: Time for the boxes; the less there is, the looser they are.
            device: Warp device.

        Raises:
            BounderError: If ``leaves`` is no positive whole number.
        """
        leaves = leaves_for_bytes(_network_bytes(domain, hidden), grid.ndim) if leaves is None else _leaves(leaves)
        tree = build(grid, leaves, seconds)
        lower, upper = domain.base.widened(grid.position(tree.first - 0.5), grid.position(tree.last + 0.5))
        low = np.nextafter(round_down(lower - 2 * ROOM), np.float32(-np.inf))
        high = np.nextafter(round_up(upper + 2 * ROOM), np.float32(np.inf))
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

    @cached_property
    def volume(self) -> "Bvh | None":
        if self.domain.tested_as_point:
            return None
        return type(self)(self.domain.base, self.tensors, self.sizes, self._device)

    @property
    def source(self) -> BvhSource:
        return self.source_of(BvhSource)

    def weights(self) -> np.ndarray:
        low, high, n, room = self.tensors["low"], self.tensors["high"], self.ndim, 0.0
        if QUERIES[self.query_kind] is PLANE:
            corner = np.maximum(np.abs(low), np.abs(high)).astype(np.float64)
            room = plane_room(float(corner.sum(axis=1).max()), n, float(self.domain.limit[-1]))
        nodes = np.concatenate([low, high, self.tensors["past"][:, None]], axis=1)
        return np.concatenate([[len(nodes), room], nodes.reshape(-1)]).astype(np.float32)

    @property
    def nbytes(self) -> int:
        return super().nbytes + 4 * LEADING  # which are in no tensor

    def _in_leaf(self, count: int, meets: Callable[[int, np.ndarray], np.ndarray]) -> np.ndarray:
        """0 for which of ``count`` rows meet a leaf and all nodes above it, else -1; ``meets`` tells which rows meet a node."""
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
        """See ``Bounder``; without room for rounding. Float64 rounds monotonically: what touches a box touches those that hold it."""
        v, touching = np.asarray(v, dtype=np.float64), TOUCHING[self.query_kind]
        low, high = self.tensors["low"].astype(np.float64), self.tensors["high"].astype(np.float64)
        return self._in_leaf(len(v), lambda node, rows: touching(v[rows], low[node], high[node]))

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """See ``Bounder``: 0 where one leaf, and so all above it, holds the box and has ``ROOM`` to spare, else -1."""
        if self.volume is not None:
            raise BounderError(f"{self.method}: {self.query_kind} queries are proven by their volume")
        low, high = self.tensors["low"].astype(np.float64), self.tensors["high"].astype(np.float64)

        def hold(node: int, rows: np.ndarray) -> np.ndarray:
            # Strictly: where float64 loses ROOM, its numbers are farther apart than that.
            return ((low[node] < lower[rows] - ROOM) & (high[node] > upper[rows] + ROOM)).all(axis=1)

        least, center = self._in_leaf(len(lower), hold), (lower + upper) / 2
        return BoxBounds(least, np.argmax(upper - lower, axis=1), center, self.reference(center))

    def rounding_bound(self) -> float:
        """See ``Bounder``; none: what rounds is paid for by room around the boxes, and f is 0 or -1."""
        return 0.0


def plane_room(corner: float, n: int, limit: float) -> float:
    """Room for the rounding of a plane's comparison with the supports of boxes in n dimensions.

    Args:
        corner: The largest sum of the absolute coordinates of a box's corner.
        n: Dimension.
        limit: Of the plane's offset.
    """
    # A plane m . y = c, no entry of m above 1. A support is 2 n products and their sums, and c -+ room one sum more: 2 n + 1
    # roundings, 2 n + 4 to be safe. Under 16 (n + 1) results and factors, each times at most 1 + size, may be set to zero.
    size = corner + limit
    return float(round_up(gamma(2 * n + 4) * size * (1 + 1e-9) + 16 * (n + 1) * (1 + size) * TINY))


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
