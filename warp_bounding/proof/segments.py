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

from functools import cache, partial
from typing import ClassVar
from weakref import WeakKeyDictionary

import numpy as np
import warp as wp

from warp_bounding.bounders.bounder import DISTANCES, Bounder
from warp_bounding.bounders.cascade import Cascade
from warp_bounding.bounders.distance import DistanceBounder, VolumeDistance
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.bounders.mlp_distance import MlpDistance
from warp_bounding.errors import BounderError, QueryError
from warp_bounding.networks.bounds import NetworkShape, Parametrization, body, double_array, lanes_text
from warp_bounding.queries.distance import DistanceDomain
from warp_bounding.rounding import round_down
from warp_bounding.runtime.launch import BlockLaunch
from warp_bounding.runtime.native import constant, constants, fill, named, native_text, unique_name
from warp_bounding.shapes.joints import Joints

__all__ = ["Segments", "clear_segments"]

MOST_DEPTH = 30  # of a march: its steps are 2^30 at most
DEPTH = 8  # a piece is halved at most this often
# local units: more than a point of a piece may be off
AROUND = 2.0**-28
INSIDE = 1e-9  # of the domain's half-widths: segments are clipped this far outside the domain
PIECE = 2.0**-45  # of the largest coordinate of a segment: above what a dozen operations on an end of a piece round
MOST_PIECES = 64  # of a segment, by turns of joints; one that has more is not cleared
LARGEST_LOCAL = 2.0**20  # half-widths of the domain: a segment is bounded only if no coordinate of a or w is larger
EARLIER = 1.0 - 2.0**-48  # makes a time that was computed no later than it is
BLOCK = 64  # segments of a thread
MOST_KEPT = 8  # launches, each for another number of segments
SHARED = 8  # where there are fewer segments, all lanes share each of them
ROUNDS = 16  # of several networks: how often each may go on where the others have stopped


