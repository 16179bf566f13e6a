"""Meshes and cubes of a USD stage, with usd-core: in world space, polygons cut into fans.

Coordinates are the stage's own, in its units. An animation is read at its first time code; of a subdivision surface the
control cage is read; what is invisible is read, too. Shapes with a surface that are not read (spheres, planes, patches,
instancers of points) and skins are refused.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warp_bounding.shapes.formats.reading import LONGEST_REASON, import_optional, joined, placed, reading, triangulated
from warp_bounding.shapes.mesh import Mesh, mesh_of
from warp_bounding.shapes.recentred import Recentred

if TYPE_CHECKING:
    from pxr import Usd

USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)  # of a cube
SIDES = np.array([0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3])
ANIMATED = "animated: only its first pose is bounded"


def read_usd(path: Path) -> Mesh | Recentred:
    """Read all shapes of a USD stage as one mesh, in world coordinates; ``ShapeError`` for what is not read."""
    usd = import_optional("pxr.Usd", "usd-core", path)
    tf = import_optional("pxr.Tf", "usd-core", path)
    utilities = import_optional("pxr.UsdUtils", "usd-core", path)
    _silence = utilities.CoalescingDiagnosticDelegate()  # while it lives, USD's warnings stay off standard error
    notes: list[str] = []
    with reading(path, "a USD stage"), np.errstate(all="ignore"):  # vertices that are not finite are refused
        try:
            stage = usd.Stage.Open(str(path))
        except tf.ErrorException as error:
            raise ValueError(error.args[0].commentary) from error  # without the places in USD's own source
        if problems := stage.GetCompositionErrors():
            first = " ".join(str(problems[0]).split())[:LONGEST_REASON]
            raise ValueError(f"expected a complete USD stage, got {first}")
        vertices, faces, _ = joined(_parts(stage, notes))
    return mesh_of(vertices, faces, name=path.name, note="; ".join(dict.fromkeys(notes)))


def _parts(stage: "Usd.Stage", notes: list[str]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Vertices in the world and faces of each shape; adds to the notes."""
    from pxr import Usd, UsdGeom, UsdSkel

    time = Usd.TimeCode.EarliestTime()
    placement = UsdGeom.XformCache(time)
    for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
        if prim.IsA(UsdSkel.Root):
            raise ValueError(f"expected a mesh without a skin, which is not read, got {prim.GetPath()}")
        if prim.IsA(UsdGeom.Xformable) and UsdGeom.Xformable(prim).TransformMightBeTimeVarying():
            notes.append(ANIMATED)
        if prim.IsA(UsdGeom.Mesh):
            mesh = UsdGeom.Mesh(prim)
            values = mesh.GetPointsAttr(), mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr()
            if mesh.GetSubdivisionSchemeAttr().Get() != UsdGeom.Tokens.none:
                notes.append("a subdivision surface: only its control cage is bounded")
            points, counts, indices = (np.asarray(value.Get(time) if value.HasValue() else []) for value in values)
            vertices = points.reshape(-1, 3).astype(np.float64)
            faces = triangulated(counts.astype(np.int64), indices.astype(np.int64), len(vertices))
        elif prim.IsA(UsdGeom.Cube):
            values = (UsdGeom.Cube(prim).GetSizeAttr(),)
            vertices, faces = CORNERS * values[0].Get(time) / 2, triangulated(np.full(6, 4), SIDES, len(CORNERS))
        elif prim.IsA(UsdGeom.Points) or prim.IsA(UsdGeom.Curves):
            notes.append("not read, as they have no surface: points and curves")
            continue
        elif prim.IsA(UsdGeom.Gprim) or prim.GetTypeName() in ("PointInstancer", "GenerativeProcedural"):
            raise ValueError(f"expected meshes and cubes, got a {prim.GetTypeName()} at {prim.GetPath()}")
        else:
            if prim.GetTypeName() and prim.GetPrimTypeInfo().GetSchemaType().isUnknown:
                notes.append(f"not read, as its type is not known: a {prim.GetTypeName()}")
            continue
        if any(value.ValueMightBeTimeVarying() for value in values):
            notes.append(ANIMATED)
        if UsdGeom.Gprim(prim).GetOrientationAttr().Get(time) == UsdGeom.Tokens.leftHanded:
            faces = faces[:, ::-1]
        yield placed(vertices, faces, np.array(placement.GetLocalToWorldTransform(prim), dtype=np.float64).T)
