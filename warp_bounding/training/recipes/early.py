"""Training a network with exits, ``mlp-early``: together with the network first, then each exit by itself.

``EarlyTrainer`` is the main recipe (``loop``), with every exit's loss added at a small weight: layers that serve only
what comes behind them leave a linear exit less to say (3D points, bunny: behind a finished network an exit lets 22 to
42 % of all points pass wrongly, trained with it 9 %, for 4.7 instead of 4.4 % at the end and a third more time a
step). ``train_exits`` then finishes the exits behind layers that stay as they are, by Newton steps. A plane's exits
are supports, trained as in ``support`` behind finished layers.

Limits: exits cost the network some of its own tightness, and time. Exits of planes are only as good as the layers
they find.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from torch.nn.functional import softplus

from warp_bounding.runtime.launch import cpu_threads
from warp_bounding.training.engine.clock import Clock, Progress
from warp_bounding.training.engine.soap import Soap
from warp_bounding.training.engine.team import Team
from warp_bounding.training.engine.trainable_network import Evaluator, TrainableNetwork
from warp_bounding.training.recipes.default import Trainer
from warp_bounding.training.recipes.loss import Batches, accumulate, plan, schedule, summed, weights_of
from warp_bounding.training.recipes.plane import SupportTrainer

__all__ = ["EXIT_SHARE", "EarlyTrainer", "TrainedExits", "train_exits"]

EXIT_SHARE = 0.05  # of a budget, for all exits behind the finished network
JOINT = 0.3  # weight of an exit's gradient in the layers that it shares
JOINT_BATCH = 0.5  # of the recipe's batch
JOINT_HARD, JOINT_EXPLORE, JOINT_MOVES = 2048, 8192, 3  # an exit's own hard positives, and how they are found
FINISH = 0.8  # used fraction of the schedules at which a trained exit is taken up again
REFRESH = 4  # Newton steps between two refreshes of the samples
SAMPLES = {"refresh": 1, "vertices": 32768, "explore": 8192}  # what an exit's recipe has otherwise than the network's
DAMPING = 1e-4  # of the Hessian's mean diagonal entry
HALVINGS = 6  # of a step that leads upwards


class TrainedExits(NamedTuple):
    """Exits, and what setting their thresholds needs.

    Attributes:
        tensors: ``exits.i.weight`` and ``exits.i.bias`` as ``MlpEarly`` stores them.
        networks: Per exit the network that ends there, for an adversarial search; none for planes.
        states: Per exit the worst positives known, likewise; none for planes.
        points: Per exit ``(K, ndim)`` float64, their coordinates ``v``, where a proof's search may begin; none for planes.
    """

    tensors: dict[str, np.ndarray]
    networks: list[TrainableNetwork]
    states: list[torch.Tensor]
    points: list[np.ndarray]


def train_exits(
    trainer: Trainer | SupportTrainer,
    tensors: dict[str, np.ndarray],
    seconds: float,
    steps: int | None = None,
    progress: Progress | None = None,
) -> TrainedExits:
    """Train one exit behind each hidden layer but the last.

    Call it under ``single_threaded_torch``. Randomness comes from the trainer's own generator.

    Args:
        trainer: The network's trainer, at its end: its samples and its hard positives are used.
        tensors: The network as a bounder stores it; not changed.
        seconds: For all exits together.
        steps: Steps of each exit instead, for repeatable runs.
        progress: Called with the used fraction and a note.
    """
    support = isinstance(trainer, SupportTrainer)
    depth = sum(name.startswith("layers.") and name.endswith(".weight") for name in tensors) - 2
    layers = [
        torch.from_numpy(np.column_stack([tensors[f"layers.{k}.weight"], tensors[f"layers.{k}.bias"]]))
        for k in range(depth)
    ]
    exits = TrainedExits({}, [], [], [])
    for index in range(depth):
        if support:
            head = trainer.behind(layers[: index + 1])
        else:
            known = trainer.heads[index] if isinstance(trainer, EarlyTrainer) else None
            head = _Exit(trainer, layers[: index + 1], known)

        def report(used: float, note: str, index: int = index) -> None:
            if progress:
                progress((index + min(used, 1.0)) / depth, f"exit {index + 1}: {note}")

        head.run(Clock(seconds / depth, steps), progress=report)
        row = head.best()[-1] if support else head.network.split(head.best())[-1]
        exits.tensors[f"exits.{index}.weight"] = row[:, :-1].numpy().copy()
        exits.tensors[f"exits.{index}.bias"] = row[:, -1].numpy().copy()
        if not support:
            head.network.flat.copy_(head.best())
            exits.networks.append(head.network)
            exits.states.append(head.hard_states())
            exits.points.append(head.worst_points())
    return exits


class _JointExit:
    """An exit in training with its network: layers are the network's own, the output and hard positives are the exit's."""

    def __init__(self, trainer: Trainer, depth: int):
        full = trainer.network
        self.network = TrainableNetwork(full.ndim, full.hidden[:depth], full.activation, full.octaves)
        self.head = self.network.layers[-1]
        self.head.copy_(torch.rand(self.head.shape, generator=trainer.generator) * 2 - 1).div_(
            math.sqrt(self.head.shape[1])
        )
        self.network.layers[:-1] = full.layers[:depth]
        self.workers = [Evaluator(self.network) for _ in range(cpu_threads())]
        self.optimiser = Soap([self.head], trainer.recipe.beta1, trainer.recipe.beta2)
        self.hard: torch.Tensor | None = None
        self.batches: tuple[Batches, Batches] | None = None


class EarlyTrainer(Trainer):
    """``Trainer`` of a network with an exit behind each hidden layer but the last; same arguments."""

    def __init__(self, samples, hidden, activation, octaves=0, recipe=None):
        super().__init__(samples, hidden, activation, octaves, recipe)
        self.exits = [_JointExit(self, depth) for depth in range(1, len(hidden))]
        self.heads = [own.head.clone() for own in self.exits]

    def _refresh(self, team: Team, workers: list[Evaluator], used: float) -> None:
        best = self._best
        super()._refresh(team, workers, used)
        if self._best is not best:
            self.heads = [own.head.clone() for own in self.exits]
        negative, positive = (batches.x for batches in self._batches)
        recipe = replace(self.recipe, batch=int(self.recipe.batch * JOINT_BATCH))
        for own in self.exits:
            state = self.samples.positives(JOINT_EXPLORE)
            state = state if own.hard is None else torch.cat([own.hard, state], 1)
            state = self._descend(team, own.workers, state, JOINT_MOVES)
            encoded = self.network.encode(self.samples.coordinates(state))
            worst = self._evaluate(team, own.workers, encoded).topk(min(JOINT_HARD, state.shape[1]), largest=False)[1]
            own.hard = state[:, worst]
            positives = torch.cat([encoded[:, worst], positive], 1)
            below, above = (self._evaluate(team, own.workers, x) for x in (negative, positives))
            own.batches = plan(recipe, used, self.generator, (negative, below), (positives, above))

    def _gradients(
        self, team: Team, workers: list[Evaluator], row: int, used: float, rate: float
    ) -> list[torch.Tensor]:
        """See ``Trainer``; the exits make their steps, and their losses count in the layers that they share."""
        accumulate(self._batches, self.recipe, team, workers, row, used)
        for own in self.exits:
            accumulate(own.batches, self.recipe, team, own.workers, row, used, int(self.recipe.batch * JOINT_BATCH))
            *shared, head = summed(own.workers)
            for total, part in zip(workers[0].gradients, shared, strict=False):
                total.add_(part, alpha=JOINT)
            own.optimiser.step([head], rate)
        return summed(workers)


class _Exit(Trainer):
    """A network whose output alone is trained, by damped Newton steps on all samples at once: it has some fifty weights."""

    def __init__(self, trainer: Trainer, layers: list[torch.Tensor], head: torch.Tensor | None = None):
        full = trainer.network
        recipe = replace(trainer.recipe, **SAMPLES)
        hidden = tuple(full.hidden[: len(layers)])
        super().__init__(trainer.samples, hidden, full.activation, full.octaves, recipe)
        for own, layer in zip(self.network.layers, [*layers, *([] if head is None else [head])], strict=False):
            own.copy_(layer)
        self._begin = 0.0 if head is None else FINISH
        self.add_states(trainer.hard_states())

    def run(self, clock: Clock, *, counterexamples=None, progress: Progress | None = None) -> None:
        """See ``Trainer``; a step is one of Newton's."""
        with Team(cpu_threads()) as team:
            workers = self.workers(team)
            for step, used in clock.steps():
                if step % REFRESH == 0:
                    self._refresh(team, workers, self._begin + (1 - self._begin) * used)
                    activations = [self._activations(team, batches.x) for batches in self._batches]
                    if progress:
                        progress(used, f"FP {100 * self.false_positives:.1f} %")
                self._newton(team, *activations, self._begin + (1 - self._begin) * used)
            self._refresh(team, workers, 1.0)

    def _activations(self, team: Team, x: torch.Tensor) -> torch.Tensor:
        """``(N, H + 1)`` activations of the last layer, and ones, for encoded columns."""
        rows = torch.ones(x.shape[1], self.network.hidden[-1] + 1)

        def job(_, part: slice) -> None:
            h = x[:, part]
            for layer in self.network.layers[:-1]:
                z = layer @ h
                h = torch.cat([self.network.act.torch_value(z), torch.ones(1, z.shape[1])])
            rows[part] = h.T

        team.over(x.shape[1], job, self.recipe.chunk)
        return rows

    def _newton(self, team: Team, negative: torch.Tensor, positive: torch.Tensor, used: float) -> None:
        """One step down ``Trainer``'s loss. The concave part of the negatives' ramp is left out of the Hessian."""
        recipe, head = self.recipe, self.network.layers[-1][0]
        weight, width, ramp = weights_of(recipe, used)
        w_negative, w_positive = weight**-0.5 / recipe.pool, weight**0.5 / len(positive)
        level = (positive @ head).kthvalue(min(recipe.boosted, len(positive)))[0]
        boost = 1 + (schedule(recipe.boost, used, 0.6, 0.95) - 1) * (positive @ head <= level).float()

        def loss(at: torch.Tensor) -> float:
            f, g = negative @ at, positive @ at
            below = (softplus(f) - softplus(f - ramp)).sum() * w_negative
            return float(below + (softplus(-g / width) * boost).sum() * (w_positive * width))

        f, g = torch.sigmoid(negative @ head), torch.sigmoid((positive @ head).div_(-width))
        up, down = f - torch.sigmoid(negative @ head - ramp), g * boost
        gradient = (up @ negative) * w_negative - (down @ positive) * w_positive
        curvature = [(f * (1 - f)).mul_(w_negative), (down * (1 - g)).mul_(w_positive / width)]
        hessians: list = [None] * team.size  # in order, so that the sum does not depend on who is first

        def job(index: int) -> None:
            parts = []
            for h, c in zip((negative, positive), curvature, strict=True):
                part = team.share(index, len(h))
                parts.append((h[part] * c[part, None]).T @ h[part])
            hessians[index] = parts[0] + parts[1]

        team.run(job)
        hessian = torch.stack(hessians).sum(0).double()
        damping = DAMPING * float(hessian.diagonal().mean()) + 1e-12
        hessian.diagonal().add_(damping)
        change = torch.linalg.solve(hessian, gradient.double()).float()
        now, length = loss(head), 1.0
        for _ in range(HALVINGS):
            if loss(head - length * change) < now:
                head -= length * change
                return
            length *= 0.5
