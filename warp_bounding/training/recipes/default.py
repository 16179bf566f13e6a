"""The default recipe: what the paper's asymmetric loss becomes when seconds count and the threshold is the minimum.

The figure of merit is the volume of negatives above the *least* value on the object, a worst case over a continuous set.
Hence: a positive's weight grows geometrically against a negative's (the paper's schedule grows it linearly and waits for
zero false negatives); the negatives' loss turns into a ramp, which gives up on what cannot be separated instead of
bending everything for it; positives come from a pool of the worst ones found, which walk down f inside their cells; half
of a batch is drawn from samples that carry gradient, with weights that keep the mean unbiased. All schedules are functions
of the used fraction of the budget. Points that a proof's search finds enter the pool (``counterexamples``).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch

from warp_bounding.runtime.launch import cpu_threads
from warp_bounding.training.engine.clock import Clock, Progress, cosine, geometric
from warp_bounding.training.engine.soap import Soap
from warp_bounding.training.engine.team import Team
from warp_bounding.training.engine.trainable_network import Evaluator, TrainableNetwork
from warp_bounding.training.samples.base import Samples

__all__ = ["Recipe", "Trainer"]


@dataclass(frozen=True)
class Recipe:
    """Constants of the default recipe, found on the paper's shapes; none depends on the shape, some on the kind of query.

    A schedule "a -> b over [s, e]" goes geometrically from a to b while the used fraction goes from s to e.
    """

    batch: int = 2048  # negatives, and as many positives, a step
    active: float = 0.75  # share of them drawn from the samples that carry gradient
    refresh: int = 100  # steps between two refreshes of the samples
    pool: int = 32768  # fresh negatives, and fresh positives, at a refresh
    vertices: int = 131072  # corners of boundary cells at a refresh, all of them where possible
    hard: int = 4096  # the worst positives, kept from refresh to refresh
    moves: int = 2  # steps down f that they take
    explore: int = 16384  # fresh positives that walk down before they compete for the hard pool
    explore_moves: int = 4
    saturation: float = 4.0  # |f| beyond which a softplus carries almost no gradient
    weight: float = 3000.0  # of positives against negatives, 1 -> weight over [0, ramp]
    ramp: float = 0.83
    sharpness: float = 0.5  # width of the positives' softplus, 1 -> sharpness over [0, ramp]
    boost: float = 10.0  # weight of the worst positives, 1 -> boost over [0.6, 0.95]
    boosted: int = 1024  # their number
    give_up: float = 3.0  # width of the negatives' ramp, 40 -> give_up over [0.3, 0.95]
    rate: float = 2e-2  # learning rate, cosine to rate_end of it
    rate_end: float = 1e-3
    warm_up: float = 0.01
    beta1: float = 0.95
    beta2: float = 0.95
    first_gain: float = 20.0  # initial weights: uniform in +-gain / sqrt(inputs)
    later_gain: float = 3.0
    first_gain_plain: float = 3.0  # of activations that are no wave, and behind an encoding
    later_gain_plain: float = 1.7
    chunk: int = 1024  # columns that a thread evaluates at a time


RECIPES = {
    "point": Recipe(),
    "ray": Recipe(first_gain=1.5, sharpness=0.3),  # a ray sweeps over many cells: its truth is smoother than a point's
    "box": Recipe(first_gain=5.0, sharpness=0.3),
}
# Rays and boxes in 4D, where networks of the paper's sizes are far from the truth: the bulk needs gradient, too, and eight
# coordinates have many places to be low at.
MANY_COORDINATES, FAR = 8, {"sharpness": 1.0, "hard": 16384, "explore": 32768}


def recipe_of(query: str, inputs: int) -> Recipe:
    """The default recipe for a kind of query of so many coordinates."""
    far = query != "point" and inputs >= MANY_COORDINATES
    return replace(RECIPES[query], **(FAR if far else {}))


def schedule(end: float, used: float, start: float, stop: float, begin: float = 1.0) -> float:
    """Geometric from ``begin`` to ``end`` while ``used`` goes from ``start`` to ``stop``."""
    return geometric(begin, end, min(1.0, max(0.0, (used - start) / (stop - start))))


class Trainer:
    """A network in training.

    Args:
        samples: Of the kind of query; their generator is the source of everything random.
        hidden: Hidden widths.
        activation: A name in ``ACTIVATIONS``.
        octaves: Of the positional encoding.
        recipe: Constants; those of the kind of query if ``None``.

    Attributes:
        network: The parameters as they are now.
        false_positives: Estimated share of false positives, of all uniform samples, at the last refresh.
        false_negatives: Share of the worst positives that the paper's threshold of 0 would deny.
        decay: Of the hidden layers' weights, times the learning rate, a step: smaller weights bend f less, which shortens its proof.
    """

    def __init__(
        self,
        samples: Samples,
        hidden: tuple[int, ...],
        activation: str,
        octaves: int = 0,
        recipe: Recipe | None = None,
    ):
        self.recipe = recipe or recipe_of(samples.query, samples.ndim)
        self.samples, self.generator = samples, samples.generator
        self.network = TrainableNetwork(samples.ndim, hidden, activation, octaves)
        self._initialise()
        self.false_positives = self.false_negatives = 1.0
        self.decay = 0.0
        self._hard: torch.Tensor | None = None  # states
        self._best = (math.inf, self.network.flat.clone())
        self._batches: tuple[Batches, Batches] | None = None

    def _initialise(self) -> None:
        """Weights to begin with."""
        network, samples = self.network, self.samples
        waves = network.act.wave and not network.octaves
        gains = ("first_gain", "later_gain") if waves else ("first_gain_plain", "later_gain_plain")
        network.initialise(*(getattr(self.recipe, g) for g in gains), self.generator)
        # An axis of few cells carries less detail than its range in v would suggest.
        network.layers[0][:, : samples.ndim] *= samples.detail.T

    def _optimiser(self) -> Soap:
        """What changes the weights."""
        return Soap(self.network.layers, self.recipe.beta1, self.recipe.beta2)

    def run(
        self,
        clock: Clock,
        *,
        counterexamples: Callable[["Trainer", float], None] | None = None,
        progress: Progress | None = None,
    ) -> None:
        """Train until the clock's budget is used up, or an interrupt.

        Args:
            clock: The budget; its count of steps goes on.
            counterexamples: Called before every refresh with this trainer and the used fraction; may call ``add``.
            progress: Called at every refresh with the used fraction and a note on rates.
        """
        recipe, optimiser = self.recipe, self._optimiser()
        with Team(cpu_threads()) as team:
            workers = self.workers(team)
            for step, used in clock.steps():
                if step % recipe.refresh == 0:
                    if counterexamples:
                        counterexamples(self, used)
                    self._refresh(team, workers, used)
                    if progress:
                        rates = f"FP {100 * self.false_positives:.1f} %, FN at 0: {100 * self.false_negatives:.1f} % of the worst"
                        progress(used, rates)
                rate = cosine(recipe.rate, recipe.rate_end, recipe.warm_up, used)
                optimiser.step(self._gradients(team, workers, step % recipe.refresh, used, rate), rate)
                if self.decay:
                    for weight in self.network.layers[:-1]:
                        weight.mul_(1 - rate * self.decay)
            if counterexamples:
                counterexamples(self, 1.0)
            self._refresh(team, workers, 1.0)

    def workers(self, team: Team) -> list[Evaluator]:
        """One for each thread."""
        return [Evaluator(self.network, self.recipe.chunk) for _ in range(team.size)]

    def add(self, v) -> None:
        """Add positives found elsewhere, ``(N, ndim)`` float64 coordinates ``v``, to the hard pool."""
        self.add_states(self.samples.locate(v))

    def add_states(self, state: torch.Tensor) -> None:
        """Add positives found elsewhere, as states ``(S, N)``, to the hard pool."""
        self._hard = state if self._hard is None else torch.cat([state, self._hard], 1)

    def hard_states(self) -> torch.Tensor:
        """``(S, K)``, the worst positives known; none before the first refresh."""
        return self.samples.positives(0) if self._hard is None else self._hard

    def best(self) -> torch.Tensor:
        """The parameters with the fewest estimated false positives so far, flat."""
        return self._best[1]

    def worst_points(self):
        """``(K, ndim)`` float64, the worst positives known, coordinates ``v``: where a proof's search may begin."""
        hard = self.samples.coordinates(self.hard_states())
        return torch.cat([hard, self.samples.vertices], 1).T.double().numpy()

    # --- one refresh -------------------------------------------------------------------------------------------------

    def _refresh(self, team: Team, workers: list[Evaluator], used: float) -> None:
        """Draw new samples, renew the hard pool, estimate the rates, plan the batches until the next refresh."""
        recipe, samples, network = self.recipe, self.samples, self.network
        negative = network.encode(samples.negatives(recipe.pool))
        state = samples.positives(recipe.pool)
        fresh = samples.coordinates(state)
        walked = self._descend(team, workers, samples.positives(recipe.explore), recipe.explore_moves)
        state = torch.cat([walked, self.hard_states(), state], 1)
        values = self._evaluate(team, workers, network.encode(samples.coordinates(state)))
        worst = values.topk(min(recipe.hard, len(values)), largest=False)[1]
        self._hard = self._descend(team, workers, state[:, worst], recipe.moves)
        vertices = samples.vertices
        if vertices.shape[1] > recipe.vertices:
            pick = torch.randint(vertices.shape[1], (recipe.vertices,), generator=self.generator)
            vertices = vertices.index_select(1, pick)
        positive = network.encode(torch.cat([vertices, fresh, samples.coordinates(self._hard)], 1))
        values = self._evaluate(team, workers, torch.cat([negative, positive], 1))
        below, above = values[: negative.shape[1]], values[negative.shape[1] :]
        self._estimate(below, above)

        self._batches = plan(recipe, used, self.generator, (negative, below), (positive, above))

    def _estimate(self, below: torch.Tensor, above: torch.Tensor) -> None:
        """False positives at the least value known on the object; remember the parameters with the fewest."""
        self.false_positives = float((below >= above.min()).sum()) / self.recipe.pool
        hard = above[-self._hard.shape[1] :]
        self.false_negatives = float((hard < 0).float().mean())
        if self.false_positives <= self._best[0]:
            self._best = (self.false_positives, self.network.flat.clone())

    def _evaluate(self, team: Team, workers: list[Evaluator], x: torch.Tensor) -> torch.Tensor:
        values = torch.empty(x.shape[1])

        def job(index: int, part: slice) -> None:
            values[part] = workers[index].forward(x[:, part])

        team.over(x.shape[1], job, self.recipe.chunk)
        return values

    def _descend(self, team: Team, workers: list[Evaluator], state: torch.Tensor, moves: int) -> torch.Tensor:
        """States after some steps down f."""
        state, samples, network = state.clone(), self.samples, self.network

        def job(index: int, part: slice) -> None:
            columns = state[:, part]
            for move in range(moves):
                v = samples.coordinates(columns)
                slope = network.decode_gradient(workers[index].input_gradient(network.encode(v)), v)
                columns = samples.move(columns, slope, 0.4 * 0.8**move)
            state[:, part] = columns

        team.over(state.shape[1], job, self.recipe.chunk)
        return state

    # --- one step ----------------------------------------------------------------------------------------------------

    def _gradients(
        self, team: Team, workers: list[Evaluator], row: int, used: float, rate: float
    ) -> list[torch.Tensor]:
        """Gradients of the loss on the planned batch ``row``, one matrix a layer; ``rate`` is of the step that they are for."""
        accumulate(self._batches, self.recipe, team, workers, row, used)
        return summed(workers)


