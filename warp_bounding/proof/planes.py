"""Planes of a network: how far its two supports stay above the object's, over boxes of normals."""

from itertools import pairwise

import numpy as np

from warp_bounding.bounders.mlp import Mlp
from warp_bounding.errors import BounderError
from warp_bounding.geometry import hull_of
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.rounding import UNIT64, gamma
from warp_bounding.shapes.shape import Shape

AT_A_TIME = 2048  # boxes that are compared with all corners at a time
FIRST = 4  # boxes along each axis of a cube's face at the start


class SupportGap:
    """How far a network's support function stays above the object's, as a function of the normal m, for ``minimum``.

    A plane ``m . y = c`` that meets the object has ``-h(-m) <= c <= h(m)``, h the support function of the object's
    convex hull (that is necessary; for a connected object it is sufficient too, *Theorem of the separating
    hyperplane*). With ``f = min(H(m) - c, G(m) + c)`` the least f over all such c is ``min(H(m) - h(m), G(m) -
    h(-m))``, a function of m alone, and m runs over the faces of a cube, where one entry is 1: boxes of n - 1
    dimensions. On a box the network has a linear lower bound ``C + g . (m - m0)``, so that for every corner y of the
    object ``H - m . y >= C - m0 . y - sum |g - y|_k r_k``.

    A mesh has no cells: it lies in the hull of its vertices, dilated by its margin, which adds ``|D m|`` to h, D the
    half axes of the margin's ball. With gradient ``e = D D m0 / |D m0|`` and r the box's half widths, ``|D m| <= |D m0|
    + e . (m - m0) + |D r|^2 / (2 l)`` where ``|D m| >= l`` on the box, because its second derivative along d is at most
    ``|D d|^2 / l``.

    Args:
        bounder: An ``mlp`` of plane queries.
        grid: The object.

    Raises:
        BounderError: If the object has no known convex hull.
    """

    def __init__(self, bounder: Mlp, grid: Shape):
        self.networks, self.ndim = bounder.networks, grid.ndim
        base, hull = bounder.domain.base, hull_of(grid)
        if hull is None:
            raise BounderError(f"{bounder.method}: {grid.name} has no known convex hull; give a resolution")
        corners = base.to_local(hull.points)
        self.ball = hull.radius * base.scale.astype(np.float64)
        # How far the computed plane may pass a point of the object, in c, and what float64 rounds in ``reference``.
        self.rounding = float(bounder.domain.delta[-1]) * (1 + 1e-9) + 1e-12 * (1 + np.abs(corners).max())
        self.corners = [corners, -corners]

    def boxes(self) -> tuple[np.ndarray, np.ndarray]:
        """Boxes that cover the faces ``m_k = 1`` of the cube: lower and upper corners ``(N, n)`` float64."""
        n, edges = self.ndim, np.linspace(-1.0, 1.0, FIRST + 1)
        cells = np.stack(np.meshgrid(*[np.arange(FIRST)] * (n - 1), indexing="ij"), -1).reshape(-1, n - 1)
        intervals = np.array(list(pairwise(edges)))[cells]  # (N, n - 1, 2)
        sides = [[np.insert(intervals[..., side], k, 1.0, axis=1) for k in range(n)] for side in (0, 1)]
        return np.concatenate(sides[0]), np.concatenate(sides[1])

    def reference(self, m: np.ndarray) -> np.ndarray:
        """The gap at normals ``(N, n)``, ``(N,)`` float64."""
        m = np.asarray(m, dtype=np.float64)
        gap = np.empty(len(m))
        for start in range(0, len(m), AT_A_TIME):
            part = m[start : start + AT_A_TIME]
            gaps = [f(part) - (part @ y.T).max(axis=1) for f, y in zip(self.networks, self.corners, strict=True)]
            gap[start : start + AT_A_TIME] = np.minimum(*gaps) - np.linalg.norm(part * self.ball, axis=1)
        return gap - self.rounding

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """Certified lower bounds over boxes of m; see ``Bounder.bound``."""
        center, radius = (lower + upper) / 2, (upper - lower) / 2
        least, point = np.full(len(lower), np.inf), center.copy()
        dilated, tilt = self._dilation(lower, upper, center, radius)
        for network, corners in zip(self.networks, self.corners, strict=True):
            bounds = network.bound(lower, upper)
            slope, value = bounds.slope - tilt, bounds.level - dilated
            size = 4 + np.abs(value).max(initial=0.0) + np.abs(slope).sum(axis=1).max(initial=0.0)
            rounding = gamma(64, UNIT64) * (size + np.abs(corners).sum(axis=1).max())
            for start in range(0, len(lower), AT_A_TIME):
                part = slice(start, start + AT_A_TIME)
                loss = center[part] @ corners.T
                for k in range(self.ndim):  # one axis at a time: (boxes, corners) in the cache
                    away = np.abs(slope[part, k, None] - corners[:, k])
                    away *= radius[part, k, None]
                    loss += away
                worst = loss.argmax(axis=1)
                bound = value[part] - loss[np.arange(len(loss)), worst] - self.rounding - rounding
                bound[np.isnan(bound)] = -np.inf
                lower_yet = bound < least[part]
                towards = center[part] - np.sign(slope[part] - corners[worst]) * radius[part]
                point[part] = np.where(lower_yet[:, None], towards, point[part])
                least[part] = np.where(lower_yet, bound, least[part])
        return BoxBounds(least, np.argmax(radius, axis=1), point, self.reference(point))

    def touching(self, m: np.ndarray) -> np.ndarray:
        """``v`` ``(2 N, n + 1)`` of the two planes of each normal ``(N, n)`` that touch the object's hull."""
        ends = [m[i : i + AT_A_TIME] @ self.corners[0].T for i in range(0, len(m), AT_A_TIME)]
        most, least = (np.concatenate([getattr(end, side)(axis=1) for end in ends]) for side in ("max", "min"))
        dilated = np.linalg.norm(m * self.ball, axis=1)
        return np.concatenate([np.column_stack([m, most + dilated]), np.column_stack([m, least - dilated])])

    def _dilation(self, lower, upper, center, radius) -> tuple[np.ndarray, np.ndarray]:
        """``(N,)`` and ``(N, n)``: ``|D m|`` is at most the first and the second times ``m - m0`` on each box."""
        if not self.ball.any():
            return np.zeros(len(lower)), np.zeros(lower.shape)
        unit = np.ldexp(1.0, np.frexp(self.ball.max())[1])  # a power of two: squares of tiny margins would be 0
        ball = self.ball / unit
        away = np.maximum(np.maximum(lower, -upper), 0.0)  # least |m| on each axis; one of them is 1
        least = (away * ball).max(axis=1)
        length = np.linalg.norm(center * ball, axis=1)
        bent = (radius * ball) ** 2
        tilt = center * ball**2 / length[:, None]
        return (length + bent.sum(axis=1) / (2 * least)) * (1 + 1e-12) * unit, tilt * unit
