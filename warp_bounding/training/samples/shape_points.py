"""Random points of a shape without cells, in the form of those in cells: a cell is then anywhere, with its middle at the point.

Points of the border, which bisection finds, and others of the object are kept; their number grows with every refresh of
the training up to a limit, so that training begins at once. A point whose offset has moved it out of the object is taken
back along its way to the last point that is known to be in it.
"""

import numpy as np
import torch

from warp_bounding.coordinates.domain import Domain
from warp_bounding.indicators.shape import Shape
from warp_bounding.queries.boundary import border_points, held_points, pulled
from warp_bounding.training.samples.cell_points import ObjectPoints, columns

__all__ = ["NEAREST", "ShapePoints"]

CELLS = 128  # along the shape's longest side: how far an offset reaches
BORDER = 1 << 17  # points of the border in the end
HELD = 1 << 16  # other points of the object
PARTS = 16  # in which points of the border are found, one for each of the first refreshes
NEAREST = 2.0**-9  # local units: how near to the border a point is brought back that has walked out
BORDER_SHARE = 2 / 3  # of the points: on the border
ASIDE = 0.25  # cells: how far beside a point of the border it is tried whether the object ends there


class ShapePoints(ObjectPoints):
    """Points of a shape; see ``ObjectPoints``. A cell's number is then not whole, and its offset 0."""

    def __init__(self, shape: Shape, domain: Domain, generator: torch.Generator):
        self.shape, self.domain, self.generator, self.ndim = shape, domain, generator, shape.ndim
        self._rng = np.random.default_rng(int(torch.randint(2**62, (1,), generator=generator)))
        size = shape.upper - shape.lower
        self._side = size.max() / CELLS
        self.unit = torch.from_numpy((self._side * domain.scale).astype(np.float32))[:, None]
        self.origin = torch.zeros(self.ndim, 1)
        self.lower, self.upper = (columns(domain.to_local(side)[None]) for side in (domain.lower, domain.upper))
        self.detail = torch.from_numpy((size / size.max()).astype(np.float32))[:, None]
        self._points = held_points(shape, HELD, self._rng)
        self._held = self._cells(self._points)
        self._border, self._ends = torch.empty(self.ndim, 0), torch.empty(self.ndim, 0)
        self.grow()

    def _cells(self, x: np.ndarray) -> torch.Tensor:
        """Cells ``(n, N)`` whose middles are points ``(N, n)`` of object space."""
        return columns(self.domain.to_local(x)) / self.unit

    def grow(self) -> None:
        """See ``ObjectPoints``: more of the border, until there is as much as training can use."""
        if self._border.shape[1] >= BORDER:
            return
        nearest = NEAREST / 4
        border = border_points(self.shape, BORDER // PARTS, self._rng, self._points, nearest)
        ends = []
        for axis in range(self.ndim):
            step = ASIDE * self._side * np.eye(self.ndim)[axis]
            above, below = (~self.shape.contains(border + sign * step) for sign in (1, -1))
            ends.append(above.astype(np.float32) - below)
        self._border = torch.cat([self._border, self._cells(border)], 1)
        self._ends = torch.cat([self._ends, torch.from_numpy(np.stack(ends).astype(np.float32))], 1)

    def draw(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """See ``ObjectPoints``."""
        near = int(count * BORDER_SHARE)
        cells = torch.cat([self.pick(self._border, near), self.pick(self._held, count - near)], 1)
        return cells, torch.zeros_like(cells)

    def draw_touching(self, count: int, share: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """See ``ObjectPoints``: the sides on which the object ends there."""
        index = self.integers(self._border.shape[1], count)
        cells, ends = self._border.index_select(1, index), self._ends.index_select(1, index)
        return cells, torch.zeros_like(cells), ends * (self.rand(self.ndim, count) < share)

    def settled(self, before: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
        """See ``ObjectPoints``."""
        start, moved = (self._points_of(each) for each in (before, after))
        left = np.flatnonzero(~self.shape.contains(moved))
        nearest = NEAREST / float(self.domain.scale.min())
        moved[left] = pulled(self.shape.contains, start[left], moved[left], nearest)[0]
        cells = self._cells(moved)
        return torch.cat([cells, torch.zeros_like(cells)])

    def _points_of(self, state: torch.Tensor) -> np.ndarray:
        """``(N, n)`` float64 points in object space of cells and offsets."""
        cell, offset = state.chunk(2)
        return self.domain.to_object(self.to_local(cell + offset).T.double().numpy())
