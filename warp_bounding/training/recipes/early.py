"""Training a network with exits, ``mlp-early``: together with the network first, then each exit by itself.

An *exit* is a linear output on a hidden layer's activations with a threshold of its own, which may only answer *no*
(``bounders.neural.mlp_early``). ``EarlyTrainer`` is the default recipe (``recipes.default``) with every exit's loss
added at the weight ``JOINT`` in the layers that it shares, because layers that were trained for the final output alone
are a poor basis for an exit. Measured for 3D points of the bunny: an exit lets 9 % of all points pass wrongly instead
of 22 to 42 %, the whole network 4.7 instead of 4.4 %, and a step takes a third longer. ``train_exits`` then finishes
the exits by Newton steps while the layers stay as they are. The exits of a plane's network are supports, trained by
``recipes.plane`` behind finished layers.

Limits: exits cost the network some of its own tightness, and time. Exits of planes are only as good as the layers
behind which they are trained.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from torch.nn.functional import softplus

from warp_bounding.runtime.launch import cpu_threads
from warp_bounding.training.engine.clock import Clock, TrainingProgress
from warp_bounding.training.engine.soap import Soap
from warp_bounding.training.engine.team import Team
from warp_bounding.training.engine.trainable_network import Evaluator, TrainableNetwork
from warp_bounding.training.recipes.default import Trainer
from warp_bounding.training.recipes.loss import Batches, accumulate, plan, schedule, summed, weights_of
from warp_bounding.training.recipes.plane import SupportTrainer

__all__ = ["EXIT_SHARE", "EarlyTrainer", "TrainedExits", "train_exits"]

EXIT_SHARE = 0.05  # share of a budget for each exit behind the finished network
JOINT = 0.3  # weight of an exit's gradient in the layers that it shares
JOINT_BATCH = 0.5  # an exit's batch in joint training, as a share of the recipe's
# In joint training an exit keeps so many hard positives of its own, the worst of these and of so many fresh ones that
# have walked down its output so many steps.
JOINT_HARD, JOINT_EXPLORE, JOINT_MOVES = 2048, 8192, 3
FINISH = 0.8  # used fraction at which an exit that joint training has begun enters its schedules again
REFRESH = 4  # Newton steps between two refreshes of the samples
# What differs from the network's recipe. A Newton step takes all samples, so no batch is needed, and the least number
# is planned: ``refresh`` is the number of batches.
EXIT_RECIPE = {"refresh": 1, "vertices": 32768, "explore": 8192}
DAMPING = 1e-4  # added to the Hessian's diagonal, relative to its mean entry
HALVINGS = 6  # tries of a Newton step, each half as long, until one lowers the loss


class TrainedExits(NamedTuple):
    """Exits, and what setting their thresholds needs.

    Attributes:
        tensors: ``exits.i.weight`` and ``exits.i.bias`` as ``MlpEarly`` stores them.
        networks: Per exit the network that ends there, for an adversarial search; none for planes.
        states: Per exit the states of the worst positives known, for the same search; none for planes.
        points: Per exit ``(K, ndim)`` float64, their coordinates ``v``, where a proof's search may begin; none for
            planes.
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
    progress: TrainingProgress | None = None,
) -> TrainedExits:
    """Train one exit behind each hidden layer but the last.

    Call it under ``single_threaded_torch``. Randomness comes from the trainer's own generator.

    Args:
        trainer: The network's trainer after training, whose samples and hard positives are used.
        tensors: The network as a bounder stores it; not changed.
        seconds: Time for all exits together.
        steps: Number of steps of each exit in place of a time, for repeatable runs.
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
            exit_trainer = trainer.behind(layers[: index + 1])
        else:
            known = trainer.outputs[index] if isinstance(trainer, EarlyTrainer) else None
            exit_trainer = _ExitTrainer(trainer, layers[: index + 1], known)

        def report(used: float, note: str, index: int = index) -> None:
            if progress:
                progress((index + min(used, 1.0)) / depth, f"exit {index + 1}: {note}")

        exit_trainer.run(Clock(seconds / depth, steps), progress=report)
        best = exit_trainer.best()
        row = best[-1] if support else exit_trainer.network.split(best)[-1]
        exits.tensors[f"exits.{index}.weight"] = row[:, :-1].numpy().copy()
        exits.tensors[f"exits.{index}.bias"] = row[:, -1].numpy().copy()
        if not support:
            exit_trainer.network.flat.copy_(best)
            exits.networks.append(exit_trainer.network)
            exits.states.append(exit_trainer.hard_states())
            exits.points.append(exit_trainer.worst_points())
    return exits


class _JointExit:
    """An exit in joint training: the layers are the network's, the output and the hard positives are its own."""

    def __init__(self, trainer: Trainer, depth: int):
        full = trainer.network
        self.network = TrainableNetwork(full.ndim, full.hidden[:depth], full.activation, full.octaves)
        self.output = self.network.layers[-1]
        uniform = torch.rand(self.output.shape, generator=trainer.generator) * 2 - 1
        self.output.copy_(uniform).div_(math.sqrt(self.output.shape[1]))
        # The hidden layers are the full network's own tensors, whose steps are so seen here. Of ``self.network.flat``
        # only the output is in use from now on.
        self.network.layers[:-1] = full.layers[:depth]
        self.workers = [Evaluator(self.network) for _ in range(cpu_threads())]
        self.optimiser = Soap([self.output], trainer.recipe.beta1, trainer.recipe.beta2)
        self.hard: torch.Tensor | None = None
        self.batches: tuple[Batches, Batches] | None = None


