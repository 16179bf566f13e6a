"""Solids of triangles at rest or moving, and their answers with a margin; built when first needed.

A mesh and its dilated copies share one solid: the margin is told with each question.
"""

from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import warp as wp

from warp_bounding.shapes.box_distances import Asked
from warp_bounding.shapes.shape import IN, HalfSpaces
from warp_bounding.shapes.surfaces import cycles_of, paths_of
from warp_bounding.shapes.triangles.answers import (
    AT_REST,
    MOVING,
    Motion,
    decide_boxes,
    decide_planes,
    decide_segments,
    decide_then,
)
from warp_bounding.shapes.triangles.cells import MeshArrays, SidesGrid, build_sides
from warp_bounding.shapes.triangles.distances import (
    Corners,
    CornersThen,
    find_distances,
    find_distances_then,
    find_overestimates,
    find_overestimates_then,
)
from warp_bounding.shapes.triangles.half_spaces import find_half_spaces
from warp_bounding.shapes.triangles.hierarchy import MovingTriangles, Triangles, build
from warp_bounding.shapes.triangles.moving import MovingSides


class Dilated(Asked):
    """A solid and its margin, as the struct that the kernels take; answers as ``Shape`` does."""

    kernels: ClassVar[tuple[wp.Kernel, ...]]  # for ``empty``, ``inside`` and ``distances``

    def empty(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        return self._answer(self.kernels[0], lower, upper).view(bool)

    def inside(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        return self._answer(self.kernels[1], lower, upper).view(bool)

    def distances(self, x: np.ndarray) -> np.ndarray:
        return self._answer(self.kernels[2], x, dtype=wp.vec2d)


class Hierarchies:
    """The hierarchies of faces ``(F, 3)``, of which ``kept`` ``(F,)`` bool are those of closed parts.

    Vertices are at ``paths``, ``(V, 3)`` or more numbers.
    """

    def __init__(self, paths: np.ndarray, faces: np.ndarray, kept: np.ndarray):
        self._paths, self.faces, self.kept = paths, faces, kept

    def built(self, faces: np.ndarray, cycles: np.ndarray | None = None) -> Any:
        """The hierarchy of some faces."""
        raise TypeError(f"{type(self).__name__} does not define built")

    @cached_property
    def all(self) -> Any:
        """Of all faces."""
        return self.closed if self.kept.all() else self.built(self.faces)

    @cached_property
    def closed(self) -> Any:
        """Of closed parts' faces."""
        return self.built(self.faces[self.kept], cycles_of(self._paths, self.faces, self.kept)[self.kept])


class Solid(Hierarchies):
    """Triangles and the side of each point, without a margin.

    Of closed faces it is known whether they are turned ``alike``, and whether their hollows are ``empty``, outside.
    """

    def __init__(
        self, vertices: np.ndarray, faces: np.ndarray, kept: np.ndarray, alike: bool = False, empty: bool = False
    ):
        super().__init__(vertices, faces, kept)
        self.vertices, self.alike, self.empty = vertices, alike, empty

    def built(self, faces: np.ndarray, cycles: np.ndarray | None = None) -> Triangles:
        return build(self.vertices[faces], cycles)

    @cached_property
    def _grid(self) -> SidesGrid:
        return build_sides(self.vertices, self.faces[self.kept], self.closed, self.alike, self.empty)

    @property
    def hollows(self) -> int:
        """Parts of space, wider than a cell of ``triangles/cells.py``, without a way out or a surface around them."""
        return self._grid.hollows

    @property
    def both(self) -> bool:
        """Whether faces go around some points, wider than such a cell, one way, and around others the other."""
        return self._grid.both

    def depth(self, x: np.ndarray, lower: np.ndarray, upper: np.ndarray, margin: float) -> np.ndarray:
        """Approximate depth of points in the object dilated by a margin; ``lower``, ``upper`` are without it."""
        faces = Solid(self.vertices, self.faces, np.zeros(len(self.faces), dtype=bool))
        away = faces.dilated(lower, upper, 0.0).distances(x)[:, 0]
        enclosed = self.dilated(lower, upper, 0.0).decide(x) == IN
        return (np.where(enclosed, away, -away) + margin).clip(0.0)

    def dilated(self, lower: np.ndarray, upper: np.ndarray, margin: float) -> "DilatedSolid":
        """The object dilated by a margin; ``lower`` and ``upper`` are the corners of a box that holds it."""
        mesh = MeshArrays()
        mesh.lower, mesh.upper, mesh.margin = wp.vec3d(*lower), wp.vec3d(*upper), wp.float64(margin)
        mesh.faces, mesh.closed, mesh.sides = self.all, self.closed, self._grid.sides
        return DilatedSolid([mesh])


class DilatedSolid(Dilated):
    """A solid and its margin."""

    point, corners, overestimates = wp.vec3d, Corners, find_overestimates
    kernels = (*AT_REST, find_distances)

    def decide(self, x: np.ndarray) -> np.ndarray:
        return self.decide_boxes(x, x)

    def decide_boxes(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        return self._answer(decide_boxes, lower, upper)

    def decide_segments(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        return self._answer(decide_segments, start, end)

    def decide_planes(self, normal: np.ndarray, point: np.ndarray) -> np.ndarray:
        return self._answer(decide_planes, normal, point)


class MovingSolid(Hierarchies):
    """Triangles that move, and the side of each point, without a margin.

    Vertices may be elsewhere by ``rounding``, more than what float64 makes of an interpolation.
    """

    def __init__(self, times: np.ndarray, frames: np.ndarray, faces: np.ndarray, kept: np.ndarray, rounding: float):
        super().__init__(paths_of(frames), faces, kept)
        self.times, self.frames, self.rounding = times.astype(np.float64), frames, rounding

    def built(self, faces: np.ndarray, cycles: np.ndarray | None = None) -> MovingTriangles:
        return MovingTriangles(self.times, self.frames, faces, cycles)

    @cached_property
    def sides(self) -> MovingSides:
        """The grids of closed parts."""
        return MovingSides(self.closed, self.frames, self.faces[self.kept], self.rounding)


class DilatedMovingSolid(Dilated):
    """A solid that moves, in a box ``(4,)`` with time first, its margin, and the speed of its fastest point at most."""

    point, corners, overestimates = wp.vec4d, CornersThen, find_overestimates_then
    kernels = (*MOVING, find_distances_then)

    def __init__(self, solid: MovingSolid, lower: np.ndarray, upper: np.ndarray, margin: float, speed: float):
        self._solid = solid
        motion = Motion()
        motion.lower, motion.upper = wp.vec4d(*lower), wp.vec4d(*upper)
        motion.rounding = wp.float64(solid.rounding)
        motion.reach = wp.float64(np.nextafter(margin + solid.rounding, np.inf))
        motion.hold = wp.float64(np.nextafter(margin - solid.rounding, -np.inf))
        motion.speed = wp.float64(speed)
        motion.faces, motion.closed, motion.pieces = solid.all.ways, solid.closed.ways, solid.sides.pieces
        super().__init__([motion])

    def decide(self, x: np.ndarray) -> np.ndarray:
        return self._answer(decide_then, x)

    def half_spaces(self, lower: np.ndarray, upper: np.ndarray) -> HalfSpaces:
        rows = [np.ascontiguousarray(side, dtype=np.float64) for side in (lower, upper)]
        found = HalfSpaces.blank(*rows)
        if len(lower):
            self._launch(find_half_spaces, rows, found.arrays())
        return found

    def _know(self, lower: np.ndarray, upper: np.ndarray) -> None:
        """Make the boxes of keyframes and the grids for the times of queries."""
        times = self._solid.times
        spans = np.stack([lower[:, 0], upper[:, 0]], axis=1)
        spans = np.clip(spans[spans[:, 0] <= spans[:, 1]], times[0], times[-1])
        key = np.clip(np.searchsorted(times, spans, side="right") - 1, 0, len(times) - 2)
        places = key + (spans - times[key]) / (times[key + 1] - times[key])
        begun, ended = np.bincount(key[:, 0], minlength=len(times)), np.bincount(key[:, 1] + 2, minlength=len(times))
        keys = np.flatnonzero(np.cumsum(begun - ended[: len(times)]) > 0)
        for triangles in (self._solid.all, self._solid.closed):
            triangles.know(keys)
        self._solid.sides.know(places)
