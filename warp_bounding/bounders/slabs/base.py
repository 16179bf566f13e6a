"""Slabs: intersections of pairs of parallel half-spaces. What ``aabb``, ``obb`` and ``kdop`` have in common.

``f(v)`` is the least distance to a slab's faces, ``min_k min(a_k . v - low_k, high_k - a_k . v)``; it is concave, so its
minimum over a box is exact in closed form. The faces are the supports of the object's cells (Ericson, *Real-Time
Collision Detection*, ch. 4), widened so that rounding cannot cut anything off. Rays, planes and boxes are tested against the
same slabs (``slab_regions``).
"""

from dataclasses import dataclass

import numpy as np
import warp as wp

from warp_bounding.arithmetic import TINY, UNIT64, gamma, round_down, round_up
from warp_bounding.bounders.base import BoxBounds
from warp_bounding.bounders.parametric_fit import units
from warp_bounding.bounders.slabs.plain import PLAIN
from warp_bounding.bounders.slabs.regions import REGIONS, TEXTS, SlabBox, SlabPlane, SlabRay, Slabs
from warp_bounding.bounders.volume import VolumeBounder
from warp_bounding.coordinates.domain import Domain
from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.errors import BounderError
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.kernels.source import Lanes, Source, fill
from warp_bounding.support_functions.parametric import ParametricSupport

__all__ = ["SlabBounder", "SlabsSource"]


@dataclass(frozen=True)
class SlabsSource(Source):
    """Native code of the slab test; ``diagonal`` slabs are the axes of ``v`` themselves and cost no product.

    Numbers: ``low[k] high[k]``, then the ``k x n`` directions unless diagonal; of regions, see ``slab_regions``.
    """

    slabs: int
    diagonal: bool

    def body(self, lanes: Lanes) -> str:
        """See ``Source.body``."""
        text = TEXTS[self.tested_kind](self)
        return fill(text, n=self.tested_ndim, slabs=self.slabs, diagonal="true" if self.diagonal else "false")

    def plain(self) -> wp.Function:
        """See ``Source.plain``."""
        return PLAIN[self.tested_kind](self)


