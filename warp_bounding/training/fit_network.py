"""Fitting networks: train, then set the threshold by a proof where there is one, else by a search and statistics.

A network of points is trained with the prover in the loop: now and then branch and bound searches for the least f on
the object, and the points that it finds become samples. The last part of the budget is the proof itself. Support
functions of planes need no labels, and their proof is short. For rays and boxes, an adversarial search comes first, and
the prover then tries to show that nothing lies below what it found. If there is no time for that, the search's value
sets the threshold, and fresh positives test it. A network with exits is several networks that share layers; each gets a
threshold of its own, in the same way.

An arm's network is proven in another way, and so is any whose proof is left to workers: a search for the least f takes
far longer in many dimensions than a proof at a threshold that is known. So it trains without the prover, a walk finds a
low f, and ``prove_lower`` proves the highest threshold below it whose proof is expected to end in time.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_bounding.bounders.cascade import Lattice, Local
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.bounders.mlp_early import MlpEarly, part_of
from warp_bounding.errors import BounderError
from warp_bounding.networks.network import head_of
from warp_bounding.proof import Search, conjunction, least_value, prove_or_test, settle, statistical_test
from warp_bounding.proof.check import prove_lower
from warp_bounding.proof.prove import ROOM, least_found, prove_local
from warp_bounding.proof.search import STEEPNESS
from warp_bounding.queries import oracle
from warp_bounding.rounding import round_down
from warp_bounding.runtime.progress import Progress
from warp_bounding.shapes.grid import Grid
from warp_bounding.training.engine import Adversary, Clock, adversarial_minimum, interrupts, single_threaded_torch
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


# How long the proof of a network that is still being trained will take, and what follows for its training.

# Largest share of the budget that is reserved for the proof of rays or boxes, of cells and of other shapes. Of other
# shapes no proof is tried if it is expected to take more than HOPEFUL times that share.
MOST_REGION_PROOF, MOST_SHAPE_PROOF, HOPEFUL = 0.6, 0.35, 4.0
# The search of rays or boxes of a shape itself takes about so many times as long as that of coarse cells.
SHAPE_TIMES = 30.0
# How many times as long the proof of the final network takes as that of the network at used fraction 0, and at 1;
# linear in between: f gets steeper while it trains. Both are empirical.
PROOF_GROWTH = (4.2, 1.35)
# A search that did not end underestimates the rest by about this factor. For boxes of a 4D teapot it expected a proof
# of 14 s, which did not end in 21 s and left 21 % false positives. With five times the estimate weights decayed, and
# the proof ended in 2.3 s, with 16.7 %.
UNTOLD = 5.0
# If the proof of rays or boxes is expected to exceed the share DECAY_ABOVE of the budget, weights decay at the rate
# DECAY times the factor of that excess, up to MOST_DECAY: smaller weights make proofs shorter.
DECAY_ABOVE, DECAY, MOST_DECAY = 0.3, 0.05, 0.2
# A proof ends with a gap, which lowers the threshold and makes false positives of more queries. If more than this share
# of all queries is expected to become one, the proof is given up, and training keeps its time.
WORTH_PROVING = 1e-2

# About the time of the million fresh positives that test a threshold, of cells and of regions of other shapes, and the
# largest share of the budget that is left for them.
TEST_SECONDS, SHAPE_TEST_SECONDS, TEST_SHARE = 2.5, 12.0, 0.15


def final_proof_seconds(search: Search, used: float, of_cells: bool = True, untold: float = 1.0) -> float:
    """Seconds expected for the proof of the final network, by a search of the one at a used fraction of its training.

    ``untold`` corrects the estimate of a search that did not end (``UNTOLD``). Unless ``of_cells``, the search was over
    coarse cells of the shape.
    """
    begin, end = PROOF_GROWTH
    seconds = search.seconds if search.complete else untold * search.needed
    return (begin + (end - begin) * used) * seconds * (1.0 if of_cells else SHAPE_TIMES)


def decay_for(expected: float, budget: float) -> float:
    """Weight decay of a network of regions whose proof is expected to take so many seconds."""
    longer = expected / (DECAY_ABOVE * budget)
    return min(DECAY * longer, MOST_DECAY) if longer > 1 else 0.0


def statistical_seconds(budget: float, little: bool) -> float:
    """Seconds of a budget that are left for ``statistical_test``; ``little`` for cells, or if a proof is expected."""
    return TEST_SECONDS if little else min(SHAPE_TEST_SECONDS, TEST_SHARE * budget)


# What a threshold costs in false positives, and the best one for a network of rays or boxes in some time.
#
# An adversarial search finds a low f of a positive. The prover then tries to show that no positive lies below that
# value by more than a gap that costs next to nothing. If time runs out before, and the gap that it has proven costs too
# much, the search's value sets the threshold, and fresh positives test it.

# Share of all queries that may become false positives by the gap that a complete search leaves.
PROOF_COST = {"point": 1e-4, "ray": 1e-3, "plane": 1e-4, "box": 1e-3}
LARGEST_COST = 2e-2  # the same share where the search of rays or boxes ran out of time; above it the proof is not used
SAMPLES = 200_000  # random queries by which costs are estimated
FINEST = 1e-6  # least gap that is required, in f
USUAL = 1e-3  # gap in f that is required where too few negatives lie below to measure its cost


class Costs:
    """Values of f at negatives, as a device computes them, which determine what a threshold costs."""

    def __init__(self, bounder: Mlp, problem: Problem):
        x = problem.sample(SAMPLES, np.random.default_rng(0))
        truth = oracle(problem.query, problem.grid, bounder.device, bounder.domain.oracle_length)(x)
        values = bounder.values(x).numpy()[~truth & problem.reaching(x)]
        self.values, self.query = np.sort(values[np.isfinite(values)]), problem.query

    def cheap_gap(self, least: float) -> float:
        """How far below a value a threshold may lie before it costs ``PROOF_COST`` of all queries."""
        place, count = np.searchsorted(self.values, least), int(PROOF_COST[self.query] * SAMPLES)
        return max(least - float(self.values[place - count - 1]), FINEST) if place > count else USUAL

    def between(self, lower: float, upper: float) -> float:
        """Share of all queries whose f lies between two values."""
        return float(np.diff(np.searchsorted(self.values, [lower, upper]))[0]) / SAMPLES

    def of_proof(self, least: float, eps: float, needed: float, seconds: float) -> float:
        """Share of queries that a proof in ``seconds`` should cost, where a gap ``eps`` takes ``needed`` seconds."""
        return self.between(least - eps * max(needed / seconds, 1.0) ** (1 / STEEPNESS), least)


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


def tolerance(bounder: Mlp, problem: Problem, worst: np.ndarray) -> float:
    """How far below the least f of some positives ``(N, ndim)`` a threshold may lie; see ``Costs.cheap_gap``."""
    return Costs(bounder, problem).cheap_gap(float(bounder.reference(worst).min()))


def decide(
    part: Mlp,
    problem: Problem,
    found: np.ndarray,
    limits: dict[str, float] | None,
    report=lambda note: None,
) -> dict:
    """Set the threshold of a network of rays or boxes, by proof if there is time for one, and give it its certificate.

    ``found`` ``(N, ndim)`` are the lowest positives known, coordinates ``v``; ``limits`` are seconds or boxes for the
    prover, ``None`` for no proof. Returns a record of the gap, and of the proof's seconds and cost in false positives.
    """
    costs, least = Costs(part, problem), float(part.reference(found).min())
    record, left = {}, None
    if limits is not None and part.provable:
        report("proof")
        search = least_value(part, problem.grid, eps=costs.cheap_gap(least), points=found, **limits)
        error = part.rounding_bound()
        cost = costs.between(search.lower_bound - error, min(least, search.upper_bound))
        record = {
            "gap": search.upper_bound - search.lower_bound,
            "proof_cost": cost,
            "proof_seconds": round(search.seconds, 3),
        }
        if search.complete or cost <= LARGEST_COST:
            settle(part, problem.grid, search)
            return record
        least, left = min(least, search.upper_bound), search
    report("fresh positives")
    gap = costs.cheap_gap(least)
    statistical_test(part, problem.grid, least=least, room=gap, seed=problem.seed, search=left)
    return {"gap": gap} | {k: v for k, v in record.items() if k != "gap"}


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

# Share that is reserved for setting the threshold before a search has measured that: for points; for regions;
# and for rays and boxes that are searched during training, where it is more, because it is easier to give time back.
POINT_RESERVE, REGION_RESERVE, MINED_REGION_RESERVE = 0.03, 0.15, 0.4
# Once a search has measured what the proof of points takes, its reserve stays between these shares.
LEAST_RESERVED, MOST_RESERVED = 0.01, 0.2
# The same of the proof at a lower threshold, and of fresh positives that test one.
LOWER_RESERVE, TESTED_RESERVE = 2 / 3, 0.3
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
    """Train a network and set its threshold (``fit.Trainer``); Ctrl-C ends training, and the best is taken."""
    return _Fit(method, problem, NetworkOptions(budget=seconds, **options), progress).run()


class _Fit:
    """One fit.

    ``as_points``: queries are points. ``of_planes``: the network is a plane's two supports (``Head``).
    ``proof_worthwhile``: a proof of rays or boxes is expected to be worth its time. ``first_reserve``: the share of the
    budget reserved for setting the threshold until a search has measured what that takes, and again once a proof is
    given up; the user's progress counts the rest as training.
    """

    def __init__(self, method: type[Mlp], problem: Problem, options: NetworkOptions, progress: Progress | None):
        self.method, self.problem, self.options = method, problem, options
        self.early = issubclass(method, MlpEarly)
        self.as_points = problem.domain.tested_as_point
        self.of_planes = head_of(problem.query).outputs > 1
        self.lattice = lattice_of(problem, options.parts) if options.parts > 1 else None
        grid, tested = problem.grid, options.statistical or not problem.grid.certified
        of_shape = self.as_points and not isinstance(grid, Grid) and self.lattice is None and not tested
        self.lowers = of_shape and (grid.joints is not None or problem.scheduler is not None)
        self.first_reserve = POINT_RESERVE if self.as_points else REGION_RESERVE
        if self.lowers or (self.as_points and tested):
            self.first_reserve = LOWER_RESERVE if self.lowers else TESTED_RESERVE
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
        reserve = MINED_REGION_RESERVE if self.proof_worthwhile else self.first_reserve
        clock.reserved = reserve * (1 + MORE_FOR_EXITS * self.early) * options.budget + for_exits
        if not self.method.conservative:
            clock.reserved = 0.0
        trainer, exits, exit_trainers = self._trainer(), {}, []
        waiting = list(MINE_POINTS_AT if self.as_points else MINE_REGIONS_AT)

        def mine(used: float) -> None:
            if waiting and waiting[0] <= used < 1:
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
        own = {"steps": clock.count, "interrupted": self.interrupted}
        return bounder, own | {"boxes_in_training": self.boxes} | record

    def _trainer(self) -> NetworkTrainer | SupportTrainer | OccupancyTrainer:
        problem, options = self.problem, self.options
        grid, domain, sizes = problem.grid, problem.domain, (options.hidden, options.activation)
        if not self.method.conservative:
            return OccupancyTrainer(problem, *sizes)
        if self.of_planes:
            return SupportTrainer(problem, *sizes)
        # Exits are trained together with the layers for points only: of rays and boxes an exit would deny too few to
        # make up for layers that are worse for it.
        exits_too = self.early and self.as_points
        samples = samples_of(grid, domain, problem.seed)
        samples.callers = problem.callers
        if self.lattice is not None:
            return LocalTrainer(samples, *sizes, lattice=self.lattice)
        return (EarlyTrainer if exits_too else NetworkTrainer)(samples, *sizes)

    def _bounder(self, method: type[Mlp], tensors: dict[str, np.ndarray]) -> Mlp:
        return method(self.problem.domain, tensors, self.options.stored, self.problem.device)

    # --- searches while it trains ------------------------------------------------------------------------------------

    def _mine_points(self, trainer: NetworkTrainer, used: float) -> None:
        """Let the prover search the network as it is; the lowest points that it finds become training samples."""
        if not self.problem.grid.certified or self.options.statistical or self.lowers:
            return
        problem, clock, budget = self.problem, self.clock, self.options.budget
        bounder = self._bounder(Mlp, trainer.network.tensors())
        limit = {"budget": MINE_POINTS_SHARE * budget} if clock.timed else {"boxes": MINE_POINTS_BOXES}
        points = trainer.worst_points()
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

        The prover's search estimates how long a proof of the final network would take, and whether that would pay.
        """
        budget, clock, problem, samples = self.options.budget, self.clock, self.problem, trainer.samples
        seconds = ADVERSARY_SHARE * budget if clock.timed else float("inf")
        found = adversarial_minimum(samples, trainer.network, seconds, trainer.hard, rounds=ADVERSARY_ROUNDS)
        trainer.add_states(found.states)
        bounder = self._bounder(Mlp, trainer.network.tensors())
        # The prover's positives of cells are samples, too; those of a shape do not say which of its points they hold.
        of_cells = isinstance(problem.grid, Grid)
        most = (MOST_REGION_PROOF if of_cells else MOST_SHAPE_PROOF) * budget
        expected, tried = 0.0, bounder.provable and (of_cells or self.proof_worthwhile)
        self.proof_worthwhile = tried
        if tried:
            costs, least = Costs(bounder, problem), float(bounder.reference(found.worst).min())
            eps = costs.cheap_gap(least)
            limit = {"budget": MINE_REGIONS_SHARE * budget} if clock.timed else {"boxes": MINE_REGIONS_BOXES}
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
        sizes, depth = self.options.stored, len(self.options.hidden)
        depths = range(depth - len(trainers) + 1, depth + 1)
        held = [part_of(tensors, sizes, depth) for depth in depths]
        parts = [Mlp(self.problem.domain, *each, self.problem.device) for each in held]
        if self.problem.target is not None:
            parts = [part.rebased(self.problem.target) for part in parts]
        if self.lattice is not None:
            return self._prove_local(parts[0], trainers[0])
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
        least = LOWER_RESERVE / 2 if self.lowers else LEAST_SHARE  # without a proof there is nothing
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
        eps = PLANE_TOLERANCE if self.of_planes else tolerance(part, self.problem, points)
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

    def _decide(self, part: Mlp, trainer: NetworkTrainer, parts_left: int) -> dict:
        """Let the adversary look for the least f, then the prover, if that is worth it or if the adversary ends early.

        Without the prover (``limits`` is ``None``) the adversary has all the time, and fresh positives test the
        threshold.
        """
        found, limits = self._lowest(trainer, parts_left)
        if limits is not None:
            limits["progress"] = self._searched
        record = decide(part, self.problem, found.worst, limits, lambda note: self.clock.tell(1.0, note))
        return record | {"search_seconds": round(found.seconds, 3), "search_complete": found.complete}

    def _lowest(self, trainer: NetworkTrainer, parts_left: int) -> tuple[Adversary, dict[str, float] | None]:
        """What the adversary finds, and the limits of the prover."""
        self.clock.tell(1.0, "adversarial search")
        budget, rounds = self.options.budget, {} if self.clock.timed else {"rounds": SEARCH_ROUNDS}
        at_least = LEAST_SHARE * budget
        whole = (1 + OVERTIME_SHARE * self.proof_worthwhile) * budget
        reserved = statistical_seconds(budget, self.proof_worthwhile or isinstance(self.problem.grid, Grid))
        left = (whole - self.clock.seconds - self.grant_seconds) / parts_left - reserved  # seconds of this part
        share = min(left, self.final_search_limit) if self.proof_worthwhile else left
        seconds = max(share, at_least) if self.clock.timed else float("inf")
        found = adversarial_minimum(trainer.samples, trainer.network, seconds, trainer.hard, **rounds)
        limits = {"boxes": REGION_PROOF_BOXES}
        if self.clock.timed:
            left -= found.seconds
            limits = {"budget": max(left, at_least)} if self.proof_worthwhile or left > at_least else None
        return found, limits
