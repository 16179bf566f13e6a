"""Ellipsoids ``|A v + b|^2 <= r^2`` of points: ``sphere``, ``ellipsoid`` and ``oriented-ellipsoid``.

Each is the smallest of a family in object space (``geometry``): the ball (the paper's Sphere), its radius within
0.005 % of the least; the axis-aligned ellipsoid of least volume (the paper's AAElli); the ellipsoid of least volume
(the paper's OElli), by Khachiyan's problem. f is ``-|A v + b|^2``, concave, so its minimum over a box is attained at a
corner; its rounding is paid for in the threshold, which the proof sets.
"""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from warp_bounding.bounders.volumes import VolumeBounder, VolumeSource, VolumeTest
from warp_bounding.geometry import enclosing_of_hull, enclosing_of_points, extreme_corners, whole_hull
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.queries.boundary import ObjectSupport, outline
from warp_bounding.queries.domain import Domain
from warp_bounding.rounding import TINY, UNIT64, gamma
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.shape import Shape

_POINT = """
{
    constexpr int N = $n;
    constexpr bool DIAGONAL = $diagonal;
    const V none = {};
    f = v[0] * 0.0f;
#pragma unroll
    for (int i = 0; i < N; ++i) {
        const float* a = w + N + i * N;
        V y = DIAGONAL ? v[i] * w[N + i] : v[0] * a[0];
#pragma unroll
        for (int j = 1; j < N && !DIAGONAL; ++j) y = y + v[j] * a[j];
        y = y + w[i];
        f = f - y * y;
    }
}
"""

MOST_CORNER_DIMENSIONS = 8  # up to here a box's corners are enumerated; beyond, rows are bounded one by one


class Quadric(NamedTuple):
    """The numbers of an ellipsoid, as float64: A ``(n, n)``, b ``(n,)``; diagonal: A is known to be."""

    matrix: np.ndarray
    offset: np.ndarray
    diagonal: bool

    @property
    def numbers(self) -> np.ndarray:
        """float32, as bodies read them: b, then A by rows, or its diagonal."""
        matrix = np.diag(self.matrix) if self.diagonal else self.matrix.reshape(-1)
        return np.concatenate([self.offset, matrix]).astype(np.float32)


class QuadricPoint(VolumeTest):
    """``-|A v + b|^2``; numbers: b, A."""

    def __init__(self, quadric: Quadric, domain: Domain):
        self.quadric, self.weights = quadric, quadric.numbers
        # n rows of n products, n squares, their sum; a factor or a result may be set to zero
        matrix, n, limit = np.abs(quadric.matrix), len(quadric.offset), domain.limit.astype(np.float64)
        size = matrix @ limit + np.abs(quadric.offset)
        error = gamma(n + 2) * size + (2 * n + 2 + matrix.sum(axis=1) + limit.sum()) * TINY
        squares, flushed = (size + error) ** 2, (2 * n + 2 + 2 * size.sum()) * TINY
        self.error = float((((2 * size + error) * error).sum() + gamma(n + 2) * squares.sum() + flushed) * (1 + 1e-9))

    def reference(self, v: np.ndarray) -> np.ndarray:
        y = v @ self.quadric.matrix.T + self.quadric.offset
        return -(y * y).sum(axis=1)

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """See ``Bounder``; exact where a box's corners can be enumerated."""
        a, b, diagonal = self.quadric
        n, center, half = len(b), (lower + upper) / 2, (upper - lower) / 2
        if n <= MOST_CORNER_DIMENSIONS and not diagonal:
            least, point = np.full(len(lower), np.inf), lower.copy()
            for corner in np.ndindex((2,) * n):
                v = np.where(corner, upper, lower)
                value = -((v @ a.T + b) ** 2).sum(axis=1)
                point = np.where((value < least)[:, None], v, point)
                least = np.minimum(least, value)
        else:  # each row on its own; exact where A is diagonal
            least = -((np.abs(center @ a.T + b) + half @ np.abs(a).T) ** 2).sum(axis=1)
            point = np.where((center @ a.T + b) @ a > 0, upper, lower)
        size = (np.abs(a) @ np.maximum(np.abs(lower), np.abs(upper)).max(axis=0) + np.abs(b)) ** 2
        rounding = gamma(4 * n + 16, UNIT64) * size.sum()
        return BoxBounds(least - rounding, np.argmax(half, axis=1), point, self.reference(point))


@dataclass(frozen=True)
class QuadricSource(VolumeSource):
    """Native code of the ellipsoid test; a diagonal A costs n products instead of n^2.

    Numbers: ``b[n]``, then A's diagonal, or A in row order.
    """

    diagonal: bool

    texts: ClassVar = {"point": _POINT}


class QuadricBounder(VolumeBounder):
    """Base of the ellipsoid methods: they differ in the family that they minimise over.

    Tensors: ``matrix`` ``(n, n)``, or ``(n,)`` where diagonal, and ``offset`` ``(n,)``, in the coordinates of points.
    """

    tests: ClassVar = {"point": QuadricPoint}
    family: ClassVar[str]  # see ``geometry.enclosing_of_points``
    diagonal: ClassVar[bool] = True

    @classmethod
    def fit(cls, grid: Shape, domain: Domain, *, device: str | None = None) -> "QuadricBounder":
        """The smallest member of the family around a grid's cells, a shape's hull or outline, in object space."""
        hull = whole_hull(grid)
        if hull is not None:
            radii = hull.radius * (np.arange(grid.ndim) >= int(grid.time))
            matrix, center = enclosing_of_hull(hull.points, radii, cls.family)
        else:
            points = extreme_corners(grid) if isinstance(grid, Grid) else outline(grid)
            matrix, center = enclosing_of_points(points, cls.family)
        matrix, offset = matrix / domain.scale.astype(np.float64), -matrix @ (center - domain.center)
        tensors = {"matrix": np.diag(matrix) if cls.diagonal else matrix, "offset": offset}
        return cls(domain, {name: value.astype(np.float32) for name, value in tensors.items()}, {}, device)

    def check_tensors(self) -> None:
        n = self.volume_domain.ndim
        self.expect_shapes({"matrix": (n,) if self.diagonal else (n, n), "offset": (n,)})
        self.check_range()

    @property
    def shape(self) -> Quadric:
        matrix, offset = (self.tensors[name].astype(np.float64) for name in ("matrix", "offset"))
        return Quadric(np.diag(matrix) if self.diagonal else matrix, offset, self.diagonal)

    @property
    def source(self) -> QuadricSource:
        return self.source_of(QuadricSource, self.diagonal)

    def hull_least(self, support: ObjectSupport) -> tuple[float, int]:
        return -support.square(*self.shape[:2]), 1


class Sphere(QuadricBounder):
    """Minimal ball."""

    method = "sphere"
    family = "trace"


class Ellipsoid(QuadricBounder):
    """Axis-aligned ellipsoid of least volume."""

    method = "ellipsoid"
    family = "diagonal"


class OrientedEllipsoid(QuadricBounder):
    """Ellipsoid of least volume."""

    method = "oriented-ellipsoid"
    family = "determinant"
    diagonal = False
