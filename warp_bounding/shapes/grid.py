"""The shape that every proof is about: a union of closed, axis-aligned, occupied cells in n dimensions.

An axis of ``R`` cells maps an object coordinate ``x`` to the cell coordinate ``t = cells_per_unit * x - offset``; cell
``i`` is the closed interval ``|t - i| <= 1/2``. ``cells_per_unit`` has at most 24 significant bits, so the product
with a float32 ``x`` is exact in float64; ``offset`` is a multiple of 1/2, and the faces of cells are too, so the one
rounding of the difference never moves ``x`` out of a closed cell. On axes with an integer offset, a scale of at most
16 significant bits and at most 2^12 cells (voxelised meshes; images and voxel files) it moves ``x`` into none either:
the question whether ``x`` lies in a cell is answered *exactly*. The unit grid of an image or a voxel file has
``cells_per_unit = R - 1`` and ``offset = 0``: as in the paper's data set, the first and the last cell are centred on 0
and 1, and are whole. An axis of one cell is the unit interval itself.

What this file does not do: reading files (``load_shape``) and turning meshes into cells (``Mesh``).
"""

import hashlib
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from warp_bounding.errors import ShapeError
from warp_bounding.rounding import UNIT64
from warp_bounding.shapes.joints import Joints
from warp_bounding.shapes.shape import MAX_CELLS, Shape

# --- Blocks of cells --------------------------------------------------------------------------------------------------


def summed_area(occupancy: np.ndarray) -> np.ndarray:
    """The summed-area table ``(R_1 + 1, ...)`` int64: entry i counts the occupied cells before i on every axis."""
    table = np.zeros([r + 1 for r in occupancy.shape], dtype=np.int64)
    table[(slice(1, None),) * occupancy.ndim] = occupancy
    for axis in range(occupancy.ndim):
        np.cumsum(table, axis=axis, out=table)
    return table


def block_counts(table: np.ndarray, first: np.ndarray, end: np.ndarray) -> np.ndarray:
    """``(N,)`` int64, occupied cells in blocks by the ``summed_area``; 0 where a block has no cell.

    First cells and one past the last, ``(N, n)`` int64, are from 0 to the grid's shape.
    """
    end, count = np.maximum(end, first), np.zeros(len(first), dtype=np.int64)
    for sides in np.ndindex((2,) * table.ndim):
        corner = np.where(sides, end, first)
        count += (-1) ** (table.ndim - sum(sides)) * table[tuple(corner.T)]
    return count


