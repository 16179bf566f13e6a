"""Cover of a grid's occupied cells by few disjoint boxes of cells, all of them full: where a search may start."""

import numpy as np

from warp_bounding.indicators.grid import IndicatorGrid

__all__ = ["full_blocks"]


def full_blocks(grid: IndicatorGrid) -> tuple[np.ndarray, np.ndarray]:
    """Halve the grid along its longest axis until every box is full or empty (a k-d tree over a summed-area table).

    Args:
        grid: The object.

    Returns:
        First cells ``(N, n)`` int64 and one past the last cells ``(N, n)``; the boxes are disjoint and cover the object.
    """
    table = np.zeros([r + 1 for r in grid.shape], dtype=np.int64)
    table[(slice(1, None),) * grid.ndim] = grid.occupancy
    for axis in range(grid.ndim):
        np.cumsum(table, axis=axis, out=table)
    first, last = np.zeros((1, grid.ndim), np.int64), np.array([grid.shape], np.int64)
    found = []
    while len(first):
        count = np.zeros(len(first), dtype=np.int64)
        for corner in np.ndindex((2,) * grid.ndim):
            sign = (-1) ** (grid.ndim - sum(corner))
            count += sign * table[tuple(np.where(corner, last, first).T)]
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
