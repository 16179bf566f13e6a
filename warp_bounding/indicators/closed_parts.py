"""Which faces of a triangle mesh enclose an inside: those that are left when all with a free edge are taken away.

Vertices at equal places are one vertex, faces with the same three vertices one face. A face with an edge that no other
face has is taken away, and again, until there is none: the rest is closed, whatever way its faces are turned, however
many of them meet in an edge (a wall between two chambers), and however shells lie in or through one another. Its
inside is what a flood from outside does not reach (``voxelization.fill_inside``), so a choice that is made here never
takes anything from the object: every face stays on the surface, and a closed part only adds the inside to it.

A face without area stays as long as its edges do: it may be what fills a crack where a vertex lies on another face's
edge. One that hangs loose is taken away like any other, and does not make a mesh an open one.

What this does not do: cracks between vertices that are almost equal are not mended; a surface with one is open.
"""

from dataclasses import dataclass

import numpy as np

from warp_bounding.indicators.distinct_rows import distinct_rows

__all__ = ["Surface", "surface_of", "turns_of"]


@dataclass(frozen=True)
class Surface:
    """A mesh's faces, told apart by what they enclose.

    Attributes:
        closed: ``(F,)`` bool, the faces of closed parts.
        loose: ``(F,)`` bool, faces of no closed part that have an area: only they themselves are bounded there.
    """

    closed: np.ndarray
    loose: np.ndarray

    @property
    def watertight(self) -> bool:
        """Whether every face with an area belongs to a closed part."""
        return bool(self.closed.any() and not self.loose.any())

    @property
    def note(self) -> str:
        """What a user should know: where there is no inside that could be bounded; empty for a closed surface."""
        if self.watertight:
            return ""
        if not self.closed.any():
            return (
                "surface only: the mesh is open, so just the surface and the margin around it are bounded, and what lies "
                "deeper inside counts as outside"
            )
        return (
            f"surface only for {int(self.loose.sum())} of {len(self.loose)} faces: there the mesh is open, so just the surface "
            "and the margin around it are bounded, and what lies deeper inside counts as outside; closed parts are bounded whole"
        )


def surface_of(vertices: np.ndarray, faces: np.ndarray) -> Surface:
    """Tell the closed parts of a mesh from its open ones.

    Args:
        vertices: ``(V, 3)``, or ``(V, 3 K)`` for K keyframes, side by side: vertices are one where all numbers are
            equal.
        faces: ``(F, 3)``, indices of vertices.
    """
    _, _, merged = distinct_rows(vertices)
    corners = np.sort(merged[faces], axis=1)
    kept, _, face_of = distinct_rows(corners)
    whole = (np.diff(kept, axis=1) > 0).all(axis=1)  # the others have collapsed to an edge or a point: no face is there
    closed = np.zeros(len(kept), dtype=bool)
    closed[whole] = _without_free_edges(kept[whole])
    closed = closed[face_of]
    return Surface(closed=closed, loose=~closed & _has_area(vertices, faces))


def turns_of(vertices: np.ndarray, faces: np.ndarray) -> tuple[int, bool]:
    """How the faces of closed parts are turned.

    Args:
        vertices: ``(V, 3)``; those at equal places are one.
        faces: ``(F, 3)``, all of closed parts.

    Returns:
        Edges that faces do not run through as often one way as the other: 0 where faces are turned alike. And whether the faces are one
        piece that meets two by two at its edges, so that there is one inside, but where it passes through itself.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    _, _, merged = distinct_rows(vertices)
    corners = merged[faces].astype(np.int64)
    ends = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    _, edge, count = np.unique(
        ends.min(axis=1) * len(vertices) + ends.max(axis=1), return_inverse=True, return_counts=True
    )
    ways = np.bincount(edge, weights=np.sign(ends[:, 1] - ends[:, 0]), minlength=len(count))
    face, by_edge = np.tile(np.arange(len(faces)), 3), np.argsort(edge, kind="stable")
    pairs = face[by_edge[:-1]], face[by_edge[1:]]
    joined = edge[by_edge[:-1]] == edge[by_edge[1:]]
    graph = coo_array(
        (np.ones(int(joined.sum()), np.int8), (pairs[0][joined], pairs[1][joined])), shape=(len(faces),) * 2
    )
    return int(np.count_nonzero(ways)), bool((count == 2).all() and connected_components(graph, directed=False)[0] == 1)


def _without_free_edges(faces: np.ndarray) -> np.ndarray:
    """``(F,)`` bool: the faces that stay when those with an edge of their own are taken away, again and again.

    Args:
        faces: ``(F, 3)``, ascending in each row, no two rows the same.
    """
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [0, 2]]])
    unique, _, edge = distinct_rows(pairs)
    edges = edge.reshape(3, -1).T  # of each face
    stays = np.ones(len(faces), dtype=bool)
    count = np.bincount(edges.ravel(), minlength=len(unique))
    owners = np.zeros(len(unique), dtype=np.int64)  # the sum of the faces at an edge: the only one, where it is free
    np.add.at(owners, edges, np.arange(len(faces))[:, None])
    free = np.flatnonzero(count == 1)
    while len(free):
        gone = np.unique(owners[free])
        stays[gone] = False
        np.subtract.at(count, edges[gone], 1)
        np.subtract.at(owners, edges[gone], gone[:, None])
        touched = np.unique(edges[gone])
        free = touched[count[touched] == 1]
    return stays


def _has_area(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """``(F,)`` bool: whether a face has an area, at one keyframe at least."""
    corners = np.asarray(vertices, dtype=np.float64).reshape(len(vertices), -1, 3)[faces]
    a, b, c = corners.transpose(1, 0, 2, 3)
    return np.cross(b - a, c - a).any(axis=(1, 2))
