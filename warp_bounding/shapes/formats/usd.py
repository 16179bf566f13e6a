"""Shapes of a USD stage, with usd-core: meshes, cubes and planes in world space, polygons cut into fans.

Coordinates are the stage's own, in its units. An animation is read at its first time code, and skins and blend shapes
in the pose that they have then; of a subdivision surface the control cage is read. Notes say so, and name whatever else
a viewer may not show, or show otherwise. Shapes with a surface that are not read (spheres, patches, instancers of
points) are refused.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_bounding.errors import ShapeError
from warp_bounding.shapes.formats.reading import LONGEST_REASON, import_optional, joined, reading, triangulated
from warp_bounding.shapes.mesh import Mesh, mesh_of
from warp_bounding.shapes.recentred import Recentred

if TYPE_CHECKING:
    from pxr import Usd

__all__ = ["USD_SUFFIXES", "read_usd"]

USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)  # of a cube
SIDES = np.array([0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3])
MOST_NAMES = 3  # of prims, in a note


def read_usd(path: Path) -> Mesh | Recentred:
    """Read all shapes of a USD stage as one mesh, in world coordinates; ``ShapeError`` for what is not read."""
    usd = import_optional("pxr.Usd", "usd-core", path)
    tf = import_optional("pxr.Tf", "usd-core", path)
    utilities = import_optional("pxr.UsdUtils", "usd-core", path)
    _silence = utilities.CoalescingDiagnosticDelegate()  # while it lives, USD's warnings stay off standard error
    with reading(path, "a USD stage"), np.errstate(all="ignore"):  # vertices that are not finite are refused
        try:
            stage = usd.Stage.Open(str(path))
        except tf.ErrorException as error:
            raise ValueError(error.args[0].commentary) from error  # without the places in USD's own source
        problems = stage.GetCompositionErrors()
        if problems:
            first = " ".join(str(problems[0]).split())[:LONGEST_REASON]
            raise ShapeError(f"{path}: expected a complete USD stage, got {first}")
        vertices, faces, notes = _Stage(stage, path).read()
    return mesh_of(vertices, faces, name=path.name, note="; ".join(notes))


class _Stage:
    """A stage, and prims that notes are to name."""

    def __init__(self, stage: "Usd.Stage", path: Path):
        from pxr import Usd, UsdGeom

        self.stage, self.path, self.geom, self.time = stage, path, UsdGeom, Usd.TimeCode.EarliestTime()
        self.proxies = Usd.TraverseInstanceProxies()
        self.told: dict[str, list[str]] = {}

    def note(self, text: str, prim: Any) -> None:
        """Name a prim, or another thing, behind a text."""
        self.told.setdefault(text, []).append(str(prim.GetPath() if hasattr(prim, "GetPath") else prim))

    def read(self) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
        """Vertices, faces and notes of all that is defined."""
        self._pose_skins()
        parts = list(self._parts())
        for prim in self.stage.TraverseAll():
            if not prim.IsActive():
                self.note("not read, as it is inactive", prim)
            elif not prim.IsDefined():
                self.note("not read, as nothing defines it", prim)
            if prim.HasVariantSets():
                sets = prim.GetVariantSets()
                chosen = ", ".join(f"{name}={sets.GetVariantSelection(name)}" for name in sets.GetNames())
                self.note("variants as they are selected", f"{prim.GetPath()} {chosen}")
        whole = self.stage.GetRootLayer()
        for layer in self.stage.GetUsedLayers(includeClipLayers=False):
            for key in ("metersPerUnit", "upAxis"):
                own, root = (one.pseudoRoot.GetInfo(key) for one in (layer, whole))
                if layer.pseudoRoot.HasInfo(key) and own != root:
                    self.note(f"not converted, as USD does not: another {key}", layer.GetDisplayName())
        notes = []
        for text, names in self.told.items():
            names = list(dict.fromkeys(names))
            more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
            notes.append(f"{text}: {', '.join(names[:MOST_NAMES])}{more}")
        if not parts:
            raise ShapeError(f"{self.path}: expected a USD stage with meshes, got {'; '.join(['none', *notes])}")
        return joined(parts, notes)

    def _pose_skins(self) -> None:
        """Put meshes with skins and blend shapes into their first pose, in a layer that is not stored."""
        from pxr import Gf, Usd, UsdSkel

        self.stage.SetEditTarget(self.stage.GetSessionLayer())
        for prim in list(self.stage.Traverse(self.proxies)):
            if not prim.IsA(UsdSkel.Root):
                continue
            below = list(Usd.PrimRange(prim, self.proxies))
            times = [a.GetTimeSamples()[0] for one in below for a in one.GetAttributes() if a.GetNumTimeSamples()]
            first = min(times, default=0.0)
            if prim.IsInstanceProxy() or any(one.IsInstance() for one in below):
                raise ShapeError(f"{self.path}: expected skins outside instances, got {prim.GetPath()}")
            if not UsdSkel.BakeSkinning(UsdSkel.Root(prim), Gf.Interval(first, first)):
                raise ShapeError(f"{self.path}: expected skins that can be posed, got {prim.GetPath()}")
            self.note("skinned: only the first pose is bounded", prim)

    def _parts(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Vertices in the world and faces of each shape."""
        geom, placement = self.geom, self.geom.XformCache(self.time)
        for prim in self.stage.Traverse(self.proxies):
            if prim.IsA(geom.Xformable) and geom.Xformable(prim).TransformMightBeTimeVarying():
                self.note("animated: only its first pose is bounded", prim)
            read = next(
                (
                    getattr(self, f"_{kind.lower()}")
                    for kind in ("Mesh", "Cube", "Plane")
                    if prim.IsA(getattr(geom, kind))
                ),
                None,
            )
            if read is not None:
                try:
                    vertices, faces = read(prim)
                except ValueError as error:
                    raise ShapeError(f"{self.path}: {prim.GetPath()}: {error}") from error
                matrix = np.array(placement.GetLocalToWorldTransform(prim), dtype=np.float64)
                left_handed = geom.Gprim(prim).GetOrientationAttr().Get(self.time) == "leftHanded"
                if left_handed != (np.linalg.det(matrix[:3, :3]) < 0):
                    faces = faces[:, ::-1]
                self._note_display(prim)
                yield vertices @ matrix[:3, :3] + matrix[3, :3], faces
            elif prim.IsA(geom.Points) or prim.IsA(geom.Curves):
                self.note("not read, as they have no surface", prim)
            elif prim.IsA(geom.Gprim) or prim.GetTypeName() in ("PointInstancer", "GenerativeProcedural"):
                what = "a point instancer" if prim.IsA(geom.PointInstancer) else f"a {prim.GetTypeName()}"
                raise ShapeError(f"{self.path}: expected meshes, cubes and planes, got {what} at {prim.GetPath()}")
            elif prim.GetTypeName() and prim.GetPrimTypeInfo().GetSchemaType().isUnknown:
                self.note("not read, as their type is not known", f"{prim.GetPath()} ({prim.GetTypeName()})")

    def _note_display(self, prim: "Usd.Prim") -> None:
        shown = self.geom.Imageable(prim)
        if shown.ComputeVisibility(self.time) == self.geom.Tokens.invisible:
            self.note("read, although it is invisible", prim)
        if shown.ComputePurpose() != self.geom.Tokens.default_:
            self.note(f"read, although of purpose {shown.ComputePurpose()}", prim)

    def _mesh(self, prim: "Usd.Prim") -> tuple[np.ndarray, np.ndarray]:
        """``(V, 3)`` float64 vertices in the mesh's own coordinates and ``(F, 3)`` faces."""
        mesh = self.geom.Mesh(prim)
        attributes = (mesh.GetPointsAttr(), mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr())
        if any(attribute.ValueMightBeTimeVarying() for attribute in attributes):
            self.note("animated: only its first pose is bounded", prim)
        if mesh.GetSubdivisionSchemeAttr().Get() != self.geom.Tokens.none:
            self.note("a subdivision surface: only its control cage is bounded", prim)
        if len(mesh.GetHoleIndicesAttr().Get(self.time) or ()):
            self.note("holes of a subdivision surface, read as faces", prim)
        points, counts, indices = (np.asarray(a.Get(self.time) if a.HasValue() else []) for a in attributes)
        points = points.reshape(-1, 3).astype(np.float64)
        return points, triangulated(points, counts.astype(np.int64), indices.astype(np.int64), fans=True)

    def _cube(self, prim: "Usd.Prim") -> tuple[np.ndarray, np.ndarray]:
        size = self._number(self.geom.Cube(prim).GetSizeAttr(), prim)
        return CORNERS * size / 2, triangulated(CORNERS, np.full(6, 4), SIDES)

    def _plane(self, prim: "Usd.Prim") -> tuple[np.ndarray, np.ndarray]:
        plane = self.geom.Plane(prim)
        wide, long = (self._number(a, prim) for a in (plane.GetWidthAttr(), plane.GetLengthAttr()))
        corners = np.array([[-wide, -long, 0], [wide, -long, 0], [wide, long, 0], [-wide, long, 0]]) / 2
        axis = str(plane.GetAxisAttr().Get(self.time))  # width lies along x, of a plane across x along z
        order = {"X": [2, 1, 0], "Y": [0, 2, 1], "Z": [0, 1, 2]}[axis]
        return corners[:, order], triangulated(corners, np.array([4]), np.arange(4))

    def _number(self, attribute: "Usd.Attribute", prim: "Usd.Prim") -> float:
        if attribute.ValueMightBeTimeVarying():
            self.note("animated: only its first pose is bounded", prim)
        return float(attribute.Get(self.time))
