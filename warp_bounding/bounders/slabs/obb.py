"""``obb``: the oriented bounding box (the paper's OBox), along the principal axes of the object."""

import numpy as np

from warp_bounding.bounders.slabs.base import SlabBounder

__all__ = ["Obb"]


class Obb(SlabBounder):
    """Oriented box whose axes are the eigenvectors of the occupied cells' covariance, as in the paper's code."""

    method = "obb"
    of_samples = True

    @classmethod
    def sampled_directions(cls, samples: np.ndarray) -> np.ndarray:
        return np.linalg.eigh(np.atleast_2d(np.cov(samples.T, ddof=0)))[1].T
