"""Inverses and polytope vertices in float64, each with a bound of its error: regions are tested against edges and vertices.

An inverse is checked afterwards (Rump, *Verification methods*, Acta Numerica 2010, sect. 10): from ``A B = I - R``
follows ``|A^-1 - B| <= |B| |R| / (1 - |R|)``. Vertices are found by solving for every choice of n slabs; a choice
whose inverse cannot be checked must be singular in rational arithmetic, so that no vertex is ever missed.
"""

from fractions import Fraction
from itertools import combinations, product
from math import comb

import numpy as np

from warp_bounding.arithmetic import UNIT64, gamma
from warp_bounding.errors import BounderError

__all__ = ["MOST_VERTEX_DIMENSIONS", "checked_inverse", "polytope_vertices"]

MOST_VERTEX_DIMENSIONS = 6  # choices of slabs grow with the factorial of the dimension
MERGED = 2.0**-20  # units of the slabs: vertices in one cube of this size become one point
MOST_CHOICES = 1 << 20  # choices of n slabs that may meet in a vertex: a file may not ask for more work
LARGEST_REST = 0.01  # of |R|: a matrix with a larger one is too close to singular


def checked_inverse(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """The inverse of an ``(n, n)`` float64 matrix and a bound ``(n, n)`` of its error; ``None`` if there is none."""
    n = len(matrix)
    scale = np.abs(matrix).max(axis=1)
    if not (np.isfinite(scale).all() and (scale > 0).all()):
        return None
    scale = 2.0 ** np.round(np.log2(scale))  # exact scaling
    matrix = matrix / scale[:, None]
    try:
        inverse = np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        return None
    size = np.abs(matrix) @ np.abs(inverse) + np.eye(n)
    if not np.isfinite(size).all():
        return None
    rest = np.abs(np.eye(n) - matrix @ inverse) + gamma(n + 2, UNIT64) * size
    ratio = rest.sum(axis=1).max() * (1 + 1e-12)
    if not ratio < LARGEST_REST:
        return None
    error = np.repeat(np.abs(inverse).sum(axis=1, keepdims=True), n, axis=1) * (ratio / (1 - ratio) * (1 + 1e-12))
    return inverse / scale, error / scale


def polytope_vertices(directions: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points whose hull holds the polytope ``low <= directions y <= high``, up to a stated error.

    Directions ``(k, n)``, low and high ``(k,)`` are float64 and taken as exact.

    Returns:
        Points ``(P, n)`` float32 and errors ``(P, n)`` float64: every vertex of the polytope is within the error of one
        of the points, per axis.

    Raises:
        BounderError: If the polytope is not bounded, or a vertex is beyond what float64 can tell.
    """
    k, n = directions.shape
    if k < n:
        raise BounderError("the slabs do not bound a polytope")
    if comb(k, n) > MOST_CHOICES:
        raise BounderError(f"expected at most {MOST_CHOICES} choices of {n} slabs, got {comb(k, n)} of {k} slabs")
    found, errors = [], []
    sides = np.array(list(product((0, 1), repeat=n)))
    for chosen in combinations(range(k), n):
        part = directions[list(chosen)]
        inverse = checked_inverse(part)
        if inverse is None:
            if _singular(part):
                continue
            raise BounderError("slabs are so close to parallel that float64 cannot find where they meet")
        right = np.where(sides, high[list(chosen)], low[list(chosen)])
        y = right @ inverse[0].T
        error = np.abs(right) @ (inverse[1] + gamma(n + 2, UNIT64) * np.abs(inverse[0])).T
        at = y @ directions.T
        room = 2 * (error + gamma(n + 2, UNIT64) * np.abs(y)) @ np.abs(directions).T
        keep = ((at >= low - room) & (at <= high + room)).all(axis=1)
        found.append(y[keep])
        errors.append(error[keep])
    vertices, error = np.concatenate([np.zeros((0, n)), *found]), np.concatenate([np.zeros((0, n)), *errors])
    if len(vertices) <= n:
        raise BounderError("the slabs do not bound a polytope")
    keys, first, group = np.unique(np.round(vertices / MERGED), axis=0, return_index=True, return_inverse=True)
    points = vertices[first].astype(np.float32)
    away = np.abs(vertices - points[group.reshape(-1)].astype(np.float64)) * (1 + 1e-12) + error
    largest = np.zeros((len(keys), n))
    np.maximum.at(largest, group.reshape(-1), away)
    return points, largest


def _singular(matrix: np.ndarray) -> bool:
    """Whether a matrix of floats is singular, in rational arithmetic."""
    rows = [[Fraction(float(x)) for x in row] for row in matrix]
    for column in range(len(rows)):
        pivot = next((r for r in range(column, len(rows)) if rows[r][column] != 0), None)
        if pivot is None:
            return True
        rows[column], rows[pivot] = rows[pivot], rows[column]
        for r in range(column + 1, len(rows)):
            factor = rows[r][column] / rows[column][column]
            rows[r] = [a - factor * b for a, b in zip(rows[r], rows[column], strict=True)]
    return False
