"""How many occupied cells a block of a grid holds, from a table of sums."""

import numpy as np

__all__ = ["block_counts", "summed_area"]


def summed_area(occupancy: np.ndarray) -> np.ndarray:
    """The summed-area table ``(R_1 + 1, ...)`` int64: entry i counts the occupied cells before i on every axis."""
    table = np.zeros([r + 1 for r in occupancy.shape], dtype=np.int64)
    table[(slice(1, None),) * occupancy.ndim] = occupancy
    for axis in range(occupancy.ndim):
        np.cumsum(table, axis=axis, out=table)
    return table


def block_counts(table: np.ndarray, first: np.ndarray, end: np.ndarray) -> np.ndarray:
    """``(N,)`` int64, occupied cells in blocks; 0 where a block has no cell.

    Args:
        table: A grid's ``summed_area``.
        first: ``(N, n)`` int64, first cells, from 0 to the grid's shape.
        end: ``(N, n)`` int64, one past the last cells, from 0 to the grid's shape.
    """
    end, count = np.maximum(end, first), np.zeros(len(first), dtype=np.int64)
    for sides in np.ndindex((2,) * table.ndim):
        corner = np.where(sides, end, first)
        count += (-1) ** (table.ndim - sum(sides)) * table[tuple(corner.T)]
    return count
