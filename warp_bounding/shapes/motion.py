"""The shape of a triangle mesh that moves: keyframes, and vertices that go straight from one to the next.

At each time from the first to the last keyframe the object is that of a mesh at rest (``mesh.py``): every point within
the margin of a face, and what a flood from outside does not reach, then, through the faces of closed parts. Answers
hold for two meshes at once: that of the straight ways, and that of ``vertices_at``, which rounds it to float32. So a
point is undecided where these differ, and a box is empty only where no face comes within the margin and ``EVALUATION``
of it (``triangles/answers.py``).

A grid that is made of it has four coordinates, time first. A cell of time is cut at the keyframes, and between them
into pieces in which no vertex goes far. In a piece, every point of a triangle stays within the largest half way of its
three vertices of where it is in the piece's middle; so the triangle there, dilated by that and by the margin, holds all
that it is and comes near to in the piece, and its cells are found as for a mesh at rest (``triangles/cells.py``).
Nothing is sampled. Where the surface is closed, a flood from outside through the empty cells of a piece meets the
surface at no time in it, so what it does not reach holds the inside.

Before its first and after its last keyframe nothing is known of the motion: the shape has no points there, and
bounders say *maybe*. So the cells of time lie between these two, however time is divided. They rarely meet both
exactly: ``time_axis`` chooses cells that leave little out.
"""

import hashlib
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from warp_bounding.errors import ShapeError
from warp_bounding.shapes.formula import time_axis
from warp_bounding.shapes.grid import Grid, grid_over
from warp_bounding.shapes.mesh import LANDMARK, Faces, check_faces, checked_vertices
from warp_bounding.shapes.shape import (
    OUT,
    HalfSpaces,
    cells_around,
    cells_per_unit,
    checked_margin,
    checked_resolution,
)
from warp_bounding.shapes.surfaces import Surface, paths_of, surface_of

if TYPE_CHECKING:
    from warp_bounding.shapes.triangles.solid import DilatedMovingSolid, MovingSolid

DEFAULT_RESOLUTION = 32  # cells along the longest axis of space
DEFAULT_TIMES, MAX_TIMES = 32, 1024  # cells of time
# In cells: half of the longest way of a vertex within a piece. No vertex goes farther than the grid's diagonal, at most
# sqrt(3) 1024 cells, so there are at most 3,600 pieces between two *knots*: keyframes, and ends of a cell of time.
WAY = 0.25
# Of the largest coordinate: rounding to float32 (``vertices_at``) moves each coordinate of a vertex by half of this at
# most, and the vertex by sqrt(3) as much: 7/8 of this. The rest outweighs all that float64 rounds.
EVALUATION = 2.0**-23

MOST_LANDMARKS = 2**16  # corners at keyframes; of more only every second, or third, is one


