"""The shape of a triangle mesh: its surface, and its inside where the surface is closed (``surfaces``).

The object is every point within the margin of a face, and every point that a flood from outside does not reach through
the faces of closed parts. So enclosed air counts as inside; with ``hollow="empty"`` points of winding number 0 count as
outside. The triangles themselves answer about points and boxes (``triangles/``), in float64 with error bounds;
``to_grid`` makes cells that hold the object, also conservatively (``triangles/cells.py``). All claims are about the
mesh with these float32 vertices: float64 vertices of a file are rounded once, when it is read.
"""

import copy
import hashlib
import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from warp_bounding.errors import ShapeError
from warp_bounding.shapes.grid import Grid, grid_over
from warp_bounding.shapes.recentred import Recentred, expect_near, recentred
from warp_bounding.shapes.shape import (
    HOLLOW,
    OUT,
    Shape,
    cells_around,
    cells_per_unit,
    check_memory,
    checked_margin,
    checked_resolution,
)
from warp_bounding.shapes.surfaces import Surface, surface_of, turns_of

if TYPE_CHECKING:
    from warp_bounding.shapes.triangles.solid import DilatedSolid, Solid

CELL_BYTES = 8  # bytes a cell, while cells are made: the number of its region (4) and a few truth values
LANDMARK = 0.9  # of the margin: landmarks nearer to a face than this are not on the border, and dropped


