"""Cells over a surface: which of them it meets, and on which side of it the others lie."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import warp as wp

from warp_bounding.runtime.launch import launch_on_cores, ready
from warp_bounding.runtime.native import module_options
from warp_bounding.shapes.surfaces import joined_parts
from warp_bounding.shapes.triangles.hierarchy import (
    UNWOUND,
    Triangles,
    beyond,
    free,
    is_enclosed,
    segment_is_free,
    triangle_of,
    winding,
)

# --- Which cells meet a triangle --------------------------------------------------------------------------------------
#
# Which closed cells come within a margin of a triangle: the conservative step between a mesh and a proof.
#
# A cell is left empty for one reason only: there is an axis on which the triangle and the cell, grown by a ball of the
# margin's radius, do not overlap (``triangles/hierarchy.py``, which tells the axes that are tried).
#
# Cells are visited in blocks, so that a triangle across the whole grid does not visit the whole grid. The result is a
# union over triangles and does not depend on their order.

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
                    if not free(triangle_of(a - p, b - p, c - p), _CELL, margin, _SLACK):
                        occupancy[i, j, k] = wp.uint8(1)


@wp.kernel(enable_backward=False, module="warp_bounding.shapes.triangles.voxelization")
def _occupy_cells(
    # inputs
    vertices: wp.array(dtype=wp.vec3d),
    faces: wp.array2d(dtype=wp.int32),
    margins: wp.array(dtype=wp.float64),
    # outputs
    occupancy: wp.array3d(dtype=wp.uint8),
):
    """One triangle a thread. All threads write the same value, 1, so their order is of no account."""
    tid, _ = wp.tid()
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
                if not free(triangle_of(a - o, b - o, c - o), _BLOCK_OF_CELLS, margin, _SLACK):
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
    """As ``surface_cells``; also cells that may meet the inside of ``closed`` parts. ``air`` is as in ``fill_inside``.

    There must be room for one empty cell on every side.
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
    of a closed surface, however often that overlaps itself. Cells at the border are empty. ``air``, told cells ``(N,
    3)`` that do not meet the surface, says of which it is certain that they, and all that are connected to them, are
    outside.
    """
    from scipy import ndimage

    regions, count = ndimage.label(~surface)
    empty = np.zeros(count + 1, dtype=bool)
    if air is not None and count > 1:
        some, order = np.zeros(count + 1, dtype=np.int64), np.random.default_rng(0).permutation(regions.size)
        # Any cell of each: in symmetric objects the last ones lie where rays meet edges.
        some[regions.ravel()[order]] = order
        empty[1:] = air(np.stack(np.unravel_index(some[1:], surface.shape), axis=1))
    empty[regions[0, 0, 0]] = True
    return ~empty[regions]


# --- On which side cells lie ------------------------------------------------------------------------------------------
#
# On which side of a closed surface does a point lie? A grid over the surface, whose cells and centres know it.
#
# A cell that meets no face has one side: it is free. Of a cell that meets faces, only the centre has a side. Two free
# cells with a common face are on the same side, and so are two neighbouring centres if the segment between them is
# proven to cross no face. What is connected in this way with the border of the grid is outside, for certain. The rest
# is inside where a ray proves one of its points to be enclosed (``triangles/hierarchy.py``), and unknown elsewhere: a
# hollow between several parts, or behind a neck that is much narrower than a cell.
#
# A point is on the side of its own cell, if that is free, or of a centre or a free cell near it to which a short
# segment is proven to cross no face. Nothing is ever assumed: where all segments fail the side is unknown.
#
# Where hollows are empty, the winding number decides instead of the flood: what faces go around 0 times, for certain,
# is outside.

UNKNOWN, OUTSIDE, ENCLOSED = 0, 1, 2
TURNED = 3  # of ``_side_by_winding`` alone: enclosed by faces that go around the other way
FREE = 4  # added for a cell that meets no face
RESOLUTIONS = ((20_000, 128), (200_000, 192), (2**31, 256))  # cells along the longest side for up to so many faces
BORDER = 1.3718281  # cells before the surface: no round number, so that centres seldom lie in planes of faces
# Of the kernels here and the first ones of ``answers``: whoever needs these needs those.
MODULE = "warp_bounding.shapes.triangles"
INNER = 0.49  # of a free cell, the part that segments end in: rounding is far less than the rest

_UNKNOWN, _OUTSIDE, _ENCLOSED = wp.constant(UNKNOWN), wp.constant(OUTSIDE), wp.constant(ENCLOSED)
_FREE, _UNWOUND, _TURNED = wp.constant(FREE), wp.constant(UNWOUND), wp.constant(TURNED)
_INNER = wp.constant(wp.float64(INNER))
_HALF = wp.constant(wp.float64(0.5))
for _name in (MODULE, f"{MODULE}.voxelization", f"{MODULE}.winding"):
    wp.set_module_options(module_options(), wp.get_module(_name))


@wp.struct
class Sides:
    """What kernels take. Without faces there is no cell, and every point is outside."""

    lower: wp.vec3d  # the box around the faces
    upper: wp.vec3d
    origin: wp.vec3d  # centre of cell 0
    scale: wp.float64  # cells per unit
    cells: wp.array3d(dtype=wp.uint8)
    wound: int  # 1: faces are turned alike, and what they go around 0 times is outside


@wp.struct
class MeshArrays:
    """A mesh that is dilated."""

    lower: wp.vec3d  # the box that holds the dilated object
    upper: wp.vec3d
    margin: wp.float64
    faces: Triangles  # all of them
    closed: Triangles  # those of closed parts
    sides: Sides


@wp.func
def _wound(found: int) -> int:
    """The side of what faces go around so often."""
    if found == _UNWOUND:
        return _UNKNOWN
    if found == 0:
        return _OUTSIDE
    return _ENCLOSED


@wp.func
def _centre(s: Sides, cell: wp.vec3i) -> wp.vec3d:
    return s.origin + _cell(cell[0], cell[1], cell[2]) / s.scale


@wp.func
def _end_in(s: Sides, t: wp.vec3d, cell: wp.vec3i, free: bool) -> wp.vec3d:
    """Where a segment to a cell ends: at the centre, or at the nearest inner point of a free cell."""
    end = wp.vec3d(wp.float64(cell[0]), wp.float64(cell[1]), wp.float64(cell[2]))
    if free:
        for k in range(3):
            end[k] = wp.clamp(t[k], end[k] - _INNER, end[k] + _INNER)
    return s.origin + end / s.scale


@wp.func
def side_of(faces: Triangles, s: Sides, x: wp.vec3d) -> int:
    """The side of a point, finite numbers: OUTSIDE or ENCLOSED for certain, or UNKNOWN."""
    if s.cells.shape[0] == 0 or beyond(x, s.lower, s.upper):
        return _OUTSIDE
    t = (x - s.origin) * s.scale
    own, step = wp.vec3i(), wp.vec3i()
    for k in range(3):
        own[k] = int(wp.floor(t[k] + _HALF))
        if t[k] >= wp.float64(own[k]):
            step[k] = 1
        else:
            step[k] = -1
    side = int(s.cells[own[0], own[1], own[2]])
    if side > _FREE:
        return side - _FREE
    for way in range(8):
        cell = own + wp.vec3i(step[0] * (way & 1), step[1] * ((way >> 1) & 1), step[2] * (way >> 2))
        node = int(s.cells[cell[0], cell[1], cell[2]])
        side = node & 3
        if side != _UNKNOWN:  # noqa: SIM102 (a kernel's ``and`` would not wait)
            if segment_is_free(faces, x, _end_in(s, t, cell, node > _FREE), wp.float64(0.0)):
                return side
    if s.wound != 0:
        return _wound(winding(faces, x))
    if is_enclosed(faces, x):
        return _ENCLOSED
    return _UNKNOWN


@wp.func
def _joined(m: MeshArrays, a: wp.vec3i, b: wp.vec3i) -> bool:
    """Is the segment between two centres proven to cross no face?"""
    return segment_is_free(m.closed, _centre(m.sides, a), _centre(m.sides, b), wp.float64(0.0))


@wp.func
def _enclosed(m: MeshArrays, cell: wp.vec3i) -> bool:
    """Is a centre proven to be enclosed?"""
    return is_enclosed(m.closed, _centre(m.sides, cell))


@wp.func
def _side_by_winding(m: MeshArrays, cell: wp.vec3i) -> int:
    """The side of a centre by its winding number, TURNED where that is below 0."""
    found = winding(m.closed, _centre(m.sides, cell))
    if found < 0:
        return _TURNED
    return _wound(found)


def kernel_of(answer: wp.Function, mesh: type, point: type, module: str, dtype: type = wp.uint8, rows: int = 2):
    """The kernel that gives a mesh, and each query of one or two ``rows`` of points, to a function.

    It answers with a ``dtype`` and is compiled with all others of the same ``module``.
    """
    name = f"{answer.key.strip('_')}_{len(point())}"

    def of_points(
        first: int,
        # inputs
        m: mesh,
        x: wp.array(dtype=point),
        # outputs
        answers: wp.array(dtype=dtype),
    ):
        i, _ = wp.tid()
        i += first
        answers[i] = dtype(answer(m, x[i]))

    def of_pairs(
        first: int,
        # inputs
        m: mesh,
        lower: wp.array(dtype=point),
        upper: wp.array(dtype=point),
        # outputs
        answers: wp.array(dtype=dtype),
    ):
        i, _ = wp.tid()
        i += first
        answers[i] = dtype(answer(m, lower[i], upper[i]))

    kernel = of_points if rows == 1 else of_pairs
    kernel.__name__ = kernel.__qualname__ = name
    return wp.kernel(kernel, enable_backward=False, module=module)


_join = kernel_of(_joined, MeshArrays, wp.vec3i, MODULE)
_enclose = kernel_of(_enclosed, MeshArrays, wp.vec3i, MODULE, rows=1)
_wind = kernel_of(_side_by_winding, MeshArrays, wp.vec3i, f"{MODULE}.winding", rows=1)


class SidesGrid(NamedTuple):
    """A grid that was built."""

    sides: Sides
    hollows: int = 0  # there are so many, if that is known
    both: bool = False  # faces go around some cells one way, and around others the other


def build_sides(
    vertices: np.ndarray, faces: np.ndarray, triangles: Triangles, alike: bool = False, empty: bool = False
) -> SidesGrid:
    """Find the sides of a grid's cells around faces ``(F, 3)``, all of closed parts, and their hierarchy on the CPU.

    Args:
        vertices: ``(V, 3)`` float32.
        faces: ``(F, 3)`` integers.
        triangles: The hierarchy.
        alike: Whether faces are turned alike, and hollows may be told by winding numbers; else they are not
            counted.
        empty: Whether hollows are outside; only where faces are turned alike.
    """
    sides = Sides()
    sides.scale, sides.wound = wp.float64(1.0), int(empty)
    if len(faces) == 0:
        return SidesGrid(sides)
    used, faces = np.unique(faces, return_inverse=True)
    corners = vertices[used].astype(np.float64)
    lower, upper = corners.min(axis=0), corners.max(axis=0)
    scale = next(cells for most, cells in RESOLUTIONS if len(faces) <= 3 * most) / float((upper - lower).max())
    origin = lower - BORDER / scale
    corners = (corners - origin) * scale
    shape = tuple((np.floor(corners.max(axis=0) + 0.5).astype(int) + 3).tolist())  # the last is empty, rounded or not
    surface = surface_cells(corners, faces.reshape(-1, 3), shape, 0.0)
    sides.lower, sides.upper, sides.origin = (wp.vec3d(*v) for v in (lower, upper, origin))
    sides.scale = wp.float64(scale)
    mesh = MeshArrays()
    mesh.closed, mesh.sides = triangles, sides
    cells, hollows, both = _sides(surface, mesh, alike, empty)
    sides.cells = wp.array(cells, dtype=wp.uint8, device="cpu")
    return SidesGrid(sides, hollows, both)


def _sides(surface: np.ndarray, mesh: MeshArrays, alike: bool, empty: bool) -> tuple[np.ndarray, int, bool]:
    """Each cell's side, and ``FREE`` without a face; the number of free hollows; whether faces go around both ways."""
    from scipy import ndimage

    region, regions = ndimage.label(~surface)
    region = region.astype(np.int32) - 1
    region[surface] = regions + np.arange(np.count_nonzero(surface), dtype=np.int32)
    count = regions + np.count_nonzero(surface)
    starts, ends = _neighbours(surface)
    kept = _launch(_join, mesh, starts, ends)
    parts, part = joined_parts(region[tuple(starts[kept].T)], region[tuple(ends[kept].T)], count)
    outside = part[region[0, 0, 0]]
    part = part[region]  # of each cell
    some = np.zeros(parts, dtype=np.int64)  # a cell of each part
    some[part.ravel()] = np.arange(part.size)
    cells = np.stack(np.unravel_index(some, surface.shape), axis=1)
    enclosed = np.unique(part[~surface])
    enclosed = enclosed[enclosed != outside]
    reported = np.arange(parts) if empty else enclosed if alike else np.zeros(0, np.int64)
    wound = np.full(parts, UNKNOWN, dtype=np.uint8)
    if len(reported):  # at any cell of a part: first and last ones lie where rays meet edges, in symmetric objects
        order = np.random.default_rng(0).permutation(part.size)
        some[part.ravel()[order]] = order
        anywhere = np.stack(np.unravel_index(some[reported], surface.shape), axis=1)
        wound[reported] = _launch(_wind, mesh, anywhere).view(np.uint8)
    both = bool((wound == TURNED).any() and (wound == ENCLOSED).any())
    wound[wound == TURNED] = ENCLOSED
    side = wound if empty else ENCLOSED * _launch(_enclose, mesh, cells).astype(np.uint8)
    side[outside] = OUTSIDE
    return side[part] + np.uint8(FREE) * ~surface, int((wound[enclosed] == OUTSIDE).sum()), both


def _neighbours(surface: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of cells with a common face, one of which meets the surface at least: ``(P, 3)`` and ``(P, 3)``."""
    pairs = []
    for axis in range(3):
        low, high = (
            tuple(part if k == axis else slice(None) for k in range(3)) for part in (slice(-1), slice(1, None))
        )
        start = np.argwhere(surface[low] | surface[high])
        pairs.append((start, start + np.eye(3, dtype=start.dtype)[axis]))
    return tuple(np.concatenate(part) for part in zip(*pairs, strict=True))


def _launch(kernel: wp.Kernel, mesh: MeshArrays, *cells: np.ndarray) -> np.ndarray:
    """``(N,)`` bool, what a kernel answers about cells ``(N, 3)``."""
    out = wp.zeros(len(cells[0]), dtype=wp.uint8, device="cpu")
    rows = [wp.array(np.ascontiguousarray(each, dtype=np.int32), dtype=wp.vec3i, device="cpu") for each in cells]
    launch_on_cores(kernel, len(cells[0]), [mesh, *rows], [out], "cpu")
    return out.numpy().view(bool)
