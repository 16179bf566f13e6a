"""Fitting networks: train, then set the threshold by a proof where there is one, else by a search and statistics.

A network of points is trained with the prover in the loop: now and then branch and bound looks for the least f on the
object, and the points that it finds become samples. The last part of the budget is the proof itself. A monotone
network's boxes are decided by single points of the object (see ``monotone_mlp``), so it is trained and proven in the
same way. Planes' supports need no labels, and their proof is short. Networks of rays and of other boxes are first
searched by an adversary, and the prover then tries to show that nothing lies below what it found. Where there is no
time for that, the adversary's value sets the threshold and fresh positives attest it. A network with exits is several
networks that share layers; each gets a threshold of its own, in the same way.
"""

from functools import partial
from typing import Any

import numpy as np

from warp_bounding.bounders.mlp import RECIPES, Local, Mlp, MonotoneMlp
from warp_bounding.bounders.mlp_early import MlpEarly, part_of
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.networks.heads import head_of
from warp_bounding.proof import conjunction, least_value, prove_or_attest
from warp_bounding.proof.local import prove_local
from warp_bounding.runtime.progress import Progress
from warp_bounding.training.engine.adversary import Adversary, adversarial_minimum
from warp_bounding.training.engine.clock import Clock, interrupts
from warp_bounding.training.engine.team import single_threaded_torch
from warp_bounding.training.network_options import NetworkOptions
from warp_bounding.training.problem import Problem, Trained
from warp_bounding.training.proof_time import (
    HOPEFUL,
    MOST_REGION_PROOF,
    MOST_SHAPE_PROOF,
    UNTOLD,
    WORTH_PROVING,
    attest_seconds,
    decay_for,
    final_proof_seconds,
)
from warp_bounding.training.recipes.default import NetworkTrainer
from warp_bounding.training.recipes.early import EXIT_SHARE, EarlyTrainer, train_exits
from warp_bounding.training.recipes.grants import granted
from warp_bounding.training.recipes.local import LocalTrainer
from warp_bounding.training.recipes.monotone import MonotoneTrainer
from warp_bounding.training.recipes.occupancy import OccupancyTrainer
from warp_bounding.training.recipes.paper import PaperTrainer
from warp_bounding.training.recipes.plane import SupportTrainer
from warp_bounding.training.samples import samples_of
from warp_bounding.training.samples.base import Samples
from warp_bounding.training.samples.least_box import least_boxes
from warp_bounding.training.thresholds import Costs, decide, decide_parts, lattice_of, negatives_of, tolerance

__all__ = ["RECIPE_TRAINERS", "fit_network"]

# By the recipe's name; exits, monotone networks, planes and occupancies have trainers of their own (``_trainer``).
RECIPE_TRAINERS = dict(zip(RECIPES, (NetworkTrainer, PaperTrainer), strict=True))
# Shares are of the whole budget, used fractions are of the training time. Where the budget is in steps, boxes and
# rounds take the place of time, so that a fit is repeatable.

# Used fractions at which training looks for the lowest positives: the prover alone among points, the adversary and then
# the prover among rays and boxes.
MINE_POINTS_AT, MINE_REGIONS_AT = (0.4, 0.65, 0.9), (0.25, 0.5, 0.9)
# What the prover may take each time, as a share or as a number of boxes.
MINE_POINTS_SHARE, MINE_POINTS_BOXES = 0.02, 1_000_000
MINE_REGIONS_SHARE, MINE_REGIONS_BOXES = 0.02, 200_000
# What the adversary may take each time, as a share, and as a number of rounds in every budget.
ADVERSARY_SHARE, ADVERSARY_ROUNDS = 0.01, 2
MOST_ADDED = 256  # most rays or boxes that the prover finds each time and that become samples
# A monotone network is searched at every refresh from this used fraction on, to this gap of f, by at most so many
# boxes; such a search takes a few hundred.
MONOTONE_START, MONOTONE_EPS, MONOTONE_BOXES = 0.2, 0.1, 20_000

# Share that is reserved for setting the threshold before a search has told what that takes: for points; for regions;
# and for rays and boxes that are searched during training, where it is more, because it is easier to give time back.
POINT_RESERVE, REGION_RESERVE, MINED_REGION_RESERVE = 0.03, 0.15, 0.4
# Once a search has told what the proof of points takes, its reserve is kept between these shares.
LEAST_RESERVED, MOST_RESERVED = 0.01, 0.2
MORE_FOR_EXITS = 0.4  # mlp-early: a reserve for proofs is larger by this share of itself
GRANT_SECONDS = 1.0  # mlp-early: about what fitting a grant takes

