"""Meshes that trimesh reads: a scene becomes one mesh, every part in its place."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warp_bounding.errors import IndicatorError
from warp_bounding.indicators.formats.reading import import_optional, reading
from warp_bounding.indicators.mesh import IndicatorMesh, check_faces

if TYPE_CHECKING:
    import trimesh

__all__ = ["MESH_SUFFIXES", "mesh_from_trimesh", "read_mesh"]

MESH_SUFFIXES = (".obj", ".ply", ".stl", ".glb", ".gltf", ".off")


def read_mesh(path: Path) -> IndicatorMesh:
    """Read a mesh file with trimesh, all its meshes in their places.

    Args:
        path: An existing file with a suffix of ``MESH_SUFFIXES``.

    Raises:
        IndicatorError: Where trimesh is missing, the file is damaged or there is no mesh in it.
    """
    trimesh = import_optional("trimesh", "trimesh", path)
    # process=False: trimesh's clean-up would drop vertices that are NaN, and with them the evidence of a damaged file.
    options = {"skip_materials": True} if path.suffix.lower() == ".obj" else {}
    with reading(path, f"a {path.suffix.lower()} mesh"):
        return mesh_from_trimesh(trimesh.load_scene(str(path), process=False, **options), name=path.name)


def mesh_from_trimesh(source: "trimesh.Trimesh | trimesh.Scene", *, name: str) -> IndicatorMesh:
    """One mesh of all the meshes of a scene, their transforms applied.

    Args:
        source: A mesh or a scene.
        name: For messages.

    Raises:
        IndicatorError: For a scene without a mesh, or whatever ``IndicatorMesh`` refuses.
    """
    import trimesh

    with reading(name, "a scene of meshes"):
        parts = [source] if isinstance(source, trimesh.Trimesh) else source.dump()
    meshes = [part for part in parts if isinstance(part, trimesh.Trimesh) and len(part.faces)]
    others = sorted({type(part).__name__ for part in parts if not isinstance(part, trimesh.Trimesh)})
    if not meshes:
        raise IndicatorError(f"{name}: expected a mesh with faces, got {', '.join(others) or 'none'}")
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
    for mesh in meshes:  # before the parts are joined: an index out of range would then point into another part
        check_faces(np.asarray(mesh.faces), len(mesh.vertices), name)
    return IndicatorMesh(
        vertices=np.concatenate([mesh.vertices for mesh in meshes]),
        faces=np.concatenate([np.asarray(mesh.faces) + start for mesh, start in zip(meshes, starts, strict=False)]),
        name=name,
        note=f"not read, as they are not meshes: {', '.join(others)}" if others else "",
    )
