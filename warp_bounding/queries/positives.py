"""Random positives, half of them where bounders fail first: what statistics about false negatives are drawn from.

Half are the protocol's own random queries whose truth is *yes* (fewer where hardly any is: both proposals are then
drawn equally often, and all of their positives are taken); the other half pass a random point of the object, on faces,
edges and corners of its boundary cells for the most part, and barely: rays that begin or end there or lie in a face,
boxes that are thin, small or only touch, slabs that reach the domain's border, planes through it. What a bounder clips
is among them: rays that start outside the domain, boxes that reach out of it, planes given by a point outside,
directions of any length. Every one is checked by the exact oracle after its numbers were rounded to float32.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.queries.boundary import border_points
from warp_bounding.queries.registry import QUERIES

__all__ = ["draw_positives"]

RARE = 0.05  # of the draws: where fewer meet the object, all that do are taken, not as many of either half
POOL = 1 << 17  # border points of a shape without cells, each of which many queries may pass
CHUNK = 200_000  # draws of either half at a time
SNAPPED = 0.6  # share of a point's coordinates that lie on a face of its cell


def draw_positives(
    query: str,
    grid: IndicatorGrid,
    count: int,
    seed: int | Sequence[int],
    device=None,
    length=1.0,
    *,
    outside: bool = True,
) -> Iterator[np.ndarray]:
    """Fresh independent positives, in chunks.

    Args:
        query: Kind of query.
        grid: The object.
        count: How many in all; at least that many come.
        seed: Of the samples.
        device: Warp device of the oracle.
        length: Of a ray.
        outside: Queries that are given by points outside the domain are among them.

    Yields:
        ``(N, m)`` float32 queries, all of them positive.
    """
    rng = np.random.default_rng([*([seed] if isinstance(seed, (int, np.integer)) else seed), 20_24])
    kind = QUERIES[query]
    pool = np.empty((0, grid.ndim)) if isinstance(grid, IndicatorGrid) else border_points(grid, POOL, rng)
    truth, done, rare = kind.oracle(grid, device, length), 0, None
    while done < count:
        uniform = kind.sample(grid, CHUNK, rng)
        points = pool[rng.integers(len(pool), size=CHUNK)] if len(pool) else _boundary_points(grid, CHUNK, rng)
        hard = kind.barely(grid, points, rng, length, outside).astype(np.float32)
        uniform, hard = uniform[truth(uniform)], hard[truth(hard)]
        half = min(len(uniform), len(hard))
        if rare is None:  # decided once: the distribution is the same in all chunks
            rare = half < RARE * CHUNK
        part = np.concatenate([uniform, hard] if rare else [uniform[:half], hard[:half]])
        done += len(part)
        yield part


def _boundary_points(grid: IndicatorGrid, count: int, rng: np.random.Generator) -> np.ndarray:
    """``(count, n)`` float64 points of the object, object space."""
    cells = grid.boundary if len(grid.boundary) else grid.occupied
    cells = np.where(
        rng.random((count, 1)) < 0.9, *(c[rng.integers(len(c), size=count)] for c in (cells, grid.occupied))
    )
    offset = rng.uniform(-0.5, 0.5, cells.shape)
    offset = np.where(rng.random(cells.shape) < SNAPPED, np.copysign(0.5, offset), offset)
    return grid.position(cells + offset)
