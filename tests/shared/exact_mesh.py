"""The truth about points and small meshes in rational arithmetic: slow, and plainly right."""

from fractions import Fraction

import numpy as np


def _fractions(x) -> list[Fraction]:
    return [Fraction(float(v)) for v in x]


def _minus(a, b):
    return [p - q for p, q in zip(a, b, strict=True)]


def _dot(a, b):
    return sum(p * q for p, q in zip(a, b, strict=True))


def _cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def _squared_to_segment(p, a, b) -> Fraction:
    e, w = _minus(b, a), _minus(p, a)
    length = _dot(e, e)
    t = min(max(_dot(w, e) / length, Fraction(0)), Fraction(1)) if length else Fraction(0)
    d = [x - t * y for x, y in zip(w, e, strict=True)]
    return _dot(d, d)


def _squared_to_triangle(p, a, b, c) -> Fraction:
    n = _cross(_minus(b, a), _minus(c, a))
    if any(n):
        sides = [_dot(_cross(_minus(v, u), _minus(p, u)), n) for u, v in ((a, b), (b, c), (c, a))]
        if min(sides) >= 0:
            return _dot(_minus(p, a), n) ** 2 / _dot(n, n)
    return min(_squared_to_segment(p, *ends) for ends in ((a, b), (b, c), (c, a)))


def squared_distance(vertices: np.ndarray, faces: np.ndarray, x: np.ndarray) -> Fraction:
    """From a point to the nearest of the faces."""
    p, corners = _fractions(x), [_fractions(v) for v in vertices]
    return min(_squared_to_triangle(p, *(corners[i] for i in face)) for face in faces)


def in_tetrahedron(corners: np.ndarray, x: np.ndarray) -> bool:
    """Whether a point lies in the closed tetrahedron of four corners, which is not flat."""
    p, corners = _fractions(x), [_fractions(v) for v in corners]
    for i in range(4):
        top, (a, b, c) = corners[i], [v for k, v in enumerate(corners) if k != i]
        n = _cross(_minus(b, a), _minus(c, a))
        if _dot(n, _minus(top, a)) * _dot(n, _minus(p, a)) < 0:
            return False
    return True
