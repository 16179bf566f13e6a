"""Search for a concrete query that a bounder should not have denied.

A proof's search works on numbers ``v`` of a set a little larger than the positives. Here its lowest points become
float32 queries as a user would ask them. The exact oracle tells which of them are positives, and the deployed kernel
computes their f. From these positives a population walks down f by random steps, with a step length for each query, and
every step is checked in the same way. A query that is found is therefore a true positive, with the f that a device
computes: if f is below a threshold, the bounder has a false negative at that threshold. To find none proves nothing.
"""

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.proof.covers import COVERS
from warp_bounding.queries import QUERIES, oracle

__all__ = ["Walk", "queries_at"]

STARTS = 1024  # queries that walk
# Lengths of steps, in units of the domain's size:
JITTERS = (0.0, 1e-7, 1e-6, 1e-6, 1e-5, 1e-5, 1e-4, 1e-4, 1e-3, 1e-3, 1e-2)  # around the points of a proof
LONGEST, SHORTEST, FRESH = 0.05, 1e-7, 3e-3  # of a walk: the limits, and about the length that it begins with
LONGER, SHORTER = 1.6, 0.75  # factors of a step's length, after a success and after a failure
ROUNDS, RENEWED = 240, 24  # steps of a walk, and after how many the lower half of the queries replaces the upper one


class Walk:
    """Looks for positives with a low f.

    Args:
        bounder: The bounder whose f is computed; its threshold plays no part.
        grid: The object.
        seed: Seed of the steps.
    """

    def __init__(self, bounder: Bounder, grid: IndicatorGrid, seed: int = 0):
        self.bounder, self.grid, self.query = bounder, grid, bounder.query_kind
        self._truth = oracle(self.query, grid, bounder.device, bounder.domain.oracle_length)
        self._rng = np.random.default_rng([seed, 77])

    def values(self, x: np.ndarray) -> np.ndarray:
        """The f of float32 queries as the device computes it; infinity for queries that do not meet the object."""
        values = self.bounder.values(x).numpy().copy()
        values[~self._truth(x)] = np.inf
        return values

    def around(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The lowest positives at and close around some queries.

        Args:
            x: ``(N, m)`` queries in object space, positives or not.

        Returns:
            ``(K, m)`` float32 and ``(K,)`` f, lowest first; none if no positive is there.
        """
        near = np.concatenate([self._moved(x, np.full(len(x), step)) for step in JITTERS])
        return self._lowest(near, self.values(near))

    def down(self, x: np.ndarray, rounds: int = ROUNDS) -> tuple[np.ndarray, np.ndarray]:
        """Walk from positives; returns what ``around`` does."""
        x, values = self._lowest(x, self.values(x))
        if not len(x):
            return x, values
        copies = -(-STARTS // len(x))
        x, values = np.tile(x, (copies, 1))[:STARTS], np.tile(values, copies)[:STARTS]
        steps = FRESH * 10.0 ** self._rng.uniform(-2, 1, len(x))
        for number in range(1, rounds + 1):
            tried = self._moved(x, steps)
            found = self.values(tried)
            better = found < values
            x[better], values[better] = tried[better], found[better]
            steps = np.clip(np.where(better, LONGER, SHORTER) * steps, SHORTEST, LONGEST)
            if number % RENEWED == 0:
                order, half = np.argsort(values, kind="stable"), len(x) // 2
                low, high = order[:half], order[len(x) - half :]
                x[high], values[high] = x[low], values[low]
                steps = FRESH * 10.0 ** self._rng.uniform(-3, 1, len(x))
        return self._lowest(x, values)

    def _lowest(self, x: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        order = np.argsort(values, kind="stable")[:STARTS]
        order = order[np.isfinite(values[order])]
        return x[order].copy(), values[order].copy()

    def _moved(self, x: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """Each query with some of its numbers moved by about its step, as a float32 query of its kind."""
        x = np.asarray(x, dtype=np.float64)
        move = self._rng.normal(size=x.shape) * steps[:, None] * (self._rng.random(x.shape) < 0.6)
        return QUERIES[self.query].nudged(self.grid, x, move).astype(np.float32)


def queries_at(bounder: Bounder, grid: IndicatorGrid, v: np.ndarray) -> np.ndarray:
    """Queries ``(N, m)`` float64 in object space at a search's points.

    Args:
        bounder: The bounder that was searched.
        grid: The object.
        v: ``(N, ndim)`` coordinates of the domain; or ``(N, n)`` normals of planes, which become the planes that touch
            the object; or ``(N, n)`` points of boxes, which become the boxes that are no more than these; or ``(N, 2n +
            1)`` numbers ``(p, t, m)`` of rays: the point ``p = a + t w``, and a direction m of any length.

    Raises:
        BounderError: If these are other numbers.
    """
    return bounder.domain.to_object(COVERS[bounder.query_kind].coordinates(bounder, grid, v))
