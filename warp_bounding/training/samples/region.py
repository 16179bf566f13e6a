"""What samples of rays and boxes share: a point of the object that the region passes, and labels by the exact oracle."""

import numpy as np
import torch

from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.queries import oracle, sample
from warp_bounding.training.samples.base import Samples, columns
from warp_bounding.training.samples.cell_points import CellPoints

__all__ = ["RegionSamples"]

FEWEST_NEGATIVES = 64
APART = 2.0  # cells
ATTEMPTS = 20  # at finding a negative


class RegionSamples(Samples):
    """Random regions of 2n numbers; see ``Samples``. The first 2n rows of a state are a cell and an offset.

    Args:
        grid: The object.
        domain: Of this kind of query (a ``RegionDomain``).
        generator: Source of randomness.
    """

    def __init__(self, grid: IndicatorGrid, domain: RegionDomain, generator: torch.Generator):
        self.grid, self.domain, self.generator, self.ndim = grid, domain, generator, 2 * grid.ndim
        self.cells = CellPoints(grid, domain.base, generator)
        self.detail = self.cells.detail.repeat(2, 1)
        self.vertices = torch.empty(self.ndim, 0)
        self._oracle = oracle(self.query, grid, "cpu", domain.oracle_length)
        self._rng = np.random.default_rng(int(torch.randint(2**62, (1,), generator=generator)))

    def uniform(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """See ``Samples``."""
        q = sample(self.query, self.grid, count, self._rng)
        return columns(self.domain.to_local(q)), torch.from_numpy(self._oracle(q))

    def negatives(self, count: int) -> torch.Tensor:
        """See ``Samples``; where (almost) every region meets the object, the others are positives.

        The loss needs a few columns, and a threshold that is set on positives does not care.
        """
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
