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
        return cls.of_directions(grid, domain, cls.sampled_directions(grid.position(grid.occupied)), device)

    @classmethod
    def sampled_directions(cls, samples: np.ndarray) -> np.ndarray:
        """See ``SlabBounder``: principal axes."""
        return np.linalg.eigh(np.atleast_2d(np.cov(samples.T, ddof=0)))[1].T
