"""Plans of which every motion is proven free: RRT-Connect (Kuffner and LaValle 2000) that asks ``Motions`` in batches.

The smaller of two trees takes a step towards each of some random configurations; the other one goes on towards the new
configurations until it arrives or something is in the way. Half of the random configurations are drawn near the tree
that grows: one deep in a shelf finds no way out by targets from everywhere. Then shortcuts: of random pairs of places
along the path those whose straight motion is proven replace what lies between.

What this does not do: find the shortest path, or heed velocities.
"""

from typing import NamedTuple

import numpy as np

import warp_bounding as wb

__all__ = ["Found", "connect", "plan", "shortened"]

STEP = 1.0  # in joint values: a proof costs about the same for a long motion as for a short one
SAMPLES, TOGETHER = 400_000, 16  # random configurations, at most, and how many are drawn together
NEAR = 4.0  # in joint values: how far from a configuration of the tree are those that are drawn near it, about
SHORTCUTS, AT_ONCE = 8, 16  # rounds of shortcuts, and how many are asked together


class Found(NamedTuple):
    """A path ``(W, n)``, and how many motions were asked; ``None`` without a path."""

    path: np.ndarray | None
    asked: int


class _Tree:
    """Configurations, each with the number of the one that it was reached from."""

    def __init__(self, root: np.ndarray):
        self.states, self.parents, self.count = np.empty((256, len(root))), np.empty(256, dtype=int), 0
        self.add(root[None], -1)

    def add(self, states: np.ndarray, parent: int) -> int:
        """Add configurations one behind the other; the last one's number."""
        old, self.count = self.count, self.count + len(states)
        if self.count > len(self.parents):
            self.states = np.concatenate([self.states, np.empty((self.count, self.states.shape[1]))])
            self.parents = np.concatenate([self.parents, np.empty(self.count, dtype=int)])
        self.states[old : self.count], self.parents[old : self.count] = states, np.arange(old, self.count) - 1
        self.parents[old] = parent
        return self.count - 1

    def nearest(self, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Number of the configuration that is nearest to each target, and how far it is."""
        states = self.states[: self.count]
        at = (np.einsum("ij,ij->i", states, states) - 2 * targets @ states.T).argmin(axis=1)
        return at, np.linalg.norm(targets - states[at], axis=1)

    def way(self, number: int) -> list[np.ndarray]:
        """From the root to one of them."""
        found = []
        while number >= 0:
            found.append(self.states[number])
            number = self.parents[number]
        return found[::-1]


def connect(motions: wb.arms.Motions, start, goal, *, seed: int = 0, step: float = STEP, samples: int = SAMPLES):
    """A path from one configuration to another, as ``Found``.

    Args:
        motions: What proves motions.
        start: ``(n,)``.
        goal: ``(n,)``.
        seed: Of random configurations.
        step: Length of a step, in joint values.
        samples: Random configurations, at most.
    """
    rng, lower, upper = np.random.default_rng(seed), motions.arm.lower, motions.arm.upper
    trees, asked = [_Tree(np.asarray(end, dtype=np.float64)) for end in (start, goal)], 0
    if motions.configurations([start, goal]).any():
        return Found(None, 0)

    def grow(tree: _Tree, targets: np.ndarray, most: int | None = None) -> list[int]:
        """Number of the last configuration on the way to each target, after at most so many steps; -1 if none."""
        nonlocal asked
        ways, nearest = [], tree.nearest(targets)
        for target, at, length in zip(targets, *nearest, strict=True):
            count = max(1, int(np.ceil(length / step)))
            shares = np.arange(min(count, most or count) + 1)[:, None] / count
            way = tree.states[at] + shares * (target - tree.states[at])
            if len(way) > count:
                way[-1] = target
            ways.append(way)
        clear, _ = motions.segments(np.concatenate([way[:-1] for way in ways]), np.concatenate([w[1:] for w in ways]))
        asked += len(clear)
        last, begun = [], 0
        for at, way in zip(nearest[0], ways, strict=True):
            proven = clear[begun : begun + len(way) - 1]
            begun += len(proven)
            free = len(proven) if proven.all() else int(np.argmin(proven))
            last.append(tree.add(way[1 : 1 + free], at) if free else -1)
        return last

    for number in range(max(1, samples // TOGETHER)):
        turn = trees[0].count > trees[1].count
        one, other = trees[::-1] if turn else trees
        targets = rng.uniform(lower, upper, (TOGETHER, len(lower)))
        near = one.states[rng.integers(one.count, size=TOGETHER // 2)]
        targets[: len(near)] = np.clip(near + rng.normal(0, NEAR / np.sqrt(len(lower)), near.shape), lower, upper)
        if number == 0:
            targets[0] = other.states[0]
        new = [each for each in grow(one, targets, 1) if each >= 0]
        for a, b in zip(new, grow(other, one.states[new]) if new else [], strict=True):
            if b >= 0 and (other.states[b] == one.states[a]).all():
                ways = one.way(a), other.way(b)
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
