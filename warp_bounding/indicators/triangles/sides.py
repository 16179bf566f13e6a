"""On which side of a closed surface does a point lie? A grid over the surface, whose cells and centres know it.

A cell that meets no face has one side: it is free. Of a cell that meets faces, only the centre has a side. Two free
cells with a common face are on the same side, and so are two neighbouring centres if the segment between them is
proven to cross no face. What is connected in this way with the border of the grid is outside, for certain. The rest is
inside where a ray proves one of its points to be enclosed (``rays.py``), and unknown elsewhere: a hollow between
several parts, or behind a neck that is much narrower than a cell.

A point is on the side of its own cell, if that is free, or of a centre or a free cell near it to which a short segment
is proven to cross no face. Nothing is ever assumed: where all segments fail the side is unknown.

Where hollows are empty, the winding number decides instead of the flood: what faces go around 0 times, for certain, is outside.
"""

from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from warp_bounding.indicators.triangles.hierarchy import Triangles
from warp_bounding.indicators.triangles.rays import UNWOUND, is_enclosed, winding
from warp_bounding.indicators.triangles.walks import segment_is_free
from warp_bounding.runtime.launch import launch_on_cores
from warp_bounding.runtime.native import module_options

__all__ = ["ENCLOSED", "MODULE", "OUTSIDE", "UNKNOWN", "Sides", "SidesGrid", "build_sides", "side_of"]

UNKNOWN, OUTSIDE, ENCLOSED = 0, 1, 2
TURNED = 3  # of ``_wind`` alone: enclosed by faces that go around the other way
FREE = 4  # added for a cell that meets no face
RESOLUTIONS = ((20_000, 128), (200_000, 192), (2**31, 256))  # cells along the longest side for up to so many faces
BORDER = 1.3718281  # cells before the surface: no round number, so that centres seldom lie in planes of faces
MODULE = "warp_bounding.indicators.triangles"  # of the kernels here and in ``answers``: whoever needs these needs those
INNER = 0.49  # of a free cell, the part that segments end in: rounding is far less than the rest

_UNKNOWN, _OUTSIDE, _ENCLOSED = wp.constant(UNKNOWN), wp.constant(OUTSIDE), wp.constant(ENCLOSED)
_FREE, _UNWOUND, _TURNED = wp.constant(FREE), wp.constant(UNWOUND), wp.constant(TURNED)
_INNER = wp.constant(wp.float64(INNER))
_HALF = wp.constant(wp.float64(0.5))
wp.set_module_options(module_options(), wp.get_module(MODULE))


@wp.struct
class Sides:
    """What kernels take. Without faces there is no cell, and every point is outside."""

    lower: wp.vec3d  # the box around the faces
    upper: wp.vec3d
    origin: wp.vec3d  # centre of cell 0
    scale: wp.float64  # cells per unit
    cells: wp.array3d(dtype=wp.uint8)
    wound: int  # 1: faces are turned alike, and what they go around 0 times is outside


@wp.func
def _wound(faces: Triangles, x: wp.vec3d) -> int:
    found = winding(faces, x)
    if found == _UNWOUND:
        return _UNKNOWN
    if found == 0:
        return _OUTSIDE
    return _ENCLOSED


@wp.func
def _centre(s: Sides, i: int, j: int, k: int) -> wp.vec3d:
    return s.origin + wp.vec3d(wp.float64(i), wp.float64(j), wp.float64(k)) / s.scale


