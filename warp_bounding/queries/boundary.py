"""Points on the border of a shape, found by bisection between a point of the object and one outside.

They lie in the object, beside a point outside: where bounders fail first.
"""

from collections.abc import Callable
from weakref import WeakKeyDictionary

import numpy as np

from warp_bounding.errors import ShapeError
from warp_bounding.geometry import Hull, farthest, hull_of
from warp_bounding.queries.domain import Domain
from warp_bounding.rounding import UNIT64, gamma
from warp_bounding.shapes.shape import Shape

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
