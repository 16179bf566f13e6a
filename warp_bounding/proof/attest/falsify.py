"""A concrete query that a bounder should not have denied: real, not only a point of a proof's parametrisation.

A proof's search works on numbers ``v`` of a set a little larger than the positives. Here its lowest points become float32
queries as a user would ask them; each is asked of the exact oracle, and its f is what the deployed kernel computes. From the
positives among them a population walks down f by random steps whose length adapts to each, and every step is checked in the
same way. What is found is therefore a true positive with the f that a device sees: below a threshold, it is a false negative
of the bounder at that threshold. What is not found proves nothing.
"""

import numpy as np

from warp_bounding.bounders.base import Bounder
from warp_bounding.errors import BounderError
from warp_bounding.geometry.hull import hull_corners
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.queries import oracle

__all__ = ["Walk", "queries_at"]

STARTS = 1024  # queries that walk
JITTERS = (0.0, 1e-7, 1e-6, 1e-6, 1e-5, 1e-5, 1e-4, 1e-4, 1e-3, 1e-3, 1e-2)  # of the domain, around a proof's points
ROUNDS, RENEWED = 240, 24  # steps, and after how many the lower half takes the place of the upper one
LONGEST, SHORTEST, FRESH = 0.05, 1e-7, 3e-3  # steps, of the domain
GROWTH, SHRINK = 1.6, 0.75  # of a step's length, after a success and after a failure
CORNERS_AT_A_TIME = 256  # normals against all corners


class Walk:
    """Looks for positives with a low f.

    Args:
        bounder: Its threshold plays no part.
        grid: The object.
        seed: Of the steps.
    """

    def __init__(self, bounder: Bounder, grid: IndicatorGrid, seed: int = 0):
        self.bounder, self.grid, self.query = bounder, grid, bounder.query_kind
        self._truth = oracle(self.query, grid, bounder.device, bounder.domain.length or 1.0)
        self._rng = np.random.default_rng([seed, 77])

    def values(self, x: np.ndarray) -> np.ndarray:
        """F of float32 queries as the device computes it; infinity for those that do not meet the object."""
        values = self.bounder.values(x).numpy().copy()
        values[~self._truth(x)] = np.inf
        return values

    def around(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The lowest positives at and close around some queries.

        Args:
            x: ``(N, m)``, object space; need not be positives.

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
            steps = np.clip(np.where(better, GROWTH, SHRINK) * steps, SHORTEST, LONGEST)
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
        """Each query moved by about its step, some numbers of it only; still a query of its kind, as float32."""
        rng, grid, n = self._rng, self.grid, self.grid.ndim
        x = np.asarray(x, dtype=np.float64)
        move = rng.normal(size=x.shape) * steps[:, None] * (rng.random(x.shape) < 0.6)
        size = grid.upper - grid.lower
        places = {"point": (True,), "ray": (True, False), "plane": (False, True), "box": (True, True)}[self.query]
        parts = []
        for start, place in zip(range(0, x.shape[1], n), places, strict=True):
            part = x[:, start : start + n]
            if place:
                part = np.clip(part + move[:, start : start + n] * size, grid.lower, grid.upper)
            else:
                length = np.linalg.norm(part, axis=1, keepdims=True)
                part = part / length + move[:, start : start + n]
                part = part / np.linalg.norm(part, axis=1, keepdims=True)
            parts.append(part)
        if self.query == "box":
            parts = [np.minimum(*parts), np.maximum(*parts)]
        return np.concatenate(parts, axis=1).astype(np.float32)


def queries_at(bounder: Bounder, grid: IndicatorGrid, v: np.ndarray) -> np.ndarray:
    """Queries ``(N, m)`` float64 in object space at a search's points.

    Args:
        bounder: The one that was searched.
        grid: The object.
        v: ``(N, ndim)`` coordinates of the domain; or ``(N, n)`` normals of planes, which become the planes that touch the object; or
            ``(N, n)`` points of boxes, which become the boxes that are no more than these; or ``(N, 2n + 1)`` numbers ``(p, t, m)`` of rays: the point ``p = a + t w``, and a direction m of any length.

    Raises:
        BounderError: If these are other numbers.
    """
    kind, n, count = bounder.query_kind, grid.ndim, v.shape[1]
    if kind == "plane" and count == n:
        v = _touching(bounder, grid, v)
    elif kind == "box" and count == n:
        v = np.concatenate([v, v], axis=1)
    elif kind == "ray" and count == 2 * n + 1:
        m = v[:, n + 1 :]
        w = m / np.linalg.norm(m, axis=1, keepdims=True) * bounder.domain.stretch.astype(np.float64)
        v = np.concatenate([v[:, :n] - v[:, n : n + 1] * w, w], axis=1)
    elif count != bounder.domain.ndim:
        raise BounderError(f"{kind} queries of {n}D objects have {bounder.domain.ndim} coordinates, got {count}")
    return bounder.domain.to_object(v)


def _touching(bounder: Bounder, grid: IndicatorGrid, normals: np.ndarray) -> np.ndarray:
    """Both planes ``(m, c)`` of each normal that touch the object's convex hull."""
    corners = bounder.domain.base.to_local(grid.position(hull_corners(grid.occupied) - 0.5))
    least, most = [], []
    for start in range(0, len(normals), CORNERS_AT_A_TIME):
        along = normals[start : start + CORNERS_AT_A_TIME] @ corners.T
        least.append(along.min(axis=1))
        most.append(along.max(axis=1))
    ends = [np.concatenate(least)[:, None], np.concatenate(most)[:, None]]
    return np.concatenate([np.concatenate([normals, end], axis=1) for end in ends])
