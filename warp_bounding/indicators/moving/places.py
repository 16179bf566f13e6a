"""Places on and over a surface that moves, with their times: where it sticks out, and at random."""

import numpy as np

__all__ = ["corner_places", "random_places"]

MOST = 2**16  # corners at keyframes; of more only every second, or third, is one


def corner_places(times: np.ndarray, frames: np.ndarray, faces: np.ndarray, margin: float) -> np.ndarray:
    """``(P, 4)`` float64, time first: vertices of faces at keyframes; for a margin, what lies over them on either side.

    Args:
        times: ``(K,)``.
        frames: ``(K, V, 3)``.
        faces: ``(F, 3)``.
        margin: Object units.
    """
    used = np.unique(faces)
    stride = max(1, len(frames) * len(used) // MOST)
    found = []
    for number, (time, frame) in enumerate(zip(times, frames, strict=True)):
        some = used[number % stride :: stride]
        vertices = frame.astype(np.float64)
        away = margin * _normals(vertices, faces)[some] if margin else np.zeros(3)
        for way in (away, -away) if margin else (away,):
            found.append(np.insert(vertices[some] + way, 0, time, axis=1))
    return np.concatenate(found)


def _normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """``(V, 3)``, directions of length 1, or 0: sums of the normals of faces, weighted by their areas."""
    corner, *others = vertices[faces].transpose(1, 0, 2)
    normals = np.cross(others[0] - corner, others[1] - corner)
    sums = np.stack(
        [np.bincount(faces.T.ravel(), np.tile(normal, 3), minlength=len(vertices)) for normal in normals.T], axis=1
    )
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    return sums / np.where(lengths > 0, lengths, 1.0)


def random_places(
    times: np.ndarray, frames: np.ndarray, faces: np.ndarray, margin: float, count: int, rng: np.random.Generator
) -> np.ndarray:
    """``(count, 4)`` float64, time first, uniform: points of faces, uniform by their area at the keyframe before.

    Args:
        times: ``(K,)``.
        frames: ``(K, V, 3)``.
        faces: ``(F, 3)``.
        margin: How far points may be from the faces, object units.
        count: How many.
        rng: Source of randomness.
    """
    times = times.astype(np.float64)
    time = np.sort(rng.uniform(times[0], times[-1], count))
    edges = np.searchsorted(time, times[1:-1])
    found = []
    for k, part in enumerate(np.split(time, edges)):
        first, last = (f[faces].astype(np.float64) for f in (frames[k], frames[k + 1]))
        area = np.linalg.norm(np.cross(first[:, 1] - first[:, 0], first[:, 2] - first[:, 0]), axis=1)
        area = area if area.any() else np.ones(len(faces))
        face = rng.choice(len(faces), len(part), p=area / area.sum())
        share = ((part - times[k]) / (times[k + 1] - times[k]))[:, None, None]
        corners = (1 - share) * first[face] + share * last[face]
        found.append(np.einsum("nk,nkx->nx", rng.dirichlet(np.ones(3), len(part)), corners))
    away = rng.normal(size=(count, 3))
    away *= margin * rng.random((count, 1)) / np.linalg.norm(away, axis=1, keepdims=True)
    return rng.permutation(np.column_stack([time, np.concatenate(found) + away]))
