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
    """

    faces: np.ndarray
    first: np.ndarray
    low: np.ndarray
    high: np.ndarray
    low_deltas: np.ndarray
    high_deltas: np.ndarray


def patches_of(vertices: np.ndarray, deltas: np.ndarray, faces: np.ndarray) -> Patches:
    """Halve the faces by the middles of where they lie until each part has ``FACES`` at most."""
    middles, parts, waiting = vertices[faces].mean(axis=1), [], [np.arange(len(faces))]
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
    return Patches(faces[np.concatenate(parts)], first, *ends(vertices), low_deltas, high_deltas)