@dataclass(frozen=True)
class Batches:
    """The batches until the next refresh, of negatives or of positives.

    Attributes:
        x: ``(features + 1, N)``, encoded samples.
        rows: ``(refresh, batch)`` indices into them.
        weight: ``(batch,)``.
        boost: ``(N,)``, of the worst positives' weights; 1 of others.
    """

    x: torch.Tensor
    rows: torch.Tensor
    weight: torch.Tensor
    boost: torch.Tensor | None = None


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
    planned = Batches(negative, chosen, weights / recipe.pool)  # a volume
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
    batches: tuple[Batches, Batches],
    recipe: Recipe,
    team: Team,
    workers: list[Evaluator],
    row: int,
    used: float,
    size: int | None = None,
) -> None:
    """Gradient of the loss on batch ``row`` of negatives and positives, of the workers' network, each worker's share in its ``gradient``.

    Args:
        batches: See ``plan``.
        recipe: Constants.
        team: Of threads.
        workers: One a thread.
        row: Of the batch.
        used: Fraction.
        size: Of a batch; the recipe's if ``None``.
    """
    (weight, width, ramp), (negatives, positives) = weights_of(recipe, used), batches
    for worker in workers:
        worker.gradient.zero_()

    def job(index: int, part: slice) -> None:
        worker = workers[index]
        x = negatives.x.index_select(1, negatives.rows[row, part])
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

    team.over(size or recipe.batch, job, recipe.chunk)


def summed(workers: list[Evaluator]) -> list[torch.Tensor]:
    """The workers' gradients, one matrix a layer; they are the first one's own."""
    for worker in workers[1:]:
        workers[0].gradient.add_(worker.gradient)
    return workers[0].gradients


def _stratified(active: torch.Tensor, recipe: Recipe, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    """Batches drawn from two strata.

    Args:
        active: ``(N,)`` bool, the samples that carry gradient.
        recipe: Batch size, number of batches, share of active ones.
        generator: Source of randomness.

    Returns:
        ``(refresh, batch)`` indices, and ``(batch,)`` weights under which a batch's sum estimates the sum over all samples.
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
