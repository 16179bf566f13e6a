"""Branch and bound: the least value of a bounder's ``f`` over boxes, certified from below.

Every box gets a certified lower bound of f (``Bounder.bound``) and a few concrete points. A box whose bound is high
enough is closed, the others are halved. The result is sound whenever the search ends: it is the least bound over all
closed *and* open boxes.

Best first (``minimum``): a box is closed if its bound is at most ``eps`` under the least value found.
Boxes wait in chunks. The chunk of the largest gap comes first, so that a search that is stopped early has raised its
bound as far as it could. When many boxes wait, the search closes those that are not expected to matter by the end; when
too many wait, the half that matters least. Their bounds count as they are. So memory stays bounded and the search goes
on where it counts, but it can no longer reach the requested gap.

*A shape without cells* (``ShapePositives``): the search begins with the whole domain. Where the bound of f is too low
in a box, the shape decides whether the box is vacant: whether no v in it can come from a point of the object, rounding
included. Vacant boxes are dropped, the others halved. So the shape is queried only where the bounder says *no*, or
nearly so, and most of the domain is never refined. A shape that knows half-spaces of its part in a box
(``Shape.half_spaces``) closes many boxes that are neither vacant nor high enough in f (``bound_in_half_spaces``). A box
that is at most ``NARROWEST`` wide on every axis counts as object.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.proof.halving import halve
from warp_bounding.queries.domain import GROWTH, Domain
from warp_bounding.rounding import UNIT64
from warp_bounding.runtime.launch import working_seconds
from warp_bounding.shapes.shape import OUT, HalfSpaces, Shape

# --- best first ------------------------------------------------------------------------------------------------------


BOX_BATCH = 32768  # boxes that are bounded at a time
MANY, TOO_MANY = 5_000_000, 15_000_000  # boxes that wait (a million takes about 0.1 GB in 4D)
AGAIN = 1.2  # waiting boxes are pruned again when there are this many times as many as after the last pruning
# The gap falls about as this power of the number of bounded boxes; pruning closes boxes whose gap is below this share
# of the largest one, scaled by that fall.
FALLS, SHARE = 0.6, 0.5
QUARTER = 1.7  # a box whose bound is too loose by more than this factor is quartered at once
NEAR = 16.0  # gaps above the least value found: positives of a shape under it are kept as samples
WORST = 2048  # low points that are kept, as samples for training


@dataclass(frozen=True)
class Search:
    """Result of a search.

    Attributes:
        lower_bound: Certified: ``f >= lower_bound`` on every box.
        upper_bound: Least value found at a concrete point.
        worst: ``(K, n)`` float64, the lowest concrete points, lowest first, in the coordinates that f takes.
        boxes: Boxes that were bounded.
        seconds: Wall time.
        complete: Whether the two bounds agree within ``eps``, or as nearly as float64 can tell.
    """

    lower_bound: float
    upper_bound: float
    worst: np.ndarray
    boxes: int
    seconds: float
    complete: bool


def minimum(
    bounder: Bounder,
    lower: np.ndarray,
    upper: np.ndarray,
    *,
    eps: float,
    budget: float = float("inf"),
    boxes: float = float("inf"),
    points: np.ndarray | None = None,
    progress: Callable[[int, int, float], None] | None = None,
) -> Search:
    """Certified minimum of ``f`` over boxes, or over those of their points that are positives of a shape.

    Args:
        bounder: The bounder of ``f``; or ``ShapePositives``, which certify that boxes hold no positive. Of others
            every point of the boxes counts as a positive.
        lower: ``(N, n)`` float64 lower corners, coordinates ``v``.
        upper: ``(N, n)`` float64 upper corners.
        eps: Gap between bound and found value at which a box is closed; at least 0. It is not taken smaller than what
            the bounds of single points resolve, or the search would not end.
        budget: Seconds after which the search ends with what it has; the given boxes are bounded once in any case.
        boxes: Number of boxes after which it ends with what it has, the same on every machine.
        points: ``(P, n)`` concrete points in the boxes to begin with; good ones save most of the work.
        progress: Called now and then with boxes done, boxes waiting, gap.

    Returns:
        The result; sound also where it is not complete.
    """
    search = _BestFirst(bounder, eps, (lower[:BOX_BATCH] + upper[:BOX_BATCH]) / 2, points)
    for chunk in _chunks(lower, upper, np.full(len(lower), -np.inf), np.full(len(lower), np.inf)):
        search.look(chunk)
    while search.waiting and search.done < boxes and search.seconds < budget:
        search.look(search.waiting.pop(max(range(len(search.waiting)), key=lambda i: search.waiting[i].gap[0])))
        if search.count > search.most:
            search.prune(max(search.done / boxes, search.seconds / budget) if min(boxes, budget) > 0 else 1.0)
        if progress:
            progress(search.done, search.count, float(search.best - search.least))
    # At most the least value found: its point may lie in no box that was closed.
    least, complete = float(min(search.least, search.best)), not search.waiting and not search.gave_up
    return Search(least, float(search.best), search.points, search.done, search.seconds, complete)


class _Chunk(NamedTuple):
    """Boxes that wait: corners, bounds, and gaps, the largest first."""

    low: np.ndarray
    high: np.ndarray
    bound: np.ndarray
    gap: np.ndarray


class _BestFirst:
    """A running search.

    Args:
        f: As in ``minimum``.
        eps: As in ``minimum``.
        probe: Points at which bounds and values are compared, for what bounds resolve.
        points: As in ``minimum``.

    Attributes:
        waiting: Open boxes.
        done: How many boxes were bounded.
        best: The least value found.
        closed: The least bound of a closed box.
        points: The lowest points found, lowest first.
        most: How many boxes may wait until some are pruned.
        gave_up: Whether pruning closed a box.
    """

    def __init__(self, f, eps: float, probe: np.ndarray, points: np.ndarray | None):
        self.f, self.positives, self.started = f, f if isinstance(f, ShapePositives) else None, working_seconds()
        self.points = probe[:0] if points is None else np.asarray(points, dtype=np.float64)
        self.values = f.reference(self.points) if len(self.points) else np.empty(0)
        self.eps = max(eps, 4 * float((f.reference(probe) - f.bound(probe, probe).lower).max()))
        self.best, self.closed, self.done = self.values.min(initial=np.inf), np.inf, 0
        self.waiting, self.most, self.gave_up = [], MANY * AGAIN, False

    @property
    def seconds(self) -> float:
        """Since the beginning."""
        return working_seconds() - self.started

    @property
    def count(self) -> int:
        """How many boxes wait."""
        return sum(len(chunk.bound) for chunk in self.waiting)

    @property
    def least(self) -> float:
        """The least bound of any box, closed or open."""
        return min([self.closed, *(chunk.bound.min() for chunk in self.waiting)])

    @property
    def target(self) -> float:
        """The bound that closes a box: near the least value found, or the least bound of a closed box."""
        return min(self.best - self.eps, self.closed)

    def look(self, chunk: _Chunk) -> None:
        """Bound boxes; halves of those that stay open wait."""
        open_ = chunk.bound < self.target
        self.closed = chunk.bound[~open_].min(initial=self.closed)
        low, high, parent = (column[open_] for column in chunk[:3])
        if not len(low):
            return
        bounds = self.f.bound(low, high)
        self.done += len(low)
        bound = np.fmax(bounds.lower, parent)  # a half is no worse than the whole, nor is one without a bound (NaN)
        axis, small = bounds.axis.copy(), np.zeros(len(low), dtype=bool)
        if self.positives is None:
            self._sample(bounds.point, bounds.value)
        else:
            small = self.positives.too_small(low, high)  # of whole boxes, as the bounds are: ``_cut`` may cut parts off
            self._cut(low, high, bounds, bound, axis)
            near = np.flatnonzero((bound < np.inf) & (bounds.value < self.best + NEAR * self.eps))
            near = near[self.positives.holds(bounds.point[near])]
            self._sample(bounds.point[near], bounds.value[near])
        open_ = (bound < self.target) & ~small
        self.closed = bound[~open_].min(initial=self.closed)
        # Where the bound is much looser than it may be, its halves would only be halved again: quarter at once.
        with np.errstate(invalid="ignore"):  # no positive of a box is known: its value is infinite
            loose = open_ & (bounds.value - bound > QUARTER * (bounds.value - (self.best - self.eps)))
        loose &= bounds.next_axis is not None
        once = open_ & ~loose
        halves = [(*halve(low[once], high[once], axis[once]), np.tile(bound[once], 2))]
        if loose.any():
            quarters = halve(*halve(low[loose], high[loose], axis[loose]), np.tile(bounds.next_axis[loose], 2))
            halves.append((*quarters, np.tile(bound[loose], 4)))
        low, high, bound = (np.concatenate(column) for column in zip(*halves, strict=True))
        with np.errstate(invalid="ignore"):  # as long as no value is known, every gap is infinite
            self.waiting += _chunks(low, high, bound, np.nan_to_num(self.best - bound, nan=np.inf))

    def _cut(self, low: np.ndarray, high: np.ndarray, bounds: BoxBounds, bound: np.ndarray, axis: np.ndarray) -> None:
        """Let the shape raise bounds and cut boxes, in place."""
        target = self.target
        rows = np.flatnonzero(bound < target)
        known = self.positives.tightened(low[rows], high[rows], bounds.part(rows), np.full(len(rows), target))
        bound[rows], axis[rows] = np.fmax(known.lower, bound[rows]), known.axis
        low[rows], high[rows] = known.corners
        self.closed = min(self.closed, target) if known.cut.any() else self.closed

    def _sample(self, points: np.ndarray, values: np.ndarray) -> None:
        """Remember the lowest points."""
        self.points, self.values = lowest(self.points, self.values, points, values)
        self.best = values.min(initial=self.best)

    def prune(self, used: float) -> None:
        """Close boxes that are not expected to matter by the end; ``used`` is the share of the limits that is spent."""
        known = [float(chunk.gap[0]) for chunk in self.waiting if np.isfinite(chunk.gap[0])]
        level, count = SHARE * max(known, default=0.0) * used**FALLS, self.count
        self.waiting, closed = _split(self.waiting, level, TOO_MANY // 2 if count > TOO_MANY else count)
        self.most = max(MANY, self.count) * AGAIN
        for chunk in closed:
            self.closed, self.gave_up = chunk.bound.min(initial=self.closed), True


def _chunks(*columns: np.ndarray) -> list[_Chunk]:
    """Boxes, given by the columns of ``_Chunk``, in chunks of ``BOX_BATCH``."""
    order = np.argsort(-columns[-1], kind="stable")
    columns = [column[order] for column in columns]
    return [_Chunk(*(column[i : i + BOX_BATCH] for column in columns)) for i in range(0, len(order), BOX_BATCH)]


def _split(chunks: list[_Chunk], level: float, most: int) -> tuple[list[_Chunk], list[_Chunk]]:
    """The boxes of gaps above a level, the ``most`` largest if there are more, and the others."""
    gap = np.concatenate([chunk.gap for chunk in chunks])
    large = gap > level
    if large.sum() > most:
        large = np.zeros(len(gap), dtype=bool)
        large[np.argpartition(-gap, most)[:most]] = True
    parts, begin = ([], []), 0
    for chunk in chunks:
        rows, begin = large[begin : begin + len(chunk.gap)], begin + len(chunk.gap)
        for part, some in zip(parts, (rows, ~rows), strict=True):
            if some.any():
                part.append(_Chunk(*(column[some] for column in chunk)))
    return parts


def lowest(
    points: np.ndarray, values: np.ndarray, more: np.ndarray, more_values: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The lowest ``WORST`` of two sets of points and their values, sorted."""
    if len(values) >= WORST:
        better = more_values < values[-1]
        more, more_values = more[better], more_values[better]
        if not len(more):
            return points, values
    points, values = np.concatenate([points, more]), np.concatenate([values, more_values])
    order = np.argsort(values, kind="stable")[:WORST]
    return points[order], values[order]


