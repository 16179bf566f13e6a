"""Connected components of a grid's closed cells, and few corners that have the same convex hull.

Closed cells are connected through corners too (3^n - 1 neighbours). The hull of a component is the hull of its cells'
corners, which are integers. Dropped are corners strictly between two others on an axis-parallel line, and those that
Qhull (Barber, Dobkin, Huhdanpaa 1996) finds inside: each of the latter only after *integer* arithmetic has found it in
a simplex of corners that stay, so no rounding in Qhull can lose an extreme corner. Of a mesh's vertices, which are no
integers, those that are dropped lie so near to a convex sum of others that the hull is widened by what they miss.
"""

from dataclasses import dataclass
from math import factorial
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from warp_bounding.arithmetic import UNIT64, gamma
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.shape import Shape

__all__ = [
    "Component",
    "Hull",
    "components",
    "connected_labels",
    "hull_corners",
    "hull_of",
    "hull_points",
    "line_ends",
    "whole_hull",
]

FEW_CORNERS = 48  # of so many corners or fewer all are kept: to find their hull takes longer than it saves
WALKS = 8  # searches for one corner, from as many facets: flat facets of Qhull's triangulation end some of them
LONGEST_WALK = 200  # facets that the search for one corner visits before the corner is kept for lack of a proof
MISSED = 1e-9  # of the size: a point that is farther from the convex sum that was found for it is kept
AT_A_TIME = 1 << 22  # numbers in an intermediate array


class Hull(NamedTuple):
    """A convex set that holds an object: the convex hull of points, dilated."""

    points: np.ndarray  # (P, n) float64, object space
    radius: float  # object units, Euclidean in space


@dataclass(frozen=True)
class Component:
    """A connected component."""

    lower: np.ndarray  # (n,) int64, its first cells
    upper: np.ndarray  # (n,) int64, its last cells
    corners: np.ndarray  # (V, n) int64, corner j is at cell coordinates j - 1/2; their hull is the component's hull


def connected_labels(occupancy: np.ndarray) -> np.ndarray:
    """``(M,)`` integers: the number of its component for each occupied cell of a bool grid, in the order of ``np.argwhere``."""
    from scipy import ndimage

    return ndimage.label(occupancy, np.ones((3,) * occupancy.ndim))[0][occupancy] - 1


def line_ends(cells: np.ndarray) -> np.ndarray:
    """``(P, n)`` corners of cells that are the first or the last on each of the n axis-parallel lines through them."""
    n, lower = cells.shape[1], cells.min(axis=0)
    corner = np.zeros(cells.max(axis=0) - lower + 2, dtype=bool)
    for shift in np.ndindex((2,) * n):
        corner[tuple((cells - lower + shift).T)] = True
    extreme = corner.copy()
    for axis in range(n):
        up = np.cumsum(corner, axis=axis, dtype=np.int32)
        extreme &= (up == 1) | (up == np.take(up, [-1], axis=axis))
    return np.argwhere(extreme) + lower


def _determinant(a: np.ndarray) -> np.ndarray:
    """The determinants ``(...)`` of integer matrices ``(..., k, k)``, exactly."""
    if a.shape[-1] == 1:
        return a[..., 0, 0]
    columns = range(a.shape[-1])
    return sum((-1) ** j * a[..., 0, j] * _determinant(np.delete(a[..., 1:, :], j, axis=-1)) for j in columns)


def _cofactors(a: np.ndarray) -> np.ndarray:
    """The cofactors ``(F, n, n)`` of integer matrices, exactly: ``a @ cofactors.T = det I``."""
    n = a.shape[-1]
    if n == 1:
        return np.ones_like(a)
    minors = (np.delete(np.delete(a, i, axis=1), j, axis=2) for i in range(n) for j in range(n))
    signs = np.where(np.indices((n, n)).sum(axis=0) % 2, -1, 1)
    return np.stack([_determinant(m) for m in minors], axis=1).reshape(-1, n, n) * signs


def _in_simplices(points: np.ndarray, apex: np.ndarray, facets: np.ndarray, neighbors: np.ndarray, start: np.ndarray):
    """Which integer points ``(P, n)`` were found to lie in a simplex of the apex and one of the facets' corners ``(F, n, n)``.

    From the facet ``start`` ``(P,)`` near each point the search walks through the most negative weight, to the facet
    opposite to that corner (``neighbors`` ``(F, n)``).
    """
    edges = facets - apex
    cofactors = _cofactors(edges)
    determinant = (edges[:, 0] * cofactors[:, 0]).sum(axis=1)
    cofactors *= np.sign(determinant)[:, None, None]
    determinant = np.abs(determinant)
    inside = np.zeros(len(points), dtype=bool)
    lost, at, d = np.arange(len(points)), start, points - apex
    for _ in range(LONGEST_WALK):
        weights = (cofactors[at] * d[:, None, :]).sum(axis=2)  # barycentric coordinates, times the determinant
        least = weights.argmin(axis=1)
        found = (weights[np.arange(len(at)), least] >= 0) & (determinant[at] > 0)
        inside[lost[found]] = (weights.sum(axis=1) <= determinant[at])[found]
        lost, d, at = lost[~found], d[~found], neighbors[at, least][~found]
        if len(lost) == 0:
            break
    return inside


