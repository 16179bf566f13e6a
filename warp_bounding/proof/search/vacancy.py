"""Branch and bound over the positives of a shape without a grid: points that the shape does not certify to be absent.

The search begins with the whole domain. A box matters only while its certified bound of f is too low; then the shape is
asked whether the box is *vacant*: whether no v in it can come from a point of the object, with everything that the
pipeline rounds. Vacant boxes are dropped, the others halved. So the shape is asked only where the bounder says *no*, or
nearly so, and most of the domain is never refined. A shape that knows half-spaces of its part in a box
(``Shape.half_spaces``) closes many boxes that are neither vacant nor high enough in f (``search.half_space``). A box that has become ``NARROWEST`` on every axis counts as object.
"""

from abc import ABC, abstractmethod

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.indicators.shape import Shape
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.proof.search.half_space import HeldBounds, bound_in_half_spaces

__all__ = ["LONGEST_TO_SPLIT", "NARROWEST", "Positives", "ShapePositives"]

NARROWEST = 2.0**-14  # local units, in which the domain is about [-1, 1]^n: sides of boxes that are not halved any more
# A box whose longest side is so many times that which the bound of f would halve is halved along its longest side:
# f alone would leave flat boxes, which shapes that know a distance only can never certify.
LONGEST_TO_SPLIT = 8.0


class Positives(ABC):
    """Boxes that hold all positives of a shape, and what the shape knows of these; searched by ``best_first.minimum``.

    The numbers of the boxes are coordinates v, or others (Z of them) from which v follows.
    """

    @abstractmethod
    def boxes(self) -> tuple[np.ndarray, np.ndarray]:
        """``(N, Z)`` corners of boxes that hold everything which can come from a positive."""

    @abstractmethod
    def reference(self, v: np.ndarray) -> np.ndarray:
        """F at ``(N, Z)``; see ``Bounder.reference``."""

    @abstractmethod
    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """Certified bounds of f over boxes; see ``Bounder.bound``."""

    @abstractmethod
    def vacant(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """``(N,)`` bool, certified: nothing in the closed box can come from a positive."""

    @abstractmethod
    def held(self, lower: np.ndarray, upper: np.ndarray, bounds: BoxBounds, target: np.ndarray) -> HeldBounds:
        """What is known of f over what in boxes comes from positives.

        Args:
            lower: ``(N, Z)`` float64 corners.
            upper: ``(N, Z)`` float64.
            bounds: What ``bound`` has told of these boxes.
            target: ``(N,)``, f that is of no interest any more.
        """

    @abstractmethod
    def too_small(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """``(N,)`` bool: boxes that are not halved any more."""

    @abstractmethod
    def holds(self, v: np.ndarray) -> np.ndarray:
        """``(N,)`` bool: whether these are positives of the shape, for all that is known."""


class ShapePositives(Positives):
    """P_delta of a shape of points, by what it certifies to be absent.

    Args:
        bounder: Its f is bounded; it is tested as a point of the object's space, or a ``LeastBox``.
        shape: The object.
        narrowest: See ``NARROWEST``; ``certify`` takes less, so that no box decides there that the fit has halved.
    """

    def __init__(self, bounder: Bounder, shape: Shape, narrowest: float = NARROWEST):
        self.bounder, self.shape, self.narrowest = bounder, shape, narrowest
        self.domain = bounder.domain
        self.asked = 0  # boxes that the shape was asked about

    def boxes(self) -> tuple[np.ndarray, np.ndarray]:
        """See ``Positives``: every v of a query that is not answered without f, one box, or ``cut`` in pieces."""
        limit = self.domain.limit.astype(np.float64)[None]
        return self.bounder.cut(-limit, limit)[:2]

    def reference(self, v: np.ndarray) -> np.ndarray:
        """See ``Positives``."""
        return self.bounder.reference(v)

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """See ``Positives``; flat boxes are halved along their longest side."""
        bounds = self.bounder.bound(lower, upper)
        return bounds._replace(axis=_unless_flat(upper - lower, bounds.axis), next_axis=None)

    def vacant(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """See ``Positives``."""
        self.asked += len(lower)
        return self.shape.empty(*self.domain.origins(lower, upper))

    def held(self, lower: np.ndarray, upper: np.ndarray, bounds: BoxBounds, target: np.ndarray) -> HeldBounds:
        """See ``Positives``."""
        known = None if bounds.slope is None else self.shape.half_spaces(*self.domain.origins(lower, upper))
        if known is None:
            least = np.where(self.vacant(lower, upper), np.inf, bounds.lower)
            return HeldBounds(least, bounds.axis, (lower, upper), np.zeros(len(lower), dtype=bool))
        self.asked += len(lower)
        found = bound_in_half_spaces(self.domain, lower, upper, bounds, known, target)
        return found._replace(axis=_unless_flat(found.corners[1] - found.corners[0], found.axis))

    def too_small(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """See ``Positives``."""
        return ((upper - lower) <= self.narrowest).all(axis=1)

    def holds(self, v: np.ndarray) -> np.ndarray:
        """See ``Positives``: whether the exact v of a point of the object lies here."""
        return self.shape.contains(self.domain.to_object(v))


def _unless_flat(side: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """The axes along which boxes of these sides are to be halved, ``(N,)``; of a flat box that of its longest side."""
    longest, row = side.argmax(axis=1), np.arange(len(side))
    return np.where(side[row, longest] > LONGEST_TO_SPLIT * side[row, axis], longest, axis)
