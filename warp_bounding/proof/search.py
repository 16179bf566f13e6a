"""Branch and bound: the least value of a bounder's ``f`` over boxes, certified from below.

Every box gets a certified lower bound of f (``Bounder.bound``) and a few concrete points. A box whose bound is high
enough is closed, the others are halved. The result is sound whenever the search ends: it is the least bound over all
closed *and* open boxes.

*Best first* (``minimum``), on the host: a box is closed if its bound is at most ``eps`` under the least value found.
Boxes wait in chunks. The chunk of the highest price comes first, by default that of the largest gap, so that a search
that is stopped early has raised its bound as far as it could. When many boxes wait, the search closes those that are
not expected to matter by the end; when too many wait, the half that matters least. Their bounds count as they are. So
memory stays bounded and the search goes on where it counts, but it can no longer reach the requested gap.

*A shape without cells* (``ShapePositives``): the search begins with the whole domain. Where the bound of f is too low
in a box, the shape decides whether the box is vacant: whether no v in it can come from a point of the object, rounding
included. Vacant boxes are dropped, the others halved. So the shape is queried only where the bounder says *no*, or
nearly so, and most of the domain is never refined. A shape that knows half-spaces of its part in a box
(``Shape.half_spaces``) closes many boxes that are neither vacant nor high enough in f (``bound_in_half_spaces``). A box
that is at most ``NARROWEST`` wide on every axis counts as object.

*Depth first* (``parametrized_minimum``), in a kernel, over boxes of a parametrization's numbers: it proves ``f >=
target``, or the highest target that time allows. A box is closed when its bound reaches the target (any bound reaches
``CLOSE_ALL``, minus infinity), or when it is too narrow to be halved; it is never opened again. The target is proven
when no box waits and the least bound of a closed box reaches it. Which boxes must be halved depends on the target
alone, not on the order, so a depth-first search with a few boxes a thread does the same work as one that keeps them all
in order, and needs no memory. The initial boxes come in random order, so the share of them that is done tells early how
long the rest will take. A search for the minimum begins with the best target, and goes on with a lower one if that is
expected to take too long. No target above the least bound of a closed box can be proven any more, so the target falls
to that bound, too (``Pace.reach``); that is what is proven in the end.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from typing import NamedTuple

import numpy as np
import warp as wp

from warp_bounding.activations import constant, constants
from warp_bounding.bounders.bounder import Bounder
from warp_bounding.networks.bounds import (
    AXIS,
    BoxBounds,
    NetworkShape,
    Parametrization,
    body,
    double_array,
    lanes_text,
    load_text,
)
from warp_bounding.networks.network import Network
from warp_bounding.proof.halving import halve
from warp_bounding.queries.domain import GROWTH, Domain
from warp_bounding.rounding import UNIT64
from warp_bounding.runtime.launch import launch_blocks, working_seconds
from warp_bounding.runtime.native import named, unique_name
from warp_bounding.shapes.shape import HalfSpaces, Shape

# --- best first ------------------------------------------------------------------------------------------------------


CHUNK = 32768  # boxes that are bounded at a time
MANY, TOO_MANY = 5_000_000, 15_000_000  # boxes that wait (a million takes about 0.1 GB in 4D)
AGAIN = 1.2  # waiting boxes are pruned again when there are this many times as many as after the last pruning
# The gap falls about as this power of the number of bounded boxes; pruning closes boxes whose price is below this share
# of the highest price, scaled by that fall.
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
        needed: Seconds that a complete search is expected to take; infinity where that is not known.
        numbers: ``(K, Z)``, the lowest points as numbers of a parametrization, where there is one.
        by_group: ``(G,)``, the same as ``lower_bound`` of each group of boxes by itself.
    """

    lower_bound: float
    upper_bound: float
    worst: np.ndarray
    boxes: int
    seconds: float
    complete: bool
    needed: float = np.inf
    numbers: np.ndarray | None = None
    by_group: np.ndarray | None = None


