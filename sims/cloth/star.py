"""A solid star: five points around an axis, a ridge along each; closed, concave, of any number of triangles.

Twelve corners and twenty triangles give its shape; each triangle is then cut into four, again and again, so that a
query has a mesh of the usual size to search. Boxes and k-DOPs are loose around it, and its points are what a network
that is not proven cuts off.
"""

import numpy as np

import warp_bounding as wb

__all__ = ["star"]

POINTS = 5
TIP, NOTCH, HALF = 0.6, 0.28, 0.24  # distance of tips and notches from the axis; of the apexes from the middle plane
CUTS = 4  # 20 triangles become 5,120


def star(cuts: int = CUTS) -> wb.shapes.Mesh:
    """The star, its axis along y, its middle at the origin, its tips at distance 0.6.

    Args:
        cuts: How often each triangle is cut into four.
    """
    angle = np.pi / POINTS * np.arange(2 * POINTS) + np.pi / 2
    distance = np.where(np.arange(2 * POINTS) % 2 == 0, TIP, NOTCH)
    rim = np.stack([distance * np.cos(angle), np.zeros(2 * POINTS), -distance * np.sin(angle)], axis=1)
    vertices = np.concatenate([rim, [[0.0, HALF, 0.0], [0.0, -HALF, 0.0]]])
    top, bottom = 2 * POINTS, 2 * POINTS + 1
    faces = []
    for i in range(2 * POINTS):
        following = (i + 1) % (2 * POINTS)
        faces += [(i, following, top), (following, i, bottom)]
    faces = np.array(faces)
    for _ in range(cuts):
        vertices, faces = _cut(vertices, faces)
    return wb.shapes.Mesh(vertices.astype(np.float32), faces.astype(np.int32), name="star")


def _cut(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each triangle in four, at the middles of its edges; neighbours share them."""
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]], axis=2)
    unique, inverse = np.unique(edges.reshape(-1, 2), axis=0, return_inverse=True)
    middles = len(vertices) + inverse.reshape(-1, 3)
    a, b, c = faces.T
    ab, bc, ca = middles.T
    smaller = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([vertices, vertices[unique].mean(axis=1)]), np.concatenate([np.stack(t, 1) for t in smaller])