@wp.func
def _beyond(s: Sides, x: wp.vec3d) -> bool:
    for k in range(3):  # noqa: SIM110 (a kernel has no ``any``)
        if x[k] < s.lower[k] or x[k] > s.upper[k]:
            return True
    return False


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
    if s.cells.shape[0] == 0 or _beyond(s, x):
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
    # Where a segment fails, it crosses a face, as a rule; then nodes of the other side are asked first.
    failed = wp.int32(_UNKNOWN)
    for turn in range(2):
        for way in range(8):
            cell = own + wp.vec3i(step[0] * (way & 1), step[1] * ((way >> 1) & 1), step[2] * (way >> 2))
            node = int(s.cells[cell[0], cell[1], cell[2]])
            side = node & 3
            if side != _UNKNOWN and (side == failed) == (turn == 1):
                if segment_is_free(faces, x, _end_in(s, t, cell, node > _FREE), wp.float64(0.0)):
                    return side
                if failed == _UNKNOWN:
                    failed = side
    if s.wound != 0:
        return _wound(faces, x)
    if is_enclosed(faces, x):
        return _ENCLOSED
    return _UNKNOWN


@wp.kernel(enable_backward=False, module=MODULE)
def _join(
    first: int,
    # inputs
    faces: Triangles,
    s: Sides,
    starts: wp.array(dtype=wp.vec3i),
    ends: wp.array(dtype=wp.vec3i),
    # outputs
    joined: wp.array(dtype=wp.uint8),
):
    """Is the segment between two centres proven to cross no face?"""
    i = first + wp.tid()
    a, b = starts[i], ends[i]
    start, end = _centre(s, a[0], a[1], a[2]), _centre(s, b[0], b[1], b[2])
    joined[i] = wp.uint8(segment_is_free(faces, start, end, wp.float64(0.0)))


@wp.kernel(enable_backward=False, module=MODULE)
def _enclose(
    first: int,
    # inputs
    faces: Triangles,
    s: Sides,
    cells: wp.array(dtype=wp.vec3i),
    # outputs
    enclosed: wp.array(dtype=wp.uint8),
):
    """Is a centre proven to be enclosed?"""
    i = first + wp.tid()
    enclosed[i] = wp.uint8(is_enclosed(faces, _centre(s, cells[i][0], cells[i][1], cells[i][2])))


@wp.kernel(enable_backward=False)
def _wind(
    first: int,
    # inputs
    faces: Triangles,
    s: Sides,
    cells: wp.array(dtype=wp.vec3i),
    # outputs
    sides: wp.array(dtype=wp.uint8),
):
    """The side of a centre by its winding number, TURNED where that is below 0."""
    i = first + wp.tid()
    x = _centre(s, cells[i][0], cells[i][1], cells[i][2])
    found = winding(faces, x)
    if found != _UNWOUND and found < 0:
        sides[i] = wp.uint8(_TURNED)
    else:
        sides[i] = wp.uint8(_wound(faces, x))


@dataclass(frozen=True, eq=False)
class SidesGrid:
    """A grid that was built; ``cells`` is ``(X, Y, Z)`` uint8, a side and ``FREE`` or not; of ``hollows`` there are so many, if that is known.

    ``both``: faces go around some cells one way, and around others the other.
    """

    lower: np.ndarray
    upper: np.ndarray
    origin: np.ndarray
    scale: float
    cells: np.ndarray
    wound: bool = False
    hollows: int = 0
    both: bool = False

    def on(self, device: str | wp.Device) -> Sides:
        """The struct that kernels take, on a Warp device."""
        made = Sides()
        made.lower, made.upper, made.origin = (wp.vec3d(*v) for v in (self.lower, self.upper, self.origin))
        made.scale, made.wound = wp.float64(self.scale), int(self.wound)
        made.cells = wp.array(self.cells, dtype=wp.uint8, device=device)
        return made


