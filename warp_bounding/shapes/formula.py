"""Shapes that are formulas; closed cells that hold a certified shape, their dilation, and cells of time."""

import math

import numpy as np

from warp_bounding.errors import ShapeError
from warp_bounding.shapes.grid import Grid, grid_over
from warp_bounding.shapes.shape import (
    MAX_CELLS,
    SCALE_BITS,
    Shape,
    cells_around,
    cells_per_unit,
    check_memory,
    checked_margin,
    checked_resolution,
)

# --- Cells of time ----------------------------------------------------------------------------------------------------

SPARE = 4  # up to so many more cells of time than requested are made where these fit the range better
LEFT = 0.01  # of a cell of time: as much may be left out at the ends of the range before other cells are tried


def time_axis(start: float, end: float, count: int, name: str) -> tuple[float, float, int]:
    """Cells of time that lie between two float32 times and leave little of the range out.

    A rate has few significant bits and a first face lies at a multiple of half a cell, so cells seldom begin and end
    where the range does. Of all rates for ``count`` to ``count + SPARE`` cells, this is the first that leaves out
    ``LEFT`` of a cell or less, or else the best: of 32 cells between random times, half leave out less than 0.2 % of
    the range, all less than 1.5 %.

    Returns:
        Cells per unit of time, where the first cell begins (in cells, a multiple of 1/2), and their number.

    Raises:
        ShapeError: If float32 cells cannot divide the range.
    """
    # Rates of at most SCALE_BITS significant bits, as ``cells_per_unit`` are (``shape``): float32 times then
    # have exact cell coordinates. Rates are whole numbers of steps, in ascending order.
    step = math.ldexp(1.0, math.frexp(cells_per_unit(end - start, count, name))[1] - SCALE_BITS)
    few, many = (n / (end - start) / step for n in (count, count + SPARE))
    mantissa = np.arange(np.ceil(few), np.floor(many) + 1)
    rate = step * mantissa[mantissa % 2.0 ** np.maximum(np.frexp(mantissa)[1] - SCALE_BITS, 0) == 0]
    begin = np.ceil(2 * start * rate) / 2  # exact, as the products are: 24 + 16 bits
    cells = np.floor(end * rate - begin)
    # One cell less where the difference was rounded up (an end much nearer to 0 than the start), so none passes the
    # range.
    cells -= begin + cells > end * rate
    left = (end - start) * rate - cells
    best = int(np.argmin(np.maximum(left, LEFT)))
    return float(rate[best]), float(begin[best]), int(cells[best])


# --- Dilation ---------------------------------------------------------------------------------------------------------
#
# Dilation of cells: which closed cells come within a distance of an occupied closed cell.

DILATED_BYTES = 26  # bytes a padded cell: three float64 arrays of squared distances, and two of truth values


