"""Which closed cells come within a margin of a triangle: the conservative step between a mesh and a proof.

A cell is left empty for one reason only: there is an axis on which the triangle and the cell, grown by a ball of the
margin's radius, do not overlap (``triangles/arithmetic.py``, which tells the axes that are tried).

Cells are visited in blocks, so that a triangle across the whole grid does not visit the whole grid. The result is a
union over triangles and does not depend on their order.
"""

from collections.abc import Callable

import numpy as np
import warp as wp

from warp_bounding.indicators.triangles.arithmetic import free
from warp_bounding.runtime.launch import ready
from warp_bounding.runtime.native import module_options

__all__ = ["SLACK", "fill_inside", "solid_cells", "surface_cells"]

# By how much cells are grown on each side, in cells, to outweigh all rounding. All coordinates are under 2^11 cells
# (the resolution is at most 1024), so for an axis d, as computed, with |d| its sum of absolute components, float64
# errs by less than
#   a vertex in cells (one rounding), then relative to a centre (one more)      2^-42 in each component, so |d| 2^-42
#   its dot product with d, three products and two sums                         3 * 2^-53 * 2^11 |d|, so |d| 2^-40
#   the reach, (half + SLACK) |d| + margin * length(d), half <= 4, margin < 2^10    8 * 2^-53 * 2^10 |d| = |d| 2^-40
# together less than |d| 2^-38 (fused multiply-adds only take errors away); SLACK * |d| is 64 times that.
SLACK = 2.0**-32
BLOCK = 8  # cells along each side of a block

_SLACK = wp.constant(wp.float64(SLACK))
_BLOCK = wp.constant(BLOCK)
_HALF_CELL = wp.constant(wp.float64(0.5))
_CELL = wp.constant(wp.vec3d(0.5, 0.5, 0.5))  # half of a cell's sides, and of a block's
_BLOCK_OF_CELLS = wp.constant(wp.vec3d(BLOCK / 2, BLOCK / 2, BLOCK / 2))
_TO_BLOCK_CENTRE = wp.constant(wp.vec3d((BLOCK - 1) / 2, (BLOCK - 1) / 2, (BLOCK - 1) / 2))
wp.set_module_options(module_options())


@wp.func
def _cell(i: int, j: int, k: int) -> wp.vec3d:
    return wp.vec3d(wp.float64(i), wp.float64(j), wp.float64(k))


@wp.func
def _occupy_block(
    a: wp.vec3d,
    b: wp.vec3d,
    c: wp.vec3d,
    margin: wp.float64,
    low: wp.vec3i,
    high: wp.vec3i,
    occupancy: wp.array3d(dtype=wp.uint8),
):
    """Occupy the cells low, ..., high that the triangle comes within the margin of."""
    for i in range(low[0], high[0] + 1):
        for j in range(low[1], high[1] + 1):
            for k in range(low[2], high[2] + 1):
                if occupancy[i, j, k] == wp.uint8(0):
                    p = _cell(i, j, k)
                    if not free(a - p, b - p, c - p, _CELL, margin, _SLACK):
                        occupancy[i, j, k] = wp.uint8(1)


@wp.kernel(enable_backward=False)
def _occupy_cells(
    # inputs
    vertices: wp.array(dtype=wp.vec3d),
    faces: wp.array2d(dtype=wp.int32),
    margins: wp.array(dtype=wp.float64),
    # outputs
    occupancy: wp.array3d(dtype=wp.uint8),
):
    """One triangle a thread. All threads write the same value, 1, so their order is of no account."""
    tid = wp.tid()
    a, b, c = vertices[faces[tid, 0]], vertices[faces[tid, 1]], vertices[faces[tid, 2]]
    margin = margins[tid]
    lower, upper = wp.min(a, wp.min(b, c)), wp.max(a, wp.max(b, c))
    reach = margin + _HALF_CELL + _SLACK
    low, high = wp.vec3i(), wp.vec3i()
    for k in range(3):
        low[k] = wp.max(int(wp.ceil(lower[k] - reach)), 0)
        high[k] = wp.min(int(wp.floor(upper[k] + reach)), occupancy.shape[k] - 1)
    for i in range(low[0], high[0] + 1, _BLOCK):
        for j in range(low[1], high[1] + 1, _BLOCK):
            for k in range(low[2], high[2] + 1, _BLOCK):
                o = _cell(i, j, k) + _TO_BLOCK_CENTRE
                if not free(a - o, b - o, c - o, _BLOCK_OF_CELLS, margin, _SLACK):
                    last = wp.min(high, wp.vec3i(i + _BLOCK - 1, j + _BLOCK - 1, k + _BLOCK - 1))
                    _occupy_block(a, b, c, margin, wp.vec3i(i, j, k), last, occupancy)


