"""The recipe of points: what the paper's asymmetric loss becomes when seconds count and the threshold is the minimum.

The aim is few negatives above the *least* value on the object, a worst case over a continuous set. Hence the loss of
``accumulate``, and positives from a pool of the worst ones found, which take steps down f inside their cells. Positives
that others find, such as the prover, enter the pool by ``add``.

Samples are columns here: coordinates v ``(ndim, N)``, and of positives their *states* ``(S, N)``, from which v follows
(``training.samples``: a cell and an offset in it, for instance) and which stay positive wherever they move.

``occupancy`` is at the end: the usual loss, for comparison.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from warp_bounding.queries import oracle
from warp_bounding.training.engine import (
    Clock,
    Evaluator,
    Soap,
    Team,
    TrainableNetwork,
    cosine,
    evaluated,
    geometric,
    summed,
    torch,
)
from warp_bounding.training.samples import Problem, Samples

# The asymmetric loss of the default recipe and its constants, the batches that it is taken on, and its gradient.
#
# A positive's weight grows geometrically against a negative's (the paper's schedule grows it linearly and waits for
# zero false negatives). The negatives' loss turns into a ramp, which gives up on negatives that cannot be separated
# instead of distorting f for them. Most of a batch is drawn from samples that carry gradient, with weights that keep
# the mean unbiased. All schedules are functions of the used fraction of the budget.


@dataclass(frozen=True)
class Recipe:
    """Constants of the default recipe, found on the paper's shapes.

    A schedule "a -> b over [s, e]" goes geometrically from a to b while the used fraction goes from s to e.
    """

    batch: int = 2048  # negatives, and as many positives, a step
    active: float = 0.75  # share of a batch that is drawn from the samples that carry gradient
    refresh: int = 100  # steps between two refreshes of the samples, and batches that are planned at each
    pool: int = 32768  # fresh negatives, and fresh positives, at a refresh
    vertices: int = 131072  # corners of boundary cells at a refresh, all of them where possible
    hard: int = 4096  # the worst positives, retained from refresh to refresh
    moves: int = 2  # steps down f that these take at a refresh
    explore: int = 16384  # fresh positives that walk down before they compete for the hard pool
    explore_moves: int = 4  # the number of these steps
    saturation: float = 4.0  # |f| beyond which a softplus carries almost no gradient
    # Of positives against negatives, 1 -> weight over [0, ramp]. Of ten pairs of fits around grids, meshes and a motion
    # eight are tighter than with 3000; 8 % in the mean.
    weight: float = 1000.0
    ramp: float = 0.83
    sharpness: float = 0.5  # width of the positives' softplus, 1 -> sharpness over [0, ramp]
    boost: float = 10.0  # weight of the worst positives, 1 -> boost over [0.6, 0.95]
    boosted: int = 1024  # number of the worst positives that are boosted
    give_up: float = 3.0  # width of the negatives' ramp, 40 -> give_up over [0.3, 0.95]
    rate: float = 2e-2  # highest learning rate (``cosine``)
    rate_end: float = 1e-3  # learning rate at the end, relative to the highest
    warm_up: float = 0.01  # used fraction at which the learning rate is highest
    beta1: float = 0.95  # of ``Soap``
    beta2: float = 0.95
    first_gain: float = 20.0  # initial weights of the first layer: uniform in +-gain / sqrt(inputs)
    later_gain: float = 3.0  # the same, of later hidden layers
    first_gain_plain: float = 3.0  # the same two where the activation is no wave
    later_gain_plain: float = 1.7

    def gains(self, wave: bool) -> tuple[float, float]:
        """Gain of the initial weights of the first layer, and of later hidden layers."""
        return (self.first_gain, self.later_gain) if wave else (self.first_gain_plain, self.later_gain_plain)


# Share of uniform samples that are usually negatives within the domain. Few of a caller's queries are, as most lie far
# away or touch; with this weight their loss counts against the positives' as that of uniform samples does.
NEGATIVES = 0.75


def schedule(end: float, used: float, start: float, stop: float, begin: float = 1.0) -> float:
    """Geometric from ``begin`` to ``end`` while ``used`` goes from ``start`` to ``stop``."""
    return geometric(begin, end, min(1.0, max(0.0, (used - start) / (stop - start))))


@dataclass(frozen=True)
class Batches:
    """The batches until the next refresh, of negatives or of positives."""

    x: torch.Tensor  # ``(n + 1, N)``, encoded samples
    rows: torch.Tensor  # ``(refresh, batch)`` indices into them
    weight: torch.Tensor  # ``(batch,)``
    boost: torch.Tensor | None = None  # ``(N,)``, of the worst positives' weights; 1 of others


def plan(
    recipe: Recipe,
    used: float,
    generator: torch.Generator,
    negatives: tuple[torch.Tensor, torch.Tensor],
    positives: tuple[torch.Tensor, torch.Tensor],
) -> tuple[Batches, Batches]:
    """Draw batches of encoded samples whose values are known: ``(x, f)`` of negatives and of positives."""
    (negative, below), (positive, above) = negatives, positives
    chosen, weights = _stratified(below > -recipe.saturation, recipe, generator)
    planned = Batches(negative, chosen, weights * (NEGATIVES / len(below)))
    level = above.kthvalue(min(recipe.boosted, len(above)))[0]
    boost = 1 + (schedule(recipe.boost, used, 0.6, 0.95) - 1) * (above <= level).float()
    chosen, weights = _stratified(above <= torch.clamp(level, min=recipe.saturation), recipe, generator)
    return planned, Batches(positive, chosen, weights / len(above), boost)  # a mean


def weights_of(recipe: Recipe, used: float) -> tuple[float, float, float]:
    """Weight of positives against negatives, width of the positives' softplus, width of the negatives' ramp."""
    weight = schedule(recipe.weight, used, 0.0, recipe.ramp)
    width = schedule(recipe.sharpness, used, 0.0, recipe.ramp)
    return weight, width, schedule(recipe.give_up, used, 0.3, 0.95, begin=40.0)


def accumulate(
    batches: tuple[Batches, Batches], recipe: Recipe, team: Team, workers: list[Evaluator], row: int, used: float
) -> None:
    """Gradient of the loss on the batch number ``row`` that ``plan`` has drawn since the last refresh.

    The workers, one for each thread, are of one network; each one's share is in its ``gradient``.
    """
    (weight, width, ramp), (negatives, positives) = weights_of(recipe, used), batches
    for worker in workers:
        worker.gradient.zero_()

    def job(index: int, part: slice) -> None:
        worker = workers[index]
        columns = negatives.rows[row, part]
        x = negatives.x.index_select(1, columns)
        f = worker.forward(x, keep=True)
        signal = torch.sigmoid(f)
        if ramp < 30:
            signal -= torch.sigmoid(f - ramp)
        worker.backward(x, signal.mul_(negatives.weight[part]).mul_(weight**-0.5))
        columns = positives.rows[row, part]
        x = positives.x.index_select(1, columns)
        f = worker.forward(x, keep=True)
        signal = torch.sigmoid(f.div_(-width)).mul_(positives.weight[part]).mul_(positives.boost[columns])
        worker.backward(x, signal.mul_(-(weight**0.5)))

    team.over(len(negatives.weight), job)


def _stratified(active: torch.Tensor, recipe: Recipe, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    """Batches drawn from two strata: the samples that carry gradient, ``active`` ``(N,)`` bool, and the others.

    Indices ``(refresh, batch)``, and weights ``(batch,)`` under which a batch's sum estimates that over all samples.
    """
    strata = [active.nonzero()[:, 0], (~active).nonzero()[:, 0]]
    counts = [int(recipe.batch * recipe.active), recipe.batch - int(recipe.batch * recipe.active)]
    if len(strata[0]) <= 16 or not len(strata[1]):  # one stratum is (almost) empty: draw from all
        strata, counts = [torch.arange(len(active))], [recipe.batch]
    columns, weights = [], []
    for indices, count in zip(strata, counts, strict=True):
        columns.append(indices[torch.randint(len(indices), (recipe.refresh, count), generator=generator)])
        weights.append(torch.full((count,), len(indices) / count))
    return torch.cat(columns, 1), torch.cat(weights)


# Of a network that begins with the waves of its shape: one layer more makes f bend more, and its proof longer.
WAVE_DECAY = 0.03


class NetworkTrainer:
    """A network in training, on samples whose generator is the source of everything random.

    ``false_positives`` is the estimated share of all uniform samples at the least value known on the object,
    ``false_negatives`` that of the worst positives which the paper's threshold of 0 would deny, both of the last
    refresh; ``hard`` ``(S, K)`` are the states of the worst positives known. In each step the hidden layers' weights
    shrink by ``decay`` times the learning rate: smaller weights bend f less, which shortens its proof.
    """

    def __init__(self, samples: Samples, hidden: tuple[int, ...], activation: str):
        self.recipe, self.activation = Recipe(), activation
        self.samples, self.generator = samples, samples.generator
        self.network = TrainableNetwork(samples.ndim, hidden, activation)
        self.decay = 0.0
        self._initialise()
        self.team = Team()
        self.workers = [Evaluator(self.network) for _ in range(self.team.size)]
        self.false_positives = self.false_negatives = 1.0
        self.hard = samples.positives(0)
        self._best = (math.inf, self.network.flat.clone())
        self._batches: tuple[Batches, Batches] | None = None

    def _initialise(self) -> None:
        network, samples = self.network, self.samples
        waves = network.act.wave
        network.initialise(*self.recipe.gains(waves), self.generator)
        # An axis of few cells carries less detail than its range in v would suggest.
        network.layers[0][:, : samples.ndim] *= samples.detail.T
        if waves and samples.waves is not None and samples.waves.shape == network.layers[0].shape:
            network.layers[0].copy_(samples.waves)
            self.decay = WAVE_DECAY

    def _optimiser(self) -> Soap:
        return Soap(self.network.layers, self.recipe.beta1, self.recipe.beta2)

    def run(self, clock: Clock, on_refresh: Callable[[float], None] = lambda used: None) -> None:
        """Train until the clock's budget is used up, or an interrupt.

        ``on_refresh`` is called before every refresh with the used fraction, and at the end with 1; it may ``add``
        positives.
        """
        recipe, optimiser = self.recipe, self._optimiser()
        for step, used in clock.steps():
            if step % recipe.refresh == 0:
                on_refresh(used)
                self._refresh(used)
                worst = f"FN at 0: {100 * self.false_negatives:.1f} % of the worst"
                clock.tell(used, f"FP {100 * self.false_positives:.1f} %, {worst}")
            rate = cosine(recipe.rate, recipe.rate_end, recipe.warm_up, used)
            optimiser.step(self._gradients(step % recipe.refresh, used, rate), rate)
            if self.decay:
                for weight in self.network.layers[:-1]:
                    weight.mul_(1 - rate * self.decay)
        on_refresh(1.0)
        self._refresh(1.0)

    def add(self, v: np.ndarray) -> None:
        """Add positives found elsewhere, here as rows: ``(N, ndim)`` float64 coordinates ``v``; to the hard pool."""
        self.hard = torch.cat([self.samples.locate(v), self.hard], 1)

    @property
    def least(self) -> float:
        """The fewest estimated false positives so far, a share; infinity before the first refresh."""
        return self._best[0]

    def finish(self) -> dict[str, np.ndarray]:
        """Store the parameters with the fewest estimated false positives so far; returns them in a bounder's form."""
        self.network.flat.copy_(self._best[1])
        return self.network.tensors()

    def worst_points(self) -> np.ndarray:
        """``(K, ndim)`` float64, the worst positives known, coordinates ``v``: where a proof's search may begin."""
        hard = self.samples.coordinates(self.hard)
        return torch.cat([hard, self.samples.vertices], 1).T.double().numpy()

    def _refresh(self, used: float) -> None:
        """Draw new samples, renew the hard pool, estimate the rates, plan the batches until the next refresh."""
        recipe, samples, network = self.recipe, self.samples, self.network
        negative = network.encode(samples.negatives(recipe.pool))
        state = samples.positives(recipe.pool)
        fresh = samples.coordinates(state)
        walked = self._descend(samples.positives(recipe.explore), recipe.explore_moves)
        state = torch.cat([walked, self.hard, state], 1)
        x = network.encode(samples.coordinates(state))
        values = self._evaluate(x)
        worst = values.topk(min(recipe.hard, len(values)), largest=False)[1]
        self.hard = self._descend(state[:, worst], recipe.moves)
        vertices = samples.vertices
        if vertices.shape[1] > recipe.vertices:
            pick = torch.randint(vertices.shape[1], (recipe.vertices,), generator=self.generator)
            vertices = vertices.index_select(1, pick)
        positive = network.encode(torch.cat([vertices, fresh, samples.coordinates(self.hard)], 1))
        values = self._evaluate(torch.cat([negative, positive], 1))
        f_negative, f_positive = values[: negative.shape[1]], values[negative.shape[1] :]
        self.false_positives = float((f_negative >= f_positive.min()).sum()) / recipe.pool
        self.false_negatives = float((f_positive[-self.hard.shape[1] :] < 0).float().mean())
        if self.false_positives <= self._best[0]:
            self._best = (self.false_positives, self.network.flat.clone())
        self._batches = plan(recipe, used, self.generator, (negative, f_negative), (positive, f_positive))

    def _evaluate(self, x: torch.Tensor) -> torch.Tensor:
        return evaluated(self.team, self.workers, x)

    def _descend(self, state: torch.Tensor, moves: int) -> torch.Tensor:
        """States ``(S, N)`` after some ``moves`` down f; the first is 0.4 cells long, the next ones shrink."""
        begin, state, samples, network = state, state.clone(), self.samples, self.network

        def job(index: int, part: slice) -> None:
            columns = state[:, part]
            for move in range(moves):
                v = samples.coordinates(columns)
                slope = self.workers[index].input_gradient(network.encode(v))
                columns = samples.move(columns, slope, 0.4 * 0.8**move)
            state[:, part] = columns

        self.team.over(state.shape[1], job)
        return self.samples.resolved(begin, state)

    def _gradients(self, row: int, used: float, rate: float) -> list[torch.Tensor]:
        """Gradients of the loss on the planned batch ``row``, one matrix a layer, for a step at this learning rate."""
        accumulate(self._batches, self.recipe, self.team, self.workers, row, used)
        return summed(self.workers)