def dilate(
    occupancy: np.ndarray, radius: np.ndarray, *, static_axes: tuple[int, ...] = ()
) -> tuple[np.ndarray, np.ndarray]:
    """Occupy every cell whose closed box comes within an ellipsoidal radius of an occupied one.

    Two cells whose indices differ by ``d`` along an axis are ``max(d - 1, 0)`` cells apart there. The squared distance
    is a sum over axes, so its minimum is taken axis by axis.

    Args:
        occupancy: n-D bool.
        radius: ``(n,)``, the distance in cells along each axis.
        static_axes: Axes along which nothing moves (time): no dilation there.

    Returns:
        The dilated array, larger where the object would leave it, and ``(n,)`` int, the cells added before each axis.

    Raises:
        ShapeError: Where the radius would need more cells than a grid may have.
    """
    radius = np.array([0.0 if k in static_axes else r for k, r in enumerate(radius)])
    if sum(math.log2(s + 2 * r + 2) for s, r in zip(occupancy.shape, radius, strict=True)) > math.log2(MAX_CELLS):
        largest = max(radius.tolist())
        raise ShapeError(f"expected a margin for which {MAX_CELLS} cells suffice, got one of up to {largest:g} cells")
    cells = math.prod(s + 2 * (r + 1) for s, r in zip(occupancy.shape, radius.tolist(), strict=True))
    check_memory(cells * DILATED_BYTES, f"dilating {occupancy.size:,} cells", "give a smaller margin or fewer cells")
    # Reach d is needed while (d - 1) / radius <= 1; the two factors keep rounding on the safe side.
    reach = np.array([math.floor(r * (1 + 1e-12)) + 1 if r > 0 else 0 for r in radius])
    padded = np.pad(occupancy, [(int(d),) * 2 for d in reach])
    squared = np.where(padded, 0.0, np.inf)  # distance to the nearest occupied cell, in radii
    for axis, (r, d) in enumerate(zip(radius.tolist(), reach.tolist(), strict=True)):
        if d:
            squared = _nearest_along(squared, axis, r, d)
    result = squared <= 1 + 1e-9
    # Padding that stayed empty (the object is not near that side) is cut off again; the given cells all stay.
    used = [np.flatnonzero(result.any(axis=tuple(a for a in range(result.ndim) if a != k))) for k in range(result.ndim)]
    crop_low = np.array([min(int(u[0]), int(d)) for u, d in zip(used, reach, strict=True)])
    crop_high = np.array([min(s - 1 - int(u[-1]), int(d)) for u, s, d in zip(used, result.shape, reach, strict=True)])
    cut = tuple(slice(int(a), s - int(b)) for a, b, s in zip(crop_low, crop_high, result.shape, strict=True))
    return result[cut], reach - crop_low


def _nearest_along(squared: np.ndarray, axis: int, radius: float, reach: int) -> np.ndarray:
    """Take the least sum of ``squared`` and the squared gap, over cells up to ``reach`` away along an axis."""
    result = squared.copy()
    source, target = np.moveaxis(squared, axis, 0), np.moveaxis(result, axis, 0)
    for step in range(1, reach + 1):
        cost = ((step - 1) / radius) ** 2 if step > 1 else 0.0
        np.minimum(target[step:], source[:-step] + cost, out=target[step:])
        np.minimum(target[:-step], source[step:] + cost, out=target[:-step])
    return result


# --- Cells ------------------------------------------------------------------------------------------------------------
#
# Closed cells that hold a shape, found by dividing blocks of cells until the shape certifies them empty.
#
# A block that the shape certifies to lie in it whole is not divided either, so the work goes to the shape's border. The
# corners of each block are rounded outwards, so a block that is left out holds no point of the object, its border
# included.

MOST_AXES = 4  # coordinates; a grid of more has too many cells to be of use
CELL_BYTES = 2  # bytes a cell: the grid, and its copy in the ``Grid``
BLOCK_BYTES = 200  # bytes a block of the finest level while it is requested: index, corners, and what the shape needs
BLOCKS_AT_ONCE = 2**18  # blocks that are asked for at a time
TIMES = 32  # cells of time


