"""Closed cells that hold a shape, found by dividing blocks of cells until the shape certifies them empty.

A block that the shape certifies to lie in it whole is not divided either, so the work goes to the shape's border. The
corners of each block are rounded outwards, so a block that is left out holds no point of the object, its border
included.
"""

import math

import numpy as np

from warp_bounding.errors import IndicatorError
from warp_bounding.indicators.functions.intervals import lower_of, upper_of
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.limits import (
    cells_around,
    cells_per_unit,
    check_memory,
    checked_margin,
    checked_resolution,
)
from warp_bounding.indicators.moving.time_axis import time_axis
from warp_bounding.indicators.shape import Shape

__all__ = ["MOST_AXES", "cells_of"]

MOST_AXES = 4  # coordinates; a grid of more has too many cells to be of use
CELL_BYTES = 2  # bytes a cell: the grid, and its copy in the ``IndicatorGrid``
BLOCK_BYTES = 200  # bytes a block of the finest level while it is asked for: index, corners, and what the shape needs
CHUNK = 2**18  # blocks that are asked for at a time
TIMES = 32  # cells of time


def cells_of(shape: Shape, resolution: int | None, margin: float) -> IndicatorGrid:
    """The cells that a shape and its margin may meet.

    Args:
        shape: A certified shape of at most ``MOST_AXES`` coordinates, not dilated or dilated by ``margin``.
        resolution: Cells along the longest side of the dilated object, 2 to 1024; 64 for ``None``. Time has ``TIMES``.
        margin: Object units, at least 0.

    Raises:
        IndicatorError: For a shape without certificates or of too many coordinates, an impossible resolution or
            margin, or more cells than this machine can hold.
    """
    resolution, margin = checked_resolution(resolution), checked_margin(margin)
    if not shape.certified:
        raise IndicatorError(f"{shape.name}: cells need a shape that certifies boxes empty, and this one cannot")
    if shape.ndim > MOST_AXES:
        raise IndicatorError(f"{shape.name}: a grid has at most {MOST_AXES} coordinates, got {shape.ndim}")
    shape = shape.dilated(margin)
    scale, first, counts = _axes(shape, resolution)
    what = f"{shape.name}: dividing it into {' x '.join(map(str, counts))} cells"
    surface = math.prod(counts) / min(counts)
    check_memory(math.prod(counts) * CELL_BYTES + surface * BLOCK_BYTES, what, "give a coarser resolution")
    return IndicatorGrid(
        _divide(shape, scale, first, counts),
        cells_per_unit=scale,
        offset=first,
        name=shape.name,
        time=shape.time,
        margin=margin,
        resolution=resolution,
        note=shape.restriction,
        shape_digest=shape.geometry,
        joints=shape.joints,
    )


def _axes(shape: Shape, resolution: int) -> tuple[np.ndarray, np.ndarray, tuple[int, ...]]:
    """Cells per unit, the offset, and the number of cells of each axis."""
    space = slice(1 if shape.time else 0, None)
    rate = cells_per_unit(float(shape.extent.max()), resolution, shape.name)
    first, last = cells_around(shape.lower[space] * rate, shape.upper[space] * rate, 0.0, shape.name)
    scale, offset, counts = np.full(len(first), rate), first.astype(np.float64), last - first + 1
    if shape.time:
        often, begin, count = time_axis(float(shape.lower[0]), float(shape.upper[0]), TIMES, shape.name)
        scale, offset, counts = np.r_[often, scale], np.r_[begin + 0.5, offset], np.r_[count, counts]
    return scale, offset, tuple(counts.tolist())


def _divide(shape: Shape, scale: np.ndarray, offset: np.ndarray, counts: tuple[int, ...]) -> np.ndarray:
    occupancy, limits = np.zeros(counts, dtype=bool), np.array(counts)
    halves = np.stack(np.meshgrid(*[[0, 1]] * len(counts), indexing="ij"), axis=-1).reshape(-1, len(counts))
    waiting = [(np.zeros((1, len(counts)), dtype=np.int64), 1 << (max(counts) - 1).bit_length())]
    while waiting:  # depth first, so that few blocks wait
        blocks, size = waiting.pop()
        if len(blocks) > CHUNK:
            waiting += [(part, size) for part in np.array_split(blocks, -(-len(blocks) // CHUNK))]
            continue
        ends = np.minimum(blocks + size, limits)
        lower, upper = (lower_of((blocks - 0.5 + offset) / scale), upper_of((ends - 0.5 + offset) / scale))
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
