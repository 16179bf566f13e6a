"""Fitting networks: train, then set the threshold by a proof where there is one, else by a search and statistics.

Points are trained with the prover in the loop: now and then branch and bound looks for the least value of f on the
object, what it finds goes into training, and the last part of the budget is the proof itself. Planes' supports need
no labels, and their proof is short. A monotone network's boxes are trained and proven as points. Rays and boxes of
other networks are searched by an adversary first, whose least value the prover then has to meet; where it has no time
to, the adversary's threshold stands and fresh positives attest it. A network with exits is several networks that
share layers; each gets a threshold of its own, in the same way.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from warp_bounding.bounders.neural.mlp import RECIPES, Mlp
from warp_bounding.bounders.neural.mlp_early import MlpEarly, part_of
from warp_bounding.bounders.neural.monotone_mlp import MonotoneMlp
from warp_bounding.networks.heads import head_of
from warp_bounding.proof import Search, conjunction, least_value, prove
from warp_bounding.training.engine.adversary import adversarial_minimum
from warp_bounding.training.engine.clock import Clock, interrupts
from warp_bounding.training.engine.team import single_threaded_torch
from warp_bounding.training.engine.trainable_network import TrainableNetwork
from warp_bounding.training.problem import Problem
from warp_bounding.training.recipes.default import Trainer
from warp_bounding.training.recipes.early import EXIT_SHARE, EarlyTrainer, train_exits
from warp_bounding.training.recipes.monotone import LeastBoxSamples, MonotoneTrainer
from warp_bounding.training.recipes.occupancy import train_occupancy
from warp_bounding.training.recipes.paper import PaperTrainer
from warp_bounding.training.recipes.plane import SupportTrainer
from warp_bounding.training.samples import samples_of
from warp_bounding.training.samples.base import Samples
from warp_bounding.training.thresholds import Costs, decide, tolerance

__all__ = ["TRAINERS", "NetworkOptions", "fit_network"]

TRAINERS = dict(zip(RECIPES, (Trainer, PaperTrainer), strict=True))
SEARCHES = (0.4, 0.65, 0.9)  # used fractions at which the prover looks for counterexamples
LOOKS = (0.25, 0.5, 0.9)  # likewise, of rays and boxes
SEARCH_SHARE = 0.02  # of the budget, each
ADVERSARY_SHARE = 0.01  # of the budget, of each look that an adversary takes at rays and boxes before the prover does
MONOTONE_START = 0.2  # used fraction from which the prover looks at a monotone network at every refresh
MONOTONE_EPS, MONOTONE_BOXES = 0.1, 20_000  # and how closely: such a search takes a few hundred boxes
POINT_RESERVE, REGION_RESERVE = (
    0.03,
    0.15,
)  # of the budget: for what sets the threshold, before a search has told what it takes
LONG_PROOF_SHARE = 0.2  # reserved where the last search did not end in its time
LONG_RESERVE = 0.4  # likewise, before the prover has looked at rays or boxes: it is easier to give time back
MORE_FOR_EXITS = 0.4  # of that, for the thresholds of exits
LEAST_SHARE = 0.05  # of the budget: a proof gets this much, even where training took longer than it should
ATTEST_SECONDS = 2.5  # about what a million fresh positives take
SEARCH_BOXES, REGION_BOXES, PROOF_BOXES = (
    1_000_000,
    300_000,
    20_000_000,
)  # what takes the place of time in budgets of steps
SEARCH_ROUNDS = 12  # likewise, of the adversarial search
TRAINING_ROUNDS = 2  # of the adversarial search, each time in training
EXIT_STEPS = 40  # likewise, of each exit
LOOK_SHARE, LOOK_BOXES = (
    0.02,
    200_000,
)  # of the budget, or boxes, of each look of the prover at rays and boxes in training
MOST_ADDED = 256  # positives of such a look that become training samples
SETTLED_SHARE, SETTLED_SECONDS = 0.1, 20.0  # of the budget, at most: for the adversary, where a proof comes after it
LONGEST_PROOF = 0.6  # of the budget, of rays and boxes
LONG_PROOF = 0.3  # of the budget: where a proof is expected to take longer, weights decay,
DECAY, MOST_DECAY = 0.05, 0.2  # at this rate, and faster by as much as it is longer
WORTH_PROVING = 1e-2  # share of all queries: where a proof is expected to cost more, training keeps the time
HARDER = (4.2, 1.35)  # times as long as at a used fraction of 0 to 1 the proof of the last network takes
LATE_SHARE = 0.1  # of the budget: by so much a proof may end late, where to come less near saves next to no work
PLANE_TOLERANCE = 1e-3  # of a plane's offset, in domain half-widths

Progress = Callable[[float, float, str], None]


@dataclass(frozen=True)
class NetworkOptions:
    """What kind of network, and how long it may take; see ``fit``."""

    hidden: tuple[int, ...]
    activation: str
    budget: float
    steps: int | None = None
    octaves: int = 0
    recipe: str = RECIPES[0]

    @property
    def stored(self) -> dict:
        """The sizes that a bounder stores."""
        return {"hidden": list(self.hidden), "activation": self.activation, "octaves": self.octaves}


def fit_network(
    kind: type[Mlp], problem: Problem, options: NetworkOptions, progress: Progress | None = None
) -> tuple[Mlp, dict]:
    """Train a network and set its threshold.

    Args:
        kind: ``Mlp``, ``MlpEarly``, ``MonotoneMlp`` or ``Occupancy``.
        problem: What for.
        options: How.
        progress: Called with done, total and a note. Ctrl-C ends training; the best network so far is taken.

    Returns:
        The bounder, frozen, and a record of how it went.
    """
    return _Fit(kind, problem, options, progress).run()


class _Fit:
    """One fit: its clock and its progress."""

    def __init__(self, kind: type[Mlp], problem: Problem, options: NetworkOptions, progress: Progress | None):
        self.kind, self.problem, self.options, self.progress = kind, problem, options, progress
        self.clock = Clock(options.budget, options.steps)
        self.early = issubclass(kind, MlpEarly)
        self.monotone = issubclass(kind, MonotoneMlp)
        self.as_points = problem.domain.tested_as_point or self.monotone  # proven over the object's points
        self.supports = head_of(problem.query).outputs > 1
        self.reserve = POINT_RESERVE if self.as_points else REGION_RESERVE
        self.settled = min(SETTLED_SHARE * options.budget, SETTLED_SECONDS)
        self.interrupted, self.boxes = False, 0
        self.hopeful = not self.as_points and not self.supports  # rays and boxes: a proof is worth its time

    def run(self) -> tuple[Mlp, dict]:
        options, clock = self.options, self.clock
        exits = EXIT_SHARE * (len(options.hidden) - 1) if self.early else 0.0
        self.exit_seconds = exits * options.budget
        looks = self.hopeful and options.recipe == "default"  # the paper's recipe lets nobody look
        reserve = LONG_RESERVE if looks else self.reserve
        clock.reserved = reserve * (1 + MORE_FOR_EXITS * self.early) * options.budget + self.exit_seconds
        if not self.kind.conservative:
            clock.reserved = 0.0
            bounder, record = self._occupancy(), {}
        elif self.supports:
            bounder, record = self._supports()
        else:
            bounder, record = self._network()
        own = {"recipe": options.recipe, "steps": clock.count, "interrupted": self.interrupted}
        return bounder, own | {"boxes_in_training": self.boxes} | record

    # --- training ----------------------------------------------------------------------------------------------------

    def _occupancy(self) -> Mlp:
        problem, options = self.problem, self.options
        tensors = train_occupancy(
            problem.grid,
            problem.domain,
            options.hidden,
            options.activation,
            self.clock,
            octaves=options.octaves,
            seed=problem.seed,
            progress=lambda used, note: self._report(used, note),
        )
        return self.kind(problem.domain, tensors, options.stored, problem.device).freeze(0.0, None)

    def _supports(self) -> tuple[Mlp, dict]:
        problem, options = self.problem, self.options
        trainer = SupportTrainer(problem.grid, problem.domain, options.hidden, options.activation, problem.seed)
        exits = None
        with single_threaded_torch():
            self.interrupted = interrupts(lambda: trainer.run(self.clock, progress=self._report))
            tensors = trainer.tensors()
            if self.early:
                exits = train_exits(trainer, tensors, self.exit_seconds, self._exit_steps())
        parts = self._parts(tensors, exits.tensors if exits else {})
        for part in parts:
            self._report(1.0, "proof")
            search = prove(part, problem.grid, eps=PLANE_TOLERANCE, **self._limit(len(parts)))
        return self._whole(parts), {"gap": float(search.upper_bound - search.lower_bound)}

    def _network(self) -> tuple[Mlp, dict]:
        options = self.options
        samples = self._samples()
        joint = self.early and self.as_points  # elsewhere too few are denied early to pay for worse layers
        trainer_of = EarlyTrainer if joint else TRAINERS[options.recipe]
        if self.monotone:
            trainer = MonotoneTrainer(samples, options.hidden, options.activation)
        else:
            trainer = trainer_of(samples, options.hidden, options.activation, options.octaves)
        waiting = list(SEARCHES if self.as_points else LOOKS)

        def counterexamples(_, used: float) -> None:
            if self.monotone:
                if used >= MONOTONE_START:
                    self._counterexamples(trainer, used)
            elif waiting and waiting[0] <= used < 1:
                waiting.pop(0)
                if self.as_points:
                    self._counterexamples(trainer, used)
                else:
                    self._hard_positives(trainer, samples, used)

        exits = None
        with single_threaded_torch():
            self.interrupted = interrupts(
                lambda: trainer.run(self.clock, counterexamples=counterexamples, progress=self._report)
            )
            tensors = trainer.network.tensors(trainer.best())
            trainer.network.flat.copy_(trainer.best())
            if self.early:
                exits = train_exits(trainer, tensors, self.exit_seconds, self._exit_steps())
        parts = self._parts(tensors, exits.tensors if exits else {})
        networks = [*(exits.networks if exits else []), trainer.network]
        states = [*(exits.states if exits else []), trainer.hard_states()]
        points = [*(exits.points if exits else []), trainer.worst_points()]
        for index, part in enumerate(parts):
            if self.as_points:
                record = self._prove(part, points[index], len(parts) - index)
            else:
                record = self._decide(part, samples, networks[index], states[index], len(parts) - index)
        return self._whole(parts), record

    def _exit_steps(self) -> int | None:
        return None if self.clock.timed else EXIT_STEPS

    def _report(self, used: float, note: str) -> None:
        if self.progress:
            self.progress(min(used, 1.0) * (1 - self.reserve), 1.0, note)

    def _samples(self) -> Samples:
        problem = self.problem
        if not self.monotone:
            return samples_of(problem.grid, problem.domain, problem.seed)
        return LeastBoxSamples(problem.grid, problem.domain, torch.Generator().manual_seed(problem.seed))

    def _counterexamples(self, trainer: Trainer, used: float) -> None:
        """Let the prover look at the network as it is; its lowest points become training samples."""
        problem, clock, budget = self.problem, self.clock, self.options.budget
        kind = MonotoneMlp if self.monotone else Mlp
        bounder = kind(problem.domain, trainer.network.tensors(), self.options.stored, problem.device)
        limit = {"seconds": SEARCH_SHARE * budget} if clock.timed else {"boxes": SEARCH_BOXES}
        points = trainer.worst_points()
        if self.monotone:  # cheap and often: where f is steep, samples alone would take a network for better than it is
            eps, limit = MONOTONE_EPS, {"boxes": MONOTONE_BOXES}
        else:
            eps = tolerance(bounder, problem, points)
        search = least_value(bounder, problem.grid, eps=eps, points=points, **limit)
        self.boxes += search.boxes
        trainer.add(search.worst)
        if clock.timed:
            expected = min(max(_last_proof(search, used), 0.01 * budget), LONG_PROOF_SHARE * budget)
            clock.reserve(expected * (1 + MORE_FOR_EXITS * self.early) + self.exit_seconds)

    def _hard_positives(self, trainer: Trainer, samples: Samples, used: float) -> None:
        """Let adversary and prover look at the network as it is; the worst positives they find become training samples.

        What the prover gets done tells how much time its proof of the last network is worth.
        """
        budget, clock, problem = self.options.budget, self.clock, self.problem
        seconds = ADVERSARY_SHARE * budget if clock.timed else float("inf")
        found = adversarial_minimum(samples, trainer.network, seconds, trainer.hard_states(), rounds=TRAINING_ROUNDS)
        trainer.add_states(found.states)
        bounder = Mlp(problem.domain, trainer.network.tensors(), self.options.stored, problem.device)
        expected, self.hopeful = 0.0, bounder.provable
        if bounder.provable:
            costs, least = Costs(bounder, problem), float(bounder.reference(found.worst).min())
            eps = costs.room(least)
            limit = {"seconds": LOOK_SHARE * budget} if clock.timed else {"boxes": LOOK_BOXES}
            search = least_value(bounder, problem.grid, eps=eps, points=found.worst, **limit)
            self.boxes += search.boxes
            trainer.add_states(samples.spread(samples.at(search.numbers), MOST_ADDED))
            expected = _last_proof(search, used)
            if clock.timed:
                self.hopeful = costs.of_proof(least, eps, expected, LONGEST_PROOF * budget) <= WORTH_PROVING
                longer = expected / (LONG_PROOF * budget)
                if self.hopeful and longer > 1:
                    trainer.decay = max(trainer.decay, min(DECAY * longer, MOST_DECAY))
        if clock.timed:
            proof = min(expected, LONGEST_PROOF * budget) + self.settled if self.hopeful else self.reserve * budget
            clock.reserve(proof * (1 + MORE_FOR_EXITS * self.early) + self.exit_seconds, used)

    # --- thresholds --------------------------------------------------------------------------------------------------

    def _parts(self, tensors: dict[str, np.ndarray], exits: dict[str, np.ndarray]) -> list[Mlp]:
        """The exits as networks by themselves, and the network."""
        domain, sizes, device = self.problem.domain, self.options.stored, self.problem.device
        if not self.early:
            return [(MonotoneMlp if self.monotone else Mlp)(domain, tensors, sizes, device)]
        depths = range(1, len(self.options.hidden) + 1)
        return [Mlp(domain, *part_of(tensors | exits, sizes, depth), device) for depth in depths]

    def _whole(self, parts: list[Mlp]) -> Mlp:
        if not self.early:
            return parts[0]
        bounder = MlpEarly.of(parts)
        return bounder.freeze(float(bounder.threshold), conjunction([part.certificate for part in parts]))

    def _limit(self, parts_left: int) -> dict[str, float]:
        """Time, or boxes, of the next part's proof."""
        if not self.clock.timed:
            return {"boxes": PROOF_BOXES}
        left = (1 + LATE_SHARE) * self.options.budget - self.clock.seconds
        return {"seconds": max(left / parts_left, LEAST_SHARE * self.options.budget)}

    def _prove(self, part: Mlp, points: np.ndarray, parts_left: int) -> dict:
        self._report(1.0, "proof")
        eps = tolerance(part, self.problem, points)
        search = prove(part, self.problem.grid, eps=eps, points=points, **self._limit(parts_left))
        return {"gap": float(search.upper_bound - search.lower_bound)}

    def _decide(
        self, part: Mlp, samples: Samples, network: TrainableNetwork, states: torch.Tensor, parts_left: int
    ) -> dict:
        self._report(1.0, "adversarial search")
        budget, rounds = self.options.budget, {} if self.clock.timed else {"rounds": SEARCH_ROUNDS}
        left = ((1 + LATE_SHARE * self.hopeful) * budget - self.clock.seconds) / parts_left - ATTEST_SECONDS
        share = min(left, self.settled) if self.hopeful else left
        seconds = max(share, 0.05 * budget) if self.clock.timed else float("inf")
        found = adversarial_minimum(samples, network, seconds, states=states, **rounds)
        limits, least = {"boxes": REGION_BOXES}, LEAST_SHARE * budget
        if self.clock.timed:
            left -= found.seconds
            limits = {"seconds": max(left, least)} if self.hopeful or left > least else None
        record = decide(part, self.problem, found.worst, limits, lambda note: self._report(1.0, note))
        return record | {"search_seconds": round(found.seconds, 3), "search_complete": found.complete}


def _last_proof(search: Search, used: float) -> float:
    """Seconds that the proof of the last network is expected to take, by a search of the one at a used fraction: f gets steeper."""
    return (HARDER[0] + (HARDER[1] - HARDER[0]) * used) * (search.seconds if search.complete else search.needed)