# --- f over the part of a box in a half-space ------------------------------------------------------------------------


# float64 roundings, at most, through which any term of a sum below goes: the map to local space and back takes 8, a
# term of a sum over the axes one for each axis (fewer than 64).
ROUNDINGS = 128.0


class TightenedBounds(NamedTuple):
    """What is known about f over those v of N boxes that come from points of the object.

    Attributes:
        lower: ``(N,)`` certified lower bounds of f there; infinity where a box holds no such v.
        axis: ``(N,)`` the axis along which halving the box should help most.
        corners: ``(N, n)`` lower and upper corners of the parts of the boxes that matter: every other such v has f of
            at least the target.
        cut: ``(N,)`` bool, which boxes lost something by that.
    """

    lower: np.ndarray
    axis: np.ndarray
    corners: tuple[np.ndarray, np.ndarray]
    cut: np.ndarray


def bound_in_half_spaces(
    domain: Domain, lower: np.ndarray, upper: np.ndarray, bounds: BoxBounds, known: HalfSpaces, target: np.ndarray
) -> TightenedBounds:
    """Bounds of f over the v of boxes that come from points of half-spaces.

    With ``f >= a + b . zeta``, ``|zeta| <= 1``, on the box, and ``c + d . zeta >= 0`` for every v of such a point, f is
    at least ``a - s c + (b - s d) . zeta`` there for any ``s >= 0``. That is concave in s and bends where an entry of
    ``b - s d`` changes its sign; the best of these is taken. A box is then cut to where none of the three linear
    functions shows that a point is outside the half-space, or that f is at least the target.

    Args:
        domain: Maps points to v; its ``delta`` is counted in.
        lower: ``(N, n)`` float64 corners of boxes, coordinates v.
        upper: ``(N, n)`` float64.
        bounds: Of f over these boxes, with ``level`` and ``slope``.
        known: Half-spaces, object space, over the boxes' ``Domain.origins``.
        target: ``(N,)``, f at which a box is closed.
    """
    center, radius, scale = (lower + upper) / 2, (upper - lower) / 2 * GROWTH, domain.scale.astype(np.float64)
    at, rate = domain.to_local(known.center), known.slope / scale
    away = 1 + np.abs(center) + np.abs(at) + np.abs(domain.center) * scale
    reach = domain.delta * GROWTH + ROUNDINGS * UNIT64 * away
    c = known.level + (rate * (center - at)).sum(axis=1) + (np.abs(rate) * reach).sum(axis=1)
    c += ROUNDINGS * UNIT64 * np.abs(known.level)
    a = bounds.level - ROUNDINGS * UNIT64 * (np.abs(bounds.slope) * away).sum(axis=1)
    b, d = bounds.slope * radius, rate * radius
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = b / d
    shares = np.where((shares > 0) & np.isfinite(shares), shares, 0.0)
    best, share = np.full(len(b), -np.inf), np.zeros(len(b))
    for each in shares.T:
        value = a - each * c - np.abs(b - each[:, None] * d).sum(axis=1)
        better = value > best
        best, share = np.where(better, value, best), np.where(better, each, share)
    # The best of them once more, with what its float64 arithmetic may round.
    size = np.abs(a) + share * np.abs(c) + (np.abs(b) + share[:, None] * np.abs(d)).sum(axis=1)
    best = best - ROUNDINGS * UNIT64 * size
    low, high = np.full_like(b, -1.0), np.ones_like(b)
    joint = a - share * c - ROUNDINGS * UNIT64 * size, b - share[:, None] * d
    for rest, line in ((c, -d), (target - a, b), (target - joint[0], joint[1])):
        _cut(low, high, rest, line)
    least, gone = np.fmax(best, bounds.lower), known.empty | (low > high).any(axis=1)
    least = np.where(known.empty, np.inf, np.where(gone, np.fmax(least, target), least))
    low[gone], high[gone] = -1.0, 1.0
    by_shape = share * known.loss > bounds.value - bounds.lower
    rounding = ROUNDINGS * UNIT64 * away
    low, high = center + radius * low - rounding, center + radius * high + rounding
    low, high = np.maximum(lower, low), np.minimum(upper, high)
    cut = ((low > lower) | (high < upper)).any(axis=1)
    return TightenedBounds(least, np.where(by_shape, known.axis, bounds.axis), (low, high), cut)


