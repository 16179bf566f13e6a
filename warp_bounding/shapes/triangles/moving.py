"""The sides of a closed surface that moves: grids over pieces of time whose cells know them."""

import math
from itertools import pairwise

import numpy as np
import warp as wp

from warp_bounding.runtime.launch import launch_on_cores
from warp_bounding.shapes.triangles.cells import BORDER, ENCLOSED, INNER, OUTSIDE, UNKNOWN
from warp_bounding.shapes.triangles.hierarchy import (
    MovingTriangles,
    Ways,
    beyond,
    during,
    is_enclosed,
    segment_is_free,
    span_of,
)

# Is a point outside a closed surface that moves, at all times of a span? Grids over pieces of time know cells that are.
#
# What counts as inside at a time is what a flood from outside does not reach then. That may change where no face comes
# near: a vase that closes its neck makes its hollow part of the object. So it is not enough to be outside at one time,
# and each grid stands for a piece of time in which vertices go about a cell. A cell that meets no face at any time of
# the piece is free. What is connected with the grid's border through free cells is outside at all times of the piece;
# any other part of the free cells is enclosed at all of them if a ray proves it of one point at one time, because the
# number of faces that a way to infinity crosses, modulo 2, changes only where a face passes.
#
# A point is outside in a span if it is so in each piece: by its own cell, or by a cell nearby that is outside and to
# which a short segment is proven to meet no face at any time of the span in the piece.
#
# Grids are made when they are first asked for. All of a motion's together are small (``MOST_BYTES``).

# Cells along the longest side of a grid; the first that is cheap enough counts.
RESOLUTIONS = (96, 64, 48, 32, 24, 16, 8)
WAY = 1.0  # cells that a vertex goes in a piece, at most
MOST_BYTES = 2**26  # of all grids of a motion
MOST_PIECES = 1024  # between two keyframes: in pieces of a longer way vertices go farther
MOST_CELLS = 2 * RESOLUTIONS[0]  # along a side of a grid: where vertices go far in a piece, its cells are larger
FARTHEST = 5  # cells: how far a segment to a cell may reach
MOST_REGIONS, ASKED = 32, 8  # parts of the free cells that may be enclosed, and cells of each that rays are sent from
MOST_SEGMENTS = 14  # segments that are tried in a piece

_UNKNOWN, _OUTSIDE, _ENCLOSED = wp.constant(UNKNOWN), wp.constant(OUTSIDE), wp.constant(ENCLOSED)
_FARTHEST, _MOST_SEGMENTS = wp.constant(FARTHEST), wp.constant(MOST_SEGMENTS)
_INNER = wp.constant(wp.float64(INNER))
_HALF = wp.constant(wp.float64(0.5))


@wp.struct
class Pieces:
    """What kernels take. Without closed parts there are no pieces, and every point is outside."""

    count: int  # all of them
    rounding: wp.float64  # by which faces may be elsewhere
    first: wp.array(dtype=wp.int32)  # (K,), of the pieces after each keyframe
    known: wp.array(dtype=wp.uint8)  # whether a piece has its grid
    lower: wp.array(dtype=wp.vec3d)  # the box around the faces in a piece, rounding included
    upper: wp.array(dtype=wp.vec3d)
    origin: wp.array(dtype=wp.vec3d)  # centre of cell 0
    scale: wp.array(dtype=wp.float64)  # cells per unit
    shape: wp.array(dtype=wp.vec3i)
    begin: wp.array(dtype=wp.int64)  # of a piece's cells
    cells: wp.array(dtype=wp.uint8)  # UNKNOWN, OUTSIDE or ENCLOSED


@wp.func
def _cell(p: Pieces, piece: int, cell: wp.vec3i) -> int:
    shape = p.shape[piece]
    for k in range(3):
        if cell[k] < 0 or cell[k] >= shape[k]:
            return _OUTSIDE
    place = (wp.int64(cell[0]) * wp.int64(shape[1]) + wp.int64(cell[1])) * wp.int64(shape[2]) + wp.int64(cell[2])
    return int(p.cells[p.begin[piece] + place])


@wp.func
def _own_cell(p: Pieces, piece: int, x: wp.vec3d) -> wp.vec3i:
    own, t = wp.vec3i(), (x - p.origin[piece]) * p.scale[piece]
    for k in range(3):
        own[k] = int(wp.floor(t[k] + _HALF))
    return own


@wp.func
def _known_side(p: Pieces, piece: int, x: wp.vec3d) -> int:
    """The side of a point at all times of a piece, as its cell tells."""
    if p.known[piece] == wp.uint8(0):
        return _UNKNOWN
    if beyond(x, p.lower[piece], p.upper[piece]):
        return _OUTSIDE
    return _cell(p, piece, _own_cell(p, piece, x))


