"""``kd-tree``: the occupied cells as a k-d tree of bits, some three and a half bits a leaf; exact on its own grid.

Boxes are halved at cells' borders until they are full or empty, so a node's box follows from the way to it, and nothing of it
is kept (``kdtree.bits``). Large empty or full parts take one leaf, which ``voxels`` pays for cell by cell; and a tree can be
asked rays, planes and boxes. f is 0 where a full leaf and all nodes above it are met, else -1.

A border is ``low + i step``, rounded; the boxes that kernels compute are moved out by more than that, and by twice ``ROOM``
for rays that run along a face (``slabs.regions``). What a node is asked is what a hierarchy asks of its boxes (``bvh``).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import warp as wp

from warp_bounding.arithmetic import TINY, gamma, round_down, round_up
from warp_bounding.bounders.base import Bounder, BoxBounds
from warp_bounding.bounders.bvh.bvh import LARGEST, TOUCHING, plane_room
from warp_bounding.bounders.bvh.native import TOUCHES
from warp_bounding.bounders.kdtree.bits import BLOCK_WORDS, Tree, blocks, build, nodes_of, packed, unpacked
from warp_bounding.bounders.kdtree.native import ALONE, TOGETHER
from warp_bounding.bounders.kdtree.plain import plain_walk
from warp_bounding.bounders.options import Option, whole
from warp_bounding.bounders.slabs.regions import ROOM
from warp_bounding.coordinates.base import GEOMETRIC
from warp_bounding.coordinates.region_domain import AnyDomain
from warp_bounding.errors import BounderError
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.kernels.source import Lanes, Source, fill
from warp_bounding.queries import QUERIES

__all__ = ["KdTree", "KdTreeSource"]

MOST_ALONG = 2**22  # cells along an axis: float32 tells their numbers apart, and halves of them
MOST_CELLS = 2**31 - 1
MOST_NODES = 2**24  # all of them are held in memory where a bounder is checked
SLACK = 1e-12  # relative: above the rounding of what float64 makes of borders
_leaves = whole("leaves", 1)


@dataclass(frozen=True)
class KdTreeSource(Source):
    """Native code of the walk; its numbers are told in ``kdtree.native``."""

    packed = True

    def body(self, lanes: Lanes) -> str:
        prepare, touches = TOUCHES[self.query](self.ndim)
        walk = TOGETHER if lanes.vector else ALONE
        return fill(walk, prepare=prepare, touches=touches, n=self.ndim, coordinates=self.coordinates)

    def plain(self) -> wp.Function:
        return plain_walk(self)


class KdTree(Bounder):
    """A k-d tree of bits.

    Tensors: ``inner`` and ``full``, uint32 (``kdtree.bits``); ``low``, ``step`` and ``wide`` ``(n,)``: cell i lies between
    ``low + i step - wide`` and ``low + (i + 1) step + wide``. Sizes: ``shape``, cells of the box that is divided; ``nodes``.
    """

    method = "kd-tree"
    lays_cells = True
    bit_fields = ("inner", "full")
    options = (Option("leaves", None, "leaves; by default as many as the cells need", _leaves, int),)

    @classmethod
    def supports(cls, query: str, ndim: int, space: str = "geometric") -> bool:
        return space == GEOMETRIC and query in TOUCHES and (ndim >= 2 or not QUERIES[query].is_region)

    @classmethod
    def fit(
        cls, grid: IndicatorGrid, domain: AnyDomain, *, leaves: int | None = None, device: str | None = None
    ) -> "KdTree":
        """Divide a grid's occupied cells.

        Args:
            grid: The object.
            domain: Its domain, or that of a region.
            leaves: At most so many; those that are left out hold the fewest empty cells. ``None`` for as many as it takes.
            device: Warp device.

        Raises:
            BounderError: If ``leaves`` is no positive whole number, or float32 cannot tell the cells apart.
        """
        (first, last), tree = build(grid.occupancy, None if leaves is None else _leaves(leaves))
        extent = last - first + 1
        lower, upper = domain.base.widened(grid.position(first[None] - 0.5), grid.position(last[None] + 0.5))
        step = ((upper - lower) / extent)[0].astype(np.float32)
        low, wide = lower[0].astype(np.float32), np.zeros(len(extent))
        for axis, count in enumerate(extent):
            cells = np.tile(first.astype(np.float64), (count, 1))
            cells[:, axis] += np.arange(count)
            lower, upper = domain.base.widened(grid.position(cells - 0.5), grid.position(cells + 0.5))
            border = float(low[axis]) + np.arange(count + 1) * float(step[axis])
            beyond = np.concatenate([border[:-1] - lower[:, axis], upper[:, axis] - border[1:]])
            wide[axis] = max(beyond.max(), 0.0)
        wide = round_up(wide + 2 * ROOM + SLACK * (np.abs(low) + extent * step))
        if (wide >= 0.5 * step).any():
            raise BounderError(f"kd-tree: float32 cannot resolve a grid of {grid.shape} cells")
        tensors = {"inner": packed(tree.inner), "full": packed(tree.full), "low": low, "step": step, "wide": wide}
        return cls(domain, tensors, {"shape": [int(e) for e in extent], "nodes": len(tree.inner)}, device)

    def check_tensors(self) -> None:
        n, shape, count = self.ndim, tuple(self.sizes.get("shape", ())), self.sizes.get("nodes")
        whole = len(shape) == n and all(type(r) is int and 0 < r <= MOST_ALONG for r in shape)
        if not whole or np.prod(shape, dtype=np.float64) > MOST_CELLS:
            expected = f"{n} sizes of a box of cells up to {MOST_ALONG}, {MOST_CELLS} cells in all"
            raise BounderError(f"kd-tree: expected {expected}, got {shape}")
        if type(count) is not int or not 0 < count < MOST_NODES or self.domain.parametric:
            raise BounderError(f"kd-tree: expected under {MOST_NODES} nodes in geometric space, got {count!r} nodes")
        leaves = count // 2 + 1
        bits = {"inner": (-(-count // 32),), "full": (-(-leaves // 32),)}
        self.expect_shapes(bits | dict.fromkeys(("low", "step", "wide"), (n,)))
        low, step, wide = (self.tensors[name].astype(np.float64) for name in ("low", "step", "wide"))
        self.extent = np.array(shape, dtype=np.int64)
        if not (np.abs(low) + self.extent * np.abs(step) + np.abs(wide) < LARGEST).all():
            raise BounderError("kd-tree: numbers are so large that float32 products may overflow")
        if not ((step > 0) & (wide >= 0)).all():
            got = f"{step.tolist()} and {wide.tolist()}"
            raise BounderError(f"kd-tree: expected positive steps and no negative widths, got {got}")
        self.tree = Tree(unpacked(self.tensors["inner"], count), unpacked(self.tensors["full"], leaves))
        self.nodes = nodes_of(self.tree, self.extent)

    @property
    def leaves(self) -> int:
        """Number of leaves, full and empty."""
        return len(self.tree.full)

    @cached_property
    def volume(self) -> "KdTree | None":
        if self.domain.tested_as_point:
            return None
        return type(self)(self.domain.base, self.tensors, self.sizes, self._device)

    @property
    def source(self) -> KdTreeSource:
        return self.source_of(KdTreeSource)

    @cached_property
    def _blocks(self) -> np.ndarray:
        return blocks(self.tree.inner)

    def weights(self) -> np.ndarray:
        low, step, wide = (self.tensors[name].astype(np.float64) for name in ("low", "step", "wide"))
        # A computed border is a sum of two numbers, one of them a product: two roundings of at most ``size``, and as many results
        # that may be set to zero; ``low`` and ``high`` round outwards.
        size = np.abs(low) + self.extent * step + wide
        room = (gamma(4) + 2 * SLACK) * size * (1 + 1e-6) + 4 * TINY + 2 * ROOM
        low, high = round_down(low - wide - room), round_up(low + wide + room)
        corner = np.maximum(np.abs(low), np.abs(high)).astype(np.float64) + self.extent * step
        limit = float(self.domain.limit[-1])
        numbers = [
            len(self._blocks) // BLOCK_WORDS,
            plane_room(float(corner.sum()) * (1 + 1e-6), self.ndim, limit),
        ]
        return np.concatenate([numbers, low, high, step, self.extent]).astype(np.float32)

    def words(self) -> np.ndarray:
        return np.concatenate([self._blocks, self.tensors["full"]])

    @property
    def nbytes(self) -> int:
        header = len(self.domain.header) + 1 + len(self.domain.extra)
        return 4 * (header + 2 + 4 * self.ndim + len(self.words()))

    def _boxes(self, first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Corners ``(N, n)`` float64 of boxes of cells: nested as these are, since float64 rounds monotonically."""
        low, step, wide = (self.tensors[name].astype(np.float64) for name in ("low", "step", "wide"))
        return (low + first * step) - wide, (low + (last + 1) * step) + wide

    def reference(self, v: np.ndarray) -> np.ndarray:
        """See ``Bounder``; without room for rounding."""
        v, touching = np.asarray(v, dtype=np.float64), TOUCHING[self.query_kind]
        met = np.zeros(len(v), dtype=bool)
        row, node = np.arange(len(v)), np.zeros(len(v), dtype=np.int64)
        while len(row):
            keep = touching(v[row], *self._boxes(self.nodes.first[node], self.nodes.last[node])) & ~met[row]
            row, node = row[keep], node[keep]
            met[row[self.nodes.full[node]]] = True
            below = self.nodes.child[node]
            row, below = row[below > 0], below[below > 0]
            row, node = np.repeat(row, 2), (below[:, None] + np.arange(2)).reshape(-1)
        return np.where(met, 0.0, -1.0)

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """See ``Bounder``: 0 where a full leaf holds the box and has ``ROOM`` to spare, else -1."""
        if self.volume is not None:
            raise BounderError(f"{self.method}: {self.query_kind} queries are proven by their volume")
        center, nodes = (lower + upper) / 2, self.nodes
        low, step = (self.tensors[name].astype(np.float64) for name in ("low", "step"))
        cell = np.clip(np.floor((center - low) / step), 0, self.extent - 1).astype(np.int64)
        node = np.zeros(len(lower), dtype=np.int64)
        while (inner := nodes.child[node] > 0).any():
            below = nodes.child[node[inner]]
            node[inner] = below + (cell[inner] > nodes.last[below]).any(axis=1)
        least, most = self._boxes(nodes.first[node], nodes.last[node])
        holds = (least < lower - ROOM) & (most > upper + ROOM)
        found = np.where(nodes.full[node] & holds.all(axis=1), 0.0, -1.0)
        return BoxBounds(found, np.argmax(upper - lower, axis=1), center, self.reference(center))

    def rounding_bound(self) -> float:
        """See ``Bounder``; none: what rounds is paid for by room around the boxes, and f is 0 or -1."""
        return 0.0
