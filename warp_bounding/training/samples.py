"""Where training looks: uniform negatives, and positives drawn where a network is likely to fail.

A positive is a cell and an offset in [-1/2, 1/2]^n inside it, so that it can be moved without leaving the object. Labels
are those of the indicator; no sample is ever taken for a proof.
"""

from itertools import product

import numpy as np
import torch

from warp_bounding.bounders.domain import Domain
from warp_bounding.indicators.grid import IndicatorGrid

__all__ = ["Samples"]

BOUNDARY_SHARE = 2 / 3  # of the positives: in cells that touch an empty one
FEWEST_NEGATIVES = 64
FACE_SHARE = 0.6  # of their coordinates: on a face of the cell


class Samples:
    """Random points of a grid, as columns of ``v``.

    Args:
        grid: The object.
        domain: Its domain, which gives the map to ``v``.
        generator: Source of randomness.
    """

    def __init__(self, grid: IndicatorGrid, domain: Domain, generator: torch.Generator):
        self.grid, self.generator, self.ndim = grid, generator, grid.ndim
        origin, unit = (
            domain.to_local(grid.position(np.zeros(grid.ndim))),
            domain.to_local(grid.position(np.ones(grid.ndim))),
        )
        self._origin, self._unit = (torch.from_numpy(a.astype(np.float32))[:, None] for a in (origin, unit - origin))
        shape = np.array(grid.shape)
        self._first = torch.from_numpy(np.where(shape > 1, 0.0, -0.5).astype(np.float32))[:, None]
        self._extent = torch.from_numpy(np.where(shape > 1, shape - 1.0, 1.0).astype(np.float32))[:, None]
        self._table = torch.from_numpy(grid.occupancy.reshape(-1).copy())
        self._stride = torch.tensor([int(np.prod(shape[k + 1 :])) for k in range(grid.ndim)])[:, None]
        self._shape = torch.from_numpy(shape)[:, None]
        self._boundary = _columns(grid.boundary)
        self._occupied = _columns(grid.occupied)
        self.vertices = self.to_local(_columns(_boundary_vertices(grid.occupancy)) - 0.5)

    def to_local(self, t: torch.Tensor) -> torch.Tensor:
        """``v`` of cell coordinates, both ``(n, N)``."""
        return t * self._unit + self._origin

    @property
    def cell_size(self) -> torch.Tensor:
        """``(n, 1)``, a cell's size in ``v``."""
        return self._unit

    def uniform(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """``v`` ``(n, count)`` of uniform points, and their truth ``(count,)``."""
        t = torch.rand(self.ndim, count, generator=self.generator) * self._extent + self._first
        cell = torch.minimum(torch.round(t).long().clamp_(min=0), self._shape - 1)
        return self.to_local(t), self._table[(cell * self._stride).sum(0)]

    def negatives(self, count: int) -> torch.Tensor:
        """``v`` of the negatives among ``count`` uniform points; where that is none, of a few in the empty cells."""
        v, truth = self.uniform(count)
        if truth.all():
            cells = self._pick(_columns(np.argwhere(~self.grid.occupancy)), FEWEST_NEGATIVES)
            return self.to_local(cells + torch.rand(cells.shape, generator=self.generator) - 0.5)
        return v[:, ~truth]

    def positives(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Cells and offsets: most in boundary cells and on cell faces, the rest uniform in the object."""
        near = int(count * BOUNDARY_SHARE) if self._boundary.shape[1] else 0
        offset = torch.rand(self.ndim, count, generator=self.generator) - 0.5
        snap = torch.rand(self.ndim, near, generator=self.generator) < FACE_SHARE
        offset[:, :near] = torch.where(snap, torch.sign(offset[:, :near]) * 0.5, offset[:, :near])
        return torch.cat([self._pick(self._boundary, near), self._pick(self._occupied, count - near)], 1), offset

    def locate(self, v: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
        """Cells and offsets of positives found elsewhere (a proof's search).

        Args:
            v: ``(N, n)`` float64; a point in no occupied cell, by rounding, is dropped.

        Returns:
            Cells and offsets, ``(n, M)`` each.
        """
        t = (v - self._origin.numpy().T.astype(np.float64)) / self._unit.numpy().T
        cell = np.rint(t).astype(np.int64)
        inside = ((cell >= 0) & (cell < self.grid.shape)).all(axis=1)
        inside[inside] = self.grid.occupancy[tuple(cell[inside].T)]
        cell, t = cell[inside], t[inside]
        return _columns(cell), _columns(np.clip(t - cell, -0.5, 0.5))

    def _pick(self, cells: torch.Tensor, count: int) -> torch.Tensor:
        if not count:
            return cells[:, :0]
        return cells.index_select(1, torch.randint(cells.shape[1], (count,), generator=self.generator))


def _columns(rows: np.ndarray) -> torch.Tensor:
    """``(N, n)`` numbers as ``(n, N)`` float32."""
    return torch.from_numpy(np.ascontiguousarray(rows.T, dtype=np.float32))


def _boundary_vertices(occupancy: np.ndarray) -> np.ndarray:
    """``(P, n)`` indices of cell corners between occupied and empty cells; corner i is at ``t = i - 1/2``."""
    padded = np.pad(occupancy, 1)
    some, every = np.zeros([r + 1 for r in occupancy.shape], bool), np.ones([r + 1 for r in occupancy.shape], bool)
    for shift in product((0, 1), repeat=occupancy.ndim):
        part = padded[tuple(slice(s, s + r + 1) for s, r in zip(shift, occupancy.shape, strict=True))]
        some |= part
        every &= part
    return np.argwhere(some & ~every)
