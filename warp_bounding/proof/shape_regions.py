"""The positives of a network of rays or boxes of a shape without cells: coarse cells first, the shape itself where they fail.

Cells that hold the shape are laid over it, and the boxes of their cover (``proof.covers``) hold all positives. They are
searched as in ``search.vacancy``: where the bound of f is too low in a box, the shape is asked whether the regions in it
can meet it at all (``Cover.reach``), and the box is dropped where it certifies that they cannot. So cells are refined,
without being laid, where the network would fail on them and only there.
"""

from collections.abc import Callable
from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np

from warp_bounding.bounders.mlp import Mlp
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.shape import OUT, Shape
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.proof.covers import COVERS
from warp_bounding.proof.search.best_first import Search, minimum
from warp_bounding.proof.search.depth_first import charted_minimum
from warp_bounding.proof.search.half_space import HeldBounds
from warp_bounding.proof.search.vacancy import NARROWEST, Positives
from warp_bounding.queries import QUERIES
from warp_bounding.runtime.launch import working_seconds

__all__ = ["ShapeRegions", "coarse_cells", "least_region"]

CELLS, MOST_CELLS = 2.0**21, 2.0**26  # about how many cells are laid in the box around a shape, and at most
MOST_RESOLUTION = 1024
# Regions of a shape: cells along the longest side, as shares of the usual number; the share of the limits that the search
# of each may take; how many times as long as the one before it one of finer cells takes, and one of the shape itself.
CELL_SHARES, FIRST_SHARE, FINER_TIMES, SHAPE_TIMES = (1.0, 2.0, 3.0), 0.7, 2.5, 8.0

_CELLS: WeakKeyDictionary[Shape, dict[int, IndicatorGrid]] = WeakKeyDictionary()


def coarse_cells(shape: Shape, share: float = 1.0) -> IndicatorGrid:
    """Cells that hold a shape, its margin included; a ``share`` of the usual number along its longest side."""
    usual, most = (count ** (1 / shape.ndim) for count in (CELLS, MOST_CELLS))
    resolution = round(min(share * usual, most, MOST_RESOLUTION))
    known = _CELLS.setdefault(shape, {})
    if resolution not in known:
        known[resolution] = shape.to_grid(resolution=resolution, margin=shape.margin)
    return known[resolution]


class ShapeRegions(Positives):
    """P_delta of a shape for a kind of region, as boxes of a chart's numbers z; with what ``search.minimum`` asks for.

    Args:
        bounder: Its f is bounded.
        shape: The object.
        cells: That hold it (``coarse_cells``).
        narrowest: See ``vacancy.NARROWEST``.
    """

    def __init__(self, bounder: Mlp, shape: Shape, cells: IndicatorGrid, narrowest: float = NARROWEST):
        self.bounder, self.shape, self.cells, self.domain = bounder, shape, cells, bounder.domain
        self.kind, self._query = COVERS[bounder.query_kind], QUERIES[bounder.query_kind]
        self.cover = self.kind.charted(bounder, cells)
        self._narrow = narrowest + self._sides(self.cover.lower[:1], self.cover.lower[:1]).max(initial=0.0)
        self.asked = 0  # boxes that the shape was asked about

    def boxes(self) -> tuple[np.ndarray, np.ndarray]:
        """See ``Positives``."""
        return self.cover.lower, self.cover.upper

    def reference(self, z: np.ndarray) -> np.ndarray:
        """See ``Positives``."""
        return self.bounder.reference(self.coordinates(z))

    def coordinates(self, z: np.ndarray) -> np.ndarray:
        """``v`` of numbers z."""
        return self.cover.coordinates(z)

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """See ``Positives``; ``boxes`` are without what the chart has cut off, by the cells."""
        return self.cover.bound(lower, upper)

    def vacant(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """See ``Positives``: no positive of the shape lies in the closed box, but for those that others have, too."""
        vacant = np.zeros(len(lower), dtype=bool)
        for pieces in self.kind.pieces:
            left = np.flatnonzero(~vacant)
            low, high = self.kind.reach(self.cover, lower[left], upper[left], pieces)
            shape = low.shape
            low, high = self.domain.base.origins(low.reshape(-1, shape[2]), high.reshape(-1, shape[2]))
            empty = (low > high).any(axis=1)
            some = np.flatnonzero(~empty)
            self.asked += len(some)
            empty[some] = self.shape.empty(low[some], high[some])
            vacant[left] = empty.reshape(shape[:2]).all(axis=1)
        return vacant

    def held(self, lower: np.ndarray, upper: np.ndarray, bounds: BoxBounds, target: np.ndarray) -> HeldBounds:
        """See ``Positives``; corners are without what the chart has cut off."""
        low, high = bounds.boxes.swapaxes(0, 1)
        least = np.where(self.vacant(low, high), np.inf, bounds.lower)
        return HeldBounds(least, bounds.axis, (low, high), np.zeros(len(low), dtype=bool))

    def too_small(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """See ``Positives``."""
        return self._sides(lower, upper).max(axis=1) <= self._narrow

    def _sides(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """``(N, ndim)`` sides of the boxes of v that boxes of z can reach, noise included."""
        low, high = self.cover.chart.hull(lower, upper, self.cover.numbers)
        return high - low

    def holds(self, z: np.ndarray) -> np.ndarray:
        """See ``Positives``."""
        q = self.domain.to_object(self.coordinates(z))
        return self._query.decide(self.shape, q, self.domain.oracle_length) != OUT


def least_region(
    bounder: Mlp,
    shape: Shape,
    known: float,
    *,
    eps: float,
    seconds: float,
    boxes: float,
    progress: Callable[[int, float, float], None] | None,
) -> Search:
    """``least_value`` of rays or boxes of a shape without cells, which knows a positive with f of ``known``.

    A bound over cells that hold the shape holds for the shape. Coarse cells come first, then finer ones as long as time is
    expected to suffice, and at last the shape itself. ``needed`` of the result is about the first cells alone.
    """
    started, cover_of, best = working_seconds(), COVERS[bounder.query_kind].charted, None

    def left(share: float = 1.0) -> dict[str, float]:
        spent, done = working_seconds() - started, best.boxes if best else 0
        return {"seconds": share * (seconds - spent), "boxes": share * (boxes - done)}

    for share in CELL_SHARES:
        before, cells = working_seconds(), coarse_cells(shape, share)
        found = charted_minimum(cover_of(bounder, cells), eps=eps, progress=progress, **left(FIRST_SHARE))
        best = found if best is None else _better(best, found)
        took = working_seconds() - before
        limit = left()
        if not found.complete or best.lower_bound >= known - eps or limit["seconds"] < FINER_TIMES * took:
            break
    rest = limit["seconds"] >= SHAPE_TIMES * took and limit["boxes"] >= SHAPE_TIMES * found.boxes
    if found.complete and best.lower_bound < known - eps and rest:
        positives = ShapeRegions(bounder, shape, cells)
        own = minimum(
            positives, *positives.boxes(), positives=positives, known=known, eps=eps, progress=progress, **limit
        )
        best, known = _better(best, own), min(known, own.upper_bound)
    complete = best.lower_bound >= known - eps
    spent = working_seconds() - started
    nothing = np.empty((0, bounder.domain.ndim))
    return replace(best, upper_bound=known, worst=nothing, numbers=None, seconds=spent, complete=complete)


def _better(one: Search, other: Search) -> Search:
    """The first of two searches for the same least value, with the higher of both bounds."""
    return replace(one, lower_bound=max(one.lower_bound, other.lower_bound), boxes=one.boxes + other.boxes)
