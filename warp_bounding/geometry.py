"""Hulls of cells and meshes, enclosing balls and ellipsoids and their reach, and inverses with bounded errors."""

import math
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations, product
from math import comb, factorial
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from warp_bounding.errors import BounderError
from warp_bounding.rounding import UNIT64, gamma
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.shape import Shape

# Connected components of a grid's closed cells, and few corners that have the same convex hull.
#
# Closed cells are connected through corners too (3^n - 1 neighbours). The hull of a component is the hull of its
# cells' corners, which are integers. Dropped are corners strictly between two others on an axis-parallel line, and
# those that Qhull (Barber, Dobkin, Huhdanpaa 1996) finds inside: each of the latter only after *integer* arithmetic
# has found it in a simplex of corners that stay, so no rounding in Qhull can lose an extreme corner. Of a mesh's
# vertices, which are no integers, those that are dropped lie so near to a convex sum of others that the hull is
# widened by what they miss.

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
    """Which integer points ``(P, n)`` certainly lie in a simplex of the apex and a facet's corners ``(F, n, n)``.

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
    """Int64 corners ``(V, n)`` of cells ``(M, n)``: all vertices of their convex hull, and few others."""
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


def components(occupancy: np.ndarray) -> list[Component]:
    """The connected components of the closed cells of a bool grid, the largest first."""
    from scipy import ndimage

    labels = ndimage.label(occupancy, np.ones((3,) * occupancy.ndim))[0][occupancy]
    cells = np.argwhere(occupancy)
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
        if isinstance(shape, Grid):
            _HULLS[shape] = Hull(shape.position(hull_corners(shape.occupied) - 0.5), 0.0)
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
    corners = None if isinstance(shape, Grid) else shape.corners()
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
        # A flat simplex is made invertible: the sum then misses the point, which is kept.
        flat = ~(np.abs(np.linalg.det(corners)) > 0)
        matrices = corners.swapaxes(1, 2) + flat[:, None, None] * np.eye(n)
        weights = np.linalg.solve(matrices, d[..., None])[..., 0]
        weights = np.maximum(np.concatenate([weights, 1 - weights.sum(axis=1, keepdims=True)], axis=1), 0)
        weights /= weights.sum(axis=1, keepdims=True)
        found = np.einsum("pi,pik->pk", weights[:, :n], corners)
        missed[part] = np.linalg.norm(d - found, axis=1)
    kept |= ~(missed <= MISSED * size)  # NaN is kept
    # The apex is a mean of P points, and each sum has n + 1 terms.
    rounding = gamma(len(points) + 16 * n, UNIT64) * float(np.abs(points).max()) * n
    return points[kept], float(missed[~kept].max(initial=0.0)) * (1 + 1e-9) + rounding


# Smallest enclosing balls and ellipsoids of a grid's cells or of points, with a proven gap to the optimum.
#
# All three are one concave problem over weights ``u`` on the points (a design problem, see Todd, *Minimum-Volume
# Ellipsoids*, SIAM 2016): with ``mu`` and ``C`` the mean and covariance under ``u``,
#
# * ball of least radius: maximise ``trace C``; the radius squared is its optimum;
# * axis-aligned ellipsoid of least volume: maximise ``log det diag C``;
# * ellipsoid of least volume: maximise ``log det C`` (Khachiyan's problem).
#
# Frank-Wolfe steps with away steps move weight towards the farthest point or away from the nearest weighted one, with
# an exact line search. Scaling the current ellipsoid to hold all points gives an upper bound, the dual a lower one;
# the search stops when they agree to ``GAP``. Few points matter: it is fitted to some of them, and those that it
# leaves out join.

GAP = 1e-4  # relative, in squared length: 0.005 % in radius
MOST_STEPS = 20_000  # of Frank-Wolfe, for one set of points
DIRECTIONS = 64  # random ones whose outermost points the ellipsoid is fitted to first
JOINING = 64  # points that join these at a time
MOST_ROUNDS = 12  # of ellipsoids around dilated points, each also around the farthest places of the one before it
STEPS_OF_ROUND = 3000  # of Frank-Wolfe
ASCENTS = 12  # steps towards the farthest place of a dilated point
TINIEST = 1e-300  # a divisor in place of zero
THIN = 1e-4  # of the size: what is thinner, such as a sheet, is taken to be so thick, since no ellipsoid is flat


def enclosing_of_points(points: np.ndarray, family: str) -> tuple[np.ndarray, np.ndarray]:
    """The smallest ``{x: |A (x - center)| <= 1}`` of a family around points ``(P, n)``, up to float64 rounding.

    Args:
        points: In any units, such as samples of queries.
        family: ``"trace"`` (balls), ``"diagonal"`` (axis-aligned ellipsoids) or ``"determinant"`` (all ellipsoids).

    Returns:
        ``A`` ``(n, n)`` float64 and the centre ``(n,)``; ``BounderError`` if the search does not end (it always
            has).
    """
    origin, size = points.mean(axis=0), np.ptp(points, axis=0).max()
    points = _thickened((points - origin) / size, family)
    chosen = _outermost(points)
    weights = np.full(len(chosen), 1.0 / len(chosen))
    while True:
        mean, shape, goal, weights, closed = _enclose(points[chosen], weights, family, MOST_STEPS)
        if not closed:
            raise BounderError(f"no enclosing ellipsoid within {GAP} after {MOST_STEPS} steps in {points.shape[1]}D")
        offset = points - mean
        distance = np.einsum("ij,jk,ik->i", offset, shape, offset)
        if distance.max() <= goal * (1 + GAP):
            scale = np.linalg.cholesky(shape / distance.max()).T
            return scale / size, mean * size + origin
        # The ellipsoid of a part of the points bounds the optimum of all from below; those farthest out join the part.
        distance[chosen] = 0.0
        more = np.argsort(distance)[-JOINING:]
        more = more[distance[more] > goal]
        chosen = np.concatenate([chosen, more])
        weights = np.concatenate([weights, np.zeros(len(more))])


def enclosing_of_hull(points: np.ndarray, radii: np.ndarray, family: str) -> tuple[np.ndarray, np.ndarray]:
    """``enclosing_of_points`` around points ``(P, n)`` that are dilated by an ellipsoid with half axes ``(n,)``.

    A holds the dilated points but for what ``MOST_ROUNDS`` may leave, which a proof must charge.
    """
    if not radii.any():
        return enclosing_of_points(points, family)
    from warp_bounding.shapes.surfaces import distinct_rows

    points, _, _ = distinct_rows(points)
    origin, size = points.mean(axis=0), np.ptp(points, axis=0).max()
    points, radii = _thickened((points - origin) / size, family), radii / size
    chosen = _outermost(points)
    weights = np.full(len(chosen), 1.0 / len(chosen))
    places = points + _farthest_places(points, radii, np.eye(len(radii)), np.zeros(len(radii)))
    for _ in range(MOST_ROUNDS):
        mean, shape, goal, weights = _enclose(places[chosen], weights, family, STEPS_OF_ROUND)[:4]
        matrix = np.linalg.cholesky(shape / goal).T
        places = points + _farthest_places(points, radii, matrix, mean)
        reach = np.linalg.norm((places - mean) @ matrix.T, axis=1)
        largest = max(float(reach.max()), 1.0)
        if largest**2 <= 1 + GAP:
            break
        # Those that carry no weight leave, and the others have moved: each stands for its point's farthest place.
        chosen, weights = chosen[weights > 0], weights[weights > 0]
        reach[chosen] = 0.0
        more = np.argsort(reach)[-JOINING:]
        more = more[reach[more] > 1]
        chosen, weights = np.concatenate([chosen, more]), np.concatenate([weights, np.zeros(len(more))])
    return matrix / largest / size, mean * size + origin


def _thickened(points: np.ndarray, family: str) -> np.ndarray:
    """The points ``(P, n)``, of size 1.

    If they are flat in a direction that matters to the family, they are there twice, ``THIN`` apart.
    """
    if family == "trace":
        return points
    directions = np.eye(points.shape[1])
    if family == "determinant":
        centred = points - points.mean(axis=0)
        directions = np.linalg.eigh(centred.T @ centred)[1].T
    for direction in directions[np.ptp(points @ directions.T, axis=0) < THIN]:
        points = np.concatenate([points - THIN / 2 * direction, points + THIN / 2 * direction])
    return points


def _farthest_places(points: np.ndarray, radii: np.ndarray, matrix: np.ndarray, center: np.ndarray) -> np.ndarray:
    """``(P, n)``: moves of points in their dilation to about the farthest in the metric ``|A (x - center)|``."""
    stretched, z = matrix * radii, (points - center) @ matrix.T
    u = np.zeros_like(points)
    for _ in range(ASCENTS):  # as in power iteration
        u = (z + u @ stretched.T) @ stretched
        u /= np.maximum(np.linalg.norm(u, axis=1, keepdims=True), TINIEST)
    return radii * u


def _outermost(points: np.ndarray) -> np.ndarray:
    """Indices of points that are farthest out along an axis or in a random direction."""
    n = points.shape[1]
    directions = np.concatenate([np.eye(n), np.random.default_rng(0).normal(size=(DIRECTIONS, n))])
    along = points @ directions.T
    return np.unique(np.concatenate([along.argmin(axis=0), along.argmax(axis=0)]))


def _enclose(
    points: np.ndarray, weights: np.ndarray, family: str, steps: int
) -> tuple[np.ndarray, np.ndarray, float, np.ndarray, bool]:
    """Centre, metric, objective and weights of the smallest member of a family around points, from initial weights.

    The last is whether the gap was closed in so many steps.
    """
    n = points.shape[1]
    for _ in range(steps):
        mean = weights @ points
        offset = points - mean
        covariance = (offset * weights[:, None]).T @ offset
        shape, goal = _metric(covariance, family)
        distance = np.einsum("ij,jk,ik->i", offset, shape, offset)
        far = int(np.argmax(distance))
        if distance[far] <= goal * (1 + GAP / 2):
            return mean, shape, goal, weights, True
        used = np.flatnonzero(weights > 0)
        near = int(used[np.argmin(distance[used])])
        away = distance[far] - goal < goal - distance[near] and weights[near] < 1
        index = near if away else far
        most = weights[near] / (1 - weights[near]) if away else 1.0
        step = max(_line_search(_ratios(covariance, offset[index], distance[index], family), n, family), -most)
        if away and step <= -most * (1 - 1e-9):
            step = -most
        weights = weights * (1 - step)
        weights[index] = max(weights[index] + step, 0.0)
        if away and step == -most:
            weights[index] = 0.0
        weights /= weights.sum()
    return mean, shape, goal, weights, False


def _metric(covariance: np.ndarray, family: str) -> tuple[np.ndarray, float]:
    """The matrix whose quadratic form is the gradient of the goal, and the value it has on the optimum's contacts."""
    n = len(covariance)
    if family == "trace":
        return np.eye(n), float(np.trace(covariance))
    if family == "diagonal":
        return np.diag(1.0 / np.diag(covariance)), float(n)
    return np.linalg.inv(covariance), float(n)


