"""RRT-Connect (Kuffner and LaValle 2000): two trees, from start and goal, grow towards random states and each other.

One tree takes a step of ``REACH`` at most towards a random state; if it is free, the other one goes on towards the new
state, step by step, until it arrives or something is in the way; then they change places. Every state and every edge of
a step is asked through the broad phase. Random states depend on the seed and the problem alone, so as long as all
answers are exact both trees are the same to the bit.

What this does not do: smooth paths, or choose a step's length.
"""

import numpy as np

from sims.planning.broad import BroadPhase
from sims.planning.planner import Exact, Place, Planner

__all__ = ["REACH", "SAMPLES", "RrtConnect"]

REACH = 0.4  # of a step at most, in the coordinates in which lengths are told
SAMPLES = 3000  # random states of a problem at most
CAPACITY = 256  # states that a tree has room for at first


class _Tree:
    """States, each with the one that it was reached from."""

    def __init__(self, root: np.ndarray, measured: np.ndarray):
        self.states = np.zeros((CAPACITY, len(root)), dtype=np.float32)
        self.measured = np.zeros((CAPACITY, len(measured)))
        self.parents: list[int] = []
        self.add(root, measured, -1)

    def add(self, state: np.ndarray, measured: np.ndarray, parent: int) -> int:
        """Its number."""
        number = len(self.parents)
        if number == len(self.states):
            self.states, self.measured = (
                np.concatenate([each, np.zeros_like(each)]) for each in (self.states, self.measured)
            )
        self.states[number], self.measured[number] = state, measured
        self.parents.append(parent)
        return number

    def nearest(self, measured: np.ndarray) -> int:
        """The number of the state that is nearest to a place."""
        count = len(self.parents)
        return int(((self.measured[:count] - measured) ** 2).sum(axis=1).argmin())

    def way(self, number: int) -> list[np.ndarray]:
        """States from the root to one of them."""
        found = []
        while number >= 0:
            found.append(self.states[number].copy())
            number = self.parents[number]
        return found[::-1]


class RrtConnect(Planner):
    """All problems of one place, one after the other, with trees of their own; see ``Planner``.

    Attributes:
        sizes: ``(P,)`` int, states of both trees together.
    """

    def __init__(
        self,
        world: Place,
        exact: Exact,
        broad: BroadPhase | None = None,
        *,
        samples: int = SAMPLES,
        reach: float = REACH,
        problems: int = 100,
        seed: int = 0,
    ):
        """Draw problems.

        Args:
            world: Where to plan.
            exact: What decides.
            broad: What is asked first; nothing if ``None``.
            samples: Random states a problem, at most.
            reach: Of a step, in the coordinates in which lengths are reported.
            problems: How many, at most.
            seed: Of problems and random states.
        """
        super().__init__(world, exact, broad, problems, seed)
        self.samples, self.reach, self.seed = samples, reach, seed

    def plan(self) -> None:
        """Each problem in turn."""
        count = len(self.problems)
        ends = self._free(self.problems.reshape(2 * count, -1), None).reshape(count, 2)
        self.blocked, self.lengths = ~ends.all(axis=1), np.full(count, np.inf)
        self.paths, self.sizes = [None] * count, np.zeros(count, dtype=int)
        for number in np.flatnonzero(~self.blocked):
            self._solve(int(number))

    def _solve(self, number: int) -> None:
        rng, measured = np.random.default_rng([self.seed, 2, number]), self.world.measured
        trees = [_Tree(end, measured(end[None])[0]) for end in self.problems[number]]
        growing = 0
        for target in [self.problems[number, 1], *self.world.draw(self.samples, rng)]:
            one, other = trees[growing], trees[1 - growing]
            new = self._towards(one, target, 1)
            if new is not None:
                met = self._towards(other, one.states[new], None)
                if met is not None and (other.states[met] == one.states[new]).all():
                    ways = [one.way(new), other.way(met)]
                    path = [*ways[growing], *ways[1 - growing][::-1][1:]]
                    self.paths[number] = np.array(path)
                    self.lengths[number] = np.linalg.norm(np.diff(measured(self.paths[number]), axis=0), axis=1).sum()
                    break
            growing = 1 - growing
        self.sizes[number] = sum(len(tree.parents) for tree in trees)

    def _towards(self, tree: _Tree, target: np.ndarray, steps: int | None) -> int | None:
        """Grow a tree towards a state by so many steps at most; the number of the last new state, or ``None``."""
        goal, found = self.world.measured(target[None])[0], None
        at = tree.nearest(goal)
        while steps is None or steps > 0:
            way = goal - tree.measured[at]
            length = float(np.linalg.norm(way))
            if length == 0:
                return at
            start, new = tree.states[at], target
            if length > self.reach:
                share = self.reach / length
                new = (start + share * (target.astype(np.float64) - start)).astype(np.float32)
            edge = start[None], new[None]
            if not (self._free(new[None], None)[0] and self._free(*edge)[0]):
                break
            at = found = tree.add(new, self.world.measured(new[None])[0], at)
            if steps is not None:
                steps -= 1
        return found

    def state(self) -> bytes:
        """Lengths, paths, and how large the trees are."""
        return b"|".join([self.sizes.tobytes(), *self.found()])
