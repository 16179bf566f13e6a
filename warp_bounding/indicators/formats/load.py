"""``load_indicator``: one door for files, arrays and meshes; and the readers of the formats that hold arrays.

Which reader a file gets depends on its extension alone (``READERS``); what it holds must then be what the extension
says. Meshes come from ``mesh_files.py`` and usd-core (``usd.py``), voxels from ``binvox.py``, pixels from
``images.py``. What an array's values mean and where its cells lie is told in ``arrays.py``, meshes and arrays of other
libraries in ``objects.py``. Shapes of other kinds are objects with a ``to_grid`` (``Indicator``), as ours are, or
files whose reader makes one.
"""

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from warp_bounding.errors import IndicatorError
from warp_bounding.indicators.formats.arrays import Placement, Threshold, grid_of
from warp_bounding.indicators.formats.binvox import read_binvox
from warp_bounding.indicators.formats.images import read_png
from warp_bounding.indicators.formats.mesh_files import MESH_READERS, read_mesh
from warp_bounding.indicators.formats.objects import ACCEPTED, array_from, function_from, mesh_from
from warp_bounding.indicators.formats.reading import reading
from warp_bounding.indicators.formats.usd import USD_SUFFIXES, read_usd
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.mesh import IndicatorMesh
from warp_bounding.indicators.motion import IndicatorMotion
from warp_bounding.runtime.whole_file import BOUNDER_FILE

__all__ = ["READERS", "Indicator", "load_indicator"]


@runtime_checkable
class Indicator(Protocol):
    """A shape: all that is asked of one.

    Attributes:
        name: For people.
        extent: ``(n,)``, its size along each axis, object units.
    """

    name: str
    extent: np.ndarray

    def to_grid(self, *, resolution: int | None = None, margin: float = 0.0) -> IndicatorGrid:
        """Closed cells that hold every point within ``margin`` of the shape, ``resolution`` of them along the longest axis."""


def load_indicator(
    source: object,
    *,
    time: bool | None = None,
    threshold: float | str | None = None,
    spacing: float | Sequence[float] | None = None,
    origin: Sequence[float] | None = None,
) -> Indicator:
    """Make an indicator of a file, an array or a mesh.

    Coordinate k is array axis k: of an image, coordinate 0 is the row, from the top, and coordinate 1 the column.

    Args:
        source: A path to ``.png`` (alpha of at least 0.5 is occupied), ``.binvox`` (coordinates x, y, z), ``.npy``,
            ``.npz`` (one array, or one named ``occupancy``), a mesh (``.obj``, ``.ply``, ``.stl``, ``.glb``,
            ``.gltf``, ``.off``, ``.dae``) or USD (``.usd``, ``.usda``, ``.usdc``, ``.usdz``); an n-D array of NumPy,
            torch or Warp that holds truth values, or 0 and 1; a pair ``(vertices, faces)``, a ``trimesh.Trimesh`` or
            ``trimesh.Scene``, a ``newton.Mesh`` or a ``wp.Mesh``; an ``IndicatorGrid``, ``IndicatorMesh`` or
            ``IndicatorMotion``, or whatever else has their ``name``, ``extent`` and ``to_grid``, which is returned as
            it is; or an object with ``ndim``, ``lower``, ``upper``, ``contains`` and ``empty``, which becomes an
            ``IndicatorFunction``.
        time: Whether coordinate 0 is time. By default it is for 4-D arrays and motions; a mesh never moves.
        threshold: Which values of an array, or grey values of an image, are occupied: a text such as ``"<128"``,
            ``"<=0"``, ``">0.5"``, or a number, from which on they are.
        spacing: Of an array, voxel file or image: the size of a cell, object units; one number, or one for each axis.
            By default the centres of the first and the last cell lie on 0 and 1, as in the paper, on every axis,
            however many cells it has.
        origin: Of an array, voxel file or image: where the centre of the first cell is, object units; 0 on every axis
            by default. Whole or half cells away from 0.

    Returns:
        An ``IndicatorGrid`` for images, voxels and arrays, an ``IndicatorMesh`` for meshes, an ``IndicatorMotion`` for
        one.

    Raises:
        IndicatorError: In one line, for everything that cannot be read or bounded, or that may mean two things.

    Example:
        >>> wb.load_indicator(ball)
        <IndicatorGrid array: 3D, 16 x 16 x 16 cells, 912 occupied, extent 1.067 x 1.067 x 1.067>
        >>> wb.load_indicator(np.eye(3), threshold=">0.5", spacing=0.1).extent
        array([0.3, 0.3])
    """
    if time is not None and not isinstance(time, bool | np.bool_):
        raise IndicatorError(f"time must be True, False or None, got {time!r}")
    limit = None if threshold is None else Threshold.of(threshold)
    found = _load(source, limit)
    if isinstance(found, _Array):
        found = grid_of(found.values, found.name, time, limit, Placement(spacing, origin))
    else:
        given = {"threshold": threshold, "spacing": spacing, "origin": origin}
        for option in (key for key, value in given.items() if value is not None):
            kind = type(found).__name__
            raise IndicatorError(
                f"{found.name}: {option} is for arrays and images, got {option}={given[option]!r} for {kind}"
            )
    if not isinstance(found, IndicatorGrid):
        moves = isinstance(found, IndicatorMotion) or getattr(found, "time", False) is True
        if moves and time is False:
            raise IndicatorError(f"{found.name}: coordinate 0 of {_article(found)} is time, got time=False")
        if time and not moves:
            raise IndicatorError(f"{found.name}: {_article(found)} has no time coordinate, got time=True")
        return found
    if time is not None and time != found.time:
        found = replace(found, time=bool(time))
    if found.time and found.ndim < 2:
        raise IndicatorError(f"{found.name}: time and at least one more coordinate expected, got {found.ndim}")
    return found


