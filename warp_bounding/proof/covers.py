"""Boxes that cover every positive query of a kind, widened by rounding, and how their numbers become queries.

A kind of query is a ``Cover``, found by its name in ``COVERS``.
"""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.errors import BounderError
from warp_bounding.geometry import Hull, hull_of
from warp_bounding.networks.bounds import BoxBounds, PlainParametrization
from warp_bounding.networks.parametrizations import BoxParametrization, RayParametrization
from warp_bounding.proof.search import ParametrizedPositives
from warp_bounding.queries.region_domain import RegionDomain
from warp_bounding.rounding import UNIT64, gamma
from warp_bounding.shapes.grid import Grid, blocks_of, summed_area
from warp_bounding.shapes.shape import Shape

# --- any kind --------------------------------------------------------------------------------------------------------


class Cover:
    """The cover of a kind of query; found under the kind's name in ``covers.COVERS``."""

    def parametrized(self, bounder: Mlp, grid: Grid) -> ParametrizedPositives | None:
        """The positives of a network as boxes of a parametrization, for a depth-first search; ``None`` if it has none.

        The bounder's domain must hold the object.

        Raises:
            BounderError: If the bounds' own arithmetic cannot be certified so far beyond the domain.
        """
        return None

    def best_first(self, bounder: Bounder, grid: Grid) -> tuple:
        """What ``minimum`` searches without a parametrization: an f with ``bound`` and ``reference``, and corners."""
        return bounder, *bounder.cut(*positive_boxes(bounder, grid))[:2]

    # The values of ``pieces`` for ``reach`` to try, fewest first; empty for kinds whose covers of shapes need no cells.
    pieces: tuple[int, ...] = ()

    def reach(
        self, cover: ParametrizedPositives, lower: np.ndarray, upper: np.ndarray, pieces: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where the regions of boxes can meet the object.

        Args:
            cover: What ``parametrized`` has made.
            lower: ``(N, Z)`` float64 corners of boxes in the cover's, numbers of the parametrization.
            upper: ``(N, Z)`` float64.
            pieces: How many boxes to return for each.

        Returns:
            Corners ``(N, pieces, n)`` float64 of boxes in local space; inverted ones hold nothing. Every exact positive
            of a box of z that no other box of the cover has meets the object in one of these.
        """
        raise NotImplementedError

    def anew(
        self, bounder: Mlp, grid: Grid, cover: ParametrizedPositives
    ) -> Iterator[tuple[np.ndarray, np.ndarray, int]]:
        """The positives for ``certify``, some at a time, in boxes that may be others than those of the search.

        Yields:
            Lower and upper corners, and how many of the object's cells are done with these.
        """
        yield cover.lower, cover.upper, len(grid.occupied)

    def at_points(self, p: np.ndarray, bounder: Bounder) -> np.ndarray:
        """``v`` of queries that pass points ``(N, n)`` of the object, in local space (for points and boxes in any)."""
        raise NotImplementedError(bounder.query_kind)

    def coordinates(self, bounder: Bounder, grid: Grid, v: np.ndarray) -> np.ndarray:
        """``v`` of points that a search has found, given in the numbers ``(N, Z)`` that it searched over.

        Raises:
            BounderError: If these are other numbers.
        """
        if (n := bounder.domain.ndim) != v.shape[1]:
            raise BounderError(
                f"{bounder.query_kind} queries of {grid.ndim}D objects have {n} coordinates, got {v.shape[1]}"
            )
        return v


def positive_boxes(bounder: Bounder, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """P_delta, the object widened by delta, as boxes of ``v``: one a cell for closed forms, else few large ones.

    Returns:
        Lower and upper corners ``(N, n)`` float64.
    """
    first, last = (grid.occupied, grid.occupied + 1) if bounder.exact_on_cells else blocks_of(grid.occupancy)
    return bounder.domain.widened(grid.position(first - 0.5), grid.position(last - 0.5))


# --- points ----------------------------------------------------------------------------------------------------------


class PointCover(Cover):
    """Points of an object: few large blocks of its cells."""

    def parametrized(self, bounder: Mlp, grid: Grid) -> ParametrizedPositives:
        boxes, limit = positive_boxes(bounder, grid), bounder.domain.limit.astype(np.float64)
        return ParametrizedPositives(bounder.network, PlainParametrization(grid.ndim), *boxes, np.zeros(1), limit)

    def at_points(self, p: np.ndarray, bounder: Bounder) -> np.ndarray:
        return p


# --- rays ------------------------------------------------------------------------------------------------------------


PRODUCTS = 16  # float64 roundings, at most, of a term in ``RayCover.reach``
CELLS = 256  # cells that ``single_cells`` takes at a time


def single_cells(bounder: Mlp, grid: Grid) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """The positives of ``RayCover.parametrized`` in boxes of one cell (t = 0) and of one exposed face each.

    They are found without ``blocks_of`` and ``_exposed``: ``certify`` must not rest on the code of the search.

    Yields:
        Lower and upper corners ``(N, 2 n + 1)`` for up to ``CELLS`` cells: of these cells, then of their faces on each
        of the 2n sides.
    """
    n, domain = grid.ndim, bounder.domain
    occupied = {tuple(cell) for cell in grid.occupied.tolist()}
    for start in range(0, len(grid.occupied), CELLS):
        cells = grid.occupied[start : start + CELLS].astype(np.float64)
        yield _boxes(domain, grid, cells - 0.5, cells + 0.5, 0.0, _directions(n))
        for axis in range(n):
            for sign in (1, -1):
                step = np.eye(n)[axis] * sign
                beyond = (cells + step).astype(int).tolist()
                bare = np.array([tuple(cell) not in occupied for cell in beyond], dtype=bool)
                middle = cells[bare] + step / 2
                half = 0.5 * (1 - np.abs(step))
                yield _boxes(domain, grid, middle - half, middle + half, 1.0, _directions(n, axis, -sign))


def _boxes(
    domain: RegionDomain,
    grid: Grid,
    first: np.ndarray,
    last: np.ndarray,
    t_most: float,
    directions: tuple[np.ndarray, np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Boxes (p, t, m): p between corners given in cells, 0 <= t <= ``t_most``, m in each of ``directions``."""
    sides = []
    for corner, t, m in ((first, 0.0, directions[0]), (last, t_most, directions[1])):
        p = np.repeat(domain.base.to_local(grid.position(corner)), len(m), axis=0)
        sides.append(np.concatenate([p, np.full((len(p), 1), t), np.tile(m, (len(corner), 1))], axis=1))
    return sides[0], sides[1]


def _exposed(occupancy: np.ndarray, axis: int, sign: int) -> np.ndarray:
    """Occupied cells whose neighbour along an axis is empty, or outside the grid."""
    occupied = occupancy.astype(np.int8)
    return np.diff(occupied, axis=axis, append=0) < 0 if sign > 0 else np.diff(occupied, axis=axis, prepend=0) > 0


def _directions(n: int, axis: int | None = None, sign: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """The faces of the cube [-1, 1]^n as boxes ``(F, n)``; given an axis, only the part that has this sign along it."""
    lower, upper = [], []
    for k in range(n):
        for side in (1.0, -1.0):
            low, high = -np.ones(n), np.ones(n)
            low[k] = high[k] = side
            if axis is not None:
                if k == axis and side != sign:
                    continue
                if k != axis:
                    (low if sign > 0 else high)[axis] = 0.0
            lower.append(low)
            upper.append(high)
    return np.array(lower), np.array(upper)


class RayCover(Cover):
    """Rays that meet an object, by where they first enter it: boxes of ``parametrizations.RayParametrization``.

    z = (p, t, m), 2n + 1 numbers: a point p of the object that the ray ``a + t w`` passes, its parameter 0 <= t <= 1
    there (w is the whole displacement, ``stretch`` times a unit vector), and the ray's direction m, scaled onto the
    surface of the cube [-1, 1]^n. In each box one entry of m is fixed, and another number: t = 0 where the ray begins
    in the object, else the entry of p across the exposed face.

    Let a ray meet the object. Either its origin lies in the object: these are the boxes with p anywhere in the object,
    t = 0 and every direction. Or it first enters at a point p, and exposed faces with inward directions cover it:

    1. Let A be an occupied cell that holds p, and D a cell that holds the ray just before p: it is empty, or outside
       the grid. On an axis on which the ray stands still choose D as A is; it holds the ray there, too.
    2. On an axis on which D and A differ p lies on the face between them, and the ray moves from D towards A.
    3. Change D into A one axis at a time. All cells on this way hold p. The first step from an empty to an occupied
       cell crosses a face that holds p, is exposed, and is crossed inwards by the ray.
    """

    def parametrized(self, bounder: Mlp, grid: Grid) -> ParametrizedPositives:
        n, domain = grid.ndim, bounder.domain
        local = domain.base.to_local
        first, last = blocks_of(grid.occupancy)
        boxes = [_boxes(domain, grid, first - 0.5, last - 0.5, 0.0, _directions(n))]
        for axis in range(n):
            for sign in (1, -1):
                first, last = blocks_of(_exposed(grid.occupancy, axis, sign), flat=axis)
                # From cells to corners: cell i is [i - 1/2, i + 1/2], and ``last`` is one past the last cell.
                first, last = first - 0.5, last - 0.5
                # Each block is one cell thick on the axis; only its exposed face stays, the upper one for sign > 0.
                (first if sign > 0 else last)[:, axis] = (last if sign > 0 else first)[:, axis]
                boxes.append(_boxes(domain, grid, first, last, 1.0, _directions(n, axis, -sign)))
        lower, upper = (np.concatenate(side) for side in zip(*boxes, strict=True))
        stretch, base = domain.stretch.astype(np.float64), domain.base
        limit = base.limit.astype(np.float64)
        # What the parametrization rounds in ``a = p - t w``: an entry goes through some 2 n + 12 roundings, of which
        # the length of m takes most.
        slop = gamma(128, UNIT64) * (limit + 2 * stretch)
        # in the order in which ``RayParametrization`` reads them
        numbers = [stretch, limit, local(grid.lower), local(grid.upper), *np.split(domain.delta, 2), slop]
        # The centres of a box are ``p - t w`` and w. An input's absolute terms are most where the box is a whole face
        # of the cube, |m| >= 1 and half widths of 1: w its length 1, n - 1 linear parts, a rest of 0.71 (n - 1)^1.5, n
        # - 1 squares of at most 2 each, (n - 1)(n - 2) / 2 products of at most 3.5 each, and n - 1 with t, all times
        # ``stretch``; together under 2 n^2. In a they come with t <= 1, and with p.
        size, terms = limit + 2 * stretch, 2 * n * n * stretch
        size, terms = np.concatenate([size, stretch * (1 + 1e-3)]), np.concatenate([size + terms, limit + terms])
        return ParametrizedPositives(
            bounder.network, RayParametrization(2 * n), lower, upper, np.concatenate(numbers), size, terms=terms
        )

    pieces = (1, 6, 24)

    def reach(
        self, cover: ParametrizedPositives, lower: np.ndarray, upper: np.ndarray, pieces: int
    ) -> tuple[np.ndarray, np.ndarray]:
        # Before p the ray is outside of all cells, or p is its origin: what counts is p + r w with 0 <= r <= 1 - t.
        n = cover.parametrization.inputs // 2
        low, high = (side[:, None, n:] for side in cover.parametrization.hull(lower, upper, cover.numbers))
        left = 1.0 - lower[:, n]
        first, last = (left[:, None, None] * ((np.arange(pieces) + end) / pieces)[:, None] for end in (0, 1))
        ways = np.stack([first * low, first * high, last * low, last * high])
        begin, end = lower[:, None, :n], upper[:, None, :n]
        room = PRODUCTS * UNIT64 * (np.maximum(np.abs(begin), np.abs(end)) + np.abs(ways).max(axis=0))
        return begin + ways.min(axis=0) - room, end + ways.max(axis=0) + room

    def anew(
        self, bounder: Mlp, grid: Grid, cover: ParametrizedPositives
    ) -> Iterator[tuple[np.ndarray, np.ndarray, int]]:
        sets = 1 + 2 * grid.ndim  # the cells of a part, and their faces on each side
        for index, (lower, upper) in enumerate(single_cells(bounder, grid)):
            yield lower, upper, min((index + 1) * CELLS // sets, len(grid.occupied))

    def at_points(self, p: np.ndarray, bounder: Bounder) -> np.ndarray:
        # the ray that begins at p, along the axes in turn
        n = p.shape[1]
        return np.concatenate([p, np.eye(n)[np.arange(len(p)) % n] * bounder.domain.stretch.astype(np.float64)], axis=1)

    def coordinates(self, bounder: Bounder, grid: Grid, v: np.ndarray) -> np.ndarray:
        # (p, t, m) of the parametrization is the ray with p = a + t w, and a direction m of any length
        n = grid.ndim
        if v.shape[1] != 2 * n + 1:
            return super().coordinates(bounder, grid, v)
        m = v[:, n + 1 :]
        w = m / np.linalg.norm(m, axis=1, keepdims=True) * bounder.domain.stretch.astype(np.float64)
        return np.concatenate([v[:, :n] - v[:, n : n + 1] * w, w], axis=1)


# --- boxes -----------------------------------------------------------------------------------------------------------


MOST_CELLS = 2.0**30  # cells from the grid's origin to the domain's ends: the parametrization counts them in 32 bits


class BoxCover(Cover):
    """Boxes that meet an object, as all pairs of corners: boxes of ``parametrizations.BoxParametrization``.

    A summed-area table says which of them meet the object. Devices cut boxes at ``|v| = limit``, which may lie outside
    the grid on one side (the domain's centre is a float32 number), or on all (the bounder was made for a larger grid).
    So corners run over all that is within the limit, in cells of this grid.
    """

    def parametrized(self, bounder: Mlp, grid: Grid) -> ParametrizedPositives:
        n, base = grid.ndim, bounder.domain.base
        origin = base.to_local(grid.position(np.zeros(n)))
        unit = base.to_local(grid.position(np.ones(n))) - origin
        limit = base.limit.astype(np.float64) + 2 * base.delta
        noise = base.delta * (1 + 1e-9) + gamma(64, UNIT64) * (limit + np.abs(origin) + unit * np.array(grid.shape))
        table = summed_area(grid.occupancy)
        strides = [int(np.prod(table.shape[k + 1 :])) for k in range(n)]
        words = np.concatenate([grid.shape, strides, table.reshape(-1)]).astype(np.int32)
        edge = base.limit.astype(np.float64)
        lower, upper = (np.tile((side - origin) / unit, 2)[None] for side in (-edge, edge))
        most = float(max(np.abs(lower).max(), np.abs(upper).max()))
        if not most < MOST_CELLS:
            wide = f"the domain is {most:.3g} cells of the shape wide, more than the proof counts"
            raise BounderError(f"{bounder.method}: {wide}")
        numbers, largest = np.concatenate([unit, origin, noise]), np.tile(limit + noise, 2)
        return ParametrizedPositives(bounder.network, BoxParametrization(2 * n), lower, upper, numbers, largest, words)

    pieces = (1,)

    def reach(
        self, cover: ParametrizedPositives, lower: np.ndarray, upper: np.ndarray, pieces: int
    ) -> tuple[np.ndarray, np.ndarray]:
        # the largest box
        n = cover.parametrization.inputs // 2
        low, high = cover.parametrization.hull(lower, upper, cover.numbers)
        return low[:, None, :n], high[:, None, n:]

    def at_points(self, p: np.ndarray, bounder: Bounder) -> np.ndarray:
        return np.concatenate([p, p], axis=1)


# --- planes ----------------------------------------------------------------------------------------------------------


AT_A_TIME = 2048  # boxes that are compared with all corners at a time
FIRST = 4  # boxes along each axis of a cube's face at the start


class SupportGap:
    """How far a network's support function stays above the object's, as a function of the normal m, for ``minimum``.

    A plane ``m . y = c`` that meets the object has ``-h(-m) <= c <= h(m)``, h the support function of the object's
    convex hull (that is necessary; for a connected object it is sufficient too, *Theorem of the separating
    hyperplane*). With ``f = min(H(m) - c, G(m) + c)`` the least f over all such c is ``min(H(m) - h(m), G(m) -
    h(-m))``, a function of m alone, and m runs over the faces of a cube, where one entry is 1: boxes of n - 1
    dimensions. On a box the network has a linear lower bound ``C + g . (m - m0)``, so that for every corner y of the
    object ``H - m . y >= C - m0 . y - sum |g - y|_k r_k``.

    A mesh has no cells: it lies in the hull of its vertices, dilated by its margin, which adds ``|D m|`` to h, D the
    half axes of the margin's ball. With gradient ``e = D D m0 / |D m0|`` and r the box's half widths, ``|D m| <= |D m0|
    + e . (m - m0) + |D r|^2 / (2 l)`` where ``|D m| >= l`` on the box, because its second derivative along d is at most
    ``|D d|^2 / l``.

    Args:
        bounder: An ``mlp`` of plane queries.
        grid: The object.
    """

    def __init__(self, bounder: Mlp, grid: Shape):
        self.networks, self.ndim = bounder.networks, grid.ndim
        base, hull = bounder.domain.base, known_hull(bounder, grid)
        corners = base.to_local(hull.points)
        self.ball = hull.radius * base.scale.astype(np.float64)
        # How far the computed plane may pass a point of the object, in c, and what float64 rounds in ``reference``.
        self.room = float(bounder.domain.delta[-1]) * (1 + 1e-9) + 1e-12 * (1 + np.abs(corners).max())
        self.corners = [corners, -corners]

    def boxes(self) -> tuple[np.ndarray, np.ndarray]:
        """Boxes that cover the faces ``m_k = 1`` of the cube: lower and upper corners ``(N, n)`` float64."""
        n, edges = self.ndim, np.linspace(-1.0, 1.0, FIRST + 1)
        cells = np.stack(np.meshgrid(*[np.arange(FIRST)] * (n - 1), indexing="ij"), -1).reshape(-1, n - 1)
        intervals = np.array(list(pairwise(edges)))[cells]  # (N, n - 1, 2)
        sides = [[np.insert(intervals[..., side], k, 1.0, axis=1) for k in range(n)] for side in (0, 1)]
        return np.concatenate(sides[0]), np.concatenate(sides[1])

    def reference(self, m: np.ndarray) -> np.ndarray:
        """The gap at normals ``(N, n)``, ``(N,)`` float64."""
        m = np.asarray(m, dtype=np.float64)
        gap = np.empty(len(m))
        for start in range(0, len(m), AT_A_TIME):
            part = m[start : start + AT_A_TIME]
            gaps = [f(part) - (part @ y.T).max(axis=1) for f, y in zip(self.networks, self.corners, strict=True)]
            gap[start : start + AT_A_TIME] = np.minimum(*gaps) - np.linalg.norm(part * self.ball, axis=1)
        return gap - self.room

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """Certified lower bounds over boxes of m; see ``Bounder.bound``."""
        center, radius = (lower + upper) / 2, (upper - lower) / 2
        least, point = np.full(len(lower), np.inf), center.copy()
        dilated, tilt = self._dilation(lower, upper, center, radius)
        for network, corners in zip(self.networks, self.corners, strict=True):
            bounds = network.bound(lower, upper)
            slope, value = bounds.slope - tilt, bounds.level - dilated
            size = 4 + np.abs(value).max(initial=0.0) + np.abs(slope).sum(axis=1).max(initial=0.0)
            rounding = gamma(64, UNIT64) * (size + np.abs(corners).sum(axis=1).max())
            for start in range(0, len(lower), AT_A_TIME):
                part = slice(start, start + AT_A_TIME)
                loss = center[part] @ corners.T
                for k in range(self.ndim):  # one axis at a time: (boxes, corners) in the cache
                    away = np.abs(slope[part, k, None] - corners[:, k])
                    away *= radius[part, k, None]
                    loss += away
                worst = loss.argmax(axis=1)
                bound = value[part] - loss[np.arange(len(loss)), worst] - self.room - rounding
                bound[np.isnan(bound)] = -np.inf
                lower_yet = bound < least[part]
                towards = center[part] - np.sign(slope[part] - corners[worst]) * radius[part]
                point[part] = np.where(lower_yet[:, None], towards, point[part])
                least[part] = np.where(lower_yet, bound, least[part])
        return BoxBounds(least, np.argmax(radius, axis=1), point, self.reference(point))

    def _dilation(self, lower, upper, center, radius) -> tuple[np.ndarray, np.ndarray]:
        """``(N,)`` and ``(N, n)``: ``|D m|`` is at most the first and the second times ``m - m0`` on each box."""
        if not self.ball.any():
            return np.zeros(len(lower)), np.zeros(lower.shape)
        away = np.maximum(np.maximum(lower, -upper), 0.0)  # least |m| on each axis; one of them is 1
        least = (away * self.ball).max(axis=1)
        length = np.linalg.norm(center * self.ball, axis=1)
        bent = (radius * self.ball) ** 2
        tilt = center * self.ball**2 / length[:, None]
        return (length + bent.sum(axis=1) / (2 * least)) * (1 + 1e-12), tilt


def known_hull(bounder: Bounder, shape: Shape) -> Hull:
    """The hull of the object.

    Raises:
        BounderError: If none is known.
    """
    hull = hull_of(shape)
    if hull is None:
        raise BounderError(f"{bounder.method}: {shape.name} has no known convex hull; give a resolution")
    return hull


class PlaneCover(Cover):
    """The cover of planes, for networks: over normals, without a parametrization."""

    def best_first(self, bounder: Mlp, grid: Shape) -> tuple:
        gap = SupportGap(bounder, grid)
        return gap, *gap.boxes()

    def coordinates(self, bounder: Bounder, grid: Shape, v: np.ndarray) -> np.ndarray:
        # a normal becomes the two planes that touch the object's hull
        if v.shape[1] != grid.ndim:
            return super().coordinates(bounder, grid, v)
        base, hull = bounder.domain.base, known_hull(bounder, grid)
        corners = base.to_local(hull.points)
        ends = [v[i : i + AT_A_TIME] @ corners.T for i in range(0, len(v), AT_A_TIME)]
        most, least = (np.concatenate([getattr(end, side)(axis=1) for end in ends]) for side in ("max", "min"))
        dilated = np.linalg.norm(v * (hull.radius * base.scale.astype(np.float64)), axis=1)
        most, least = most + dilated, least - dilated
        return np.concatenate([np.column_stack([v, most]), np.column_stack([v, least])])


# A new kind of query is one more entry.
COVERS: dict[str, Cover] = {"point": PointCover(), "ray": RayCover(), "plane": PlaneCover(), "box": BoxCover()}
