"""A probabilistic roadmap (Kavraki et al. 1996) that asks a broad phase before every exact check.

One batch of states (random ones, and the starts and goals of all problems), one of edges from each free state to its
nearest ones, one of the connections of all starts and goals; then a shortest path for each problem (Dijkstra). Nearness
and lengths are in the place's own units.

What this does not do: choose edges lazily or smooth paths; all edges of the roadmap are tested, as for a roadmap that
is used many times.
"""

import numpy as np

from sims.planning.broad import BroadPhase
from sims.planning.planner import Exact, Place, Planner

__all__ = ["NEIGHBOURS", "Roadmap"]

NEIGHBOURS = 12  # that a state is connected with


class Roadmap(Planner):
    """All problems of one place, planned at once; see ``Planner``.

    Attributes:
        nodes: ``(S, n)`` float32, free states of the roadmap.
        roadmap: ``(E, 2)`` int, its free edges.
    """

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
        super().__init__(world, exact, broad, problems, seed)
        self.neighbours = neighbours
        self.states = world.draw(states, np.random.default_rng([seed, 0]))

    def plan(self) -> None:
        """States, roadmap, connections, shortest paths."""
        count = len(self.problems)
        places = np.concatenate([self.states, self.problems[:, 0], self.problems[:, 1]])
        free = self._free(places, None)
        self.nodes = self.states[free[: len(self.states)]]
        self.blocked = ~(free[len(self.states) : -count] & free[-count:])
        self._connect()
        self._search()

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
        queried = np.flatnonzero(~self.blocked)
        if not len(queried):
            return
        distance, before = dijkstra(graph, indices=n + queried, return_predecessors=True)
        for row, problem in enumerate(queried):
            node = n + count + problem
            self.lengths[problem] = distance[row, node]
            if not np.isfinite(self.lengths[problem]):
                continue
            way = [node]
            while way[-1] != n + problem:
                way.append(before[row, way[-1]])
            self.paths[problem] = places[way[::-1]]

    def state(self) -> bytes:
        """The whole result: roadmap, lengths and paths."""
        return b"|".join([*(array.tobytes() for array in (self.nodes, self.roadmap, self._links)), *self.found()])
