"""What a row of ``tests/shapes/formats.md`` promises: a file that holds the feature, and what must come of it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from warp_bounding.shapes import load_shape

V = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
QUADS = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
T = np.array([[q[0], q[i], q[i + 1]] for q in QUADS for i in (1, 2)], np.uint16)


class Case(NamedTuple):
    """One row.

    Attributes:
        write: Makes the file in a folder, and returns its path.
        words: Of the note, or of the error; none where the row says *read*.
        check: Asserts that a shape is what the file holds; not asked where the row says *refused*.
        load: Reads the file; what it returns has a ``restriction``.
    """

    write: Callable[[Path], Path]
    words: str = ""
    check: Callable[[Any], None] = lambda shape: None
    load: Callable[[Path], Any] = load_shape


def file(name: str, content: str | bytes) -> Callable[[Path], Path]:
    """Writes one file."""

    def write(folder: Path) -> Path:
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
        return folder / name

    return write


def measures(vertices: np.ndarray, faces: np.ndarray) -> tuple[set, float, float]:
    """The places of the vertices of faces, the area, and the volume that closed faces enclose: equal for equal polygons
    however they are cut."""
    corners = np.asarray(vertices, np.float32).astype(np.float64)[np.asarray(faces, np.int64)]
    a, b, c = corners.transpose(1, 0, 2)
    area = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)
    volume = abs(float(np.linalg.det(corners - corners.reshape(-1, 3).mean(axis=0)).sum() / 6))
    return {tuple(corner) for corner in corners.reshape(-1, 3).tolist()}, area, volume


def same(shape: Any, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Assert that a mesh has the geometry of another one."""
    found, expected = measures(shape.vertices, shape.faces), measures(vertices, faces)
    assert found[0] == expected[0]
    assert np.allclose(found[1:], expected[1:], rtol=1e-6, atol=0)


def cubes(*shifts: tuple[float, float, float], half: float = 1.0) -> Callable[[Any], None]:
    """Check for cubes at these places, (0, 0, 0) by default."""
    shifts = shifts or ((0, 0, 0),)
    vertices = np.concatenate([half * V + np.float32(shift) for shift in shifts])
    faces = np.concatenate([T.astype(int) + 8 * k for k in range(len(shifts))])
    return lambda shape: same(shape, vertices, faces)
