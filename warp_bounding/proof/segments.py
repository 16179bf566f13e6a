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

from functools import cache
from typing import ClassVar
from weakref import WeakKeyDictionary

import numpy as np
import warp as wp

from warp_bounding.activations import constant, constants
from warp_bounding.bounders.bounder import DISTANCES, Bounder
from warp_bounding.bounders.cascade import Cascade, Local
from warp_bounding.bounders.distance import DistanceBounder, VolumeDistance
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.bounders.mlp_distance import MlpDistance
from warp_bounding.bounders.union import Union
from warp_bounding.errors import BounderError, QueryError
from warp_bounding.networks.bounds import NetworkShape, body, double_array, lanes_text
from warp_bounding.networks.parametrizations import SegmentParametrization
from warp_bounding.queries.distance import DistanceDomain
from warp_bounding.rounding import round_down
from warp_bounding.runtime.launch import BlockLaunch
from warp_bounding.runtime.native import named, native_text, unique_name
from warp_bounding.shapes.joints import Joints

__all__ = ["clear_segments"]

MOST_DEPTH = 30  # of a march: its steps are 2^30 at most
DEPTH = 8  # a piece is halved at most this often
# local units: more than a point of a piece may be off, where it is asked which part of a domain it lies in
AROUND = 2.0**-28
INSIDE = 1e-9  # of the domain's half-widths: segments are clipped this far outside the domain
PIECE = 2.0**-45  # of the largest coordinate of a segment: above what a dozen operations on an end of a piece round
MOST_PIECES = 64  # of a segment, by turns of joints; one that has more is not cleared
LARGEST_LOCAL = 2.0**20  # half-widths of the domain: a segment is bounded only if no coordinate of a or w is larger
EARLIER = 1.0 - 2.0**-48  # makes a time that was computed no later than it is
BLOCK = 128  # segments of a thread
ROUNDS = 16  # of several networks: how often each may go on where the others have stopped


def clear_segments(
    bounder: Bounder, starts: np.ndarray, ends: np.ndarray, *, depth: int = DEPTH, first: bool = False
) -> np.ndarray | tuple[np.ndarray, np.ndarray]:
    """Which segments are proven to meet the object nowhere, and how far each is proven to be clear.

    Args:
        bounder: A network (``mlp``, ``mlp-early``, with thresholds of parts or one) of points, several of them in a
            cascade or a union, a volume of points that has a distance (``DISTANCES``), or a distance bounder, proven or
            not; if it is proven, so is the answer. Of a shape that moves segments are of time and space.
        starts: ``(N, n)``, object space; taken as they are, float32 or float64. Of continuous joints they are not
            turned back: from 3 to 4 is another way than from 3 to 4 - 2 pi.
        ends: ``(N, n)``, object space.
        depth: How often a piece is halved at most, or the logarithm of the steps of a march; a larger depth clears more
            segments that pass close to the object.
        first: Also tell how far, which takes longer where segments are not clear.

    Returns:
        ``(N,)`` bool: True if no point of the closed segment lies in the object, of one that moves at the point's time.
        False says nothing; it is the answer for NaN, infinity, segments that are a million domains away, and those that
        go beyond a joint's limits. With ``first`` also ``(N,)`` float64, a share of the way: before it the segment is
        proven to be clear, and 1 where all of it is.

    Raises:
        BounderError: For another kind of bounder.
        QueryError: For arrays of another shape, or a negative depth.

    Example:
        >>> network = wb.fit(ball, method="mlp", hidden=(8,), steps=3, device="cpu")
        >>> starts = np.array([[9.0, 9.0, 9.0], [0.0, 0.0, 0.0]])
        >>> wb.proof.clear_segments(network, starts, np.array([[9.0, 9.0, 0.0], [1.0, 1.0, 1.0]]))
        array([ True, False])
    """
    if isinstance(bounder, Bounder):
        bounder.expect_local("clear_segments")
    far = _with_distance(bounder)
    if far is None and not (
        isinstance(bounder, Bounder)
        and _of_networks(bounder)
        and bounder.domain is bounder.domain.base
        and not (bounder.domain.time or bounder.domain.unbounded)
    ):
        raise BounderError(f"segments need a network or a volume of points at rest, or a distance, got {bounder!r}")
    starts, ends = _checked(bounder.ndim, starts, ends, depth)
    joints = getattr(bounder.domain, "joints", None)
    if joints is None:
        until = _until(bounder, far, starts, ends, depth, first)
    else:
        inside, owner, begin, end, low, high = _in_one_turn(joints, starts, ends)
        until, found = np.where(inside, np.inf, 0.0), _until(bounder, far, low, high, depth, first)
        np.minimum.at(until, owner, np.where(found < np.inf, (begin + found * (end - begin)) * EARLIER, np.inf))
    cleared = until == np.inf
    return (cleared, np.minimum(until, 1.0)) if first else cleared


