"""Fitting networks: train, then set the threshold by a proof.

A network of points is trained with the prover in the loop: now and then branch and bound searches for the least f on
the object, and the points that it finds become samples. The last part of the budget is the proof itself.

An arm's network is proven in another way, and so is any whose proof is left to workers: a search for the least f takes
far longer in many dimensions than a proof at a threshold that is known. So it trains without the prover, a walk finds a
low f, and ``prove_lower`` proves the highest threshold below it whose proof is expected to end in time.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_bounding.activations import DEFAULT, RELU, SINE
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.proof import Search, least_value, prove_or_test
from warp_bounding.proof.lowering import prove_lower
from warp_bounding.proof.prove import BELOW_FOUND, least_found
from warp_bounding.queries import oracle
from warp_bounding.rounding import round_down
from warp_bounding.runtime.progress import Progress
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.shape import Shape
from warp_bounding.training.engine import Clock, interrupts, single_threaded_torch
from warp_bounding.training.recipe import NetworkTrainer, OccupancyTrainer
from warp_bounding.training.samples import Problem, Samples, Trained, samples_of

# Options of a network's training, in addition to its problem.


@dataclass(frozen=True)
class NetworkOptions:
    """What kind of network, and how long it may take; see ``fit``. Without an activation trials find one."""

    hidden: tuple[int, ...]
    activation: str | None
    budget: float
    steps: int | None = None
    statistical: bool = False


# Shares are of the whole budget, used fractions are of the training time. Where the budget is in steps, numbers of
# boxes take the place of time, so that a fit is repeatable.


@dataclass(frozen=True)
class Schedule:
    """When training looks for the lowest positives, and what it leaves of the budget for what comes after it.

    Attributes:
        search_at: Used fractions at which the prover searches points.
        search_share: What a search may take, a share of the budget.
        search_boxes: The same as a number of boxes.
        reserve: For setting the threshold, until a search has measured that: a share.
        least_reserve: The least that is reserved for the proof once a search has measured it: a share.
        most_reserve: The most: a share.
        lower_reserve: For the proof at a lower threshold: a share.
        tested_reserve: For fresh positives that test a threshold: a share.
        proof_growth: How many times as long the proof of the final network takes as that of the network at used
            fraction 0, and at 1; linear in between: f gets steeper while it trains. Both are empirical.
    """

    search_at: tuple[float, ...] = (0.4, 0.65, 0.9)
    search_share: float = 0.02
    search_boxes: int = 1_000_000
    reserve: float = 0.03
    least_reserve: float = 0.01
    most_reserve: float = 0.2
    lower_reserve: float = 2 / 3
    tested_reserve: float = 0.3
    proof_growth: tuple[float, float] = (4.2, 1.35)


@dataclass(frozen=True)
class ProofLimits:
    """When a proof may end.

    Attributes:
        least_share: What it gets even if training took longer than it should: a share of the budget.
        overtime: By how much it may exceed the budget, a share: ending earlier would loosen the threshold and save
            little time.
        boxes: The number of boxes at which it ends, where the budget is in steps.
        cost: The share of all queries that may become false positives by the gap that a complete search of points
            leaves.
        finest: Least gap that is required, in f.
        usual: Gap in f that is required where too few negatives lie below to measure its cost.
    """

    least_share: float = 0.05
    overtime: float = 0.1
    boxes: int = 20_000_000
    cost: float = 1e-4
    finest: float = 1e-6
    usual: float = 1e-3


SCHEDULE, LIMITS = Schedule(), ProofLimits()
# Activations that are tried where none is asked for, each in a training of this share of the budget. A trial is as good
# as nothing below so many steps.
TRIED, TRIAL_SHARE, FEWEST_STEPS = (SINE.name, RELU.name), 0.1, 100
SAMPLES = 200_000  # random queries by which the cost of a gap is estimated


def final_proof_seconds(search: Search, used: float) -> float:
    """Seconds expected for the proof of the final network, by a search of the one at a used fraction of its training.

    Infinity where that search did not end.
    """
    begin, end = SCHEDULE.proof_growth
    return (begin + (end - begin) * used) * search.seconds if search.complete else math.inf


def tolerance(bounder: Mlp, problem: Problem, worst: np.ndarray) -> float:
    """How far below the least f of some positives ``(N, ndim)`` a threshold may lie, by ``LIMITS.cost``."""
    x, least = problem.sample(SAMPLES, np.random.default_rng(0)), float(bounder.reference(worst).min())
    truth = oracle(problem.query, problem.grid, bounder.device, bounder.domain.oracle_length)(x)
    values = bounder.values(x).numpy()[~truth & problem.reaching(x)]
    values = np.sort(values[np.isfinite(values)])
    place, count = np.searchsorted(values, least), int(LIMITS.cost * SAMPLES)
    return max(least - float(values[place - count - 1]), LIMITS.finest) if place > count else LIMITS.usual


def fit_network(
    method: type[Mlp], problem: Problem, options: dict[str, Any], seconds: float, progress: Progress | None
) -> Trained:
    """Train a network and set its threshold (``fit.Trainer``); Ctrl-C ends training, and the best is taken."""
    return _Fit(method, problem, NetworkOptions(budget=seconds, **options), progress).run()


def _least(trainer: NetworkTrainer) -> float:
    """Its fewest false positives so far, a share."""
    return trainer.least


def tries(shape: Shape, steps: int | None) -> bool:
    """Whether activations are tried: where there is time for it, and of no arms, whose waves are sines."""
    short = steps is not None and steps * TRIAL_SHARE < FEWEST_STEPS
    return shape.waves is None and not short


class _Fit:
    """One fit.

    ``first_reserve``: the share of the budget reserved for setting the threshold until a search has measured what that
    takes; the user's progress counts the rest as training. ``trials`` are of short trainings, on the same ``samples``
    as the ``trainer``.
    """

    def __init__(self, method: type[Mlp], problem: Problem, options: NetworkOptions, progress: Progress | None):
        self.method, self.options = method, options
        grid, tested = problem.grid, options.statistical or not problem.grid.certified
        of_shape = not (tested or isinstance(grid, Grid))
        self.lowers = of_shape and (grid.joints is not None or problem.scheduler is not None)
        self.first_reserve = SCHEDULE.reserve
        if self.lowers or tested:
            self.first_reserve = SCHEDULE.lower_reserve if self.lowers else SCHEDULE.tested_reserve
        self.clock = Clock(options.budget, options.steps, progress, 1 - self.first_reserve)
        self.problem, self.interrupted, self.boxes = problem, False, 0
        self.samples: Samples | None = None
        self.trials: list[NetworkTrainer] = []
        self.trainer: NetworkTrainer | OccupancyTrainer | None = None

    def run(self) -> Trained:
        if self.method.conservative:
            self.clock.reserved = self.first_reserve * self.options.budget
        with single_threaded_torch():
            self.interrupted = interrupts(self._train)
            if (trainer := self.trainer) is None:  # nothing has been learned yet
                raise KeyboardInterrupt
            if self.interrupted and self.trials:
                trainer = min([*self.trials, trainer], key=_least)
            bounder = self._bounder(self.method, trainer, trainer.finish())
        record = self._prove(bounder, trainer) if self.method.conservative else {}
        own = {"steps": self.clock.count, "interrupted": self.interrupted}
        if self.trials:
            own["trials"] = {each.activation: each.least for each in self.trials}
        return bounder, own | {"boxes_in_training": self.boxes} | record

    def _train(self) -> None:
        """Train with the activation that is asked for, or with the one that did best in a trial."""
        activation = self.options.activation or self._tried()
        trainer = self.trainer = self._trainer(activation)
        waiting = list(SCHEDULE.search_at)

        def mine(used: float) -> None:
            if waiting and waiting[0] <= used < 1:
                waiting.pop(0)
                self._mine(trainer, used)

        trainer.run(self.clock, mine)

    def _tried(self) -> str:
        """The activation whose short training leaves the fewest false positives; the default where none is worth it."""
        if not tries(self.problem.grid, self.options.steps):
            return DEFAULT.name
        for name in TRIED:
            self.trainer = self._trainer(name)
            self.trials.append(self.trainer)
            self.trainer.run(self.clock.trial(TRIAL_SHARE))
        return min(self.trials, key=_least).activation

    def _trainer(self, activation: str) -> NetworkTrainer | OccupancyTrainer:
        problem, hidden = self.problem, self.options.hidden
        if not self.method.conservative:
            return OccupancyTrainer(problem, hidden, activation)
        if self.samples is None:
            reaching = problem.reaching if problem.front else None
            self.samples = samples_of(problem.grid, problem.domain, problem.seed, reaching)
            self.samples.callers = problem.callers
        return NetworkTrainer(self.samples, hidden, activation)

    def _bounder(self, method: type[Mlp], trainer, tensors: dict[str, np.ndarray]) -> Mlp:
        sizes = {"hidden": list(self.options.hidden), "activation": trainer.activation}
        return method(self.problem.domain, tensors, sizes, self.problem.device)

    def _mine(self, trainer: NetworkTrainer, used: float) -> None:
        """Let the prover search the network as it is; the lowest points that it finds become training samples."""
        if not self.problem.grid.certified or self.options.statistical or self.lowers:
            return
        problem, clock, budget = self.problem, self.clock, self.options.budget
        bounder = self._bounder(Mlp, trainer, trainer.network.tensors())
        limit = {"budget": SCHEDULE.search_share * budget} if clock.timed else {"boxes": SCHEDULE.search_boxes}
        points = trainer.worst_points()
        eps = tolerance(bounder, problem, points)
        search = least_value(bounder, problem.grid, eps=eps, points=points, **limit)
        self.boxes += search.boxes
        trainer.add(search.worst)
        if clock.timed:
            expected = max(final_proof_seconds(search, used), SCHEDULE.least_reserve * budget)
            expected = min(expected, SCHEDULE.most_reserve * budget)
            clock.reserve(expected)

    # --- the threshold -----------------------------------------------------------------------------------------------

    def _limit(self) -> dict[str, float]:
        """Limit of the proof: seconds, or boxes."""
        if not self.clock.timed:
            return {"boxes": LIMITS.boxes}
        left = (1 + LIMITS.overtime) * self.options.budget - self.clock.seconds
        least = SCHEDULE.lower_reserve / 2 if self.lowers else LIMITS.least_share  # without a proof there is nothing
        return {"budget": max(left, least * self.options.budget)}

    def _prove(self, bounder: Mlp, trainer: NetworkTrainer) -> dict:
        """Set the threshold; a record of how."""
        self.clock.tell(1.0, "proof")
        points, grid = trainer.worst_points(), self.problem.grid
        limit = self._limit()
        if self.lowers:
            least = least_found(bounder, grid, self.problem.seed, points)
            bounder.freeze(float(round_down(least - 2 * bounder.rounding_bound() - BELOW_FOUND)), None)
            self.clock.go_on("estimating how long a proof takes")
            found = prove_lower(bounder, grid, scheduler=self.problem.scheduler, progress=self._proven, **limit)
            bounder.freeze(float(found.threshold), found.certificate)
            return {"gap": least - float(found.threshold), "complete": True}
        eps = tolerance(bounder, self.problem, points)
        limit |= {"eps": eps, "points": points, "statistical": self.options.statistical, "progress": self._searched}
        search = prove_or_test(bounder, grid, seed=self.problem.seed, **limit)
        if search is None:
            return {"gap": eps}
        return {"gap": float(search.upper_bound - search.lower_bound), "complete": search.complete}

    def _proven(self, done: float, total: float) -> None:
        """Say how a proof at a threshold goes."""
        self.clock.go_on(f"proof, {done / total:.1%} of the volume")

    def _searched(self, boxes: int, _: float, gap: float) -> None:
        """Say how a search for the least f goes."""
        self.clock.go_on(f"proof, {boxes:,} boxes, gap {gap:.2g}")
