"""Whole segments against a network of points: bounds of f along them, instead of samples.

A network answers *no* at a point only where f is under its threshold, and at points of the object f is at least
threshold + E (``prove``). So where f is proven to be under threshold + E all along a segment, no point of it lies in
the object. An upper bound of f is a lower bound of -f, by the same relaxations as in every proof, over boxes of one
number: the parameter t along the segment.

All of this is computed in float64. The segment that is bounded is ``a + t w`` of the computed a and w, with t between
the computed ends. Where a and w are within ``LARGEST_LOCAL``, a point of the true segment is off by less than 2^-29,
four products and sums of 2^-52 each; and proofs hold for the object dilated by delta, the float32 rounding of the same
map, which is at least a hundred times as much. Clipping errs outwards by ``INSIDE``, which is more than the rounding of
t times w. Segments that lie farther out are not cleared.

Of joints, a segment is one of configurations that are not turned back: it may turn a joint many times. It is cut where
a continuous joint has made half a turn more, and each piece is asked about in the turn around 0, a little wider than
one (``joints.WIDER``), so that it does not matter what the place of a cut rounds. What the piece itself is off by,
``PIECE`` of the largest coordinate, counts as above: far less than delta. A segment that goes beyond a limit is not
cleared.
"""

import numpy as np

from warp_bounding.bounders.batch import Framed
from warp_bounding.bounders.bounder import DISTANCES, Bounder
from warp_bounding.bounders.cascade import Cascade
from warp_bounding.bounders.distance import DistanceBounder, VolumeDistance
from warp_bounding.bounders.mlp import Local, Mlp
from warp_bounding.bounders.mlp_distance import MlpDistance
from warp_bounding.bounders.union import Union
from warp_bounding.errors import BounderError, QueryError
from warp_bounding.networks.bounds import bound_boxes
from warp_bounding.networks.parametrizations import SegmentParametrization
from warp_bounding.proof.search import halve
from warp_bounding.queries.distance import DistanceDomain
from warp_bounding.rounding import round_down
from warp_bounding.shapes.joints import Joints

__all__ = ["clear_segments"]

MOST_DEPTH = 30  # of a march: its steps are 2^30 at most
DEPTH = 8  # a piece is halved at most this often
AROUND = (
    2.0**-28
)  # local units: more than a point of a piece may be off, where it is asked which part of a domain it lies in
INSIDE = 1e-9  # of the domain's half-widths: segments are clipped this far outside the domain
PIECE = 2.0**-45  # of the largest coordinate of a segment: above what a dozen operations on an end of a piece round
MOST_PIECES = 64  # of a segment, by turns of joints; one that has more is not cleared
LARGEST_LOCAL = 2.0**20  # half-widths of the domain: a segment is bounded only if no coordinate of a or w is larger


def clear_segments(bounder: Bounder, starts: np.ndarray, ends: np.ndarray, *, depth: int = DEPTH) -> np.ndarray:
    """Which segments are proven to meet the object nowhere.

    Args:
        bounder: A network (``mlp``, ``mlp-early``, with thresholds of parts or one) of points, several of them in a
            cascade or a union, a volume of points that has a distance (``DISTANCES``), or a distance bounder, proven or
            not; if it is proven, so is the answer. Of a shape that moves segments are of time and space.
        starts: ``(N, n)``, object space; taken as they are, float32 or float64. Of continuous joints they are not
            turned back: from 3 to 4 is another way than from 3 to 4 - 2 pi.
        ends: ``(N, n)``, object space.
        depth: How often a piece is halved at most, or the logarithm of the steps of a march; a larger depth clears more
            segments that pass close to the object.

    Returns:
        ``(N,)`` bool: True if no point of the closed segment lies in the object, of one that moves at the point's time.
        False says nothing; it is the answer for NaN, infinity, segments that are a million domains away, and those that
        go beyond a joint's limits.

    Raises:
        BounderError: For another kind of bounder.
        QueryError: For arrays of another shape, or a negative depth.

    Example:
        >>> network = wb.fit(ball, method="mlp", hidden=(8,), steps=3, device="cpu")
        >>> starts = np.array([[9.0, 9.0, 9.0], [0.0, 0.0, 0.0]])
        >>> wb.proof.clear_segments(network, starts, np.array([[9.0, 9.0, 0.0], [1.0, 1.0, 1.0]]))
        array([ True, False])
    """
    if isinstance(bounder, Framed):
        bounder.expect_local("clear_segments")
    joints = getattr(getattr(bounder, "domain", None), "joints", None)
    if joints is not None:
        starts, ends = _checked(bounder.ndim, starts, ends, depth)
        cleared, owner, *pieces = _in_one_turn(joints, starts, ends)
        if len(owner):
            cleared[owner[~_cleared(bounder, *pieces, depth)]] = False
        return cleared
    return _cleared(bounder, starts, ends, depth)


