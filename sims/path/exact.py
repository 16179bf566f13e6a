"""The exact world: does a state or a straight edge meet a closed occupied cell? Decided without rounding.

Endpoints are float32; a scaled coordinate ``p = cells_per_unit * x`` is exact in float64 (24 times 24 bits), and in
these coordinates cell i spans ``offset + i - 1/2`` to ``offset + i + 1/2``, multiples of 1/2. So comparisons of p with
faces are exact, and with them the question for states. A segment from a along d meets a cell of centre c iff their
ranges overlap along both axes, and the line passes the centre closely enough (the separating axes of a box and a
segment):

    |d_0 (c_1 - a_1) - d_1 (c_0 - a_0)| <= (|d_0| + |d_1|) / 2.

In float64 both sides are off by less than ``ROUNDING`` times the sum of the magnitudes (three roundings a product, one
a sum, with or without fused multiply-add; 8 units of 2^-53 in all). Where that leaves a doubt, which is next to never,
Python's integers decide.

What this does not do: robots with a size. Dilate the world (``grid.to_grid(margin=...)``) for a disc.
"""

from fractions import Fraction

import numpy as np
import warp as wp

import warp_bounding as wb
from sims.planning.planner import Exact

__all__ = ["ExactWorld"]

FREE, HIT, DOUBT = 0, 1, 2
_FREE, _HIT, _DOUBT = (wp.constant(wp.uint8(answer)) for answer in (FREE, HIT, DOUBT))
FARTHEST = 2.0**30  # cells: so far the columns that a row is searched for are right, too
ROUNDING = wp.constant(wp.float64(16.0 * 2.0**-53))  # twice what the docstring counts
HALF = wp.constant(wp.float64(0.5))
ZERO, ONE = wp.constant(wp.float64(0.0)), wp.constant(wp.float64(1.0))


@wp.func
def first_cell(t: wp.float64, cells: int) -> int:
    """A cell at or before the first one that can contain cell coordinates from t on, in the grid."""
    return wp.int32(wp.clamp(wp.floor(t) - ONE, ZERO, wp.float64(cells)))


@wp.func
def last_cell(t: wp.float64, cells: int) -> int:
    """A cell at or behind the last one that can contain cell coordinates up to t, in the grid."""
    return wp.int32(wp.clamp(wp.ceil(t) + ONE, -ONE, wp.float64(cells - 1)))


@wp.kernel(enable_backward=False)
def meet_states(
    # inputs
    first: int,
    states: wp.array(dtype=wp.vec2),
    scale: wp.vec2d,
    offset: wp.vec2d,
    occupancy: wp.array2d(dtype=wp.uint8),
    # outputs
    answers: wp.array(dtype=wp.uint8),
):
    """Whether a state lies in a closed occupied cell."""
    thread, _ = wp.tid()
    i = first + thread
    p0 = wp.float64(states[i][0]) * scale[0]
    p1 = wp.float64(states[i][1]) * scale[1]
    rows, columns = occupancy.shape[0], occupancy.shape[1]
    answers[i] = _FREE
    for r in range(first_cell(p0 - offset[0], rows), last_cell(p0 - offset[0], rows) + 1):
        c0 = offset[0] + wp.float64(r)
        if p0 < c0 - HALF or p0 > c0 + HALF:
            continue
        for c in range(first_cell(p1 - offset[1], columns), last_cell(p1 - offset[1], columns) + 1):
            c1 = offset[1] + wp.float64(c)
            if p1 < c1 - HALF or p1 > c1 + HALF:
                continue
            if occupancy[r, c] != wp.uint8(0):
                answers[i] = _HIT
                return


@wp.kernel(enable_backward=False)
def meet_segments(
    # inputs
    first: int,
    starts: wp.array(dtype=wp.vec2),
    ends: wp.array(dtype=wp.vec2),
    scale: wp.vec2d,
    offset: wp.vec2d,
    occupancy: wp.array2d(dtype=wp.uint8),
    # outputs
    answers: wp.array(dtype=wp.uint8),
):
    """Whether a closed segment meets a closed occupied cell; ``DOUBT`` where float64 cannot tell."""
    thread, _ = wp.tid()
    i = first + thread
    a0 = wp.float64(starts[i][0]) * scale[0]
    a1 = wp.float64(starts[i][1]) * scale[1]
    b0 = wp.float64(ends[i][0]) * scale[0]
    b1 = wp.float64(ends[i][1]) * scale[1]
    d0 = b0 - a0
    d1 = b1 - a1
    reach = HALF * (wp.abs(d0) + wp.abs(d1))
    low0 = wp.min(a0, b0)
    high0 = wp.max(a0, b0)
    low1 = wp.min(a1, b1)
    high1 = wp.max(a1, b1)
    rows, columns = occupancy.shape[0], occupancy.shape[1]
    answers[i] = _FREE
    for r in range(first_cell(low0 - offset[0], rows), last_cell(high0 - offset[0], rows) + 1):
        c0 = offset[0] + wp.float64(r)
        if high0 < c0 - HALF or low0 > c0 + HALF:
            continue
        near = low1
        far = high1
        if (
            d0 != ZERO
        ):  # only the columns that the segment crosses in this row; off by far less than the cell that is added
            u1 = a1 + wp.clamp((c0 - HALF - a0) / d0, ZERO, ONE) * d1
            v1 = a1 + wp.clamp((c0 + HALF - a0) / d0, ZERO, ONE) * d1
            near = wp.min(u1, v1)
            far = wp.max(u1, v1)
        for c in range(first_cell(near - offset[1], columns), last_cell(far - offset[1], columns) + 1):
            if occupancy[r, c] == wp.uint8(0):
                continue
            c1 = offset[1] + wp.float64(c)
            if high1 < c1 - HALF or low1 > c1 + HALF:
                continue
            over = d0 * (c1 - a1)
            under = d1 * (c0 - a0)
            gap = wp.abs(over - under) - reach
            doubt = ROUNDING * (wp.abs(over) + wp.abs(under) + reach)
            if gap < -doubt or reach == ZERO:
                answers[i] = _HIT
                return
            if gap <= doubt:
                answers[i] = _DOUBT


