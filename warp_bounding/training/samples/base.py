"""What a kind of query gives to training: uniform samples with their truth, and positives that can be moved.

A positive is a column of *state* numbers, such as a cell and an offset in [-1/2, 1/2]^n inside it for a point, from
which its coordinates ``v`` follow by a formula. Every state in the allowed range is a positive, so a positive can walk
down a network's output without ever leaving the object. Labels are those of the exact oracles; no sample is ever taken
for a proof.
"""

import numpy as np
import torch

from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.shape import Shape
from warp_bounding.queries import oracle, sample
from warp_bounding.training.samples.callers import CALLERS_SHARE, CallersQueries
from warp_bounding.training.samples.cell_points import CellPoints, ObjectPoints, columns
from warp_bounding.training.samples.shape_points import ShapePoints

__all__ = ["FEWEST_NEGATIVES", "LEAST", "LabelledRegions", "RegionSamples", "Samples", "first_ones"]

FEWEST_NEGATIVES = 64  # samples that stand for negatives where uniform samples gave none
LEAST = 1e-12  # local units: added below divisors
APART = 2.0  # cells: edge of the boxes of v of which ``spread`` keeps one state each
LABELLED, PARTS = 1 << 19, 32  # regions of a shape that are labelled and kept in the end, and in how many draws
ATTEMPTS = 20  # batches in which a negative is looked for


