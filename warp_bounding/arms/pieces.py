"""Convex bodies that together hold a mesh that is far from convex: cut again and again, where that saves most volume.

A piece is what lies of the mesh on one side of a plane, a little more than half. The surface within it is held by the
hull of the corners there and of the points in which edges cross the plane, and so is what lies inside of the mesh
between them. Planes are at right angles to a piece's longest principal axes. What rounding moves a point by is added to
the bodies' radius.
"""

from typing import NamedTuple

import numpy as np

from warp_bounding.arms.arm import Body
from warp_bounding.rigid import matmul

CUTS = np.linspace(0.2, 0.8, 5)  # where planes are tried, shares of a piece's length
LEAST_GAIN = 0.05  # of the whole volume: what a cut must save
OVERLAP = 1e-7  # of the size: by how much the two sides of a cut overlap
ROUNDING = 1e-13  # of the size: what a crossing is off by at most, and more


class _Piece(NamedTuple):
    triangles: np.ndarray  # (F, 3, 3)
    volume: float  # of its hull


def hulls_of(vertices: np.ndarray, faces: np.ndarray, count: int, **named) -> list[Body]:
    """At most so many bodies that together hold a mesh of vertices ``(V, 3)`` and faces ``(F, 3)``."""
    whole = vertices[faces]
    size = float(np.abs(vertices).max())
    pieces = [_piece(whole)]
    total, cuts = pieces[0].volume, {0: _best_cut(pieces[0], size)} if count > 1 else {}
    while len(pieces) < count:
        gains = {k: cut[0] for k, cut in cuts.items() if cut is not None}
        if not gains or max(gains.values()) <= LEAST_GAIN * total:
            break
        k = max(gains, key=gains.get)
        pieces[k : k + 1], number = cuts.pop(k)[1], len(pieces)
        cuts = {i + (i > k): cut for i, cut in cuts.items()}
        for i in (k, k + 1):
            cuts[i] = _best_cut(pieces[i], size)
        assert len(pieces) == number + 1
    if len(pieces) == 1:
        return [Body.hull(vertices[np.unique(faces)], **named)]
    return [Body.hull(piece.triangles.reshape(-1, 3), **named).grown(ROUNDING * size) for piece in pieces]


def _piece(triangles: np.ndarray) -> _Piece:
    from scipy.spatial import ConvexHull, QhullError

    try:
        return _Piece(triangles, float(ConvexHull(triangles.reshape(-1, 3)).volume))
    except QhullError:  # flat
        return _Piece(triangles, 0.0)


def _best_cut(piece: _Piece, size: float) -> tuple[float, list[_Piece]] | None:
    """What the best cut of a piece saves, and its two sides."""
    points = piece.triangles.reshape(-1, 3)
    axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    best = None
    for axis in axes:
        heights = matmul(piece.triangles, axis[:, None])[..., 0]
        low, high = heights.min(), heights.max()
        for share in CUTS:
            level, sides = low + share * (high - low), []
            for sign in (1.0, -1.0):
                sides.append(_clipped(piece.triangles, sign * heights, sign * level + OVERLAP * size))
            if not all(map(len, sides)):
                continue
            pieces = [_piece(side) for side in sides]
            saved = piece.volume - sum(each.volume for each in pieces)
            if best is None or saved > best[0]:
                best = saved, pieces
    return best


def _clipped(triangles: np.ndarray, heights: np.ndarray, level: float) -> np.ndarray:
    """Triangles whose hull is that of the parts of others whose height is at most ``level``."""
    below = heights <= level
    found = [triangles[below.all(axis=1)]]
    cut, at, under = (each[below.any(axis=1) & ~below.all(axis=1)] for each in (triangles, heights, below))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        # a corner on its own side of the plane, with the crossings of its two edges
        alone = (under[:, i] != under[:, j]) & (under[:, i] != under[:, k])
        a, b, c = cut[alone, i], cut[alone, j], cut[alone, k]
        s, t = ((level - at[alone, i]) / (at[alone, m] - at[alone, i]) for m in (j, k))
        p, q = a + s[:, None] * (b - a), a + t[:, None] * (c - a)
        inside = under[alone, i]
        found.append(np.stack([a, p, q], axis=1)[inside])
        found += [np.stack([b, c, p], axis=1)[~inside], np.stack([c, p, q], axis=1)[~inside]]
    return np.concatenate(found)
