"""Random points in the cells of a grid: a cell's index and an offset in [-1/2, 1/2]^n, as columns.

What is hard for a network lies on the boundary: most points are in cells that touch an empty one, and most of their
coordinates on a face of the cell, for regions rather on a face behind which it is empty.
"""

from itertools import product

import numpy as np
import torch

from warp_bounding.coordinates.domain import Domain
from warp_bounding.indicators.grid import IndicatorGrid

__all__ = ["CellPoints", "ObjectPoints", "columns"]

BOUNDARY_SHARE = 2 / 3  # of the points: in cells that touch an empty one
FACE_SHARE = 0.6  # of the coordinates of these points: on a face of the cell
EXPOSED_SHARE = 0.9  # of the coordinates on a face, where just one of the two is exposed: on that one


class ObjectPoints:
    """Random points of an object, given as a cell and an offset from its middle, in cells.

    Attributes:
        unit: ``(n, 1)``, sides of a cell in local space.
        origin: ``(n, 1)``, the middle of cell 0.
        lower: ``(n, 1)``, of the object's box in local space.
        upper: ``(n, 1)``.
        detail: ``(n, 1)``, cells along each axis, relative to the axis with most.
    """

    ndim: int
    generator: torch.Generator
    unit: torch.Tensor
    origin: torch.Tensor
    lower: torch.Tensor
    upper: torch.Tensor
    detail: torch.Tensor

    def draw(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Cells and offsets: most in boundary cells and on cell faces, the rest uniform in the object."""
        raise NotImplementedError

    def draw_touching(self, count: int, share: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Boundary cells, offsets, and sides ``(n, count)``: 1 or -1 on a cell's upper or lower face, else 0.

        A ``share`` of the coordinates is on a face.
        """
        raise NotImplementedError

    def settled(self, before: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
        """Cells and offsets ``(2 n, N)`` of points of the object, after offsets have moved."""
        return after

    def grow(self) -> None:
        """Called once a refresh, by those who find points as training goes on."""

    def to_local(self, t: torch.Tensor) -> torch.Tensor:
        """Local coordinates of cell coordinates, both ``(n, N)``."""
        return t * self.unit + self.origin

    def pick(self, cells: torch.Tensor, count: int) -> torch.Tensor:
        """``(n, count)`` random ones of the cells ``(n, C)``."""
        if not count:
            return cells[:, :0]
        return cells.index_select(1, self.integers(cells.shape[1], count))

    def rand(self, *shape: int) -> torch.Tensor:
        """Uniform numbers in [0, 1) of this shape."""
        return torch.rand(*shape, generator=self.generator)

    def integers(self, end: int, count: int) -> torch.Tensor:
        """``(count,)`` uniform whole numbers from 0 to ``end - 1``."""
        return torch.randint(end, (count,), generator=self.generator)


class CellPoints(ObjectPoints):
    """Points of a grid's object, in its cells; the domain of points gives the map to local space."""

    def __init__(self, grid: IndicatorGrid, domain: Domain, generator: torch.Generator):
        self.grid, self.generator, self.ndim = grid, generator, grid.ndim
        origin, one = (domain.to_local(grid.position(at(grid.ndim))) for at in (np.zeros, np.ones))
        sides = [domain.to_local(side) for side in (grid.lower, grid.upper)]
        self.origin, self.unit, self.lower, self.upper = (columns(a[None]) for a in (origin, one - origin, *sides))
        cells = torch.tensor(grid.shape, dtype=torch.float32)[:, None]
        self.detail = cells / cells.max()
        self.occupied, self.boundary = columns(grid.occupied), columns(grid.boundary)
        self._exposed = torch.from_numpy(_exposed_sides(grid))

    def walk(self, state: torch.Tensor, slope: torch.Tensor, step: float | torch.Tensor) -> torch.Tensor:
        """Cells and offsets ``(2 n, N)`` after a move down a slope in local space; all points stay in their cells.

        The largest component moves by ``step`` cells.
        """
        slope = slope * self.unit
        slope /= slope.abs().amax(0, keepdim=True) + 1e-12
        cell, offset = state.chunk(2)
        return torch.cat([cell, (offset - step * slope).clamp_(-0.5, 0.5)])

    def draw(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """See ``ObjectPoints``."""
        near = int(count * BOUNDARY_SHARE) if self.boundary.shape[1] else 0
        offset = self.rand(self.ndim, count) - 0.5
        snap = self.rand(self.ndim, near) < FACE_SHARE
        offset[:, :near] = torch.where(snap, torch.sign(offset[:, :near]) * 0.5, offset[:, :near])
        return torch.cat([self.pick(self.boundary, near), self.pick(self.occupied, count - near)], 1), offset

    def draw_touching(self, count: int, share: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """See ``ObjectPoints``."""
        cells, exposed = (self.boundary, self._exposed) if self.boundary.shape[1] else (self.occupied, None)
        index = self.integers(cells.shape[1], count)
        offset = self.rand(self.ndim, count) - 0.5
        side = torch.sign(offset)
        if exposed is not None:
            known = exposed.index_select(1, index)
            side = torch.where((known != 0) & (self.rand(self.ndim, count) < EXPOSED_SHARE), known.float(), side)
        side = side * (self.rand(self.ndim, count) < share)
        return cells.index_select(1, index), torch.where(side != 0, 0.5 * side, offset), side

    def boundary_vertices(self) -> torch.Tensor:
        """``(n, K)`` local coordinates of the corners between occupied and empty cells."""
        return self.to_local(columns(_boundary_vertices(self.grid.occupancy)) - 0.5)

    def locate(self, y: np.ndarray) -> tuple[torch.Tensor, torch.Tensor, np.ndarray]:
        """Cells and offsets of points found elsewhere, and which of them they are: ``(N,)`` bool.

        Args:
            y: ``(N, n)`` float64, local space; a point in no occupied cell, by rounding, is dropped.
        """
        t = (y - self.origin.numpy().T.astype(np.float64)) / self.unit.numpy().T
        cell = np.rint(t).astype(np.int64)
        inside = ((cell >= 0) & (cell < self.grid.shape)).all(axis=1)
        inside[inside] = self.grid.occupancy[tuple(cell[inside].T)]
        cell, t = cell[inside], t[inside]
        return columns(cell), columns(np.clip(t - cell, -0.5, 0.5)), inside


def _boundary_vertices(occupancy: np.ndarray) -> np.ndarray:
    """``(P, n)`` indices of cell corners between occupied and empty cells; corner i is at ``t = i - 1/2``."""
    padded = np.pad(occupancy, 1)
    some, every = np.zeros([r + 1 for r in occupancy.shape], bool), np.ones([r + 1 for r in occupancy.shape], bool)
    for shift in product((0, 1), repeat=occupancy.ndim):
        part = padded[tuple(slice(s, s + r + 1) for s, r in zip(shift, occupancy.shape, strict=True))]
        some |= part
        every &= part
    return np.argwhere(some & ~every)


def _exposed_sides(grid: IndicatorGrid) -> np.ndarray:
    """``(n, B)`` int8: on which side of a boundary cell it is empty, 1 above, -1 below, 0 for both or neither."""
    padded = np.pad(grid.occupancy, 1, constant_values=True)
    index = grid.boundary + 1
    sides = []
    for axis in range(grid.ndim):
        step = np.arange(grid.ndim) == axis
        above, below = (~padded[tuple((index + s * step).T)] for s in (1, -1))
        sides.append(above.astype(np.int8) - below.astype(np.int8))
    return np.array(sides).reshape(grid.ndim, -1)


def columns(rows: np.ndarray) -> torch.Tensor:
    """``(N, n)`` numbers as ``(n, N)`` float32."""
    return torch.from_numpy(np.ascontiguousarray(rows.T, dtype=np.float32))