def _divide(shape: Shape, scale: np.ndarray, offset: np.ndarray, counts: tuple[int, ...]) -> np.ndarray:
    occupancy, limits = np.zeros(counts, dtype=bool), np.array(counts)
    halves = np.stack(np.meshgrid(*[[0, 1]] * len(counts), indexing="ij"), axis=-1).reshape(-1, len(counts))
    waiting = [(np.zeros((1, len(counts)), dtype=np.int64), 1 << (max(counts) - 1).bit_length())]
    while waiting:  # depth first, so that few blocks wait
        blocks, size = waiting.pop()
        if len(blocks) > BLOCKS_AT_ONCE:
            waiting += [(part, size) for part in np.array_split(blocks, -(-len(blocks) // BLOCKS_AT_ONCE))]
            continue
        ends = np.minimum(blocks + size, limits)
        lower = np.nextafter((blocks - 0.5 + offset) / scale, -np.inf)
        upper = np.nextafter((ends - 0.5 + offset) / scale, np.inf)
        left = ~shape.empty(lower, upper)
        blocks, ends, lower, upper = blocks[left], ends[left], lower[left], upper[left]
        if size == 1:
            occupancy[tuple(blocks.T)] = True
            continue
        whole = shape.inside(lower, upper)
        for block, end in zip(blocks[whole].tolist(), ends[whole].tolist(), strict=True):
            occupancy[tuple(slice(a, b) for a, b in zip(block, end, strict=True))] = True
        size //= 2
        blocks = (blocks[~whole][:, None] + halves * size).reshape(-1, len(counts))
        waiting.append((blocks[(blocks < limits).all(axis=1)], size))
    return occupancy


SEARCH = 20  # halvings of each side in a search for points of the object


class Formula(Shape):
    """A shape that is not made of cells or faces; cells can be laid over it.

    ``_bounds`` ``(2, n)`` float64 are the corners of a box that holds it, without a margin.
    """

    _bounds: np.ndarray

    @property
    def ndim(self) -> int:
        return self._bounds.shape[1]

    def to_grid(self, *, resolution: int | None = None, margin: float = 0.0) -> Grid:
        """See ``Shape``; the shape must certify boxes, and have ``MOST_AXES`` axes at most."""
        resolution, margin = checked_resolution(resolution), checked_margin(margin)
        if not self.certified:
            raise ShapeError(f"{self.name}: cells need a shape that certifies boxes empty, and this one cannot")
        if self.ndim > MOST_AXES:
            raise ShapeError(f"{self.name}: a grid has at most {MOST_AXES} coordinates, got {self.ndim}")
        shape, space = self.dilated(margin), slice(int(self.time), None)
        rate = cells_per_unit(float(shape.extent.max()), resolution, self.name)
        first, last = cells_around(shape.lower[space] * rate, shape.upper[space] * rate, 0.0, self.name)
        scale, offset, counts = np.full(len(first), rate), first.astype(np.float64), last - first + 1
        if self.time:
            often, begin, count = time_axis(float(shape.lower[0]), float(shape.upper[0]), TIMES, self.name)
            scale, offset, counts = np.r_[often, scale], np.r_[begin + 0.5, offset], np.r_[count, counts]
        counts = tuple(counts.tolist())
        what = f"{self.name}: dividing it into {' x '.join(map(str, counts))} cells"
        surface = math.prod(counts) / min(counts)
        check_memory(math.prod(counts) * CELL_BYTES + surface * BLOCK_BYTES, what, "give a coarser resolution")
        return grid_over(shape, _divide(shape, scale, offset, counts), scale, offset, margin, resolution)

    def check_contents(self, *, count: int = 4096, seed: int = 0) -> None:
        x = np.random.default_rng(seed).uniform(self.sample_lower, self.sample_upper, (count, self.ndim))
        held = self.contains(x)
        if held.all():
            raise ShapeError(f"{self.name}: there is nothing to leave out, {count} random points are in the object")
        if not held.any() and not self._found(count):
            raise ShapeError(f"{self.name}: there is nothing to bound, a search found no point in the object")

    def _found(self, most: int) -> bool:
        """Whether the centre of a box is in the object, of boxes that are halved where they are not certified empty."""
        lower, upper, space = self.lower[None], self.upper[None], np.arange(self.ndim)
        for depth in range(SEARCH * self.ndim if self.certified else 0):
            left = ~self.empty(lower, upper)
            lower, upper = lower[left][:most], upper[left][:most]
            middle = lower + (upper - lower) / 2
            if self.contains(middle).any():
                return True
            half = space == depth % self.ndim
            lower = np.concatenate([lower, np.where(half, middle, lower)])
            upper = np.concatenate([np.where(half, middle, upper), upper])
        return False
