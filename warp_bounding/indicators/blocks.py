"""Cover of a grid's occupied cells by few disjoint boxes of cells, all of them full: where a search may start."""

import numpy as np

from warp_bounding.indicators.summed_area import summed_area

__all__ = ["blocks_of"]


def blocks_of(occupancy: np.ndarray, flat: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Halve a grid along its longest axis until every box is full or empty (a k-d tree over a summed-area table).

    Args:
        occupancy: bool, n axes.
        flat: An axis along which boxes are one cell thick; none if ``None``.

    Returns:
        First cells ``(N, n)`` int64 and one past the last cells ``(N, n)``; the boxes are disjoint and cover what is
        occupied.
    """
    table, ndim = summed_area(occupancy), occupancy.ndim
    layers = 1 if flat is None else occupancy.shape[flat]
    first, last = np.zeros((layers, ndim), np.int64), np.tile(occupancy.shape, (layers, 1)).astype(np.int64)
    if flat is not None:
        first[:, flat], last[:, flat] = np.arange(layers), np.arange(layers) + 1
    found = []
    while len(first):
        count = np.zeros(len(first), dtype=np.int64)
        for corner in np.ndindex((2,) * ndim):
            sign = (-1) ** (ndim - sum(corner))
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