def _ratios(covariance: np.ndarray, direction: np.ndarray, distance: float, family: str) -> list[float]:
    """The ratios r of a step s: the logarithm of the goal changes by ``m log(1 - s) + sum log(1 + s r)``."""
    if family == "trace":
        return [distance / float(np.trace(covariance))]
    if family == "diagonal":
        return (direction**2 / np.diag(covariance)).tolist()
    return [distance]


def _line_search(ratios: list[float], n: int, family: str) -> float:
    """The signed step s < 1 that maximises the goal; C becomes ``(1 - s) (C + s d d^T)``.

    The slope is that of ``-m / (1 - s) + sum of r / (1 + s r)``, which falls; m is 1 for balls, and n otherwise.
    """
    m = 1 if family == "trace" else n
    if max(ratios) <= 0:  # a point at the mean: the less of it the better
        return -math.inf
    if len(ratios) == 1:
        return (ratios[0] - m) / (ratios[0] * (1 + m))

    def slope(s: float) -> float:
        return sum(r / (1 + s * r) for r in ratios) - m / (1 - s)

    low, high = (0.0, 1.0 - 1e-9) if slope(0.0) > 0 else (-1.0 / max(ratios) * (1 - 1e-9), 0.0)
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (middle, high) if slope(middle) > 0 else (low, middle)
    return (low + high) / 2