def build_sides(
    vertices: np.ndarray, faces: np.ndarray, triangles: Triangles, alike: bool = False, empty: bool = False
) -> SidesGrid:
    """Find the sides of a grid's cells.

    Args:
        vertices: ``(V, 3)`` float32.
        faces: ``(F, 3)`` integers, all of them of closed parts.
        triangles: The hierarchy of these faces, on the CPU.
        alike: Whether faces are turned alike, and hollows may be told by winding numbers; else they are not counted.
        empty: Whether hollows are outside; only where faces are turned alike.
    """
    from warp_bounding.indicators.voxelization import surface_cells

    zero = np.zeros(3)
    if len(faces) == 0:
        return SidesGrid(zero, zero, zero, 1.0, np.zeros((0, 0, 0), dtype=np.uint8))
    used, faces = np.unique(faces, return_inverse=True)
    corners = vertices[used].astype(np.float64)
    lower, upper = corners.min(axis=0), corners.max(axis=0)
    scale = next(cells for most, cells in RESOLUTIONS if len(faces) <= 3 * most) / float((upper - lower).max())
    origin = lower - BORDER / scale
    corners = (corners - origin) * scale
    shape = tuple((np.floor(corners.max(axis=0) + 0.5).astype(int) + 3).tolist())  # the last is empty, rounded or not
    surface = surface_cells(corners, faces.reshape(-1, 3), shape, 0.0)
    grid = SidesGrid(lower, upper, origin, scale, np.zeros(shape, dtype=np.uint8), empty)
    grid.cells[:], hollows, both = _sides(surface, triangles, grid.on("cpu"), alike, empty)
    return replace(grid, hollows=hollows, both=both)


def _sides(
    surface: np.ndarray, triangles: Triangles, sides: Sides, alike: bool, empty: bool
) -> tuple[np.ndarray, int, bool]:
    """The side of each cell, and ``FREE`` where no face is; how many hollows have a free cell; whether faces go around both ways."""
    from scipy import ndimage
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    region, regions = ndimage.label(~surface)
    region = region.astype(np.int32) - 1
    region[surface] = regions + np.arange(np.count_nonzero(surface), dtype=np.int32)
    count = regions + np.count_nonzero(surface)
    starts, ends = _neighbours(surface)
    kept = _launch(_join, len(starts), [triangles, sides, _cells(starts), _cells(ends)])
    pairs = region[tuple(starts[kept].T)], region[tuple(ends[kept].T)]
    graph = coo_array((np.ones(len(pairs[0]), dtype=np.int8), pairs), shape=(count, count))
    parts, part = connected_components(graph, directed=False)
    outside = part[region[0, 0, 0]]
    part = part[region]  # of each cell
    some = np.zeros(parts, dtype=np.int64)  # a cell of each part
    some[part.ravel()] = np.arange(part.size)
    cells = _cells(np.stack(np.unravel_index(some, surface.shape), axis=1))
    enclosed = np.unique(part[~surface])
    enclosed = enclosed[enclosed != outside]
    told = np.arange(parts) if empty else enclosed if alike else np.zeros(0, np.int64)
    wound = np.full(parts, UNKNOWN, dtype=np.uint8)
    if len(told):  # at any cell of a part: first and last ones lie where rays meet edges, in symmetric objects
        order = np.random.default_rng(0).permutation(part.size)
        some[part.ravel()[order]] = order
        anywhere = _cells(np.stack(np.unravel_index(some[told], surface.shape), axis=1))
        wound[told] = _launch(_wind, len(told), [triangles, sides, anywhere]).view(np.uint8)
    both = bool((wound == TURNED).any() and (wound == ENCLOSED).any())
    wound[wound == TURNED] = ENCLOSED
    side = wound if empty else ENCLOSED * _launch(_enclose, parts, [triangles, sides, cells]).astype(np.uint8)
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


def _cells(cells: np.ndarray) -> wp.array:
    return wp.array(np.ascontiguousarray(cells, dtype=np.int32), dtype=wp.vec3i, device="cpu")


def _launch(kernel: wp.Kernel, count: int, inputs: list) -> np.ndarray:
    """``(count,)`` bool, what a kernel of one truth value an item answers."""
    out = wp.zeros(count, dtype=wp.uint8, device="cpu")
    launch_on_cores(kernel, count, inputs, [out], "cpu")
    return out.numpy().view(bool)
