"""Training for local thresholds: each part of the domain is judged by the worst positive in it, not by the worst of all.

Towards the end f is taken relative to its part: less the least f of the positives known there, and more the least of
all. A part where the network fails then asks nothing of the others.
"""

import math

import numpy as np
import torch

from warp_bounding.bounders.mlp import Lattice
from warp_bounding.training.recipes.default import NetworkTrainer
from warp_bounding.training.samples.base import Samples

__all__ = ["LocalTrainer"]

# Used fractions between which the parts come in, linearly. Earlier they do harm: a part in which the network fails is let
# go before it has been learned.
BEGIN, END = 0.7, 0.9


class LocalTrainer(NetworkTrainer):
    """A network in training, at thresholds of parts of the domain.

    Attributes:
        lattice: The parts.
        least: ``(parts,)``, the least f of the positives known in each at the last refresh; infinity where there is none.
    """

    def __init__(
        self, samples: Samples, hidden: tuple[int, ...], activation: str, octaves: int = 0, *, lattice: Lattice
    ):
        self.lattice = lattice
        self._edges = [torch.from_numpy(axis) for axis in lattice.edges]
        self.least = torch.full((lattice.count,), math.inf)
        self._offsets, self._used = torch.zeros(lattice.count), 0.0
        super().__init__(samples, hidden, activation, octaves)

    def place(self, x: torch.Tensor) -> torch.Tensor:
        """``(N,)`` index of the part of each encoded sample."""
        place = torch.zeros(x.shape[1], dtype=torch.long)
        for row, edges in zip(x, self._edges, strict=False):
            place = place * (len(edges) + 1) + torch.bucketize(row, edges, right=True)
        return place

    def offset(self, x: torch.Tensor) -> torch.Tensor:
        return self._offsets[self.place(x)]

    def level(self, positive: torch.Tensor, f: torch.Tensor, used: float) -> None:
        self.least = torch.full((self.lattice.count,), math.inf)
        self.least.scatter_reduce_(0, self.place(positive), f, "amin")
        self._used = used
        share = min(max((used - BEGIN) / (END - BEGIN), 0.0), 1.0)
        # A part without positives denies everything: far under all that costs, and no gradient comes from there.
        own = torch.where(self.least.isinf(), self.least.min() + 1e6, self.least)
        self._offsets = share * (own - self.least.min())

    def judge(
        self, negative: torch.Tensor, f_negative: torch.Tensor, positive: torch.Tensor, f_positive: torch.Tensor
    ) -> float:
        if self._used < BEGIN:
            return super().judge(negative, f_negative, positive, f_positive)
        return float((f_negative >= self.least[self.place(negative)]).sum()) / self.recipe.pool

    def worst_points(self) -> np.ndarray:
        fresh = self.samples.coordinates(self.samples.positives(self.recipe.pool))
        return np.concatenate([super().worst_points(), fresh.T.double().numpy()])