class _Array(NamedTuple):
    """Values that a threshold and a placement make a grid of."""

    values: np.ndarray
    name: str


def _load(source: object, threshold: Threshold | None) -> _Array | Indicator:
    if isinstance(source, Indicator):
        return source
    if (function := function_from(source)) is not None:
        return function
    if isinstance(source, str | os.PathLike):
        return _load_file(Path(os.fsdecode(source)), threshold)
    array = array_from(source)
    if array is not None:
        return _Array(array, "array")
    mesh = mesh_from(source)
    if mesh is None:
        raise IndicatorError(f"expected {ACCEPTED}, got {type(source).__name__}")
    return mesh


def _article(found: Indicator) -> str:
    known = {IndicatorMesh: "a mesh", IndicatorMotion: "a motion"}
    return known.get(type(found), f"this {type(found).__name__}")


def _load_file(path: Path, threshold: Threshold | None) -> _Array | Indicator:
    suffix = path.suffix.lower()
    try:
        if not path.exists():
            raise IndicatorError(f"{path}: no such file")
        if not path.is_file():
            raise IndicatorError(f"{path}: expected a file, got {'a directory' if path.is_dir() else 'something else'}")
        if suffix == BOUNDER_FILE.suffix:
            raise IndicatorError(f"{path}: expected a shape, got a bounder's file; load (or info) reads it")
        if suffix not in READERS:
            raise IndicatorError(f"{path}: expected one of {' '.join(READERS)}, got {suffix or 'no extension'!r}")
        with path.open("rb") as file:
            if not file.read(1):
                raise IndicatorError(f"{path}: expected a {suffix} file, but it is empty")
        found = READERS[suffix](path, threshold is not None)
        return _Array(found, path.name) if isinstance(found, np.ndarray) else found
    except (OSError, ValueError) as error:  # no permission, a name with a null byte, ...
        if isinstance(error, IndicatorError):
            raise
        reason = getattr(error, "strerror", None) or str(error)
        raise IndicatorError(f"{path}: cannot be read: {reason}") from error


def _read_npy(path: Path) -> np.ndarray:
    with reading(path, "a NumPy .npy array"), path.open("rb") as file:
        array = np.lib.format.read_array(file, allow_pickle=False)
        if file.read(1):
            raise IndicatorError(f"{path}: expected the end of the file after {array.size} numbers, got more data")
    return array


def _read_npz(path: Path) -> np.ndarray:
    with reading(path, "a NumPy .npz archive"), path.open("rb") as file:
        if file.read(2) != b"PK":
            raise IndicatorError(f"{path}: expected a NumPy .npz archive, got a file that is not a zip archive")
        file.seek(0)
        with np.load(file, allow_pickle=False) as archive:
            names = archive.files
            if len(names) != 1 and "occupancy" not in names:
                raise IndicatorError(f"{path}: expected one array or one named 'occupancy', got {names}")
            array = archive["occupancy" if "occupancy" in names else names[0]]
            if not isinstance(array, np.ndarray):  # other files in the archive come as bytes
                raise IndicatorError(f"{path}: expected an archive of NumPy arrays, got the file {names[0]!r}")
            return array


# By extension: each is given a path and whether a threshold waits for numbers, and makes an array or an ``Indicator``.
READERS: dict[str, Callable[[Path, bool], Any]] = {
    ".png": lambda path, numbers: read_png(path, grey=numbers),
    ".binvox": lambda path, _: read_binvox(path),
    ".npy": lambda path, _: _read_npy(path),
    ".npz": lambda path, _: _read_npz(path),
    **dict.fromkeys(MESH_READERS, lambda path, _: read_mesh(path)),
    **dict.fromkeys(USD_SUFFIXES, lambda path, _: read_usd(path)),
}