@dataclass(frozen=True, eq=False)
class MovingMesh(Faces):
    """A moving triangle mesh in object space, and at each time all points within a margin of it.

    Attributes:
        frames: ``(K, V, 3)`` float32, read-only, object units: the vertices at each keyframe; at least two.
        faces: ``(F, 3)`` int32, read-only, indices of vertices.
        times: ``(K,)`` float32, read-only, ascending, in the unit of time; 0 to 1 in equal steps if ``None``.
        time_cells: Cells that ``to_grid`` divides the range of time into; up to 4 more where they fit it better.
        name: What it was made from, for messages and files.
        note: A restriction that a user should know.
        margin: By how much the mesh is dilated in space, at each time; object units.

    Raises:
        ShapeError: For what is no mesh, fewer than two keyframes, times that do not ascend, or an impossible
            margin.

    Example:
        >>> motion = wb.shapes.MovingMesh([mesh.vertices, mesh.vertices + 0.5], mesh.faces, times=[0.0, 2.0])
        >>> motion.ndim
        4
    """

    frames: np.ndarray
    faces: np.ndarray
    times: np.ndarray | None = None
    time_cells: int = DEFAULT_TIMES
    name: str = "motion"
    note: str = ""
    margin: float = 0.0

    time, ndim = True, 4

    def __post_init__(self) -> None:
        frames, faces = np.asarray(self.frames), np.asarray(self.faces)
        if frames.ndim != 3 or frames.shape[2] != 3 or len(frames) < 2 or frames.dtype.kind not in "iuf":
            got = f"{frames.dtype} of shape {frames.shape}"
            raise ShapeError(f"{self.name}: expected keyframes as numbers of shape (K, V, 3), K >= 2, got {got}")
        frames = checked_vertices(frames, self.name)
        check_faces(faces, frames.shape[1], self.name)
        times = np.linspace(0.0, 1.0, len(frames)) if self.times is None else np.asarray(self.times)
        times = np.array(times, dtype=np.float32).reshape(-1)
        if len(times) != len(frames) or not np.isfinite(times).all() or not (np.diff(times) > 0).all():
            raise ShapeError(f"{self.name}: expected {len(frames)} ascending times, one a keyframe, got {times}")
        cells = self.time_cells
        if isinstance(cells, bool) or not isinstance(cells, (int, np.integer)) or not 1 <= cells <= MAX_TIMES:
            raise ShapeError(f"{self.name}: time_cells must be an integer from 1 to {MAX_TIMES}, got {cells!r}")
        faces = np.array(faces, dtype=np.int32, order="C")
        for key, value in (("frames", frames), ("faces", faces), ("times", times)):
            value.setflags(write=False)
            object.__setattr__(self, key, value)
        object.__setattr__(self, "margin", checked_margin(self.margin))

    def __repr__(self) -> str:
        sides = " x ".join(f"{side:.4g}" for side in self.bounds[1] - self.bounds[0])
        counts = f"{len(self.frames)} keyframes of {self.frames.shape[1]:,} vertices, {len(self.faces):,} faces"
        times = f"times {self.times[0]:g} to {self.times[-1]:g} in {self.time_cells} cells"
        margin = f"margin {self.margin:g}" if self.margin else ""
        notes = filter(None, [margin, self.restriction, "closed" * self.watertight])
        return f"<MovingMesh {self.name}: 4D, {counts}, extent {sides}, {times}, {', '.join(notes)}>"

    @cached_property
    def bounds(self) -> np.ndarray:
        """``(2, 3)`` float64, lower and upper corner of the faces over all times, object units."""
        used = self.frames[:, self._used].reshape(-1, 3)
        return np.stack([used.min(axis=0), used.max(axis=0)]).astype(np.float64)

    def _corner(self, side: int) -> np.ndarray:
        return np.insert(super()._corner(side), 0, self.times[-side])  # ``(4,)``, the first time or the last one

    @cached_property
    def surface(self) -> Surface:
        """Which faces belong to parts that are closed at all times, whose inside is bounded too."""
        return surface_of(paths_of(self.frames), self.faces)

    @cached_property
    def geometry(self) -> str:
        """SHA-256 of the geometry; name, note and ``time_cells`` do not enter."""
        sha = hashlib.sha256(b"warp-bounding motion 1")
        sha.update(np.array([*self.frames.shape, len(self.faces)], dtype="<i8").tobytes())
        sha.update(self.times.astype("<f4").tobytes() + self.frames.astype("<f4").tobytes())
        sha.update(self.faces.astype("<i4").tobytes())
        return sha.hexdigest()

    @property
    def _rounding(self) -> float:
        return EVALUATION * float(np.abs(self.bounds).max())

    @cached_property
    def _solid(self) -> "MovingSolid":
        from warp_bounding.shapes.triangles.solid import MovingSolid

        return MovingSolid(self.times, self.frames, self.faces, self.surface.closed, self._rounding)

    @cached_property
    def _dilated_solid(self) -> "DilatedMovingSolid":
        from warp_bounding.shapes.triangles.solid import DilatedMovingSolid

        return DilatedMovingSolid(self._solid, self.lower, self.upper, self.margin, self.speed)

    def half_spaces(self, lower: np.ndarray, upper: np.ndarray) -> HalfSpaces:
        return self._dilated_solid.half_spaces(lower, upper)

    @cached_property
    def speed(self) -> float:
        used = self.frames[:, self._used].astype(np.float64)
        ways = np.linalg.norm(np.diff(used, axis=0), axis=2).max(axis=1)
        return float((ways / np.diff(self.times.astype(np.float64))).max() * (1 + 1e-12)) + float(np.finfo(float).tiny)

    @property
    def knots(self) -> np.ndarray:
        return self.times.astype(np.float64)

    def points(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """``(count, 4)`` float64: points of faces at random times; of a dilated motion up to the margin from them.

        They are uniform by the faces' area at the keyframe before.
        """
        times, frames, faces = self.times.astype(np.float64), self.frames, self.faces
        time = np.sort(rng.uniform(times[0], times[-1], count))
        edges = np.searchsorted(time, times[1:-1])
        found = []
        for k, part in enumerate(np.split(time, edges)):
            first, last = (f[faces].astype(np.float64) for f in (frames[k], frames[k + 1]))
            area = np.linalg.norm(np.cross(first[:, 1] - first[:, 0], first[:, 2] - first[:, 0]), axis=1)
            area = area if area.any() else np.ones(len(faces))
            face = rng.choice(len(faces), len(part), p=area / area.sum())
            share = ((part - times[k]) / (times[k + 1] - times[k]))[:, None, None]
            corners = (1 - share) * first[face] + share * last[face]
            found.append(np.einsum("nk,nkx->nx", rng.dirichlet(np.ones(3), len(part)), corners))
        away = rng.normal(size=(count, 3))
        away *= self.margin * rng.random((count, 1)) / np.linalg.norm(away, axis=1, keepdims=True)
        return rng.permutation(np.column_stack([time, np.concatenate(found) + away]))

    def landmarks(self) -> np.ndarray:
        """``(P, 4)`` float64: vertices of faces at keyframes; of a dilated motion, points above and below them."""
        used, found = self._used, []
        stride = max(1, len(self.frames) * len(used) // MOST_LANDMARKS)
        for number, (time, frame) in enumerate(zip(self.times, self.frames, strict=True)):
            some, vertices = used[number % stride :: stride], frame.astype(np.float64)
            away = self.margin * _normals(vertices, self.faces)[some] if self.margin else np.zeros(3)
            for way in (away, -away) if self.margin else (away,):
                found.append(np.insert(vertices[some] + way, 0, time, axis=1))
        points = np.concatenate(found)
        if not self.margin:
            return points
        nearer = self._with_margin(LANDMARK * self.margin)
        return points[nearer.decide(points) == OUT]

    def vertices_at(self, time: float) -> np.ndarray:
        """The vertices at a time, as a simulation should use them: ``to_grid`` bounds these very numbers.

        Args:
            time: In the unit of ``times``; outside their range the nearest keyframe is returned, of which bounders
                promise nothing: they answer with *maybe* there.

        Returns:
            ``(V, 3)`` float32.

        Example:
            >>> motion.vertices_at(1.0)[0]
            array([0.25, 0.25, 0.25], dtype=float32)
        """
        return self._exactly_at(float(np.float32(time))).astype(np.float32)

    def to_grid(self, *, resolution: int | None = None, margin: float = 0.0) -> Grid:
        """Divide the dilated motion into cells of time and space, conservatively.

        A closed cell is occupied if at any of its times the surface, the inside (of a closed surface) or their margin,
        with vertices as ``vertices_at`` rounds them, meets it. One empty cell lies around the object on every side in
        space, and no cell reaches beyond the first or the last keyframe in time.

        Args:
            resolution: Cells along the longest axis of the dilated object, over all times, 2 to 1024; 32 by default.
            margin: Object units, at least 0. The motion's own, if it has one.

        Returns:
            The grid, time first, the same on every machine.

        Raises:
            ShapeError: For an impossible resolution or margin, or a mesh or times too far from the origin.

        Example:
            >>> motion.to_grid(resolution=8).time
            True
        """
        resolution = DEFAULT_RESOLUTION if resolution is None else resolution
        resolution, margin = checked_resolution(resolution), self._margin_of_cells(margin)
        rounding = self._rounding
        extent = float((self.bounds[1] - self.bounds[0]).max()) + 2 * margin
        scale = cells_per_unit(extent, resolution, self.name)
        reach = (margin + rounding) * scale
        first, last = cells_around(*(self.bounds * scale), reach + 2 * WAY, self.name)
        shape = tuple((last - first + 1).tolist())
        rate, begin, count = time_axis(float(self.times[0]), float(self.times[-1]), self.time_cells, self.name)
        cells = [
            self._cells((begin + i) / rate, (begin + i + 1) / rate, scale, first, shape, reach) for i in range(count)
        ]
        scales, offset = np.array([rate, scale, scale, scale]), np.array([begin + 0.5, *first.astype(np.float64)])
        return grid_over(self, np.stack(cells), scales, offset, margin, resolution)

    def _exactly_at(self, time: float) -> np.ndarray:
        """``(V, 3)`` float64."""
        k = int(np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, len(self.times) - 2))
        low, high = float(self.times[k]), float(self.times[k + 1])
        share = min(max((time - low) / (high - low), 0.0), 1.0)
        return (1.0 - share) * self.frames[k].astype(np.float64) + share * self.frames[k + 1].astype(np.float64)

    def _cells(
        self, start: float, end: float, scale: float, first: np.ndarray, shape: tuple[int, int, int], reach: float
    ) -> np.ndarray:
        """The cells of space that are occupied at some time from ``start`` to ``end``."""
        from warp_bounding.shapes.triangles.cells import SLACK, solid_cells

        used, faces = np.unique(self.faces, return_inverse=True)
        faces = faces.reshape(-1, 3)
        keys = self.times.astype(np.float64)  # first: NumPy would round the numbers that float32 is compared with
        keys = keys[(keys > start) & (keys < end)]
        occupancy = np.zeros(shape, dtype=bool)
        knots = np.unique(np.concatenate([[start], keys, [end]]))
        for low, high in pairwise(knots):
            ends = [self._exactly_at(t)[used] * scale - first for t in (low, high)]
            way = np.linalg.norm(ends[1] - ends[0], axis=1)
            pieces = max(int(np.ceil(way.max() / (2 * WAY))), 1)
            dilation = reach + (way[faces].max(axis=1) / (2 * pieces)) * (1 + 1e-9) + SLACK
            for piece in range(pieces):
                share = (piece + 0.5) / pieces
                middle = (1 - share) * ends[0] + share * ends[1]
                occupancy |= solid_cells(middle, faces, self.surface.closed, shape, dilation)
        return occupancy


def _normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """``(V, 3)``, directions of length 1, or 0: sums of the normals of faces, weighted by their areas."""
    corner, *others = vertices[faces].transpose(1, 0, 2)
    normals = np.cross(others[0] - corner, others[1] - corner)
    sums = np.stack(
        [np.bincount(faces.T.ravel(), np.tile(normal, 3), minlength=len(vertices)) for normal in normals.T], axis=1
    )
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    return sums / np.where(lengths > 0, lengths, 1.0)
