"""How a mesh's faces join: which of them enclose an inside, and which sums of faces every line crosses evenly."""

from dataclasses import dataclass

import numpy as np


def distinct_rows(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows ``(N, k)`` without NaN in lexicographic order, each once.

    The distinct rows ``(U, k)``; ``(U,)`` int64, where each occurs first; ``(N,)`` int64, which of them each row is.
    """
    order = np.lexsort(rows.T[::-1])  # stable: the first of equal rows comes first
    ordered = rows[order]
    new = np.ones(len(rows), dtype=bool)
    new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    number = np.empty(len(rows), dtype=np.int64)
    number[order] = np.cumsum(new) - 1
    return ordered[new], order[new], number


def paths_of(frames: np.ndarray) -> np.ndarray:
    """Vertices at K keyframes ``(K, V, 3)``, side by side: ``(V, 3 K)``."""
    return np.ascontiguousarray(frames.transpose(1, 0, 2)).reshape(frames.shape[1], -1)


# --- Closed parts -----------------------------------------------------------------------------------------------------
#
# Which faces of a triangle mesh enclose an inside: those that are left when all with a free edge are taken away.
#
# Vertices at equal places are one vertex, faces with the same three vertices one face. A face with an edge that no
# other face has is taken away, and again, until there is none: the rest is closed, whatever way its faces are turned,
# however many of them meet in an edge (a wall between two chambers), and however shells lie in or through one another.
# Its inside is what a flood from outside does not reach (``triangles.cells.fill_inside``), so a choice that is made
# here never takes anything from the object: every face stays on the surface, and a closed part only adds the inside to
# it.
#
# A face without area stays as long as its edges do: it may be what fills a crack where a vertex lies on another face's
# edge. One that hangs loose is taken away like any other, and does not make a mesh an open one.
#
# What this does not do: cracks between vertices that are almost equal are not mended; a surface with one is open.


@dataclass(frozen=True)
class Surface:
    """A mesh's faces, distinguished by what they enclose.

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
                "surface only: the mesh is open, so just the surface and the margin around it are bounded, and what "
                "lies deeper inside counts as outside"
            )
        return (
            f"surface only for {int(self.loose.sum())} of {len(self.loose)} faces: there the mesh is open, so just "
            "the surface and the margin around it are bounded, and what lies deeper inside counts as outside; closed "
            "parts are bounded whole"
        )


def surface_of(vertices: np.ndarray, faces: np.ndarray) -> Surface:
    """Tell the closed parts of a mesh from its open ones.

    Vertices are ``(V, 3)``, or ``(V, 3 K)`` for K keyframes, side by side: they are one where all numbers are equal.
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
    """Whether the faces ``(F, 3)`` of closed parts are consistently oriented; equal vertices ``(V, 3)`` count as one.

    Returns:
        The number of edges that faces do not run through equally often both ways, 0 for consistent faces; and whether
            the faces are one piece with two faces at every edge, which has one inside unless it intersects itself.
    """
    _, _, merged = distinct_rows(vertices)
    ends, face, edge, count = _edges_of(merged[faces].astype(np.int64), len(vertices))
    ways = np.bincount(edge, weights=np.sign(ends[:, 1] - ends[:, 0]), minlength=len(count))
    by_edge = np.argsort(edge, kind="stable")
    first, second = by_edge[:-1], by_edge[1:]
    joined = edge[first] == edge[second]
    pieces, _ = joined_parts(face[first][joined], face[second][joined], len(faces))
    return int(np.count_nonzero(ways)), bool((count == 2).all() and pieces == 1)


def _edges_of(corners: np.ndarray, vertices: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of the three sides of faces ``(F, 3)``: both ends, the face, the edge's number; and the sides of each edge."""
    ends = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    numbers = ends.min(axis=1) * vertices + ends.max(axis=1)
    _, edge, count = np.unique(numbers, return_inverse=True, return_counts=True)
    return ends, np.tile(np.arange(len(corners)), 3), edge, count