def _in_one_turn(joints: Joints, starts: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, ...]:
    """Which segments ``(N,)`` lie within the limits, and their pieces: segment numbers, and ends, turned back."""
    period = np.array(joints.period)
    inside = joints.within(starts) & joints.within(ends)
    with np.errstate(divide="ignore", invalid="ignore"):
        seams = [
            np.where(period > 0, np.floor(end / period + 0.5), 0.0) for end in (starts, ends)
        ]  # how many lie before an end
        first, last = np.minimum(*seams), np.maximum(*seams)
        inside &= (last - first).sum(axis=1) < MOST_PIECES
        cuts = [np.zeros((len(starts), 1)), np.ones((len(starts), 1))]
        for axis in np.flatnonzero(period):
            for number in range(int((last - first)[inside, axis].max(initial=0))):
                at = (first[:, axis] + number + 0.5) * period[axis]
                share = (at - starts[:, axis]) / (ends - starts)[:, axis]
                cuts.append(np.where(first[:, axis] + number < last[:, axis], share, 0.0)[:, None])
    times = np.sort(np.clip(np.concatenate(cuts, axis=1)[inside], 0.0, 1.0), axis=1)
    row, number = np.nonzero(times[:, 1:] > times[:, :-1])
    owner = np.flatnonzero(inside)[row]
    a, b = starts[owner], ends[owner]
    low, high = (a + times[row, number + side][:, None] * (b - a) for side in (0, 1))
    high = np.where((times[row, number + 1] == 1)[:, None], b, high)
    middle = (low + high) / 2
    by = joints.turned_back(middle) - middle
    return inside, owner, low + by, high + by


def _cleared(bounder, starts: np.ndarray, ends: np.ndarray, depth: int) -> np.ndarray:
    """``clear_segments`` of what lies in one turn."""
    far = _with_distance(bounder)
    if far is not None and not far.domain.time:
        starts, ends = _checked(far.ndim, starts, ends, depth)
        joints, off = bounder.domain.joints, 0.0
        if joints is not None and any(joints.period):
            off = PIECE * max(map(abs, (*joints.lower, *joints.upper))) * np.sqrt(far.ndim) * (1 + INSIDE)
        with np.errstate(over="ignore", invalid="ignore"):
            return far.segments(starts, ends, off, 2 ** min(depth, MOST_DEPTH))[0].numpy() == 0
    if far is None and (
        not isinstance(bounder, Bounder)
        or bounder.domain is not bounder.domain.base
        or not _of_networks(bounder)
        or bounder.domain.time
        or bounder.domain.unbounded
    ):
        raise BounderError(f"segments need a network or a volume of points at rest, or a distance, got {bounder!r}")
    starts, ends = _checked(bounder.ndim, starts, ends, depth)
    with np.errstate(over="ignore", invalid="ignore"):
        a = bounder.domain.to_local(starts)
        w = bounder.domain.to_local(ends) - a
        known = ((np.abs(a) <= LARGEST_LOCAL) & (np.abs(w) <= LARGEST_LOCAL)).all(axis=1)  # False for NaN
    if bounder.domain.time:  # beyond its range nothing is known
        within = [bounder.domain.lower[0], bounder.domain.upper[0]]
        known &= np.logical_and.reduce([(x[:, 0] >= within[0]) & (x[:, 0] <= within[1]) for x in (starts, ends)])
    segments = np.flatnonzero(known)
    a, w = a[segments], w[segments]
    limit = bounder.domain.limit.astype(np.float64)
    first, last, inside = _within(a, w, limit if far is None else limit + 2 * AROUND)  # a distance's has no delta
    a, w, owner = a[inside], w[inside], segments[inside]
    low = np.concatenate([a, w, first[inside, None]], axis=1)
    high = np.concatenate([a, w, last[inside, None]], axis=1)
    whole = _queried(bounder, bounder.ndim)
    along = 2 * bounder.ndim
    failed = ~known
    for level in range(depth + 1):
        cleared = whole.clears(low, high)
        low, high, owner = low[~cleared], high[~cleared], owner[~cleared]
        middle = (low[:, along:] + high[:, along:]) / 2
        points = low[:, : bounder.ndim] + middle * low[:, bounder.ndim : along]
        failed[owner[whole.lets_through(points)]] = True  # no half that holds such a point will be cleared
        left = ~failed[owner]
        low, high, owner = low[left], high[left], owner[left]
        if level == depth or not len(owner):
            break
        low, high = halve(low, high, np.full(len(low), along))
        owner = np.tile(owner, 2)
    failed[owner] = True  # their last pieces were not cleared
    return ~failed


