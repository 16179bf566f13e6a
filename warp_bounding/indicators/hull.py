"""The corners of cells that the convex hull of a grid's object may have as vertices: decided in integers, none is lost.

A corner is dropped only where it is no extreme point for certain: it lies between two other corners of the object on a
grid line, or half-way between two of them. What is left holds all vertices of the hull, and few others.
"""

from itertools import product

import numpy as np

__all__ = ["hull_corners"]

REACH = 4  # steps along an axis up to which half-way points are looked for
MOST_STEPS = 4000  # directions that are tried


def hull_corners(occupancy: np.ndarray) -> np.ndarray:
    """Corners of occupied cells, among them all vertices of their convex hull.

    Args:
        occupancy: ``(R_0, ..., R_{n-1})`` bool.

    Returns:
        ``(V, n)`` float64 cell coordinates t; cell i spans [i - 1/2, i + 1/2].
    """
    n = occupancy.ndim
    corner = np.zeros(np.array(occupancy.shape) + 1, bool)
    for shift in product((0, 1), repeat=n):
        corner[tuple(slice(s, s + r) for s, r in zip(shift, occupancy.shape, strict=True))] |= occupancy
    extreme = corner.copy()
    for axis in range(n):  # the first or the last of its line, along every axis
        count = np.cumsum(corner, axis=axis)
        extreme &= (count == 1) | (count == np.take(count, [-1], axis=axis))
    points = np.argwhere(extreme & corner)
    reach = REACH
    while reach > 1 and (2 * reach + 1) ** n > MOST_STEPS:
        reach -= 1
    padded = np.pad(corner, reach)
    for step in product(range(-reach, reach + 1), repeat=n):
        if step > (0,) * n:
            there, back = (padded[tuple((points + reach + s * np.array(step)).T)] for s in (1, -1))
            points = points[~(there & back)]
    return points - 0.5
