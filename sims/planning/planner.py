"""What planners share: where, the broad phase before every exact check, and what their runs are judged by.

In each batch of states or edges, what the broad phase clears is taken as free, what it certainly knows to collide is
not, and everything else is checked exactly. So with a conservative broad phase every answer is the exact one, and
whatever a planner makes of the answers is the same to the bit.
"""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sims import base
from sims.planning.broad import FREE, HIT, MAYBE, BroadPhase

__all__ = ["Cleared", "Exact", "Place", "Planner"]


class Place(ABC):
    """Where to plan.

    Attributes:
        name: For people.
    """

    name: str

    @abstractmethod
    def draw(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """``(count, n)`` float32, random states, free or not."""

    @abstractmethod
    def problems_of(self, count: int, seed: int) -> np.ndarray:
        """``(P, 2, n)`` float32, start and goal of ``count`` problems at most."""

    @abstractmethod
    def measured(self, x: np.ndarray) -> np.ndarray:
        """``(N, n)`` float64, states in the coordinates in which lengths are reported."""


Cleared = Callable[[np.ndarray], np.ndarray]


class Exact(ABC):
    """The narrow phase of a planner.

    Attributes:
        checks: How many states or edges were decided so far, whichever is the price.
    """

    checks: int = 0

    @abstractmethod
    def states(self, x: np.ndarray) -> np.ndarray:
        """Which states ``(N, n)`` float32 collide: ``(N,)`` bool."""

    @abstractmethod
    def segments(self, starts: np.ndarray, ends: np.ndarray, cleared: Cleared | None = None) -> np.ndarray:
        """Which edges between states collide: ``(N,)`` bool.

        Args:
            starts: ``(N, n)`` float32.
            ends: ``(N, n)`` float32.
            cleared: What the broad phase says of states along edges, ``(K, n)`` float64: those that need no check. For
                those who check edges state by state.
        """


@dataclass
class _Batch:
    """What the broad phase said about a batch, to be judged later: all ends (states: twice the same), and answers."""

    starts: np.ndarray
    ends: np.ndarray
    answers: np.ndarray = field(repr=False)

    def where(self, answer: int) -> tuple[np.ndarray, np.ndarray]:
        """The ends of what was answered so."""
        return self.starts[self.answers == answer], self.ends[self.answers == answer]


class Planner(base.Example):
    """All problems of one place, planned at once.

    Attributes:
        world: Where.
        problems: ``(P, 2, n)`` float32.
        checks: Exact checks, of states and edges.
        seconds: Per repetition: broad phase, narrow phase, everything.
        blocked: ``(P,)`` bool, problems whose start or goal is not free.
        lengths: ``(P,)`` float64; infinite where there is no path.
        paths: Per problem ``(V, n)`` float32, from start to goal, or ``None``.
    """

    LOST = "states and edges were cleared that collide, or are free and were said to collide"
    DIFFER = "the paths differ"

    def __init__(self, world: Place, exact: Exact, broad: BroadPhase | None, problems: int, seed: int):
        """Draw the problems; they depend on the seed, not on the broad phase.

        Args:
            world: Where to plan.
            exact: What decides.
            broad: What is asked first; nothing if ``None``.
            problems: How many, at most.
            seed: Of problems and of all that is random.
        """
        super().__init__()
        self.world, self.broad, self.exact = world, broad, exact
        self.problems = world.problems_of(problems, seed)
        self.checks = 0

    @abstractmethod
    def plan(self) -> None:
        """Fill in ``blocked``, ``lengths`` and ``paths``; all that is asked goes through ``_free``."""

    def step(self) -> None:
        """Plan. May be called again, for its time."""
        start = time.perf_counter()
        self.checks, self._spent, self._batches = 0, [0.0, 0.0], []
        self.plan()
        self.seconds.append((*self._spent, time.perf_counter() - start))
        self.calls = [self.checks]

    def _free(self, starts: np.ndarray, ends: np.ndarray | None) -> np.ndarray:
        """Which states or edges of a batch are free: the broad phase first, then the exact world; timed and counted."""
        start, answers = time.perf_counter(), np.full(len(starts), MAYBE, dtype=np.uint8)
        if self.broad is not None:
            answers = self.broad.classify(starts, ends)
        left = np.flatnonzero(answers == MAYBE)
        middle, before, asking = time.perf_counter(), self.exact.checks, 0.0

        def cleared(x: np.ndarray) -> np.ndarray:
            nonlocal asking
            begun = time.perf_counter()
            found = self.broad.states(x)
            asking += time.perf_counter() - begun
            return found

        if ends is None:
            hits = self.exact.states(starts[left])
        else:
            hits = self.exact.segments(starts[left], ends[left], cleared if self.broad is not None else None)
        free = answers == FREE
        free[left] = ~hits
        end = time.perf_counter()
        self._spent[0] += middle - start + asking if self.broad is not None else 0.0
        self._spent[1] += end - middle - asking if self.broad is not None else end - start
        self.checks += self.exact.checks - before
        self._batches.append(_Batch(starts, starts if ends is None else ends, answers))
        return free

    def left_by(self, broad: BroadPhase) -> np.ndarray:
        """``(K,)`` bool: which states and edges of the last ``step`` a broad phase leaves to exact checks."""
        answers = []
        for batch in self._batches:
            ends = None if batch.ends is batch.starts else batch.ends
            answers.append(broad.classify(batch.starts, ends))
        return np.concatenate(answers) == MAYBE

    def found(self) -> list[bytes]:
        """Lengths and paths, as a part of ``state``."""
        paths = [b"none" if path is None else path.tobytes() for path in self.paths]
        return [self.blocked.tobytes(), self.lengths.tobytes(), *paths]

    @property
    def solved(self) -> int:
        """Problems with a path."""
        return int(np.isfinite(self.lengths).sum())

    @property
    def mean_length(self) -> float:
        """Of the paths; 0 where there are none."""
        return float(self.lengths[np.isfinite(self.lengths)].mean()) if self.solved else 0.0

    def collisions(self) -> np.ndarray:
        """``(P,)`` bool: problems whose path collides with the exact world."""
        hit = np.zeros(len(self.problems), dtype=bool)
        known = [(problem, path) for problem, path in enumerate(self.paths) if path is not None]
        if known:
            owner = np.concatenate([np.full(len(path) - 1, problem) for problem, path in known])
            starts, ends = (np.concatenate([path[part] for _, path in known]) for part in (slice(-1), slice(1, None)))
            hit[owner[self.exact.segments(starts, ends)]] = True
        return hit

    def missed(self, reference: "Planner | None" = None) -> int:
        """States and edges that were cleared and collide with the exact world, or that do not and were said to."""
        wrong = 0
        for batch in self._batches:
            wrong += int(self.exact.segments(*batch.where(FREE)).sum())
            wrong += int((~self.exact.segments(*batch.where(HIT))).sum())
        return wrong

    def extra(self, reference: "Planner") -> dict[str, Any]:
        """``world``, ``fewer`` checks (a factor), ``solved``, paths' ``collisions`` and ``mean_length``, price."""
        saved, broad = reference.checks - self.checks, self.milliseconds()[0]
        return {
            "world": self.world.name,
            "fewer": reference.checks / max(self.checks, 1),
            "solved": self.solved,
            "collisions": int(self.collisions().sum()),
            "mean_length": self.mean_length if self.solved else None,
            "us_per_saved_check": 1e3 * broad / saved if saved > 0 else None,
        }

    def test_final(self, reference: "Planner") -> None:
        """Check this run against one without a broad phase.

        Raises:
            AssertionError: If something was judged wrongly, a path collides, or a bit of the result differs.
        """
        if not self.missed(reference):
            collisions = int(self.collisions().sum())
            assert collisions == 0, f"{collisions} paths collide"
        super().test_final(reference)
