"""The paper's own fits of boxes and k-DOPs: volumes around samples, with nothing proven of them, to compare its tables with."""

from collections.abc import Callable

import numpy as np

from warp_bounding.bounders import METHODS

__all__ = ["sampled_fit"]


def sampled_fit(method: str, q: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """A volume around samples.

    Args:
        method: ``"aabb"``, ``"obb"`` or ``"kdop"``; the latter with the m axes and the m normals "all ones but one", whatever m is.
        q: ``(N, m)`` positive queries in their own units (points too).

    Returns:
        A function from ``(M, m)`` queries to ``(M,)`` bool: inside the volume.
    """
    q = np.asarray(q, dtype=np.float64)
    axes = np.eye(q.shape[1])
    normals = np.concatenate([axes, 1 - axes]) if method == "kdop" else METHODS[method].sampled_directions(q)
    projected = q @ normals.T
    low, high = projected.min(axis=0), projected.max(axis=0)

    def inside(x: np.ndarray) -> np.ndarray:
        y = np.asarray(x, dtype=np.float64) @ normals.T
        return ((y >= low) & (y <= high)).all(axis=1)

    return inside