class ExactWorld(Exact):
    """The narrow phase of the planner.

    Attributes:
        grid: Its cells.
        doubts: Segments that integers had to decide so far.
        checks: States and segments that were asked so far.
    """

    def __init__(self, grid: wb.shapes.Grid, device: str = "cpu"):
        """Copy the cells to a device.

        Args:
            grid: 2D.
            device: Warp device.

        Raises:
            ShapeError: If the grid is not 2D and at rest.
        """
        if grid.ndim != 2 or grid.time:
            raise wb.ShapeError(f"{grid.name}: expected a world of 2 dimensions, got {grid.ndim}")
        self.grid, self.device, self.doubts = grid, wp.get_device(device), 0
        occupancy = wp.array(grid.occupancy.astype(np.uint8), dtype=wp.uint8, device=self.device)
        self._world = [wp.vec2d(*grid.cells_per_unit), wp.vec2d(*grid.offset), occupancy]

    def states(self, x: np.ndarray) -> np.ndarray:
        """Which states collide: ``(N,)`` bool.

        Args:
            x: ``(N, 2)`` float32, object space.

        Raises:
            QueryError: For another shape or dtype, or numbers that are not finite or a billion cells away.
        """
        return self._launch(meet_states, [self._checked(x)]) == HIT

    def segments(self, starts: np.ndarray, ends: np.ndarray, cleared=None) -> np.ndarray:
        """Which closed segments collide: ``(N,)`` bool.

        Args:
            starts: ``(N, 2)`` float32, object space.
            ends: ``(N, 2)`` float32.
            cleared: Not asked: a segment is decided as a whole.

        Raises:
            QueryError: For another shape or dtype, or numbers that are not finite or a billion cells away.
        """
        starts, ends = self._checked(starts), self._checked(ends)
        if len(starts) != len(ends):
            raise wb.QueryError(f"expected as many ends as starts, got {len(ends)} and {len(starts)}")
        answers = self._launch(meet_segments, [starts, ends])
        hits = answers == HIT
        for i in np.flatnonzero(answers == DOUBT):
            hits[i] = self._decide(starts[i], ends[i])
            self.doubts += 1
        return hits

    def _launch(self, kernel: wp.Kernel, places: list[np.ndarray]) -> np.ndarray:
        count = len(places[0])
        self.checks += count
        answers = wp.empty(count, dtype=wp.uint8, device=self.device)
        arrays = [wp.array(place, dtype=wp.vec2, device=self.device) for place in places]
        if count:
            wb.launch_on_cores(kernel, count, [*arrays, *self._world], [answers], self.device)
        return answers.numpy()

    def _checked(self, x: np.ndarray) -> np.ndarray:
        x = np.asarray(x)
        if x.dtype != np.float32 or x.ndim != 2 or x.shape[1] != 2:
            raise wb.QueryError(f"expected (N, 2) float32, got {x.shape} {x.dtype}")
        if not np.isfinite(x).all():
            raise wb.QueryError("expected finite coordinates, got NaN or infinity")
        if (np.abs(x * self.grid.cells_per_unit) > FARTHEST).any():
            raise wb.QueryError(f"expected coordinates within {FARTHEST:.0f} cells, got {np.abs(x).max():g}")
        return np.ascontiguousarray(x)

    def _decide(self, start: np.ndarray, end: np.ndarray) -> bool:
        """The same condition in exact arithmetic, for one segment."""
        grid, half = self.grid, Fraction(1, 2)
        scale, offset = ([Fraction(float(v)) for v in values] for values in (grid.cells_per_unit, grid.offset))
        a = [Fraction(float(start[k])) * scale[k] - offset[k] for k in range(2)]
        b = [Fraction(float(end[k])) * scale[k] - offset[k] for k in range(2)]
        d = [b[k] - a[k] for k in range(2)]
        cells = [  # ceil and floor: the closed cells that the segment's range overlaps
            range(max(0, -((half - min(a[k], b[k])) // 1)), min(grid.shape[k] - 1, (max(a[k], b[k]) + half) // 1) + 1)
            for k in range(2)
        ]
        for r in cells[0]:
            for c in cells[1]:
                near = abs(d[0] * (c - a[1]) - d[1] * (r - a[0])) <= (abs(d[0]) + abs(d[1])) * half
                if grid.occupancy[r, c] and near:
                    return True
        return False
