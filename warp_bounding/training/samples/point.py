"""Samples of points: a positive is a cell and an offset inside it."""

import numpy as np
import torch

from warp_bounding.coordinates.domain import Domain
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.training.samples.base import FEWEST_NEGATIVES, Samples
from warp_bounding.training.samples.cell_points import CellPoints, columns

__all__ = ["PointSamples"]


class PointSamples(Samples):
    """Random points of a grid; see ``Samples``. A state is a cell (n rows) and an offset (n rows)."""

    query = "point"

    def __init__(self, grid: IndicatorGrid, domain: Domain, generator: torch.Generator):
        self.grid, self.generator, self.ndim = grid, generator, grid.ndim
        self.cells = CellPoints(grid, domain, generator)
        self.detail, self.vertices = self.cells.detail, self.cells.boundary_vertices()
        shape = np.array(grid.shape)
        self._first = columns(np.where(shape > 1, 0.0, -0.5)[None])
        self._extent = columns(np.where(shape > 1, shape - 1.0, 1.0)[None])
        self._table = torch.from_numpy(grid.occupancy.reshape(-1).copy())
        self._stride = torch.tensor([int(np.prod(shape[k + 1 :])) for k in range(grid.ndim)])[:, None]
        self._shape = torch.from_numpy(shape)[:, None]

    def uniform(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        t = self.cells.rand(self.ndim, count) * self._extent + self._first
        cell = torch.minimum(torch.round(t).long().clamp_(min=0), self._shape - 1)
        return self.cells.to_local(t), self._table[(cell * self._stride).sum(0)]

    def usual_negatives(self, count: int) -> torch.Tensor:
        v, truth = self.uniform(count)
        if truth.all():
            cells = self.cells.pick(columns(np.argwhere(~self.grid.occupancy)), FEWEST_NEGATIVES)
            return self.cells.to_local(cells + self.cells.rand(*cells.shape) - 0.5)
        return v[:, ~truth]

    def positives(self, count: int) -> torch.Tensor:
        return torch.cat(self.cells.draw(count))

    def coordinates(self, state: torch.Tensor) -> torch.Tensor:
        return self.cells.to_local(state[: self.ndim] + state[self.ndim :])

    def move(self, state: torch.Tensor, slope: torch.Tensor, step: float | torch.Tensor) -> torch.Tensor:
        return self.cells.walk(state, slope, step)

    def locate(self, v: np.ndarray) -> torch.Tensor:
        return torch.cat(self.cells.locate(v)[:2])
