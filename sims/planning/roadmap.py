"""A probabilistic roadmap (Kavraki et al. 1996) that asks a broad phase before every exact check.

One batch of states (random ones, and the starts and goals of all problems), one of edges from each free state to its nearest ones, one of
the connections of all starts and goals; then a shortest path for each problem (Dijkstra). Nearness and lengths are in the place's own units. In each
batch, what the broad phase clears is taken as free, what it certainly knows to collide is not, and everything else is checked exactly. So
with a conservative broad phase every answer is the exact one, and roadmap, lengths and paths are the same to the bit.

What this does not do: choose edges lazily or smooth paths; all edges of the roadmap are tested, as for a roadmap that is used many times.
"""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sims import base
from sims.planning.broad import FREE, HIT, MAYBE, BroadPhase

__all__ = ["NEIGHBOURS", "Cleared", "Exact", "Place", "Roadmap"]

NEIGHBOURS = 12  # that a state is connected with


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
        """``(N, n)`` float64, states in the coordinates in which lengths are told."""


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
            cleared: What the broad phase says of states along edges, ``(K, n)`` float64: those that need no check. For those who check edges state by state.
        """


@dataclass
class _Batch:
    """What the broad phase said about one batch, kept to be judged later: all ends (states: twice the same), and the answers."""

    starts: np.ndarray
    ends: np.ndarray
    answers: np.ndarray = field(repr=False)

    def where(self, answer: int) -> tuple[np.ndarray, np.ndarray]:
        """The ends of what was answered so."""
        return self.starts[self.answers == answer], self.ends[self.answers == answer]


class Roadmap(base.Example):
    """All problems of one place, planned at once.

    Attributes:
        world: Where.
        problems: ``(P, 2, n)`` float32.
        checks: Exact checks, of states and edges.
        seconds: Per repetition: broad phase, narrow phase, everything.
        blocked: ``(P,)`` bool, problems whose start or goal is not free.
        lengths: ``(P,)`` float64; infinite where there is no path.
        paths: Per problem ``(V, n)`` float32, from start to goal, or ``None``.
        nodes: ``(S, n)`` float32, free states of the roadmap.
        roadmap: ``(E, 2)`` int, its free edges.
    """

    LOST = "states and edges were cleared that collide, or are free and were said to collide"
    DIFFER = "the paths differ"

    def __init__(
        self,
        world: Place,
        exact: Exact,
        broad: BroadPhase | None = None,
        *,
        states: int = 4000,
        neighbours: int = NEIGHBOURS,
        problems: int = 200,
        seed: int = 0,
    ):
        """Draw states and problems; they depend on the seed, not on the broad phase.

        Args:
            world: Where to plan.
            exact: What decides.
            broad: What is asked first; nothing if ``None``.
            states: Random states, free or not.
            neighbours: Nearest states that each is connected with.
            problems: How many, at most.
            seed: Of states and problems.
        """
        super().__init__()
        self.world, self.broad, self.neighbours = world, broad, neighbours
        self.exact = exact
        self.problems = world.problems_of(problems, seed)
        self.states = world.draw(states, np.random.default_rng([seed, 0]))
        self.checks = 0

    def step(self) -> None:
        """Plan: states, roadmap, connections, shortest paths. May be called again, for its time."""
        start = time.perf_counter()
        self.checks, self._spent, self._batches = 0, [0.0, 0.0], []
        count = len(self.problems)
        places = np.concatenate([self.states, self.problems[:, 0], self.problems[:, 1]])
        free = self._free(places, None)
        self.nodes = self.states[free[: len(self.states)]]
        self.blocked = ~(free[len(self.states) : -count] & free[-count:])
        self._connect()
        self._search()
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

    def _connect(self) -> None:
        """The roadmap's edges, and those between starts, goals and the roadmap."""
        from scipy.spatial import cKDTree

        measured = self.world.measured
        n, k = len(self.nodes), min(self.neighbours, len(self.nodes) - 1)
        self.roadmap = self._links = np.zeros((0, 2), dtype=np.int64)
        if k < 1:
            return
        tree = cKDTree(measured(self.nodes))
        near = tree.query(measured(self.nodes), k + 1)[1].astype(np.int64)
        pairs = np.stack([np.repeat(np.arange(n), k + 1), near.reshape(-1)], axis=1)
        pairs.sort(axis=1)
        pairs = np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0)
        self.roadmap = pairs[self._free(self.nodes[pairs[:, 0]], self.nodes[pairs[:, 1]])]

        ends = np.flatnonzero(~self.blocked)
        ends = np.concatenate([ends, len(self.problems) + ends])  # starts, then goals
        places = np.concatenate([self.problems[:, 0], self.problems[:, 1]])
        near = tree.query(measured(places[ends]), k)[1].astype(np.int64).reshape(len(ends), k)
        links = np.stack([np.repeat(ends, k), near.reshape(-1)], axis=1)
        self._links = links[self._free(places[links[:, 0]], self.nodes[links[:, 1]])]

    def _search(self) -> None:
        """A shortest path for each problem: starts lead into the roadmap, and it leads to the goals."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import dijkstra

        n, count = len(self.nodes), len(self.problems)
        places = np.concatenate([self.nodes, self.problems[:, 0], self.problems[:, 1]])
        leaving = self._links[:, 0] < count
        out, home = self._links[leaving] + [n, 0], self._links[~leaving][:, ::-1] + [0, n]
        edges = np.concatenate([self.roadmap, self.roadmap[:, ::-1], out, home])
        at = self.world.measured(places)
        lengths = np.linalg.norm(at[edges[:, 0]] - at[edges[:, 1]], axis=1)
        graph = coo_array((lengths, (edges[:, 0], edges[:, 1])), shape=(len(places),) * 2).tocsr()
        self.lengths, self.paths = np.full(count, np.inf), [None] * count
        asked = np.flatnonzero(~self.blocked)
        if not len(asked):
            return
        distance, before = dijkstra(graph, indices=n + asked, return_predecessors=True)
        for row, problem in enumerate(asked):
            node = n + count + problem
            self.lengths[problem] = distance[row, node]
            if not np.isfinite(self.lengths[problem]):
                continue
            way = [node]
            while way[-1] != n + problem:
                way.append(before[row, way[-1]])
            self.paths[problem] = places[way[::-1]]

    @property
    def solved(self) -> int:
        """Problems with a path."""
        return int(np.isfinite(self.lengths).sum())

    @property
    def mean_length(self) -> float:
        """Of the paths; 0 where there are none."""
        return float(self.lengths[np.isfinite(self.lengths)].mean()) if self.solved else 0.0

    def state(self) -> bytes:
        """The whole result: roadmap, lengths and paths."""
        paths = [b"none" if path is None else path.tobytes() for path in self.paths]
        arrays = (self.nodes, self.roadmap, self._links, self.blocked, self.lengths)
        return b"|".join([*(array.tobytes() for array in arrays), *paths])

    def collisions(self) -> np.ndarray:
        """``(P,)`` bool: problems whose path collides with the exact world."""
        hit = np.zeros(len(self.problems), dtype=bool)
        known = [(problem, path) for problem, path in enumerate(self.paths) if path is not None]
        if known:
            owner = np.concatenate([np.full(len(path) - 1, problem) for problem, path in known])
            starts, ends = (np.concatenate([path[part] for _, path in known]) for part in (slice(-1), slice(1, None)))
            hit[owner[self.exact.segments(starts, ends)]] = True
        return hit

    def missed(self, reference: "Roadmap | None" = None) -> int:
        """States and edges that were cleared and collide with the exact world, or that do not and were said to."""
        wrong = 0
        for batch in self._batches:
            wrong += int(self.exact.segments(*batch.where(FREE)).sum())
            wrong += int((~self.exact.segments(*batch.where(HIT))).sum())
        return wrong

    def extra(self, reference: "Roadmap") -> dict[str, Any]:
        """``world``, how many times ``fewer`` checks, problems ``solved``, ``collisions`` of paths, their ``mean_length``, a check's price."""
        saved, broad = reference.checks - self.checks, self.milliseconds()[0]
        return {
            "world": self.world.name,
            "fewer": reference.checks / max(self.checks, 1),
            "solved": self.solved,
            "collisions": int(self.collisions().sum()),
            "mean_length": self.mean_length if self.solved else None,
            "us_per_saved_check": 1e3 * broad / saved if saved > 0 else None,
        }

    def test_final(self, reference: "Roadmap") -> None:
        """Check this run against one without a broad phase.

        Raises:
            AssertionError: If something was judged wrongly, a path collides, or a bit of the result differs.
        """
        if not self.missed(reference):
            collisions = int(self.collisions().sum())
            assert collisions == 0, f"{collisions} paths collide"
        super().test_final(reference)
