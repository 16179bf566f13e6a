"""Distances to volumes: what the closed forms have in common.

A proven bounder of points denies only points outside a volume ``{x: f(x) >= threshold}`` that holds the object: that is its certificate. The distance to
the volume, or less, is therefore a lower bound of the distance to the object, and needs no proof of its own. The file holds the
bounder of points (its tensors; in ``sizes`` its domain, sizes and threshold), and everything that the kernel reads follows from these numbers, rounded
outwards; ``certify`` proves the bounder of points again.

What follows is computed in the coordinates of the ``DistanceDomain``, y, in float64, and charged ``NOISE`` relative to all that enters, which
is some hundred times what its few sums and products round.
"""

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import numpy as np

from warp_bounding.bounders.base import Bounder
from warp_bounding.bounders.distances.base import DistanceBounder
from warp_bounding.bounders.options import Option, taken
from warp_bounding.coordinates.distance_domain import DistanceDomain
from warp_bounding.coordinates.domain import Domain, json_number
from warp_bounding.errors import BounderError
from warp_bounding.kernels.distances.source import FLUSHED, DistanceSource
from warp_bounding.queries.point import POINT

__all__ = ["NOISE", "Form", "VolumeDistance"]

NOISE = 1e-13  # relative to the sizes of all terms: more than float64 rounds in sums and products of them


class Form(NamedTuple):
    """What a kernel computes a distance to a volume from.

    Attributes:
        source: Made from ``(ndim, time)`` and these sizes.
        numbers: float32, the source's.
        error: E, without ``FLUSHED``.
        growth: See ``DistanceBounder``.
        reference: F of ``(N, n)`` float64 local coordinates.
    """

    source: DistanceSource
    numbers: np.ndarray
    error: float
    growth: float
    reference: Callable[[np.ndarray], np.ndarray]


class VolumeDistance(DistanceBounder):
    """The distance to the volume of a bounder of points. A subclass names its class and tells how far the volume is (``form_of``).

    Tensors: those of the bounder of points. Sizes: ``volume``, a table of its ``domain``, ``sizes`` and ``threshold``.
    """

    bounds: ClassVar[type[Bounder]]  # the class of bounders of points

    @classmethod
    def form_of(cls, volume: Bounder, domain: DistanceDomain) -> Form:
        """How far the volume is."""
        raise TypeError(f"{cls.__name__} does not define form_of")

    @classmethod
    def options_taken(cls) -> tuple[Option, ...]:
        return tuple(taken([cls.bounds], POINT.name).values())

    @classmethod
    def supports(cls, ndim: int) -> bool:
        return super().supports(ndim) and cls.bounds.supports(POINT.name, ndim)

    @classmethod
    def around(cls, volume: Bounder, domain: DistanceDomain, sizes: dict[str, Any], device: str | None = None):
        """The distance to the volume of a bounder of points, with a threshold that covers rounding and nothing else.

        Args:
            volume: A bounder of points at its threshold.
            domain: Of the same object.
            sizes: What else there is to tell.
            device: Warp device.
        """
        told = {
            "domain": volume.domain.to_dict(),
            "sizes": volume.sizes,
            "threshold": float(volume.threshold),
        }
        return cls(domain, volume.tensors, {**sizes, "volume": told}, device)

    def check_tensors(self) -> None:
        told = self.sizes.get("volume")
        if not isinstance(told, dict) or set(told) != {"domain", "sizes", "threshold"}:
            raise BounderError(f"{self.method}: expected the volume's domain, sizes and threshold")
        domain, threshold = Domain.from_dict(told["domain"]), json_number(told["threshold"], "the volume's threshold")
        if domain.ndim != self.ndim or domain.time or domain.unbounded:
            raise BounderError(f"{self.method}: the volume is of another kind of object")
        if not np.isfinite(threshold) or float(np.float32(threshold)) != threshold:
            raise BounderError(f"{self.method}: the volume's threshold {threshold} is not a finite float32 number")
        self._volume = self.bounds(domain, self.tensors, told["sizes"], self._device).freeze(threshold, None)
        self._form = self.form_of(self._volume, self.domain)
        if not (np.isfinite(self._form.numbers).all() and np.isfinite(self._form.error)):
            raise BounderError(f"{self.method}: numbers are so large that float32 cannot hold them")

    @property
    def volume(self) -> Bounder:
        return self._volume

    @property
    def source(self) -> DistanceSource:
        return self._form.source

    def weights(self) -> np.ndarray:
        return self._form.numbers

    def reference(self, v: np.ndarray) -> np.ndarray:
        return self._form.reference(np.asarray(v, dtype=np.float64))

    def rounding_bound(self) -> float:
        return self._form.error + FLUSHED

    def growth(self) -> float:
        return self._form.growth
