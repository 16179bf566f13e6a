"""Training the exits of ``mlp-early`` behind the finished layers of a network, which stay as they are.

The network itself is trained as for ``mlp``; so its false positives are those of ``mlp``, and exits can only take some away.
An exit is linear in its layer's activations, so these are computed once per refresh and a step costs a few products of a
matrix and a vector: a tenth of the budget is plenty. Loss, schedules and samples are those of the main recipe (``loop``),
but for the hard positives, which are the exit's own; a plane's exits are supports, trained as in ``support``.

Limits: exits trained together with the network could be tighter, at the cost of the network's own tightness.
"""

import copy
import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch

from warp_bounding.launch import cpu_threads
from warp_bounding.training.clock import Clock
from warp_bounding.training.loop import Trainer, schedule
from warp_bounding.training.network import Evaluator, TrainableNetwork
from warp_bounding.training.soap import Soap
from warp_bounding.training.support import SupportTrainer
from warp_bounding.training.team import Team

__all__ = ["EXIT_SHARE", "TrainedExits", "train_exits"]

EXIT_SHARE = 0.1  # of a budget, for all exits
REFRESH = 400  # steps: cheaper than the main network's, so more of them between two refreshes

Progress = Callable[[float, str], None]


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
        head = (_SupportExit if support else _Exit)(trainer, layers[: index + 1])

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


class _Exit(Trainer):
    """A network whose output alone is trained; batches are rows of activations."""

    def __init__(self, trainer: Trainer, layers: list[torch.Tensor]):
        full = trainer.network
        recipe = replace(trainer.recipe, refresh=REFRESH)
        hidden = tuple(full.hidden[: len(layers)])
        super().__init__(trainer.samples, hidden, full.activation, full.octaves, full.moments, recipe)
        for own, layer in zip(self.network.layers, layers, strict=False):
            own.copy_(layer)
        self.add_states(trainer.hard_states())

    def run(self, clock: Clock, *, counterexamples=None, progress: Progress | None = None) -> None:
        """See ``Trainer``."""
        recipe, threads = self.recipe, cpu_threads()
        team = Team(threads)
        workers = [Evaluator(self.network, recipe.chunk) for _ in range(threads)]
        head, step = self.network.layers[-1], 0
        optimiser = Soap([head], recipe.beta1, recipe.beta2)
        try:
            while (used := clock.fraction()) < 1:
                if step % recipe.refresh == 0:
                    self._refresh(team, workers, used)
                    self._batches = [(self._activations(team, x), *rest) for x, *rest in self._batches]
                    if progress:
                        progress(used, f"FP {100 * self.false_positives:.1f} %")
                gradient = self._head_gradient(head[0], step % recipe.refresh, used)
                warm = min(1.0, (used + 1e-3) / recipe.warm_up)
                cosine = recipe.rate_end + (1 - recipe.rate_end) * 0.5 * (1 + math.cos(math.pi * min(used, 1.0)))
                optimiser.step([gradient], recipe.rate * warm * cosine)
                step += 1
                clock.count += 1
            self._refresh(team, workers, 1.0)
        finally:
            team.close()

    def _activations(self, team: Team, x: torch.Tensor) -> torch.Tensor:
        """``(N, H + 1)`` activations of the last layer, and ones, for encoded columns; a batch then copies whole rows."""
        rows = torch.ones(x.shape[1], self.network.hidden[-1] + 1)

        def job(index: int) -> None:
            first, last = (x.shape[1] * k // team.size for k in (index, index + 1))
            for start in range(first, last, self.recipe.chunk):
                part = slice(start, min(start + self.recipe.chunk, last))
                h = x[:, part]
                for layer in self.network.layers[:-1]:
                    z = layer @ h
                    z = torch.sin(z) if self.network.activation == "sin" else z.clamp_(min=0)
                    h = torch.cat([z, torch.ones(1, z.shape[1])])
                rows[part] = h.T

        team.run(job)
        return rows

    def _head_gradient(self, head: torch.Tensor, row: int, used: float) -> torch.Tensor:
        """Gradient of ``Trainer``'s loss in the output's weights, ``(1, H + 1)``."""
        recipe = self.recipe
        weight = schedule(recipe.weight, used, 0.0, recipe.ramp)
        width = schedule(recipe.sharpness, used, 0.0, recipe.ramp)
        ramp = schedule(recipe.give_up, used, 0.3, 0.95, begin=40.0)
        (negative, negative_rows, negative_weight), (positive, positive_rows, positive_weight, boost) = self._batches
        h = negative.index_select(0, negative_rows[row])
        f = h @ head
        signal = torch.sigmoid(f)
        if ramp < 30:
            signal -= torch.sigmoid(f - ramp)
        gradient = signal.mul_(negative_weight).mul_(weight**-0.5) @ h
        chosen = positive_rows[row]
        h = positive.index_select(0, chosen)
        signal = torch.sigmoid((h @ head).div_(-width)).mul_(positive_weight).mul_(boost[chosen])
        return (gradient - (signal @ h) * weight**0.5)[None]


class _SupportExit(SupportTrainer):
    """A plane's two outputs on finished layers: the trainer's own loop sees one layer, behind fixed activations."""

    def __init__(self, trainer: SupportTrainer, layers: list[torch.Tensor]):
        self.__dict__.update(copy.copy(trainer).__dict__)
        self._fixed = layers
        width = len(layers[-1])
        head = (torch.rand(2, width + 1, generator=self.generator) * 2 - 1) / math.sqrt(width)
        self._layers = [head.requires_grad_(True)]
        self._best = (math.inf, self._copy())

    def best(self) -> list[torch.Tensor]:
        """The layers with the fewest estimated false positives so far."""
        return self._best[1]

    def _forward(self, m: torch.Tensor) -> torch.Tensor:
        with torch.no_grad():
            for layer in self._fixed:
                m = torch.addmm(layer[:, -1], m, layer[:, :-1].T)
                m = torch.sin(m) if self.activation == "sin" else torch.relu(m)
        return super()._forward(m)