# How far ellipsoids of one shape, around many centres, reach from the origin.
#
# The farthest point of ``{z + M u: |u| <= 1}`` maximises a convex quadratic, ``|z|^2 + 2 c . u + u^T B u`` with ``c =
# M^T z`` and ``B = M^T M``. For every number l above the largest eigenvalue of B that is at most
#
#     |z|^2 + l + sum_i g_i^2 / (l - d_i),
#
# with d the eigenvalues and g the coordinates of c along the eigenvectors, and with the best l it is the maximum
# itself (the dual of a trust-region problem; Conn, Gould, Toint, *Trust-Region Methods*, SIAM 2000, ch. 7). So no
# choice of l can be wrong, and a decomposition that float64 has found is charged what it misses.

HALVINGS = 60  # of the interval in which the best l lies
APART = 1e-12  # relative: l lies at least so far above the largest eigenvalue


def farthest(centres: np.ndarray, matrix: np.ndarray) -> float:
    """Upper bound of ``|z + M u|`` over centres z ``(P, r)`` and ``|u| <= 1``, exact up to 1e-12; M is ``(r, n)``."""
    length = np.linalg.norm(centres, axis=1)
    outward = 1 + gamma(4 * sum(matrix.shape) + 32, UNIT64)
    if not matrix.any():
        return float(length.max()) * outward
    across = float(np.linalg.norm(matrix)) * outward  # no less than the largest singular value
    along = centres @ matrix
    norm = np.linalg.norm(along, axis=1)
    # One point of each ellipsoid: those that cannot reach as far as the farthest of these are not looked at.
    u = along / np.where(norm > 0, norm, 1.0)[:, None]
    known = float(np.linalg.norm(centres + u @ matrix.T, axis=1).max()) / outward
    near = length * outward + across >= known
    return min(float(length.max() + across), float(np.sqrt(_dual(centres[near], matrix)))) * outward


