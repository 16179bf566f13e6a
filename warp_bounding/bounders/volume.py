"""Volumes that regions are tested against as a whole: what slabs, ellipsoids and half-spaces have in common."""

from abc import abstractmethod
from collections.abc import Mapping
from functools import cached_property
from typing import Any, ClassVar, Protocol

import numpy as np

from warp_bounding.bounders.base import Bounder, BoxBounds
from warp_bounding.coordinates.domain import Domain
from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.errors import BounderError

__all__ = ["RegionTest", "VolumeBounder"]


class RegionTest(Protocol):
    """The test of a kind of region against a volume."""

    error: float  # bounds how far the computed f may lie under ``reference``

    def reference(self, v: np.ndarray) -> np.ndarray:
        """The largest value of the volume's f on each region, or more; ``(N,)`` float64."""


class VolumeBounder(Bounder):
    """A volume in the space of points, which regions are tested against, or of a region's own numbers (parametric).

    A subclass has the volume's own f (``volume_weights``, ``volume_reference``, ``volume_bound``, ``volume_rounding``),
    and makes the test of regions (``region_test``). f of a region is at least the largest value of the volume's f on
    it.
    """

    regions: ClassVar[Mapping[str, Any]]  # the tests of regions, by their kind of query

    @classmethod
    def supports(cls, query: str, ndim: int, space: str = "geometric") -> bool:
        return super().supports(query, ndim, space) or (query in cls.regions and ndim >= 2)

    @property
    def volume_domain(self) -> Domain | RegionDomain:
        """The domain of the space that the volume lies in."""
        return self.domain.base if self.domain.tested_as_region else self.domain

    @cached_property
    def volume(self) -> "VolumeBounder | None":
        if not self.domain.tested_as_region:
            return None
        return type(self)(self.volume_domain, self.tensors, self.sizes, self._device)

    @cached_property
    def region(self) -> Any:
        """The test of regions of space; ``None`` where there are none."""
        return self.region_test() if self.domain.tested_as_region else None

    @abstractmethod
    def region_test(self) -> RegionTest:
        """The test of this domain's kind of region against the volume."""

    @abstractmethod
    def volume_weights(self) -> np.ndarray:
        """``weights`` of points."""

    @abstractmethod
    def volume_reference(self, v: np.ndarray) -> np.ndarray:
        """``reference`` of points."""

    @abstractmethod
    def volume_bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """``bound`` of boxes of points."""

    @abstractmethod
    def volume_rounding(self) -> float:
        """``rounding_bound`` of points."""

    def region_weights(self) -> np.ndarray:
        """``weights`` of regions of space."""
        return self.region.weights

    def weights(self) -> np.ndarray:
        return self.region_weights() if self.region else self.volume_weights()

    def reference(self, v: np.ndarray) -> np.ndarray:
        v = np.asarray(v, dtype=np.float64)
        return self.region.reference(v) if self.region else self.volume_reference(v)

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """See ``Bounder``; exact up to float64 rounding.

        Raises:
            BounderError: For regions that are tested against the volume.
        """
        if self.region:
            raise BounderError(f"{self.method}: {self.query_kind} queries are proven by their volume")
        return self.volume_bound(lower, upper)

    def rounding_bound(self) -> float:
        return self.region.error if self.region else self.volume_rounding()

    def check_range(self) -> None:
        if self.region:
            self.volume.check_range()
        super().check_range()

    @property
    def nbytes(self) -> int:
        """See ``Bounder``; of a region's test, the numbers that it reads, not the tensors that they follow from."""
        if not self.region:
            return super().nbytes
        return 4 * (len(self.domain.header) + 1 + len(self.domain.extra) + len(self.weights()))