def _checked(ndim: int, starts: np.ndarray, ends: np.ndarray, depth: int) -> tuple[np.ndarray, np.ndarray]:
    starts, ends = np.asarray(starts, dtype=np.float64), np.asarray(ends, dtype=np.float64)
    if starts.shape != ends.shape or starts.ndim != 2 or starts.shape[1] != ndim:
        raise QueryError(f"starts and ends must both be (N, {ndim}), got {starts.shape} and {ends.shape}")
    if depth < 0:
        raise QueryError(f"depth must be at least 0, got {depth}")
    return starts, ends


def _with_distance(bounder) -> DistanceBounder | None:
    """A distance bounder: the one that is given, or that of a volume of points at rest; ``None`` for others."""
    if isinstance(bounder, DistanceBounder):
        return bounder
    cls = DISTANCES.get(getattr(bounder, "method", None))
    if cls is None or not issubclass(cls, VolumeDistance) or type(bounder) is not cls.bounds:
        return None
    domain = bounder.domain
    if domain is not domain.base or domain.time or domain.unbounded:
        return None
    far = cls.around(bounder, DistanceDomain.around(domain.lower, domain.upper), {}, str(bounder.device))
    return far.freeze(min(float(round_down(np.nextafter(-far.rounding_bound(), -np.inf))), 0.0), None)


def _of_networks(bounder: Bounder) -> bool:
    """Whether a bounder is a network, or consists of some, all asked about coordinates of the whole."""
    if isinstance(bounder, Cascade | Union):
        return all(map(_of_networks, bounder.members))
    return isinstance(bounder, Mlp | Local)


def _queried(bounder: Bounder, ndim: int) -> "_Part | _Parts":
    """What is asked about pieces."""
    if isinstance(bounder, Union):
        return _Parts([_queried(part, ndim) for part in bounder.members], False)
    if isinstance(bounder, MlpDistance):
        return _MovingDistance(bounder, ndim)
    if isinstance(bounder, Local):
        return _LocalPart(bounder, ndim)
    if len(bounder.parts) > 1:
        return _Parts([_queried(part, ndim) for part in bounder.parts], True)
    return _Part(bounder.parts[0], ndim)