@wp.func
def _leads_to(t: Ways, p: Pieces, piece: int, x: wp.vec3d, side: int) -> bool:
    """Is it proven, by a segment to a cell of a side, that x is on this side at all times of a span in a piece?"""
    place = (x - p.origin[piece]) * p.scale[piece]
    own = _own_cell(p, piece, x)
    tried = wp.int32(0)
    for far in range(1, _FARTHEST + 1):
        for way in range(27):
            step = wp.vec3i(way // 9 - 1, (way // 3) % 3 - 1, way % 3 - 1) * far
            cell = own + step
            if way != 13 and _cell(p, piece, cell) == side:
                end = wp.vec3d()
                for k in range(3):
                    middle = wp.float64(cell[k])
                    end[k] = wp.clamp(place[k], middle - _INNER, middle + _INNER)
                if segment_is_free(t, x, p.origin[piece] + end / p.scale[piece], p.rounding):
                    return True
                tried += 1
                if tried >= _MOST_SEGMENTS:
                    return False
    return False


@wp.func
def _piece_at(p: Pieces, key: int, share: wp.float64) -> int:
    count = p.first[key + 1] - p.first[key]
    return p.first[key] + wp.min(int(share * wp.float64(count)), count - 1)


@wp.func
def outside_in(t: Ways, p: Pieces, x: wp.vec3d) -> bool:
    """Is it proven that x, finite numbers, is outside at all times of the span?"""
    if p.count == 0:
        return True
    key = t.span.key
    begin, end = _piece_at(p, key, t.span.begin), _piece_at(p, key, t.span.end)
    for piece in range(begin, end + 1):
        if _known_side(p, piece, x) == _ENCLOSED:
            return False
    queried = wp.bool(False)
    for piece in range(begin, end + 1):
        if _known_side(p, piece, x) != _OUTSIDE:
            if p.known[piece] == wp.uint8(0):
                return False
            if not queried:
                if is_enclosed(during(t, span_of(key, t.span.begin, t.span.begin)), x):
                    return False
                queried = True
            count = wp.float64(p.first[key + 1] - p.first[key])
            number = piece - p.first[key]
            begins = wp.max(t.span.begin, wp.float64(number) / count)
            part = span_of(key, begins, wp.min(t.span.end, wp.float64(number + 1) / count))
            if not _leads_to(during(t, part), p, piece, x, _OUTSIDE):
                return False
    return True


@wp.func
def side_in(t: Ways, p: Pieces, x: wp.vec3d) -> int:
    """The side of x at the time of the span, a single one, if x is farther than the rounding from all faces."""
    if p.count == 0:
        return _OUTSIDE
    piece = _piece_at(p, t.span.key, t.span.begin)
    side = _known_side(p, piece, x)
    if side != _UNKNOWN:
        return side
    if is_enclosed(t, x):
        return _ENCLOSED
    if p.known[piece] == wp.uint8(0):
        return _UNKNOWN
    if _leads_to(t, p, piece, x, _OUTSIDE):
        return _OUTSIDE
    if _leads_to(t, p, piece, x, _ENCLOSED):
        return _ENCLOSED
    return _UNKNOWN


@wp.kernel(enable_backward=False)
def _enclose(
    first: int,
    # inputs
    ways: Ways,
    key: int,
    share: wp.float64,
    centres: wp.array(dtype=wp.vec3d),
    # outputs
    enclosed: wp.array(dtype=wp.uint8),
):
    """Is a centre proven to be enclosed?"""
    i, _ = wp.tid()
    i += first
    enclosed[i] = wp.uint8(is_enclosed(during(ways, span_of(key, share, share)), centres[i]))


class MovingSides:
    """The grids, on the CPU, of a motion whose faces ``(F, 3)`` are of closed parts and elsewhere by the rounding."""

    def __init__(self, triangles: MovingTriangles, frames: np.ndarray, faces: np.ndarray, rounding: float):
        self._triangles, self._rounding = triangles, rounding
        used, faces = np.unique(faces, return_inverse=True)
        self._faces, self._used, self._frames = faces.reshape(-1, 3).astype(np.int32), used, frames
        self._size, self._counts, self._cell_bytes = 1.0, np.zeros(len(frames) - 1, dtype=np.int64), []
        if len(faces):
            self._plan()
        first = np.concatenate([[0], np.cumsum(self._counts)]).astype(np.int32)
        count = int(first[-1])
        room = int((self._counts * self._cell_bytes).sum()) if count else 0
        self._arrays = {
            "first": (first, wp.int32),
            "known": (np.zeros(count, dtype=np.uint8), wp.uint8),
            "lower": (np.zeros((count, 3)), wp.vec3d),
            "upper": (np.zeros((count, 3)), wp.vec3d),
            "origin": (np.zeros((count, 3)), wp.vec3d),
            "scale": (np.zeros(count), wp.float64),
            "shape": (np.zeros((count, 3), dtype=np.int32), wp.vec3i),
            "begin": (np.zeros(count, dtype=np.int64), wp.int64),
            "cells": (np.empty(room, dtype=np.uint8), wp.uint8),
        }
        self._next = 0  # cell that is free
        self.pieces = Pieces()
        self.pieces.count, self.pieces.rounding = count, wp.float64(rounding)
        for name, (array, dtype) in self._arrays.items():
            setattr(self.pieces, name, wp.array(array, dtype=dtype, device="cpu", copy=False))

    def _plan(self) -> None:
        """Choose how large cells are, and how many pieces there are between keyframes."""
        corners = [f[self._used].astype(np.float64) for f in self._frames]
        boxes = np.array([[f.min(axis=0), f.max(axis=0)] for f in corners])
        ways = np.array([np.linalg.norm(b - a, axis=1).max() for a, b in pairwise(corners)])
        sides = np.maximum((boxes[:-1, 1] - boxes[:-1, 0]), (boxes[1:, 1] - boxes[1:, 0]))
        self._size = float(sides.max())
        for resolution in RESOLUTIONS:
            cell = self._size / resolution
            self._counts = np.clip(np.ceil(ways / (WAY * cell)), 1, MOST_PIECES).astype(np.int64)
            # In a piece the box of the faces is larger than at its ends by the way of a piece at most.
            piece = sides + (ways / self._counts)[:, None] + 4 * self._rounding
            piece = np.ceil(np.minimum(piece / cell, MOST_CELLS)) + 5
            self._cell_bytes = np.prod(piece, axis=1).astype(np.int64)
            self._cell = cell
            if (self._counts * self._cell_bytes).sum() <= MOST_BYTES:
                break

    def know(self, spans: np.ndarray) -> None:
        """Make the grids of some spans ``(N, 2)`` float64, keyframes plus shares, first and last times."""
        if not self.pieces.count:
            return
        first, known = self._arrays["first"][0], self._arrays["known"][0]
        k = np.clip(np.floor(spans).astype(int), 0, len(self._counts) - 1)
        place = np.clip((spans - k) * self._counts[k], 0, self._counts[k] - 1)
        begin, end = (first[k] + place).T
        # A piece more where rounding could tell them apart: a piece that is not known is no error, only no answer.
        begin = np.floor(begin - 1e-6).astype(int).clip(0)
        end = np.floor(end + 1e-6).astype(int).clip(None, len(known) - 1)
        queried = np.bincount(begin, minlength=len(known) + 1) - np.bincount(end + 1, minlength=len(known) + 1)
        for piece in np.flatnonzero((np.cumsum(queried)[:-1] > 0) & (known == 0)):
            self._make(int(piece))

    def _make(self, piece: int) -> None:
        from warp_bounding.shapes.triangles.cells import SLACK, surface_cells

        array = {name: a for name, (a, _) in self._arrays.items()}
        key = int(np.searchsorted(array["first"], piece, side="right")) - 1
        count = self._counts[key]
        shares = (piece - int(array["first"][key]) + np.array([0.0, 0.5, 1.0])) / count
        start, end = (self._frames[k][self._used].astype(np.float64) for k in (key, key + 1))
        low, middle, high = ((1 - s) * start + s * end for s in shares)
        lower = np.minimum(low, high).min(axis=0) - 2 * self._rounding
        upper = np.maximum(low, high).max(axis=0) + 2 * self._rounding
        cell = max(self._cell, float((upper - lower).max()) / MOST_CELLS)
        origin = lower - BORDER * cell
        half_way = np.linalg.norm(high - low, axis=1)[self._faces].max(axis=1) / 2
        shape = tuple((np.floor((upper - origin) / cell + 0.5).astype(int) + 3).tolist())
        dilation = (half_way + self._rounding) / cell * (1 + 1e-9) + SLACK
        surface = surface_cells((middle - origin) / cell, self._faces, shape, dilation)
        cells = self._sides(surface, key, shares[1], origin, cell)
        size = math.prod(shape)
        if self._next + size > len(array["cells"]):
            raise AssertionError("the room for cells was planned too small")
        array["cells"][self._next : self._next + size] = cells.ravel()
        array["begin"][piece], self._next = self._next, self._next + size
        array["lower"][piece], array["upper"][piece], array["origin"][piece] = lower, upper, origin
        array["scale"][piece], array["shape"][piece], array["known"][piece] = 1 / cell, shape, 1

    def _sides(self, surface: np.ndarray, key: int, share: float, origin: np.ndarray, cell: float) -> np.ndarray:
        from scipy import ndimage

        region, regions = ndimage.label(~surface)
        outside = region[0, 0, 0]
        numbers = [number for number in range(1, regions + 1) if number != outside][:MOST_REGIONS]
        cells = [np.flatnonzero(region == number) for number in numbers]
        queried = np.array([c[np.linspace(0, len(c) - 1, ASKED).astype(int)] for c in cells], dtype=int).ravel()
        centres = origin + np.stack(np.unravel_index(queried, surface.shape), axis=1) * cell
        enclosed = np.zeros(len(queried), dtype=np.uint8)
        self._triangles.know(np.array([key, key + 1]))
        inputs = [self._triangles.ways, key, wp.float64(share), wp.array(centres, dtype=wp.vec3d, device="cpu")]
        answers = wp.array(enclosed, dtype=wp.uint8, device="cpu", copy=False)
        launch_on_cores(_enclose, len(queried), inputs, [answers], "cpu")
        side = np.full(regions + 1, UNKNOWN, dtype=np.uint8)
        side[np.repeat(numbers, ASKED)[enclosed > 0].astype(int)] = ENCLOSED
        side[outside] = OUTSIDE
        return side[region]
