"""The paper's networks over the numbers of rays, planes and boxes, trained as it trains them.

Their loss is asymmetric, and samples set the threshold. Nothing is proven of them: they may deny a positive that no
sample shows, and tables count that.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from paper.comparisons import RATE, PaperRecipe, PaperTrainer
from paper.parametric import numbers_of_domain, to_local
from warp_bounding.activations import DEFAULT
from warp_bounding.networks.network import Network
from warp_bounding.queries import oracle, sample
from warp_bounding.queries.region_domain import RegionDomain, domain_of
from warp_bounding.training.engine import Clock, single_threaded_torch
from warp_bounding.training.samples import columns

BATCH, STAGE = 8192, 400  # samples of a step, and steps between two changes of the weights: the paper's take days here
FOR_SAMPLES = 0.1  # of the seconds: for the positives that set the threshold
DRAWN = 1 << 18  # random queries at a time, of whose positives the threshold is the least f
LEAST_DRAWS = 4  # times that, even where no time is left


class RegionSamples:
    """Random regions with their exact truth, as columns ``v``; what ``PaperTrainer`` asks of samples."""

    waves = None

    def __init__(self, grid: Any, domain: RegionDomain, seed: int):
        self.grid, self.domain, self.ndim = grid, domain, 2 * grid.ndim
        self.generator, self._rng = torch.Generator().manual_seed(seed), np.random.default_rng(seed)
        self.detail = torch.ones(self.ndim, 1)
        self._oracle = oracle(domain.query, grid, "cpu", domain.oracle_length)

    def labelled(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """``v`` ``(count, 2 n)`` float64 and the truth of queries of the protocol."""
        x = sample(self.domain.query, self.grid, count, self._rng)
        return to_local(self.domain, x), np.asarray(self._oracle(x), dtype=bool)

    def uniform(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """``labelled``, as columns."""
        v, truth = self.labelled(count)
        return columns(v), torch.from_numpy(truth)

    def positives(self, count: int) -> torch.Tensor:
        """No states: this training moves no positives."""
        return torch.empty(self.ndim, 0)


@dataclass(frozen=True)
class RegionNetwork:
    """A network over the numbers of regions; *maybe* where f is at least the threshold."""

    domain: RegionDomain
    network: Network
    threshold: float

    certificate = None

    def query(self, q: np.ndarray) -> np.ndarray:
        """``(N,)`` bool, *maybe*, of regions that begin in the domain."""
        return self.network(to_local(self.domain, q)) >= self.threshold

    @property
    def nbytes(self) -> int:
        """Bytes that a query reads: the map to v, a threshold, weights and biases."""
        layers = [*self.network.hidden, self.network.output]
        return numbers_of_domain(self.domain, sum(layer.weight.size + layer.bias.size for layer in layers))


def fit(
    grid: Any, query: str, hidden: tuple[int, ...], *, length: float = 1.0, seed: int = 0, seconds: float = 60.0,
    steps: int | None = None,
) -> RegionNetwork:  # fmt: skip
    """Train a network over regions, in seconds or in steps, and set its threshold by samples."""
    domain = domain_of(grid, query, length)
    samples = RegionSamples(grid, domain, seed)
    clock = Clock((1 - FOR_SAMPLES) * seconds, steps)
    with single_threaded_torch(), torch.no_grad():
        trainer = PaperTrainer(samples, hidden, DEFAULT.name)
        trainer.paper = replace(PaperRecipe(), batch=BATCH, stage=STAGE, rate=RATE)
        trainer.run(clock)
        tensors = trainer.finish()
    layers = [(tensors[f"layers.{i}.weight"], tensors[f"layers.{i}.bias"]) for i in range(len(hidden) + 1)]
    network, least, draws = Network(layers, DEFAULT.name, np.full(2 * grid.ndim, 4.0)), np.inf, 0
    while draws < LEAST_DRAWS or (steps is None and clock.seconds < seconds):
        v, truth = samples.labelled(DRAWN)
        least, draws = min(least, float(network(v[truth]).min(initial=np.inf))), draws + 1
    return RegionNetwork(domain, network, least)
