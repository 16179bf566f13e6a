"""A tree of bounders: the domain is cut again and again, and a small bounder holds its part of the object in each leaf.

A point goes down to one leaf, by comparisons, and is asked by the box around the leaf's part of the object and by the
leaf's own bounder; so a tree of many small networks costs about as much as one of them. A leaf bounds what the
object has in its region and nothing else. The regions of both sides of a cut overlap by what is rounded on the way to a leaf, so
together they hold all that their parent's holds.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from warp_bounding.arithmetic import round_down, round_up
from warp_bounding.bounders import Bounder, compose, method_class
from warp_bounding.bounders.composition.composition import Composition
from warp_bounding.bounders.composition.cover import Region, check_cover, split_regions
from warp_bounding.bounders.composition.tree import AND, SPLIT, Tree
from warp_bounding.bounders.local.lattice import NEAREST_TO_ZERO
from warp_bounding.bounders.neural.mlp import Mlp
from warp_bounding.bounders.options import settled
from warp_bounding.bounders.slabs.aabb import Aabb
from warp_bounding.bounders.volume import VolumeBounder
from warp_bounding.coordinates.domain import Domain
from warp_bounding.coordinates.region_domain import domain_of
from warp_bounding.errors import BounderError
from warp_bounding.evaluation import quick_rates
from warp_bounding.indicators import load_indicator
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.parts.clipped import part_of
from warp_bounding.indicators.shape import Shape
from warp_bounding.proof import prove
from warp_bounding.queries.boundary import border_points
from warp_bounding.queries.point import POINT
from warp_bounding.runtime.devices import device_of
from warp_bounding.runtime.progress import Progress, reported
from warp_bounding.training.checks import check_numbers, warn_of_restriction
from warp_bounding.training.fit import LEAST_SHARE, SHAPE_BOXES, SHAPE_EPS, Stopwatch, described
from warp_bounding.training.problem import Problem
from warp_bounding.training.trainers import trainer_of

__all__ = ["hierarchy"]

MOST_LEVELS = 8
MOST_LEAVES = 2**MOST_LEVELS
# By how much a leaf's region reaches beyond the points of the border that are known, of the longest side: the first that
# the shape certifies to hold all is taken.
TIGHT = (2.0**-9, 2.0**-7, 2.0**-5, 2.0**-3)
BORDER = 65_536  # points of the border that tell where to cut
CUTS = (0.5, 0.75, 1.0, 1.25, 1.5)  # of convex leaves: where cuts are tried, in shares of an even one
# Of a convex hull that tells what a cut costs: how many points it is of, about, and their least size, object units.
HULL, TINIEST = 1024, 1e-12
# Of the proof of a node's box: the gap of f, in local units, and the boxes after which it ends.
BOX_EPS, BOX_BOXES = 1e-3, 200_000


@dataclass(frozen=True)
class _Node:
    """A region, object space, float32 numbers; and the axis, the place in v and the sides where it is split, no leaf."""

    lower: np.ndarray
    upper: np.ndarray
    border: np.ndarray  # points of the object's border in it
    axis: int = 0
    place: float = 0.0
    children: tuple["_Node", ...] = ()

    def leaves(self) -> Iterator["_Node"]:
        if not self.children:
            yield self
        for child in self.children:
            yield from child.leaves()


def hierarchy(
    shape,
    query: str = "point",
    method: str = "mlp",
    *,
    levels: int = 3,
    leaves: int | None = None,
    budget: float = 60.0,
    seed: int = 0,
    margin: float = 0.0,
    device: str | None = None,
    progress: Progress | bool | None = None,
    **options,
) -> Composition:
    """Fit a tree of bounders to a shape, and prove it part by part.

    The union of k-DOPs with learned half-spaces, each around its part of the object, is such a tree too:
    ``method="learned-kdop"``.

    Args:
        shape: As of ``fit``; no cells are laid over it.
        query: ``"point"``.
        method: Of the leaves, a name in ``METHODS``.
        levels: How often the object is halved, 1 to 8; there are 2^levels leaves.
        leaves: How many leaves there are instead, 2 to 256; each gets about the same share of the object's border.
        budget: Seconds for all leaves together.
        seed: Seed of everything random.
        margin: The object is dilated by this length first, object units.
        device: Warp device; the default device if ``None``.
        progress: As of ``fit``.
        **options: The method's own, of each leaf, such as ``hidden=(16, 16)``.

    Returns:
        The composition, with ``certificate`` and ``info``.

    Raises:
        IndicatorError: If the shape cannot be read or bounded.
        BounderError: For a kind of query, method or option that a leaf does not take, or a shape that certifies nothing.

    Example:
        >>> tree = wb.hierarchy(ball, method="kdop", levels=1, device="cpu", progress=False)
        >>> tree.certificate.proven, len(tree.parts)
        (True, 4)
    """
    if query != POINT.name:
        raise BounderError(f"a hierarchy bounds point queries, got {query!r}")
    if isinstance(levels, bool) or not isinstance(levels, (int, np.integer)) or not 1 <= levels <= MOST_LEVELS:
        raise BounderError(f"levels must be a whole number from 1 to {MOST_LEVELS}, got {levels!r}")
    if leaves is not None and (type(leaves) is not int or not 2 <= leaves <= MOST_LEAVES):
        raise BounderError(f"leaves must be a whole number from 2 to {MOST_LEAVES}, got {leaves!r}")
    check_numbers(budget, seed, margin)
    device_of(device)
    spent, shape = Stopwatch(), load_indicator(shape)
    shape = shape.dilated(margin) if isinstance(shape, Shape) else shape.to_grid(margin=margin)
    warn_of_restriction(shape)
    cls = method_class(method, query, shape.ndim)
    if not cls.conservative or cls.lays_cells:
        raise BounderError(f"{method}: cannot be a leaf of a hierarchy")
    (told,) = settled([cls], query, options, [hierarchy])
    shape.check()
    shape.check_contents()
    if not shape.certified:
        raise BounderError(f"{shape.name} certifies no box to be empty, so the parts of a hierarchy have no proof")
    domain = domain_of(shape, query)
    root = _shared_out(shape, domain, leaves or 2 ** int(levels), issubclass(cls, VolumeBounder), seed)
    builder = _Builder(shape, domain, cls, told, seed, device)
    count = len(list(root.leaves()))
    with reported(progress, f"hierarchy of {count} {method}") as update:
        tree = builder.build(root, budget, count, spent, update)
    whole = compose(tree, builder.parts, builder.regions, shape)
    whole.info = described(shape, seed, {"leaves": builder.records} | spent.seconds())
    whole.info["rates"] = quick_rates(whole, shape)
    return whole


def _shared_out(shape: Shape, domain: Domain, leaves: int, convex: bool, seed: int) -> _Node:
    """Regions that share the border out, evenly or if the leaves are convex about evenly, each cut where it costs least.

    Of convex leaves that is where the sides' convex hulls are smallest, of others where the boxes are, by the border in them.
    """
    points, cost = border_points(shape, BORDER, np.random.default_rng(seed)), _hull if convex else _box

    def cut(lower: np.ndarray, upper: np.ndarray, border: np.ndarray, leaves: int) -> _Node:
        first_leaves = leaves // 2
        share = first_leaves / leaves
        shares = [share * part for part in (CUTS if convex else (1.0,)) if share * part < 1]
        tried = [
            _cut(shape, border, axis, each, cost)
            for axis in range(shape.ndim)
            for each in shares
            if leaves > 1 < len(border)
        ]
        tried = [each for each in tried if each is not None]
        if not tried:
            return _Node(lower, upper, border)
        _, axis, middle, below = min(tried, key=lambda each: each[0])
        place = np.float32(domain.to_local(np.full(domain.ndim, middle))[axis])
        place = float(place if abs(place) >= NEAREST_TO_ZERO else np.float32(NEAREST_TO_ZERO))
        (_, first), (last, _) = split_regions(domain, axis, place)
        sides = (
            cut(lower, np.minimum(upper, first), border[below], first_leaves),
            cut(np.maximum(lower, last), upper, border[~below], leaves - first_leaves),
        )
        return _Node(lower, upper, border, axis, place, sides)

    least = np.full(shape.ndim, -np.inf)
    return cut(least, -least, points, leaves)


def _cut(
    shape: Shape, border: np.ndarray, axis: int, share: float, cost: Callable[[np.ndarray, np.ndarray], float]
) -> tuple[float, int, float, np.ndarray] | None:
    """A cut with this share of the border below it: cost, axis, place and which points lie below; ``None`` if none do.

    Cells are cut through their centres. A cut along their faces, where a grid's border lies, would leave the cells that it
    touches to both halves, to one of them as faces without a volume, which no sample would ever show to its leaf.
    """
    place = float(np.quantile(border[:, axis], share))
    if isinstance(shape, IndicatorGrid):
        scale, offset = shape.cells_per_unit[axis], shape.offset[axis]
        place = float((np.floor(place * scale - offset) + offset) / scale)
    below = border[:, axis] <= place
    if below.all() or not below.any():
        return None
    room = 1e-3 * np.ptp(border, axis=0)
    return sum(cost(side, room) for side in (border[below], border[~below])), axis, place, below


def _box(border: np.ndarray, room: np.ndarray) -> float:
    """Volume of the box around points, times their number."""
    return len(border) * float(np.prod(np.ptp(border, axis=0) + room))


def _hull(border: np.ndarray, room: np.ndarray) -> float:
    """Volume of the convex hull of points, each drawn out to a small box, so that there always is one."""
    from scipy.spatial import ConvexHull

    few = border[:: -(-len(border) // HULL)]
    corners = np.array(list(product((-1, 1), repeat=border.shape[1]))) * np.maximum(room, TINIEST)
    return float(ConvexHull((few[:, None] + corners).reshape(-1, border.shape[1])).volume)


class _Builder:
    """Parts and regions of the composition, in the order in which they are asked."""

    def __init__(self, shape: Shape, domain: Domain, cls: type[Bounder], told: dict[str, Any], seed: int, device):
        self.shape, self.domain, self.cls, self.told = shape, domain, cls, told
        self.seed, self.device = int(seed), device
        self.parts: list[Bounder] = []
        self.regions: list[Region] = []
        self.records: list[dict[str, Any]] = []

    def build(self, node: _Node, budget: float, leaves: int, spent: Stopwatch, progress: Progress | None) -> Tree:
        """The tree of a node; what is left of the budget is shared by the leaves that are left."""
        if node.children:
            halves = [self.build(child, budget, leaves, spent, progress) for child in node.children]
            return [SPLIT, node.axis, node.place, *halves]
        region = self._tightened(node)
        own = part_of(self.shape, region)
        box = Aabb.fit(own, self.domain, device=self.device)
        prove(box, own, eps=BOX_EPS, boxes=BOX_BOXES)
        guard = self._add(box, region)
        left = leaves - len(self.records)
        seconds = max(budget - spent.working, LEAST_SHARE * budget) / left
        if progress:
            progress(len(self.records), leaves, f"leaf {len(self.records) + 1} of {leaves}")
        return [AND, guard, self._add(self._leaf(own, seconds), region)]

    def _tightened(self, node: _Node) -> Region:
        """The smallest box around the node's part of the object that the shape certifies to hold it, about."""
        whole, size = part_of(self.shape, (node.lower, node.upper)), float(self.shape.extent.max())
        if not len(node.border):
            return node.lower, node.upper
        for room in TIGHT:
            low, high = (
                round_down(node.border.min(axis=0) - room * size),
                round_up(node.border.max(axis=0) + room * size),
            )
            region = np.maximum(low, node.lower), np.minimum(high, node.upper)
            try:
                check_cover(whole, [region])
            except BounderError:
                continue
            return region
        return node.lower, node.upper

    def _leaf(self, own: Shape, seconds: float) -> Bounder:
        network = issubclass(self.cls, Mlp)
        domain = domain_of(own, POINT.name) if network else self.domain  # a network learns best in a domain of its own
        target = self.domain if network else None
        problem = Problem(own, domain, POINT.name, self.seed, self.device, target=target)
        bounder, record = trainer_of(self.cls).train(self.cls, problem, self.told, seconds, None)
        self.records.append(record)
        if not network:
            prove(bounder, own, eps=SHAPE_EPS, boxes=SHAPE_BOXES)
        return bounder

    def _add(self, part: Bounder, region: Region) -> int:
        self.parts.append(part)
        self.regions.append(region)
        return len(self.parts) - 1
