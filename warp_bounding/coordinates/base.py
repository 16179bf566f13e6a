"""A bounder's coordinates for a kind of query: the map to them, its rounding, its C text, what a placement does.

In local space, where the domain is about [-1, 1]^n, a query becomes numbers ``v``. The C text that computes them is
given ``V q[]`` (the numbers in object space), ``center scale limit`` (n each), ``extra``, a ``V zero`` and the
functions ``root`` and ``over`` (``kernels``); it sets ``V v[]`` and clears two masks: ``finite`` (false: *maybe*,
whatever else holds) and ``inside`` (false: *no*). V is a vector of queries or a float, so masks are combined with ``&``
and ``|`` and never negated. Where a shape is placed, ``q`` are numbers in the world and ``place`` is
``Placement.values``: another text moves q first, in place.
"""

from abc import ABC, abstractmethod
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from warp_bounding.arithmetic import UNIT32, gamma
from warp_bounding.queries import QUERIES

__all__ = [
    "FAR",
    "FARTHEST",
    "GEOMETRIC",
    "GUARD",
    "LARGEST",
    "LATER",
    "PARALLEL",
    "PARAMETRIC",
    "SMALLEST",
    "SUMMED",
    "Coordinates",
    "Numbers",
    "WorldMap",
    "direction_rounding",
    "literal",
    "vector_type",
]

GEOMETRIC, PARAMETRIC = "geometric", "parametric"  # spaces: v is tested as a region, or its numbers are one point
FAR = 8.0  # domain half-widths: a region given from farther away, and not certainly outside, is answered with maybe
SMALLEST = 2.0**-90  # largest entry of a direction under which it is answered with maybe
LARGEST = 2.0**90  # and beyond which it is
FARTHEST = 2.0**60  # the sum of absolute values of a point's coordinates beyond which a region is answered with maybe
PARALLEL = 2.0**-80  # of w: a ray that moves less than this along an axis does not cross a face
GUARD = 16 * UNIT32  # relative room in the test against the domain: over three times its rounding
SUMMED = 2.0**-17  # of an offset: above what a sum of n <= 64 products rounds, n + 12 units
LATER = 4 * GUARD  # of a ray's time: above the rounding of its end, n + 18 units

Numbers = wp.array(dtype=wp.float32)


class WorldMap(NamedTuple):
    """A placement before rounding, float64: M, M^-1, the translation, and the error of the latter in float32."""

    matrix: np.ndarray
    forward: np.ndarray
    translation: np.ndarray
    away: np.ndarray


class Coordinates(ABC):
    """The coordinates of a kind of query.

    A ``domain`` is a ``Domain`` or ``RegionDomain`` of that kind, ``base`` its domain of points.

    Attributes:
        name: Of the kind of query.
        text: The C text from q to v.
        moving: The C text that moves q from the world into the object's space, before it.
    """

    name: str
    text: str
    moving: str

    @property
    def parametric(self) -> "Coordinates":
        """The coordinates in parametric space: where v is a query's own numbers already, these."""
        return self

    def columns(self, n: int) -> int:
        """Numbers of a query about an object of dimension n."""
        return QUERIES[self.name].columns(n)

    def ndim(self, n: int) -> int:
        """Number of coordinates ``v`` for an object of dimension n."""
        return 2 * n

    def extra_count(self, n: int, time: bool) -> int:
        """Numbers ``extra``: the kind's, then the largest coordinate that certainly lies inside the range of time."""
        return int(time)

    def stretch(self, base, length: float | None) -> np.ndarray:
        """``(n,)`` float32, a ray's displacement in local space, per axis and unit direction; ones for others."""
        return np.ones(base.ndim, np.float32)

    def extra(self, domain) -> np.ndarray:
        """float32, the kind's own part of ``extra``."""
        return np.zeros(0, np.float32)

    def units(self, domain) -> np.ndarray:
        """``(2 n,)`` float64, ``v`` per unit of a query's own numbers, in parametric space."""
        return np.tile(domain.base.scale.astype(np.float64), 2)

    @abstractmethod
    def limit(self, domain) -> np.ndarray:
        """``(ndim,)`` float32, largest ``|v|`` that a bounder is asked about."""

    @abstractmethod
    def delta(self, domain) -> np.ndarray:
        """``(ndim,)`` float64, the input error of ``v`` that proofs cover."""

    @abstractmethod
    def rounding(self, base, length: float | None) -> np.ndarray:
        """``(n,)``: how far, per axis of local space, the computed query may pass a point of the exact one."""

    @abstractmethod
    def to_local(self, domain, q: np.ndarray) -> np.ndarray:
        """``v`` ``(N, ndim)`` of finite queries ``(N, m)`` that meet the domain, in float64."""

    @abstractmethod
    def to_object(self, domain, v: np.ndarray) -> np.ndarray:
        """A query ``(N, m)`` float64 in object space for each ``v`` ``(N, ndim)``."""

    @abstractmethod
    def plain(self, n: int, time: bool, placed: bool, front: int) -> wp.Function:
        """The twin of ``text`` in Warp's own Python: ``(parameters, place, q) -> (v, finite, inside)``."""

    @abstractmethod
    def plain_move(self, n: int) -> wp.Function:
        """The twin of ``moving``: ``(place, q) -> (q, finite)``."""

    def placed_values(self, domain, world: WorldMap) -> list[np.ndarray]:
        """What the kernels read of a placement besides translation and matrix."""
        return []

    @abstractmethod
    def placed_rounding(self, domain, world: WorldMap, input_unit: float) -> np.ndarray:
        """``(n,)``, local space: how far a moved query may pass a point (``placement_rounding``); infinite without a bound.

        Args:
            domain: The bounder's.
            world: The map.
            input_unit: By how much the numbers were rounded before they were moved, relatively.
        """


@cache
def vector_type(length: int) -> Any:
    """A vector of so many float32 numbers, Warp's own where it has a name."""
    own = {2: wp.vec2, 3: wp.vec3, 4: wp.vec4}
    return own[length] if length in own else wp.types.vector(length=length, dtype=wp.float32)


def literal(value: float) -> str:
    """A float32 constant in C, exactly."""
    return f"{float(value).hex()}f"


def direction_rounding(ndim: int) -> float:
    """Relative error of an entry of a unit direction: two divisions, the norm of n squares, a float64 input."""
    return gamma(ndim + 10)