def minimum(
    bounder: Bounder,
    lower: np.ndarray,
    upper: np.ndarray,
    *,
    eps: float | np.ndarray,
    budget: float = float("inf"),
    boxes: float = float("inf"),
    points: np.ndarray | None = None,
    progress: Callable[[int, int, float], None] | None = None,
    positives: "ShapePositives | None" = None,
    known: float = float("inf"),
    groups: np.ndarray | None = None,
    group_of: Callable[[np.ndarray], np.ndarray] | None = None,
    group_count: int = 1,
    price: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
) -> Search:
    """Certified minimum of ``f`` over boxes, or over those of their points that are positives of a shape.

    Boxes may belong to groups, each with a minimum of its own. No group is refined below its own minimum, and a search
    that runs out of time is loose only in unfinished groups.

    Args:
        bounder: The bounder of ``f``.
        lower: ``(N, n)`` float64 lower corners, coordinates ``v``.
        upper: ``(N, n)`` float64 upper corners.
        eps: Gap between bound and found value at which a box is closed; at least 0. It is not taken smaller than what
            the bounds of single points resolve, or the search would not end. Of groups there may be one for each.
        budget: Seconds after which the search ends with what it has; the given boxes are bounded once in any case.
        boxes: Number of boxes after which it ends with what it has, the same on every machine.
        points: ``(P, n)`` concrete points in the boxes to begin with; good ones save most of the work.
        progress: Called now and then with boxes done, boxes waiting, gap.
        positives: Certifies which boxes hold no positive; if ``None``, every point of the boxes is a positive.
        known: A value of f at a positive, where there are no groups.
        groups: ``(N,)`` int, the group of each box, from 0 on; all are one group if ``None``.
        group_of: The groups of ``points``; needed where there are groups.
        group_count: How many groups there are, including those without a box.
        price: The cost of a bound as the proven minimum of its group: called with bounds ``(K,)`` and their groups, it
            grows as bounds fall. Boxes of the highest price come first. The gap if ``None``.

    Returns:
        The result; sound also where it is not complete.
    """
    started = working_seconds()
    low_points = np.empty((0, lower.shape[1])) if points is None else np.asarray(points, dtype=np.float64)
    low_values = bounder.reference(low_points) if len(low_points) else np.empty(0)
    groups = np.zeros(len(lower), np.int64) if groups is None else np.asarray(groups)
    best, closed, done = np.full(group_count, known), np.full(group_count, np.inf), 0
    np.minimum.at(best, np.zeros(len(low_points), np.int64) if group_of is None else group_of(low_points), low_values)
    probe = (lower[:CHUNK] + upper[:CHUNK]) / 2
    resolved = 4 * float((bounder.reference(probe) - bounder.bound(probe, probe).lower).max())
    eps = np.broadcast_to(np.maximum(eps, resolved), best.shape)

    def targets() -> np.ndarray:
        """The bound that closes a box, by group: near the least value found, or the least bound of a closed box."""
        return np.minimum(best - eps, closed)

    def prices(bound: np.ndarray, group: np.ndarray) -> np.ndarray:
        with np.errstate(invalid="ignore"):  # without a known value of a group its best value and price are infinite
            gap = np.nan_to_num(best[group] - bound, nan=np.inf)
            return gap if price is None else price(bound, group)

    def advance(low: np.ndarray, high: np.ndarray, parent: np.ndarray, group: np.ndarray, _) -> list[_Chunk]:
        """Bound a chunk; its halves that stay open, in chunks."""
        nonlocal done, low_points, low_values
        open_ = parent < targets()[group]
        np.minimum.at(closed, group[~open_], parent[~open_])
        low, high, parent, group = low[open_], high[open_], parent[open_], group[open_]
        if not len(low):
            return []
        bounds = bounder.bound(low, high)
        done += len(low)
        bound = np.fmax(bounds.lower, parent)  # a half is no worse than the whole, nor is one without a bound (NaN)
        points, values, of_points, axis = bounds.point, bounds.value, group, bounds.axis.copy()
        if positives is not None:
            small = positives.too_small(low, high)  # of whole boxes, as the bounds are: ``held`` may cut parts off
            queried = np.flatnonzero(bound < targets()[group])
            goal = targets()[group[queried]]
            held = positives.held(low[queried], high[queried], bounds.part(queried), goal)
            bound[queried], axis[queried] = np.fmax(held.lower, bound[queried]), held.axis
            low[queried], high[queried] = held.corners
            np.minimum.at(closed, group[queried[held.cut]], goal[held.cut])
            near = np.flatnonzero((bound < np.inf) & (values < (best + NEAR * eps)[group]))
            near = near[positives.holds(points[near])]
            points, values, of_points = points[near], values[near], group[near]
        low_points, low_values = lowest(low_points, low_values, points, values)
        np.minimum.at(best, of_points, values)
        open_ = bound < targets()[group]
        if positives is not None:
            open_ &= ~small
        np.minimum.at(closed, group[~open_], bound[~open_])
        # Where the bound is much looser than it may be, its halves would only be halved again: quarter at once.
        with np.errstate(invalid="ignore"):  # no positive of a box is known: its value is infinite
            loose = open_ & (bounds.value - bound > QUARTER * (bounds.value - (best - eps)[group]))
        loose &= bounds.next_axis is not None
        once, parts = open_ & ~loose, []
        if once.any():
            halves = halve(low[once], high[once], axis[once])
            parts.append((*halves, np.tile(bound[once], 2), np.tile(group[once], 2)))
        if loose.any():
            halves = halve(low[loose], high[loose], axis[loose])
            halves = halve(*halves, np.tile(bounds.next_axis[loose], 2))
            parts.append((*halves, np.tile(bound[loose], 4), np.tile(group[loose], 4)))
        if not parts:
            return []
        low, high, bound, group = (np.concatenate(part) for part in zip(*parts, strict=True))
        return _chunks(low, high, bound, group, prices(bound, group))

    def least() -> np.ndarray:
        found = closed.copy()
        for chunk in waiting:
            np.minimum.at(found, chunk.group, chunk.bound)
        return found

    nowhere = np.full(len(lower), -np.inf)
    start = _chunks(lower, upper, nowhere, groups, -nowhere)
    waiting, gave_up = [rest for chunk in start for rest in advance(*chunk)], False
    looked_at = MANY
    while waiting and done < boxes and working_seconds() - started < budget:
        waiting += advance(*waiting.pop(max(range(len(waiting)), key=lambda i: waiting[i].price[0])))
        count = sum(len(chunk.bound) for chunk in waiting)
        if count > looked_at * AGAIN:
            spent = working_seconds() - started
            used = max(done / boxes, spent / budget) if min(boxes, budget) > 0 else 1.0
            known = [float(chunk.price[0]) for chunk in waiting if np.isfinite(chunk.price[0])]
            level = SHARE * max(known, default=0.0) * used**FALLS
            waiting, rest = _split(waiting, level, TOO_MANY // 2 if count > TOO_MANY else count)
            looked_at = max(MANY, sum(len(chunk.bound) for chunk in waiting))
            for chunk in rest:
                np.minimum.at(closed, chunk.group, chunk.bound)
                gave_up = True
        if progress:
            progress(done, sum(len(chunk.bound) for chunk in waiting), float(best.min() - least().min()))
    # At most the least value found: its point may lie in no box that was closed.
    found, spent = np.minimum(least(), best), working_seconds() - started
    complete = not waiting and not gave_up
    return Search(float(found.min()), float(best.min()), low_points, done, spent, complete, by_group=found)


class _Chunk(NamedTuple):
    """Boxes that wait: corners, bounds, groups, and prices, the highest first."""

    low: np.ndarray
    high: np.ndarray
    bound: np.ndarray
    group: np.ndarray
    price: np.ndarray


def _chunks(*columns: np.ndarray) -> list[_Chunk]:
    """Boxes, given by the columns of ``_Chunk``, in chunks of ``CHUNK``."""
    order = np.argsort(-columns[-1], kind="stable")
    held = [each[order] for each in columns]
    return [_Chunk(*(each[i : i + CHUNK] for each in held)) for i in range(0, len(order), CHUNK)]


def _split(chunks: list[_Chunk], level: float, most: int) -> tuple[list[_Chunk], list[_Chunk]]:
    """The boxes of prices above a level, the ``most`` highest if there are more, and the others."""
    price = np.concatenate([chunk.price for chunk in chunks])
    expensive = price > level
    if expensive.sum() > most:
        expensive = np.zeros(len(price), dtype=bool)
        expensive[np.argpartition(-price, most)[:most]] = True
    kept, rest, begin = [], [], 0
    for chunk in chunks:
        own, begin = expensive[begin : begin + len(chunk.price)], begin + len(chunk.price)
        for part, held in ((own, kept), (~own, rest)):
            if part.any():
                held.append(_Chunk(*(each[part] for each in chunk)))
    return kept, rest


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


class CachedBounds(NamedTuple):
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
) -> CachedBounds:
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
    room = ROUNDINGS * UNIT64 * away
    low, high = np.maximum(lower, center + radius * low - room), np.minimum(upper, center + radius * high + room)
    cut = ((low > lower) | (high < upper)).any(axis=1)
    return CachedBounds(least, np.where(by_shape, known.axis, bounds.axis), (low, high), cut)


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

    ``minimum`` and ``certify`` search it. ``prove.ShapeRegions`` does the same for regions, whose boxes are of
    parametrization numbers instead of v.

    Args:
        bounder: Its f is bounded; v is a point of the object's space.
        shape: The object.
        narrowest: See ``NARROWEST``; ``certify`` takes less, and so decides on smaller boxes than the fit did.
    """

    def __init__(self, bounder: Bounder, shape: Shape, narrowest: float = NARROWEST):
        self.bounder, self.shape, self.narrowest = bounder, shape, narrowest
        self.domain = bounder.domain

    def boxes(self) -> tuple[np.ndarray, np.ndarray]:
        """``(N, n)`` corners of boxes that hold every v of a positive that the domain test passes: the domain, cut."""
        limit = self.domain.limit.astype(np.float64)[None]
        return self.bounder.cut(-limit, limit)[:2]

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

    def held(self, lower: np.ndarray, upper: np.ndarray, bounds: BoxBounds, target: np.ndarray) -> CachedBounds:
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
            return CachedBounds(least, bounds.axis, (lower, upper), np.zeros(len(lower), dtype=bool))
        found = bound_in_half_spaces(self.domain, lower, upper, bounds, known, target)
        return found._replace(axis=_unless_flat(found.corners[1] - found.corners[0], found.axis))

    def too_small(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """``(N,)`` bool: boxes that are not halved any more."""
        return ((upper - lower) <= self.narrowest).all(axis=1)

    def holds(self, v: np.ndarray) -> np.ndarray:
        """``(N,)`` bool: which of these v are positives: the exact v of points of the object."""
        return self.shape.contains(self.domain.to_object(v))


def _unless_flat(side: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """The axes ``(N,)`` along which to halve boxes of these sides: as given, but of flat boxes the longest side."""
    longest, row = side.argmax(axis=1), np.arange(len(side))
    return np.where(side[row, longest] > LONGEST_TO_SPLIT * side[row, axis], longest, axis)


# --- depth first: the kernel -----------------------------------------------------------------------------------------


STACK = 1024  # boxes that a block can hold; a stack grows by one box for each lane and level, of about 60 levels
RARELY = 4  # f is evaluated in one of so many steps: it takes a quarter of the time of a bound, and seldom finds less
# in the parametrization's numbers: a box narrower than this is closed, since halving would not raise its bound
SMALLEST = 1e-8
KEPT = 8  # low points that a block returns


# A block (a thread on CUDA) has a stack of boxes in global memory. It takes as many as it has lanes, bounds them,
# closes those whose bound reaches the target and halves the others, until the stack is empty or full, the block has
# bounded as many boxes as it may, or a positive lies under the target. Boxes that are then on the stack wait for the
# next launch. If the target is -infinity, all boxes are bounded once and closed, however many there are, and a bound
# that is NaN counts as -infinity. A box that is too narrow to be halved is closed, too: the least bound of a closed box
# then lies below the target. BODY bounds the boxes of all lanes, SPLIT sets where one is halved.
_SEARCH = """
double* stack = stacks.data + (long long)block * (STACK * ROW);
double* kept_value = low_value.data + block * KEPT; double* kept_point = low_point.data + (long long)block * (KEPT * BOX);
for (int k = 0; k < KEPT; ++k) kept_value[k] = INFINITY;
int held = heights.data[block], initial = initials.data[block], turn = 0, rounds = 0;
long long done = 0; double closed = INFINITY;
bool refuted = false; // whether a positive lies under the target
const bool last = isinf(target) && target < 0.0;
while (held > 0 && (last || (done < most && held + L <= STACK && !refuted))) {
    const int taken = held < L ? held : L;
    held -= taken; initial = held < initial ? held : initial;
    const bool tried = !isfinite(target) || rounds++ % RARELY == 0; turn = (turn + tried) % KEPT;
    V low[BOX], high[BOX];
    for (int l = 0; l < L; ++l) { const int j = held + (l < taken ? l : 0); LOAD }
    BODY
    done += taken;
    for (int l = 0; l < taken; ++l) {
        if (LANE(dead) != 0.0) continue;
        if (LANE(valid) != 0.0 && LANE(value) < kept_value[turn]) {
            kept_value[turn] = LANE(value); refuted = refuted || LANE(value) < target;
            for (int k = 0; k < BOX; ++k) kept_point[turn * BOX + k] = LANE(z[k]);
        }
        const double bound = LANE(least);
        if (last) { const double b = bound == bound ? bound : target; closed = b < closed ? b : closed; continue; }
        if (bound >= target) { closed = bound < closed ? bound : closed; continue; }
        AXIS
        double* one = stack + (long long)held * ROW; double* two = one + ROW;
        for (int k = 0; k < BOX; ++k) { one[k] = two[k] = LANE(low[k]); one[BOX + k] = two[BOX + k] = LANE(high[k]); }
        if (one[BOX + axis] - one[axis] < SMALLEST)
            for (int k = 0; k < BOX; ++k) if (one[BOX + k] - one[k] > one[BOX + axis] - one[axis]) axis = k;
        if (one[BOX + axis] - one[axis] < SMALLEST) {
            const double b = bound == bound ? bound : -INFINITY; closed = b < closed ? b : closed; continue;
        }
        held += 2;
        const double a = one[axis], b = one[BOX + axis]; double middle;
        SPLIT
        one[BOX + axis] = middle; two[axis] = middle;
    }
}
heights.data[block] = held; initials.data[block] = initial; done_out.data[block] = done; closed_out.data[block] = closed;
"""  # noqa: E501


def _snippet(shape: NetworkShape) -> str:
    names = "const double* w = weights.data; const double* padding = paddings.data;\n"
    names += constants(
        BOX=shape.parametrization.size, ROW=2 * shape.parametrization.size, STACK=STACK, RARELY=RARELY, KEPT=KEPT
    )
    names += f" constexpr double SMALLEST = {constant(SMALLEST)};"
    cpu, cuda = lanes_text(shape, names)
    parts = {
        "LOAD": load_text("stack", "j"),
        "BODY": body(shape, "tried"),
        "AXIS": AXIS,
        "SPLIT": shape.parametrization.split,
    }
    search = re.sub(r"\b(LOAD|BODY|AXIS|SPLIT)\b", lambda part: parts[part.group()], _SEARCH)
    return f"""
