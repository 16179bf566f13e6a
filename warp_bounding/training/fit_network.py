"""Fitting networks: train, then set the threshold by a proof.

A network of points is trained with the prover in the loop: now and then branch and bound searches for the least f on
the object, and the points that it finds become samples. The last part of the budget is the proof itself. Support
functions of planes need no labels, and their proof is short. A network with exits is several networks that share
layers; each gets a threshold of its own, in the same way.

An arm's network is proven in another way, and so is any whose proof is left to workers: a search for the least f takes
far longer in many dimensions than a proof at a threshold that is known. So it trains without the prover, a walk finds a
low f, and ``prove_lower`` proves the highest threshold below it whose proof is expected to end in time.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_bounding.bounders.cascade import Lattice, Local
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.bounders.mlp_early import MlpEarly, part_of
from warp_bounding.errors import BounderError
from warp_bounding.networks.network import HEADS
from warp_bounding.proof import Search, conjunction, least_value, prove_or_test
from warp_bounding.proof.check import prove_lower
from warp_bounding.proof.prove import ROOM, least_found, prove_local
from warp_bounding.queries import oracle
from warp_bounding.rounding import round_down
from warp_bounding.runtime.progress import Progress
from warp_bounding.shapes.grid import Grid
from warp_bounding.training.engine import Clock, interrupts, single_threaded_torch
from warp_bounding.training.recipes.default import LocalTrainer, NetworkTrainer
from warp_bounding.training.recipes.early import EXIT_SHARE, EarlyTrainer, granted, train_exits
from warp_bounding.training.recipes.occupancy import OccupancyTrainer
from warp_bounding.training.recipes.plane import SupportTrainer
from warp_bounding.training.samples import Problem, Trained, samples_of

# Options of a network's training, in addition to its problem.


@dataclass(frozen=True)
class NetworkOptions:
    """What kind of network, and how long it may take; see ``fit``."""

    hidden: tuple[int, ...]
    activation: str
    budget: float
    steps: int | None = None
    parts: int = 1
    statistical: bool = False

    def __post_init__(self):
        if self.statistical and self.parts > 1:
            raise BounderError("parts are proven; statistical is for one threshold")

    @property
    def stored(self) -> dict:
        """The sizes that a bounder stores."""
        return {"hidden": list(self.hidden), "activation": self.activation}


# Shares are of the whole budget, used fractions are of the training time. Where the budget is in steps, numbers of
# boxes take the place of time, so that a fit is repeatable.


@dataclass(frozen=True)
class Schedule:
    """When training looks for the lowest positives, and what it leaves of the budget for what comes after it.

    Attributes:
        search_at: Used fractions at which the prover searches points.
        search_share: What a search may take, a share of the budget.
        search_boxes: The same as a number of boxes.
        reserve: For setting the threshold, until a search has measured that: a share, of points and of planes.
        least_reserve: The least that is reserved for the proof once a search has measured it: a share.
        most_reserve: The most, also of thresholds of parts: a share.
        lower_reserve: For the proof at a lower threshold: a share.
        tested_reserve: For fresh positives that test a threshold: a share.
        more_for_exits: By what share of itself a reserve for proofs is larger for a network with exits.
        grant_seconds: About what fitting a grant takes, seconds.
        exit_steps: Steps of Newton's method for each exit, where the budget is in steps.
        proof_growth: How many times as long the proof of the final network takes as that of the network at used
            fraction 0, and at 1; linear in between: f gets steeper while it trains. Both are empirical.
    """

    search_at: tuple[float, ...] = (0.4, 0.65, 0.9)
    search_share: float = 0.02
    search_boxes: int = 1_000_000
    reserve: tuple[float, float] = (0.03, 0.15)
    least_reserve: float = 0.01
    most_reserve: float = 0.2
    lower_reserve: float = 2 / 3
    tested_reserve: float = 0.3
    more_for_exits: float = 0.4
    grant_seconds: float = 1.0
    exit_steps: int = 40
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
        plane_gap: The gap at which the proof of planes ends, in domain half-widths of a plane's offset.
        finest: Least gap that is required, in f.
        usual: Gap in f that is required where too few negatives lie below to measure its cost.
    """

    least_share: float = 0.05
    overtime: float = 0.1
    boxes: int = 20_000_000
    cost: float = 1e-4
    plane_gap: float = 1e-3
    finest: float = 1e-6
    usual: float = 1e-3


SCHEDULE, LIMITS = Schedule(), ProofLimits()
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


def lattice_of(problem: Problem, count: int) -> Lattice:
    """Parts of the domain, at most ``count`` and about as many, as nearly cubes as whole counts along axes allow."""
    shape, domain = problem.grid, problem.domain
    lower, upper = shape.lower, shape.upper
    if isinstance(shape, Grid):
        cells = shape.occupied
        lower, upper = shape.position(cells.min(axis=0) - 0.5), shape.position(cells.max(axis=0) + 0.5)
    low, high = domain.to_local(lower), domain.to_local(upper)
    counts = np.ones(len(low), dtype=int)
    while True:  # one more along the axis with the longest parts, as long as there are no more than ``count``
        longest = np.argsort(-(high - low) / counts)
        grown = [counts + (np.arange(len(counts)) == axis) for axis in longest]
        fitting = next((g for g in grown if g.prod() <= count), None)
        if fitting is None:
            return Lattice.of(low, high, tuple(int(c) for c in counts))
        counts = fitting


