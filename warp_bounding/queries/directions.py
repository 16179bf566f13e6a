"""Random directions, as the paper draws them and as bounders may miss them, for the kinds of query that have one.

The paper's have spherical angles that are each uniform, so they are *not* uniform on the sphere. In n dimensions there
are n - 1 angles, all in [0, pi] but the last, which is in [0, 2 pi]; coordinate k is the cosine of angle k times the
sines of the angles before it. One dimension has the two directions +1 and -1.
"""

import numpy as np

__all__ = ["HARD_DIRECTION", "NARROW", "hard_directions", "hard_lengths", "nudged_directions", "sample_directions"]

NARROW = 1e-3  # the largest size that "barely" means: of the domain, or of an entry of a direction of length 1
PARALLEL, NEARLY = 0.1, 0.1  # shares of the entries of hard directions that are 0, and that are scaled by NARROW
SCALED = 0.2  # share of hard directions whose length is not 1

# A direction d of length 1 and what it is stretched by, where kernels draw hard positives (``hard``).
HARD_DIRECTION = f"""
double d[N], norm = 0.0;
for (int k = 0; k < N; ++k) {{
    d[k] = u() + u() - 1.0;
    const double chosen = u();
    if (chosen < {PARALLEL + NEARLY}) d[k] *= chosen < {PARALLEL} ? 0.0 : {NARROW};
    norm += d[k] * d[k];
}}
if (!(norm > 1e-12)) {{ for (int k = 0; k < N; ++k) d[k] = k == 0; norm = 1.0; }}
norm = sqrt(norm);
for (int k = 0; k < N; ++k) d[k] /= norm;
double stretch = 1.0;
if (u() < {SCALED}) stretch = u() < 0.5 ? power(12) : 1.0 / power(12);
"""


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


def hard_directions(shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """``(N, n)`` float64 directions of length 1; some entries are 0 or nearly so: parallel to faces."""
    d = rng.normal(size=shape)
    chosen = rng.random(shape)
    d = np.where(chosen < PARALLEL, 0.0, np.where(chosen < PARALLEL + NEARLY, d * NARROW, d))
    d[np.abs(d).max(axis=1) == 0, 0] = 1.0
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def hard_lengths(count: int, rng: np.random.Generator) -> np.ndarray:
    """``(count, 1)`` factors of unit directions, most of them 1: bounders take directions of any length."""
    return np.where(rng.random((count, 1)) < SCALED, np.exp2(rng.uniform(-12, 12, (count, 1))), 1.0)


def nudged_directions(d: np.ndarray, move: np.ndarray) -> np.ndarray:
    """Directions of length 1 near others ``(N, n)``, after a step ``(N, n)`` on the sphere."""
    d = d / np.linalg.norm(d, axis=1, keepdims=True) + move
    return d / np.linalg.norm(d, axis=1, keepdims=True)