#if !defined(__CUDA_ARCH__)
{cpu}
{search}
#else
{cuda}
{search}
#endif
#undef LANE
"""


@cache
def depth_first_kernel(shape: NetworkShape) -> wp.Kernel:
    """The kernel for a network and a parametrization; a thread searches the block ``block + wp.tid()``.

    It reads and writes ``stacks`` ``(blocks, STACK, 2, Z)`` float64, ``heights`` ``(blocks,)`` int32, the number of
    boxes on each stack, and ``initials`` ``(blocks,)`` int32, how many of the lowest of these are initial boxes. It
    writes ``done_out``, the number of boxes bounded (int64), ``closed_out``, the least bound of a box that it has
    closed, ``low_value`` ``(blocks, KEPT)`` and ``low_point`` ``(blocks, KEPT, Z)``, low positives.
    """
    name = named(unique_name(shape, "descent"))

    @name.block_kernel(_snippet(shape))
    def descend(
        block: int,
        target: wp.float64,
        most: int,
        weights: wp.array(dtype=wp.float64),
        paddings: wp.array(dtype=wp.float64),
        numbers: wp.array(dtype=wp.float64),
        table: wp.array(dtype=wp.int32),
        stacks: wp.array(dtype=wp.float64),
        heights: wp.array(dtype=wp.int32),
        initials: wp.array(dtype=wp.int32),
        done_out: wp.array(dtype=wp.int64),
        closed_out: wp.array(dtype=wp.float64),
        low_value: wp.array(dtype=wp.float64),
        low_point: wp.array(dtype=wp.float64),
    ): ...

    return descend


# --- pace ------------------------------------------------------------------------------------------------------------


# The work is taken to grow like (1 / gap)^STEEPNESS until two gaps have been measured, whose exponent is then used,
# within these bounds.
STEEPNESS = 0.2
FLATTEST, STEEPEST = 0.15, 0.7
END = 0.93  # used fraction of the limits at which a search should be done: the last boxes take longer than the others
HEADROOM = 1.15  # a new gap is chosen so that its expected time, times this, is what is left
LATE = 1.03  # a gap is given up where its expected time exceeds what is left by this factor
SURE = 4096  # initial boxes that must be done before a gap is judged, or
PATIENCE = 0.25  # this fraction of the time left must have passed: some 512 boxes are in work at any time
WIDEST = 3.0  # largest factor by which a gap is widened at once
OVERTIME, WIDER = 0.01, 3.0  # past END, a gap is widened by the factor WIDER after every OVERTIME of the limits


class Pace:
    """The gap between the least value known and the target of a search, widened as time runs short.

    Args:
        gap: The first gap, which is the best one that is requested.
        used: Fraction of the limits (time, boxes) that preparations have used.

    Attributes:
        gap: The present gap.
        whole: Fraction of the limits that the first gap was expected to take when it was given up; 0 if it was not.
    """

    def __init__(self, gap: float, used: float = 0.0):
        self.gap, self.whole = gap, 0.0
        self._growth, self._judged, self._start = STEEPNESS, None, used
        self._from = (used, 0.0, 0)

    def update(self, used: float, begun: float, boxes: int, count: int) -> None:
        """Widen the gap if the search is late.

        What the present gap takes is measured in boxes, and converted to time by the speed of the whole search so far,
        because machines have slow moments.

        Args:
            used: Fraction of the limits that is used.
            begun: Fraction of the initial boxes that are done or begun.
            boxes: Number of boxes that were bounded.
            count: Number of initial boxes.
        """
        time, done, work = (now - then for now, then in zip((used, begun, boxes), self._from, strict=True))
        left, here = END - used, (used, begun, boxes)
        if left <= 0:
            if time >= OVERTIME:
                self.gap, self._from = self.gap * WIDER, here
            return
        if not work or (done * count < SURE and time < PATIENCE * (left + time)):
            return
        whole = work / max(done, 1 / count) * (used - self._start) / boxes
        expected = whole * (1 - begun)
        if expected <= LATE * left:
            return
        if self._judged:
            gap, before = self._judged
            self._growth = float(np.clip(np.log(before / whole) / np.log(self.gap / gap), FLATTEST, STEEPEST))
        else:
            self.whole = whole
        self._judged = (self.gap, whole)
        self.gap *= min((HEADROOM * expected / left) ** (1 / self._growth), WIDEST)
        self._from = here

    def reach(self, gap: float) -> None:
        """Widen the gap to at least one that the search cannot come under any more."""
        self.gap = max(self.gap, gap)

    def widen(self) -> None:
        """Widen the gap whatever the time."""
        self.gap *= 10.0


# --- depth first, in a kernel ----------------------------------------------------------------------------------------


CPU_BLOCKS, CUDA_BLOCKS = 64, 2048  # blocks of a launch, each with a stack of its own
MOST = 1024  # boxes that a block bounds before it returns: some 50 ms a launch
HANDED_OUT = 64  # boxes that an idle block is given at a time
# Initial boxes of a search: INITIAL_SHARE of those that there is time for, but within these numbers. With fewer, the
# share that is done would not tell what the rest will take.
INITIAL, MOST_INITIAL = 4096, 131_072
INITIAL_SHARE = 0.02
CLOSE_ALL = -np.inf  # as a target: every box that waits is bounded once and closed
STATE = 3  # arrays of the blocks' state: stacks, heights, and how many boxes of each are initial ones


@dataclass(frozen=True)
class ParametrizedPositives:
    """An object's positives as boxes of a parametrization's numbers z, and the network whose f is bounded there."""

    network: Network  # of f
    parametrization: Parametrization  # how numbers z become a query
    lower: np.ndarray  # ``(N, Z)`` float64, corners of boxes that cover all positives, with what the pipeline rounds
    upper: np.ndarray  # ``(N, Z)`` float64
    numbers: np.ndarray  # float64 parameters of the parametrization
    limit: np.ndarray  # ``(K,)``, largest inputs of the network that boxes reach, noise included
    table: np.ndarray = field(default_factory=lambda: np.zeros(1, np.int32))  # int32 parameters of the parametrization
    terms: np.ndarray | None = None  # ``(K,)``, of the sum of an input's absolute terms over a box; ``None``: limit

    def bound(self, lower: np.ndarray, upper: np.ndarray, device="cpu") -> BoxBounds:
        """Certified bounds over boxes of z."""
        more = self.limit, self.terms, self.numbers, self.table, device
        return self.network.bound_parametrized(self.parametrization, lower, upper, *more)

    @property
    def padding(self) -> np.ndarray:
        """What float64 rounds in bounds over boxes, layer by layer."""
        return self.network.padding_for(self.limit, self.terms)

    def coordinates(self, z: np.ndarray) -> np.ndarray:
        """Coordinates ``v`` of a query for numbers of the parametrization."""
        return self.parametrization.coordinates(z, self.numbers)


class Descent:
    """Boxes that wait, in a reserve and on the stacks of the kernel's blocks, and what was found on the way.

    Attributes:
        boxes: Number of boxes that were bounded.
        initial_count: Number of initial boxes.
        least: Least bound of a closed box.
        begun: Fraction of the initial boxes that are done or begun.
        stuck: Whether the last step could not do anything, because every stack is full.
        points: ``(K, Z)``, the lowest positives found, numbers of the parametrization, lowest first.
        values: ``(K,)``, f there.
    """

    def __init__(self, cover: ParametrizedPositives, device: str):
        dev = wp.get_device(device)
        self._kernel, self._device = depth_first_kernel(cover.network.kernel_shape(cover.parametrization)), dev
        blocks, size = CPU_BLOCKS if dev.is_cpu else CUDA_BLOCKS, cover.parametrization.size
        self._stacks = np.empty((blocks, STACK, 2, size))
        self._heights, self._initial = np.zeros(blocks, np.int32), np.zeros(blocks, np.int32)
        self._done, self._closed = np.zeros(blocks, np.int64), np.full(blocks, np.inf)
        self._values, self._points = np.full((blocks, KEPT), np.inf), np.zeros((blocks, KEPT, size))
        order = np.random.default_rng(0).permutation(len(cover.lower))
        self._reserve, self._left = np.stack([cover.lower, cover.upper], axis=1)[order], len(order)
        held = [cover.network.packed, cover.padding, cover.numbers]
        self._parameters_host = [np.ascontiguousarray(a, dtype=np.float64) for a in held]
        self._parameters = [double_array(a, dev) for a in self._parameters_host]
        self._parameters.append(wp.array(cover.table, dtype=wp.int32, device=dev))
        # What the kernel changes; the first STATE arrays are also what it starts from. On a CPU the Warp arrays share
        # their memory; on CUDA those are copied before each launch, and all of them after it.
        self._outputs_host = [self._stacks, self._heights, self._initial]
        self._outputs_host += [self._done, self._closed, self._values, self._points]
        kinds = [wp.float64, wp.int32, wp.int32, wp.int64, *[wp.float64] * 3]
        self._outputs = [
            wp.array(a.reshape(-1), dtype=t, device=dev, copy=not dev.is_cpu)
            for a, t in zip(self._outputs_host, kinds, strict=True)
        ]
        self.points, self.values = np.empty((0, size)), np.empty(0)
        self.boxes, self.initial_count, self.least, self.begun, self.stuck = 0, len(order), np.inf, 0.0, False
        self._target = CLOSE_ALL

    @property
    def waiting(self) -> bool:
        """Whether any box is not closed."""
        return bool(self._left or self._heights.any())

    @property
    def complete(self) -> bool:
        """Whether the last target is proven: every box is closed and reaches it."""
        return not self.waiting and self.least >= self._target

    def step(self, target: float, boxes: float = float("inf")) -> float:
        """Let each block search on, for some 50 ms in all, and close the boxes that reach a target.

        Args:
            target: Value of f, or ``CLOSE_ALL``.
            boxes: About how many boxes to bound at most.

        Returns:
            The lowest value of f at a positive that this step has found.
        """
        self._target = float(target)
        self._left -= _fill(self._stacks, self._heights, self._initial, self._reserve[: self._left])
        most = int(min(MOST, max(boxes / len(self._heights), 1)))
        if not self._device.is_cpu:
            for array, values in zip(self._outputs[:STATE], self._outputs_host[:STATE], strict=True):
                array.assign(values.reshape(-1))
        inputs = [0, self._target, most, *self._parameters]
        launch_blocks(self._kernel, len(self._heights), inputs, self._outputs, self._device, first_index=0, block=1)
        if not self._device.is_cpu:
            for array, values in zip(self._outputs, self._outputs_host, strict=True):
                values[...] = array.numpy().reshape(values.shape)
        self.boxes, self.least = self.boxes + int(self._done.sum()), min(self.least, float(self._closed.min()))
        self.begun = 1 - (self._left + int(self._initial.sum())) / len(self._reserve)
        self.stuck = not self._done.any()
        seen = np.isfinite(self._values)
        self.points, self.values = lowest(self.points, self.values, self._points[seen], self._values[seen])
        return float(self._values.min())


def prove_target(
    cover: ParametrizedPositives, target: float, *, boxes: float = float("inf"), device: str = "cpu"
) -> Descent:
    """Try to prove ``f >= target`` for all positives; ends early where a positive lies under the target.

    Args:
        cover: The positives.
        target: Value of f, or ``CLOSE_ALL``.
        boxes: Limit: the number of boxes after which the search ends.
        device: Warp device.
    """
    descent = Descent(cover, device)
    while descent.waiting:
        found = descent.step(target, boxes - descent.boxes)
        if descent.boxes >= boxes or descent.stuck or min(found, descent.least) < target:
            break
    return descent


def _fill(stacks: np.ndarray, heights: np.ndarray, initial: np.ndarray, reserve: np.ndarray) -> int:
    """Give empty blocks boxes from the reserve's end, or else the bottom half of the fullest stack, its largest boxes.

    The lowest ``initial`` boxes of each stack ``(STACK, 2, Z)`` are initial ones, not halved yet. The reserve
    ``(N, 2, Z)`` has the initial boxes that no block has taken. Returns how many boxes were taken from it.
    """
    taken, empty = 0, np.flatnonzero(heights == 0)
    for place, block in enumerate(empty):
        left = len(reserve) - taken
        if left:
            count = min(HANDED_OUT, -(-left // (len(empty) - place)))
            stacks[block, :count] = reserve[left - count : left]
            heights[block] = initial[block] = count
            taken += count
            continue
        donor = int(np.argmax(heights))
        if heights[donor] < 2:
            break
        count = heights[donor] // 2
        stacks[block, :count] = stacks[donor, :count]
        stacks[donor, : heights[donor] - count] = stacks[donor, count : heights[donor]].copy()
        heights[block], heights[donor] = count, heights[donor] - count
        initial[block] = min(initial[donor], count)
        initial[donor] -= initial[block]
    return taken


def parametrized_minimum(
    cover: ParametrizedPositives,
    *,
    eps: float,
    upper: float = float("inf"),
    budget: float = float("inf"),
    boxes: float = float("inf"),
    progress: Callable[[int, float, float], None] | None = None,
    device: str = "cpu",
) -> Search:
    """Certified minimum of f over parametrized positives.

    Args:
        cover: The positives.
        eps: Gap between bound and found value at which the search ends.
        upper: A value of f that is not below the minimum, such as f of a positive that is known.
        budget: Seconds after which the search ends with what it has. Compiling kernels does not count.
        boxes: Limit: the number of boxes after which it ends with what it has, the same on every machine.
        progress: Called with boxes done, the fraction of the initial boxes that are done or begun, and the gap that is
            aimed at.
        device: Warp device.
    """
    started = working_seconds()
    cover = divided(cover, INITIAL, device)
    # Each initial box is bounded once: that tells how many there is time for, and finds low positives to begin with.
    survey = prove_target(cover, CLOSE_ALL, device=device)
    spent = working_seconds() - started  # 0 where all of it was compiling
    affordable = min(boxes, budget * survey.boxes / spent if spent > 0 else np.inf)
    initial = min(INITIAL_SHARE * affordable, MOST_INITIAL) if np.isfinite(affordable) else INITIAL
    descent = Descent(divided(cover, initial, device), device)  # no fewer boxes than there are by now
    best = min(upper, float(survey.values.min(initial=np.inf)))

    def done() -> int:
        return survey.boxes + descent.boxes

    def used() -> float:
        spent = working_seconds() - started
        return max(done() / boxes, spent / budget) if min(boxes, budget) > 0 else 1.0

    pace = Pace(eps, used())
    while descent.waiting:
        pace.update(used(), descent.begun, descent.boxes, descent.initial_count)
        target = best - pace.gap if used() < 1 else CLOSE_ALL
        best = min(best, descent.step(target, boxes - done()))
        pace.reach(best - descent.least)  # a closed box is not opened again, so no smaller gap can be proven
        if descent.stuck:
            pace.widen()
        if progress:
            progress(done(), descent.begun, pace.gap)
    # Survey and search each cover all positives, so both least bounds hold and the higher one counts. Neither can
    # exceed a value that was found.
    proven, spent = min(max(survey.least, descent.least), best), working_seconds() - started
    numbers = lowest(survey.points, survey.values, descent.points, descent.values)[0]
    needed = max(pace.whole * budget, spent) if pace.whole else spent
    return Search(proven, best, cover.coordinates(numbers), done(), spent, best - proven <= eps, needed, numbers)


def divided(cover: ParametrizedPositives, count: float, device: str) -> ParametrizedPositives:
    """The same positives in at least ``count`` boxes, if halving makes so many; halves without positives go."""
    lower, upper = cover.lower, cover.upper
    for _ in range(2 * MOST_INITIAL.bit_length()):  # halves without positives do not count
        if len(lower) >= count:
            break
        bounds = cover.bound(lower, upper, device)
        some = ~np.isposinf(bounds.lower)  # infinity is the bound of a box without positives
        boxes, axis, row = bounds.boxes[some], bounds.axis[some], np.arange(np.count_nonzero(some))
        (lower, upper), middle = (
            boxes.swapaxes(0, 1),
            cover.parametrization.middle(boxes[row, 0, axis], boxes[row, 1, axis]),
        )
        less, more = upper.copy(), lower.copy()
        less[row, axis] = more[row, axis] = middle
        lower, upper = np.concatenate([lower, more]), np.concatenate([less, upper])
    return replace(cover, lower=lower, upper=upper)
