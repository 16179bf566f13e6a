"""Which files of a folder are shapes, and what of them enters the name of their bounder.

A file is a shape if its extension is one that ``load_indicator`` reads; whether it holds one is found out when it is baked. Folders inside are
looked through as well, hidden files and folders are not.
"""

import hashlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from warp_bounding.baking.settings import file_digest
from warp_bounding.errors import IndicatorError
from warp_bounding.indicators.formats.gltf import referred_buffers
from warp_bounding.indicators.formats.load import READERS
from warp_bounding.indicators.formats.usd import USD_SUFFIXES

__all__ = ["MEGABYTE", "Found", "find_shapes", "shape_digest"]

MEGABYTE = 1_000_000


class Found(NamedTuple):
    """What a folder holds: paths, in the order of their names."""

    shapes: list[Path]
    too_large: list[Path]
    foreign: int  # files of other kinds


def find_shapes(folder: Path, largest: float, without: Path) -> Found:
    """Look through a folder.

    Args:
        folder: Where.
        largest: Megabytes; files above it are not taken.
        without: A folder that is left out, wherever it is: that of the results.

    Raises:
        IndicatorError: If there is no such folder, or no shape in it.
    """
    if not folder.is_dir():
        raise IndicatorError(f"{folder}: {'a file, expected a folder' if folder.exists() else 'no such folder'}")
    found = Found([], [], 0)
    for path in _files(folder, without.resolve()):
        if path.suffix.lower() not in READERS:
            found = found._replace(foreign=found.foreign + 1)
        elif path.stat().st_size > largest * MEGABYTE:
            found.too_large.append(path)
        else:
            found.shapes.append(path)
    if not found.shapes:
        others = f", {len(found.too_large)} above {largest:g} MB" if found.too_large else ""
        expected = f"expected files of {' '.join(READERS)}"
        raise IndicatorError(f"{folder}: no shapes, {expected}; got {found.foreign} of other kinds{others}")
    return found


def _files(folder: Path, without: Path) -> Iterator[Path]:
    for where, folders, files in os.walk(folder):
        inside = Path(where)
        folders[:] = sorted(f for f in folders if not f.startswith(".") and (inside / f).resolve() != without)
        yield from (p for p in (inside / f for f in sorted(files) if not f.startswith(".")) if p.is_file())


def shape_digest(path: Path) -> str:
    """SHA-256 of all bytes that a shape is read from: the file's, its extension, and those of files that a glTF or USD file refers to.

    Raises:
        OSError: If the file itself cannot be read.
    """
    parts = [path.suffix.lower(), file_digest(path)]
    for other in sorted(_referred(path)):
        parts.append(file_digest(other) if other.is_file() else "")
    return hashlib.sha256("|".join(parts).encode()).hexdigest()


def _referred(path: Path) -> set[Path]:
    """Files that a shape's file needs besides itself; none where it is too damaged to tell."""
    suffix = path.suffix.lower()
    if suffix == ".gltf":
        try:
            return referred_buffers(path)
        except (ValueError, AttributeError, TypeError):
            return set()
    if suffix in USD_SUFFIXES:
        try:
            from pxr import Tf, UsdUtils
        except ImportError:
            return set()  # the task says what is not installed
        try:
            layers, _, _ = UsdUtils.ComputeAllDependencies(str(path))
        except Tf.ErrorException:
            return set()
        return {Path(layer.realPath) for layer in layers if layer.realPath} - {path.resolve()}
    return set()
