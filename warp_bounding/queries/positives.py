"""Random positives, half of them where bounders fail first: what statistics about false negatives are drawn from.

Half are the protocol's own random queries whose truth is *yes* (fewer where hardly any is: both proposals are then drawn equally
often, and all of their positives are taken); the other half pass a random point of the object, on faces,
edges and corners of its boundary cells for the most part, and barely: rays that begin or end there or lie in a face, boxes
that are thin, small or only touch, slabs that reach the domain's border, planes through it. What a bounder clips is among
them: rays that start outside the domain, boxes that reach out of it, planes given by a point outside, directions of any
length. Every one is checked by the exact oracle after its numbers were rounded to float32.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.queries.point import sample_points
from warp_bounding.queries.registry import oracle, sample

__all__ = ["DISTRIBUTION", "draw_positives"]

_UNIFORM = "half uniform queries that meet the object (or as many as an equal number of draws gives, where they are rare), half "
DISTRIBUTION = {
    "point": _UNIFORM + "points of its cells, mostly on faces, edges and corners of boundary cells",
    "ray": _UNIFORM
    + "rays that pass, begin or end at such points, mostly on faces, edges and corners of boundary cells, many of them from outside the domain",
    "plane": _UNIFORM
    + "planes through its points, mostly on faces, edges and corners of boundary cells, given by that point or one as far as several domains away",
    "box": _UNIFORM
    + "thin, small or touching boxes around its points, mostly on faces, edges and corners of boundary cells, some reaching outside the domain",
}
RARE = 0.05  # share of the draws that meet the object, under which one does not wait for a full half of them
CHUNK = 200_000
SNAPPED = 0.6  # share of a point's coordinates that lie on a face of its cell
NARROW = 1e-3  # of the domain: the largest distance that "barely" means
FROM_OUTSIDE = 0.5  # share of the hard rays that start outside, of those which would
SCALED = 0.2  # share of directions whose length is not 1
AWAY = 8.0  # domain widths at most, from a plane's given point to the object's
BEYOND = 0.15  # share of a box's coordinates that lie outside the domain


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
    truth, done, rare = oracle(query, grid, device, length), 0, None
    while done < count:
        uniform = sample(query, grid, CHUNK, rng)
        hard = _hard(query, grid, CHUNK, rng, length, outside).astype(np.float32)
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


def _hard(
    query: str, grid: IndicatorGrid, count: int, rng: np.random.Generator, length: float, outside: bool
) -> np.ndarray:
    p = _boundary_points(grid, count, rng)
    if query == "point":
        return p
    if query == "ray":
        return _rays(grid, p, rng, length, outside)
    return {"plane": _planes, "box": _boxes}[query](grid, p, rng, outside)


def _directions(shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Directions, most of them of length 1; some entries are 0 or nearly so: parallel to faces."""
    d = rng.normal(size=shape)
    kind = rng.random(shape)
    d = np.where(kind < 0.1, 0.0, np.where(kind < 0.2, d * NARROW, d))
    d[np.abs(d).max(axis=1) == 0, 0] = 1.0
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def _lengths(count: int, rng: np.random.Generator) -> np.ndarray:
    """``(count, 1)``, what unit directions are multiplied with: bounders take any length."""
    return np.where(rng.random((count, 1)) < SCALED, np.exp2(rng.uniform(-12, 12, (count, 1))), 1.0)


def _rays(grid: IndicatorGrid, p: np.ndarray, rng: np.random.Generator, length: float, outside: bool) -> np.ndarray:
    d = _directions(p.shape, rng)
    t = rng.random((len(p), 1)) * length
    kind = rng.random((len(p), 1))
    t = np.where(kind < 0.3, length * (1 - 2e-7), np.where(kind < 0.5, 0.0, t))
    origin = p - t * d
    stays = ((origin >= grid.lower) & (origin <= grid.upper)).all(axis=1, keepdims=True)
    if outside:
        stays |= rng.random((len(p), 1)) < FROM_OUTSIDE
    return np.concatenate([np.where(stays, origin, p), d * _lengths(len(p), rng)], axis=1)


def _planes(grid: IndicatorGrid, p: np.ndarray, rng: np.random.Generator, outside: bool) -> np.ndarray:
    d = _directions(p.shape, rng)
    away = sample_points(grid, len(p), rng) - p  # another point of the same plane
    away -= (away * d).sum(axis=1, keepdims=True) * d
    kind, far = rng.random((len(p), 1)), rng.uniform(1.0, AWAY if outside else 1.0, (len(p), 1))
    away *= np.where(kind < 0.5, 0.0, np.where(kind < 0.75, 1.0, far))
    return np.concatenate([d * _lengths(len(p), rng), p + away], axis=1)


def _boxes(grid: IndicatorGrid, p: np.ndarray, rng: np.random.Generator, outside: bool) -> np.ndarray:
    corners, slab = [], rng.random((len(p), 1)) < 0.5  # half reach the domain's border along most axes
    for end in (grid.lower, grid.upper):
        kind = rng.random(p.shape)
        share = rng.random(p.shape) * np.where(kind < 0.5, NARROW, 1.0)
        share = np.where((kind > 0.5) & slab, 1.0, share)
        share = np.where(kind < 0.3, 0.0, share)
        if outside:
            share = np.where(kind > 1 - BEYOND, np.exp2(rng.uniform(0, 10, p.shape)), share)
        corners.append(p + share * (end - p))
    return np.concatenate(corners, axis=1)
