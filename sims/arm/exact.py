"""The narrow phases of an arm: configurations one by one, and edges as planners do it, at configurations along them.

``Hulls`` asks the rounded hulls that the shape is made of, in Warp's float64 kernels; ``Meshes`` asks triangle meshes
of the same bodies with Coal, the way a user of Pinocchio does. Both check an edge at points that halve it again and
again until they are ``STEP`` apart, and stop at the first collision.
"""

from abc import abstractmethod
from functools import cache

import numpy as np

import warp_bounding as wb
from sims.arm.meshes import MeshModel
from sims.arm.workplace import Workplace
from sims.planning.planner import Cleared, Exact

__all__ = ["STEP", "Hulls", "Meshes", "Stepped"]

STEP = (
    0.02  # metres: the most that two configurations along an edge that are checked differ, in the place's coordinates
)


class Stepped(Exact):
    """Edges are checked at configurations along them; those at their ends are states of their own.

    Attributes:
        place: Where.
        checks: Configurations that were asked so far.
    """

    def __init__(self, place: Workplace):
        self.place, self.checks = place, 0

    @abstractmethod
    def hits(self, x: np.ndarray) -> np.ndarray:
        """Which configurations ``(N, n)`` float64 collide, in the place's coordinates: ``(N,)`` bool."""

    def states(self, x: np.ndarray) -> np.ndarray:
        x = self._checked(x)
        self.checks += len(x)
        return self.hits(x.astype(np.float64)) if len(x) else np.zeros(0, dtype=bool)

    def segments(self, starts: np.ndarray, ends: np.ndarray, cleared: Cleared | None = None) -> np.ndarray:
        """Which edges collide at a configuration along them; one of no length is its state.

        Configurations that the broad phase clears are not checked.

        Raises:
            QueryError: For another shape or dtype, or numbers that are not finite.
        """
        starts, ends = self._checked(starts), self._checked(ends)
        if len(starts) != len(ends):
            raise wb.QueryError(f"expected as many ends as starts, got {len(ends)} and {len(starts)}")
        begin, way = starts.astype(np.float64), ends.astype(np.float64) - starts
        length = np.linalg.norm(way, axis=1)
        halvings = np.ceil(np.log2(np.maximum(length / STEP, 1.0))).astype(int)
        hit, still = np.zeros(len(starts), dtype=bool), length == 0
        if len(starts) == 1 and not still[0]:
            hit[0] = self._along(begin[0], way[0], int(halvings[0]), cleared)
            return hit
        hit[still] = self.states(starts[still])
        for level in range(1, int(halvings.max(initial=0)) + 1):
            queried = np.flatnonzero((halvings >= level) & ~hit)
            for odd in range(1, 2**level, 2):
                queried = queried[~hit[queried]]
                if not len(queried):
                    break
                x, rows = begin[queried] + (odd / 2**level) * way[queried], queried
                if cleared is not None:
                    left = ~cleared(x)
                    x, rows = x[left], rows[left]
                self.checks += len(rows)
                if len(rows):
                    hit[rows] = self.hits(x)
        return hit

    def _along(self, begin: np.ndarray, way: np.ndarray, halvings: int, cleared: Cleared | None) -> bool:
        """Whether one edge collides.

        The broad phase is asked about all of it at once, since each call costs as much as many configurations.
        """
        x = begin + _halving(halvings)[:, None] * way
        if cleared is not None and len(x):
            x = x[~cleared(x)]
        for number in range(len(x)):
            self.checks += 1
            if self.hits(x[number : number + 1])[0]:
                return True
        return False

    def _checked(self, x: np.ndarray) -> np.ndarray:
        x, n = np.asarray(x), self.place.shape.ndim
        if x.dtype != np.float32 or x.ndim != 2 or x.shape[1] != n:
            raise wb.QueryError(f"expected (N, {n}) float32, got {x.shape} {x.dtype}")
        if not np.isfinite(x).all():
            raise wb.QueryError("expected finite configurations, got NaN or infinity")
        return x


class Hulls(Stepped):
    """The arm's rounded hulls, in Warp; what float64 cannot decide counts as a collision."""

    def hits(self, x: np.ndarray) -> np.ndarray:
        return self.place.shape.contains(x)


class Meshes(Stepped):
    """Triangle meshes of the bodies, with Coal and Pinocchio.

    They lie inside the hulls, so what is proven free of these is free of them.

    Raises:
        BoundingError: If these packages are not installed.
    """

    def __init__(self, place: Workplace):
        super().__init__(place)
        self.model = MeshModel(place.shape)

    def hits(self, x: np.ndarray) -> np.ndarray:
        return self.model.hits(self.place.joint_values(x))


@cache
def _halving(count: int) -> np.ndarray:
    """``(2^count - 1,)``: times that halve an edge so often, in the order in which they are checked."""
    return np.array([odd / 2**level for level in range(1, count + 1) for odd in range(1, 2**level, 2)])
