"""Training of a distance: F at most d everywhere, and as near below it as a small network can be.

What F exceeds the distance by at the worst place is its slack, and is taken off everywhere. So samples are of two
kinds. *Below*: random points of the domain, where each unit of ``d - F`` costs the same up to ``FAR`` from the
object, and farther away less, as does nothing in the object, where F may be anything below 0. *Above*: a pool of the
points where F exceeds the distance most, as far as they are known; random points and those around the worst ones are
labelled anew at every refresh, and now and then those that the proof's own search finds (``worst_points``). The
asymmetry grows while it trains, as in the recipe for points, and both sides get sharper.

In the object F is asked to be below a part of the depth with its sign turned, so that it has less of a bend to
follow at the border; thin parts are bounded more tightly without. In four dimensions and more it may fall short of
large distances by a share, which marches make up for with a few steps: boxes of a proof can then be larger there,
and these fill most of the domain.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from warp_bounding.bounders.mlp_distance import MlpDistance
from warp_bounding.proof.distances import worst_points
from warp_bounding.queries.boundary import border_points, held_points
from warp_bounding.runtime.progress import Progress
from warp_bounding.training.engine import (
    Clock,
    Evaluator,
    Soap,
    Team,
    TrainableNetwork,
    cosine,
    evaluated,
    geometric,
    interrupts,
    single_threaded_torch,
    summed,
    torch,
)
from warp_bounding.training.samples import Problem, Trained

# Initial gains of the first layer and of later ones: of sines, of sines from ``EASED_IN`` dimensions on, of ReLU. A 4D
# dragon had 12.2 % false positives at points after 200 s with a first gain of 7, and 11.9 % with 12.
GAINS, GAINS_OF_MANY, PLAIN_GAINS = (10.0, 3.0), (12.0, 3.0), (1.7, 1.7)
# Below that many dimensions the first layer's gain is this by the mean distance from a point of the domain to the
# object, local units, where that is more: a distance rises and falls over such a way. A maze with lanes of a tenth of
# its side learned nothing in 30 s with a gain of 10 (72 % false positives), and had 7 % with 25 to 40; bunny, star and
# rooms were as good or better with 20 to 25 as with 10.
FINENESS = 1.2
SURVEYED = 4096  # points that this mean is taken of
REFRESH = 100  # steps between two looks at new samples
LABELLED, MOST_LABELLED = 16_384, 1 << 20  # new points at a refresh, and kept in all
NEAR_SHARE = 0.5  # of these: near the border
NEAR = (2.0**-8, 2.0**-2)  # local units: how near, a standard deviation between these
MARKED = 0.5  # of the near ones: around what the shape names (``Shape.landmarks``), so that no small part is left out
# Of a point's depth in the object, by dimension, F is asked to be that much below 0. After as many steps, false
# positives at radius 0 with 0, 0.4 and 1 were 5.1, – and 7.3 % (rooms, 2D), 2.1, 2.2 and 2.8 (bunny, 3D), 7.0, 6.5 and
# 6.2 (cells of a dragon, 3D); of the 4D bunny the slack was 0.009 and 0.003 with 0 and 0.5; of the 4D dragon, 200 s,
# they were 11.9 and 11.7 % with 1 and 0.5.
DEPTHS, DEEPEST = {1: 0.0, 2: 0.0, 3: 0.4}, 0.5
# From so many dimensions on, F may fall short by this share of what a distance is above the second number, local units.
EASE, EASED_FROM, EASED_IN = 0.2, 0.05, 4
HARD, AROUND = 16_384, 8192  # the worst points kept, and points around them that are tried at a refresh
MOVES = (2.0**-10, 2.0**-3)  # local units: how far around them
# When the proof's own search looks for what random points do not find, used fractions; for what share of the budget,
# and at how many boxes at most; and how much more than the worst point known it looks for, local units.
SEARCHES, SEARCH_SHARE, SEARCHED, CLOSER = tuple(np.arange(0.4, 0.99, 0.05)), 0.02, 3e6, 3e-3
BATCH = 2048  # of each kind, a step
FAR = 0.25  # local units: up to this distance each unit of ``d - F`` costs the same
WEIGHT = (3.0, 300.0)  # of what is above against what is below, at the begin and the end of training
WIDTH = (2e-2, 1e-4)  # local units: in which both sides go from flat to steep
RAMP = 0.85  # used fraction at which both have reached their ends
RATE, RATE_END, WARM_UP = 1e-2, 1e-3, 0.02  # arguments of ``cosine``, the learning rate
BETA1, BETA2 = 0.95, 0.95
JUDGED = (0.0, 0.05, 0.1, 0.2)  # local units: radii at which false positives are counted to choose the best network


class DistanceTrainer:
    """A network in training."""

    def __init__(self, cls: type[MlpDistance], problem: Problem, hidden: tuple[int, ...], activation: str):
        shape, seed = problem.grid, problem.seed
        self.shape, self.domain, self.ndim = shape, problem.domain, shape.ndim
        self._cls, self._hidden = cls, hidden
        self.rng, self.generator = np.random.default_rng(seed), torch.Generator().manual_seed(seed)
        self.network = TrainableNetwork(shape.ndim, hidden, activation)
        self.team = Team()
        self.workers = [Evaluator(self.network) for _ in range(self.team.size)]
        self._known, self._marks = held_points(shape, HARD, self.rng), shape.landmarks()
        self._depth = DEPTHS.get(self.ndim, DEEPEST)
        self._ease = EASE if self.ndim >= EASED_IN else 0.0
        self._limit = self.domain.limit.astype(np.float64)
        gains = self._gains() if self.network.act.wave else PLAIN_GAINS
        self.network.initialise(*gains, self.generator)
        nothing = torch.empty(self.ndim, 0), torch.empty(0)
        self.points, self.hard = nothing, nothing
        self._best = (math.inf, self.network.flat.clone())
        # false positives over the judged radii, and the slack, at the last refresh
        self.rate, self.over = 1.0, math.inf

    def run(self, clock: Clock) -> None:
        """Train until the clock's budget is used up."""
        optimiser, searches = Soap(self.network.layers, BETA1, BETA2), list(SEARCHES)
        for step, used in clock.steps():
            if step % REFRESH == 0:
                if step and searches and used >= searches[0]:
                    searches.pop(0)
                    self._search(SEARCH_SHARE * clock.total if clock.timed else math.inf)
                self._refresh()
                clock.tell(used, f"FP {100 * self.rate:.1f} %, slack {self.over * self.domain.unit:.3g}")
            rate = cosine(RATE, RATE_END, WARM_UP, used)
            optimiser.step(self._gradients(min(used / RAMP, 1.0)), rate)
        self._refresh()

    def finish(self) -> dict[str, np.ndarray]:
        """Take the parameters with the fewest estimated false positives; returns them as a bounder stores them."""
        self.network.flat.copy_(self._best[1])
        return self.network.tensors()

    def _gains(self) -> tuple[float, float]:
        """Of the first and of later layers' weights, for waves; see ``FINENESS``."""
        if self.ndim >= EASED_IN:
            return GAINS_OF_MANY
        wanted = self._labelled(self.rng.uniform(-1, 1, (SURVEYED, self.ndim)) * self._limit)[1]
        away = wanted[wanted > 0]
        return (max(GAINS[0], FINENESS / float(away.mean())) if len(away) else GAINS[0]), GAINS[1]

    def _labelled(self, v: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
        """Columns and goals of F at points ``(N, n)``, local units: distances from above if known, else below."""
        v = np.clip(v, -self._limit, self._limit).astype(np.float32)
        x = self.domain.sample_at(v)
        low, high = self.shape.distances(x).T
        distance = np.where(np.isfinite(high), high, low) / self.domain.unit
        distance -= self._ease * np.maximum(distance - EASED_FROM, 0.0)
        held = distance <= 0
        if self._depth:
            distance[held] = -self._depth * self.shape.depth(x[held]) / self.domain.unit
        return torch.from_numpy(np.ascontiguousarray(v.T)), torch.from_numpy(distance.astype(np.float32))

    def _fresh(self) -> np.ndarray:
        """New random points of the domain, some near the border."""
        near = int(LABELLED * NEAR_SHARE)
        marked = int(near * MARKED) if len(self._marks) else 0
        border = border_points(self.shape, near - marked, self.rng, self._known, 2.0**-9)
        marks = self._marks[self.rng.integers(len(self._marks), size=marked)] if marked else border[:0]
        border = self.domain.to_local(np.concatenate([border, marks]))
        size = np.exp2(self.rng.uniform(*np.log2(NEAR), (near, 1)))
        anywhere = self.rng.uniform(-1, 1, (LABELLED - near, self.ndim)) * self._limit
        return np.concatenate([border + size * self.rng.standard_normal(border.shape), anywhere])

    def _refresh(self) -> None:
        fresh = self._labelled(self._fresh())
        if self.points[1].shape[0] < MOST_LABELLED:
            self.points = tuple(torch.cat(pair, -1) for pair in zip(self.points, fresh, strict=True))
            weight = torch.where(self.points[1] > 0, FAR / self.points[1].clamp(min=FAR), 0.0)
            self._chances = weight.cumsum(0)
        tried = fresh
        if self.hard[1].shape[0]:
            pick = self.rng.integers(self.hard[1].shape[0], size=AROUND)
            around = self.hard[0].T.double().numpy()[pick]
            size = np.exp2(self.rng.uniform(*np.log2(MOVES), (AROUND, 1)))
            around = self._labelled(around + size * self.rng.standard_normal(around.shape))
            tried = tuple(torch.cat(parts, -1) for parts in zip(fresh, around, self.hard, strict=True))
        above = self._evaluate(tried[0]) - tried[1]
        self.over, worst = float(above.max()), above.topk(min(HARD, len(above)))[1]
        self.hard = tried[0][:, worst], tried[1][worst]
        # the fresh points are half near the border, so this is no rate of any protocol; it only chooses
        inside, distance = self._evaluate(fresh[0]) - max(self.over, 0.0), fresh[1]
        rates = [((inside <= radius) & (distance > radius)).float().mean() for radius in JUDGED]
        self.rate = float(sum(rates)) / len(rates)
        if self.rate <= self._best[0]:
            self._best = (self.rate, self.network.flat.clone())

    def _search(self, seconds: float) -> None:
        """Add to the worst points those that the proof's own search finds."""
        met, now = max(self.over, 0.0), self.made(self.network.tensors())
        found = self._labelled(worst_points(now, self.shape, met, CLOSER, boxes=SEARCHED, budget=seconds))
        self.hard = tuple(torch.cat(parts, -1) for parts in zip(self.hard, found, strict=True))

    def made(self, tensors: dict[str, np.ndarray], device: str | None = "cpu") -> MlpDistance:
        """A bounder of some tensors, without a threshold."""
        sizes = {"hidden": list(self._hidden), "activation": self.network.act.name}
        return self._cls(self.domain, tensors, sizes, device)

    def _evaluate(self, v: torch.Tensor) -> torch.Tensor:
        return evaluated(self.team, self.workers, v, self.network.encode)

    def _gradients(self, used: float) -> list[torch.Tensor]:
        """Gradients of the loss on a random batch, one matrix a layer."""
        weight, width = geometric(*WEIGHT, used), geometric(*WIDTH, used)
        for worker in self.workers:
            worker.gradient.zero_()
        place = torch.rand(BATCH, generator=self.generator) * self._chances[-1]
        below = torch.searchsorted(self._chances, place).clamp_(max=len(self._chances) - 1)
        above = torch.randint(self.hard[1].shape[0], (BATCH,), generator=self.generator)

        def job(index: int, part: slice) -> None:
            worker = self.workers[index]
            kinds = (self.points, below, -1.0, weight**-0.5), (self.hard, above, 1.0, weight**0.5)
            for points, columns, sign, share in kinds:
                own = columns[part]
                x = self.network.encode(points[0].index_select(1, own))
                gap = worker.forward(x, keep=True) - points[1][own]
                worker.backward(x, torch.sigmoid(gap * (sign / width)).mul_(sign * share / BATCH))

        self.team.over(BATCH, job)
        return summed(self.workers)


def train_distance(
    cls: type[MlpDistance],
    problem: Problem,
    options: dict[str, Any],
    seconds: float,
    progress: Progress | None,
) -> Trained:
    """Train a network's distance, without a threshold; see ``Trainer``. Ctrl-C ends it, and the best is taken."""
    clock = Clock(seconds, options["steps"], progress)
    with single_threaded_torch():
        trainer = DistanceTrainer(cls, problem, tuple(options["hidden"]), options["activation"])
        interrupted = interrupts(lambda: trainer.run(clock))
        tensors = trainer.finish()
    return trainer.made(tensors, problem.device), {"steps": clock.count, "interrupted": interrupted}
