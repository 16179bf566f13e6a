"""Positives that bounders miss first: queries that only just meet the object, but certainly.

``HardPositives`` is what stress tests ask, ``draw_positives`` what statistics about false negatives are drawn from.
Both pass a point of the object's border, mostly on a face, an edge or a corner of a cell, and barely: rays that begin
or end there or lie in a face, boxes that are thin, degenerate or reach outside, planes that are tangent or given by a
point far away. Rounding to float32 may move such a query off the object, so each is checked by the exact truth after
its numbers were rounded.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from warp_bounding.errors import QueryError
from warp_bounding.queries.boundary import border_points
from warp_bounding.queries.registry import QUERIES
from warp_bounding.rounding import UNIT32
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.shape import IN, Shape

FORMS = ("float32", "float64", "placed")
POOL = 1 << 17  # border points of a shape without cells
MOVES = (2.0**-26, 2.0**-8)  # of the shape's longest side: the least and the largest move off such a point
STILL = 0.25  # share of queries that are the border points themselves
RATIONAL = 256  # float64 queries of a grid that are drawn at a time: their truth takes rational arithmetic


class World(NamedTuple):
    """Where a shape stands, float64: ``world = forward @ object + translation``, and the inverse of ``forward``."""

    forward: np.ndarray
    inverse: np.ndarray
    translation: np.ndarray


class HardPositives:
    """Hard positives of one object, in chunks that depend on the seed and their number alone.

    Raises ``QueryError`` if the shape cannot tell which regions of this kind meet it.
    """

    def __init__(self, query: str, shape: Shape, length: float = 1.0, device=None):
        self.kind, self.shape, self.length = QUERIES[query], shape, float(length)
        self._grid, self._seed, self._pool = isinstance(shape, Grid), None, None
        if self._grid:
            self._truth, self._hulls = self.kind.oracle(shape, device, length), self.kind.hulls(shape)
        elif not self.kind.decides(shape):
            raise QueryError(f"{shape.name}: cannot tell which {query} queries meet it; give a resolution")
        else:
            self._truth, self._hulls = (lambda q: self.kind.decide(shape, q, self.length) == IN), []

    def draw(self, seed: int, chunk: int, count: int, form: str = "float32", world: World | None = None) -> np.ndarray:
        """Certain positives ``(N, m)``, N at most ``count``.

        The form is ``"float32"``; ``"float64"``: their numbers are not float32; ``"placed"``: where the shape stands in
        the ``world``, float32. Regions are placed by a signed permutation and one power of two, which rounds nothing.
        """
        rng, kind = np.random.default_rng([seed, chunk]), self.kind
        if form == "float64":
            count = min(count, RATIONAL) if self._grid else count
            q = self._drawn(seed, count, rng)
            if not self._grid:
                return q[self._truth(q)]
            truth = [kind.truth(self.shape, x[None], self.length, kind.near(self.shape, x)) for x in q]
            return q[np.concatenate(truth)]
        if form == "placed" and not kind.is_region:
            x = self._points(seed, count, rng) @ world.forward.T + world.translation
            q = x.astype(np.float32)
            back = (q.astype(np.float64) - world.translation) @ world.inverse.T
            terms = (np.abs(q) + np.abs(world.translation)) @ np.abs(world.inverse).T
            room = UNIT32 * 2.0**-20 * terms  # of the way back in float64: generous
            return q[self.shape.inside(back - room, back + room)]
        q = self._drawn(seed, count, rng).astype(np.float32)
        q = q[self._truth(q)]
        if form == "placed":
            maps = [world.forward.T] * 2
            maps[0] = world.inverse if kind.directed[0] else maps[0]  # normals stand across: with time it counts
            halves = [half @ m.astype(np.float32) for half, m in zip(np.split(q, 2, axis=1), maps, strict=True)]
            halves = halves if any(kind.directed) else [np.minimum(*halves), np.maximum(*halves)]
            q = np.hstack(halves)
        return q

    def _points(self, seed: int, count: int, rng: np.random.Generator) -> np.ndarray:
        """``(count, n)`` float64 points at the object's border, object space."""
        if self._grid:
            return _boundary_points(self.shape, count, rng)
        if seed != self._seed:
            self._seed, self._pool = seed, border_points(self.shape, POOL, np.random.default_rng([seed, 5]))
        x = self._pool[rng.integers(POOL, size=count)]
        size = np.exp2(rng.uniform(*np.log2(MOVES), count)) * float(self.shape.extent.max())
        return x + (rng.random(count) >= STILL)[:, None] * size[:, None] * rng.uniform(-1, 1, x.shape)

    def _drawn(self, seed: int, count: int, rng: np.random.Generator) -> np.ndarray:
        """``(count, m)`` float64, positives for the most part."""
        return self.kind.hardest(self.shape, self._points(seed, count, rng), rng, self.length, self._hulls)


# --- statistics ------------------------------------------------------------------------------------------------------
#
# Half are the protocol's own random queries whose truth is *yes* (fewer where hardly any is: both proposals are then
# drawn equally often, and all of their positives are taken), the other half are hard.

RARE = 0.05  # of the draws: where fewer meet the object, all that do are taken, not as many of either half
DRAWS_AT_ONCE = 200_000  # draws of either half at a time
SNAPPED = 0.6  # share of a point's coordinates that lie on a face of its cell


def draw_positives(
    query: str, grid: Grid, count: int, seed: int | Sequence[int], device=None, length=1.0, *, outside: bool = True
) -> Iterator[np.ndarray]:
    """Fresh independent positives ``(N, m)`` float32, in chunks, at least ``count`` of them.

    With ``outside``, queries that are given by points outside the domain are among them.
    """
    rng = np.random.default_rng([*([seed] if isinstance(seed, (int, np.integer)) else seed), 20_24])
    kind = QUERIES[query]
    pool = np.empty((0, grid.ndim)) if isinstance(grid, Grid) else border_points(grid, POOL, rng)
    truth, done, rare = kind.oracle(grid, device, length), 0, None
    while done < count:
        uniform = kind.sample(grid, DRAWS_AT_ONCE, rng)
        if len(pool):
            points = pool[rng.integers(len(pool), size=DRAWS_AT_ONCE)]
        else:
            points = _boundary_points(grid, DRAWS_AT_ONCE, rng)
        hard = kind.barely(grid, points, rng, length, outside).astype(np.float32)
        uniform, hard = uniform[truth(uniform)], hard[truth(hard)]
        half = min(len(uniform), len(hard))
        if rare is None:  # decided once: the distribution is the same in all chunks
            rare = half < RARE * DRAWS_AT_ONCE
        part = np.concatenate([uniform, hard] if rare else [uniform[:half], hard[:half]])
        done += len(part)
        yield part


def _boundary_points(grid: Grid, count: int, rng: np.random.Generator) -> np.ndarray:
    """``(count, n)`` float64 points of the object, object space."""
    cells = grid.boundary if len(grid.boundary) else grid.occupied
    cells = np.where(
        rng.random((count, 1)) < 0.9, *(c[rng.integers(len(c), size=count)] for c in (cells, grid.occupied))
    )
    offset = rng.uniform(-0.5, 0.5, cells.shape)
    offset = np.where(rng.random(cells.shape) < SNAPPED, np.copysign(0.5, offset), offset)
    return grid.position(cells + offset)
