"""Smallest enclosing balls and ellipsoids of a grid's cells, with a proven gap to the optimum.

All three are one concave problem over weights ``u`` on the points (a design problem, see Todd, *Minimum-Volume
Ellipsoids*, SIAM 2016): with ``mu`` and ``C`` the mean and covariance under ``u``,

* ball of least radius: maximise ``trace C``; the radius squared is its optimum;
* axis-aligned ellipsoid of least volume: maximise ``log det diag C``;
* ellipsoid of least volume: maximise ``log det C`` (Khachiyan's problem).

Frank-Wolfe steps with away steps move weight towards the farthest point or away from the nearest weighted one, with an
exact line search. Scaling the current ellipsoid to hold all points gives an upper bound, the dual a lower one; the
search stops when they agree to ``GAP``.
"""

import numpy as np

from warp_bounding.errors import BounderError
from warp_bounding.indicators.grid import IndicatorGrid

__all__ = ["enclosing_ellipsoid"]

GAP = 1e-4  # relative, in squared length: 0.005 % in radius
MOST_STEPS = 20_000


def enclosing_ellipsoid(grid: IndicatorGrid, family: str) -> tuple[np.ndarray, np.ndarray]:
    """The smallest ``{x: |A (x - center)| <= 1}`` of a family around all occupied cells.

    Args:
        grid: The object.
        family: ``"trace"`` (balls), ``"diagonal"`` (axis-aligned ellipsoids) or ``"determinant"`` (all ellipsoids).

    Returns:
        ``A`` ``(n, n)`` float64 and the centre ``(n,)``, object space; A holds the points up to float64 rounding.

    Raises:
        BounderError: If the search does not close the gap (it always has).
    """
    points = extreme_corners(grid)
    origin, size = points.mean(axis=0), np.ptp(points, axis=0).max()
    points = (points - origin) / size
    weights = np.full(len(points), 1.0 / len(points))
    n = points.shape[1]
    for _ in range(MOST_STEPS):
        mean = weights @ points
        offset = points - mean
        covariance = (offset * weights[:, None]).T @ offset
        shape, goal = _metric(covariance, family)
        distance = np.einsum("ij,jk,ik->i", offset, shape, offset)
        far = int(np.argmax(distance))
        if distance[far] <= goal * (1 + GAP):
            scale = np.linalg.cholesky(shape / distance[far]).T
            return scale / size, mean * size + origin
        used = np.flatnonzero(weights > 0)
        near = int(used[np.argmin(distance[used])])
        away = distance[far] - goal < goal - distance[near] and weights[near] < 1
        index = near if away else far
        most = weights[near] / (1 - weights[near]) if away else 1.0
        step = _line_search(covariance, offset[index], family, -1.0 if away else 1.0, most)
        if away and step >= most * (1 - 1e-9):
            step = most
        step = -step if away else step
        weights *= 1 - step
        weights[index] = max(weights[index] + step, 0.0)
        if away and -step >= most * (1 - 1e-12):
            weights[index] = 0.0
        weights /= weights.sum()
    raise BounderError(f"no enclosing ellipsoid within {GAP} after {MOST_STEPS} steps in {n}D")


def extreme_corners(grid: IndicatorGrid) -> np.ndarray:
    """Cell corners that can be vertices of the convex hull: first or last on every grid line through them.

    Returns:
        ``(P, n)`` float64, object space.
    """
    corners = np.pad(grid.occupancy, [(0, 1)] * grid.ndim)
    for axis in range(grid.ndim):  # corner i belongs to cells i - 1 and i
        corners = corners | np.roll(corners, 1, axis=axis)
    keep = corners
    for axis in range(grid.ndim):
        first = np.maximum.accumulate(corners, axis=axis)
        last = np.flip(np.maximum.accumulate(np.flip(corners, axis), axis=axis), axis)
        before, after = np.roll(first, 1, axis=axis), np.roll(last, -1, axis=axis)
        index = [slice(None)] * grid.ndim
        index[axis] = slice(0, 1)
        before[tuple(index)] = False
        index[axis] = slice(-1, None)
        after[tuple(index)] = False
        keep = keep & ~(before & after)
    return grid.position(np.argwhere(keep) - 0.5)


def _metric(covariance: np.ndarray, family: str) -> tuple[np.ndarray, float]:
    """The matrix whose quadratic form is the gradient of the goal, and the value it has on the optimum's contacts."""
    n = len(covariance)
    if family == "trace":
        return np.eye(n), float(np.trace(covariance))
    if family == "diagonal":
        return np.diag(1.0 / np.diag(covariance)), float(n)
    return np.linalg.inv(covariance), float(n)


def _line_search(covariance: np.ndarray, direction: np.ndarray, family: str, sign: float, most: float) -> float:
    """Step in (0, most] that maximises the goal; C becomes ``(1 - s) (C + s d d^T)`` after a (signed) step s."""

    def slope(step: float) -> float:
        s = sign * step
        moved = (1 - s) * (covariance + s * np.outer(direction, direction))
        change = -covariance + (1 - 2 * s) * np.outer(direction, direction)
        shape, _ = _metric(moved, family)
        return sign * float((shape * change).sum())

    low, high = 0.0, most * (1 - 1e-9) if family != "trace" else most
    if slope(high) >= 0:
        return high
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (middle, high) if slope(middle) > 0 else (low, middle)
    return (low + high) / 2