def _dual(centres: np.ndarray, matrix: np.ndarray) -> float:
    """The square of ``farthest``, by the dual."""
    n, few = matrix.shape[1], gamma(4 * sum(matrix.shape) + 32, UNIT64)
    gram = matrix.T @ matrix
    d, vectors = np.linalg.eigh(gram)
    size = float((matrix * matrix).sum())
    # B differs from V D V^T by this at most, in any direction; and V from a rotation.
    missed = float(np.linalg.norm(gram - (vectors * d) @ vectors.T)) + 8 * n * few * size
    turned = float(np.linalg.norm(vectors.T @ vectors - np.eye(n))) + 2 * n * few
    length = np.linalg.norm(centres, axis=1)[:, None]
    reach = length * np.sqrt(size)  # at least |c|
    g = np.abs(centres @ matrix @ vectors) + (8 * n * few + turned) * reach
    most = np.linalg.norm(g, axis=1, keepdims=True)
    low = np.full_like(most, d[-1] * (1 + APART) + np.finfo(float).tiny)
    high = low + most
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        with np.errstate(over="ignore", divide="ignore"):
            rises = ((g / (middle - d)) ** 2).sum(axis=1, keepdims=True) <= 1
        low, high = np.where(rises, low, middle), np.where(rises, middle, high)
    rest = (g * g / (high - d)).sum(axis=1, keepdims=True)
    value = length * length + high * (1 + 3 * turned) + rest + missed * (1 + 3 * turned) + 4 * turned * reach
    return float(value.max()) * (1 + few)


# Inverses and polytope vertices in float64, each with a bound of its error: regions are tested against edges and
# vertices.
#
# An inverse is checked afterwards (Rump, *Verification methods*, Acta Numerica 2010, sect. 10): from ``A B = I - R``
# follows ``|A^-1 - B| <= |B| |R| / (1 - |R|)``. Vertices are found by solving for every choice of n slabs; a choice
# whose inverse cannot be checked must be singular in rational arithmetic, so that no vertex is ever missed.

