"""Points on the border of a shape, found by bisection between a point of the object and one outside; hard positives.

They lie in the object, beside a point outside: where bounders fail first.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from warp_bounding.errors import QueryError, ShapeError
from warp_bounding.geometry import Hull, farthest, hull_of
from warp_bounding.queries import QUERIES
from warp_bounding.queries.domain import Domain
from warp_bounding.rounding import UNIT32, UNIT64, gamma
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.shape import IN, Shape

NEAREST = 2.0**-16  # of the shape's longest side
DRAWN, MOST_DRAWN = 65_536, 1 << 24  # random points at a time, and until no more of the object are looked for
RARE = 1 / 64  # share of random points: where fewer are in the object, those that the shape names join them
HELD = 16_384  # points of the object towards which points outside are drawn
FEWEST = 1024  # points around the shape that are drawn at least
NEAR_SHARE = 0.75  # of the pairs: one end is the nearest known point of the object, of FEW
FEW = 16_384
OUTLINE = 16_384  # points of the border that stand for a shape where a volume is fitted to it
# Of pairs: these are put on an end of the object's box along an axis at which the object is cut off, as a motion is at
# the ends of its time.
ENDS_SHARE, TRIED = 0.1, 4.0  # and how many times as many pairs are tried
ASKED, CUT = 512, 1 / 16  # points that are asked whether it is, and the share of them that must be in the object there
STEPS = 48  # bisections at most; no pair is further apart than 2^28 NEAREST


def random_points(shape: Shape, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Uniform points ``(count, n)`` float64, float32 numbers, of the box that holds the object; which are in it."""
    u = rng.random((count, shape.ndim))
    points = (shape.lower + u * (shape.upper - shape.lower)).astype(np.float32).astype(np.float64)
    return points, shape.contains(points)


def held_points(shape: Shape, count: int, rng: np.random.Generator, known: np.ndarray | None = None) -> np.ndarray:
    """About ``count`` points of the object: known ones, random ones of its box, or those that the shape names.

    Raises ``ShapeError`` where none was found.
    """
    found, drawn = [] if known is None else [known], 0
    while sum(map(len, found)) < count and drawn < MOST_DRAWN:
        points, truth = random_points(shape, DRAWN, rng)
        found.append(points[truth])
        drawn += DRAWN
        if len(found[-1]) < RARE * DRAWN and len(named := shape.points(count, rng)):
            found.append(named)
            break
    held = np.concatenate(found) if found else np.empty((0, shape.ndim))
    if not len(held):
        raise ShapeError(f"{shape.name}: there is nothing to bound, it holds none of {drawn:,} points of its box")
    return held


def pulled(
    holds: Callable[[np.ndarray], np.ndarray], inner: np.ndarray, outer: np.ndarray, nearest: float
) -> tuple[np.ndarray, np.ndarray]:
    """Both ends ``(N, n)`` of segments from points that it ``holds`` to others, within ``nearest`` of each other."""
    inner, outer = inner.copy(), outer.copy()
    for _ in range(STEPS):
        open_ = np.flatnonzero(np.abs(outer - inner).max(axis=1, initial=0.0) > nearest)
        if not len(open_):
            break
        middle = (inner[open_] + outer[open_]) / 2
        held = holds(middle)
        inner[open_[held]], outer[open_[~held]] = middle[held], middle[~held]
    return inner, outer


def border_points(
    shape: Shape, count: int, rng: np.random.Generator, known: np.ndarray | None = None, nearest: float = NEAREST
) -> np.ndarray:
    """``(count, n)`` float64 points of the object, each within ``nearest`` longest sides of one that is not.

    ``known`` are points of the object to begin with.
    """
    from scipy.spatial import KDTree

    held = known if known is not None and len(known) else held_points(shape, HELD, rng)
    outer = shape.sample_lower + rng.random((2 * count + FEWEST, shape.ndim)) * (
        shape.sample_upper - shape.sample_lower
    )
    outer = outer[~shape.contains(outer)]
    outer = outer[rng.integers(len(outer), size=count)]
    size = np.where(shape.upper > shape.lower, shape.upper - shape.lower, 1.0)
    # Near pairs need few steps and find thin parts; far pairs find all sides.
    inner = held[rng.integers(len(held), size=count)]
    near, few = rng.random(count) < NEAR_SHARE, held[rng.integers(len(held), size=min(len(held), FEW))]
    inner[near] = few[KDTree(few / size).query(outer[near] / size, workers=-1)[1]]
    _to_ends(shape, inner, outer, rng)
    return pulled(shape.contains, inner, outer, nearest * float(shape.extent.max()))[0]


