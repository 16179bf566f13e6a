"""Plans of which every motion is proven free: RRT-Connect (Kuffner and LaValle 2000) that asks ``Motions``.

One tree takes a step towards a random configuration; the other one goes on towards the new configuration until it
arrives or something is in the way; then they change places. All steps of one way are asked together. Then shortcuts:
of random pairs of places along the path those whose straight motion is proven replace what lies between.

What this does not do: find the shortest path, or heed velocities.
"""

from typing import NamedTuple

import numpy as np

import warp_bounding as wb

__all__ = ["Found", "connect", "plan", "shortened"]

REACH = 0.5  # of a step, in joint values
SAMPLES = 200_000  # random configurations, at most
NEAR = 4.0  # steps: how far a target may be from a configuration from which a step has failed (Yershova et al. 2005)
SHORTCUTS, AT_ONCE = 8, 16  # rounds of shortcuts, and how many are asked together


class Found(NamedTuple):
    """A path ``(W, n)``, and how many motions were asked; ``None`` without a path."""

    path: np.ndarray | None
    asked: int


class _Tree:
    """Configurations, each with the number of the one that it was reached from."""

    def __init__(self, root: np.ndarray):
        self.states, self.parents, self.near = root[None].repeat(256, axis=0), [-1], np.full(256, np.inf)

    def add(self, states: np.ndarray, parent: int) -> int:
        """Add configurations one behind the other; the last one's number."""
        for state in states:
            count = len(self.parents)
            if count == len(self.states):
                self.states = np.concatenate([self.states, self.states])
                self.near = np.concatenate([self.near, np.full(count, np.inf)])
            self.states[count] = state
            self.parents.append(parent)
            parent = count
        return parent

    def nearest(self, state: np.ndarray) -> tuple[int, float]:
        """Number of the nearest configuration, and how far it is."""
        squares = ((self.states[: len(self.parents)] - state) ** 2).sum(axis=1)
        at = int(squares.argmin())
        return at, float(np.sqrt(squares[at]))

    def way(self, number: int) -> list[np.ndarray]:
        """From the root to one of them."""
        found = []
        while number >= 0:
            found.append(self.states[number])
            number = self.parents[number]
        return found[::-1]


def connect(motions: wb.arms.Motions, start, goal, *, seed: int = 0, reach: float = REACH, samples: int = SAMPLES):
    """A path from one configuration to another, as ``Found``.

    Args:
        motions: What proves motions.
        start: ``(n,)``.
        goal: ``(n,)``.
        seed: Of random configurations.
        reach: Length of a step, in joint values.
        samples: Random configurations, at most.
    """
    rng, lower, upper = np.random.default_rng(seed), motions.arm.lower, motions.arm.upper
    trees, asked = [_Tree(np.asarray(end, dtype=np.float64)) for end in (start, goal)], 0
    if motions.configurations([start, goal]).any():
        return Found(None, 0)

    def grow(tree: _Tree, target: np.ndarray, most: int, drawn: bool = False) -> int | None:
        """Number of the last configuration on the way to a target, after at most so many steps; ``None`` if none.

        A target that was drawn has to lie near a configuration from which a step has failed.
        """
        nonlocal asked
        at, length = tree.nearest(target)
        if drawn and length > tree.near[at]:
            return None
        way, count = target - tree.states[at], max(1, int(np.ceil(length / reach)))
        shares = np.arange(min(count, most) + 1)[:, None] / count
        steps = tree.states[at] + shares * way
        if count <= most:
            steps[-1] = target
        clear, _ = motions.segments(steps[:-1], steps[1:])
        asked += len(clear)
        free = len(clear) if clear.all() else int(np.argmin(clear))
        if not free:
            tree.near[at] = NEAR * reach
        return tree.add(steps[1 : 1 + free], at) if free else None

    for number in range(samples):
        target = trees[1].states[0] if number == 0 else rng.uniform(lower, upper)
        turn = len(trees[0].parents) > len(trees[1].parents)  # the smaller tree grows
        one, other = trees[::-1] if turn else trees
        if (new := grow(one, target, 1, drawn=number > 0)) is None:
            continue
        met = grow(other, one.states[new], 1000)
        if met is not None and (other.states[met] == one.states[new]).all():
            ways = one.way(new), other.way(met)
            first, second = ways[::-1] if turn else ways
            return Found(np.array([*first, *second[::-1][1:]]), asked)
    return Found(None, asked)


def shortened(motions: wb.arms.Motions, path: np.ndarray, *, seed: int = 0, rounds: int = SHORTCUTS) -> Found:
    """A shorter path: straight motions that are proven replace parts of it."""
    rng, asked = np.random.default_rng(seed), 0
    for _ in range(rounds):
        lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
        ends = np.concatenate([[0.0], np.cumsum(lengths)])
        places = np.sort(rng.uniform(0, ends[-1], (AT_ONCE, 2)), axis=1)
        if not asked:
            places[0] = 0.0, ends[-1]
        at = np.clip(np.searchsorted(ends, places, side="right") - 1, 0, len(lengths) - 1)
        share = (places - ends[at]) / np.maximum(lengths[at], 1e-300)
        q = path[at] + np.clip(share, 0, 1)[..., None] * (path[at + 1] - path[at])
        clear, _ = motions.segments(q[:, 0], q[:, 1])
        asked += len(clear)
        saved = np.where(clear, places[:, 1] - places[:, 0] - np.linalg.norm(q[:, 1] - q[:, 0], axis=1), 0.0)
        best = int(saved.argmax())
        if saved[best] > 1e-6 * ends[-1]:
            (i, j), (a, b) = at[best], q[best]
            shorter = np.concatenate([path[: i + 1], a[None], b[None], path[j + 1 :]])
            clear, _ = motions.segments(shorter[:-1], shorter[1:])  # what a new corner cuts is asked anew
            asked += len(clear)
            path = shorter if clear.all() else path
    return Found(path, asked)


def plan(motions: wb.arms.Motions, start, goal, *, seed: int = 0, **options) -> Found:
    """``connect``, then ``shortened``."""
    found = connect(motions, start, goal, seed=seed, **options)
    if found.path is None:
        return found
    shorter = shortened(motions, found.path, seed=seed)
    return Found(shorter.path, found.asked + shorter.asked)
