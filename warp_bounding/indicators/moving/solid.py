"""The faces of a motion, and the inside of its closed parts, as kernels ask for them; built when they are first needed.

A motion and its dilated copies share one of these: the margin is told with each question.
"""

from functools import cached_property

import numpy as np
import warp as wp

from warp_bounding.indicators.half_spaces import HalfSpaces
from warp_bounding.indicators.moving.answers import Motion, decide_moments, find_empty_spans, find_inside_spans
from warp_bounding.indicators.moving.excess import CornersThen, find_excesses_then
from warp_bounding.indicators.moving.half_spaces import find_half_spaces_then
from warp_bounding.indicators.moving.hierarchy import MovingTriangles
from warp_bounding.indicators.moving.points import find_distances_then
from warp_bounding.indicators.moving.sides import MovingSides
from warp_bounding.indicators.triangles.asked import AskedSolid
from warp_bounding.indicators.triangles.cycles import cycles_of
from warp_bounding.runtime.launch import launch_on_cores

__all__ = ["DilatedMovingSolid", "MovingSolid"]


class MovingSolid:
    """Triangles that move, and the side of each point, without a margin.

    Args:
        times: ``(K,)`` float32.
        frames: ``(K, V, 3)`` float32.
        faces: ``(F, 3)`` integers.
        closed: ``(F,)`` bool, the faces of closed parts.
        rounding: By which vertices may be elsewhere: more than what float64 makes of an interpolation.
    """

    def __init__(self, times: np.ndarray, frames: np.ndarray, faces: np.ndarray, closed: np.ndarray, rounding: float):
        self.times, self.rounding = times.astype(np.float64), rounding
        self._frames, self._faces, self._closed_faces = frames, faces, closed

    @cached_property
    def all(self) -> MovingTriangles:
        """The hierarchy of all faces."""
        if self._closed_faces.all():
            return self.closed
        return MovingTriangles(self.times, self._frames, self._faces)

    @cached_property
    def closed(self) -> MovingTriangles:
        """The hierarchy of closed parts' faces."""
        paths = np.ascontiguousarray(self._frames.transpose(1, 0, 2)).reshape(self._frames.shape[1], -1)
        cycles = cycles_of(paths, self._faces, self._closed_faces)
        kept = self._closed_faces
        return MovingTriangles(self.times, self._frames, self._faces[kept], cycles[kept])

    @cached_property
    def sides(self) -> MovingSides:
        """The grids of closed parts."""
        return MovingSides(self.closed, self._frames, self._faces[self._closed_faces], self.rounding)


