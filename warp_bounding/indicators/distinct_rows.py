"""Distinct rows of an array, as ``np.unique(rows, axis=0)`` finds them, several times as fast: columns are sorted one by one."""

import numpy as np

__all__ = ["distinct_rows"]


def distinct_rows(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows in lexicographic order, each once.

    Args:
        rows: ``(N, k)`` numbers without NaN.

    Returns:
        ``(U, k)`` the distinct rows; ``(U,)`` int64, where each occurs first; and ``(N,)`` int64, which of them each row is.
    """
    order = np.lexsort(rows.T[::-1])  # stable: the first of equal rows comes first
    ordered = rows[order]
    new = np.ones(len(rows), dtype=bool)
    new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    number = np.empty(len(rows), dtype=np.int64)
    number[order] = np.cumsum(new) - 1
    return ordered[new], order[new], number