class _Parts:
    """Several: a piece is cleared where one clears it, if all must say *maybe*, else where all do."""

    def __init__(self, parts: list, all_must: bool):
        self.parts, self.all_must = parts, all_must

    def clears(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        return self._reported(
            [lambda rows, part=part: part.clears(low[rows], high[rows]) for part in self.parts], len(low), self.all_must
        )

    def lets_through(self, points: np.ndarray) -> np.ndarray:
        asked = [lambda rows, part=part: part.lets_through(points[rows]) for part in self.parts]
        return self._reported(asked, len(points), not self.all_must)

    @staticmethod
    def _reported(asked: list, count: int, any_will_do: bool) -> np.ndarray:
        """``(count,)`` bool; each is asked only about the rows that those before it have left open."""
        found = np.full(count, not any_will_do)
        for ask in asked:
            rows = np.flatnonzero(found != any_will_do)
            found[rows] = ask(rows)
        return found


class _Part:
    """One network: it clears the pieces on which its f is under its threshold.

    Args:
        part: Of points, of the first coordinates of the whole.
        ndim: How many coordinates the whole has.
    """

    def __init__(self, part: Mlp, ndim: int):
        self._bound(part, ndim)
        self.target = np.nextafter(-(float(part.threshold) + part.rounding_bound()), np.inf)

    def _bound(self, part: Mlp | MlpDistance, ndim: int, sign: float = 1.0) -> None:
        """Keep what bounds of -f along a piece need, or of f for the sign -1."""
        network, own = part.network, np.arange(part.ndim)
        self.shape, self.part = network.kernel_shape(SegmentParametrization(part.ndim)), part
        self.columns = [*own, *(own + ndim), 2 * ndim]
        self.weights = network.packed.copy()
        self.weights[-1 - network.output.weight.shape[1] :] *= -sign  # the output layer's, so that -f is bounded
        limit = part.domain.limit.astype(np.float64) + (4 * AROUND if sign < 0 else 0.0)
        self.padding = network.padding_for(limit * (1 + 2 * INSIDE))

    def lowest(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Lower bounds ``(N,)`` of -f on pieces."""
        corners = (np.ascontiguousarray(each[:, self.columns]) for each in (low, high))
        return bound_boxes(self.shape, self.weights, self.padding, *corners).lower

    def clears(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """``(N,)`` bool: pieces on which f is proven to stay under threshold + E."""
        return self.lowest(low, high) > self.target

    def lets_through(self, points: np.ndarray) -> np.ndarray:
        """``(N,)`` bool: points ``v`` at which f is not under threshold + E."""
        return ~(-self.part.reference(points[:, : self.part.ndim]) > self.target)


class _LocalPart(_Part):
    """A network at thresholds of the domain's parts: the least threshold of its parts clears a piece."""

    def __init__(self, part: Local, ndim: int):
        self._bound(part.member, ndim)
        self.whole = part
        self.target = np.nextafter(-(float(part.threshold) + part.rounding_bound()), np.inf)

    def clears(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        n = self.whole.ndim
        at, way, times = np.split(low[:, self.columns], [n, 2 * n], axis=1)
        ends = [at + time * way for time in (times, high[:, self.columns[-1:]])]
        least, _, _ = self.whole.thresholds_in(np.minimum(*ends) - AROUND, np.maximum(*ends) + AROUND)
        return self.lowest(low, high) > np.nextafter(self.target - least, np.inf)

    def lets_through(self, points: np.ndarray) -> np.ndarray:
        return ~(-self.whole.reference(points[:, : self.whole.ndim]) > self.target)


class _MovingDistance(_Part):
    """A network's distance to a shape that moves: pieces are cleared where it is proven to be above 0 all along.

    It is not enough that no face touches the point on its way, which a march would tell: a hole may close around it.
    """

    def __init__(self, part: MlpDistance, ndim: int):
        self._bound(part, ndim, -1.0)
        self.target = -float(part.threshold) + part.steepness * AROUND  # for what a point of a piece may be off

    def lowest(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        found = super().lowest(low, high)
        if self.part.lattice is None:
            return found
        n = self.part.ndim
        at, way, times = np.split(low[:, self.columns], [n, 2 * n], axis=1)
        ends = [at + time * way for time in (times, high[:, self.columns[-1:]])]
        corners = np.minimum(*ends) - AROUND, np.maximum(*ends) + AROUND
        return np.nextafter(found + self.part.lattice.extremes(self.part.relief, *corners)[0], -np.inf)

    def lets_through(self, points: np.ndarray) -> np.ndarray:
        return ~(self.part.reference(points) > self.target)


def _within(a: np.ndarray, w: np.ndarray, limit: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The least and the largest t in [0, 1] at which ``a + t w`` may be in the domain, and whether there is any."""
    reach = limit * (1 + INSIDE)
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.sort(np.stack([(-reach - a) / w, (reach - a) / w]), axis=0)
    rests = np.abs(a) <= reach
    first = np.where(w != 0, ends[0], np.where(rests, -np.inf, np.inf)).max(axis=1).clip(0.0)
    last = np.where(w != 0, ends[1], np.where(rests, np.inf, -np.inf)).min(axis=1).clip(max=1.0)
    inside = first <= last + INSIDE
    return first.clip(0.0, 1.0), np.maximum(last, first).clip(0.0, 1.0), inside
