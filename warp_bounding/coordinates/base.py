"""A bounder's coordinates for a kind of query: the map to them, its rounding, its C text, what a placement does.

*Local space* is object space mapped by ``x -> (x - center) * scale``; the domain is about [-1, 1]^n there. A query
becomes numbers ``v`` of that space: coordinates of points, displacements, normals. The C text that computes them is
given ``V q[]`` (the numbers in object space), ``center scale limit`` (n each), ``extra``, a ``V zero`` and the
functions ``root`` and ``over`` (``kernels``). It sets ``V v[]`` and clears two masks: ``testable`` (false: the query
cannot be tested, the answer is *maybe*, whatever ``inside`` says: a number that is not finite, a direction without a
usable length, an inverted box, a region that is given from too far away or lies outside the range of time) and
``inside`` (false: *no*). V is a vector of queries or a float, so masks are combined with ``&`` and ``|`` and never
negated. Where a shape is placed, ``q`` are numbers in the world and ``place`` is ``Placement.values``: another text
moves q into object space first.
"""

from abc import ABC, abstractmethod
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from warp_bounding.arithmetic import UNIT32, gamma, round_up
from warp_bounding.queries import QUERIES

__all__ = [
    "DIRECTION_LARGEST",
    "DIRECTION_SMALLEST",
    "FAR",
    "FARTHEST_SUM",
    "GUARD",
    "LATER",
    "PARALLEL",
    "SUMMED",
    "UNIT_LIMIT",
    "Coordinates",
    "Numbers",
    "WorldMap",
    "direction_rounding",
    "literal",
    "vector_type",
]

FAR = 8.0  # of |a|_1, a region's point in local space: one from farther away that may meet the domain is *maybe*
FARTHEST_SUM = 2.0**60  # of |a|_1: beyond it a region is *maybe* in any case, as sums with it could overflow
# A direction whose largest |entry| is outside of these is *maybe*, so that products with it neither overflow nor
# vanish.
DIRECTION_SMALLEST, DIRECTION_LARGEST = 2.0**-90, 2.0**90
PARALLEL = 2.0**-80  # local units: a ray whose w is at most this on an axis counts as parallel to that axis' faces
GUARD = 16 * UNIT32  # relative room in the test against the domain: over three times its rounding
SUMMED = 2.0**-17  # relative, of an offset: above what a sum of n <= 64 products rounds, n + 12 units
LATER = 4 * GUARD  # relative, of coordinate 0 at a ray's end: above the rounding of it, n + 18 units
# The largest |entry| of a computed unit vector, times a stretch. It does not grow with n: the norm is the root of a
# sum of non-negative squares, and rounding is monotonic, so the sum is at least the rounded square of each entry. With
# e_k the entry before the last division, norm >= |e_k| (1 - u)^(3/2); the quotient and the product round once more: 4
# units.
UNIT_LIMIT = 1 + gamma(16)

Numbers = wp.array(dtype=wp.float32)


class WorldMap(NamedTuple):
    """A placement before rounding, float64.

    Attributes:
        matrix: M, from the world's axes to the object's.
        forward: M^-1, from the object's axes to the world's.
        translation: Where the object's origin stands in the world.
        translation_error: By how much each of its numbers changes when it is rounded to float32.
    """

    matrix: np.ndarray
    forward: np.ndarray
    translation: np.ndarray
    translation_error: np.ndarray


class Coordinates(ABC):
    """The coordinates of a kind of query.

    A ``domain`` is a ``Domain`` or ``RegionDomain`` of that kind, ``base`` its domain of points.

    Attributes:
        name: Of the kind of query.
        directed: Of each n of a query's numbers, whether they are a direction without a length; else they are a point.
        text: The C text from q to v.
        moving: The C text that moves q from the world into the object's space; it runs before ``text``.
    """

    name: str
    directed: tuple[bool, ...]
    text: str
    moving: str

    def columns(self, n: int) -> int:
        """Numbers of a query about an object of dimension n."""
        return QUERIES[self.name].columns(n)

    def ndim(self, n: int) -> int:
        """Number of coordinates ``v`` for an object of dimension n."""
        return self.columns(n)

    def extra_count(self, n: int, time: bool) -> int:
        """How many numbers ``extra`` there are: the kind's own, and one more where coordinate 0 is time."""
        return int(time)

    def stretch(self, base, length: float | None) -> np.ndarray:
        """``(n,)`` float32, a ray's displacement in local space, per axis and unit direction; ones for others."""
        return np.ones(base.ndim, np.float32)

    def extra(self, domain) -> np.ndarray:
        """float32, the kind's own part of ``extra``."""
        return np.zeros(0, np.float32)

    def limit(self, domain) -> np.ndarray:
        """``(ndim,)`` float32, largest ``|v|`` that a bounder is asked about."""
        return self._by_part(domain.base.limit, round_up(domain.stretch * UNIT_LIMIT))

    def delta(self, domain) -> np.ndarray:
        """``(ndim,)`` float64, the input error of ``v`` that proofs cover."""
        base = domain.base
        return self._by_part(base.delta, direction_rounding(base.ndim) * domain.stretch.astype(np.float64))

    def to_local(self, domain, q: np.ndarray) -> np.ndarray:
        """``v`` ``(N, ndim)`` of finite queries ``(N, m)`` that meet the domain, in float64."""
        parts = np.split(q, len(self.directed), axis=1)
        for k, part in enumerate(parts):
            if self.directed[k]:
                parts[k] = part / np.linalg.norm(part, axis=1, keepdims=True) * domain.stretch.astype(np.float64)
            else:
                parts[k] = domain.base.to_local(part)
        return np.concatenate(parts, axis=1)

    def to_object(self, domain, v: np.ndarray) -> np.ndarray:
        """A query ``(N, m)`` float64 in object space for each ``v`` ``(N, ndim)``."""
        stretch, parts = domain.stretch.astype(np.float64), np.split(v, len(self.directed), axis=1)
        both = zip(parts, self.directed, strict=True)
        return np.concatenate([p / stretch if directed else domain.base.to_object(p) for p, directed in both], axis=1)

    def _by_part(self, point: np.ndarray, direction: np.ndarray) -> np.ndarray:
        return np.concatenate([direction if directed else point for directed in self.directed])

    @abstractmethod
    def rounding(self, base, length: float | None) -> np.ndarray:
        """``(n,)``: how far, per axis of local space, the computed query may pass a point of the exact one."""

    def placed_values(self, domain, world: WorldMap) -> list[np.ndarray]:
        """What the kernels read of a placement besides translation and matrix."""
        return []

    @abstractmethod
    def placed_rounding(self, domain, world: WorldMap, input_unit: float) -> np.ndarray:
        """``(n,)``, local units: how far a moved query may pass a point of the exact one; infinite without a bound.

        See ``placement_rounding``.

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
