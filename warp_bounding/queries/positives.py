"""Random positives, half of them where bounders fail first: what statistics about false negatives are drawn from.

Half are the protocol's own random queries whose truth is *yes* (fewer where hardly any is: both proposals are then drawn equally
often, and all of their positives are taken); the other half pass a random point of the object, on faces,
edges and corners of its boundary cells for the most part, and barely: rays that begin or end there or lie in a face, boxes
that are thin, small or only touch, slabs that reach the domain's border, planes through it. Every one is checked by the exact oracle after its numbers were
rounded to float32.
"""

from collections.abc import Iterator

import numpy as np

from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.queries.point import sample_points

__all__ = ["DISTRIBUTION", "draw_positives"]

DISTRIBUTION = (
    "half uniform queries that meet the object (or as many as an equal number of draws gives, where they are rare), half through "
    "points on its boundary cells, mostly grazing"
)
RARE = 0.05  # share of the draws that meet the object, under which one does not wait for a full half of them
CHUNK = 200_000
SNAPPED = 0.6  # share of a point's coordinates that lie on a face of its cell
NARROW = 1e-3  # of the domain: the largest distance that "barely" means


def draw_positives(
    query: str, grid: IndicatorGrid, count: int, seed: int, device=None, length=1.0
) -> Iterator[np.ndarray]:
    """Fresh independent positives, in chunks.

    Args:
        query: Kind of query.
        grid: The object.
        count: How many in all; at least that many come.
        seed: Of the samples.
        device: Warp device of the oracle.
        length: Of a ray.

    Yields:
        ``(N, m)`` float32 queries, all of them positive.
    """
    from warp_bounding.queries import oracle, sample

    rng, truth, done, rare = np.random.default_rng([seed, 20_24]), oracle(query, grid, device, length), 0, None
    while done < count:
        uniform = sample(query, grid, CHUNK, rng)
        hard = _hard(query, grid, CHUNK, rng, length).astype(np.float32)
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


def _hard(query: str, grid: IndicatorGrid, count: int, rng: np.random.Generator, length: float) -> np.ndarray:
    p = _boundary_points(grid, count, rng)
    return {"point": lambda: p, "ray": _rays, "plane": _planes, "box": _boxes}[query](
        *(() if query == "point" else (grid, p, rng)), *((length,) if query == "ray" else ())
    )


def _directions(shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Unit vectors; some entries are 0 or nearly so: parallel to faces."""
    d = rng.normal(size=shape)
    kind = rng.random(shape)
    d = np.where(kind < 0.1, 0.0, np.where(kind < 0.2, d * NARROW, d))
    d[np.abs(d).max(axis=1) == 0, 0] = 1.0
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def _rays(grid: IndicatorGrid, p: np.ndarray, rng: np.random.Generator, length: float) -> np.ndarray:
    d = _directions(p.shape, rng)
    t = rng.random((len(p), 1)) * length
    kind = rng.random((len(p), 1))
    t = np.where(kind < 0.3, length * (1 - 2e-7), np.where(kind < 0.5, 0.0, t))
    origin = p - t * d
    inside = ((origin >= grid.lower) & (origin <= grid.upper)).all(axis=1, keepdims=True)
    return np.concatenate([np.where(inside, origin, p), d], axis=1)


def _planes(grid: IndicatorGrid, p: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    d = _directions(p.shape, rng)
    away = sample_points(grid, len(p), rng) - p  # another point of the same plane
    away -= (away * d).sum(axis=1, keepdims=True) * d
    return np.concatenate([d, p + np.where(rng.random((len(p), 1)) < 0.5, away, 0.0)], axis=1)


def _boxes(grid: IndicatorGrid, p: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    corners, slab = [], rng.random((len(p), 1)) < 0.5  # half reach the domain's border along most axes
    for end in (grid.lower, grid.upper):
        kind = rng.random(p.shape)
        share = rng.random(p.shape) * np.where(kind < 0.5, NARROW, 1.0)
        share = np.where((kind > 0.5) & slab, 1.0, share)
        corners.append(p + np.where(kind < 0.3, 0.0, share) * (end - p))
    return np.concatenate(corners, axis=1)
