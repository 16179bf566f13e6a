"""How far ellipsoids of one shape, around many centres, reach from the origin.

The farthest point of ``{z + M u: |u| <= 1}`` maximises a convex quadratic, ``|z|^2 + 2 c . u + u^T B u`` with ``c = M^T z`` and
``B = M^T M``. For every number l above the largest eigenvalue of B that is at most

    |z|^2 + l + sum_i g_i^2 / (l - d_i),

with d the eigenvalues and g the coordinates of c along the eigenvectors, and with the best l it is the maximum itself (the dual of a
trust-region problem; Conn, Gould, Toint, *Trust-Region Methods*, SIAM 2000, ch. 7). So no choice of l can be wrong, and a
decomposition that float64 has found is charged what it misses.
"""

import numpy as np

from warp_bounding.arithmetic import UNIT64, gamma

__all__ = ["farthest"]

HALVINGS = 60  # of the interval in which the best l lies
APART = 1e-12  # relative: l lies at least so far above the largest eigenvalue


def farthest(centres: np.ndarray, matrix: np.ndarray) -> float:
    """Upper bound of ``|z + M u|`` over all centres z and all u of length at most 1; exact but for some 1e-12, which are added.

    Args:
        centres: ``(P, r)`` float64.
        matrix: ``(r, n)`` float64, M.
    """
    length = np.linalg.norm(centres, axis=1)
    outward = 1 + gamma(4 * sum(matrix.shape) + 32, UNIT64)
    if not matrix.any():
        return float(length.max()) * outward
    across = float(np.linalg.norm(matrix)) * outward  # no less than the largest singular value
    along = centres @ matrix
    norm = np.linalg.norm(along, axis=1)
    # One point of each ellipsoid: those that cannot reach as far as the farthest of these are not looked at.
    u = along / np.where(norm > 0, norm, 1.0)[:, None]
    known = float(np.linalg.norm(centres + u @ matrix.T, axis=1).max()) / outward
    near = length * outward + across >= known
    return min(float(length.max() + across), float(np.sqrt(_dual(centres[near], matrix)))) * outward


def _dual(centres: np.ndarray, matrix: np.ndarray) -> float:
    """The square of ``farthest``, by the dual."""
    n, few = matrix.shape[1], gamma(4 * sum(matrix.shape) + 32, UNIT64)
    gram = matrix.T @ matrix
    d, vectors = np.linalg.eigh(gram)
    size = float((matrix * matrix).sum())
    # B differs from V D V^T by this at most, in any direction; and V from a rotation.
    missed = float(np.linalg.norm(gram - (vectors * d) @ vectors.T)) + 8 * n * few * size
    turned = float(np.linalg.norm(vectors.T @ vectors - np.eye(n))) + 2 * n * few
    length = np.linalg.norm(centres, axis=1)[:, None]
    reach = length * np.sqrt(size)  # at least |c|
    g = np.abs(centres @ matrix @ vectors) + (8 * n * few + turned) * reach
    most = np.linalg.norm(g, axis=1, keepdims=True)
    low = np.full_like(most, d[-1] * (1 + APART) + np.finfo(float).tiny)
    high = low + most
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        with np.errstate(over="ignore", divide="ignore"):
            rises = ((g / (middle - d)) ** 2).sum(axis=1, keepdims=True) <= 1
        low, high = np.where(rises, low, middle), np.where(rises, middle, high)
    rest = (g * g / (high - d)).sum(axis=1, keepdims=True)
    value = length * length + high * (1 + 3 * turned) + rest + missed * (1 + 3 * turned) + 4 * turned * reach
    return float(value.max()) * (1 + few)
