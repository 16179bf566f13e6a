"""Meshes of a USD stage, read with usd-core: all ``Mesh`` prims in world space, polygons cut into fans of triangles.

What this does not do: subdivision surfaces are read as their control cage, skinning is not applied, an animation is
read at its first time code, and shapes that are not meshes (spheres, curves) are left out; the indicator's note says
which. Point instancers are refused: their prototypes would be read in the wrong place.
"""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warp_bounding.errors import IndicatorError
from warp_bounding.indicators.formats.reading import LONGEST_REASON, import_optional, reading
from warp_bounding.indicators.mesh import IndicatorMesh

if TYPE_CHECKING:
    from pxr import Usd, UsdGeom

__all__ = ["USD_SUFFIXES", "read_usd"]

USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")


def read_usd(path: Path) -> IndicatorMesh:
    """Read all meshes of a USD stage.

    Args:
        path: An existing ``.usd``, ``.usda``, ``.usdc`` or ``.usdz`` file.

    Returns:
        One mesh, in the coordinates of the stage's world.

    Raises:
        IndicatorError: Where usd-core is missing, the file is damaged or refers to missing ones, there is no mesh in
            it, or a mesh is not one.
    """
    usd = import_optional("pxr.Usd", "usd-core", path)
    tf = import_optional("pxr.Tf", "usd-core", path)
    geom = import_optional("pxr.UsdGeom", "usd-core", path)
    utilities = import_optional("pxr.UsdUtils", "usd-core", path)
    _silence = utilities.CoalescingDiagnosticDelegate()  # while it lives, USD's warnings stay off standard error
    with reading(path, "a USD stage"):
        try:
            stage = usd.Stage.Open(str(path))
        except tf.ErrorException as error:
            raise ValueError(error.args[0].commentary) from error  # without the places in USD's own source
        problems = stage.GetCompositionErrors()
        if problems:
            first = " ".join(str(problems[0]).split())[:LONGEST_REASON]
            raise IndicatorError(f"{path}: expected a complete USD stage, got {first}")
        time = usd.TimeCode.EarliestTime()
        placement = geom.XformCache(time)
        parts, others, moving, count = [], set(), False, 0
        for prim in stage.Traverse(usd.TraverseInstanceProxies()):
            if prim.IsA(geom.PointInstancer):
                raise IndicatorError(f"{path}: expected meshes, got a point instancer at {prim.GetPath()}")
            moving |= prim.IsA(geom.Xformable) and geom.Xformable(prim).TransformMightBeTimeVarying()
            if prim.IsA(geom.Mesh):
                mesh = geom.Mesh(prim)
                moving |= mesh.GetPointsAttr().ValueMightBeTimeVarying()
                matrix = np.array(placement.GetLocalToWorldTransform(prim), dtype=np.float64)
                vertices, faces = _mesh(mesh, matrix, time, f"{path}: {prim.GetPath()}")
                parts.append((vertices, faces + count))
                count += len(vertices)
            elif prim.IsA(geom.Gprim) or prim.GetTypeName() == "SkelRoot":
                others.add(str(prim.GetTypeName()))
    if not parts:
        raise IndicatorError(f"{path}: expected a USD stage with meshes, got {', '.join(sorted(others)) or 'none'}")
    notes = [f"not read, as they are not meshes: {', '.join(sorted(others))}"] if others else []
    notes += ["animated: only its first pose is bounded"] if moving else []
    vertices, faces = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return IndicatorMesh(vertices, faces, name=path.name, note="; ".join(notes))


def _mesh(mesh: "UsdGeom.Mesh", matrix: np.ndarray, time: "Usd.TimeCode", name: str) -> tuple[np.ndarray, np.ndarray]:
    """``(V, 3)`` float64 vertices in the world and ``(F, 3)`` faces, counter-clockwise seen from outside.

    ``matrix`` is ``(4, 4)`` and acts on row vectors.
    """
    points, counts, indices = (
        np.asarray(attribute.Get(time) if attribute.HasValue() else [])
        for attribute in (mesh.GetPointsAttr(), mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr())
    )
    points = points.reshape(-1, 3).astype(np.float64)
    counts, indices = counts.astype(np.int64), indices.astype(np.int64)
    if counts.size and counts.min() < 3:
        raise IndicatorError(f"{name}: expected polygons of at least 3 vertices, got {counts.min()}")
    if counts.sum() != indices.size:
        raise IndicatorError(f"{name}: expected {counts.sum()} indices for {counts.size} polygons, got {indices.size}")
    if indices.size and (indices.min() < 0 or indices.max() >= len(points)):
        wrong = indices.min() if indices.min() < 0 else indices.max()
        raise IndicatorError(f"{name}: expected faces of vertices 0 to {len(points) - 1}, got vertex {wrong}")
    faces = _fans(counts, indices)
    left_handed = mesh.GetOrientationAttr().Get(time) == "leftHanded"
    if left_handed != (np.linalg.det(matrix[:3, :3]) < 0):
        faces = faces[:, ::-1]
    return points @ matrix[:3, :3] + matrix[3, :3], faces


def _fans(counts: np.ndarray, indices: np.ndarray) -> np.ndarray:
    """Triangles (0, i, i + 1) of every polygon."""
    triangles = counts - 2
    first = np.repeat(np.cumsum(counts) - counts, triangles)
    second = first + np.arange(triangles.sum()) - np.repeat(np.cumsum(triangles) - triangles, triangles) + 1
    return np.stack([indices[first], indices[second], indices[second + 1]], axis=1)