class EarlyTrainer(Trainer):
    """``Trainer`` of a network with an exit behind each hidden layer but the last; same arguments."""

    def __init__(self, samples, hidden, activation, octaves=0, recipe=None):
        super().__init__(samples, hidden, activation, octaves, recipe)
        self.exits = [_JointExit(self, depth) for depth in range(1, len(hidden))]
        self.outputs = [each.output.clone() for each in self.exits]  # as they were with the best network

    def _refresh(self, team: Team, workers: list[Evaluator], used: float) -> None:
        best = self._best
        super()._refresh(team, workers, used)
        if self._best is not best:
            self.outputs = [each.output.clone() for each in self.exits]
        negative, positive = (batches.x for batches in self._batches)
        recipe = replace(self.recipe, batch=int(self.recipe.batch * JOINT_BATCH))
        for each in self.exits:
            state = self.samples.positives(JOINT_EXPLORE)
            state = state if each.hard is None else torch.cat([each.hard, state], 1)
            state = self._descend(team, each.workers, state, JOINT_MOVES)
            encoded = self.network.encode(self.samples.coordinates(state))
            worst = self._evaluate(team, each.workers, encoded).topk(min(JOINT_HARD, state.shape[1]), largest=False)[1]
            each.hard = state[:, worst]
            positives = torch.cat([encoded[:, worst], positive], 1)
            below, above = (self._evaluate(team, each.workers, x) for x in (negative, positives))
            each.batches = plan(recipe, used, self.generator, (negative, below), (positives, above))

    def _gradients(
        self, team: Team, workers: list[Evaluator], row: int, used: float, rate: float
    ) -> list[torch.Tensor]:
        """The exits make their own steps here, and their losses count in the layers that they share."""
        accumulate(self._batches, self.recipe, team, workers, row, used)
        for each in self.exits:
            accumulate(each.batches, self.recipe, team, each.workers, row, used, int(self.recipe.batch * JOINT_BATCH))
            *shared, output = summed(each.workers)
            for total, part in zip(workers[0].gradients, shared, strict=False):
                total.add_(part, alpha=JOINT)
            each.optimiser.step([output], rate)
        return summed(workers)


class _ExitTrainer(Trainer):
    """A network of which only the output is trained, some fifty weights, by damped Newton steps on all samples.

    Args:
        trainer: The whole network's trainer.
        layers: The hidden layers, which stay as they are.
        output: ``(1, H + 1)``, the output that joint training has begun; random if ``None``.
    """

    def __init__(self, trainer: Trainer, layers: list[torch.Tensor], output: torch.Tensor | None = None):
        full = trainer.network
        recipe = replace(trainer.recipe, **EXIT_RECIPE)
        hidden = tuple(full.hidden[: len(layers)])
        super().__init__(trainer.samples, hidden, full.activation, full.octaves, recipe)
        for own, layer in zip(self.network.layers, [*layers, *([] if output is None else [output])], strict=False):
            own.copy_(layer)
        self._begin = 0.0 if output is None else FINISH
        self.add_states(trainer.hard_states())

    def run(self, clock: Clock, *, on_refresh=None, progress: TrainingProgress | None = None) -> None:
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
        """One damped Newton step of the output's weights.

        The loss is ``recipes.loss``'s over all samples, from their activations ``(N, H + 1)``: the mean over negatives
        of ``softplus(f) - softplus(f - ramp)``, and over positives of ``width softplus(-f / width) boost``. The ramp's
        concave part is left out of the Hessian, which is then positive definite.
        """
        recipe, output = self.recipe, self.network.layers[-1][0]
        weight, width, ramp = weights_of(recipe, used)
        w_negative, w_positive = weight**-0.5 / recipe.pool, weight**0.5 / len(positive)
        level = (positive @ output).kthvalue(min(recipe.boosted, len(positive)))[0]
        boost = 1 + (schedule(recipe.boost, used, 0.6, 0.95) - 1) * (positive @ output <= level).float()

        def loss(at: torch.Tensor) -> float:
            f_negative, f_positive = negative @ at, positive @ at
            below = (softplus(f_negative) - softplus(f_negative - ramp)).sum() * w_negative
            return float(below + (softplus(-f_positive / width) * boost).sum() * (w_positive * width))

        s_negative = torch.sigmoid(negative @ output)
        s_positive = torch.sigmoid((positive @ output).div_(-width))
        pull_down, push_up = s_negative - torch.sigmoid(negative @ output - ramp), s_positive * boost
        gradient = (pull_down @ negative) * w_negative - (push_up @ positive) * w_positive
        curvature = [
            (s_negative * (1 - s_negative)).mul_(w_negative),
            (push_up * (1 - s_positive)).mul_(w_positive / width),
        ]
        hessians: list = [None] * team.size  # one a thread, added in order: the sum does not depend on who is first

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
        now, length = loss(output), 1.0
        for _ in range(HALVINGS):
            if loss(output - length * change) < now:
                output -= length * change
                return
            length *= 0.5