def _cut(low: np.ndarray, high: np.ndarray, rest: np.ndarray, line: np.ndarray) -> None:
    """Narrow the ranges of zeta in place to where ``line . zeta <= rest`` can hold for a zeta with ``|zeta| <= 1``."""
    size = np.abs(line)
    whole = size.sum(axis=1)
    rest = rest + whole + ROUNDINGS * UNIT64 * (np.abs(rest) + whole)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        end = (rest[:, None] - size) / size
    end = np.where(np.isfinite(end), end * (1 + np.sign(end) * 1e-12) + 1e-12, np.inf)
    np.copyto(high, np.minimum(high, end), where=line > 0)
    np.copyto(low, np.maximum(low, -end), where=line < 0)


# --- positives of a shape without cells ------------------------------------------------------------------------------


NARROWEST = 2.0**-14  # local units, in which the domain is about [-1, 1]^n: boxes with no longer side are not halved
# A box whose longest side is more than this many times the side that the bound of f would halve is halved along its
# longest side: else boxes get flat, and a shape that only knows a distance can never certify flat boxes.
LONGEST_TO_SPLIT = 8.0


class ShapePositives:
    """Boxes that hold P_delta of a shape for points, and what the shape certifies of them.

    ``minimum`` and ``certify`` search it.

    Args:
        bounder: Its f is bounded; v is a point of the object's space.
        shape: The object.
        narrowest: See ``NARROWEST``; ``certify`` takes less, and so decides on smaller boxes than the fit did.
    """

    def __init__(self, bounder: Bounder, shape: Shape, narrowest: float = NARROWEST):
        self.bounder, self.shape, self.narrowest = bounder, shape, narrowest
        self.domain = bounder.domain

    def boxes(self) -> tuple[np.ndarray, np.ndarray]:
        """``(N, n)`` corners of boxes that hold every v of a positive that the domain test passes: the domain."""
        limit = self.domain.limit.astype(np.float64)[None]
        return -limit, limit

    def reference(self, v: np.ndarray) -> np.ndarray:
        """``f`` at ``(N, n)``; see ``Bounder.reference``."""
        return self.bounder.reference(v)

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """Certified bounds of f over boxes, see ``Bounder.bound``; flat boxes are halved along their longest side."""
        bounds = self.bounder.bound(lower, upper)
        return bounds._replace(axis=_unless_flat(upper - lower, bounds.axis), next_axis=None)

    def vacant(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """``(N,)`` bool, certified: nothing in the closed box can come from a positive."""
        return self.shape.empty(*self.domain.origins(lower, upper))

    def tightened(self, lower: np.ndarray, upper: np.ndarray, bounds: BoxBounds, target: np.ndarray) -> TightenedBounds:
        """What is known of f over those v of boxes that come from positives.

        Args:
            lower: ``(N, n)`` float64 corners.
            upper: ``(N, n)`` float64.
            bounds: What ``bound`` says of these boxes.
            target: ``(N,)``, f at which a box is closed.
        """
        known = None if bounds.slope is None else self.shape.half_spaces(*self.domain.origins(lower, upper))
        if known is None:
            least = np.where(self.vacant(lower, upper), np.inf, bounds.lower)
            return TightenedBounds(least, bounds.axis, (lower, upper), np.zeros(len(lower), dtype=bool))
        least = bound_in_half_spaces(self.domain, lower, upper, bounds, known, target)
        return least._replace(axis=_unless_flat(least.corners[1] - least.corners[0], least.axis))

    def too_small(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """``(N,)`` bool: boxes that are not halved any more."""
        return ((upper - lower) <= self.narrowest).all(axis=1)

    def holds(self, v: np.ndarray) -> np.ndarray:
        """``(N,)`` bool: which of these v are positives: the exact v of points of the object."""
        return self.shape.decide(self.domain.to_object(v)) != OUT  # a file's domain may reach far beyond limits


def _unless_flat(side: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """The axes ``(N,)`` along which to halve boxes of these sides: as given, but of flat boxes the longest side."""
    longest, row = side.argmax(axis=1), np.arange(len(side))
    return np.where(side[row, longest] > LONGEST_TO_SPLIT * side[row, axis], longest, axis)