def _to_ends(shape: Shape, inner: np.ndarray, outer: np.ndarray, rng: np.random.Generator) -> None:
    """Move ``ENDS_SHARE`` of pairs, in place, to where the object is cut off.

    A network may be low there, where random points never are.
    """
    ends = [(axis, end[axis]) for axis in range(shape.ndim) for end in (shape.lower, shape.upper)]
    few = inner[:ASKED]
    ends = [(axis, at) for axis, at in ends if shape.contains(_at_end(few, axis, at)).mean() > CUT]
    if not ends:
        return
    chosen = np.flatnonzero(rng.random(len(inner)) < TRIED * ENDS_SHARE)
    for part, (axis, at) in zip(np.array_split(chosen, len(ends)), ends, strict=True):
        within, without = (_at_end(x[part], axis, at) for x in (inner, outer))
        good = np.flatnonzero(shape.contains(within) & ~shape.contains(without))[
            : int(ENDS_SHARE * len(inner) / len(ends))
        ]
        inner[part[good]], outer[part[good]] = within[good], without[good]


def _at_end(x: np.ndarray, axis: int, at: float) -> np.ndarray:
    moved = x.copy()
    moved[:, axis] = at
    return moved


_OUTLINES: WeakKeyDictionary[Shape, np.ndarray] = WeakKeyDictionary()


def outline(shape: Shape) -> np.ndarray:
    """``(P, n)`` float64 points that stand for a shape where a volume is fitted to it: its landmarks and border points.

    They are no bound: the volume's threshold is proven afterwards.
    """
    if shape not in _OUTLINES:
        _OUTLINES[shape] = np.concatenate([shape.landmarks(), border_points(shape, OUTLINE, np.random.default_rng(0))])
    return _OUTLINES[shape]


# How far an object reaches in a direction, certified from above: its support, widened by what rounds on the way to v.

MOST_NUMBERS = 1 << 22  # float64 numbers in an intermediate array: 32 MiB


class ObjectSupport:
    """The support of an object widened by ``delta``, from above; of a shape without a known hull that of its outline.

    Args:
        grid: The object.
        base: Its domain of points.
        hull: A convex set that holds it; ``hull_of(grid)`` if ``None``, which is found once and has few points.

    Attributes:
        points: ``(C, n)`` float64, local space: every vertex of the object's hull, and some more.
        ball: ``(n,)``, local units: half axes of the ellipsoid by which the points' hull is dilated.
        delta: ``(n,)``, the object is widened by this on every axis.
        certified: Whether the hull is known, so that all that is said of the support holds.
    """

    def __init__(self, grid: Shape, base: Domain, hull: Hull | None = None):
        hull = hull or hull_of(grid)
        self.certified = hull is not None
        hull = hull or Hull(outline(grid), 0.0)
        lower, upper = base.widened(hull.points, hull.points)
        self.points, self.delta = (lower + upper) / 2, base.delta * (1 + 1e-6) + 1e-14
        self.ball = hull.radius * base.scale.astype(np.float64) * (np.arange(base.ndim) >= int(grid.time))

    def __call__(self, m: np.ndarray) -> np.ndarray:
        """``h(m)`` of vectors ``(..., n)``, in local space; the rounding of this evaluation is included."""
        flat = m.reshape(-1, m.shape[-1])
        best = np.empty(len(flat))
        size = max(1, MOST_NUMBERS // len(self.points))
        for start in range(0, len(flat), size):
            best[start : start + size] = (flat[start : start + size] @ self.points.T).max(axis=1)
        largest = np.abs(flat) @ (np.abs(self.points).max(axis=0) + self.ball + self.delta)
        best += np.linalg.norm(flat * self.ball, axis=1) + np.abs(flat) @ self.delta
        best += gamma(2 * flat.shape[1] + 8, UNIT64) * largest
        return best.reshape(m.shape[:-1])

    def square(self, matrix: np.ndarray, offset: np.ndarray) -> float:
        """Upper bound of ``|A p + b|^2`` over the widened object, A ``(r, n)`` and b ``(r,)``, rounding included."""
        most = farthest(self.points @ matrix.T + offset, matrix * self.ball)
        most += np.linalg.norm(np.abs(matrix) @ self.delta)
        reach = np.abs(matrix) @ (np.abs(self.points).max(axis=0) + self.ball + self.delta) + np.abs(offset)
        return float((most + gamma(8 * len(self.delta) + 64, UNIT64) * reach.sum()) ** 2 * (1 + 1e-12))


# --- positives that bounders miss first -------------------------------------------------------------------------------
#
# Queries that only just meet the object, but certainly. ``HardPositives`` is what stress tests ask, ``draw_positives``
# what statistics about false negatives are drawn from. Both pass a point of the object's border, mostly on a face, an
# edge or a corner of a cell, and barely: rays that begin or end there or lie in a face, boxes that are thin, degenerate
# or reach outside, planes that are tangent or given by a point far away. Rounding to float32 may move such a query off
# the object, so each is checked by the exact truth after its numbers were rounded.

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
