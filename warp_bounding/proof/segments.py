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
"""

import numpy as np

from warp_bounding.arithmetic import round_down
from warp_bounding.bounders.base import Bounder
from warp_bounding.bounders.distances.base import DistanceBounder
from warp_bounding.bounders.distances.registry import DISTANCES
from warp_bounding.bounders.distances.volume import VolumeDistance
from warp_bounding.bounders.local.local import Local
from warp_bounding.bounders.neural.mlp import Mlp
from warp_bounding.coordinates.distance_domain import DistanceDomain
from warp_bounding.errors import BounderError, QueryError
from warp_bounding.networks.bound_kernel import bound_boxes
from warp_bounding.networks.charts.segment import SegmentChart
from warp_bounding.proof.search.best_first import halve

__all__ = ["clear_segments"]

MOST_DEPTH = 30  # of a march: its steps are 2^30 at most
LARGEST_MOVE = 1e37  # object units: by which the ends of a segment are rounded; others are not cleared
DEPTH = 8  # a piece is halved at most this often
AROUND = (
    2.0**-28
)  # local units: more than a point of a piece may be off, where it is asked which part of a domain it lies in
INSIDE = 1e-9  # of the domain's half-widths: segments are clipped this far outside the domain
LARGEST_LOCAL = 2.0**20  # half-widths of the domain: a segment is bounded only if no coordinate of a or w is larger


def clear_segments(bounder: Bounder, starts: np.ndarray, ends: np.ndarray, *, depth: int = DEPTH) -> np.ndarray:
    """Which segments are proven to meet the object nowhere.

    Args:
        bounder: A network (``mlp``, ``mlp-early``, with thresholds of parts or one) of points, a volume of points that has a distance (``DISTANCES``), or a
            distance bounder, proven or not; if it is proven, so is the answer.
        starts: ``(N, n)``, object space; taken as they are, float32 or float64.
        ends: ``(N, n)``, object space.
        depth: How often a piece is halved at most, or the logarithm of the steps of a march; a larger depth clears more segments
            that pass close to the object.

    Returns:
        ``(N,)`` bool: True if no point of the closed segment lies in the object. False says nothing; it is the answer
        for NaN, infinity and segments that are a million domains away.

    Raises:
        BounderError: For another kind of bounder.
        QueryError: For arrays of another shape, or a negative depth.

    Example:
        >>> network = wb.fit(ball, method="mlp", hidden=(8,), steps=3, device="cpu")
        >>> wb.clear_segments(network, np.array([[9.0, 9.0, 9.0], [0.0, 0.0, 0.0]]), np.array([[9.0, 9.0, 0.0], [1.0, 1.0, 1.0]]))
        array([ True, False])
    """
    if (far := _with_distance(bounder)) is not None:
        starts, ends = _checked(far.ndim, starts, ends, depth)
        return _marched(far, starts, ends, 2 ** min(depth, MOST_DEPTH))
    if (
        not isinstance(bounder, Bounder)
        or bounder.domain is not bounder.domain.base
        or not isinstance(bounder, (Mlp, Local))
        or bounder.domain.time
        or bounder.domain.unbounded
    ):
        raise BounderError(f"segments need a network or a volume of points at rest, or a distance, got {bounder!r}")
    starts, ends = _checked(bounder.ndim, starts, ends, depth)
    with np.errstate(over="ignore", invalid="ignore"):
        a = bounder.domain.to_local(starts)
        w = bounder.domain.to_local(ends) - a
        known = ((np.abs(a) <= LARGEST_LOCAL) & (np.abs(w) <= LARGEST_LOCAL)).all(axis=1)  # False for NaN
    segments = np.flatnonzero(known)
    a, w = a[segments], w[segments]
    first, last, inside = _within(a, w, bounder.domain.limit.astype(np.float64))
    a, w, owner = a[inside], w[inside], segments[inside]
    low = np.concatenate([a, w, first[inside, None]], axis=1)
    high = np.concatenate([a, w, last[inside, None]], axis=1)
    parts = [_LocalPart(part) if isinstance(part, Local) else _Part(part) for part in bounder.parts]
    along = 2 * bounder.ndim
    failed = ~known
    for level in range(depth + 1):
        cleared = np.zeros(len(low), dtype=bool)
        for part in parts:
            cleared[~cleared] = part.clears(low[~cleared], high[~cleared])
        low, high, owner = low[~cleared], high[~cleared], owner[~cleared]
        middle = (low[:, along:] + high[:, along:]) / 2
        points = low[:, : bounder.ndim] + middle * low[:, bounder.ndim : along]
        hopeless = np.ones(len(low), dtype=bool)
        for part in parts:  # no part denies this point, so no half that holds it will be cleared
            hopeless[hopeless] = part.lets_through(points[hopeless])
        failed[owner[hopeless]] = True
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


def _marched(bounder: DistanceBounder, starts: np.ndarray, ends: np.ndarray, steps: int) -> np.ndarray:
    """``clear_segments`` of a distance."""
    with np.errstate(over="ignore", invalid="ignore"):
        rounded = [part.astype(np.float32) for part in (starts, ends)]
        moved = [np.linalg.norm(a - b, axis=1) for a, b in zip((starts, ends), rounded, strict=True)]
        radius = np.maximum(*moved) * (1 + INSIDE)
    known = np.isfinite(radius) & (radius < LARGEST_MOVE)
    radius = np.where(known, radius, 0.0)
    return known & (bounder.segments(*rounded, radius, steps)[0].numpy() == 0)


class _Part:
    """One network of a conjunction: it clears the pieces on which its f is under its threshold."""

    def __init__(self, part: Mlp):
        self._bound(part)
        self.target = np.nextafter(-(float(part.threshold) + part.rounding_bound()), np.inf)

    def _bound(self, part: Mlp) -> None:
        """Keep what bounds of -f along a piece need."""
        network = part.network
        self.shape, self.part = network.kernel_shape(SegmentChart(part.ndim)), part
        self.weights = network.packed.copy()
        self.weights[-1 - network.output.weight.shape[1] :] *= -1.0  # the output layer's, so that -f is bounded
        self.padding = network.padding_for(part.domain.limit.astype(np.float64) * (1 + 2 * INSIDE))

    def clears(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """``(N,)`` bool: pieces on which f is proven to stay under threshold + E."""
        return bound_boxes(self.shape, self.weights, self.padding, low, high).lower > self.target

    def lets_through(self, points: np.ndarray) -> np.ndarray:
        """``(N,)`` bool: points ``v`` at which f is not under threshold + E."""
        return ~(-self.part.reference(points) > self.target)


class _LocalPart(_Part):
    """A network at thresholds of the parts of its domain: a piece is cleared by the least threshold of those that it meets."""

    def __init__(self, part: Local):
        self._bound(part.member)
        self.whole = part
        self.target = np.nextafter(-(float(part.threshold) + part.rounding_bound()), np.inf)

    def clears(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        n = self.whole.ndim
        ends = [low[:, :n] + side[:, 2 * n :] * low[:, n : 2 * n] for side in (low, high)]
        least, _, _ = self.whole.thresholds_in(np.minimum(*ends) - AROUND, np.maximum(*ends) + AROUND)
        lower = bound_boxes(self.shape, self.weights, self.padding, low, high).lower
        return lower > np.nextafter(self.target - least, np.inf)

    def lets_through(self, points: np.ndarray) -> np.ndarray:
        return ~(-self.whole.reference(points) > self.target)


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
