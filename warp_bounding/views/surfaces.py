"""Surfaces in three dimensions where an answer changes, as triangles.

A level set is found from answers alone, those that are deployed: marching cubes over answers at the nodes of a grid say between which two
nodes the answer changes, and halving that way again and again says where. What is thinner than the grid's cells can be missed.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from warp_bounding.views.needed import needed

__all__ = ["Surface", "cell_surface", "level_surface"]

HALVINGS = 12  # of a grid's edge: to 1/4096 of a cell
CHUNK = 1 << 20  # points that are asked at a time


class Surface(NamedTuple):
    """Triangles, counter-clockwise as seen from outside."""

    vertices: np.ndarray  # (V, 3) float64
    faces: np.ndarray  # (F, 3) int64

    @classmethod
    def empty(cls) -> "Surface":
        """No triangle."""
        return cls(np.empty((0, 3)), np.empty((0, 3), dtype=np.int64))


def nodes(lower: np.ndarray, upper: np.ndarray, resolution: int) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of nodes along each axis of a box, and the step between them: about ``resolution`` along the longest side."""
    size = np.maximum(upper - lower, np.finfo(np.float64).tiny)
    count = np.maximum(np.ceil(resolution * size / size.max()).astype(int), 2) + 1
    return count, size / (count - 1)


def level_surface(
    inside: Callable[[np.ndarray], np.ndarray], lower: np.ndarray, upper: np.ndarray, resolution: int
) -> Surface:
    """The surface around the points of a box for which a test is true, closed where the box ends.

    Args:
        inside: The test: called with ``(N, 3)`` float64 it returns ``(N,)`` bool.
        lower: ``(3,)`` float64.
        upper: ``(3,)`` float64.
        resolution: Cells along the longest side.
    """
    count, step = nodes(lower, upper, resolution)
    ticks = [low + np.arange(n) * d for low, n, d in zip(lower, count, step, strict=True)]
    mask = np.zeros(count + 2, dtype=bool)  # a ring of false nodes around the box
    mask[1:-1, 1:-1, 1:-1] = _asked(inside, ticks).reshape(count)
    if not mask.any():
        return Surface.empty()
    pyvista = needed("pyvista")
    grid = pyvista.ImageData(dimensions=mask.shape)
    grid["inside"] = mask.ravel(order="F").astype(np.uint8)
    found = grid.contour([0.5], scalars="inside", compute_normals=False)
    halves = np.rint(2 * np.asarray(found.points)).astype(int)  # each vertex is in the middle of an edge between nodes
    first, second = halves // 2, -(-halves // 2)
    true_first = mask[tuple(first.T)][:, None]
    yes, no = (lower + (np.where(true_first, *pair) - 1) * step for pair in ((first, second), (second, first)))
    within = ((no >= lower - step / 2) & (no <= upper + step / 2)).all(axis=1)
    no = np.clip(no, lower, upper)  # the ring lies outside the box, where nothing is asked
    for _ in range(HALVINGS):
        middle = (yes + no) / 2
        true = inside(middle)
        yes, no = np.where(true[:, None], middle, yes), np.where(true[:, None], no, middle)
    vertices = np.where(within[:, None], (yes + no) / 2, no)
    return _outwards(Surface(vertices, found.regular_faces.astype(np.int64)))


def _asked(inside: Callable[[np.ndarray], np.ndarray], ticks: list[np.ndarray]) -> np.ndarray:
    """The answers at all nodes, some planes of nodes at a time."""
    layers = max(1, CHUNK // (len(ticks[1]) * len(ticks[2])))
    found = []
    for start in range(0, len(ticks[0]), layers):
        points = np.stack(np.meshgrid(ticks[0][start : start + layers], *ticks[1:], indexing="ij"), axis=-1)
        found.append(inside(points.reshape(-1, 3)))
    return np.concatenate(found)


def _outwards(surface: Surface) -> Surface:
    """The surface, turned inside out if it encloses a negative volume."""
    a, b, c = (surface.vertices[surface.faces[:, k]] - surface.vertices.mean(axis=0) for k in range(3))
    if np.einsum("ij,ij->", a, np.cross(b, c)) < 0:
        return Surface(surface.vertices, surface.faces[:, ::-1].copy())
    return surface


def cell_surface(occupied: np.ndarray, edges: list[np.ndarray]) -> Surface:
    """The surface of closed cells.

    Args:
        occupied: ``(X, Y, Z)`` bool.
        edges: Where the cells begin and end along each axis: ``(X + 1,)``, ``(Y + 1,)``, ``(Z + 1,)`` float64.
    """
    padded, size = np.pad(occupied, 1).astype(np.int8), np.array(occupied.shape) + 1
    squares = []
    for axis in range(3):
        others = [other for other in range(3) if other != axis]
        change = np.diff(padded, axis=axis)
        trimmed = np.take(np.take(change, range(1, size[others[0]]), others[0]), range(1, size[others[1]]), others[1])
        at = np.argwhere(trimmed)
        corners = np.repeat(at[:, None], 4, axis=1)
        corners[:, [1, 2], others[0]] += 1
        corners[:, [2, 3], others[1]] += 1
        # The corners run from one other axis to the next, counter-clockwise about +axis for axes 0 and 2 and clockwise for axis 1.
        along = (trimmed[tuple(at.T)] < 0) ^ (axis == 1)
        squares.append(np.where(along[:, None, None], corners, corners[:, ::-1]))
    squares = np.concatenate(squares).reshape(-1, 3)
    numbers, faces = np.unique(np.ravel_multi_index(squares.T, size), return_inverse=True)
    places = np.unravel_index(numbers, size)
    vertices = np.stack([edge[place] for edge, place in zip(edges, places, strict=True)], axis=1)
    faces = faces.reshape(-1, 4)
    return Surface(vertices, np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]]))
