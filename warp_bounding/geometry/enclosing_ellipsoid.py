"""Smallest enclosing balls and ellipsoids of a grid's cells or of points, with a proven gap to the optimum.

All three are one concave problem over weights ``u`` on the points (a design problem, see Todd, *Minimum-Volume
Ellipsoids*, SIAM 2016): with ``mu`` and ``C`` the mean and covariance under ``u``,

* ball of least radius: maximise ``trace C``; the radius squared is its optimum;
* axis-aligned ellipsoid of least volume: maximise ``log det diag C``;
* ellipsoid of least volume: maximise ``log det C`` (Khachiyan's problem).

Frank-Wolfe steps with away steps move weight towards the farthest point or away from the nearest weighted one, with an
exact line search. Scaling the current ellipsoid to hold all points gives an upper bound, the dual a lower one; the
search stops when they agree to ``GAP``. Few points matter: it is fitted to some of them, and those that it leaves out
join.
"""

import math

import numpy as np

from warp_bounding.errors import BounderError
from warp_bounding.geometry.hull import line_ends
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.surfaces import distinct_rows

__all__ = ["enclosing_ellipsoid", "enclosing_of_hull", "enclosing_of_points", "extreme_corners"]

GAP = 1e-4  # relative, in squared length: 0.005 % in radius
MOST_STEPS = 20_000  # of Frank-Wolfe, for one set of points
DIRECTIONS = 64  # random ones whose outermost points the ellipsoid is fitted to first
JOINING = 64  # points that join these at a time
MOST_ROUNDS = 12  # of ellipsoids around dilated points, each also around the farthest places of the one before it
STEPS_OF_ROUND = 3000  # of Frank-Wolfe
ASCENTS = 12  # steps towards the farthest place of a dilated point
TINIEST = 1e-300  # a divisor in place of zero
THIN = 1e-4  # of the size: what is thinner, such as a sheet, is taken to be so thick, since no ellipsoid is flat


def enclosing_ellipsoid(grid: IndicatorGrid, family: str) -> tuple[np.ndarray, np.ndarray]:
    """``enclosing_of_points`` around all occupied cells, in object space."""
    return enclosing_of_points(extreme_corners(grid), family)


def enclosing_of_points(points: np.ndarray, family: str) -> tuple[np.ndarray, np.ndarray]:
    """The smallest ``{x: |A (x - center)| <= 1}`` of a family around points ``(P, n)``.

    Args:
        points: In any units, such as samples of queries.
        family: ``"trace"`` (balls), ``"diagonal"`` (axis-aligned ellipsoids) or ``"determinant"`` (all ellipsoids).

    Returns:
        ``A`` ``(n, n)`` float64 and the centre ``(n,)``, in these units; A holds the points up to float64 rounding.

    Raises:
        BounderError: If the search does not close the gap (it always has).
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
    """``enclosing_of_points`` around points ``(P, n)`` that are dilated by an ellipsoid along the axes.

    Args:
        points: In any units.
        radii: ``(n,)``, half axes of that ellipsoid; zeros for none.
        family: As there.

    Returns:
        A and the centre; A holds the dilated points but for what ``MOST_ROUNDS`` may leave, which a proof must charge.
    """
    if not radii.any():
        return enclosing_of_points(points, family)
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
    """The points ``(P, n)``, of size 1; where they are flat in a direction that matters to the family, twice, ``THIN`` apart."""
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
    """``(P, n)``: by how much to move each point in its dilation so that it is about the farthest in the metric ``|A (x - center)|``."""
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
    """Centre, metric, its goal and the weights of the smallest member of a family around all points, from these weights on.

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


def extreme_corners(grid: IndicatorGrid) -> np.ndarray:
    """``(P, n)`` float64, object space: corners of cells that are first or last on every grid line through them."""
    return grid.position(line_ends(grid.occupied) - 0.5)


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
