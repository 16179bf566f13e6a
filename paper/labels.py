"""The paper's labels: a region counts as a hit if one of some hundred random points of it lies in the object.

500 points of a region, 1500 in four dimensions: of a ray uniform in [0, length], of a box uniform inside, of a plane
all coordinates but the first uniform in [-3, 3] (in the frame where the grid's outer cell centres are 0 and 1), the
first solved for; a plane whose normal has no first component yields no points. A region that the exact truth calls
empty is not sampled. That is fast, and it excludes phantom hits: a point may be rounded off its region into a cell.
"""

from typing import Any

import numpy as np

from warp_bounding.queries import QUERIES, oracle

PLANE_SPAN = 3.0  # free coordinates of a plane's points are uniform in [-3, 3]


class SampledOracle:
    """The paper's labels ``(N,)`` bool of queries ``(N, m)``, a subset of the exact ones; of points these very ones."""

    def __init__(self, query: str, grid: Any, device: str | None = None, seed: int = 0, length: float = 1.0):
        self.query, self.grid, self.seed, self.length = query, grid, seed, length
        self.count, self._exact = 500 if grid.ndim < 4 else 1500, oracle(query, grid, device, length)

    def __call__(self, q: np.ndarray) -> np.ndarray:
        hit = np.array(self._exact(q), dtype=bool)
        if not QUERIES[self.query].is_region:
            return hit
        left, rng = np.flatnonzero(hit), np.random.default_rng(self.seed)
        hit[:] = False
        counts = np.full(len(left), self.count)
        if self.query == "plane":  # points whose free coordinates lie outside the domain are not drawn one by one
            frame = self.grid.sample_upper - self.grid.sample_lower
            inside = np.prod(((self.grid.upper - self.grid.lower) / frame / (2 * PLANE_SPAN))[1:])
            counts = rng.binomial(self.count, inside, len(left)) * (q[left, 0] != 0)
        for number in range(counts.max(initial=0)):
            left, counts = left[counts > number], counts[counts > number]
            found = self.grid.contains(self._points(q[left].astype(np.float64), rng))
            hit[left[found]] = True
            left, counts = left[~found], counts[~found]
        return hit

    def _points(self, q: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """A random point of each region ``(N, 2 n)``."""
        first, second = np.split(q, 2, axis=1)
        if self.query == "box":
            return first + rng.random(first.shape) * (second - first)
        if self.query == "ray":
            along = self.length * rng.random((len(q), 1)) / np.linalg.norm(second, axis=1, keepdims=True)
            return first + along * second
        y = self.grid.lower + rng.random(second.shape) * (self.grid.upper - self.grid.lower)
        y[:, 0] = second[:, 0] - (first[:, 1:] * (y - second)[:, 1:]).sum(axis=1) / first[:, 0]
        return y
