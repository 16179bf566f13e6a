"""Ellipsoids ``|A v + b|^2 <= r^2``. What ``sphere``, ``ellipsoid`` and ``oriented-ellipsoid`` have in common.

The three methods minimise a size over a family (``geometry``); their rounding is paid for in the threshold,
which the proof sets. Rays, planes and boxes are tested against the same ellipsoid (``Quadric``), with the
same threshold but for rounding.
"""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from warp_bounding.bounders.volumes import VolumeBounder, VolumeSource, VolumeTest, text
from warp_bounding.errors import BounderError
from warp_bounding.geometry import checked_inverse, enclosing_of_hull, enclosing_of_points, line_ends, whole_hull
from warp_bounding.kernels.source import Source
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.queries.boundary import ObjectSupport, outline
from warp_bounding.queries.region_domain import AnyDomain, RegionDomain
from warp_bounding.rounding import TINY, UNIT64, gamma
from warp_bounding.runtime.native import literal
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.shape import Shape

# --- native text -----------------------------------------------------------------------------------------------------

SMALLEST = 2.0**-80  # of |A w|^2: a segment as short as that counts as its origin
SWEEPS = 2  # of coordinate descent over a box


def _box(source: Source) -> str:
    """Row by row where A is diagonal, else by coordinate descent."""
    return text.ELLIPSOID_INTERVALS if source.diagonal else text.ELLIPSOID_DESCENT


TEXTS = {"point": text.ELLIPSOID_POINT, "ray": text.ELLIPSOID_RAY, "plane": text.ELLIPSOID_PLANE, "box": _box}


# --- regions ---------------------------------------------------------------------------------------------------------
#
# Points, rays, planes and boxes against an ellipsoid, where ``f(y) = -|A y + b|^2`` for points: f of a region is the
# largest on it.
#
# * Point: f is concave, so its minimum over a box is attained at a corner.
# * Ray: the segment's nearest point in the space of ``z = A y + b``, where the ellipsoid is a ball. Exact.
# * Plane: ``m . y = c`` is ``(B^T m) . z = c - m . centre`` with ``B = A^-1``; its distance from 0 squared. Exact.
# * Box: exact where A is diagonal. Otherwise a few steps of coordinate descent from the point nearest the centre; the
# plane through what they find, at right angles to it in the space of z, then bounds the box's distance from below
# (Cauchy-Schwarz). That holds whatever the steps found, so their rounding does not matter. Conservative by what they
# leave: little.
#
# The results are upper bounds of the points' f on the region, less ``error``; so a point's threshold serves for all of
# them.

MOST_CORNER_DIMENSIONS = 8  # up to here a box's corners are enumerated; beyond, rows are bounded one by one
SHORTEST = 2.0**-40  # of a vector in the space of z; the root of SMALLEST


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


class QuadricRay(VolumeTest):
    """The nearest point of a segment; numbers: b, A."""

    def __init__(self, quadric: Quadric, domain: RegionDomain):
        matrix, offset, _ = quadric
        n, limit = len(offset), domain.limit.astype(np.float64)
        size, error = row_sizes(matrix, offset, limit[:n])
        fastest, _ = row_sizes(matrix, np.zeros(n), limit[n:])
        if not fastest.sum() < 2.0**40:
            raise BounderError(f"a ray of length {domain.length:g} is so long that float32 products may overflow")
        # At a point a + t w in the domain, t |w| is at most twice the limit: so is what the speed's rounding moves it
        # by, however long the ray is. The computed origin and speed are a segment on which t is then ``late``: quotient
        # and sums make t |speed| wrong by a few roundings of |origin|, and that enters squared.
        largest = np.linalg.norm(size)
        flushed = 8 * (n + 1) ** 2 * (1 + largest + fastest.sum() + np.abs(matrix).sum()) ** 2 * TINY
        moved = np.linalg.norm(error + 2 * gamma(n + 2) * size) + flushed
        late = gamma(4 * n + 16) * (largest + moved) + flushed / SHORTEST
        near = largest + moved + late + 2 * SHORTEST  # of the point that is found, where another is at ``largest``
        most = ((near - late) ** 2 + late**2) ** 0.5
        most = (most + gamma(4) * 3 * (near + largest) + flushed) ** 2 * (1 + gamma(n + 3))
        self.error = float((most - largest**2) * (1 + 1e-9) + 1e-12 * most)
        self.quadric, self.weights = quadric, quadric.numbers

    def reference(self, v: np.ndarray) -> np.ndarray:
        matrix, offset, _ = self.quadric
        n = len(offset)
        y, s = v[:, :n] @ matrix.T + offset, v[:, n:] @ matrix.T
        length = (s * s).sum(axis=1)
        t = np.clip(-(y * s).sum(axis=1) / np.where(length > 0, length, 1), 0, 1)[:, None]
        return -((y + t * s) ** 2).sum(axis=1)


