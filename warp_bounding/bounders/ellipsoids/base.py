"""Ellipsoids ``|A v + b|^2 <= r^2``. What ``sphere``, ``ellipsoid`` and ``oriented-ellipsoid`` have in common.

``f(v) = -|A v + b|^2`` is concave, so its minimum over a box is attained at a corner. The three methods minimise a
size over a family (``enclosing``); their rounding is paid for in the threshold, which the proof sets. Rays, planes and
boxes are tested against the same ellipsoid (``quadric_regions``), with the same threshold but for rounding.
"""

from dataclasses import dataclass

import numpy as np
import warp as wp

from warp_bounding.arithmetic import UNIT64, gamma
from warp_bounding.bounders.base import BoxBounds
from warp_bounding.bounders.ellipsoids.plain import PLAIN
from warp_bounding.bounders.ellipsoids.regions import (
    REGIONS,
    TEXTS,
    QuadricBox,
    QuadricPlane,
    QuadricRay,
    row_sizes,
    squares_error,
)
from warp_bounding.bounders.parametric_fit import units
from warp_bounding.bounders.volume import VolumeBounder
from warp_bounding.coordinates.domain import Domain
from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.errors import BounderError
from warp_bounding.geometry.enclosing_ellipsoid import enclosing_ellipsoid, enclosing_of_points
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.kernels.source import Lanes, Source, fill
from warp_bounding.support_functions.parametric import ParametricSupport

__all__ = ["QuadricBounder", "QuadricSource"]

MOST_CORNER_DIMENSIONS = 8  # up to here a box's corners are enumerated; beyond, rows are bounded one by one


@dataclass(frozen=True)
class QuadricSource(Source):
    """Native code of the ellipsoid test; a diagonal A costs n products instead of n^2.

    Numbers: ``b[n]``, then A's diagonal, or A in row order; of regions, see ``quadric_regions``.
    """

    diagonal: bool

    def body(self, lanes: Lanes) -> str:
        """See ``Source.body``."""
        text = TEXTS[self.tested_kind](self)
        return fill(text, n=self.tested_ndim, diagonal="true" if self.diagonal else "false")

    def plain(self) -> wp.Function:
        """See ``Source.plain``."""
        return PLAIN[self.tested_kind](self)


class QuadricBounder(VolumeBounder):
    """Base of the ellipsoid methods: they differ in the family that they minimise over.

    Tensors: ``matrix`` ``(n, n)``, or ``(n,)`` where diagonal, and ``offset`` ``(n,)``, in the coordinates of points.
    """

    regions = REGIONS
    family = "determinant"

    @classmethod
    def fit(cls, grid: IndicatorGrid, domain: Domain | RegionDomain, *, device: str | None = None) -> "QuadricBounder":
        """The smallest member of the family around a grid's occupied cells, found in object space."""
        matrix, center = enclosing_ellipsoid(grid, cls.family)
        local = matrix / domain.scale.astype(np.float64)
        offset = -matrix @ (center - domain.center)
        tensors = {"matrix": (local if cls.family == "determinant" else np.diag(local)).astype(np.float32)}
        return cls(domain, tensors | {"offset": offset.astype(np.float32)}, {}, device)

    @classmethod
    def fit_regions(
        cls, grid: IndicatorGrid, domain: RegionDomain, samples: np.ndarray, *, device: str | None = None
    ) -> "QuadricBounder":
        """See ``Bounder``; the threshold is the radius."""
        matrix, center = enclosing_of_points(samples, cls.family)
        local, offset = matrix / units(domain), (-matrix @ center).astype(np.float32)
        tensors = {"matrix": (local if cls.family == "determinant" else np.diag(local)).astype(np.float32)}
        return cls(domain, tensors | {"offset": offset}, {}, device)

    def __init__(
        self, domain: Domain | RegionDomain, tensors: dict[str, np.ndarray], sizes: dict, device: str | None = None
    ):
        """See ``Bounder``; raises ``BounderError`` where the tensors do not fit together."""
        super().__init__(domain, tensors, sizes, device)
        n = self.volume_domain.ndim
        expected = {"matrix": (n, n) if self.family == "determinant" else (n,), "offset": (n,)}
        if {k: t.shape for k, t in self.tensors.items()} != expected:
            found = {k: t.shape for k, t in self.tensors.items()}
            raise BounderError(f"{self.method}: expected tensors {expected}, got {found}")
        self.check_range()

    def region_test(self) -> QuadricRay | QuadricPlane | QuadricBox:
        offset = self.tensors["offset"].astype(np.float64)
        return REGIONS[self.query_kind](self.matrix, offset, self.tensors["matrix"].ndim == 1, self.domain)

    @property
    def matrix(self) -> np.ndarray:
        """``(n, n)`` float64, A."""
        matrix = self.tensors["matrix"].astype(np.float64)
        return matrix if matrix.ndim == 2 else np.diag(matrix)

    @property
    def source(self) -> QuadricSource:
        """See ``Bounder``."""
        diagonal = self.tensors["matrix"].ndim == 1
        return QuadricSource(self.ndim, self.domain.time, diagonal, query=self.query_kind, space=self.domain.space)

    def region_weights(self) -> np.ndarray:
        return self.region.weights(self.tensors)

    def volume_weights(self) -> np.ndarray:
        return np.concatenate([self.tensors["offset"], self.tensors["matrix"].reshape(-1)])

    def volume_reference(self, v: np.ndarray) -> np.ndarray:
        y = v @ self.matrix.T + self.tensors["offset"]
        return -(y * y).sum(axis=1)

    def volume_bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """See ``Bounder``; exact where a box's corners can be enumerated."""
        n, a, b = self.domain.ndim, self.matrix, self.tensors["offset"].astype(np.float64)
        center, half = (lower + upper) / 2, (upper - lower) / 2
        if n <= MOST_CORNER_DIMENSIONS and self.family == "determinant":
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
        return BoxBounds(least - rounding, np.argmax(half, axis=1), point, self.volume_reference(point))

    def least(self, grid: IndicatorGrid) -> tuple[float, int]:
        """See ``Bounder``."""
        if not self.domain.parametric:
            return super().least(grid)
        offset = self.tensors["offset"].astype(np.float64)
        return -ParametricSupport(grid, self.domain).square(self.matrix, offset), 1

    def volume_rounding(self) -> float:
        """See ``Bounder``: n rows of n products, n squares, their sum."""
        limit = self.domain.limit.astype(np.float64)
        return squares_error(*row_sizes(self.matrix, self.tensors["offset"].astype(np.float64), limit))
