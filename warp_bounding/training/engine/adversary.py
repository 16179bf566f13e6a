"""The least value of a network over all positives of a kind of query, as far as a search finds it.

The prover starts from what this finds, and where it does not end in its time, this sets the threshold. Starts are the
samples' own positives, which prefer what barely touches, and the worst ones that training knew. All walk down f by
projected gradient steps whose length adapts to each: longer after a success, shorter after a failure. The lowest are
kept, few of a kind, walked to a standstill and mixed with relatives (a random step sideways) and fresh starts, until
several rounds in a row have not found anything lower.

Limits: this is a search, not a proof. f has many narrow basins; one that no start falls into is missed. What it
returns earns no confidence by itself: a bound on the rate of false negatives comes from fresh samples afterwards.
"""

from dataclasses import dataclass

import numpy as np
import torch

from warp_bounding.runtime.working_time import working_seconds
from warp_bounding.training.engine.team import Team, single_threaded_torch
from warp_bounding.training.engine.trainable_network import Evaluator, TrainableNetwork
from warp_bounding.training.samples.base import Samples

__all__ = ["Adversary", "adversarial_minimum"]

STARTS, WALKED = 65536, 16384  # fresh starts of a round, of which the lowest so many are walked
KEPT = 4096  # the lowest states ever found, which are kept from round to round
# At most CROWD kept states lie in a box of v of the width BOX (the domain's is 2), so that they do not all end in one
# basin.
CROWD, BOX = 4, 0.125
WALK, POLISH = 6, 12  # steps of fresh starts and of kept states in a round
LONGEST, SHORTEST = 2.0, 1e-3  # lengths of a step, cells
GROWTH, SHRINK = 1.6, 0.4  # factors of a step's length after a success and after a failure
QUIET = 8  # rounds without an improvement that end the search
# Least decrease that counts as an improvement, relative to the standard deviation of f over the kept states, or to 1.
IMPROVEMENT = 1e-4


@dataclass(frozen=True)
class Adversary:
    """What a search found."""

    value: float  # least value of f, in float32
    states: torch.Tensor  # ``(S, K)``, the worst positives, ascending by f
    worst: np.ndarray  # ``(K, ndim)`` float64, their coordinates ``v``
    values: torch.Tensor  # ``(K,)``, f there
    rounds: int  # rounds of the search
    complete: bool  # whether the search ended by itself, not by its time
    seconds: float  # its time


def adversarial_minimum(
    samples: Samples, network: TrainableNetwork, seconds: float, states: torch.Tensor | None = None, rounds: int = 1000
) -> Adversary:
    """Search for the least value of a network over positives.

    Args:
        samples: Samples of the kind of query.
        network: The network; not changed.
        seconds: Time limit.
        states: ``(S, N)``, positives known to be hard.
        rounds: Largest number of rounds; with unlimited time the search is repeatable.
    """
    started = working_seconds()
    with single_threaded_torch():
        search = _Search(samples, network, states)
        quiet = count = 0
        while count < rounds and quiet < QUIET and (not count or working_seconds() - started < seconds):
            before = float(search.values[0]) if len(search.values) else float("inf")
            search.round()
            count += 1
            scale = float(search.values.std()) if len(search.values) > 1 else 1.0
            quiet = 0 if float(search.values[0]) < before - IMPROVEMENT * max(1.0, scale) else quiet + 1
        v = samples.coordinates(search.states).T.double().numpy()
    return Adversary(
        float(search.values[0]), search.states, v, search.values, count, quiet >= QUIET, working_seconds() - started
    )