def blocks_of(occupancy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Disjoint boxes of cells that cover what is occupied: halved along the longest axis until all are full or empty.

    First cells ``(N, n)`` int64 and one past the last.
    """
    table, ndim = summed_area(occupancy), occupancy.ndim
    first, last = np.zeros((1, ndim), np.int64), np.array([occupancy.shape], np.int64)
    found = []
    while len(first):
        count = block_counts(table, first, last)
        full = count == (last - first).prod(axis=1)
        found.append((first[full], last[full]))
        mixed = (count > 0) & ~full
        first, last = first[mixed], last[mixed]
        axis = np.argmax(last - first, axis=1)
        row = np.arange(len(first))
        middle = (first[row, axis] + last[row, axis]) // 2
        left_last, right_first = last.copy(), first.copy()
        left_last[row, axis] = middle
        right_first[row, axis] = middle
        first, last = np.concatenate([first, right_first]), np.concatenate([left_last, last])
    return tuple(np.concatenate(part) for part in zip(*found, strict=True))


# --- The grid ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class Grid(Shape):
    """An n-dimensional occupancy grid, placed in object space.

    Attributes:
        occupancy: ``(R_0, ..., R_{n-1})`` bool, read-only; coordinate k is array axis k.
        cells_per_unit: ``(n,)`` float64, cells per unit of object length, each a positive float32.
        offset: ``(n,)`` float64, multiples of 1/2.
        name: What it was read from, for messages and files: of a file its name, never the folder that it lies in.
        time: Coordinate 0 is time (an animated shape); a query outside its range has no certain answer.
        margin: How far the object was dilated before it was divided into cells, object units.
        resolution: The ``resolution`` that a mesh was voxelised with; ``None`` where the grid was given as one.
        note: A restriction that a user should know, such as that an open mesh is bounded by its surface only.
        remark: What else a user may want to know.
        shape_digest: ``geometry`` of the shape that was divided into these cells, or of the grid that was dilated;
            else ``None``.
        joints: Those of that shape.

    Raises:
        ShapeError: If all cells are empty, or all are occupied, or scale or offset are impossible.

    Example:
        >>> wb.shapes.Grid(ball)
        <Grid array: 3D, 16 x 16 x 16 cells, 912 occupied, extent 1.067 x 1.067 x 1.067>
        >>> wb.shapes.Grid(ball, cells_per_unit=[4, 4, 4], offset=[0, 0, 0]).upper
        array([3.875, 3.875, 3.875])
    """

    largest_delta = 1.0 / 16.0  # of a cell

    occupancy: np.ndarray
    cells_per_unit: np.ndarray = None
    offset: np.ndarray = None
    name: str = "array"
    time: bool = False
    margin: float = 0.0
    resolution: int | None = None
    note: str = field(default="", compare=False)
    shape_digest: str | None = field(default=None, compare=False)
    joints: Joints | None = field(default=None, compare=False)
    remark: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        given = np.asarray(self.occupancy)
        if given.dtype != bool and given.size and not ((given == 0) | (given == 1)).all():
            raise ShapeError(
                f"{self.name}: expected truth values, or 0 and 1, got {given.dtype} from {given.min()} to "
                f"{given.max()}; write which are "
                "occupied, such as (a >= 65) | (a < 0) of an OccupancyGrid, where what is unknown counts as occupied"
            )
        occupancy = np.array(given, dtype=bool, order="C")  # a copy, which the caller cannot change after a proof
        if occupancy.ndim < 1 or occupancy.size == 0:
            raise ShapeError(f"{self.name}: expected an array with at least one cell, got shape {occupancy.shape}")
        if occupancy.size > MAX_CELLS:
            raise ShapeError(f"{self.name}: expected at most {MAX_CELLS} cells, got {occupancy.size}")
        count = int(occupancy.sum())
        if count == 0:
            raise ShapeError(f"{self.name}: there is nothing to bound, all {occupancy.size} cells are empty")
        if count == occupancy.size:
            raise ShapeError(f"{self.name}: there is nothing to leave out, all {count} cells are occupied")
        occupancy.setflags(write=False)
        shape = np.array(occupancy.shape)
        unit_scale, unit_offset = np.where(shape > 1, shape - 1, 1), np.where(shape > 1, 0.0, 0.5)
        scale = unit_scale if self.cells_per_unit is None else self.cells_per_unit
        offset = unit_offset if self.offset is None else self.offset
        scale, offset = (np.array(a, dtype=np.float64).reshape(-1) for a in (scale, offset))
        if scale.shape != shape.shape or offset.shape != shape.shape:
            raise ShapeError(
                f"{self.name}: the map needs {shape.size} scales and offsets, got {scale.size}, {offset.size}"
            )
        if not (np.isfinite(scale) & (scale > 0) & (scale.astype(np.float32) == scale)).all():
            raise ShapeError(f"{self.name}: cells_per_unit must be positive float32 numbers, got {scale.tolist()}")
        if not (np.isfinite(offset) & (np.rint(2 * offset) == 2 * offset) & (np.abs(offset) < 2**22)).all():
            raise ShapeError(f"{self.name}: offset must hold multiples of 1/2 under 2^22, got {offset.tolist()}")
        for name, value in (("occupancy", occupancy), ("cells_per_unit", scale), ("offset", offset)):
            object.__setattr__(self, name, value)

    @property
    def counts(self) -> list[str]:
        return [f"{' x '.join(map(str, self.shape))} cells", f"{int(self.occupancy.sum()):,} occupied"]

    # --- where it is -------------------------------------------------------------------------------------------------

    @property
    def ndim(self) -> int:
        return self.occupancy.ndim

    @property
    def shape(self) -> tuple[int, ...]:
        """Cells along each axis."""
        return self.occupancy.shape

    @property
    def lower(self) -> np.ndarray:
        """``(n,)`` float64, the grid's lower corner in object space: where the first cells begin."""
        return self.position(np.full(self.ndim, -0.5))

    @property
    def upper(self) -> np.ndarray:
        """``(n,)`` float64, the grid's upper corner in object space: where the last cells end."""
        return self.position(np.array(self.shape) - 0.5)

    @property
    def sample_lower(self) -> np.ndarray:
        """``(n,)`` float64, where samplers begin: the first cell's centre (the paper's 0)."""
        return self.position(np.where(np.array(self.shape) > 1, 0.0, -0.5))

    @property
    def sample_upper(self) -> np.ndarray:
        """``(n,)`` float64, where samplers end: the last cell's centre (the paper's 1)."""
        shape = np.array(self.shape)
        return self.position(np.where(shape > 1, shape - 1.0, 0.5))

    @property
    def frame(self) -> tuple[np.ndarray, np.ndarray]:
        return self.lower, self.upper

    @property
    def details_per_unit(self) -> np.ndarray:
        return self.cells_per_unit

    def position(self, t: np.ndarray) -> np.ndarray:
        """Object coordinates of cell coordinates.

        Args:
            t: ``(..., n)``, cell coordinates; cell i spans [i - 1/2, i + 1/2].

        Returns:
            ``(..., n)`` float64, object space.

        Example:
            >>> grid.position([[0, 0, 0], [15, 15, 15]])
            array([[0., 0., 0.],
                   [1., 1., 1.]])
        """
        return (np.asarray(t, dtype=np.float64) + self.offset) / self.cells_per_unit

    def cell_coordinate(self, x: np.ndarray) -> np.ndarray:
        """Cell coordinates ``t`` of points, exact for float32 input.

        Args:
            x: ``(..., n)``, object space.

        Returns:
            ``(..., n)`` float64.

        Example:
            >>> grid.cell_coordinate(np.ones((1, 3), np.float32))
            array([[15., 15., 15.]])
        """
        return np.asarray(x).astype(np.float64) * self.cells_per_unit - self.offset

    # --- what it is --------------------------------------------------------------------------------------------------

    def decide(self, x: np.ndarray) -> np.ndarray:
        """In plain NumPy: is a closed occupied cell around them? Points outside the grid, and NaN, are in none."""
        with np.errstate(invalid="ignore", over="ignore"):
            t = self.cell_coordinate(x)
            first, last = np.ceil(t - 0.5), np.floor(t + 0.5)  # all cells i with |t - i| <= 1/2: one, or two on a face
        found = np.zeros(len(t), dtype=bool)
        for choice in np.ndindex((2,) * self.ndim):
            cell = np.where(choice, last, first)
            inside = ((cell >= 0) & (cell < self.shape)).all(axis=1)  # False for NaN
            index = np.where(inside[:, None], cell, 0).astype(np.int64)
            found |= inside & self.occupancy[tuple(index.T)]
        return found.astype(np.uint8)

    def empty(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        return (lower <= upper).all(axis=1) & (block_counts(self._table, *self._blocks(lower, upper)) == 0)

    def cells_beyond(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """``(K, n)``, those of ``occupied`` that reach outside the box with these corners, object space."""
        low, high = self.position(self.occupied - 0.5), self.position(self.occupied + 0.5)
        return self.occupied[((low < lower) | (high > upper)).any(axis=1)]

    def reaches_beyond(self, lower: np.ndarray, upper: np.ndarray) -> bool:
        return len(self.cells_beyond(lower, upper)) > 0

    def inside(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        first, end = self._blocks(lower, upper)
        whole = (lower >= self.lower).all(axis=1) & (upper <= self.upper).all(axis=1) & (lower <= upper).all(axis=1)
        return whole & (block_counts(self._table, first, end) == (end - first).prod(axis=1))

    def _blocks(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """All cells that closed boxes ``(N, n)`` float64 may meet: first ones, and one past the last."""
        sides = [np.asarray(side, dtype=np.float64) * self.cells_per_unit for side in (lower, upper)]
        room = 4 * UNIT64 * (np.maximum(*np.abs(sides)) + np.abs(self.offset))  # of two roundings
        low, high = sides[0] - self.offset - room, sides[1] - self.offset + room
        first, end = np.ceil(low - 0.5), np.floor(high + 0.5) + 1
        return tuple(np.clip(np.nan_to_num(side), 0, self.shape).astype(np.int64) for side in (first, end))

    @cached_property
    def _table(self) -> np.ndarray:
        return summed_area(self.occupancy)

    def distance(self, x: np.ndarray) -> np.ndarray:
        return self.distances(x)[:, 0]

    def distances(self, x: np.ndarray) -> np.ndarray:
        """See ``Shape``: distances to the occupied cells.

        Where coordinate 0 is time, distances are in space, at the point's time: infinite if no cell is occupied then.
        """
        found = self._distances(x)
        if self.time:
            found[(x[:, 0] < self.lower[0]) | (x[:, 0] > self.upper[0])] = 0.0, np.inf
        with np.errstate(over="ignore", invalid="ignore"):
            exact = (np.asarray(x).astype(np.float32) == x).all(axis=1)  # float32 points, of which ``contains`` is sure
        found[:, 1] = np.where(exact & self.contains(x), 0.0, found[:, 1])
        return found

    def depth(self, x: np.ndarray) -> np.ndarray:
        return np.where(self.contains(x), self._gaps(x)[:, 0], 0.0)

    def overestimate(
        self,
        lower: np.ndarray,
        upper: np.ndarray,
        values: np.ndarray,
        least: float,
        enough: np.ndarray | float = np.inf,
    ) -> np.ndarray | None:
        """See ``Shape``: tangents of the distances to all cells are taken off; ``None`` where coordinate 0 is time."""
        return None if self.time else self._distances.overestimate(lower, upper, values, least, enough)

    @cached_property
    def _gaps(self):
        """How far points are from empty cells; the grid's border is empty."""
        from warp_bounding.shapes.box_distances import BoxDistances

        first, past = blocks_of(~np.pad(self.occupancy, 1))
        return BoxDistances(self.position(first - 1.5), self.position(past - 1.5), time=self.time)

    @cached_property
    def _distances(self):
        from warp_bounding.shapes.box_distances import BoxDistances

        first, past = blocks_of(self.occupancy)
        return BoxDistances(self.position(first - 0.5), self.position(past - 0.5), time=self.time)

    def landmarks(self) -> np.ndarray:
        return self.position(self.boundary.astype(np.float64))

    @property
    def digest(self) -> str:
        """``geometry``: the cells are those of the dilated object."""
        return self.geometry

    @cached_property
    def geometry(self) -> str:
        """SHA-256 of the cells, scale and offset; the name and the way it was made do not enter."""
        sha = hashlib.sha256(b"warp-bounding grid 1")
        sha.update(np.array(self.shape, dtype="<i8").tobytes())
        sha.update(np.packbits(self.occupancy).tobytes())
        sha.update(self.cells_per_unit.astype("<f8").tobytes() + self.offset.astype("<f8").tobytes())
        sha.update(bytes([self.time]))
        return sha.hexdigest()

    @cached_property
    def occupied(self) -> np.ndarray:
        """``(M, n)`` int64 indices of the occupied cells."""
        return np.argwhere(self.occupancy)

    @cached_property
    def boundary(self) -> np.ndarray:
        """``(B, n)`` int64 indices of occupied cells that touch an empty cell, at a corner at least.

        Cells outside the grid count as occupied: nothing has to be separated from them.
        """
        interior = self.occupancy
        for axis in range(self.ndim):
            padded = np.pad(interior, [(int(k == axis),) * 2 for k in range(self.ndim)], constant_values=True)
            below, above = (np.take(padded, range(s, s + self.shape[axis]), axis=axis) for s in (0, 2))
            interior = below & interior & above
        return np.argwhere(self.occupancy & ~interior)

    # --- what can be made of it --------------------------------------------------------------------------------------

    def dilated(self, margin: float) -> "Grid":
        return self.to_grid(margin=margin)

    def to_grid(self, *, resolution: int | None = None, margin: float = 0.0) -> "Grid":
        """This grid, dilated: every cell within ``margin`` of an occupied cell becomes occupied.

        Args:
            resolution: Must be ``None``: a grid brings its own.
            margin: Object units, at least 0; cells are added around the grid where the dilated object needs them.

        Raises:
            ShapeError: For a resolution, or a negative or non-finite margin.

        Example:
            >>> wider = grid.to_grid(margin=0.1)
            >>> int(wider.occupancy.sum()) > int(grid.occupancy.sum())
            True
        """
        if resolution is not None and resolution != self.resolution:
            raise ShapeError(f"{self.name}: a grid brings its own resolution {self.shape}, got resolution={resolution}")
        margin = self._new_margin(margin)
        if margin is None:
            return self
        from warp_bounding.shapes.formula import dilate

        with np.errstate(over="ignore"):
            radius = margin * self.cells_per_unit
        occupancy, pad = dilate(self.occupancy, radius, static_axes=(0,) if self.time else ())
        return replace(
            self,
            occupancy=occupancy,
            cells_per_unit=self.cells_per_unit,
            offset=self.offset - pad,
            margin=margin,
            shape_digest=self.shape_digest or self.geometry,
        )


def grid_over(
    shape: Shape, occupancy: np.ndarray, scale: np.ndarray, offset: np.ndarray, margin: float, resolution: int
) -> Grid:
    """The grid of a dilated shape's cells, with the shape's name, notes, joints and digest."""
    return Grid(
        occupancy,
        cells_per_unit=scale,
        offset=offset,
        name=shape.name,
        time=shape.time,
        margin=margin,
        resolution=resolution,
        note=shape.restriction,
        remark=shape.remark,
        shape_digest=shape.geometry,
        joints=shape.joints,
    )