class DilatedMovingSolid(AskedSolid):
    """A solid that moves, and its margin.

    Args:
        solid: Without a margin.
        lower: ``(4,)``, corner of a box that holds the dilated object, time first.
        upper: ``(4,)``, the other corner.
        margin: Object units.
    """

    point = wp.vec4d
    kernels = (decide_moments, find_empty_spans, find_inside_spans)

    def __init__(self, solid: MovingSolid, lower: np.ndarray, upper: np.ndarray, margin: float):
        self._solid = solid
        motion = Motion()
        motion.lower, motion.upper = wp.vec4d(*lower), wp.vec4d(*upper)
        motion.rounding = wp.float64(solid.rounding)
        motion.reach = wp.float64(np.nextafter(margin + solid.rounding, np.inf))
        motion.hold = wp.float64(np.nextafter(margin - solid.rounding, -np.inf))
        motion.faces, motion.closed, motion.pieces = solid.all.ways, solid.closed.ways, solid.sides.pieces
        super().__init__(motion)

    def distances(self, x: np.ndarray) -> np.ndarray:
        """``(N, 2)`` float64, lower and upper bounds of the distance in space from points to the object at their time."""
        x = np.ascontiguousarray(x, dtype=np.float64)
        low, high = np.array(self._struct.lower), np.array(self._struct.upper)
        known = (x[:, 0] >= low[0]) & (x[:, 0] <= high[0])  # not so for NaN
        self._know(*[np.clip(np.nan_to_num(x[known]), low, high)] * 2)
        keys = np.where(known, self._keys(x[:, 0]), -1)
        found = np.empty((len(x), 2))
        if len(x):
            inputs = [
                self._struct,
                wp.array(keys, dtype=wp.int32, device="cpu"),
                wp.array(x, dtype=wp.vec4d, device="cpu", copy=False),
            ]
            out = wp.array(found, dtype=wp.vec2d, device="cpu", copy=False)
            launch_on_cores(find_distances_then, len(x), inputs, [out], "cpu")
        return found

    def half_spaces(self, lower: np.ndarray, upper: np.ndarray) -> HalfSpaces:
        """See ``Shape.half_spaces``."""
        lower, upper = (np.ascontiguousarray(side, dtype=np.float64) for side in (lower, upper))
        found = HalfSpaces.blank(lower, upper)
        if len(lower):
            self._know(lower, upper)
            boxes = [wp.array(side, dtype=wp.vec4d, device="cpu", copy=False) for side in (lower, upper)]
            launch_on_cores(find_half_spaces_then, len(lower), [self._struct, *boxes], found.arrays(), "cpu")
        return found

    def excess(
        self,
        lower: np.ndarray,
        upper: np.ndarray,
        values: np.ndarray,
        least: float,
        enough: np.ndarray | float,
        speed: float,
    ) -> np.ndarray:
        """See ``Shape.excess``: of boxes that lie between two keyframes, but for as little as rounding makes of their times; ``speed`` is the motion's."""
        lower, upper = (np.ascontiguousarray(side, dtype=np.float64) for side in (lower, upper))
        out, times = np.empty(len(lower)), self._solid.times
        if not len(out):
            return out
        low, high = np.array(self._struct.lower), np.array(self._struct.upper)
        self._know(*(np.clip(np.nan_to_num(side), low, high) for side in (lower, upper)))
        keys = self._keys(lower[:, 0] / 2 + upper[:, 0] / 2)
        beyond = 2 * speed * np.maximum(np.maximum(times[keys] - lower[:, 0], upper[:, 0] - times[keys + 1]), 0.0)
        boxes = [wp.array(side, dtype=wp.vec4d, device="cpu", copy=False) for side in (lower, upper)]
        held = wp.array(np.ascontiguousarray(values, dtype=np.float64), dtype=CornersThen, device="cpu")
        ends = wp.array(np.broadcast_to(enough, len(out)).astype(np.float64), dtype=wp.float64, device="cpu")
        inputs = [
            self._struct,
            wp.array(keys, dtype=wp.int32, device="cpu"),
            wp.array(beyond, dtype=wp.float64, device="cpu"),
        ]
        inputs += [*boxes, held, wp.float64(least), ends]
        made = wp.array(out, dtype=wp.float64, device="cpu", copy=False)
        launch_on_cores(find_excesses_then, len(out), inputs, [made], "cpu")
        return out

    def _keys(self, time: np.ndarray) -> np.ndarray:
        """The keyframes that come before times, never the last one."""
        times = self._solid.times
        return np.clip(np.searchsorted(times, time, side="right") - 1, 0, len(times) - 2)

    def _know(self, lower: np.ndarray, upper: np.ndarray) -> None:
        """Make what is needed for the times of queries that meet the box around the object."""
        low, high = np.array(self._struct.lower), np.array(self._struct.upper)
        asked = ((lower <= upper) & (lower <= high) & (upper >= low)).all(axis=1)
        if not asked.any():
            return
        times = self._solid.times
        spans = np.clip(np.stack([lower[asked, 0], upper[asked, 0]], axis=1), times[0], times[-1])
        key = np.clip(np.searchsorted(times, spans, side="right") - 1, 0, len(times) - 2)
        places = key + (spans - times[key]) / (times[key + 1] - times[key])
        begun, ended = np.bincount(key[:, 0], minlength=len(times)), np.bincount(key[:, 1] + 2, minlength=len(times))
        keys = np.flatnonzero(np.cumsum(begun - ended[: len(times)]) > 0)
        for triangles in (self._solid.all, self._solid.closed):
            triangles.know(keys)
        self._solid.sides.know(places)
