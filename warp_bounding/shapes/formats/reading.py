"""What all readers share: one clear error for whatever goes wrong inside, and what each makes of a mesh."""

import contextlib
import importlib
import logging
import os
import warnings
from collections.abc import Iterable, Iterator, Sequence
from types import ModuleType
from typing import NamedTuple

import numpy as np

from warp_bounding.errors import ShapeError
from warp_bounding.rigid import moved

LONGEST_REASON = 200  # characters of a foreign error message that go into ours
DAMAGED = (AssertionError, AttributeError, IndexError, NameError, TypeError)  # raised where a reader has no words
LIBRARIES = ("PIL", "trimesh", "yaml", "yourdfpy")  # that read files


@contextlib.contextmanager
def reading(path: str | os.PathLike, expected: str) -> Iterator[None]:
    """Turn every exception of a foreign reader into a ``ShapeError`` of one line: what was ``expected``, and why.

    What the reader logs goes to handlers of the program only, not to standard error; its warnings go nowhere.

    The readers of the file formats raise dozens of exception types on damaged input (``SyntaxError``, ``KeyError``,
    ``struct.error``, ...), none of them documented; hence the broad catch, which hides nothing: the cause is chained.
    """
    silent, loggers = logging.NullHandler(), [logging.getLogger(name) for name in LIBRARIES]
    for logger in loggers:
        logger.addHandler(silent)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", module=rf"({'|'.join(LIBRARIES)})\b")
            # of NumPy before 2.3, which leaves out what follows a word that is no number
            warnings.filterwarnings("error", message="string or file could not be read to its end")
            yield
    except ShapeError:
        raise
    except Exception as error:
        known = getattr(error, "strerror", None) if not isinstance(error, FileNotFoundError) else None
        reason = known or " ".join(str(error).split()) or type(error).__name__
        if isinstance(error, ValueError) and reason.startswith("expected"):  # by a reader of ours
            raise ShapeError(f"{path}: {reason}") from error
        reason = "its parts do not fit together" if isinstance(error, DAMAGED) else reason
        reason = f"{reason} is missing" if isinstance(error, KeyError | FileNotFoundError) else reason
        reason = reason if len(reason) <= LONGEST_REASON else reason[: LONGEST_REASON - 3] + "..."
        raise ShapeError(f"{path}: expected {expected}, but it cannot be read: {reason}") from error
    finally:
        for logger in loggers:
            logger.removeHandler(silent)


def import_optional(module: str, package: str, path: str | os.PathLike) -> ModuleType:
    """Import a module of an optional dependency; ``ShapeError`` with the command that installs it if missing."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        hint = "pip install 'warp-bounding[train]'"
        raise ShapeError(f"{path}: reading it needs {package}, which is not installed; run {hint}") from error


# --- Meshes -----------------------------------------------------------------------------------------------------------
#
# What every reader of a mesh file makes: vertices, triangles, and notes of what a user should know.
#
# Polygons become fans of triangles around their first corner. The fan holds the polygon. Of one that is not convex it
# may hold more: triangles that lie beside it.


class MeshData(NamedTuple):
    """A mesh as it was read.

    Attributes:
        vertices: ``(V, 3)`` float64.
        faces: ``(F, 3)`` int64, indices of vertices, each of which exists.
        notes: What was not read, or read in one way of several.
    """

    vertices: np.ndarray
    faces: np.ndarray
    notes: tuple[str, ...] = ()


def as_numbers(words: Sequence[bytes]) -> np.ndarray:
    """Decimal numbers of a text, ``(N,)`` float64; raises ``ValueError`` for a word that is none."""
    return np.fromiter(map(float, words), np.float64, len(words))


def as_faces(indices: np.ndarray, vertices: int) -> np.ndarray:
    """Indices as int64; raises ``ValueError`` unless each is that of a vertex, 0 to ``vertices - 1``."""
    indices = np.asarray(indices)
    if indices.size and not (indices.min() >= 0 and indices.max() < vertices):
        if not vertices:
            raise ValueError("expected vertices of the faces, got none")
        wrong = indices.min() if indices.min() < 0 else indices.max()
        raise ValueError(f"expected faces of vertices 0 to {vertices - 1}, got vertex {wrong:.15g}")
    return indices.astype(np.int64)


def joined(parts: Iterable[tuple[np.ndarray, np.ndarray]], notes: Iterable[str] = ()) -> MeshData:
    """One mesh of parts ``(vertices, faces)``.

    Raises ``ValueError`` if no part has a face, or a vertex is not finite.
    """
    parts = [(np.asarray(vertices, np.float64), faces) for vertices, faces in parts]
    starts = np.cumsum([0] + [len(vertices) for vertices, _ in parts])
    notes = tuple(dict.fromkeys(notes))
    if not sum(len(faces) for _, faces in parts):
        raise ValueError("; ".join(["expected a mesh with faces, got none", *notes]))
    vertices = np.concatenate([vertices for vertices, _ in parts])
    if not (finite := np.isfinite(vertices).all(axis=1)).all():
        raise ValueError(f"expected finite vertices, got {(~finite).sum()} that are not")
    return MeshData(vertices, np.concatenate([f + s for (_, f), s in zip(parts, starts, strict=False)]), notes)


def placed(vertices: np.ndarray, faces: np.ndarray, matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices where a matrix ``(4, 4)`` puts them, and their faces, turned where it mirrors."""
    if (matrix == np.eye(4)).all():
        return vertices, faces
    return moved(vertices, matrix), faces[:, ::-1] if np.linalg.det(matrix[:3, :3]) < 0 else faces


def triangulated(counts: np.ndarray, indices: np.ndarray, vertices: int) -> np.ndarray:
    """Cut polygons ``(P,)`` of so many corners, whose indices come one after another, into fans ``(F, 3)`` int64.

    Raises ``ValueError`` for polygons of fewer than three corners, or of vertices that are not there.
    """
    counts = np.asarray(counts, np.int64)
    if counts.size and counts.min() < 3:
        raise ValueError(f"expected polygons of at least 3 vertices, got {counts.min()}")
    if counts.sum() != np.size(indices):
        raise ValueError(f"expected {counts.sum()} indices for {counts.size} polygons, got {np.size(indices)}")
    indices, sizes = as_faces(indices, vertices), counts - 2
    first = np.repeat(np.cumsum(counts) - counts, sizes)
    second = first + np.arange(sizes.sum()) - np.repeat(np.cumsum(sizes) - sizes, sizes) + 1
    return np.stack([indices[first], indices[second], indices[second + 1]], axis=1)
