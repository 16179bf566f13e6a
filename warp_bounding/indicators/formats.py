"""``load_indicator``: one door for files, arrays and meshes; and the readers of the formats that hold arrays.

Which reader a file gets depends on its extension alone; what it holds must then be what the extension says. Meshes
come from trimesh (``mesh_files.py``) and usd-core (``usd.py``), voxels from ``binvox.py``.
"""

import os
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

from warp_bounding.errors import IndicatorError
from warp_bounding.indicators.binvox import read_binvox
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.mesh import IndicatorMesh
from warp_bounding.indicators.mesh_files import MESH_SUFFIXES, mesh_from_trimesh, read_mesh
from warp_bounding.indicators.motion import IndicatorMotion
from warp_bounding.indicators.reading import import_optional, reading
from warp_bounding.indicators.usd import USD_SUFFIXES, read_usd

__all__ = ["SUFFIXES", "load_indicator"]

TIME_NDIM = 4  # arrays of this many dimensions are animations unless the caller says otherwise
OCCUPIED = 0.5  # numbers from here on are occupied
ALPHA_MODES = ("RGBA", "LA", "PA")
PALETTE_MODES = ("P", "RGB", "L", "1")  # may name a transparent colour instead of carrying an alpha channel


def load_indicator(source: object, *, time: bool | None = None) -> IndicatorGrid | IndicatorMesh | IndicatorMotion:
    """Make an indicator of a file, an array or a mesh.

    Args:
        source: A path to ``.png`` (alpha of at least 0.5 is occupied; coordinate 0 is the row), ``.binvox``
            (coordinates x, y, z), ``.npy``, ``.npz`` (one array, or one named ``occupancy``), a mesh that trimesh reads
            (``.obj``, ``.ply``, ``.stl``, ``.glb``, ``.gltf``, ``.off``) or USD (``.usd``, ``.usda``, ``.usdc``,
            ``.usdz``); an n-D array, bool or numeric (0.5 and more is occupied); a ``trimesh.Trimesh`` or
            ``trimesh.Scene``; an ``IndicatorGrid``, ``IndicatorMesh`` or ``IndicatorMotion``, which is returned as it is.
        time: Whether coordinate 0 is time. By default it is for 4-D arrays and motions; a mesh never moves.

    Returns:
        An ``IndicatorGrid`` for images, voxels and arrays, an ``IndicatorMesh`` for meshes, an ``IndicatorMotion`` for one.

    Raises:
        IndicatorError: In one line, for everything that cannot be read or bounded.
    """
    if time is not None and not isinstance(time, bool | np.bool_):
        raise IndicatorError(f"time must be True, False or None, got {time!r}")
    indicator = _load(source, time)
    if isinstance(indicator, IndicatorMotion):
        if time is False:
            raise IndicatorError(f"{indicator.name}: coordinate 0 of a motion is time, got time=False")
        return indicator
    if isinstance(indicator, IndicatorMesh):
        if time:
            raise IndicatorError(f"{indicator.name}: a mesh has no time coordinate, got time=True")
        return indicator
    if indicator.time and indicator.ndim < 2:
        raise IndicatorError(f"{indicator.name}: time and at least one more coordinate expected, got {indicator.ndim}")
    return indicator


def _load(source: object, time: bool | None) -> IndicatorGrid | IndicatorMesh | IndicatorMotion:
    if isinstance(source, IndicatorMesh | IndicatorMotion):
        return source
    if isinstance(source, IndicatorGrid):
        return source if time is None or time == source.time else replace(source, time=bool(time))
    if isinstance(source, np.ndarray):
        return _grid(source, "array", time)
    if isinstance(source, str | os.PathLike):
        return _load_file(Path(os.fsdecode(source)), time)
    trimesh = sys.modules.get("trimesh")  # whoever passes a Trimesh has imported it
    if trimesh is not None and isinstance(source, trimesh.Trimesh | trimesh.Scene):
        return mesh_from_trimesh(source, name="trimesh")
    kind = type(source).__name__
    raise IndicatorError(f"expected a path, a NumPy array, a trimesh.Trimesh or an indicator, got {kind}")


def _load_file(path: Path, time: bool | None) -> IndicatorGrid | IndicatorMesh:
    suffix = path.suffix.lower()
    try:
        if not path.exists():
            raise IndicatorError(f"{path}: there is no such file")
        if not path.is_file():
            raise IndicatorError(f"{path}: expected a file, got {'a directory' if path.is_dir() else 'something else'}")
        if suffix not in SUFFIXES:
            raise IndicatorError(f"{path}: expected one of {' '.join(SUFFIXES)}, got {suffix or 'no extension'!r}")
        with path.open("rb") as file:
            if not file.read(1):
                raise IndicatorError(f"{path}: expected a {suffix} file, but it is empty")
        if suffix in MESH_SUFFIXES:
            return read_mesh(path)
        if suffix in USD_SUFFIXES:
            return read_usd(path)
        return _grid(_ARRAY_READERS[suffix](path), path.name, time)
    except (OSError, ValueError) as error:  # no permission, a name with a null byte, ...
        if isinstance(error, IndicatorError):
            raise
        reason = getattr(error, "strerror", None) or str(error)
        raise IndicatorError(f"{path}: cannot be read: {reason}") from error


def _grid(array: np.ndarray, name: str, time: bool | None) -> IndicatorGrid:
    """Make the indicator of an array of truth values or numbers."""
    if isinstance(array, np.ma.MaskedArray):
        raise IndicatorError(f"{name}: expected a plain array, got a masked one; fill it first")
    if array.dtype.kind not in "biuf":
        raise IndicatorError(f"{name}: expected an array of bool or real numbers, got dtype {array.dtype}")
    if array.dtype.kind == "f" and np.isnan(array).any():
        count = int(np.isnan(array).sum())
        raise IndicatorError(f"{name}: expected numbers, got NaN in {count} of {array.size} cells")
    occupancy = array if array.dtype.kind == "b" else array >= OCCUPIED
    return IndicatorGrid(occupancy, name=name, time=array.ndim == TIME_NDIM if time is None else bool(time))


def _read_png(path: Path) -> np.ndarray:
    """``(height, width)`` bool, where alpha is at least one half."""
    image_module = import_optional("PIL.Image", "pillow", path)
    with reading(path, "a PNG image"), warnings.catch_warnings():
        warnings.simplefilter("error", image_module.DecompressionBombWarning)
        with image_module.open(path, formats=("PNG",)) as image:
            if getattr(image, "n_frames", 1) != 1:
                raise IndicatorError(f"{path}: expected one picture, got an animation of {image.n_frames}")
            if image.mode not in ALPHA_MODES and not (image.mode in PALETTE_MODES and "transparency" in image.info):
                raise IndicatorError(f"{path}: expected an image with an alpha channel, got mode {image.mode} without")
            alpha = np.asarray(image.convert("RGBA"))[..., 3]
    return alpha / 255.0 >= OCCUPIED


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


_ARRAY_READERS = {".png": _read_png, ".binvox": read_binvox, ".npy": _read_npy, ".npz": _read_npz}
SUFFIXES = (*_ARRAY_READERS, *MESH_SUFFIXES, *USD_SUFFIXES)
