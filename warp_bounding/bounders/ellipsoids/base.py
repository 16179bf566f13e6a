"""Ellipsoids ``|A v + b|^2 <= r^2``. What ``sphere``, ``ellipsoid`` and ``oriented-ellipsoid`` have in common.

The three methods minimise a size over a family (``geometry.enclosing_ellipsoid``); their rounding is paid for in the threshold,
which the proof sets. Rays, planes and boxes are tested against the same ellipsoid (``ellipsoids.regions``), with the same threshold
but for rounding.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from warp_bounding.bounders.ellipsoids.native import TEXTS
from warp_bounding.bounders.ellipsoids.regions import TESTS, Quadric
from warp_bounding.bounders.volume import VolumeBounder, VolumeSource
from warp_bounding.coordinates.object_support import ObjectSupport
from warp_bounding.coordinates.region_domain import AnyDomain
from warp_bounding.geometry.enclosing_ellipsoid import enclosing_of_hull, enclosing_of_points, extreme_corners
from warp_bounding.geometry.hull import whole_hull
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.shape import Shape
from warp_bounding.queries.boundary import outline

__all__ = ["QuadricBounder", "QuadricSource"]


@dataclass(frozen=True)
class QuadricSource(VolumeSource):
    """Native code of the ellipsoid test; a diagonal A costs n products instead of n^2.

    Numbers: ``b[n]``, then A's diagonal, or A in row order; of regions, see ``ellipsoids.regions``.
    """

    diagonal: bool

    texts = TEXTS


class QuadricBounder(VolumeBounder):
    """Base of the ellipsoid methods: they differ in the family that they minimise over.

    Tensors: ``matrix`` ``(n, n)``, or ``(n,)`` where diagonal, and ``offset`` ``(n,)``, in the coordinates of points.
    """

    tests = TESTS
    family: ClassVar[str]  # see ``enclosing_ellipsoid``
    diagonal: ClassVar[bool] = True

    @classmethod
    def fit(cls, grid: Shape, domain: AnyDomain, *, device: str | None = None) -> "QuadricBounder":
        """The smallest member of the family around a grid's cells, a shape's hull or its outline, found in object space."""
        hull = whole_hull(grid)
        if hull is not None:
            radii = hull.radius * (np.arange(grid.ndim) >= int(grid.time))
            matrix, center = enclosing_of_hull(hull.points, radii, cls.family)
        else:
            points = extreme_corners(grid) if isinstance(grid, IndicatorGrid) else outline(grid)
            matrix, center = enclosing_of_points(points, cls.family)
        return cls._around(domain, matrix / domain.scale.astype(np.float64), -matrix @ (center - domain.center), device)

    @classmethod
    def _around(cls, domain: AnyDomain, matrix: np.ndarray, offset: np.ndarray, device) -> "QuadricBounder":
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
