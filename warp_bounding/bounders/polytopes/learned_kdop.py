"""``learned-kdop``: a k-DOP whose k half-spaces are free and learned by gradient descent (the paper's OurkDOP).

As many half-spaces as ``kdop`` has, but each with a normal of its own instead of pairs on given axes. Learned are the normals
only (``training.kdop``): every face is set to the exact support of what is bounded, so any normals make a conservative volume,
and any step of training can be the last. For regions there are two kinds, as for the classics: a polytope in object space that
rays, planes and boxes are tested against (k = 4 n, ``half_spaces``), and one in the space of a region's own 2n numbers
(k = 8 n, ``ParametricSupport``).
"""

from functools import cached_property

import numpy as np

from warp_bounding.arithmetic import TINY, UNIT64, gamma, round_up
from warp_bounding.bounders.base import BoxBounds
from warp_bounding.bounders.options import STEPS, Option
from warp_bounding.bounders.parametric_fit import units
from warp_bounding.bounders.polytopes.half_spaces import REGIONS, HalfSpacesSource
from warp_bounding.bounders.slabs.kdop import BY_VERTICES, kdop_directions
from warp_bounding.bounders.volume import RegionTest, VolumeBounder
from warp_bounding.coordinates.base import GEOMETRIC
from warp_bounding.coordinates.domain import Domain
from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.errors import BounderError
from warp_bounding.geometry.checked_inverse import MOST_VERTEX_DIMENSIONS
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.support_functions.object import ObjectSupport
from warp_bounding.support_functions.parametric import ParametricSupport

__all__ = ["LearnedKdop", "classic_normals"]

MOST_REGION_DIMENSIONS = 16  # of an object whose rays, planes and boxes are bounded


def classic_normals(domain: Domain | RegionDomain, k: int | None = None) -> np.ndarray:
    """``kdop``'s half-spaces, where training starts from: ``(k, m)`` float64 normals in the coordinates of what is bounded."""
    scale = units(domain) if domain.parametric else domain.scale.astype(np.float64)
    directions = kdop_directions(len(scale), k) / scale
    return np.concatenate([directions, -directions])