# Labelled queries, those of a step, and steps until they are renewed.
LABELS, LABELS_BATCH, LABELS_REFRESH = 65536, 4096, 50
LABELS_RATE, LABELS_WARM_UP = 1e-2, 0.02


class OccupancyTrainer:
    """``occupancy``: binary cross-entropy on uniform queries with exact labels, nothing more (the paper's OccNet).

    The output is the log odds that a query meets the object. Both kinds of error weigh the same, so a decision at
    probability one half leaves about as many false negatives as false positives. Optimiser and initial weights are
    those of the recipe, so that both are trained equally well and can be compared.
    """

    def __init__(self, problem: Problem, hidden: tuple[int, ...], activation: str):
        self.problem, self.activation, seed = problem, activation, problem.seed
        self.generator, self._rng = torch.Generator().manual_seed(seed), np.random.default_rng(seed)
        self._oracle = oracle(problem.query, problem.grid, "cpu", problem.domain.oracle_length)
        self.network = TrainableNetwork(problem.grid.ndim, hidden, activation)
        self.network.initialise(*Recipe().gains(self.network.act.wave), self.generator)
        self.team = Team()
        self.workers = [Evaluator(self.network) for _ in range(self.team.size)]

    def finish(self) -> dict[str, np.ndarray]:
        """The network as it is, as ``Occupancy`` stores it."""
        return self.network.tensors()

    def run(self, clock: Clock, on_refresh=None) -> None:
        """Train until the clock's budget is used up, or an interrupt; ``on_refresh`` is not called."""
        optimiser = Soap(self.network.layers, Recipe.beta1, Recipe.beta2)
        for step, used in clock.steps():
            if step % LABELS_REFRESH == 0:
                q = self.problem.sample(LABELS, self._rng)
                truth = torch.from_numpy(np.asarray(self._oracle(q), dtype=np.float32))
                x = self.network.encode(torch.from_numpy(self.problem.domain.to_local(q).astype(np.float32)).T)
                clock.tell(used, f"{step} steps")
            pick = torch.randint(LABELS, (LABELS_BATCH,), generator=self.generator)
            optimiser.step(self._gradients(x[:, pick], truth[pick]), cosine(LABELS_RATE, 1e-3, LABELS_WARM_UP, used))

    def _gradients(self, x: torch.Tensor, truth: torch.Tensor) -> list[torch.Tensor]:
        for worker in self.workers:
            worker.gradient.zero_()

        def job(index: int, part: slice) -> None:
            own = x[:, part].contiguous()
            odds = torch.sigmoid(self.workers[index].forward(own, keep=True))
            self.workers[index].backward(own, odds.sub_(truth[part]).div_(LABELS_BATCH))

        self.team.over(LABELS_BATCH, job)
        return summed(self.workers)