class _Search:
    def __init__(self, samples: Samples, network: TrainableNetwork, states: torch.Tensor | None):
        self.samples, self.network, self.team = samples, network, Team()
        self.workers = [Evaluator(network) for _ in range(self.team.size)]
        states = samples.positives(0) if states is None else states
        self.states, self.values, self.steps = states, self.evaluate(states), torch.full((states.shape[1],), 0.4)

    def evaluate(self, states: torch.Tensor) -> torch.Tensor:
        values = torch.empty(states.shape[1])

        def job(index: int, part: slice) -> None:
            x = self.network.encode(self.samples.coordinates(states[:, part]))
            values[part] = self.workers[index].forward(x)

        self.team.over(states.shape[1], job)
        return values

    def walk(self, states: torch.Tensor, steps: torch.Tensor, moves: int):
        """States, values and steps after some moves, none of which leads upwards."""
        states, values, steps = states.clone(), torch.empty(states.shape[1]), steps.clone()

        def job(index: int, part: slice) -> None:
            here, step, worker = states[:, part], steps[part], self.workers[index]
            v = self.samples.coordinates(here)
            slope, f = self._slope(worker, v)
            for move in range(moves):
                there = self.samples.move(here, slope.clone(), step)
                v = self.samples.coordinates(there)
                if move < moves - 1:
                    slope_there, f_there = self._slope(worker, v)
                else:
                    slope_there, f_there = slope, worker.forward(self.network.encode(v)).clone()
                better = f_there < f
                here, slope = torch.where(better, there, here), torch.where(better, slope_there, slope)
                f = torch.where(better, f_there, f)
                step = torch.where(better, step * GROWTH, step * SHRINK).clamp_(SHORTEST, LONGEST)
            states[:, part], values[part], steps[part] = here, f, step

        begin = states.clone()
        self.team.over(states.shape[1], job)
        settled = self.samples.settled(begin, states)
        if settled is states:
            return states, values, steps
        values, before = self.evaluate(settled), self.evaluate(begin)
        lower = values < before
        return torch.where(lower, settled, begin), torch.minimum(values, before), steps

    def _slope(self, worker: Evaluator, v: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        x = self.network.encode(v)
        slope = self.network.decode_gradient(worker.input_gradient(x), v)
        return slope, worker.forward(x).clone()

    def round(self) -> None:
        fresh = self.samples.positives(STARTS)
        lowest = self.evaluate(fresh).topk(WALKED, largest=False)[1]
        random = torch.rand(WALKED, generator=self.samples.generator)
        fresh, values, steps = self.walk(fresh[:, lowest], 0.05 * 20.0**random, WALK)
        pools = [(fresh, values, steps)]
        if self.states.shape[1]:
            pools.append(self.walk(self.states, self.steps, POLISH))
            sideways = torch.randn(self.samples.ndim, self.states.shape[1], generator=self.samples.generator)
            length = 0.05 * 40.0 ** torch.rand(self.states.shape[1], generator=self.samples.generator)
            relatives = self.samples.settled(self.states, self.samples.move(self.states, sideways, length))
            pools.append(self.walk(relatives, length * 0.5, WALK))
        states, values, steps = (torch.cat(parts, -1) for parts in zip(*pools, strict=True))
        order = _spread(self.samples.coordinates(states), values.argsort())
        self.states, self.values, self.steps = states[:, order], values[order], steps[order]


def _spread(v: torch.Tensor, order: torch.Tensor) -> torch.Tensor:
    """The first ``KEPT`` of an order ``(N,)`` of which no more than ``CROWD`` are in one small box of ``v`` ``(ndim, N)``.

    Without it, a pool of the worst positives ends as copies of the very worst one.
    """
    box = torch.floor(v.index_select(1, order) / BOX).long()
    key = torch.zeros(box.shape[1], dtype=torch.int64)
    for row in box:
        key = key * 1_000_003 + row  # collisions only drop a sample
    key, place = key.sort(stable=True)
    index = torch.arange(len(key))
    first = torch.where(torch.cat([torch.ones(1, dtype=torch.bool), key[1:] != key[:-1]])[: len(key)], index, 0)
    alone = torch.empty(len(key), dtype=torch.bool)
    alone[place] = index - first.cummax(0)[0] < CROWD
    return order[alone][:KEPT]
