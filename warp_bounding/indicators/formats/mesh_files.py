"""Mesh files, each by the reader of its format: whatever a file holds is read, noted, or the file is refused."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from warp_bounding.errors import IndicatorError
from warp_bounding.indicators.formats.collada import read_collada
from warp_bounding.indicators.formats.gltf import read_gltf
from warp_bounding.indicators.formats.mesh_data import MeshData
from warp_bounding.indicators.formats.obj import read_obj
from warp_bounding.indicators.formats.off import read_off
from warp_bounding.indicators.formats.ply import read_ply
from warp_bounding.indicators.formats.reading import reading
from warp_bounding.indicators.formats.stl import read_stl
from warp_bounding.indicators.mesh import IndicatorMesh, mesh_of
from warp_bounding.indicators.recentred import Recentred

__all__ = ["MESH_READERS", "read_mesh", "read_mesh_data"]

MESH_READERS: dict[str, Callable[[Path], MeshData]] = {
    ".obj": read_obj,
    ".ply": read_ply,
    ".stl": read_stl,
    ".glb": read_gltf,
    ".gltf": read_gltf,
    ".off": read_off,
    ".dae": read_collada,
}


def read_mesh_data(path: Path) -> MeshData:
    """Read the vertices and faces of a mesh file.

    Args:
        path: An existing file.

    Raises:
        IndicatorError: In one line, for a file of another kind, one that is damaged, and one that holds what is not read.
    """
    suffix = path.suffix.lower()
    if suffix not in MESH_READERS:
        raise IndicatorError(
            f"{path}: expected a mesh file of {' '.join(MESH_READERS)}, got {suffix or 'no extension'!r}"
        )
    with reading(path, f"a {suffix} mesh"), np.errstate(all="ignore"):  # vertices that are not finite are refused
        return MESH_READERS[suffix](path)


def read_mesh(path: Path) -> IndicatorMesh | Recentred:
    """Read a mesh file, as ``read_mesh_data`` does (``mesh_of``); raises ``IndicatorError`` as well for what ``IndicatorMesh`` refuses."""
    vertices, faces, notes = read_mesh_data(path)
    return mesh_of(vertices, faces, name=path.name, note="; ".join(notes))