class Samples:
    """Random samples of one kind of query, as columns; made of the object, a domain and a source of randomness.

    Attributes:
        query: Kind of query.
        ndim: Length of ``v``.
        generator: Source of everything random.
        detail: ``(ndim, 1)``, the object's cells along each axis of ``v``, relative to the axis with most.
        waves: ``(2 K, ndim + 1)``, a first layer whose sines are those and the cosines of the object's waves (``Shape.waves``); ``None`` where it has none.
        vertices: ``(ndim, K)``, all of the positives where a minimum of f is likely, such as corners; may be none.
        callers: Queries of the caller's own, which take the place of some of the negatives; ``None`` where there are none.
    """

    query = ""
    ndim: int
    generator: torch.Generator
    detail: torch.Tensor
    waves: torch.Tensor | None = None
    vertices: torch.Tensor
    callers: CallersQueries | None = None

    def uniform(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """``v`` ``(ndim, count)`` of samples of the protocol, and their truth ``(count,)``."""
        raise NotImplementedError

    def negatives(self, count: int) -> torch.Tensor:
        """``v`` of the negatives among ``count`` samples: of the protocol, and of the caller's own where there are such; of a few other queries where none is."""
        if self.callers is None:
            return self.usual_negatives(count)
        own = round(CALLERS_SHARE * count)
        return torch.cat([self.callers.negatives(own, self.generator), self.usual_negatives(count - own)], 1)

    def usual_negatives(self, count: int) -> torch.Tensor:
        """``negatives`` of the protocol."""
        raise NotImplementedError

    def positives(self, count: int) -> torch.Tensor:
        """States ``(S, count)``, most where a network is likely to fail."""
        raise NotImplementedError

    def coordinates(self, state: torch.Tensor) -> torch.Tensor:
        """``v`` ``(ndim, N)`` of states."""
        raise NotImplementedError

    def move(self, state: torch.Tensor, slope: torch.Tensor, step: float | torch.Tensor) -> torch.Tensor:
        """States after one step downhill; they stay positives, or ``settled`` makes them positives again.

        Args:
            state: ``(S, N)``.
            slope: ``(ndim, N)``, gradient in ``v``; may be overwritten.
            step: Length, about in cells, one number or ``(N,)``.
        """
        raise NotImplementedError

    def settled(self, before: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
        """States after several moves, as positives: those that have left the object are taken back towards ``before``."""
        return after

    def locate(self, v: np.ndarray) -> torch.Tensor:
        """States of positives ``(N, ndim)`` float64 found elsewhere, but for those that rounding moved off the object."""
        raise NotImplementedError(f"{self.query}: counterexamples come as states")

    def at(self, z: np.ndarray) -> torch.Tensor:
        """States of positives given as numbers ``(N, Z)`` of a proof's chart; some may be dropped."""
        raise NotImplementedError(f"{self.query}: there is no chart")


class LabelledRegions(Samples):
    """Random regions of 2n numbers, labelled by the exact oracle of a grid, or of a shape without cells, where they are kept."""

    def __init__(self, grid: Shape, domain: RegionDomain, generator: torch.Generator):
        self.grid, self.domain, self.generator, self.ndim = grid, domain, generator, 2 * grid.ndim
        self._oracle = oracle(self.query, grid, "cpu", domain.oracle_length)
        self._rng = np.random.default_rng(int(torch.randint(2**62, (1,), generator=generator)))
        self._kept, self._truth = torch.empty(self.ndim, 0), torch.empty(0, dtype=torch.bool)

    def uniform(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        if isinstance(self.grid, IndicatorGrid):
            return self._labelled(count)
        if len(self._truth) < LABELLED:  # of a shape labels take longer
            v, truth = self._labelled(LABELLED // PARTS)
            self._kept, self._truth = torch.cat([self._kept, v], 1), torch.cat([self._truth, truth])
        chosen = torch.randint(len(self._truth), (count,), generator=self.generator)
        return self._kept.index_select(1, chosen), self._truth[chosen]

    def _labelled(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """``uniform``, of fresh samples."""
        q = sample(self.query, self.grid, count, self._rng)
        return columns(self.domain.to_local(q)), torch.from_numpy(self._oracle(q))

    def usual_negatives(self, count: int) -> torch.Tensor:
        # Where (almost) every region meets the object, a few positives stand for them: the loss needs a few columns,
        # and the threshold, which is set on positives, does not depend on them.
        for _ in range(ATTEMPTS):
            v, truth = self.uniform(count)
            if not truth.all():
                return v[:, ~truth]
        return v[:, :FEWEST_NEGATIVES]


class RegionSamples(LabelledRegions):
    """What rays and boxes share.

    The first 2n rows of a state are a cell and an offset, a point of the object in the region.
    """

    def __init__(self, grid: Shape, domain: RegionDomain, generator: torch.Generator):
        of_cells = isinstance(grid, IndicatorGrid)
        self.cells: ObjectPoints = (CellPoints if of_cells else ShapePoints)(grid, domain.base, generator)
        super().__init__(grid, domain, generator)
        self.detail = self.cells.detail.repeat(2, 1)
        self.vertices = torch.empty(self.ndim, 0)

    def spread(self, state: torch.Tensor, most: int) -> torch.Tensor:
        """Of states, hardest first, the first one in each box of ``APART`` cells of v, and no more than ``most``.

        A search's points crowd around few minima, and would fill the hard pool with one place.
        """
        place = (self.coordinates(state) / (APART * self.cells.unit.repeat(2, 1))).floor()
        return first_ones(state, place, most)

    def usual_negatives(self, count: int) -> torch.Tensor:
        self.cells.grow()
        return super().usual_negatives(count)

    def settled(self, before: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
        n = self.grid.ndim
        points = after[: 2 * n]
        held = self.cells.settled(before[: 2 * n], points)
        return after if held is points else torch.cat([held, after[2 * n :]])

    def point(self, state: torch.Tensor) -> torch.Tensor:
        """``(n, N)`` local coordinates of the point of the object."""
        n = self.grid.ndim
        return self.cells.to_local(state[:n] + state[n : 2 * n])


def first_ones(state: torch.Tensor, place: torch.Tensor, most: int) -> torch.Tensor:
    """Of states ``(S, N)`` the first one at each place ``(K, N)``, and no more than ``most``: searches crowd around minima."""
    first = np.unique(place.numpy(), axis=1, return_index=True)[1]
    return state[:, torch.from_numpy(np.sort(first)[:most])]