def _in_one_turn(joints: Joints, starts: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, ...]:
    """Which segments ``(N,)`` lie within the limits, and of their pieces the segment, times, and ends, turned back."""
    period = np.array(joints.period)
    inside = joints.within(starts) & joints.within(ends)
    if not period.any():
        owner = np.flatnonzero(inside)
        return inside, owner, np.zeros(len(owner)), np.ones(len(owner)), starts[owner], ends[owner]
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
    return inside, owner, times[row, number], times[row, number + 1], low + by, high + by


def _until(
    bounder: Bounder, far: DistanceBounder | None, starts: np.ndarray, ends: np.ndarray, depth: int, first: bool
) -> np.ndarray:
    """Up to which share of each segment it is clear; infinity where all of it is. Of joints, within one turn."""
    if far is not None and not far.domain.time:
        joints, off = bounder.domain.joints, 0.0
        if joints is not None and any(joints.period):
            off = PIECE * max(map(abs, (*joints.lower, *joints.upper))) * np.sqrt(far.ndim) * (1 + INSIDE)
        with np.errstate(over="ignore", invalid="ignore"):
            maybe, time = (each.numpy() for each in far.segments(starts, ends, off, 2 ** min(depth, MOST_DEPTH)))
        return np.where(maybe == 0, np.inf, time)
    with np.errstate(over="ignore", invalid="ignore"):
        a = bounder.domain.to_local(starts)
        w = bounder.domain.to_local(ends) - a
        known = ((np.abs(a) <= LARGEST_LOCAL) & (np.abs(w) <= LARGEST_LOCAL)).all(axis=1)  # False for NaN
    if bounder.domain.time:  # beyond its range nothing is known
        within = [bounder.domain.lower[0], bounder.domain.upper[0]]
        known &= np.logical_and.reduce([(x[:, 0] >= within[0]) & (x[:, 0] <= within[1]) for x in (starts, ends)])
    if far is None and not first and len(starts) > BLOCK:  # where an end is not denied, no walk is needed
        for x in (starts, ends):
            known[known] = bounder.query(x[known].astype(np.float32)).numpy() == 0
    until, limit = np.where(known, np.inf, 0.0), bounder.domain.limit.astype(np.float64)
    rows = np.flatnonzero(known)
    # a distance's domain has no delta
    begin, end, inside = _within(a[rows], w[rows], limit if far is None else limit + 2 * AROUND)
    rows = rows[inside]
    until[rows] = _walked(bounder, a[rows], w[rows], begin[inside], end[inside], min(depth, MOST_DEPTH), first)
    return until


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


def _walked(
    bounder: Bounder, a: np.ndarray, w: np.ndarray, begin: np.ndarray, end: np.ndarray, depth: int, first: bool
) -> np.ndarray:
    """Up to which t from ``begin`` to ``end`` each segment ``a + t w`` is clear; infinity where all of it is."""
    if isinstance(bounder, Union):  # each of them must clear it
        until = np.full(len(a), np.inf)
        for part in bounder.members:
            rows = np.flatnonzero(until == np.inf) if not first else np.arange(len(a))
            found = _walked(part, a[rows], w[rows], begin[rows], end[rows], depth, first)
            until[rows] = np.minimum(until[rows], found)
        return until
    if isinstance(bounder, Local | MlpDistance) or len(bounder.parts) == 1:
        return _Walk.of(bounder)(bounder, a, w, begin, end, depth, first)
    until, rows = begin.copy(), np.arange(len(a))
    for _ in range(ROUNDS):  # each of them goes on where the one before has stopped
        before = until.copy()
        for part in bounder.parts:
            until[rows] = _walked(part, a[rows], w[rows], until[rows], end[rows], depth, True)
            rows = rows[until[rows] < np.inf]
        rows = rows[until[rows] > before[rows]]
    return until