class LearnedKdop(VolumeBounder):
    """k free half-spaces; see module.

    Tensors: ``normals`` ``(k, m)`` and ``offsets`` ``(k,)``, in the coordinates of points, or of v in parametric space.
    """

    method = "learned-kdop"
    regions = REGIONS
    options = (
        Option("k", None, "half-spaces, as many as kdop's by default, 40 before a network; 128 at most", parse=int),
        STEPS,
    )

    @classmethod
    def supports(cls, query: str, ndim: int, space: str = "geometric") -> bool:
        """See ``Bounder``."""
        by_vertices = query in BY_VERTICES and space == GEOMETRIC
        most = MOST_VERTEX_DIMENSIONS if by_vertices else MOST_REGION_DIMENSIONS
        return super().supports(query, ndim, space) or (query in REGIONS and 2 <= ndim <= most)

    @classmethod
    def fit(
        cls, grid: IndicatorGrid, domain: Domain | RegionDomain, *, k: int | None = None, device: str | None = None
    ) -> "LearnedKdop":
        """Where training starts: the half-spaces of ``kdop``, each on its own."""
        return cls.of_normals(grid, domain, classic_normals(domain, k), device=device)

    @classmethod
    def of_normals(
        cls,
        grid: IndicatorGrid,
        domain: Domain | RegionDomain,
        normals: np.ndarray,
        *,
        support: "ObjectSupport | ParametricSupport | None" = None,
        device: str | None = None,
    ) -> "LearnedKdop":
        """The tightest half-spaces with these normals.

        Args:
            grid: The object.
            domain: Of the kind of query.
            normals: ``(k, m)``, scaled as they come.
            support: ``support_of(grid, domain)``, where there is one already.
            device: Warp device.
        """
        normals = np.asarray(normals, dtype=np.float64)
        largest = np.abs(normals).max(axis=1, keepdims=True)
        normals = (normals / np.where(largest > 0, largest, 1)).astype(np.float32)
        if not (np.isfinite(normals).all() and (largest > 0).all()):
            raise BounderError("learned-kdop: a normal is zero or not finite")
        reach = (support or support_of(grid, domain))(normals.astype(np.float64))
        tight = cls(_tested_domain(domain), {"normals": normals, "offsets": round_up(reach)}, {}, device)
        offsets = round_up(reach + 2 * tight.rounding_bound())  # so that the threshold comes out at about zero
        return cls(domain, {"normals": normals, "offsets": offsets}, {}, device)

    def __init__(
        self, domain: Domain | RegionDomain, tensors: dict[str, np.ndarray], sizes: dict, device: str | None = None
    ):
        """See ``Bounder``; raises ``BounderError`` where the tensors do not fit together."""
        super().__init__(domain, tensors, sizes, device)
        columns = self.volume_domain.ndim
        count = len(self.tensors.get("offsets", ()))
        expected = {"normals": (count, columns), "offsets": (count,)}
        if count == 0 or {k: t.shape for k, t in self.tensors.items()} != expected:
            found = {k: t.shape for k, t in self.tensors.items()}
            raise BounderError(f"learned-kdop: expected normals (k, {columns}) and offsets (k,), got {found}")
        self.check_range()

    @cached_property
    def _numbers(self) -> tuple[np.ndarray, np.ndarray]:
        """Normals and offsets in float64."""
        return self.tensors["normals"].astype(np.float64), self.tensors["offsets"].astype(np.float64)

    @property
    def source(self) -> HalfSpacesSource:
        """See ``Bounder``."""
        count, domain = len(self.tensors["offsets"]), self.domain
        return HalfSpacesSource(self.ndim, domain.time, count, query=domain.query, space=domain.space)

    def region_test(self) -> RegionTest:
        return REGIONS[self.query_kind](*self._numbers, self.domain)

    def volume_weights(self) -> np.ndarray:
        return np.concatenate([self.tensors["offsets"], self.tensors["normals"].reshape(-1)])

    def volume_reference(self, v: np.ndarray) -> np.ndarray:
        normals, offsets = self._numbers
        return (offsets - v @ normals.T).min(axis=1)

    def volume_bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        normals, offsets = self._numbers
        center, half = (lower + upper) / 2, (upper - lower) / 2
        slack = offsets - center @ normals.T - half @ np.abs(normals).T
        size = np.abs(lower).max(axis=0) + np.abs(upper).max(axis=0)
        rounding = gamma(2 * normals.shape[1] + 8, UNIT64) * float((size @ np.abs(normals).T + np.abs(offsets)).max())
        point = np.where(normals[np.argmin(slack, axis=1)] < 0, lower, upper)
        return BoxBounds(slack.min(axis=1) - rounding, np.argmax(half, axis=1), point, self.volume_reference(point))

    def least(self, grid: IndicatorGrid) -> tuple[float, int]:
        """See ``Bounder``; zero for regions that are tested against the polytope.

        Raises:
            BounderError: If the polytope does not hold all of the object.
        """
        if self.region:
            least, count = self.volume.least(grid)
            if not least >= 0:
                raise BounderError(f"{self.method}: the half-spaces do not hold all of the object")
            return 0.0, count
        if not self.domain.parametric:
            return super().least(grid)
        normals, offsets = self._numbers
        slack = offsets - ParametricSupport(grid, self.domain)(normals)
        return float(np.nextafter(slack.min(), -np.inf)), len(slack)

    def volume_rounding(self) -> float:
        """See ``Bounder``: a sum of products, then one subtraction."""
        normals, offsets = self._numbers
        n, limit = normals.shape[1], self.domain.limit.astype(np.float64)
        reach = np.abs(normals) @ limit
        flushed = (2 * n + 2 + np.abs(normals).sum(axis=1) + limit.sum()) * TINY  # a factor or a result set to zero
        return float((gamma(n + 3) * (reach + np.abs(offsets)) + flushed).max() * (1 + 1e-9))


def support_of(grid: IndicatorGrid, domain: Domain | RegionDomain) -> "ObjectSupport | ParametricSupport":
    """The certified support of what half-spaces of this domain's kind of query hold: the object, or its positive regions."""
    return ParametricSupport(grid, domain) if domain.parametric else ObjectSupport(grid, domain.base)


def _tested_domain(domain: Domain | RegionDomain) -> Domain | RegionDomain:
    """The domain of the space that the half-spaces live in."""
    return domain.base if domain.tested_as_region else domain
