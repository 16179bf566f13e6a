"""Which sums of faces every line crosses evenly outside: the cycles modulo 2 of a closed surface.

A set of faces is a cycle if each edge belongs to an even number of them. A ray from a point crosses a cycle an odd
number of times only if the cycle keeps the point from infinity, whatever way faces are turned and however they run
through one another. So an odd number is a proof that the point is enclosed; even numbers prove nothing.

Faces that meet two by two at their edges form a patch. Where three or more meet, as at the wall between two chambers,
a cycle holds an even number of them: one linear equation modulo 2 between patches. The solutions have a basis, and each
element of it gets a random number of 64 bits; a face carries the exclusive or of the numbers of those elements that it
is in. Then the exclusive or over the faces that a ray crosses is 0 if it crosses all of them evenly. (It is 0 for one
odd sum in 2^64, too, and then the point is not known to be enclosed.)
"""

import numpy as np

from warp_bounding.indicators.distinct_rows import distinct_rows

__all__ = ["cycles_of"]

MOST_JOINED = 4096  # patches that meet three or more at an edge: for more of them no cycle is looked for
SEED = 0  # of the random numbers


def cycles_of(vertices: np.ndarray, faces: np.ndarray, closed: np.ndarray) -> np.ndarray:
    """The numbers of faces.

    Args:
        vertices: ``(V, 3)``; those at equal places are one.
        faces: ``(F, 3)`` integers.
        closed: ``(F,)`` bool, the faces that count (``closed_parts.surface_of``).

    Returns:
        ``(F,)`` uint64; 0 for a face in no cycle, and for the doubles of a face.
    """
    numbers = np.zeros(len(faces), dtype=np.uint64)
    places = np.flatnonzero(closed)
    if len(places) == 0:
        return numbers
    _, _, merged = distinct_rows(vertices)
    corners = np.sort(merged[faces[places]], axis=1)
    corners, first, _ = distinct_rows(corners)
    ends = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [0, 2]]])
    _, edge, count = np.unique(ends[:, 0] * len(vertices) + ends[:, 1], return_inverse=True, return_counts=True)
    face = np.tile(np.arange(len(corners)), 3)
    numbers[places[first]] = _numbers(edge, face, count, len(corners))
    return numbers


def _numbers(edge: np.ndarray, face: np.ndarray, count: np.ndarray, faces: int) -> np.ndarray:
    """Of each face.

    Args:
        edge: Of each edge of a face.
        face: Of each edge of a face.
        count: Faces of each edge.
        faces: How many there are.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    by_edge = np.argsort(edge, kind="stable")
    simple = by_edge[count[edge[by_edge]] == 2].reshape(-1, 2)
    joins = face[simple].T
    graph = coo_array((np.ones(len(simple), dtype=np.int8), (joins[0], joins[1])), shape=(faces, faces))
    patches, patch = connected_components(graph, directed=False)
    number = np.random.default_rng(SEED).integers(1, 2**64, size=patches, dtype=np.uint64)
    tangled = by_edge[count[edge[by_edge]] != 2]
    if len(tangled):
        stretches = np.split(patch[face[tangled]], np.flatnonzero(np.diff(edge[tangled])) + 1)
        _solve(number, {_odd(stretch) for stretch in stretches} - {()})
    return number[patch]


def _odd(stretch: np.ndarray) -> tuple[int, ...]:
    """The patches that occur an odd number of times at an edge."""
    patches, times = np.unique(stretch, return_counts=True)
    return tuple(patches[times % 2 == 1].tolist())


def _solve(number: np.ndarray, equations: set[tuple[int, ...]]) -> None:
    """Make the numbers of patches a solution of all equations: Gauss-Jordan elimination modulo 2, rows are integers."""
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