def hull_corners(cells: np.ndarray) -> np.ndarray:
    """Corners ``(V, n)`` of cells ``(M, n)``, int64, among which are all vertices of the cells' convex hull, and few others."""
    corners = line_ends(cells)
    n, size = corners.shape[1], int(np.ptp(corners, axis=0).max())
    if n < 2 or len(corners) <= FEW_CORNERS or n * factorial(n) * (2 * n * size) ** n >= 2**62:  # 64 bits must do
        return corners
    from scipy.spatial import ConvexHull, KDTree, QhullError

    try:
        hull = ConvexHull(corners)
    except QhullError:
        return corners
    kept = np.zeros(len(corners), dtype=bool)
    kept[hull.simplices.reshape(-1)] = True
    outer = corners[kept]
    ends = np.concatenate([outer[outer.argmin(axis=0)], outer[outer.argmax(axis=0)]])
    apex, scaled = ends.sum(axis=0), 2 * n * corners  # in units of 1 / 2n: the mean of 2n corners that stay
    facets, dropped = scaled[hull.simplices], scaled[~kept]
    around = [v / np.linalg.norm(v, axis=1, keepdims=True) for v in (facets.mean(axis=1) - apex, dropped - apex + 0.5)]
    inside = np.zeros(len(dropped), dtype=bool)
    for start in KDTree(around[0]).query(around[1], k=range(1, min(WALKS, len(facets)) + 1))[1].T:
        left = np.flatnonzero(~inside)
        inside[left] = _in_simplices(dropped[left], apex, facets, hull.neighbors, start[left])
    kept[~kept] = ~inside
    return corners[kept]


def hull_points(grid: IndicatorGrid) -> np.ndarray:
    """``(V, n)`` float64, object space: points of an object among which are all vertices of its convex hull."""
    return grid.position(hull_corners(grid.occupied) - 0.5)


def components(occupancy: np.ndarray) -> list[Component]:
    """The connected components of the closed cells of a bool grid, the largest first."""
    labels, cells = connected_labels(occupancy), np.argwhere(occupancy)
    order = np.argsort(labels, kind="stable")
    groups = np.split(cells[order], np.flatnonzero(np.diff(labels[order])) + 1)
    found, sides = [], np.array(list(np.ndindex((2,) * occupancy.ndim)))
    for group in sorted(groups, key=len, reverse=True):
        lower, upper = group.min(axis=0), group.max(axis=0)
        box = len(group) == np.prod(upper - lower + 1)
        found.append(Component(lower, upper, lower + sides * (upper - lower + 1) if box else hull_corners(group)))
    return found


_HULLS: WeakKeyDictionary[Shape, Hull] = WeakKeyDictionary()


def hull_of(shape: Shape) -> Hull | None:
    """A convex set that holds a shape and is about its convex hull, rounding included; ``None`` where none is known."""
    if shape not in _HULLS:
        if isinstance(shape, IndicatorGrid):
            _HULLS[shape] = Hull(hull_points(shape), 0.0)
        else:
            corners = shape.corners()
            if corners is None:
                return None
            points, missed = few_points(corners)
            _HULLS[shape] = Hull(points, float(np.nextafter(shape.margin + missed, np.inf)))
    return _HULLS[shape]


def whole_hull(shape: Shape) -> Hull | None:
    """The convex hull of a shape without cells by all the points that it names, exactly; ``None`` where it names none.

    It takes no time to find, and is the one to ask about few directions.
    """
    corners = None if isinstance(shape, IndicatorGrid) else shape.corners()
    return None if corners is None else Hull(corners, shape.margin)


def few_points(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Points ``(P, n)`` with about the same convex hull as those given, and by how much it may be too small."""
    n, size = points.shape[1], float(np.ptp(points, axis=0).max())
    if len(points) <= FEW_CORNERS:
        return points, 0.0
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
    except QhullError:
        return points, 0.0
    kept = np.zeros(len(points), dtype=bool)
    kept[hull.vertices] = True
    apex, missed = points[kept].mean(axis=0), np.zeros(len(points))
    facets = points[hull.simplices] - apex  # (F, n, n)
    reach = -(hull.equations[:, :n] @ apex + hull.equations[:, n])
    ahead = hull.equations[:, :n] / np.maximum(reach, np.finfo(float).tiny)[:, None]
    dropped, step = np.flatnonzero(~kept), max(1, AT_A_TIME // len(ahead))
    for start in range(0, len(dropped), step):
        part = dropped[start : start + step]
        d = points[part] - apex
        corners = facets[np.argmax(d @ ahead.T, axis=1)]  # of the facet that the ray from the apex leaves through
        weights = np.linalg.solve(corners.swapaxes(1, 2) + _singular(corners), d[..., None])[..., 0]
        weights = np.maximum(np.concatenate([weights, 1 - weights.sum(axis=1, keepdims=True)], axis=1), 0)
        weights /= weights.sum(axis=1, keepdims=True)
        found = np.einsum("pi,pik->pk", weights[:, :n], corners)
        missed[part] = np.linalg.norm(d - found, axis=1)
    kept |= ~(missed <= MISSED * size)  # NaN is kept
    # The apex is a mean of P points, and each sum has n + 1 terms.
    rounding = gamma(len(points) + 16 * n, UNIT64) * float(np.abs(points).max()) * n
    return points[kept], float(missed[~kept].max(initial=0.0)) * (1 + 1e-9) + rounding


def _singular(corners: np.ndarray) -> np.ndarray:
    """What makes the matrices of flat simplices invertible: then the sum that is found misses the point, which is kept."""
    flat = ~(np.abs(np.linalg.det(corners)) > 0)
    return flat[:, None, None] * np.eye(corners.shape[-1])
