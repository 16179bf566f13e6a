"""Convex bodies that together hold a mesh that is far from convex: cut again and again, where that saves most volume.

A piece is what lies of the mesh on one side of some planes, a little more than half. It is held by the hull of the
corners there, of the points in which edges cross a plane, and, inside of the mesh, of those in which three planes meet.
Planes are at right angles to a piece's principal axes. What rounding moves a point by is added to the bodies' radius.
"""

from contextlib import suppress
from typing import NamedTuple

import numpy as np

from warp_bounding.arms.arm import Body
from warp_bounding.rigid import matmul, principal_axes

CUTS = np.linspace(0.2, 0.8, 5)  # where planes are tried, shares of a piece's length
LEAST_GAIN = 0.05  # of the whole volume: what a cut must save
PARALLEL = 1e-7  # of three planes: with a smaller determinant they meet nowhere near, or the overlap holds that
OVERLAP = 1e-7  # of the size: by how much the two sides of a cut overlap, more than where three planes meet is off
ROUNDING = 1e-13  # of the size: what a crossing is off by at most, and more


class _Piece(NamedTuple):
    triangles: np.ndarray  # (F, 3, 3), its surface but for the cuts, and points where three of these meet
    walls: np.ndarray  # (W, 4), planes n . x + d <= 0 that hold all of the mesh
    cuts: np.ndarray  # (C, 4), those of the cuts
    volume: float = 0.0  # of its hull


def hulls_of(vertices: np.ndarray, faces: np.ndarray, count: int, **named) -> list[Body]:
    """At most so many bodies that together hold a mesh of vertices ``(V, 3)`` and faces ``(F, 3)``."""
    size, box = float(np.abs(vertices).max()), np.concatenate([-vertices, vertices], axis=1).max(axis=0)
    walls = np.column_stack([np.concatenate([-np.eye(3), np.eye(3)]), -box])
    pieces = [_measured(_Piece(vertices[faces], walls, np.empty((0, 4))))]
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


def _measured(piece: _Piece) -> _Piece:
    from scipy.spatial import ConvexHull, QhullError

    with suppress(QhullError):  # flat
        return piece._replace(volume=float(ConvexHull(piece.triangles.reshape(-1, 3)).volume))
    return piece


def _best_cut(piece: _Piece, size: float) -> tuple[float, list[_Piece]] | None:
    """What the best cut of a piece saves, and its two sides."""
    points = piece.triangles.reshape(-1, 3)
    best = None
    for axis in principal_axes(points):
        heights = matmul(points, axis[:, None])
        low, high = heights.min(), heights.max()
        for share in CUTS:
            sides = _sides(piece, axis, low + share * (high - low), size)
            if not all(len(side.triangles) for side in sides):
                continue
            sides = list(map(_measured, sides))
            saved = piece.volume - sum(each.volume for each in sides)
            if best is None or saved > best[0]:
                best = saved, sides
    return best


def _sides(piece: _Piece, axis: np.ndarray, level: float, size: float) -> list[_Piece]:
    """The two sides of a plane at right angles to an axis ``(3,)``."""
    heights, found, over = matmul(piece.triangles, axis[:, None])[..., 0], [], OVERLAP * size
    for sign in (1.0, -1.0):
        cut = np.append(sign * axis, -sign * level - over)
        triangles = _clipped(piece.triangles, sign * heights, sign * level + over)
        planes = np.concatenate([piece.walls, piece.cuts])
        one, other = np.triu_indices(len(piece.cuts), 1)
        a, b = piece.cuts[one], piece.cuts[other]
        across = np.cross(a[:, :3], b[:, :3])
        volume = matmul(across, cut[:3, None])
        real = np.abs(volume[:, 0]) > PARALLEL
        meet = a[:, 3:] * np.cross(b[:, :3], cut[:3]) + b[:, 3:] * np.cross(cut[:3], a[:, :3]) + cut[3] * across
        meet = -meet[real] / volume[real]
        meet = meet[(matmul(meet, planes[:, :3].T) + planes[:, 3] <= over).all(axis=1)]
        triangles = np.concatenate([triangles, np.repeat(meet[:, None], 3, axis=1)])
        found.append(_Piece(triangles, piece.walls, np.concatenate([piece.cuts, cut[None]])))
    return found


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