def joined_parts(starts: np.ndarray, ends: np.ndarray, count: int) -> tuple[int, np.ndarray]:
    """How many parts there are of so many things, some of which are joined in pairs, and the part of each."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(starts), dtype=np.int8), (starts, ends)), shape=(count, count))
    return connected_components(graph, directed=False)


def _without_free_edges(faces: np.ndarray) -> np.ndarray:
    """``(F,)`` bool: the faces that stay when those with an edge of their own are taken away, again and again.

    Rows are ascending, no two the same.
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


# --- Cycles -----------------------------------------------------------------------------------------------------------
#
# Which sums of faces every line crosses evenly outside: the cycles modulo 2 of a closed surface.
#
# A set of faces is a cycle if each edge belongs to an even number of them. A ray from a point crosses a cycle an odd
# number of times only if the cycle keeps the point from infinity, whatever way faces are turned and however they run
# through one another. So an odd number is a proof that the point is enclosed; even numbers prove nothing.
#
# Faces that meet two by two at their edges form a patch. Where three or more meet, as at the wall between two chambers,
# a cycle holds an even number of them: one linear equation modulo 2 between patches. The solutions have a basis, and
# each element of it gets a random number of 64 bits; a face carries the exclusive or of the numbers of those elements
# that it is in. Then the exclusive or over the faces that a ray crosses is 0 if it crosses all of them evenly. (It is 0
# for one odd sum in 2^64, too, and then the point is not known to be enclosed.)

MOST_JOINED = 4096  # patches that meet three or more at an edge: for more of them no cycle is looked for
SEED = 0  # of the random numbers


def cycles_of(vertices: np.ndarray, faces: np.ndarray, closed: np.ndarray) -> np.ndarray:
    """The numbers ``(F,)`` uint64 of faces; 0 for a face in no cycle, for the doubles of a face, and if not ``closed``.

    Vertices ``(V, 3)`` at equal places are one.
    """
    numbers = np.zeros(len(faces), dtype=np.uint64)
    places = np.flatnonzero(closed)
    if len(places) == 0:
        return numbers
    _, _, merged = distinct_rows(vertices)
    corners = np.sort(merged[faces[places]], axis=1)
    corners, first, _ = distinct_rows(corners)
    _, face, edge, count = _edges_of(corners, len(vertices))
    numbers[places[first]] = _numbers(edge, face, count, len(corners))
    return numbers


def _numbers(edge: np.ndarray, face: np.ndarray, count: np.ndarray, faces: int) -> np.ndarray:
    """Of each of so many faces; ``edge`` and ``face`` of each edge of a face, ``count`` faces of each edge."""
    by_edge = np.argsort(edge, kind="stable")
    simple = by_edge[count[edge[by_edge]] == 2].reshape(-1, 2)
    patches, patch = joined_parts(*face[simple].T, faces)
    number = np.random.default_rng(SEED).integers(1, 2**64, size=patches, dtype=np.uint64)
    tangled = by_edge[count[edge[by_edge]] != 2]
    if len(tangled):
        stretches = np.split(patch[face[tangled]], np.flatnonzero(np.diff(edge[tangled])) + 1)
        counts = (np.unique(stretch, return_counts=True) for stretch in stretches)
        _solve(number, {tuple(patches[times % 2 == 1].tolist()) for patches, times in counts} - {()})
    return number[patch]


def _solve(number: np.ndarray, equations: set[tuple[int, ...]]) -> None:
    """Make the numbers of patches a solution of all equations: Gauss-Jordan elimination modulo 2, rows are integers.

    An equation are the patches that occur an odd number of times at an edge.
    """
    joined = sorted({patch for equation in equations for patch in equation})
    if len(joined) > MOST_JOINED:
        number[joined] = 0
        return
    bit = {patch: 1 << i for i, patch in enumerate(joined)}
    rows: dict[int, int] = {}  # by their pivot, a single bit
    for equation in sorted(equations):
        row = sum(bit[patch] for patch in equation)
        for pivot, other in rows.items():
            if row & pivot:
                row ^= other
        if row:
            pivot = row & -row
            rows = {p: other ^ row if other & pivot else other for p, other in rows.items()}
            rows[pivot] = row
    for pivot, row in rows.items():
        others = [patch for patch in joined if row & bit[patch] and bit[patch] != pivot]
        number[joined[pivot.bit_length() - 1]] = np.bitwise_xor.reduce(number[others], initial=np.uint64(0))