# A proof, or the final adversarial search, gets this share even if training took longer than it should.
LEAST_SHARE = 0.05
# A proof may exceed the budget by this share: ending it earlier would loosen the threshold and save little time.
OVERTIME_SHARE = 0.1
# The final adversarial search, between training and a proof, takes this share, but no more than these seconds.
FINAL_SEARCH_SHARE, FINAL_SEARCH_SECONDS = 0.1, 20.0
PLANE_TOLERANCE = 1e-3  # gap at which the proof of planes ends, in domain half-widths of a plane's offset
# Limits where the budget is in steps: boxes of the final proof, of points and planes and of rays and boxes; rounds of
# the final adversarial search; steps of Newton's method for each exit.
PROOF_BOXES, REGION_PROOF_BOXES, SEARCH_ROUNDS, EXIT_STEPS = 20_000_000, 300_000, 12, 40


def fit_network(
    method: type[Mlp], problem: Problem, options: dict[str, Any], seconds: float, progress: Progress | None
) -> Trained:
    """Train a network and set its threshold (``trainers.Trainer``); Ctrl-C ends training, and the best is taken."""
    return _Fit(method, problem, NetworkOptions(budget=seconds, **options), progress).run()


class _Fit:
    """One fit.

    Attributes:
        as_points: Whether f is proven over the object's points.
        of_planes: Whether the network is a plane's two supports (``networks.heads``).
        proof_worthwhile: Of rays and boxes: whether a proof is expected to be worth its time.
        final_search_limit: Seconds that the adversary may take once training has ended, before a proof.
        first_reserve: Share of the budget that is kept for setting the threshold until a search has told what that
            takes, and again where a proof is given up. The user's progress counts the rest as training, whatever is
            kept later.
        boxes: Number of boxes that searches during training have bounded.
    """

    def __init__(self, method: type[Mlp], problem: Problem, options: NetworkOptions, progress: Progress | None):
        self.method, self.problem, self.options = method, problem, options
        self.early = issubclass(method, MlpEarly)
        self.monotone = issubclass(method, MonotoneMlp)
        self.as_points = problem.domain.tested_as_point or self.monotone
        self.of_planes = head_of(problem.query).outputs > 1
        self.lattice = lattice_of(problem, options.thresholds) if options.thresholds > 1 else None
        self.first_reserve = POINT_RESERVE if self.as_points else REGION_RESERVE
        self.clock = Clock(options.budget, options.steps, progress, 1 - self.first_reserve)
        self.final_search_limit = min(FINAL_SEARCH_SHARE * options.budget, FINAL_SEARCH_SECONDS)
        self.interrupted, self.boxes = False, 0
        self.proof_worthwhile = not self.as_points and not self.of_planes

    def run(self) -> Trained:
        options, clock = self.options, self.clock
        exits = (len(options.hidden) - 1) * self.early
        self.exit_seconds = EXIT_SHARE * exits * options.budget
        self.grant_seconds = min(GRANT_SECONDS * exits, EXIT_SHARE * options.budget)
        for_exits = self.exit_seconds + self.grant_seconds
        mined = self.proof_worthwhile and RECIPE_TRAINERS[options.recipe].takes_positives
        reserve = MINED_REGION_RESERVE if mined else self.first_reserve
        clock.reserved = reserve * (1 + MORE_FOR_EXITS * self.early) * options.budget + for_exits
        if not self.method.conservative:
            clock.reserved = 0.0
        trainer, exits, exit_trainers = self._trainer(), {}, []
        waiting = list(MINE_POINTS_AT if self.as_points else MINE_REGIONS_AT)

        def mine(used: float) -> None:
            if self.monotone:
                if used >= MONOTONE_START:
                    self._mine_points(trainer, used)
            elif waiting and waiting[0] <= used < 1:
                waiting.pop(0)
                (self._mine_points if self.as_points else self._mine_regions)(trainer, used)

        with single_threaded_torch():
            self.interrupted = interrupts(lambda: trainer.run(clock, mine))
            tensors = trainer.finish()
            if self.early:
                steps = None if clock.timed else EXIT_STEPS
                exits, exit_trainers = train_exits(trainer, tensors, self.exit_seconds, steps)
        if self.method.conservative:
            bounder, record = self._settled(tensors | exits, [*exit_trainers, trainer])
        else:
            bounder, record = self._bounder(self.method, tensors).freeze(0.0, None), {}
        own = {"recipe": options.recipe, "steps": clock.count, "interrupted": self.interrupted}
        return bounder, own | {"boxes_in_training": self.boxes} | record

    def _trainer(self) -> NetworkTrainer | SupportTrainer | OccupancyTrainer:
        problem, options = self.problem, self.options
        grid, domain, sizes = problem.grid, problem.domain, (options.hidden, options.activation)
        if not self.method.conservative:
            return OccupancyTrainer(problem, *sizes, options.octaves)
        if self.of_planes:
            return SupportTrainer(problem, *sizes)
        if self.monotone:
            return MonotoneTrainer(self._of_callers(least_boxes(grid, domain, problem.seed)), *sizes)
        # Exits are trained together with the layers for points only: of rays and boxes an exit would deny too few to
        # make up for layers that are worse for it.
        exits_too = self.early and self.as_points
        samples = self._of_callers(samples_of(grid, domain, problem.seed))
        if self.lattice is not None and self.as_points:
            return LocalTrainer(samples, *sizes, options.octaves, lattice=self.lattice)
        return (EarlyTrainer if exits_too else RECIPE_TRAINERS[options.recipe])(samples, *sizes, options.octaves)

    def _of_callers(self, samples: Samples) -> Samples:
        samples.callers = self.problem.callers
        return samples

    def _bounder(self, method: type[Mlp], tensors: dict[str, np.ndarray]) -> Mlp:
        return method(self.problem.domain, tensors, self.options.stored, self.problem.device)

    # --- searches while it trains ------------------------------------------------------------------------------------

    def _mine_points(self, trainer: NetworkTrainer, used: float) -> None:
        """Let the prover search the network as it is; the lowest points that it finds become training samples."""
        if not self.problem.grid.certified or self.options.attested:
            return
        problem, clock, budget = self.problem, self.clock, self.options.budget
        bounder = self._bounder(MonotoneMlp if self.monotone else Mlp, trainer.network.tensors())
        limit = {"seconds": MINE_POINTS_SHARE * budget} if clock.timed else {"boxes": MINE_POINTS_BOXES}
        points = trainer.worst_points()
        if self.monotone:  # often, and cheaply: where f is steep, samples alone make a network look better than it is
            eps, limit = MONOTONE_EPS, {"boxes": MONOTONE_BOXES}
        else:
            eps = tolerance(bounder, problem, points)
        search = least_value(bounder, problem.grid, eps=eps, points=points, **limit)
        self.boxes += search.boxes
        trainer.add(search.worst)
        if clock.timed:
            expected = min(max(final_proof_seconds(search, used), LEAST_RESERVED * budget), MOST_RESERVED * budget)
            if self.lattice is not None:
                expected = MOST_RESERVED * budget
            clock.reserve(expected * (1 + MORE_FOR_EXITS * self.early) + self.exit_seconds + self.grant_seconds)

    def _mine_regions(self, trainer: NetworkTrainer, used: float) -> None:
        """Let adversary and prover search the network as it is; the lowest positives that they find become samples.

        The prover's search tells how long a proof of the final network would take, and whether it would be worth it.
        """
        budget, clock, problem, samples = self.options.budget, self.clock, self.problem, trainer.samples
        seconds = ADVERSARY_SHARE * budget if clock.timed else float("inf")
        found = adversarial_minimum(samples, trainer.network, seconds, trainer.hard, rounds=ADVERSARY_ROUNDS)
        trainer.add_states(found.states)
        bounder = self._bounder(Mlp, trainer.network.tensors())
        # Of cells the prover's positives are samples, too; those of a shape do not tell which of its points they hold.
        of_cells = isinstance(problem.grid, IndicatorGrid)
        most = (MOST_REGION_PROOF if of_cells else MOST_SHAPE_PROOF) * budget
        expected, tried = 0.0, bounder.provable and (of_cells or self.proof_worthwhile)
        self.proof_worthwhile = tried
        if tried:
            costs, least = Costs(bounder, problem), float(bounder.reference(found.worst).min())
            eps = costs.cheap_gap(least)
            limit = {"seconds": MINE_REGIONS_SHARE * budget} if clock.timed else {"boxes": MINE_REGIONS_BOXES}
            search = least_value(bounder, problem.grid, eps=eps, points=found.worst, **limit)
            self.boxes += search.boxes
            if of_cells:
                trainer.add_states(samples.spread(samples.at(search.numbers), MOST_ADDED))
            expected = final_proof_seconds(search, used, of_cells, UNTOLD)
            if clock.timed:
                # the search of a shape ends with what it has, in steps
                cost = costs.of_proof(least, eps, expected, most) if of_cells else 0.0
                self.proof_worthwhile = cost <= WORTH_PROVING and (of_cells or expected <= HOPEFUL * most)
                if self.proof_worthwhile:
                    trainer.decay = max(trainer.decay, decay_for(expected, budget))
        if clock.timed:
            longest = min(expected, most) + self.final_search_limit
            proof = longest if self.proof_worthwhile else self.first_reserve * budget
            clock.reserve(proof * (1 + MORE_FOR_EXITS * self.early) + self.exit_seconds + self.grant_seconds, used)

    # --- thresholds --------------------------------------------------------------------------------------------------

    def _settled(
        self, tensors: dict[str, np.ndarray], trainers: list[NetworkTrainer] | list[SupportTrainer]
    ) -> tuple[Mlp, dict]:
        """The bounder with the threshold of each part, and the last part's record: that part is the whole network.

        The other parts are the exits as networks of their own, in order of depth.
        """
        cls, sizes, depth = MonotoneMlp if self.monotone else Mlp, self.options.stored, len(self.options.hidden)
        depths = range(depth - len(trainers) + 1, depth + 1)
        held = [part_of(tensors, sizes, depth) for depth in depths]
        parts = [cls(self.problem.domain, *each, self.problem.device) for each in held]
        if self.problem.target is not None:
            parts = [part.rebased(self.problem.target) for part in parts]
        if self.lattice is not None:
            return (self._prove_local if self.as_points else self._decide_parts)(parts[0], trainers[0])
        for left, (part, trainer) in zip(range(len(parts), 0, -1), zip(parts, trainers, strict=True), strict=True):
            record = (self._prove if self.as_points or self.of_planes else self._decide)(part, trainer, left)
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
            return {"boxes": PROOF_BOXES}
        left = (1 + OVERTIME_SHARE) * self.options.budget - self.clock.seconds - self.grant_seconds
        return {"seconds": max(left / parts_left, LEAST_SHARE * self.options.budget)}

    def _prove(self, part: Mlp, trainer: NetworkTrainer | SupportTrainer, parts_left: int) -> dict:
        self.clock.tell(1.0, "proof")
        points, grid = self._moved(trainer.worst_points()), self.problem.grid
        eps = PLANE_TOLERANCE if self.of_planes else tolerance(part, self.problem, points)
        limit = self._limit(parts_left)
        limit |= {"eps": eps, "points": points, "attested": self.options.attested}
        search = prove_or_attest(part, grid, seed=self.problem.seed, **limit)
        if search is None:
            return {"gap": eps}
        return {"gap": float(search.upper_bound - search.lower_bound), "complete": search.complete}

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
            member, lattice, problem.grid, negatives, points=points, eps=eps, **self._limit(1)
        )
        return bounder, {"gap": eps, "thresholds": self.lattice.count, "complete": search.complete}

    def _decide_parts(self, member: Mlp, trainer: LocalTrainer) -> tuple[Local, dict]:
        (found, limits), tell = self._lowest(trainer, 1), partial(self.clock.tell, 1.0)
        limits = limits or {"seconds": LEAST_SHARE * self.options.budget}
        bounder, record = decide_parts(member, self.lattice, self.problem, found.worst, limits, tell)
        return bounder, record | {"search_seconds": round(found.seconds, 3), "search_complete": found.complete}

    def _decide(self, part: Mlp, trainer: NetworkTrainer, parts_left: int) -> dict:
        """Let the adversary look for the least f, then the prover, if that is worth it or if the adversary ends early.

        Without the prover (``limits`` is ``None``) fresh positives attest the threshold; the adversary has all the
        time.
        """
        found, limits = self._lowest(trainer, parts_left)
        record = decide(part, self.problem, found.worst, limits, lambda note: self.clock.tell(1.0, note))
        return record | {"search_seconds": round(found.seconds, 3), "search_complete": found.complete}

    def _lowest(self, trainer: NetworkTrainer, parts_left: int) -> tuple[Adversary, dict[str, float] | None]:
        """What the adversary finds, and the limits of the prover."""
        self.clock.tell(1.0, "adversarial search")
        budget, rounds = self.options.budget, {} if self.clock.timed else {"rounds": SEARCH_ROUNDS}
        at_least = LEAST_SHARE * budget
        whole = (1 + OVERTIME_SHARE * self.proof_worthwhile) * budget
        attest = attest_seconds(budget, self.proof_worthwhile or isinstance(self.problem.grid, IndicatorGrid))
        left = (whole - self.clock.seconds - self.grant_seconds) / parts_left - attest  # seconds of this part
        share = min(left, self.final_search_limit) if self.proof_worthwhile else left
        seconds = max(share, at_least) if self.clock.timed else float("inf")
        found = adversarial_minimum(trainer.samples, trainer.network, seconds, trainer.hard, **rounds)
        limits = {"boxes": REGION_PROOF_BOXES}
        if self.clock.timed:
            left -= found.seconds
            limits = {"seconds": max(left, at_least)} if self.proof_worthwhile or left > at_least else None
        return found, limits