def negatives_of(problem: Problem) -> np.ndarray:
    """``(N, ndim)`` coordinates v of random queries that are certainly no positives, and that reach the bounder."""
    x = problem.sample(SAMPLES, np.random.default_rng(0))
    truth = oracle(problem.query, problem.grid, "cpu", problem.domain.oracle_length)(x)
    v = problem.domain.to_local(x[~truth & problem.reaching(x)])
    return v[(np.abs(v) <= problem.domain.limit).all(axis=1)]


def fit_network(
    method: type[Mlp], problem: Problem, options: dict[str, Any], seconds: float, progress: Progress | None
) -> Trained:
    """Train a network and set its threshold (``fit.Trainer``); Ctrl-C ends training, and the best is taken."""
    return _Fit(method, problem, NetworkOptions(budget=seconds, **options), progress).run()


class _Fit:
    """One fit.

    ``of_planes``: the network is a plane's two supports (``Head``); else queries are points. ``first_reserve``: the
    share of the budget reserved for setting the threshold until a search has measured what that takes; the user's
    progress counts the rest as training.
    """

    def __init__(self, method: type[Mlp], problem: Problem, options: NetworkOptions, progress: Progress | None):
        self.method, self.problem, self.options = method, problem, options
        self.early = issubclass(method, MlpEarly)
        self.of_planes = HEADS[problem.query].outputs > 1
        self.lattice = lattice_of(problem, options.parts) if options.parts > 1 else None
        grid, tested = problem.grid, options.statistical or not problem.grid.certified
        of_shape = not (self.of_planes or tested or isinstance(grid, Grid)) and self.lattice is None
        self.lowers = of_shape and (grid.joints is not None or problem.scheduler is not None)
        self.first_reserve = SCHEDULE.reserve[self.of_planes]
        if self.lowers or (tested and not self.of_planes):
            self.first_reserve = SCHEDULE.lower_reserve if self.lowers else SCHEDULE.tested_reserve
        self.clock = Clock(options.budget, options.steps, progress, 1 - self.first_reserve)
        self.interrupted, self.boxes = False, 0

    def run(self) -> Trained:
        options, clock = self.options, self.clock
        exits = (len(options.hidden) - 1) * self.early
        self.exit_seconds = EXIT_SHARE * exits * options.budget
        self.grant_seconds = min(SCHEDULE.grant_seconds * exits, EXIT_SHARE * options.budget)
        if self.method.conservative:
            clock.reserved = self._reserved(self.first_reserve * options.budget)
        trainer, exits, exit_trainers = self._trainer(), {}, []
        waiting = [] if self.of_planes else list(SCHEDULE.search_at)

        def mine(used: float) -> None:
            if waiting and waiting[0] <= used < 1:
                waiting.pop(0)
                self._mine(trainer, used)

        with single_threaded_torch():
            self.interrupted = interrupts(lambda: trainer.run(clock, mine))
            tensors = trainer.finish()
            if self.early:
                steps = None if clock.timed else SCHEDULE.exit_steps
                exits, exit_trainers = train_exits(trainer, tensors, self.exit_seconds, steps)
        if self.method.conservative:
            bounder, record = self._settled(tensors | exits, [*exit_trainers, trainer])
        else:
            bounder, record = self._bounder(self.method, tensors).freeze(0.0, None), {}
        own = {"steps": clock.count, "interrupted": self.interrupted}
        return bounder, own | {"boxes_in_training": self.boxes} | record

    def _reserved(self, for_proof: float) -> float:
        """Seconds that training leaves for the proof and what comes before it."""
        return for_proof * (1 + SCHEDULE.more_for_exits * self.early) + self.exit_seconds + self.grant_seconds

    def _trainer(self) -> NetworkTrainer | SupportTrainer | OccupancyTrainer:
        problem, sizes = self.problem, (self.options.hidden, self.options.activation)
        if not self.method.conservative:
            return OccupancyTrainer(problem, *sizes)
        if self.of_planes:
            return SupportTrainer(problem, *sizes)
        samples = samples_of(problem.grid, problem.domain, problem.seed)
        samples.callers = problem.callers
        if self.lattice is not None:
            return LocalTrainer(samples, *sizes, lattice=self.lattice)
        return (EarlyTrainer if self.early else NetworkTrainer)(samples, *sizes)

    def _bounder(self, method: type[Mlp], tensors: dict[str, np.ndarray]) -> Mlp:
        return method(self.problem.domain, tensors, self.options.stored, self.problem.device)

    def _mine(self, trainer: NetworkTrainer, used: float) -> None:
        """Let the prover search the network as it is; the lowest points that it finds become training samples."""
        if not self.problem.grid.certified or self.options.statistical or self.lowers:
            return
        problem, clock, budget = self.problem, self.clock, self.options.budget
        bounder = self._bounder(Mlp, trainer.network.tensors())
        limit = {"budget": SCHEDULE.search_share * budget} if clock.timed else {"boxes": SCHEDULE.search_boxes}
        points = trainer.worst_points()
        eps = tolerance(bounder, problem, points)
        search = least_value(bounder, problem.grid, eps=eps, points=points, **limit)
        self.boxes += search.boxes
        trainer.add(search.worst)
        if clock.timed:
            expected = max(final_proof_seconds(search, used), SCHEDULE.least_reserve * budget)
            expected = min(expected if self.lattice is None else math.inf, SCHEDULE.most_reserve * budget)
            clock.reserve(self._reserved(expected))

    # --- thresholds --------------------------------------------------------------------------------------------------

    def _settled(
        self, tensors: dict[str, np.ndarray], trainers: list[NetworkTrainer] | list[SupportTrainer]
    ) -> tuple[Mlp, dict]:
        """The bounder with the threshold of each part, and the last part's record: that part is the whole network.

        The other parts are the exits as networks of their own, in order of depth.
        """
        sizes, depth = self.options.stored, len(self.options.hidden)
        depths = range(depth - len(trainers) + 1, depth + 1)
        held = [part_of(tensors, sizes, depth) for depth in depths]
        parts = [Mlp(self.problem.domain, *each, self.problem.device) for each in held]
        if self.problem.target is not None:
            parts = [part.rebased(self.problem.target) for part in parts]
        if self.lattice is not None:
            return self._prove_local(parts[0], trainers[0])
        for left, (part, trainer) in zip(range(len(parts), 0, -1), zip(parts, trainers, strict=True), strict=True):
            record = self._prove(part, trainer, left)
        if not self.early:
            return parts[0], record
        bounder = MlpEarly.of(parts)
        bounder.freeze(float(bounder.threshold), conjunction([part.certificate for part in parts]))
        self.clock.tell(1.0, "grants")
        with single_threaded_torch():
            return granted(bounder, self.problem), record

    def _limit(self, parts_left: int) -> dict[str, float]:
        """Limit of the next part's proof: seconds, or boxes."""
        if not self.clock.timed:
            return {"boxes": LIMITS.boxes}
        left = (1 + LIMITS.overtime) * self.options.budget - self.clock.seconds - self.grant_seconds
        least = SCHEDULE.lower_reserve / 2 if self.lowers else LIMITS.least_share  # without a proof there is nothing
        return {"budget": max(left / parts_left, least * self.options.budget)}

    def _prove(self, part: Mlp, trainer: NetworkTrainer | SupportTrainer, parts_left: int) -> dict:
        self.clock.tell(1.0, "proof")
        points, grid = self._moved(trainer.worst_points()), self.problem.grid
        limit = self._limit(parts_left)
        if self.lowers:
            least = least_found(part, grid, self.problem.seed, points)
            part.freeze(float(round_down(least - 2 * part.rounding_bound() - ROOM)), None)
            self.clock.go_on("estimating how long a proof takes")
            found = prove_lower(part, grid, scheduler=self.problem.scheduler, progress=self._proven, **limit)
            part.freeze(float(found.threshold), found.certificate)
            return {"gap": least - float(found.threshold), "complete": True}
        eps = LIMITS.plane_gap if self.of_planes else tolerance(part, self.problem, points)
        limit |= {"eps": eps, "points": points, "statistical": self.options.statistical, "progress": self._searched}
        search = prove_or_test(part, grid, seed=self.problem.seed, **limit)
        if search is None:
            return {"gap": eps}
        return {"gap": float(search.upper_bound - search.lower_bound), "complete": search.complete}

    def _proven(self, done: float, total: float) -> None:
        """Say how a proof at a threshold goes."""
        self.clock.go_on(f"proof, {done / total:.1%} of the volume")

    def _searched(self, boxes: int, _: float, gap: float) -> None:
        """Say how a search for the least f goes."""
        self.clock.go_on(f"proof, {boxes:,} boxes, gap {gap:.2g}")

    def _moved(self, v: np.ndarray) -> np.ndarray:
        """Coordinates ``(N, ndim)`` of the domain that it was trained in, in the one where it is to be used."""
        target = self.problem.target
        return v if target is None else target.to_local(self.problem.domain.to_object(v))

    def _prove_local(self, member: Mlp, trainer: LocalTrainer) -> tuple[Local, dict]:
        self.clock.tell(1.0, "proof of every part")
        problem, points, lattice = self.problem, self._moved(trainer.worst_points()), self.lattice
        eps = tolerance(member, problem, points)
        negatives = self._moved(negatives_of(problem))
        if problem.target is not None:
            lattice = lattice.moved(self._moved)
        bounder, search = prove_local(
            member, lattice, problem.grid, negatives, points=points, eps=eps, progress=self._searched, **self._limit(1)
        )
        return bounder, {"gap": eps, "thresholds": self.lattice.count, "complete": search.complete}