MOST_VERTEX_DIMENSIONS = 6  # choices of slabs grow with the factorial of the dimension
MERGED = 2.0**-20  # units of the slabs: vertices in one cube of this size become one point
MOST_CHOICES = 1 << 20  # choices of n slabs that may meet in a vertex: a file may not ask for more work
LARGEST_REST = 0.01  # of |R|: a matrix with a larger one is too close to singular


def checked_inverse(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """The inverse of an ``(n, n)`` float64 matrix and a bound ``(n, n)`` of its error; ``None`` if there is none."""
    n = len(matrix)
    scale = np.abs(matrix).max(axis=1)
    if not (np.isfinite(scale).all() and (scale > 0).all()):
        return None
    scale = 2.0 ** np.round(np.log2(scale))  # exact scaling
    matrix = matrix / scale[:, None]
    try:
        inverse = np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        return None
    size = np.abs(matrix) @ np.abs(inverse) + np.eye(n)
    if not np.isfinite(size).all():
        return None
    rest = np.abs(np.eye(n) - matrix @ inverse) + gamma(n + 2, UNIT64) * size
    ratio = rest.sum(axis=1).max() * (1 + 1e-12)
    if not ratio < LARGEST_REST:
        return None
    error = np.repeat(np.abs(inverse).sum(axis=1, keepdims=True), n, axis=1) * (ratio / (1 - ratio) * (1 + 1e-12))
    return inverse / scale, error / scale


def polytope_vertices(directions: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points whose hull holds the polytope ``low <= directions y <= high``, up to a stated error.

    Directions ``(k, n)``, low and high ``(k,)`` are float64 and taken as exact.

    Returns:
        Points ``(P, n)`` float32 and errors ``(P, n)`` float64: every vertex of the polytope is within the error of one
        of the points, per axis.

    Raises:
        BounderError: If the polytope is not bounded, or a vertex is beyond what float64 can tell.
    """
    k, n = directions.shape
    if k < n:
        raise BounderError("the slabs do not bound a polytope")
    if comb(k, n) > MOST_CHOICES:
        raise BounderError(f"expected at most {MOST_CHOICES} choices of {n} slabs, got {comb(k, n)} of {k} slabs")
    found, errors = [], []
    sides = np.array(list(product((0, 1), repeat=n)))
    for chosen in combinations(range(k), n):
        part = directions[list(chosen)]
        inverse = checked_inverse(part)
        if inverse is None:
            if _singular_choice(part):
                continue
            raise BounderError("slabs are so close to parallel that float64 cannot find where they meet")
        right = np.where(sides, high[list(chosen)], low[list(chosen)])
        y = right @ inverse[0].T
        error = np.abs(right) @ (inverse[1] + gamma(n + 2, UNIT64) * np.abs(inverse[0])).T
        at = y @ directions.T
        room = 2 * (error + gamma(n + 2, UNIT64) * np.abs(y)) @ np.abs(directions).T
        keep = ((at >= low - room) & (at <= high + room)).all(axis=1)
        found.append(y[keep])
        errors.append(error[keep])
    vertices, error = np.concatenate([np.zeros((0, n)), *found]), np.concatenate([np.zeros((0, n)), *errors])
    if len(vertices) <= n:
        raise BounderError("the slabs do not bound a polytope")
    keys, first, group = np.unique(np.round(vertices / MERGED), axis=0, return_index=True, return_inverse=True)
    points = vertices[first].astype(np.float32)
    away = np.abs(vertices - points[group.reshape(-1)].astype(np.float64)) * (1 + 1e-12) + error
    largest = np.zeros((len(keys), n))
    np.maximum.at(largest, group.reshape(-1), away)
    return points, largest


def _singular_choice(matrix: np.ndarray) -> bool:
    """Whether a matrix of floats is singular, in rational arithmetic."""
    rows = [[Fraction(float(x)) for x in row] for row in matrix]
    for column in range(len(rows)):
        pivot = next((r for r in range(column, len(rows)) if rows[r][column] != 0), None)
        if pivot is None:
            return True
        rows[column], rows[pivot] = rows[pivot], rows[column]
        for r in range(column + 1, len(rows)):
            factor = rows[r][column] / rows[column][column]
            rows[r] = [a - factor * b for a, b in zip(rows[r], rows[column], strict=True)]
    return False