def clear_segments(
    bounder: Bounder, starts: np.ndarray, ends: np.ndarray, *, depth: int = DEPTH, first: bool = False
) -> np.ndarray | tuple[np.ndarray, np.ndarray]:
    """Which segments are proven to meet the object nowhere, and how far each is proven to be clear.

    Args:
        bounder: A network of points (``mlp``), several of them in a cascade, a volume of points that has a distance
            (``DISTANCES``), or a distance bounder, proven or not; if it is proven, so is the answer. Of a
            shape that moves segments are of time and space.
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
    cleared, until = Segments(bounder, depth=depth, first=first)(starts, ends)
    return (cleared, until) if first else cleared


class Segments:
    """Segments asked about again and again: ``clear_segments`` with memory and launches that are made once.

    A planner that asks about one edge after another keeps one of these; of several threads each needs its own. It is
    about the bounder as it is now: after another threshold is set, make another.

    Args:
        bounder: As ``clear_segments`` takes it.
        depth: As ``clear_segments`` takes it.
        first: Whether a call tells how far a segment is clear; without it that may be too short.

    Raises:
        BounderError: As in ``clear_segments``.
        QueryError: For a negative depth.

    Example:
        >>> network = wb.fit(ball, method="mlp", hidden=(8,), steps=3, device="cpu")
        >>> edge = wb.proof.Segments(network)
        >>> cleared, until = edge([[9.0, 9.0, 9.0]], [[9.0, 9.0, 0.0]])
        >>> bool(cleared[0]), float(until[0])
        (True, 1.0)
    """

    def __init__(self, bounder: Bounder, *, depth: int = DEPTH, first: bool = True):
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
        if depth < 0:
            raise QueryError(f"depth must be at least 0, got {depth}")
        self._bounder, self._joints = bounder, getattr(bounder.domain, "joints", None)
        self._turns = self._joints is not None and any(self._joints.period)
        marched, self._made = far is not None and not far.domain.time, {}
        self._make = partial(_March, far, self._joints) if marched else partial(_walks, bounder)
        self._options = min(depth, MOST_DEPTH), first
        self._asked = 0 if far is not None else 1 if first else 2  # ends of a segment

    def __call__(self, starts: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which segments are clear, and how far.

        Args:
            starts: ``(N, n)``, as ``clear_segments`` takes them.
            ends: ``(N, n)``.

        Returns:
            ``(N,)`` bool and ``(N,)`` float64, as of ``clear_segments``.

        Raises:
            QueryError: For arrays of another shape.
        """
        starts, ends = np.asarray(starts, dtype=np.float64), np.asarray(ends, dtype=np.float64)
        ndim = self._bounder.ndim
        if starts.shape != ends.shape or starts.ndim != 2 or starts.shape[1] != ndim:
            raise QueryError(f"starts and ends must both be (N, {ndim}), got {starts.shape} and {ends.shape}")
        if self._asked and len(starts) > BLOCK:  # where one of them is not denied, no walk is needed
            with np.errstate(over="ignore", invalid="ignore"):
                maybe = [self._bounder.query(x.astype(np.float32)).numpy() for x in (starts, ends)[: self._asked]]
            rows, until = np.flatnonzero(~np.any(maybe, axis=0)), np.zeros(len(starts))
            until[rows] = self._in_turns(starts[rows], ends[rows])
        else:
            until = self._in_turns(starts, ends)
        return until == np.inf, np.minimum(until, 1.0)

    def _in_turns(self, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """Up to which share each segment is clear, infinity where all of it is."""
        if not self._turns:
            return self._until(starts, ends)
        period = np.array(self._joints.period)
        with np.errstate(invalid="ignore"):
            turns = [np.floor(x / np.where(period > 0, period, np.inf) + 0.5) for x in (starts, ends)]
            if (turns[0] == turns[1]).all():  # no joint passes half a turn
                inside = self._joints.within(starts) & self._joints.within(ends)
                return np.where(inside, self._until(*(x - turns[0] * period for x in (starts, ends))), 0.0)
        inside, owner, begin, end, low, high = _in_one_turn(self._joints, starts, ends, turns)
        until, found = np.where(inside, np.inf, 0.0), self._until(low, high)
        np.minimum.at(until, owner, np.where(found < np.inf, (begin + found * (end - begin)) * EARLIER, np.inf))
        return until

    def _until(self, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """The same of segments within one turn of each joint."""
        if (made := self._made.get(len(starts))) is None:
            if len(self._made) >= MOST_KEPT:
                self._made.clear()
            made = self._made[len(starts)] = self._make(len(starts), *self._options), np.zeros(len(starts))
        return made[0](starts, ends, made[1])


def _in_one_turn(joints: Joints, starts: np.ndarray, ends: np.ndarray, turns: list) -> tuple[np.ndarray, ...]:
    """Which segments ``(N,)`` lie within the limits, and of their pieces the segment, times, and ends, turned back.

    ``turns`` are the numbers of the turns in which the ends lie.
    """
    period = np.array(joints.period)
    inside = joints.within(starts) & joints.within(ends)
    with np.errstate(divide="ignore", invalid="ignore"):
        first, last = np.minimum(*turns), np.maximum(*turns)
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
    far = cls.around(bounder, DistanceDomain.around(domain.lower, domain.upper), str(bounder.device))
    return far.freeze(min(float(round_down(np.nextafter(-far.rounding_bound(), -np.inf))), 0.0), None)


def _of_networks(bounder: Bounder) -> bool:
    """Whether a bounder is a network, or consists of some, all asked about coordinates of the whole."""
    if isinstance(bounder, Cascade):
        return all(map(_of_networks, bounder.members))
    return isinstance(bounder, Mlp)


class _March:
    """A distance along segments (``DistanceBounder.segments``)."""

    def __init__(self, far: DistanceBounder, joints: Joints | None, count: int, depth: int, first: bool):
        self._far, self._steps, self._off = far, 2**depth, 0.0
        if joints is not None and any(joints.period):
            self._off = PIECE * max(map(abs, (*joints.lower, *joints.upper))) * np.sqrt(far.ndim) * (1 + INSIDE)
        self._joints = joints

    def __call__(self, starts: np.ndarray, ends: np.ndarray, begin: np.ndarray) -> np.ndarray:
        with np.errstate(over="ignore", invalid="ignore"):
            maybe, time = (each.numpy() for each in self._far.segments(starts, ends, self._off, self._steps))
        until = np.where(maybe, time, np.inf)
        if self._joints is not None:
            until[~(self._joints.within(starts) & self._joints.within(ends))] = 0.0
        return until


def _walks(bounder: Bounder, count: int, depth: int, first: bool) -> "_Walk | _Any":
    """What asks a network, or several, about so many segments."""
    if len(bounder.parts) == 1:
        return _Walk(bounder, count, depth, first)
    return _Any([_walks(part, count, depth, True) for part in bounder.parts])


class _Any:
    """Several networks, of which any may clear a piece: each goes on where the one before has stopped."""

    def __init__(self, walks: list):
        self._walks = walks

    def __call__(self, starts: np.ndarray, ends: np.ndarray, begin: np.ndarray) -> np.ndarray:
        until, stopped = begin, np.zeros(len(starts), bool)
        for _ in range(ROUNDS):
            before = until
            for walk in self._walks:
                until = np.where(stopped, until, walk(starts, ends, np.where(stopped, np.inf, until)))
            stopped = stopped | (until == before)
            if (stopped | (until == np.inf)).all():
                break
        return until


ROUNDING = 2.0**-50  # relative, of a product and three sums in float64


class SegmentParametrization(Parametrization):
    """Segments of points: ``z = (a, w, t)``, the points ``a + t w`` of one segment for t in an interval.

    Only t varies within a box, so halving the box halves the segment. The inputs are linear in t: there is one column
    of generators, and rounding is the only noise.
    """

    noisy = True
    expand = f"""
const V middle_ = (low[2 * K] + high[2 * K]) * 0.5, half_ = (high[2 * K] - low[2 * K]) * 0.5;
for (int k = 0; k < K; ++k) {{
    center[k] = low[k] + low[K + k] * middle_;
    gen[k] = low[K + k] * half_;
    noise[k] = (absolute(low[k]) + absolute(low[K + k])) * {ROUNDING.hex()};
}}
"""
    project = "columns[0] = of[0] * gen[0]; for (int k = 1; k < K; ++k) columns[0] += of[k] * gen[k];"
    realize = """
for (int k = 0; k < 2 * K; ++k) z[k] = low[k];
z[2 * K] = slope[0] > zero ? low[2 * K] : high[2 * K];
for (int k = 0; k < K; ++k) h[k] = z[k] + z[K + k] * z[2 * K];
"""

    @property
    def size(self) -> int:
        return 2 * self.inputs + 1

    @property
    def columns(self) -> int:
        return 1


class _Walk:
    """One network along segments: the native walk (``native/bounds.h``) with its numbers, and its launch.

    Of points it bounds -f, which must lie above -(threshold + E). Of a distance to a shape that moves it bounds F,
    which must lie above 0 all along. It is not enough that no face touches the point on its way, which a march would
    tell: a hole may close around it.
    """

    _numbers: ClassVar[WeakKeyDictionary] = WeakKeyDictionary()  # of a bounder, kept as long as it is

    def __init__(self, bounder: Bounder, count: int, depth: int, first: bool):
        device, moving = bounder.device, isinstance(bounder, MlpDistance)
        if bounder not in self._numbers:
            self._numbers[bounder] = _walk_numbers(bounder)
        kernel, arrays, _ = self._numbers[bounder]
        if moving:  # for what a point of a piece may be off
            base = -float(bounder.threshold) + bounder.steepness * AROUND
        else:
            base = float(np.nextafter(-(float(bounder.threshold) + bounder.rounding_bound()), np.inf))
        shapes = (count, bounder.ndim), (count, bounder.ndim), count, count
        self._arrays = [wp.zeros(shape, dtype=wp.float64, device=device) for shape in shapes]
        self._views = [each.numpy() for each in self._arrays] if device.is_cpu else None
        *given, until = self._arrays
        shared = int(device.is_cpu and count < SHARED)
        inputs = [*given, count, 0, shared, depth, int(not first), base, *arrays]
        self._launch = BlockLaunch(kernel, count, inputs, [until], device, first_index=4, block=BLOCK)

    def __call__(self, starts: np.ndarray, ends: np.ndarray, begin: np.ndarray) -> np.ndarray:
        """Up to which share each segment is clear from ``begin`` on, infinity where all of it is or ``begin`` is."""
        for number, values in enumerate((starts, ends, begin)):
            if self._views is None:
                self._arrays[number].assign(values)
            else:  # a call of Warp takes longer than a small copy
                self._views[number][...] = values
        self._launch.launch()
        return self._arrays[3].numpy() if self._views is None else self._views[3].copy()


def _walk_numbers(bounder: Bounder) -> tuple[wp.Kernel, list[wp.array], list[np.ndarray]]:
    """The kernel of a network, and arrays, with what these share."""
    network, moving, domain = bounder.network, isinstance(bounder, MlpDistance), bounder.domain
    weights = network.packed.copy()
    if not moving:  # the output layer's, so that -f is bounded
        weights[-1 - network.output.weight.shape[1] :] *= -1.0
    limit = domain.limit.astype(np.float64)
    least, most = np.full((2, bounder.ndim), [[-np.inf], [np.inf]])
    if domain.joints is not None:
        least, most = (np.array(each, dtype=np.float64) for each in (domain.joints.lower, domain.joints.upper))
    if domain.time:  # beyond its range nothing is known
        least[0], most[0] = domain.lower[0], domain.upper[0]
    reach = (limit + 2 * AROUND * moving) * (1 + INSIDE)  # a distance's domain has no delta
    padding = network.padding_for((limit + 4 * AROUND * moving) * (1 + 2 * INSIDE))
    held = [weights, padding, np.concatenate([domain.center, domain.scale, reach, least, most])]
    held = [np.ascontiguousarray(each, dtype=np.float64) for each in held]
    kernel = _kernel(network.kernel_shape(SegmentParametrization(bounder.ndim)))
    return kernel, [double_array(each, bounder.device) for each in held], held


@cache
def _kernel(shape: NetworkShape) -> wp.Kernel:
    names = "const double* w = weights.data; const double* padding = paddings.data;\n"
    names += (
        constants(K=shape.ndim, BOX=shape.parametrization.size, BLOCK=BLOCK)
        + f" constexpr double INSIDE = {constant(INSIDE)}, LARGEST = {constant(LARGEST_LOCAL)};"
    )
    names += " auto absolute_of = [](double x) { return x < 0.0 ? -x : x; };"
    walk = fill(native_text("bounds.h").WALK, body=body(shape))
    cpu, cuda = lanes_text(shape, names)
    ends = (
        "const int BEGIN = block * BLOCK, END = BEGIN + BLOCK < count ? BEGIN + BLOCK : count;",
        "const int BEGIN = block, END = block + 1;",
    )
    text = f"#if !defined(__CUDA_ARCH__)\n{cpu}{ends[0]}\n{walk}\n#else\n{cuda}{ends[1]}\n{walk}\n#endif\n#undef LANE\n"

    @named(unique_name(shape, "walk")).block_kernel(text)
    def walk_all(
        starts: wp.array2d(dtype=wp.float64),
        ends: wp.array2d(dtype=wp.float64),
        begin: wp.array(dtype=wp.float64),
        count: int,
        block: int,
        shared: int,
        depth: int,
        quick: int,
        base: wp.float64,
        weights: wp.array(dtype=wp.float64),
        paddings: wp.array(dtype=wp.float64),
        map: wp.array(dtype=wp.float64),
        until: wp.array(dtype=wp.float64),
    ): ...

    return walk_all