class _Walk:
    """One network along segments: the native walk (``native/segments.h``) with its numbers.

    Of points it bounds -f, which must lie above -(threshold + E); of thresholds of parts that of the parts counts. Of a
    distance to a shape that moves it bounds F, which must lie above 0 all along. It is not enough that no face touches
    the point on its way, which a march would tell: a hole may close around it.
    """

    _known: ClassVar[WeakKeyDictionary] = WeakKeyDictionary()

    @classmethod
    def of(cls, bounder: Bounder) -> "_Walk":
        """That of a bounder, kept as long as it is."""
        if bounder not in cls._known:
            cls._known[bounder] = cls(bounder)
        return cls._known[bounder]

    def __init__(self, bounder: Bounder):
        member = bounder.member if isinstance(bounder, Local) else bounder
        network, moving, self.size = member.network, isinstance(bounder, MlpDistance), member.ndim
        self.kernel = _kernel(network.kernel_shape(SegmentParametrization(member.ndim)))
        weights = network.packed.copy()
        if not moving:  # the output layer's, so that -f is bounded
            weights[-1 - network.output.weight.shape[1] :] *= -1.0
        limit = member.domain.limit.astype(np.float64) + (4 * AROUND if moving else 0.0)
        lattice = getattr(bounder, "lattice", None)
        edges = [] if lattice is None else lattice.edges
        values = np.zeros(1) if lattice is None else (bounder.relief if moving else bounder.thresholds)
        self.edges = sum(map(len, edges))
        counts = np.ones(member.ndim, np.int32) if lattice is None else np.array(lattice.shape, np.int32)
        held = [weights, network.padding_for(limit * (1 + 2 * INSIDE)), np.concatenate([*edges, values])]
        self._held = [np.ascontiguousarray(each, dtype=np.float64) for each in held]
        self.numbers = [double_array(each, bounder.device) for each in self._held]
        self.numbers.append(wp.array(counts, dtype=wp.int32, device=bounder.device))
        self._alone: dict[tuple, tuple[BlockLaunch, np.ndarray, np.ndarray]] = {}  # of one segment, on a CPU

    def __call__(self, bounder: Bounder, a, w, begin, end, depth: int, first: bool) -> np.ndarray:
        """See ``_walked``."""
        if isinstance(bounder, MlpDistance):  # for what a point of a piece may be off
            base = -float(bounder.threshold) + bounder.steepness * AROUND
        else:
            base = np.nextafter(-(float(bounder.threshold) + bounder.rounding_bound()), np.inf)
        rows = np.concatenate([a[:, : self.size], w[:, : self.size], begin[:, None], end[:, None]], axis=1)
        told = depth, int(not first), float(base)
        if len(a) == 1 and bounder.device.is_cpu:  # a planner asks about one after another
            if told not in self._alone:
                made = self._launch(bounder, wp.array(rows.ravel(), dtype=wp.float64, device=bounder.device), 1, told)
                self._alone[told] = made[0], *(each.numpy() for each in made[1:])
            launch, segment, until = self._alone[told]
            segment[:] = rows.reshape(segment.shape)
            launch.launch()
            return until.copy()
        launch, _, until = self._launch(bounder, double_array(rows, bounder.device), len(a), told)
        launch.launch_once()
        return until.numpy()

    def _launch(self, bounder: Bounder, segments: wp.array, count: int, told: tuple) -> tuple:
        """The launch for these segments, and what it reads and writes."""
        until = wp.empty(count, dtype=wp.float64, device=bounder.device)
        inputs = [segments, count, 0, *told, self.edges, *self.numbers]
        options = {"first_index": 2, "block": BLOCK}
        return BlockLaunch(self.kernel, count, inputs, [until], bounder.device, **options), segments, until


@cache
def _kernel(shape: NetworkShape) -> wp.Kernel:
    names = "const double* w = weights.data; const double* padding = paddings.data;\n"
    names += (
        constants(K=shape.ndim, BOX=shape.parametrization.size, BLOCK=BLOCK)
        + f" constexpr double AROUND = {constant(AROUND)};"
    )
    names += " auto absolute_of = [](double x) { return x < 0.0 ? -x : x; };"
    walk = native_text("segments.h").WALK.replace("BODY", body(shape))
    cpu, cuda = lanes_text(shape, names)
    ends = (
        "const int BEGIN = block * BLOCK, END = BEGIN + BLOCK < count ? BEGIN + BLOCK : count;",
        "const int BEGIN = block, END = block + 1;",
    )
    text = f"#if !defined(__CUDA_ARCH__)\n{cpu}{ends[0]}\n{walk}\n#else\n{cuda}{ends[1]}\n{walk}\n#endif\n#undef LANE\n"

    @named(unique_name(shape, "walk")).block_kernel(text)
    def walk_all(
        segments: wp.array(dtype=wp.float64),
        count: int,
        block: int,
        depth: int,
        quick: int,
        base: wp.float64,
        edges: int,
        weights: wp.array(dtype=wp.float64),
        paddings: wp.array(dtype=wp.float64),
        lattice: wp.array(dtype=wp.float64),
        counts: wp.array(dtype=wp.int32),
        until: wp.array(dtype=wp.float64),
    ): ...

    return walk_all


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
