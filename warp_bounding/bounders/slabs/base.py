"""Slabs: intersections of pairs of parallel half-spaces. What ``aabb``, ``obb`` and ``kdop`` have in common.

``f(v)`` is the least distance to a slab's faces, ``min_k min(a_k . v - low_k, high_k - a_k . v)``; it is concave, so its
minimum over a box is exact in closed form. The faces are the supports of the object's cells (Ericson, *Real-Time
Collision Detection*, ch. 4), widened so that rounding cannot cut anything off. Rays, planes and boxes are tested against the
same slabs (``slabs.regions``).
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from warp_bounding.arithmetic import round_down, round_up
from warp_bounding.bounders.slabs.native import TEXTS
from warp_bounding.bounders.slabs.regions import TESTS, SlabPoint, Slabs
from warp_bounding.bounders.volume import VolumeBounder, VolumeSource
from warp_bounding.coordinates.domain import Domain
from warp_bounding.coordinates.object_support import ObjectSupport
from warp_bounding.coordinates.region_domain import AnyDomain
from warp_bounding.errors import BounderError
from warp_bounding.geometry.hull import whole_hull
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.shape import Shape
from warp_bounding.queries.boundary import outline

__all__ = ["FaceBounder", "SlabBounder", "SlabsSource"]

AT_ONCE = 1 << 16  # cells or points whose boxes are projected at a time, so that memory stays small


@dataclass(frozen=True)
class SlabsSource(VolumeSource):
    """Native code of the slab test; ``diagonal`` slabs are the axes of ``v`` themselves and cost no product.

    Numbers: ``low[k] high[k]``, then the ``k x n`` directions unless diagonal; of regions, see ``slabs.regions``.
    """

    slabs: int
    diagonal: bool

    texts = TEXTS


class FaceBounder(VolumeBounder):
    """Volumes between flat faces; f of a region is 0 or more where it meets the volume."""

    shape: Slabs

    def least(self, grid: Shape) -> tuple[float, int]:
        """See ``Bounder``; 0 for regions. Raises ``BounderError`` if the volume does not hold all of the object.

        A region that meets the object meets a volume that holds it, and the tests of regions are 0 or more there.
        """
        least, count = super().least(grid)
        if self.volume is None:
            return least, count
        if not least >= 0:
            raise BounderError(f"{self.method}: the faces do not hold all of the object")
        return 0.0, count

    def hull_least(self, support: ObjectSupport) -> tuple[float, int]:
        directions, low, high, _ = self.shape
        two_sided = np.isfinite(low).all()
        reach = support(np.concatenate([directions, -directions]) if two_sided else directions)
        slack = np.concatenate([high, -low] if two_sided else [high]) - reach
        return float(np.nextafter(slack.min(), -np.inf)), len(reach)


class SlabBounder(FaceBounder):
    """Base of the slab methods: they differ in their directions only.

    Tensors: ``directions`` ``(k, n)`` in the coordinates of points (absent for ``aabb``), ``low`` and ``high`` ``(k,)``.
    """

    tests = TESTS
    diagonal = False
    of_samples: ClassVar[bool] = False  # the directions follow from samples, and not from their dimension alone

    @classmethod
    def fit(cls, grid: Shape, domain: AnyDomain, *, device: str | None = None, **options) -> "SlabBounder":
        """The tightest faces around a grid's occupied cells, or around the outline of a shape without cells.

        ``options`` are those of ``sampled_directions``.
        """
        base, gridded = domain.base, isinstance(grid, IndicatorGrid)
        points = np.empty((0, base.ndim))
        if cls.of_samples:
            points = grid.position(grid.occupied) if gridded else outline(grid)
        local = cls._local(cls.sampled_directions(points, **options), base.scale.astype(np.float64))
        if gridded:
            low, high = cls._faces_of_cells(grid, base, local)
        else:
            support = ObjectSupport(grid, base, whole_hull(grid))
            low, high = -support(-local), support(local)
        room = 2 * SlabPoint(Slabs(local, low, high, cls.diagonal), base).error
        return cls._of_faces(domain, local, low - room, high + room, device)

    @staticmethod
    def _faces_of_cells(grid: IndicatorGrid, base: Domain, local: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        cells = _ends(grid.occupancy)
        low, high = np.full(len(local), np.inf), np.full(len(local), -np.inf)
        for start in range(0, len(cells), AT_ONCE):
            part = cells[start : start + AT_ONCE]
            lower, upper = base.widened(grid.position(part - 0.5), grid.position(part + 0.5))
            center, half = (lower + upper) / 2 @ local.T, (upper - lower) / 2 @ np.abs(local).T
            low, high = np.minimum(low, (center - half).min(axis=0)), np.maximum(high, (center + half).max(axis=0))
        return low, high

    @classmethod
    def _local(cls, directions: np.ndarray, scale: np.ndarray) -> np.ndarray:
        return np.eye(len(scale)) if cls.diagonal else (directions / scale).astype(np.float32).astype(np.float64)

    @classmethod
    def _of_faces(cls, domain: AnyDomain, local, low, high, device: str | None) -> "SlabBounder":
        """Of faces that were widened by twice the rounding bound, the proof finds a threshold of about zero."""
        tensors = {} if cls.diagonal else {"directions": local.astype(np.float32)}
        return cls(domain, tensors | {"low": round_down(low), "high": round_up(high)}, {}, device)

    @classmethod
    def sampled_directions(cls, samples: np.ndarray) -> np.ndarray:
        """``(k, m)`` float64, slab normals for ``(N, m)`` samples, in their units; the axes by default.

        Unless the class is ``of_samples``, there may be none of them.
        """
        return np.eye(samples.shape[1])

    def check_tensors(self) -> None:
        n = self.volume_domain.ndim
        count = n if self.diagonal else max(len(self.tensors.get("directions", ())), 1)
        directions = {} if self.diagonal else {"directions": (count, n)}
        self.expect_shapes(directions | {"low": (count,), "high": (count,)})
        self.check_range()

    @property
    def shape(self) -> Slabs:
        low, high = self.tensors["low"].astype(np.float64), self.tensors["high"].astype(np.float64)
        if self.domain.tested_as_region and (low > high).any():
            raise BounderError(f"{self.method}: a slab's low face is above its high face")
        return Slabs(self.directions, low, high, self.diagonal)

    @property
    def directions(self) -> np.ndarray:
        """``(k, n)`` float64, slab normals in the coordinates of points."""
        return np.eye(self.volume_domain.ndim) if self.diagonal else self.tensors["directions"].astype(np.float64)

    @property
    def source(self) -> SlabsSource:
        return self.source_of(SlabsSource, len(self.test.slabs.low), self.diagonal)


def _ends(occupancy: np.ndarray) -> np.ndarray:
    """First and last occupied cells of every grid line along the last axis: a linear function is extreme on one of them."""
    first = occupancy & (np.cumsum(occupancy, axis=-1) == 1)
    last = occupancy & (np.cumsum(occupancy[..., ::-1], axis=-1)[..., ::-1] == 1)
    return np.argwhere(first | last)
