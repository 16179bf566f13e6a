"""Faces of a mesh of blend shapes in patches of neighbours, and the boxes that hold them at every pose."""

from typing import NamedTuple

import numpy as np

__all__ = ["Patches", "patches_of"]

FACES = 8  # of a patch, at most


class Patches(NamedTuple):
    """Patches, each of some faces.

    Attributes:
        faces: ``(F, 3)`` int32, patch by patch.
        first: ``(C + 1,)`` int32: faces of patch i begin at the i-th number, and end before the next.
        low: ``(C, 3)``, least coordinates of a patch's vertices at pose 0.
        high: ``(C, 3)``, largest ones.
        low_deltas: ``(K, C, 3)``, least deltas of a patch's vertices, of each pose number.
        high_deltas: ``(K, C, 3)``, largest ones.
        part: ``(C,)`` int32, ascending: the part of the surface, connected along edges, that a patch belongs to.
    """

    faces: np.ndarray
    first: np.ndarray
    low: np.ndarray
    high: np.ndarray
    low_deltas: np.ndarray
    high_deltas: np.ndarray
    part: np.ndarray


def patches_of(vertices: np.ndarray, deltas: np.ndarray, faces: np.ndarray) -> Patches:
    """Halve the faces of each connected part by the middles of where they lie until there are ``FACES`` at most."""
    connected, middles, parts = _connected(faces), vertices[faces].mean(axis=1), []
    waiting = [np.flatnonzero(connected == number) for number in np.unique(connected)[::-1]]
    while waiting:
        part = waiting.pop()
        if len(part) <= FACES:
            parts.append(part)
            continue
        part = part[np.argsort(middles[part, np.argmax(np.ptp(middles[part], axis=0))], kind="stable")]
        waiting += [part[len(part) // 2 :], part[: len(part) // 2]]
    own = [np.unique(faces[part]) for part in parts]

    def ends(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.stack([x[i].min(axis=0) for i in own]), np.stack([x[i].max(axis=0) for i in own])

    moved = [ends(delta) for delta in deltas]
    first = np.cumsum([0, *map(len, parts)]).astype(np.int32)
    low_deltas, high_deltas = (np.stack([pair[side] for pair in moved]) for side in (0, 1))
    part = np.array([connected[own[0]] for own in parts], dtype=np.int32)
    return Patches(faces[np.concatenate(parts)], first, *ends(vertices), low_deltas, high_deltas, part)


def _connected(faces: np.ndarray) -> np.ndarray:
    """``(F,)`` int, the same number for faces that edges join: the least number of a face among them."""
    edges = np.sort(np.concatenate([faces[:, pair] for pair in ((0, 1), (1, 2), (2, 0))]), axis=1)
    _, edge = np.unique(edges, axis=0, return_inverse=True)
    edge = edge.reshape(3, -1).T
    found, before = np.arange(len(faces)), None
    while before is None or (found != before).any():
        before, least = found, np.full(edge.max() + 1, len(faces))
        np.minimum.at(least, edge, found[:, None])
        found = least[edge].min(axis=1)
        found = found[found]
    return found
