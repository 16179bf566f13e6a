"""Where an object may stand."""

import numpy as np


def rotation(s: int, rng) -> np.ndarray:
    q, r = np.linalg.qr(rng.normal(size=(s, s)))
    q *= np.sign(np.diag(r))
    if np.linalg.det(q) < 0:
        q[:, 0] *= -1
    return q


def homogeneous(q, t) -> np.ndarray:
    matrix = np.eye(len(t) + 1)
    matrix[:-1, :-1], matrix[:-1, -1] = q, t
    return matrix
