"""Random directions as the paper draws them: spherical angles, each uniform, so *not* uniform on the sphere.

In n dimensions there are n - 1 angles, all in [0, pi] but the last, which is in [0, 2 pi]; coordinate k is the cosine of
angle k times the sines of the angles before it. One dimension has the two directions +1 and -1.
"""

import numpy as np

__all__ = ["sample_directions"]


def sample_directions(ndim: int, count: int, rng: np.random.Generator) -> np.ndarray:
    """Directions of length 1 (up to float32 rounding), by uniform spherical angles.

    Args:
        ndim: Dimension n >= 1.
        count: Number of directions N.
        rng: Source of randomness.

    Returns:
        ``(N, n)`` float32.
    """
    if ndim == 1:
        return np.where(rng.random((count, 1), dtype=np.float32) < 0.5, np.float32(-1), np.float32(1))
    angles = rng.random((count, ndim - 1), dtype=np.float32) * np.float32(np.pi)
    angles[:, -1] *= 2
    cosines, sines = np.cos(angles), np.sin(angles)
    direction = np.empty((count, ndim), dtype=np.float32)
    direction[:, :-1], direction[:, -1] = cosines, 1
    for k in range(ndim - 1):
        direction[:, k + 1 :] *= sines[:, k, None]
    return direction
