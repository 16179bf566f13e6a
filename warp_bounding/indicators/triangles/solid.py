"""The faces of a mesh, and the inside of its closed parts, as kernels ask for them; built when they are first needed.

A mesh and its dilated copies share one of these: the margin is told with each question.
"""

from functools import cached_property

import numpy as np
import warp as wp

from warp_bounding.indicators.shape import IN
from warp_bounding.indicators.triangles.answers import Mesh, decide_points, find_empty, find_inside
from warp_bounding.indicators.triangles.asked import AskedSolid
from warp_bounding.indicators.triangles.box import decide_boxes
from warp_bounding.indicators.triangles.cycles import cycles_of
from warp_bounding.indicators.triangles.distances import find_clearances
from warp_bounding.indicators.triangles.excess import Corners, find_excesses
from warp_bounding.indicators.triangles.hierarchy import Triangles, build
from warp_bounding.indicators.triangles.plane import decide_planes
from warp_bounding.indicators.triangles.points import find_distances
from warp_bounding.indicators.triangles.segment import decide_segments
from warp_bounding.indicators.triangles.sides import Sides, SidesGrid, build_sides
from warp_bounding.runtime.launch import launch_on_cores

__all__ = ["DilatedSolid", "Solid"]


class Solid:
    """Triangles and the side of each point, without a margin.

    Args:
        vertices: ``(V, 3)`` float32.
        faces: ``(F, 3)`` integers.
        closed: ``(F,)`` bool, the faces of closed parts.
        alike: Whether these are turned alike (``closed_parts.turns_of``).
        empty: Whether hollows are outside.
    """

    def __init__(
        self, vertices: np.ndarray, faces: np.ndarray, closed: np.ndarray, alike: bool = False, empty: bool = False
    ):
        self.vertices, self.faces, self.closed, self.alike, self.empty = vertices, faces, closed, alike, empty

    @cached_property
    def _all(self) -> Triangles:
        if self.closed.all():
            return self._closed
        return build(self.vertices[self.faces]).on("cpu")

    @cached_property
    def _closed(self) -> Triangles:
        cycles = cycles_of(self.vertices, self.faces, self.closed)
        return build(self.vertices[self.faces[self.closed]], cycles[self.closed]).on("cpu")

    @cached_property
    def _sides_grid(self) -> SidesGrid:
        return build_sides(self.vertices, self.faces[self.closed], self._closed, self.alike, self.empty)

    @cached_property
    def _sides(self) -> Sides:
        return self._sides_grid.on("cpu")

    @property
    def hollows(self) -> int:
        """Parts of space, wider than a cell of ``triangles/sides.py``, that nothing leads out of and no surface goes around."""
        return self._sides_grid.hollows

    @property
    def both(self) -> bool:
        """Whether faces go around some points, wider than such a cell, one way, and around others the other."""
        return self._sides_grid.both

    def depth(self, x: np.ndarray, lower: np.ndarray, upper: np.ndarray, margin: float) -> np.ndarray:
        """About how deep points lie in the object dilated by a margin; ``lower`` and ``upper`` as for ``dilated``, without the margin."""
        faces = Solid(self.vertices, self.faces, np.zeros(len(self.faces), dtype=bool))
        away = faces.dilated(lower, upper, 0.0).distances(x)[:, 0]
        enclosed = self.dilated(lower, upper, 0.0).decide(x) == IN
        return (np.where(enclosed, away, -away) + margin).clip(0.0)

    def dilated(self, lower: np.ndarray, upper: np.ndarray, margin: float) -> "DilatedSolid":
        """The object dilated by a margin; ``lower`` and ``upper`` are the corners of a box that holds it."""
        mesh = Mesh()
        mesh.lower, mesh.upper, mesh.margin = wp.vec3d(*lower), wp.vec3d(*upper), wp.float64(margin)
        mesh.faces, mesh.closed, mesh.sides = self._all, self._closed, self._sides
        return DilatedSolid(mesh)


class DilatedSolid(AskedSolid):
    """A solid and its margin."""

    point = wp.vec3d
    kernels = (decide_points, find_empty, find_inside)

    def clearance(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Lower bounds of the distance from closed boxes to the object; see ``Shape.clearance``."""
        return self._answer(find_clearances, lower, upper, dtype=wp.float64)

    def distances(self, x: np.ndarray) -> np.ndarray:
        """``(N, 2)`` float64, lower and upper bounds of the distance from points to the object; see ``Shape.distances``."""
        return self._answer(find_distances, x, dtype=wp.vec2d)

    def excess(
        self, lower: np.ndarray, upper: np.ndarray, values: np.ndarray, least: float, enough: np.ndarray | float
    ) -> np.ndarray:
        """See ``Shape.excess``."""
        boxes = [
            wp.array(np.ascontiguousarray(side, dtype=np.float64), dtype=wp.vec3d, device="cpu")
            for side in (lower, upper)
        ]
        held, out = (
            wp.array(np.ascontiguousarray(values, dtype=np.float64), dtype=Corners, device="cpu"),
            np.empty(len(lower)),
        )
        if len(out):
            ends = wp.array(np.broadcast_to(enough, len(out)).astype(np.float64), dtype=wp.float64, device="cpu")
            inputs = [self._struct, *boxes, held, wp.float64(least), ends]
            made = wp.array(out, dtype=wp.float64, device="cpu", copy=False)
            launch_on_cores(find_excesses, len(out), inputs, [made], "cpu")
        return out

    def decide_boxes(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Whether closed boxes meet the object."""
        return self._answer(decide_boxes, lower, upper)

    def decide_segments(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Whether closed segments meet the object."""
        return self._answer(decide_segments, start, end)

    def decide_planes(self, normal: np.ndarray, point: np.ndarray) -> np.ndarray:
        """Whether planes meet the object."""
        return self._answer(decide_planes, normal, point)