class SlabBounder(VolumeBounder):
    """Base of the slab methods: they differ in their directions only.

    Tensors: ``directions`` ``(k, n)`` in the coordinates of points (absent for ``aabb``), ``low`` and ``high`` ``(k,)``.
    """

    regions = REGIONS
    diagonal = False

    @classmethod
    def of_directions(
        cls, grid: IndicatorGrid, domain: Domain | RegionDomain, directions: np.ndarray, device: str | None
    ) -> "SlabBounder":
        """Fit the faces to a grid's cells.

        Args:
            grid: The object.
            domain: Its domain; that of a region tested against the slabs has their numbers too.
            directions: ``(k, n)``, slab normals in object space.
            device: Warp device.
        """
        whole, domain = domain, domain.base
        if cls.diagonal:
            local = np.eye(domain.ndim)
            tensors = {}
        else:
            local = (directions / domain.scale.astype(np.float64)).astype(np.float32)
            tensors = {"directions": local}
            local = local.astype(np.float64)
        cells = _ends(grid.occupancy)
        low, high = np.full(len(local), np.inf), np.full(len(local), -np.inf)
        for start in range(0, len(cells), 1 << 16):
            part = cells[start : start + (1 << 16)]
            lower, upper = domain.widened(grid.position(part - 0.5), grid.position(part + 0.5))
            center, half = (lower + upper) / 2 @ local.T, (upper - lower) / 2 @ np.abs(local).T
            low, high = np.minimum(low, (center - half).min(axis=0)), np.maximum(high, (center + half).max(axis=0))
        # Widened by twice the rounding bound, so that the proof finds a threshold of about zero.
        room = 2 * _rounding(local, np.maximum(np.abs(low), np.abs(high)), domain, cls.diagonal)
        tensors |= {"low": round_down(low - room), "high": round_up(high + room)}
        return cls(whole, tensors, {}, device)

    @classmethod
    def fit_regions(
        cls, grid: IndicatorGrid, domain: RegionDomain, samples: np.ndarray, *, device: str | None = None, **options
    ) -> "SlabBounder":
        """See ``Bounder``; ``options`` are those of ``sampled_directions``."""
        local = (cls.sampled_directions(samples, **options) / units(domain)).astype(np.float32)
        tensors = {} if cls.diagonal else {"directions": local}
        normals = np.eye(domain.ndim) if cls.diagonal else local.astype(np.float64)
        support = ParametricSupport(grid, domain)(np.concatenate([normals, -normals]))
        high, low = support[: len(normals)], -support[len(normals) :]
        tight = cls(domain, tensors | {"low": round_down(low), "high": round_up(high)}, {}, device)
        room = 2 * tight.rounding_bound()  # so that the threshold comes out at about zero
        return cls(domain, tensors | {"low": round_down(low - room), "high": round_up(high + room)}, {}, device)

    @classmethod
    def sampled_directions(cls, samples: np.ndarray) -> np.ndarray:
        """``(k, m)`` float64, slab normals for ``(N, m)`` samples, in their units; the axes by default."""
        return np.eye(samples.shape[1])

    def __init__(
        self, domain: Domain | RegionDomain, tensors: dict[str, np.ndarray], sizes: dict, device: str | None = None
    ):
        """See ``Bounder``; raises ``BounderError`` where the tensors do not fit together."""
        super().__init__(domain, tensors, sizes, device)
        n = self.dimensions
        names = {"low", "high"} if self.diagonal else {"directions", "low", "high"}
        count = n if self.diagonal else len(self.tensors.get("directions", ()))
        shapes = {"low": (count,), "high": (count,), "directions": (count, n)}
        if set(self.tensors) != names or count == 0 or any(t.shape != shapes[k] for k, t in self.tensors.items()):
            found = {k: t.shape for k, t in self.tensors.items()}
            raise BounderError(f"{self.method}: expected tensors {sorted(names)} of k slabs in {n}D, got {found}")
        self.check_range()

    @property
    def dimensions(self) -> int:
        """Number n of coordinates of the points that the slabs hold."""
        return self.volume_domain.ndim

    def region_test(self) -> SlabRay | SlabPlane | SlabBox:
        low, high = self.tensors["low"].astype(np.float64), self.tensors["high"].astype(np.float64)
        if (low > high).any():
            raise BounderError(f"{self.method}: a slab's low face is above its high face")
        return REGIONS[self.query_kind](Slabs(self.directions, low, high, self.diagonal), self.domain)

    @property
    def directions(self) -> np.ndarray:
        """``(k, n)`` float64, slab normals in the coordinates of points."""
        return np.eye(self.dimensions) if self.diagonal else self.tensors["directions"].astype(np.float64)

    @property
    def source(self) -> SlabsSource:
        """See ``Bounder``."""
        count = self.region.count if self.region else len(self.tensors["low"])
        return SlabsSource(
            self.ndim,
            self.domain.time,
            count,
            self.diagonal,
            query=self.query_kind,
            space=self.domain.space,
        )

    def volume_weights(self) -> np.ndarray:
        parts = [self.tensors["low"], self.tensors["high"]]
        return np.concatenate(parts if self.diagonal else [*parts, self.tensors["directions"].reshape(-1)])

    def volume_reference(self, v: np.ndarray) -> np.ndarray:
        y = v @ self.directions.T
        return np.minimum(y - self.tensors["low"], self.tensors["high"] - y).min(axis=1)

    def volume_bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        d = self.directions
        low, high = self.tensors["low"].astype(np.float64), self.tensors["high"].astype(np.float64)
        center, half = (lower + upper) / 2, (upper - lower) / 2
        y, reach = center @ d.T, half @ np.abs(d).T
        slack = np.concatenate([y - reach - low, high - y - reach], axis=1)
        size = np.abs(lower).max(axis=0) + np.abs(upper).max(axis=0)
        rounding = gamma(2 * self.domain.ndim + 8, UNIT64) * float(
            (size @ np.abs(d).T + np.abs(low) + np.abs(high)).max()
        )
        worst = np.argmin(slack, axis=1)
        normal = np.concatenate([d, -d])[worst]
        point = np.where(normal > 0, lower, upper)
        return BoxBounds(slack.min(axis=1) - rounding, np.argmax(half, axis=1), point, self.volume_reference(point))

    def least(self, grid: IndicatorGrid) -> tuple[float, int]:
        """See ``Bounder``; zero for regions that are tested against the slabs.

        Raises:
            BounderError: If the slabs do not hold all of the object.
        """
        if self.domain.parametric:
            normals = self.directions
            reach = ParametricSupport(grid, self.domain)(np.concatenate([normals, -normals]))
            high, low = (self.tensors[name].astype(np.float64) for name in ("high", "low"))
            slack = np.concatenate([high - reach[: len(high)], -low - reach[len(high) :]])
            return float(np.nextafter(slack.min(), -np.inf)), len(reach)
        least, count = super().least(grid)
        if not self.region:
            return least, count
        if not least >= 0:
            raise BounderError(f"{self.method}: the slabs do not hold all of the object")
        return 0.0, count

    def volume_rounding(self) -> float:
        largest = np.maximum(np.abs(self.tensors["low"]), np.abs(self.tensors["high"])).astype(np.float64)
        return _rounding(self.directions, largest, self.domain, self.diagonal)


def _ends(occupancy: np.ndarray) -> np.ndarray:
    """First and last occupied cells of every grid line along the last axis: a linear function is extreme on one of them."""
    first = occupancy & (np.cumsum(occupancy, axis=-1) == 1)
    last = occupancy & (np.cumsum(occupancy[..., ::-1], axis=-1)[..., ::-1] == 1)
    return np.argwhere(first | last)


def _rounding(directions: np.ndarray, largest: np.ndarray, domain: Domain, diagonal: bool) -> float:
    """Error of a face distance: the sum of n products (none if diagonal), then one subtraction."""
    reach = np.abs(directions) @ domain.limit.astype(np.float64)
    product = 0.0 if diagonal else gamma(domain.ndim + 1) * reach
    flushed = (
        2 * domain.ndim + 2 + np.abs(directions).sum(axis=1) + domain.limit.sum()
    ) * TINY  # a factor or a result set to zero
    return float((product + gamma(2) * (reach + product + largest) + flushed).max())
