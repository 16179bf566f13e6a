"""The default recipe: what the paper's asymmetric loss becomes when seconds count and the threshold is the minimum.

The figure of merit is the volume of negatives above the *least* value on the object, a worst case over a continuous
set. Hence the loss of ``recipes.loss``, and positives from a pool of the worst ones found, which walk down f inside
their cells. Positives that others find, such as the prover, enter the pool by ``add``.

Samples are columns here: coordinates v ``(ndim, N)``, and of positives their *states* ``(S, N)``, from which v follows
(``samples.base``: a cell and an offset in it, for instance) and which stay positive wherever they move.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch

from warp_bounding.training.engine.clock import Clock, cosine
from warp_bounding.training.engine.soap import Soap
from warp_bounding.training.engine.team import Team
from warp_bounding.training.engine.trainable_network import Evaluator, TrainableNetwork
from warp_bounding.training.recipes.loss import Batches, Recipe, accumulate, plan, recipe_of, summed
from warp_bounding.training.samples.base import Samples

__all__ = ["NetworkTrainer"]

# Of a network that begins with the waves of its shape: one layer more makes f bend more, and its proof longer.
WAVE_DECAY = 0.03


class NetworkTrainer:
    """A network in training.

    Args:
        samples: Samples of the kind of query; their generator is the source of everything random.
        hidden: Hidden widths.
        activation: A name in ``ACTIVATIONS``.
        octaves: Octaves of the positional encoding.
        recipe: Constants; those of the kind of query if ``None``.

    Attributes:
        network: The parameters as they are now.
        false_positives: Estimated share of false positives, of all uniform samples, at the last refresh.
        false_negatives: Share of the worst positives that the paper's threshold of 0 would deny.
        hard: ``(S, K)``, states of the worst positives known; none before the first refresh.
        decay: In each step the hidden layers' weights shrink by this times the learning rate: smaller weights bend f
            less, which shortens its proof.
        takes_positives: Whether ``run`` heeds ``on_refresh``, so that positives found by others can enter the training
            (the paper's does not); ``fit_network`` reserves time for finding them only then.
    """

    takes_positives = True

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
        waves = network.act.wave and not network.octaves
        gains = ("first_gain", "later_gain") if waves else ("first_gain_plain", "later_gain_plain")
        network.initialise(*(getattr(self.recipe, g) for g in gains), self.generator)
        # An axis of few cells carries less detail than its range in v would suggest.
        network.layers[0][:, : samples.ndim] *= samples.detail.T
        if waves and samples.waves is not None and samples.waves.shape == network.layers[0].shape:
            network.layers[0].copy_(samples.waves)
            self.decay = WAVE_DECAY

    def _optimiser(self) -> Soap:
        return Soap(self.network.layers, self.recipe.beta1, self.recipe.beta2)

    def run(self, clock: Clock, on_refresh: Callable[[float], None] = lambda used: None) -> None:
        """Train until the clock's budget is used up, or an interrupt.

        Args:
            clock: The budget; its count of steps goes on.
            on_refresh: Called before every refresh with the used fraction, and at the end with 1; it may ``add``
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
        self.add_states(self.samples.locate(v))

    def add_states(self, state: torch.Tensor) -> None:
        """Add positives found elsewhere, as states ``(S, N)``, to the hard pool."""
        self.hard = torch.cat([state, self.hard], 1)

    def finish(self) -> dict[str, np.ndarray]:
        """Take the parameters with the fewest estimated false positives so far; returns them as a bounder stores them."""
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
        walked = self._descend(self.workers, samples.positives(recipe.explore), recipe.explore_moves)
        state = torch.cat([walked, self.hard, state], 1)
        x = network.encode(samples.coordinates(state))
        values = self._relative(x, self._evaluate(self.workers, x))
        worst = values.topk(min(recipe.hard, len(values)), largest=False)[1]
        self.hard = self._descend(self.workers, state[:, worst], recipe.moves)
        vertices = samples.vertices
        if vertices.shape[1] > recipe.vertices:
            pick = torch.randint(vertices.shape[1], (recipe.vertices,), generator=self.generator)
            vertices = vertices.index_select(1, pick)
        positive = network.encode(torch.cat([vertices, fresh, samples.coordinates(self.hard)], 1))
        values = self._evaluate(self.workers, torch.cat([negative, positive], 1))
        f_negative, f_positive = values[: negative.shape[1]], values[negative.shape[1] :]
        self.level(positive, f_positive, used)
        self.false_positives = self.judge(negative, f_negative, positive, f_positive)
        self.false_negatives = float((f_positive[-self.hard.shape[1] :] < 0).float().mean())
        if self.false_positives <= self._best[0]:
            self._best = (self.false_positives, self.network.flat.clone())
        f_negative, f_positive = self._relative(negative, f_negative), self._relative(positive, f_positive)
        planned = plan(recipe, used, self.generator, (negative, f_negative), (positive, f_positive))
        self._batches = tuple(replace(batches, offset=self.offset(batches.x)) for batches in planned)

    def level(self, positive: torch.Tensor, f: torch.Tensor, used: float) -> None:
        """Learn from f of encoded positives what samples are judged by, beside f itself; here nothing."""

    def offset(self, x: torch.Tensor) -> torch.Tensor | None:
        """``(N,)``, what f of encoded samples is taken relative to; ``None`` for 0."""
        return None

    def judge(
        self, negative: torch.Tensor, f_negative: torch.Tensor, positive: torch.Tensor, f_positive: torch.Tensor
    ) -> float:
        """False positives, of all uniform samples, at the least value known on the object."""
        return float((f_negative >= f_positive.min()).sum()) / self.recipe.pool

    def _relative(self, x: torch.Tensor, f: torch.Tensor) -> torch.Tensor:
        offset = self.offset(x)
        return f if offset is None else f - offset

    def _evaluate(self, workers: list[Evaluator], x: torch.Tensor) -> torch.Tensor:
        values = torch.empty(x.shape[1])

        def job(index: int, part: slice) -> None:
            values[part] = workers[index].forward(x[:, part])

        self.team.over(x.shape[1], job)
        return values

    def _descend(self, workers: list[Evaluator], state: torch.Tensor, moves: int) -> torch.Tensor:
        """States ``(S, N)`` after so many moves down f, which shrink from 0.4 cells on."""
        begin, state, samples, network = state, state.clone(), self.samples, self.network

        def job(index: int, part: slice) -> None:
            columns = state[:, part]
            for move in range(moves):
                v = samples.coordinates(columns)
                slope = network.decode_gradient(workers[index].input_gradient(network.encode(v)), v)
                columns = samples.move(columns, slope, 0.4 * 0.8**move)
            state[:, part] = columns

        self.team.over(state.shape[1], job)
        return self.samples.settled(begin, state)

    def _gradients(self, row: int, used: float, rate: float) -> list[torch.Tensor]:
        """Gradients of the loss on the planned batch ``row``, one matrix a layer, for a step at this learning rate."""
        accumulate(self._batches, self.recipe, self.team, self.workers, row, used)
        return summed(self.workers)
