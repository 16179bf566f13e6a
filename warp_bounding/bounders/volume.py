"""Volumes of points that regions are tested against as a whole: what slabs, ellipsoids and half-spaces have in common."""

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from warp_bounding.bounders.base import Bounder, BoxBounds
from warp_bounding.coordinates.domain import Domain
from warp_bounding.coordinates.object_support import ObjectSupport
from warp_bounding.errors import BounderError
from warp_bounding.geometry.hull import whole_hull
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.shape import Shape
from warp_bounding.kernels.source import Lanes, Source, fill
from warp_bounding.queries.point import POINT

__all__ = ["VolumeBounder", "VolumeSource", "VolumeTest"]


class VolumeTest:
    """The test of one kind of query against a volume; that of points also has ``bound``, as ``Bounder`` does."""

    weights: np.ndarray  # (K,) float32, as ``Bounder.weights`` gives them
    error: (
        float  # of points: ``Bounder.rounding_bound``; of regions: how far the computed f may lie under ``reference``
    )

    def reference(self, v: np.ndarray) -> np.ndarray:
        """``(N,)`` float64: f of points; of regions the largest value of the volume's f on each, or more."""
        raise TypeError(f"{type(self).__name__} does not define reference")


@dataclass(frozen=True)
class VolumeSource(Source):
    """Native code of a volume's tests: a text for each kind, in which the class's own fields and ``n`` are filled in."""

    texts: ClassVar[Mapping[str, str | Callable[[Any], str]]]  # by the kind of query that is tested

    def body(self, lanes: Lanes) -> str:
        text = self.texts[self.tested_kind]
        own = {name: str(value).lower() for name, value in vars(self).items()}  # C's true and false
        return fill(text(self) if callable(text) else text, n=self.tested_ndim, **own)


class VolumeBounder(Bounder):
    """A volume of points, which regions are tested against.

    A subclass has the numbers of its volume (``shape``) and the tests that are made of them and a domain.
    """

    tests: ClassVar[Mapping[str, Callable[..., Any]]]  # by the kind of query that is tested

    @classmethod
    def supports(cls, query: str, ndim: int) -> bool:
        return super().supports(query, ndim) or (query in cls.tests and ndim >= 2)

    @classmethod
    def takes_shapes(cls, query: str) -> bool:
        return not cls.lays_cells

    @property
    @abstractmethod
    def shape(self) -> Any:
        """The numbers of the volume in float64, as its tests take them."""

    @property
    def volume_domain(self) -> Domain:
        """The domain of points."""
        return self.domain.base

    @cached_property
    def volume(self) -> "VolumeBounder | None":
        if not self.domain.tested_as_region:
            return None
        return type(self)(self.volume_domain, self.tensors, self.sizes, self._device)

    @cached_property
    def test(self) -> Any:
        """The test of the volume, a ``VolumeTest``."""
        kind = self.query_kind if self.domain.tested_as_region else POINT.name
        return self.tests[kind](self.shape, self.domain)

    def weights(self) -> np.ndarray:
        return self.test.weights

    def reference(self, v: np.ndarray) -> np.ndarray:
        return self.test.reference(np.asarray(v, dtype=np.float64))

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """See ``Bounder``; exact up to float64 rounding. Raises ``BounderError`` for regions, which have a volume."""
        if self.volume is not None:
            raise BounderError(f"{self.method}: {self.query_kind} queries are proven by their volume")
        return self.test.bound(lower, upper)

    def rounding_bound(self) -> float:
        return self.test.error

    def exact_on_hull(self, shape: Shape) -> bool:
        """See ``Bounder``: f of points is concave, so least over a hull where it is least over the object."""
        return whole_hull(shape) is not None

    def least(self, grid: Shape) -> tuple[float, int]:
        """See ``Bounder``; of a shape without cells over the hull of the object (``geometry.hull``)."""
        if isinstance(grid, IndicatorGrid):
            return super().least(grid)
        hull, volume = whole_hull(grid), self.volume or self
        if hull is None:
            raise BounderError(f"{self.method}: {grid.name} has no known convex hull; give a resolution")
        least, count = volume.hull_least(ObjectSupport(grid, self.volume_domain, hull))
        if self.volume is None:  # nothing else is asked f; that decides where the volume is the domain
            limit = self.domain.limit.astype(np.float64)[None]
            least = max(least, float(self.bound(-limit, limit).lower[0]))
        return least, count

    @abstractmethod
    def hull_least(self, support: ObjectSupport) -> tuple[float, int]:
        """``least`` over the convex hull of the object's points."""

    def check_range(self) -> None:
        if self.volume is not None:
            self.volume.check_range()
        super().check_range()

    @property
    def nbytes(self) -> int:
        """See ``Bounder``; of a region's test, the numbers that it reads, not the tensors that they follow from."""
        if self.volume is None:
            return super().nbytes
        return 4 * (len(self.domain.header) + 1 + len(self.domain.extra) + len(self.weights()))
