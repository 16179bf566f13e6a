"""Samples of boxes for a network that is monotone in them: the positives that count are the points of the object.

A point stands for the box ``low = high = p``, the least of all boxes that hold it (``bounders.mlp``).
"""

import numpy as np
import torch

from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.shape import Shape
from warp_bounding.training.samples.base import LabelledRegions, first_ones
from warp_bounding.training.samples.box import BoxSamples
from warp_bounding.training.samples.shape_point import STEP, ShapePointSamples

__all__ = ["LeastBoxes", "LeastBoxesOfShape", "least_boxes"]


class LeastBoxes(BoxSamples):
    """Boxes of a grid; a state is a cell and an offset (n rows each).

    Attributes:
        point_detail: ``(n, 1)``, as ``detail``, of the object's points.
    """

    def __init__(self, grid: IndicatorGrid, domain: RegionDomain, generator: torch.Generator):
        super().__init__(grid, domain, generator)
        self.vertices, self.point_detail = self.cells.boundary_vertices().repeat(2, 1), self.cells.detail

    def positives(self, count: int) -> torch.Tensor:
        return torch.cat(self.cells.draw(count))

    def coordinates(self, state: torch.Tensor) -> torch.Tensor:
        return self.point(state).repeat(2, 1)

    def move(self, state: torch.Tensor, slope: torch.Tensor, step: float | torch.Tensor) -> torch.Tensor:
        low, high = slope.chunk(2)
        return self.cells.walk(state, low + high, step)

    def locate(self, v: np.ndarray) -> torch.Tensor:
        """States of points ``(N, n)`` of the object, local space."""
        return torch.cat(self.cells.locate(v)[:2])

    def spread(self, state: torch.Tensor, most: int) -> torch.Tensor:
        """Of states, lowest first, the first one in each cell, and no more than ``most``."""
        return first_ones(state, state[: self.grid.ndim], most)


class LeastBoxesOfShape(LabelledRegions):
    """Boxes of a shape without cells; a state is the point, in local coordinates (n rows)."""

    query = BoxSamples.query

    def __init__(self, shape: Shape, domain: RegionDomain, generator: torch.Generator):
        super().__init__(shape, domain, generator)
        self.points = ShapePointSamples(shape, domain.base, generator)
        self.point_detail, self.vertices = self.points.detail, self.points.vertices.repeat(2, 1)
        self.detail = self.point_detail.repeat(2, 1)

    def usual_negatives(self, count: int) -> torch.Tensor:
        self.points.grow()
        return super().usual_negatives(count)

    def positives(self, count: int) -> torch.Tensor:
        return self.points.positives(count)

    def coordinates(self, state: torch.Tensor) -> torch.Tensor:
        return state.repeat(2, 1)

    def move(self, state: torch.Tensor, slope: torch.Tensor, step: float | torch.Tensor) -> torch.Tensor:
        low, high = slope.chunk(2)
        return self.points.move(state, low + high, step)

    def settled(self, before: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
        return self.points.settled(before, after)

    def locate(self, v: np.ndarray) -> torch.Tensor:
        """See ``LeastBoxes``."""
        return self.points.locate(v)

    def spread(self, state: torch.Tensor, most: int) -> torch.Tensor:
        """See ``LeastBoxes``; cells are those of ``ShapePointSamples.move``."""
        return first_ones(state, (state / STEP).floor(), most)


def least_boxes(shape: Shape, domain: RegionDomain, seed: int) -> LeastBoxes | LeastBoxesOfShape:
    """The samples of a grid or of another shape; the seed is that of the trainer that takes them, too."""
    kind = LeastBoxes if isinstance(shape, IndicatorGrid) else LeastBoxesOfShape
    return kind(shape, domain, torch.Generator().manual_seed(seed))
