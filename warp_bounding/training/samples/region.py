"""What samples of rays and boxes share: a point of the object in the region, and labels by the exact oracle."""

import numpy as np
import torch

from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.queries import oracle, sample
from warp_bounding.training.samples.base import Samples, columns
from warp_bounding.training.samples.cell_points import CellPoints

__all__ = ["RegionSamples"]

FEWEST_NEGATIVES = 64  # samples that stand for negatives where there are none
APART = 2.0  # cells: edge of the boxes of v of which ``spread`` keeps one state each
ATTEMPTS = 20  # batches in which a negative is looked for


class RegionSamples(Samples):
    """Random regions of 2n numbers; see ``Samples``. The first 2n rows of a state are a cell and an offset."""

    def __init__(self, grid: IndicatorGrid, domain: RegionDomain, generator: torch.Generator):
        self.grid, self.domain, self.generator, self.ndim = grid, domain, generator, 2 * grid.ndim
        self.cells = CellPoints(grid, domain.base, generator)
        self.detail = self.cells.detail.repeat(2, 1)
        self.vertices = torch.empty(self.ndim, 0)
        self._oracle = oracle(self.query, grid, "cpu", domain.oracle_length)
        self._rng = np.random.default_rng(int(torch.randint(2**62, (1,), generator=generator)))

    def uniform(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        q = sample(self.query, self.grid, count, self._rng)
        return columns(self.domain.to_local(q)), torch.from_numpy(self._oracle(q))

    def negatives(self, count: int) -> torch.Tensor:
        # Where (almost) every region meets the object, a few positives stand for them: the loss needs a few columns,
        # and the threshold, which is set on positives, does not depend on them.
        for _ in range(ATTEMPTS):
            v, truth = self.uniform(count)
            if not truth.all():
                return v[:, ~truth]
        return v[:, :FEWEST_NEGATIVES]

    def spread(self, state: torch.Tensor, most: int) -> torch.Tensor:
        """Of states, hardest first, the first one in each box of ``APART`` cells of v, and no more than ``most``.

        A search's points crowd around few minima, and would fill the hard pool with one place.
        """
        place = (self.coordinates(state) / (APART * self.cells.unit.repeat(2, 1))).floor()
        first = np.unique(place.numpy(), axis=1, return_index=True)[1]
        return state[:, torch.from_numpy(np.sort(first)[:most])]

    def point(self, state: torch.Tensor) -> torch.Tensor:
        """``(n, N)`` local coordinates of the point of the object."""
        n = self.grid.ndim
        return self.cells.to_local(state[:n] + state[n : 2 * n])
