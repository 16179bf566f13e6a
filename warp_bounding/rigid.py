"""Rigid motions and products of small matrices, the same to the last bit on every CPU.

A shape's digest is made of such numbers, so that a proof is of one shape only where no digit depends on the machine.
BLAS, LAPACK and the sines of C libraries choose their instructions by the CPU, and differ in the last place. Here every
number is a sum of products, one after another, a root or a quotient, each rounded as IEEE 754 says.
"""

from fractions import Fraction

import numpy as np

TWO_PI = Fraction("6.283185307179586476925286766559005768394338798750211641949889")
_BITS = 160  # of fractions, in ``sine_cosine``
_SWEEPS = 8  # of Jacobi's rotations, each of which squares what is off the diagonal: three or four are enough
_TERMS = 40  # of a power series up to pi / 4: the next one is below 2^-160


def matmul(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """``a @ b`` of matrices ``(..., I, K)`` and ``(..., K, J)``; made for small K."""
    found = a[..., :, 0, None] * b[..., None, 0, :]
    for k in range(1, a.shape[-1]):
        found = found + a[..., :, k, None] * b[..., None, k, :]
    return found


def moved(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Points ``(P, 3)`` where a matrix ``(4, 4)``, whose last row is 0 0 0 1, takes them."""
    return matmul(points, pose[:3, :3].T) + pose[:3, 3]


def lengths(x: np.ndarray) -> np.ndarray:
    """Euclidean lengths ``(...)`` of vectors ``(..., K)``; made for small K."""
    squares = np.square(np.asarray(x, dtype=np.float64))
    return np.sqrt(sum(squares[..., k] for k in range(squares.shape[-1])))


def sine_cosine(angle: float) -> tuple[float, float]:
    """An angle's sine and cosine, within 2^-150 and then rounded; radians.

    The angle, less quarter turns, goes through two power series, in integers of ``2^-160``.
    """
    quarters = round(4 * Fraction(angle) / TWO_PI)
    x = int((Fraction(angle) - quarters * TWO_PI / 4) * 2**_BITS)
    sums, term = [0, 0], 1 << _BITS  # cosine, sine
    for k in range(_TERMS):
        sums[k % 2] += -term if k & 2 else term
        term = (term * x >> _BITS) // (k + 1)
    cosine, sine = (float(Fraction(total, 2**_BITS)) for total in sums)
    for _ in range(quarters % 4):
        sine, cosine = cosine, -sine
    return sine, cosine


def ring(count: int) -> np.ndarray:
    """``(count, 2)``: points on the unit circle at equal angles, the first at (1, 0)."""
    return np.array([sine_cosine(2 * np.pi * k / count)[::-1] for k in range(count)])


def about(axis: int, angle: float) -> np.ndarray:
    """``(3, 3)``: the turn by an angle, radians, about the x, y or z axis (0, 1, 2)."""
    (s, c), i, j = sine_cosine(angle), (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[i, i], matrix[i, j], matrix[j, i], matrix[j, j] = c, -s, s, c
    return matrix


def nearest_rotation(matrix: np.ndarray, tolerance: float) -> np.ndarray | None:
    """The rotation ``(3, 3)`` that is nearest to a matrix; ``None`` if an entry of it is farther than ``tolerance``.

    Newton's iteration of the polar decomposition. Three steps square an error of 1e-6 often enough for float64.
    """
    found = matrix
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(3):
            found = matmul(found, 3 * np.eye(3) - matmul(found.T, found)) / 2
    near = (np.abs(found - matrix) <= tolerance).all() and matmul(
        np.cross(found[0], found[1])[None], found[2][:, None]
    ) > 0
    return found if near else None


def principal_axes(points: np.ndarray) -> np.ndarray:
    """``(3, 3)``: axes at right angles, one a row, along which points ``(P, 3)`` spread most, less and least.

    Jacobi's rotations make the matrix of second moments diagonal.
    """
    x = points - points.mean(axis=0)
    moments, axes = (x[:, :, None] * x[:, None, :]).sum(axis=0), np.eye(3)
    for i, j in _SWEEPS * ((0, 1), (0, 2), (1, 2)):
        if moments[i, j]:
            with np.errstate(over="ignore"):
                ratio = (moments[j, j] - moments[i, i]) / (2 * moments[i, j])
                tangent = np.copysign(1 / (abs(ratio) + np.sqrt(1 + ratio * ratio)), ratio)
            cosine, turn = 1 / np.sqrt(1 + tangent * tangent), np.eye(3)
            turn[i, i] = turn[j, j] = cosine
            turn[i, j], turn[j, i] = tangent * cosine, -tangent * cosine
            moments, axes = matmul(turn.T, matmul(moments, turn)), matmul(turn.T, axes)
    return axes[np.argsort(-np.diag(moments), kind="stable")]
