"""``obb``: the oriented bounding box (the paper's OBox), along the principal axes of the object."""

import numpy as np

from warp_bounding.bounders.slabs.base import SlabBounder
from warp_bounding.coordinates.domain import Domain
from warp_bounding.indicators.grid import IndicatorGrid

__all__ = ["Obb"]


class Obb(SlabBounder):
    """Oriented box whose axes are the eigenvectors of the occupied cells' covariance, as in the paper's code."""

    method = "obb"

    @classmethod
    def fit(cls, grid: IndicatorGrid, domain: Domain, *, device: str | None = None) -> "Obb":
        """The smallest box with these axes around a grid's occupied cells."""
        centers = grid.position(grid.occupied)
        covariance = np.atleast_2d(np.cov(centers.T, ddof=0))
        return cls.of_directions(grid, domain, np.linalg.eigh(covariance)[1].T, device)
