"""Ellipsoids ``|A v + b|^2 <= r^2``. What ``sphere``, ``ellipsoid`` and ``oriented-ellipsoid`` have in common.

The three methods minimise a size over a family (``geometry``); their rounding is paid for in the threshold,
which the proof sets. They are for points: f is ``-|A v + b|^2``, which is concave, so least at a box's corners.
"""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from warp_bounding.bounders.volumes import VolumeBounder, VolumeSource, VolumeTest, text
from warp_bounding.geometry import enclosing_of_hull, enclosing_of_points, line_ends, whole_hull
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.queries.boundary import ObjectSupport, outline
from warp_bounding.queries.region_domain import AnyDomain
from warp_bounding.rounding import TINY, UNIT64, gamma
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.shape import Shape

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


def row_sizes(matrix: np.ndarray, offset: np.ndarray, limit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Per row of ``A y + b``, for ``|y| <= limit``: its largest size, and what float32 makes of it at most."""
    n = len(matrix)
    size = np.abs(matrix) @ limit + np.abs(offset)
    flushed = (2 * n + 2 + np.abs(matrix).sum(axis=1) + limit.sum()) * TINY  # a factor or a result set to zero
    return size, gamma(n + 2) * size + flushed


def squares_error(size: np.ndarray, error: np.ndarray) -> float:
    """Error of a sum of squares of numbers up to ``size`` that are off by ``error``."""
    n = len(size)
    squares = (size + error) ** 2
    flushed = (2 * n + 2 + 2 * size.sum()) * TINY
    return float((((2 * size + error) * error).sum() + gamma(n + 2) * squares.sum() + flushed) * (1 + 1e-9))


class QuadricPoint(VolumeTest):
    """``-|A v + b|^2``; numbers: b, A."""

    def __init__(self, quadric: Quadric, domain: AnyDomain):
        self.quadric, self.weights = quadric, quadric.numbers
        # n rows of n products, n squares, their sum
        self.error = squares_error(*row_sizes(quadric.matrix, quadric.offset, domain.limit.astype(np.float64)))

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

    texts = {"point": text.ELLIPSOID_POINT}  # noqa: RUF012


class QuadricBounder(VolumeBounder):
    """Base of the ellipsoid methods: they differ in the family that they minimise over.

    Tensors: ``matrix`` ``(n, n)``, or ``(n,)`` where diagonal, and ``offset`` ``(n,)``, in the coordinates of points.
    """

    tests = {"point": QuadricPoint}  # noqa: RUF012
    family: ClassVar[str]  # see ``geometry.enclosing_of_points``
    diagonal: ClassVar[bool] = True

    @classmethod
    def fit(cls, grid: Shape, domain: AnyDomain, *, device: str | None = None) -> "QuadricBounder":
        """The smallest member of the family around a grid's cells, a shape's hull or outline, in object space."""
        hull = whole_hull(grid)
        if hull is not None:
            radii = hull.radius * (np.arange(grid.ndim) >= int(grid.time))
            matrix, center = enclosing_of_hull(hull.points, radii, cls.family)
        else:
            points = grid.position(line_ends(grid.occupied) - 0.5) if isinstance(grid, Grid) else outline(grid)
            matrix, center = enclosing_of_points(points, cls.family)
        matrix, offset = matrix / domain.scale.astype(np.float64), -matrix @ (center - domain.center)
        tensors = {"matrix": np.diag(matrix) if cls.diagonal else matrix, "offset": offset}
        return cls(domain, {name: value.astype(np.float32) for name, value in tensors.items()}, {}, device)

    def check_tensors(self) -> None:
        n = self.domain.base.ndim
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
    """The smallest enclosing ball, in object space (the paper's Sphere), its radius within 0.005 % of the least."""

    method = "sphere"
    family = "trace"


class Ellipsoid(QuadricBounder):
    """Axis-aligned ellipsoid of least volume (the paper's AAElli)."""

    method = "ellipsoid"
    family = "diagonal"


class OrientedEllipsoid(QuadricBounder):
    """Ellipsoid of least volume (the paper's OElli), by Khachiyan's problem."""

    method = "oriented-ellipsoid"
    family = "determinant"
    diagonal = False