class Faces(Shape):
    """The base of static and moving meshes: faces with a margin, whose closed parts have an inside.

    A subclass has ``bounds``, of the faces without the margin; ``surface``; ``_solid``, without the margin; and
    ``_dilated_solid``, with it.
    """

    @property
    def restriction(self) -> str:
        return "; ".join(filter(None, [self.note, self.surface.note]))

    @property
    def watertight(self) -> bool:
        """Whether the surface is closed: no edge belongs to one face only. Equal vertices and equal faces count once.

        A mesh that trimesh calls watertight is closed, unless its faces close only with their own doubles and hold
        nothing. So are solids that touch in an edge or share a wall, and closed surfaces with faces that are doubled or
        have no area (``surfaces``). Vertices of a motion are equal if they are equal at all keyframes.
        """
        return self.surface.watertight

    @cached_property
    def lower(self) -> np.ndarray:
        return self._corner(0)

    @cached_property
    def upper(self) -> np.ndarray:
        return self._corner(1)

    @cached_property
    def _used(self) -> np.ndarray:
        """Indices of the vertices that faces use, ascending."""
        return np.unique(self.faces)

    def _corner(self, side: int) -> np.ndarray:
        """``(3,)`` float64, the lower (0) or upper (1) corner of a box that holds the faces and the margin."""
        corner, sign = self.bounds[side], 2 * side - 1
        return np.nextafter(corner + sign * self.margin, sign * np.inf) if self.margin else corner

    def decide(self, x: np.ndarray) -> np.ndarray:
        """``(N,)`` uint8 for points ``(N, n)``: ``OUT`` or ``IN`` for certain, else ``UNDECIDED``.

        A point is undecided if rounding may move it across the object's border, or if no proof was found that it is
        outside: in gaps much narrower than a cell of ``triangles/cells.py``. Outside a motion's time a point is
        ``OUT``.
        """
        return self._dilated_solid.decide(x)

    def empty(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        return self._dilated_solid.empty(lower, upper)

    def inside(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        return self._dilated_solid.inside(lower, upper)

    def distance(self, x: np.ndarray) -> np.ndarray:
        return self.distances(x)[:, 0]

    def distances(self, x: np.ndarray) -> np.ndarray:
        return self._dilated_solid.distances(x)

    def overestimate(
        self,
        lower: np.ndarray,
        upper: np.ndarray,
        values: np.ndarray,
        least: float,
        enough: np.ndarray | float = np.inf,
    ) -> np.ndarray:
        """See ``Shape``; a box of a motion must lie between two neighbouring ``knots``."""
        return self._dilated_solid.overestimate(lower, upper, values, least, enough)

    def dilated(self, margin: float):
        """The object and all points within ``margin`` of it at each time; shares what was built for the triangles."""
        margin = self._new_margin(margin)
        if margin is None:
            return self
        _ = self._solid  # before the copy, so that both have it
        return self._with_margin(margin)

    def _with_margin(self, margin: float):
        made = copy.copy(self)
        for key in ("lower", "upper", "_dilated_solid"):
            vars(made).pop(key, None)
        object.__setattr__(made, "margin", margin)
        return made

    def _margin_of_cells(self, margin: float) -> float:
        """The margin for the object's cells: its own if it has one, else the given one, checked."""
        margin = checked_margin(margin)
        if self.margin:
            self._new_margin(margin or self.margin)
        return self.margin or margin


def checked_vertices(vertices: np.ndarray, name: str) -> np.ndarray:
    """Vertices ``(..., 3)`` in float32, read-only.

    Raises ``ShapeError`` for numbers that float32 cannot hold, or only too coarsely.
    """
    expect_near(vertices.reshape(-1, 3), name)
    with np.errstate(over="ignore"):
        vertices = np.array(vertices, dtype=np.float32, order="C") + np.float32(0)  # + 0: no negative zeros
    if bad := int((~np.isfinite(vertices)).any(axis=-1).sum()):
        raise ShapeError(f"{name}: expected finite float32 vertices, got {bad} that are not")
    vertices.setflags(write=False)
    return vertices


@dataclass(frozen=True, eq=False)
class Mesh(Faces):
    """A triangle mesh in object space, and all points within a margin of it.

    Attributes:
        vertices: ``(V, 3)`` float32, read-only, object units.
        faces: ``(F, 3)`` int32, read-only, indices of vertices; faces without area are retained, and bounded.
        name: What it was read from, for messages.
        note: A restriction that a user should know, such as parts of a file that were not read.
        margin: By how much the mesh is dilated, object units.
        hollow: ``"filled"``: air that closed parts enclose is inside; ``"empty"``: it is outside.

    Raises:
        ShapeError: For what is no mesh, vertices that are not finite, faces of which none has an area, an impossible
            margin, or with ``hollow="empty"`` faces that are not consistently oriented.

    Example:
        >>> faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]
        >>> mesh = wb.shapes.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], faces)
        >>> mesh.watertight
        True
    """

    vertices: np.ndarray
    faces: np.ndarray
    name: str = "mesh"
    note: str = ""
    margin: float = 0.0
    hollow: str = "filled"

    def __post_init__(self) -> None:
        vertices, faces = np.asarray(self.vertices), np.asarray(self.faces)
        if vertices.ndim != 2 or vertices.shape[1] != 3 or vertices.dtype.kind not in "iuf":
            got = f"{vertices.dtype} of shape {vertices.shape}"
            raise ShapeError(f"{self.name}: expected vertices as numbers of shape (V, 3), got {got}")
        vertices = checked_vertices(vertices, self.name)
        check_faces(faces, len(vertices), self.name)
        faces = np.array(faces, dtype=np.int32, order="C")
        corner, *others = vertices.astype(np.float64)[faces].transpose(1, 0, 2)
        normals = np.cross(others[0] - corner, others[1] - corner)
        if not normals.any():
            raise ShapeError(f"{self.name}: expected a surface, got {len(faces)} faces without area")
        faces.setflags(write=False)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)
        object.__setattr__(self, "margin", checked_margin(self.margin))
        if self.hollow not in HOLLOW:
            raise ShapeError(f"{self.name}: hollow must be {' or '.join(map(repr, HOLLOW))}, got {self.hollow!r}")
        if self._empty and (edges := self._turns[0]):
            raise ShapeError(
                f"{self.name}: hollow='empty' needs faces that are turned alike, with all normals outwards; at "
                f"{edges:,} edges they are not (trimesh's fix_normals turns them)"
            )
        if self._empty and self._solid.both:
            raise ShapeError(
                f"{self.name}: hollow='empty' needs all normals outwards; of one part they are, and another, which is "
                "not within it, is inside out"
            )

    def __repr__(self) -> str:
        sides = " x ".join(f"{side:.4g}" for side in self.bounds[1] - self.bounds[0])
        counts = f"{len(self.vertices):,} vertices, {len(self.faces):,} faces"
        margin = f"margin {self.margin:g}" if self.margin else ""
        notes = filter(None, [margin, self.restriction, "closed" * self.watertight, self.remark])
        return f"<Mesh {self.name}: 3D, {counts}, extent {sides}, {', '.join(notes)}>"

    @property
    def ndim(self) -> int:
        return 3

    @cached_property
    def bounds(self) -> np.ndarray:
        """``(2, 3)`` float64, lower and upper corner of the faces, without a margin and without unused vertices."""
        used = self.vertices[self._used]
        return np.stack([used.min(axis=0), used.max(axis=0)]).astype(np.float64)

    @cached_property
    def surface(self) -> Surface:
        """Which faces belong to closed parts, whose inside is bounded too."""
        return surface_of(self.vertices, self.faces)

    @property
    def _empty(self) -> bool:
        return self.hollow == HOLLOW[1]

    @cached_property
    def _turns(self) -> tuple[int, bool]:
        """See ``turns_of``."""
        return turns_of(self.vertices, self.faces[self.surface.closed])

    @cached_property
    def remark(self) -> str:
        """How many hollows there are, and what they count as; a closed surface in one piece is not searched."""
        if not self.surface.closed.any() or self._turns[1]:
            return ""
        if self._turns[0]:
            return "what closed parts enclose is filled, faces that are turned alike would tell closed hollows from it"
        count = self._solid.hollows
        return f"{count:,} closed hollow{'s' * (count != 1)} {self.hollow}" if count else ""

    @cached_property
    def geometry(self) -> str:
        """SHA-256 of the geometry, vertices and faces; name, note and margin do not enter."""
        sha = hashlib.sha256(b"warp-bounding mesh 1")
        sha.update(np.array([len(self.vertices), len(self.faces)], dtype="<i8").tobytes())
        sha.update(self.vertices.astype("<f4").tobytes() + self.faces.astype("<i4").tobytes())
        sha.update(b"hollows empty" * self._empty)
        return sha.hexdigest()

    @cached_property
    def _solid(self) -> "Solid":
        from warp_bounding.shapes.triangles.solid import Solid

        alike = bool(self.surface.closed.any()) and (self._empty or not (self._turns[0] or self._turns[1]))
        return Solid(self.vertices, self.faces, self.surface.closed, alike, self._empty)

    @cached_property
    def _dilated_solid(self) -> "DilatedSolid":
        return self._solid.dilated(self.lower, self.upper, self.margin)

    def depth(self, x: np.ndarray) -> np.ndarray:
        return self._solid.depth(x, *self.bounds, self.margin)

    def decide_boxes(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """``OUT``, ``IN`` or ``UNDECIDED``, ``(N,)`` uint8: do closed boxes of corners ``(N, 3)`` meet the object?"""
        return self._dilated_solid.decide_boxes(lower, upper)

    def decide_segments(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Which closed segments meet the object: ``(N,)`` uint8, as for boxes, for their ends ``(N, 3)``."""
        return self._dilated_solid.decide_segments(start, end)

    def decide_planes(self, normal: np.ndarray, point: np.ndarray) -> np.ndarray:
        """As for boxes, ``(N,)`` uint8: do planes meet the object? Normals have any length; points are ``(N, 3)``."""
        return self._dilated_solid.decide_planes(normal, point)

    def points(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """``(count, 3)`` float64: points of faces, uniform by area; of a dilated mesh up to the margin from them."""
        corner, *others = self.vertices.astype(np.float64)[self.faces].transpose(1, 0, 2)
        edges = [other - corner for other in others]
        area = np.linalg.norm(np.cross(*edges), axis=1)
        face = rng.choice(len(area), count, p=area / area.sum())
        a, b = rng.random((2, count, 1))
        a, b = np.where(a + b > 1, 1 - a, a), np.where(a + b > 1, 1 - b, b)
        away = rng.normal(size=(count, 3))
        away *= self.margin * rng.random((count, 1)) / np.linalg.norm(away, axis=1, keepdims=True)
        return corner[face] + a * edges[0][face] + b * edges[1][face] + away

    def corners(self) -> np.ndarray:
        """``(P, 3)`` float64, the vertices of faces; see ``Shape``."""
        return self.vertices[self._used].astype(np.float64)

    def landmarks(self) -> np.ndarray:
        """``(P, 3)`` float64: the vertices of faces; of a dilated mesh, points above and below them at the margin."""
        used = self._used
        points = self.vertices[used].astype(np.float64)
        if not self.margin:
            return points
        corner, *others = self.vertices.astype(np.float64)[self.faces].transpose(1, 0, 2)
        normals, sums = np.cross(others[0] - corner, others[1] - corner), np.zeros(self.vertices.shape)
        for column in self.faces.T:
            np.add.at(sums, column, normals)
        lengths = np.linalg.norm(sums[used], axis=1, keepdims=True)
        away = self.margin * sums[used] / np.where(lengths > 0, lengths, 1.0)
        points = np.concatenate([points + away, points - away])
        nearer = self._solid.dilated(self.lower, self.upper, LANDMARK * self.margin)
        return points[nearer.decide(points) == OUT]

    def to_grid(self, *, resolution: int | None = None, margin: float = 0.0) -> Grid:
        """Divide the dilated mesh into cells, conservatively.

        Every closed cell that meets the surface, the inside (of its closed parts) or their margin is occupied. The
        cells are cubes; one empty cell lies around the dilated object on every side.

        Args:
            resolution: Cells along the longest axis of the dilated object, 2 to 1024; 64 by default.
            margin: Object units, at least 0: the (Euclidean) distance by which the object is dilated. The mesh's own,
                if it has one.

        Returns:
            The grid, in the mesh's own coordinates, the same on every machine.

        Raises:
            ShapeError: For an impossible resolution or margin, or a mesh too far away for its size.

        Example:
            >>> mesh.to_grid(resolution=8, margin=0.1).shape
            (11, 11, 11)
        """
        from warp_bounding.shapes.triangles.cells import solid_cells

        resolution, margin = checked_resolution(resolution), self._margin_of_cells(margin)
        extent = float((self.bounds[1] - self.bounds[0]).max()) + 2 * margin
        scale = cells_per_unit(extent, resolution, self.name)
        lower, upper = self.bounds * scale  # exact: 24 + 16 bits
        first, last = cells_around(lower, upper, margin * scale, self.name)
        used, faces = np.unique(self.faces, return_inverse=True)
        in_cells = self.vertices[used].astype(np.float64) * scale - first
        shape = tuple((last - first + 1).tolist())
        what = f"{self.name}: dividing it into {' x '.join(map(str, shape))} cells"
        check_memory(math.prod(shape) * CELL_BYTES, what, "give a coarser resolution")
        outside = self._solid.dilated(*self.bounds, 0.0)

        def air(cells: np.ndarray) -> np.ndarray:
            return outside.decide((cells + first) / scale) == OUT

        faces = faces.reshape(-1, 3)
        occupancy = solid_cells(
            in_cells, faces, self.surface.closed, shape, margin * scale, air if self._empty else None
        )
        offset = first.astype(np.float64)
        return grid_over(self, occupancy, np.full(3, scale), offset, margin, resolution)


def mesh_of(vertices: np.ndarray, faces: np.ndarray, **about: str) -> "Mesh | Recentred":
    """The mesh of vertices as read, also float64; ``Recentred`` where they lie too far from 0 for float32."""
    local, frame = recentred(np.asarray(vertices))
    mesh = Mesh(local, faces, **about)
    return mesh if frame is None else Recentred(mesh, frame)


def check_faces(faces: np.ndarray, vertices: int, name: str) -> None:
    """Raise ``ShapeError`` for faces that are not ``(F, 3)`` integers from 0 to ``vertices - 1``, F of at least 1."""
    if faces.size == 0:
        raise ShapeError(f"{name}: expected a mesh with faces, got none")
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
        got = f"{faces.dtype} of shape {faces.shape}"
        raise ShapeError(f"{name}: expected faces as integers of shape (F, 3), got {got}")
    lowest, highest = int(faces.min()), int(faces.max())
    if lowest < 0 or highest >= vertices:
        wrong = lowest if lowest < 0 else highest
        raise ShapeError(f"{name}: expected faces of vertices 0 to {vertices - 1}, got vertex {wrong}")
