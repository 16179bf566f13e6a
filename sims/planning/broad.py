"""The broad phase of the planner: which states and which *whole* edges does a bounder clear?

An edge is a closed straight segment between float32 states. It is cleared

* by a network of points, where bound propagation proves that the network denies every point of it
  (``warp_bounding.proof.clear_segments``);
* by a bounder of boxes, where it denies the axis-aligned boxes of pieces that together cover it (``clear_by_boxes``);
* by a bounder of distances, which marches along it: each distance is a step that nothing can stand in the way of
  (``Marching``);
* not at all by ``Points``, for planners that go on edge by edge: what checks an edge asks about the states along it;
* by ``Samples``, where a bounder denies points along it. That is how it is often done, and no proof of anything.

All but ``Samples`` are proofs wherever the bounder has one. What is not cleared is not blocked, but has to be checked
exactly; but for ``TwoSided``, which asks a bounder from the inside too: what certainly lies in an obstacle, or leads
through one, collides, and needs no check either.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np
import warp as wp

import warp_bounding as wb

__all__ = [
    "FREE",
    "HIT",
    "MAYBE",
    "Boxes",
    "BroadPhase",
    "Elsewhere",
    "Every",
    "First",
    "Marching",
    "Points",
    "Samples",
    "Segments",
    "TwoSided",
    "clear_by_boxes",
]

FREE, MAYBE, HIT = 0, 1, 2  # answers of ``BroadPhase.classify``; those of ``warp_bounding.two_sided``'s

HALVINGS = 3  # of an edge, for boxes: eight pieces at most
NETWORK_HALVINGS = 4  # for networks, whose bounds are loose where a network varies a lot along a piece
SPACING = 0.5  # cells between samples
AT_ONCE = 64  # states that are asked without a call of its own being set up
ROUNDING = 2.0**-48  # of a point along an edge, relative to the ends: eight roundings of 2^-53, four times over
PIECES = 8  # of an edge: between them are the points that a bounder from the inside is asked


class BroadPhase(ABC):
    """What the planner asks first."""

    @abstractmethod
    def states(self, x: np.ndarray) -> np.ndarray:
        """``(N,)`` bool: states, ``(N, 2)`` float32, that need no exact check."""

    @abstractmethod
    def edges(self, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """``(N,)`` bool: edges between states, ``(N, 2)`` float32 each, that need no exact check."""

    def classify(self, starts: np.ndarray, ends: np.ndarray | None = None) -> np.ndarray:
        """What is certain of states, or of edges.

        Args:
            starts: ``(N, 2)`` float32: the states, or where edges begin.
            ends: ``(N, 2)`` float32: where edges end; ``None`` for states.

        Returns:
            ``(N,)`` uint8: ``FREE`` or ``HIT`` for certain, neither of which needs an exact check, else ``MAYBE``.
        """
        cleared = self.states(starts) if ends is None else self.edges(starts, ends)
        return np.where(cleared, FREE, MAYBE).astype(np.uint8)


class _OfPoints(BroadPhase):
    """A bounder of points."""

    def __init__(self, bounder: wb.Bounder):
        self.bounder = bounder

    def states(self, x: np.ndarray) -> np.ndarray:
        return ~self.bounder.query(x).numpy()


def clear_by_boxes(
    bounder: wb.Bounder, starts: np.ndarray, ends: np.ndarray, *, halvings: int = HALVINGS
) -> np.ndarray:
    """Which segments are proven to meet the object nowhere, by the boxes of their pieces.

    A piece is the part of a segment between two dyadic times; along each axis it lies between its ends. These are
    computed in float64, moved apart by more than their rounding, and rounded outwards to float32: the box that is asked
    contains the piece.

    Args:
        bounder: Of boxes; where it is proven, so is the answer.
        starts: ``(N, n)`` float32, object space.
        ends: ``(N, n)`` float32.
        halvings: How often a piece is halved at most where its box is not denied.

    Returns:
        ``(N,)`` bool: no point of the closed segment lies in the object. False says nothing.

    Raises:
        BounderError: For a bounder of other queries.
        QueryError: For arrays of another shape, or a negative number of halvings.
    """
    if bounder.query_kind != "box" or bounder.domain.time:
        raise wb.BounderError(f"expected a bounder of boxes at rest, got {bounder!r}")
    starts, ends = np.asarray(starts, dtype=np.float64), np.asarray(ends, dtype=np.float64)
    if starts.shape != ends.shape or starts.ndim != 2 or starts.shape[1] != bounder.ndim:
        raise wb.QueryError(f"starts and ends must both be (N, {bounder.ndim}), got {starts.shape} and {ends.shape}")
    if halvings < 0:
        raise wb.QueryError(f"halvings must be at least 0, got {halvings}")
    owner, failed = np.arange(len(starts)), np.zeros(len(starts), dtype=bool)
    first, last = np.zeros(len(starts)), np.ones(len(starts))
    for level in range(halvings + 1):
        maybe = bounder.query(_boxes(starts[owner], ends[owner], first, last)).numpy()
        owner, first, last = owner[maybe], first[maybe], last[maybe]
        if level == halvings or not len(owner):
            break
        middle = (first + last) / 2  # where even this point is not denied, no half will be
        hopeless = bounder.query(_boxes(starts[owner], ends[owner], middle, middle)).numpy()
        failed[owner[hopeless]] = True
        left = ~failed[owner]
        owner, first, middle, last = owner[left], first[left], middle[left], last[left]
        owner, first, last = np.tile(owner, 2), np.concatenate([first, middle]), np.concatenate([middle, last])
    failed[owner] = True  # what was not cleared
    return ~failed


def _boxes(starts: np.ndarray, ends: np.ndarray, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """``(N, 2n)`` float32 lower and upper corners of boxes around the pieces of segments between two times."""
    way, slack = ends - starts, ROUNDING * np.maximum(np.abs(starts), np.abs(ends))
    one, other = starts + first[:, None] * way, starts + last[:, None] * way
    lower, upper = np.minimum(one, other) - slack, np.maximum(one, other) + slack
    below, above = lower.astype(np.float32), upper.astype(np.float32)
    below = np.where(below > lower, np.nextafter(below, np.float32(-np.inf)), below)
    above = np.where(above < upper, np.nextafter(above, np.float32(np.inf)), above)
    return np.concatenate([below, above], axis=1)


class Boxes(BroadPhase):
    """A bounder of boxes: of states, which are boxes of no size, and of the boxes of pieces of edges."""

    def __init__(self, bounder: wb.Bounder):
        self.bounder = bounder

    def states(self, x: np.ndarray) -> np.ndarray:
        return ~self.bounder.query(np.concatenate([x, x], axis=1)).numpy()

    def edges(self, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
        return clear_by_boxes(self.bounder, starts, ends)


class Segments(_OfPoints):
    """A network of points, and proofs along whole edges, which are halved ``halvings`` times at most."""

    def __init__(self, bounder: wb.Bounder, halvings: int = NETWORK_HALVINGS):
        super().__init__(bounder)
        self.halvings = halvings

    def edges(self, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
        return wb.proof.clear_segments(self.bounder, starts, ends, depth=self.halvings)


class Marching(BroadPhase):
    """A bounder of distances: states proven to lie at a distance, and edges that are marched along from them."""

    def __init__(self, bounder: wb.DistanceBounder):
        self.bounder = bounder

    def states(self, x: np.ndarray) -> np.ndarray:
        return ~self.bounder.query(x).numpy()

    def edges(self, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
        return ~self.bounder.segments(starts, ends)[0].numpy()


class TwoSided(BroadPhase):
    """A broad phase, and a bounder of points from the inside, which says what certainly collides.

    It is what ``warp_bounding.two_sided`` is for bounders of points alone. An edge collides if a single point of it
    does. Points between its pieces are computed in float64, within 2^-50 of the segment, relative to the larger end,
    and asked so: every proof covers that a query is rounded to float32, by 2^-24, four times over.
    """

    def __init__(self, outer: BroadPhase, inner: wb.Bounder):
        self.outer, self.inner = outer, inner

    def states(self, x: np.ndarray) -> np.ndarray:
        return self.outer.states(x)

    def edges(self, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
        return self.outer.edges(starts, ends)

    def classify(self, starts: np.ndarray, ends: np.ndarray | None = None) -> np.ndarray:
        answers = self.outer.classify(starts, ends)
        left = np.flatnonzero(answers == MAYBE)
        points = starts[left, None] if ends is None else _between(starts[left], ends[left])
        denied = ~self.inner.query(points.reshape(-1, starts.shape[1])).numpy()
        answers[left[denied.reshape(points.shape[:2]).any(axis=1)]] = HIT
        return answers


def _between(starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """``(N, PIECES - 1, n)`` float64: the points between the pieces of segments."""
    way, times = ends.astype(np.float64) - starts, np.arange(1, PIECES) / PIECES
    return starts[:, None] + times[:, None] * way[:, None]


class Points(_OfPoints):
    """A bounder of points that is asked about few states at a time, again and again; it clears no edge as a whole.

    A call of ``query`` takes longer than the answers to thousands of states; few of them are written to where a launch
    that is prepared once reads them.
    """

    def __init__(self, bounder: wb.Bounder):
        super().__init__(bounder)
        if not wp.get_device(bounder.device).is_cpu:
            raise wb.BounderError(
                f"expected a bounder on a CPU, where few states are asked at once, got {bounder.device}"
            )
        x = wp.zeros((AT_ONCE, bounder.ndim), dtype=wp.float32, device=bounder.device)
        self._prepared = bounder.prepare(x)
        self._x, self._answers = x.numpy(), self._prepared.out.numpy()

    def states(self, x: np.ndarray) -> np.ndarray:
        if len(x) > AT_ONCE:
            return super().states(x)
        self._x[: len(x)] = x
        self._prepared.launch()
        return ~self._answers[: len(x)]

    def edges(self, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
        return np.zeros(len(starts), dtype=bool)


class Samples(_OfPoints):
    """A bounder queried at points along an edge: it clears what it should not, even if the bounder is proven."""

    def __init__(self, bounder: wb.Bounder, cells_per_unit: np.ndarray, spacing: float = SPACING):
        super().__init__(bounder)
        self.cells_per_unit, self.spacing = cells_per_unit, spacing

    def edges(self, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
        if not len(starts):
            return np.zeros(0, dtype=bool)
        way = ends.astype(np.float64) - starts
        pieces = np.maximum(1, np.ceil(np.linalg.norm(way * self.cells_per_unit, axis=1) / self.spacing)).astype(int)
        first = np.concatenate([[0], np.cumsum(pieces + 1)[:-1]])
        owner = np.repeat(np.arange(len(starts)), pieces + 1)
        t = (np.arange(len(owner)) - first[owner]) / pieces[owner]
        points = (starts[owner] + t[:, None] * way[owner]).astype(np.float32)
        return ~np.logical_or.reduceat(self.bounder.query(points).numpy(), first)


class First(BroadPhase):
    """One broad phase, and another one for what it does not clear."""

    def __init__(self, first: BroadPhase, second: BroadPhase):
        self.first, self.second = first, second

    def states(self, x: np.ndarray) -> np.ndarray:
        cleared = self.first.states(x)
        cleared[~cleared] = self.second.states(x[~cleared])
        return cleared

    def edges(self, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
        cleared = self.first.edges(starts, ends)
        cleared[~cleared] = self.second.edges(starts[~cleared], ends[~cleared])
        return cleared


class Every(BroadPhase):
    """Broad phases of parts of what collides, such as a cell and the arm itself: clears what all of them clear."""

    def __init__(self, *phases: BroadPhase):
        self.phases = phases

    def states(self, x: np.ndarray) -> np.ndarray:
        cleared = np.ones(len(x), dtype=bool)
        for phase in self.phases:
            cleared[cleared] = phase.states(x[cleared])
        return cleared

    def edges(self, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
        cleared = np.ones(len(starts), dtype=bool)
        for phase in self.phases:
            cleared[cleared] = phase.edges(starts[cleared], ends[cleared])
        return cleared


class Elsewhere(BroadPhase):
    """A broad phase in coordinates that are affine in those of the planner, such as some joints of a robot.

    ``coordinates`` takes ``(N, n)`` states to ``(N, m)`` float64.
    """

    def __init__(self, phase: BroadPhase, coordinates: Callable[[np.ndarray], np.ndarray]):
        self.phase, self.coordinates = phase, coordinates

    def states(self, x: np.ndarray) -> np.ndarray:
        return self.phase.states(self.coordinates(x))

    def edges(self, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
        return self.phase.edges(self.coordinates(starts), self.coordinates(ends))
