"""A hierarchy of two levels, the paper's: a root, and children of which any may say *maybe*.

The root is the box of the domain. The object is cut again and again, and a child bounds what the object has in its
region, and nothing else: a box around it, then a small bounder of the child's own. The regions together hold the object
(``bounders.union``).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_bounding.bounders import Bounder, Union, method_class, united
from warp_bounding.bounders.bounder import resolved
from warp_bounding.bounders.cascade import Cascade
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.bounders.union import Region, check_cover
from warp_bounding.bounders.volumes import Aabb
from warp_bounding.certificates import conjunction
from warp_bounding.errors import BounderError
from warp_bounding.evaluation import quick_rates
from warp_bounding.proof import prove
from warp_bounding.queries.boundary import border_points
from warp_bounding.queries.domain import Domain
from warp_bounding.queries.point import POINT
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.rounding import round_down, round_up
from warp_bounding.runtime.launch import device_of
from warp_bounding.runtime.progress import Progress, reported
from warp_bounding.shapes import load_shape
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.parts import part_of
from warp_bounding.shapes.recentred import own_coordinates
from warp_bounding.shapes.shape import Shape
from warp_bounding.training.fit import (
    SHAPE_BOXES,
    SHAPE_EPS,
    Stopwatch,
    check_numbers,
    described,
    trainer_of,
    warn_of_little,
    warn_of_restriction,
)
from warp_bounding.training.samples import Problem

__all__ = ["hierarchy"]

MOST_LEVELS = 8
# By how much a leaf's region reaches beyond the points of the border that are known, of the longest side: the first
# that the shape certifies to hold all is taken.
TIGHT = (2.0**-9, 2.0**-7, 2.0**-5, 2.0**-3)
BORDER = 65_536  # points of the border that tell where to cut
# Of the proof of a node's box: the gap of f, in local units, and the boxes after which it ends.
BOX_EPS, BOX_BOXES = 1e-3, 200_000


@dataclass(frozen=True)
class _Leaf:
    """A region, object space, float32 numbers."""

    lower: np.ndarray
    upper: np.ndarray
    border: np.ndarray  # points of the object's border in it


def hierarchy(
    shape,
    query: str = "point",
    method: str = "mlp",
    *,
    levels: int = 3,
    budget: float = 60.0,
    seed: int = 0,
    margin: float = 0.0,
    device: str | None = None,
    progress: Progress | bool | None = None,
    **options,
) -> Union:
    """Fit bounders to the parts of a shape and prove each: *maybe* where one of them says so.

    Args:
        shape: As in ``fit``; no cells are laid over it.
        query: ``"point"``.
        method: Of the leaves, a name in ``METHODS``.
        levels: How often the object is halved, 1 to 8; there are 2^levels leaves, each with about the
            same share of its border.
        budget: Seconds for all leaves together.
        seed: Seed of everything random.
        margin: The object is dilated by this length first, object units.
        device: Warp device; the default device if ``None``.
        progress: As in ``fit``.
        **options: The method's own, of each leaf, such as ``hidden=(16, 16)``.

    Returns:
        The union, with ``certificate`` and ``info``.

    Raises:
        ShapeError: If the shape cannot be read or bounded.
        BounderError: For a kind of query, method or option that a leaf does not take, or a shape that certifies
            nothing.

    Example:
        >>> def distance(x):
        ...     return np.linalg.norm(x, axis=1) - 1.0
        >>> disk = wb.shapes.Function(None, [-1, -1], [1, 1], distance=distance)
        >>> tree = wb.hierarchy(disk, method="kdop", levels=1, device="cpu", progress=False)
        >>> tree.certificate.proven, len(tree.parts)
        (True, 2)
    """
    if query != POINT.name:
        raise BounderError(f"a hierarchy bounds point queries, got {query!r}")
    if isinstance(levels, bool) or not isinstance(levels, (int, np.integer)) or not 1 <= levels <= MOST_LEVELS:
        raise BounderError(f"levels must be a whole number from 1 to {MOST_LEVELS}, got {levels!r}")
    check_numbers(budget, seed, margin)
    device_of(device)
    spent, shape = Stopwatch(), own_coordinates(load_shape(shape), "hierarchy")
    shape = shape.dilated(margin) if isinstance(shape, Shape) else shape.to_grid(margin=margin)
    warn_of_restriction(shape)
    cls = method_class(method, query, shape.ndim)
    if not cls.conservative or cls.lays_cells:
        raise BounderError(f"{method}: cannot be a leaf of a hierarchy")
    (told,) = resolved([cls], query, options, [hierarchy])
    shape.check()
    shape.check_contents()
    if not shape.certified:
        raise BounderError(f"{shape.name} certifies no box to be empty, so the parts of a hierarchy have no proof")
    domain = domain_of(shape, query)
    regions = _halved(shape, int(levels), seed)
    builder = _Builder(shape, domain, cls, told, seed, device)
    with reported(progress, f"hierarchy of {len(regions)} {method}") as update:
        for number, leaf in enumerate(regions):
            if update:
                update(number, len(regions), f"leaf {number + 1} of {len(regions)}")
            builder.add(leaf, spent.left(budget) / (len(regions) - number))
    whole = united(builder.parts, builder.regions, shape)
    whole.info = described(shape, seed, {"leaves": builder.records} | spent.seconds())
    whole.info["rates"] = quick_rates(whole, shape)
    warn_of_little(whole)
    return whole


def _halved(shape: Shape, levels: int, seed: int) -> list[_Leaf]:
    """Regions that share the border evenly, cut where the boxes around the halves' borders are smallest.

    Both sides of a cut are closed: the border between them is in both.
    """

    def cut(lower: np.ndarray, upper: np.ndarray, border: np.ndarray, levels: int) -> list[_Leaf]:
        tried = [_cut(shape, border, axis) for axis in range(shape.ndim) if levels and len(border) > 1]
        tried = [each for each in tried if each is not None]
        if not tried:
            return [_Leaf(lower, upper, border)]
        _, axis, place, below = min(tried, key=lambda each: each[0])
        middle_low, middle_high = lower.copy(), upper.copy()
        middle_low[axis] = middle_high[axis] = np.float32(place)
        first = cut(lower, middle_high, border[below], levels - 1)
        return first + cut(middle_low, upper, border[~below], levels - 1)

    least = np.full(shape.ndim, -np.inf)
    return cut(least, -least, border_points(shape, BORDER, np.random.default_rng(seed)), levels)


def _cut(shape: Shape, border: np.ndarray, axis: int) -> tuple[float, int, float, np.ndarray] | None:
    """A cut with half of the border below it: cost, axis, place and which points lie below; ``None`` if none do.

    It costs the volumes of the boxes around the sides' points, times their numbers.

    Cells are cut through their centres. A cut along their faces, where a grid's border lies, would leave the cells that
    it touches to both halves, to one of them as faces without a volume, which no sample would ever show to its leaf.
    """
    place = float(np.quantile(border[:, axis], 0.5))
    if isinstance(shape, Grid):
        scale, offset = shape.cells_per_unit[axis], shape.offset[axis]
        place = float((np.floor(place * scale - offset) + offset) / scale)
    below = border[:, axis] <= place
    if below.all() or not below.any():
        return None
    room = 1e-3 * np.ptp(border, axis=0)
    boxes = [len(side) * float(np.prod(np.ptp(side, axis=0) + room)) for side in (border[below], border[~below])]
    return sum(boxes), axis, place, below


class _Builder:
    """Parts and regions of the union, in the order in which they are queried."""

    def __init__(self, shape: Shape, domain: Domain, cls: type[Bounder], told: dict[str, Any], seed: int, device):
        self.shape, self.domain, self.cls, self.told = shape, domain, cls, told
        self.seed, self.device = int(seed), device
        self.parts: list[Bounder] = []
        self.regions: list[Region] = []
        self.records: list[dict[str, Any]] = []

    def add(self, leaf: _Leaf, seconds: float) -> None:
        """Bound what the object has in a leaf's region, by a box and by a bounder of the class."""
        region = self._tightened(leaf)
        own = part_of(self.shape, region)
        box = Aabb.fit(own, self.domain, device=self.device)
        prove(box, own, eps=BOX_EPS, boxes=BOX_BOXES)
        within = self._fitted(own, seconds)
        part = Cascade.of([box, within])
        self.parts.append(part.freeze(float(part.threshold), conjunction([box.certificate, within.certificate])))
        self.regions.append(region)

    def _tightened(self, leaf: _Leaf) -> Region:
        """The smallest box around the leaf's part of the object that the shape certifies to hold it, about."""
        whole, size = part_of(self.shape, (leaf.lower, leaf.upper)), float(self.shape.extent.max())
        if not len(leaf.border):
            return leaf.lower, leaf.upper
        for room in TIGHT:
            low, high = (
                round_down(leaf.border.min(axis=0) - room * size),
                round_up(leaf.border.max(axis=0) + room * size),
            )
            region = np.maximum(low, leaf.lower), np.minimum(high, leaf.upper)
            try:
                check_cover(whole, [region])
            except BounderError:
                continue
            return region
        return leaf.lower, leaf.upper

    def _fitted(self, own: Shape, seconds: float) -> Bounder:
        network = issubclass(self.cls, Mlp)
        domain = domain_of(own, POINT.name) if network else self.domain  # a network learns best in a domain of its own
        target = self.domain if network else None
        problem = Problem(own, domain, POINT.name, self.seed, self.device, target=target)
        bounder, record = trainer_of(self.cls).train(self.cls, problem, self.told, seconds, None)
        self.records.append(record)
        if not network:
            prove(bounder, own, eps=SHAPE_EPS, boxes=SHAPE_BOXES)
        return bounder