def surface_cells(
    vertices: np.ndarray, faces: np.ndarray, shape: tuple[int, int, int], margin: float | np.ndarray
) -> np.ndarray:
    """Occupy every closed cell that comes within the margin of a triangle.

    Args:
        vertices: ``(V, 3)`` float64, in cells: cell i spans [i - 1/2, i + 1/2]; absolute values under 2^11.
        faces: ``(F, 3)`` integer, indices of vertices.
        shape: Cells along each axis.
        margin: In cells, from 0 to under 2^10; one for all triangles, or ``(F,)``.

    Returns:
        Bool array of the given shape. Cells are occupied whose distance exceeds the margin by no more than about
        ``SLACK``, and a few more where the closest points were not found in ``PROJECTIONS`` steps.
    """
    occupancy = wp.zeros(shape, dtype=wp.uint8, device="cpu")
    corners = wp.array(np.ascontiguousarray(vertices, dtype=np.float64), dtype=wp.vec3d, device="cpu")
    triangles = wp.array(np.ascontiguousarray(faces, dtype=np.int32), dtype=wp.int32, device="cpu")
    margins = wp.array(np.array(np.broadcast_to(margin, len(faces)), dtype=np.float64), dtype=wp.float64, device="cpu")
    inputs = [corners, triangles, margins]
    ready(_occupy_cells, wp.get_device("cpu"))
    wp.launch(_occupy_cells, dim=len(faces), inputs=inputs, outputs=[occupancy], device="cpu")
    return occupancy.numpy().view(bool)


def solid_cells(
    vertices: np.ndarray,
    faces: np.ndarray,
    closed: np.ndarray,
    shape: tuple[int, int, int],
    margin: float | np.ndarray,
    air: Callable[[np.ndarray], np.ndarray] | None = None,
) -> np.ndarray:
    """Occupy every closed cell that comes within the margin of a triangle, or that may meet the inside of the closed parts.

    Args:
        vertices: See ``surface_cells``.
        faces: See ``surface_cells``.
        closed: ``(F,)`` bool, the faces of closed parts (``closed_parts.surface_of``).
        shape: See ``surface_cells``; there must be room for one empty cell on every side.
        margin: See ``surface_cells``.
        air: See ``fill_inside``.

    Returns:
        Bool array of the given shape.
    """
    margin = np.broadcast_to(margin, len(faces))
    occupancy = np.zeros(shape, dtype=bool)
    if closed.any():
        occupancy |= fill_inside(surface_cells(vertices, faces[closed], shape, margin[closed]), air)
    if not closed.all():
        occupancy |= surface_cells(vertices, faces[~closed], shape, margin[~closed])
    return occupancy


def fill_inside(surface: np.ndarray, air: Callable[[np.ndarray], np.ndarray] | None = None) -> np.ndarray:
    """Occupy what a flood from outside, from face to face through empty cells, does not reach.

    The empty closed cells that it reaches are connected and do not meet the surface, so none of them meets the inside
    of a closed surface, however often that overlaps itself.

    Args:
        surface: ``(X, Y, Z)`` bool; the cells at its border are empty.
        air: Told cells ``(N, 3)`` that do not meet the surface, says of which it is certain that they are outside all the same; and with
            them all that are connected to them.

    Returns:
        ``(X, Y, Z)`` bool.
    """
    from scipy import ndimage

    regions, count = ndimage.label(~surface)
    empty = np.zeros(count + 1, dtype=bool)
    if air is not None and count > 1:
        some, order = np.zeros(count + 1, dtype=np.int64), np.random.default_rng(0).permutation(regions.size)
        some[regions.ravel()[order]] = (
            order  # any cell of each: in symmetric objects the last ones lie where rays meet edges
        )
        empty[1:] = air(np.stack(np.unravel_index(some[1:], surface.shape), axis=1))
    empty[regions[0, 0, 0]] = True
    return ~empty[regions]
