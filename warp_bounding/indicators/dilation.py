"""Dilation of cells: which closed cells come within a distance of an occupied closed cell."""

import math

import numpy as np

from warp_bounding.errors import IndicatorError
from warp_bounding.indicators.limits import MAX_CELLS, check_memory

__all__ = ["dilate"]

CELL_BYTES = 26  # bytes a padded cell: three float64 arrays of squared distances, and two of truth values


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
        IndicatorError: Where the radius would need more cells than a grid may have.
    """
    radius = np.array([0.0 if k in static_axes else r for k, r in enumerate(radius)])
    if sum(math.log2(s + 2 * r + 2) for s, r in zip(occupancy.shape, radius, strict=True)) > math.log2(MAX_CELLS):
        largest = max(radius.tolist())
        raise IndicatorError(
            f"expected a margin for which {MAX_CELLS} cells suffice, got one of up to {largest:g} cells"
        )
    cells = math.prod(s + 2 * (r + 1) for s, r in zip(occupancy.shape, radius.tolist(), strict=True))
    check_memory(cells * CELL_BYTES, f"dilating {occupancy.size:,} cells", "give a smaller margin or fewer cells")
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