class QuadricPlane(VolumeTest):
    """The distance of a plane; numbers: the centre, and B by columns (its diagonal where that is all)."""

    def __init__(self, quadric: Quadric, domain: RegionDomain):
        matrix, offset, diagonal = quadric
        n, found = len(offset), checked_inverse(matrix)
        if found is None:
            raise BounderError("the ellipsoid is so flat that float64 cannot invert its matrix")
        inverse, error = found
        error = error + gamma(n + 3, UNIT64) * np.abs(inverse)
        center = -inverse @ offset
        self.columns, self.center = inverse.T.astype(np.float32), center.astype(np.float32)
        numbers, middle = self.columns.astype(np.float64), self.center.astype(np.float64)
        # Entries of m are at most 1. ``wrong``: of m . centre, of c - m . centre; ``tilted``: of each entry of B^T m.
        moved = (np.abs(middle - center) + error @ np.abs(offset)).sum()
        size = np.abs(middle).sum() + float(domain.limit[-1])
        wrong = moved + gamma(n + 3) * size + 4 * (n + 1) * (1 + size) * TINY
        tilted, columns = (np.abs(numbers - inverse.T) + error.T).sum(axis=1), np.abs(numbers).sum(axis=1)
        tilted = tilted + gamma(n + 2) * columns + 4 * (n + 1) * (1 + columns) * TINY
        # m = A^T (B^T m) has an entry 1, so B^T m cannot be shorter than one over A's longest column.
        shortest = 1 / np.linalg.norm(matrix, axis=0).max()
        ratio = np.linalg.norm(tilted) / shortest + gamma(n + 4) + 8 * n * TINY / shortest**2
        if not (ratio < 0.25 and size < 2.0**40):
            raise BounderError("the ellipsoid is so flat that float32 cannot measure a plane's distance from it")
        # Nothing is claimed of planes that miss the domain: the largest |z| is at its corner.
        farthest = np.linalg.norm(row_sizes(matrix, offset, domain.base.limit.astype(np.float64))[0])
        most = ((farthest + wrong / shortest) / (1 - ratio)) ** 2 * (1 + gamma(6))
        self.error = float((most - farthest**2) * (1 + 1e-9) + 1e-12 * most)
        self.weights = np.concatenate([self.center, np.diag(self.columns) if diagonal else self.columns.reshape(-1)])

    def reference(self, v: np.ndarray) -> np.ndarray:
        off = v[:, -1] - v[:, :-1] @ self.center.astype(np.float64)
        return -(off**2) / ((v[:, :-1] @ self.columns.astype(np.float64).T) ** 2).sum(axis=1)


class QuadricBox(VolumeTest):
    """The distance of a box; numbers: b, A, and unless diagonal the factors ``1 / |A e_j|^2`` and the centre."""

    def __init__(self, quadric: Quadric, domain: RegionDomain):
        matrix, offset, diagonal = quadric
        n, limit = len(offset), domain.base.limit.astype(np.float64)
        size, error = row_sizes(matrix, offset, limit)
        self.quadric, self.weights = quadric, quadric.numbers
        if diagonal:  # the ends of a row's interval round like a point's
            self.error = squares_error(size, error)
        else:
            # A vector z as it is stored, m = A^T z, and the least of z . b + m . y over the box: products and sums of
            # rows, each of size |z_i| size_i at most. Over |z| this is a length; ``largest`` bounds lengths, ``wrong``
            # their error.
            largest, count = float(np.linalg.norm(size)), 4 * n + 16
            tiny = 16 * (n + 1) ** 2 * (1 + size.sum() + np.abs(matrix).sum() + limit.sum()) ** 2 * TINY / SHORTEST
            wrong = gamma(count) * largest * np.sqrt(n) + tiny
            most = (largest + wrong) ** 2 * (1 + gamma(count))
            self.error = float((most - largest**2) * (1 + 1e-9) + 1e-12 * most)
            center, *_ = np.linalg.lstsq(matrix, -offset, rcond=None)
            with np.errstate(divide="ignore"):
                steps = np.minimum(1 / (matrix**2).sum(axis=0), 2.0**60)
            self.start, self.steps = np.clip(center, -limit, limit).astype(np.float32), steps.astype(np.float32)
            self.weights = np.concatenate([quadric.numbers, self.steps, self.start])

    def reference(self, v: np.ndarray) -> np.ndarray:
        matrix, offset, diagonal = self.quadric
        n = len(offset)
        low, high = v[:, :n], v[:, n:]
        if diagonal:
            ends = np.sort(np.stack([low, high]) * np.diag(matrix) + offset, axis=0)
            return -(np.maximum(np.maximum(ends[0], -ends[1]), 0) ** 2).sum(axis=1)
        y = np.clip(self.start.astype(np.float64), low, high)
        for _ in range(SWEEPS):
            for j in range(n):
                slope = (y @ matrix.T + offset) @ matrix[:, j]
                y[:, j] = np.clip(y[:, j] - slope * float(self.steps[j]), low[:, j], high[:, j])
        z = y @ matrix.T + offset
        length, m = (z * z).sum(axis=1), z @ matrix
        least = np.maximum(z @ offset + np.minimum(m * low, m * high).sum(axis=1), 0)
        return -np.where(length > SMALLEST, least**2, 0) / np.where(length > SMALLEST, length, 1)


# By the name of the kind of query.
TESTS = {"point": QuadricPoint, "ray": QuadricRay, "plane": QuadricPlane, "box": QuadricBox}


@dataclass(frozen=True)
class QuadricSource(VolumeSource):
    """Native code of the ellipsoid test; a diagonal A costs n products instead of n^2.

    Numbers: ``b[n]``, then A's diagonal, or A in row order; of regions, see ``Quadric``.
    """

    diagonal: bool

    texts = TEXTS
    numbers = {"row": text.ELLIPSOID_ROW, "smallest": literal(SMALLEST), "sweeps": SWEEPS}  # noqa: RUF012


class QuadricBounder(VolumeBounder):
    """Base of the ellipsoid methods: they differ in the family that they minimise over.

    Tensors: ``matrix`` ``(n, n)``, or ``(n,)`` where diagonal, and ``offset`` ``(n,)``, in the coordinates of points.
    """

    tests = TESTS
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
