"""Training ``occupancy``: binary cross-entropy on uniform queries with exact labels, nothing more (the paper's OccNet).

Both kinds of error weigh the same, so that a decision at probability one half leaves some of each: about as many false
negatives as false positives. The optimiser and the initial weights are those of the default recipe, so that both are
trained equally well and can be compared.
"""

from __future__ import annotations

import numpy as np

from warp_bounding.activations import activation_of
from warp_bounding.networks.network import HEADS
from warp_bounding.queries import oracle
from warp_bounding.training.engine import Clock, RowNetwork, Soap, Team, cosine, geometric, initial_layers, tensors_of
from warp_bounding.training.lazy_torch import torch
from warp_bounding.training.samples import Problem

__all__ = ["OccupancyTrainer"]

BATCH = 4096  # samples of a step
POOL, REFRESH = 65536, 50  # samples that are drawn anew after so many steps
# Gains of the first and of later layers for points and activations that are waves, as in the default recipe; elsewhere
# they are those of supports.
POINT_GAINS = (20.0, 3.0)
# Log odds per f of a plane, from begin to end of training: f moves with the offset itself, so its slope is fixed.
SHARPNESS = (10.0, 100.0)
RATE, RATE_END, WARM_UP = 1e-2, 1e-3, 0.02  # arguments of ``cosine``, the learning rate


class OccupancyTrainer:
    """A network in training whose output is the log odds that a query meets the object."""

    def __init__(self, problem: Problem, hidden: tuple[int, ...], activation: str):
        grid, domain, seed = problem.grid, problem.domain, problem.seed
        self.problem, self.domain, self.head, self.team = problem, domain, HEADS[domain.query], Team()
        self.generator, self._rng = torch.Generator().manual_seed(seed), np.random.default_rng(seed)
        self._oracle = oracle(domain.query, grid, "cpu", domain.oracle_length)
        self.activation, act = activation, activation_of(activation)
        widths = [domain.ndim - self.head.offsets, *hidden, 1]
        gains = POINT_GAINS if domain.tested_as_point and act.wave else act.support_gains
        layers = initial_layers(widths, gains, self.generator)
        layers[-1] = layers[-1].repeat(self.head.outputs, 1)
        self.network = RowNetwork(layers, act)

    def finish(self) -> dict[str, np.ndarray]:
        """The network as it is, as ``Occupancy`` stores it."""
        return tensors_of(self.network.copy())

    def draw(self, count: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Rows of inputs, offsets of planes (else zeros), and the truth as 0 and 1."""
        q = self.problem.sample(count, self._rng)
        truth = torch.from_numpy(np.asarray(self._oracle(q), dtype=np.float32))
        v = torch.from_numpy(self.domain.to_local(q).astype(np.float32))
        offset = v[:, -1].clone() if self.head.offsets else torch.zeros(count)
        v = v[:, : v.shape[1] - self.head.offsets]
        return v.contiguous(), offset, truth

    def forward(self, h: torch.Tensor, offset: torch.Tensor) -> torch.Tensor:
        """``f`` ``(N,)``: log odds, or for planes what they are proportional to."""
        out = self.network(h)
        return torch.minimum(out[:, 0] - offset, out[:, 1] + offset) if self.head.offsets else out[:, 0]

    def run(self, clock: Clock, on_refresh=None) -> None:
        """Train until the clock's budget is used up, or an interrupt; ``on_refresh`` is not called."""
        optimiser = Soap(self.network.layers, 0.95, 0.95)
        for step, used in clock.steps():
            if step % REFRESH == 0:
                pool = self.draw(POOL)
                if clock.progress:
                    f, truth = self.forward(pool[0], pool[1]) >= 0, pool[2] > 0
                    fp, fn = (float(x.float().mean()) for x in (f & ~truth, ~f & truth))
                    clock.tell(used, f"FP {100 * fp:.1f} %, FN {100 * fn:.1f} %")
            pick = torch.randint(POOL, (BATCH,), generator=self.generator)
            sharpness = geometric(*SHARPNESS, min(used, 1.0)) if self.head.offsets else 1.0
            gradients = self._gradients(sharpness, *(part[pick] for part in pool))
            optimiser.step(gradients, cosine(RATE, RATE_END, WARM_UP, used))

    def _gradients(self, sharpness: float, h, offset, truth) -> list[torch.Tensor]:
        shares: list = [None] * self.team.size

        def job(index: int) -> None:
            part = self.team.share(index, len(h))
            with torch.enable_grad():
                f = sharpness * self.forward(h[part], offset[part])
                loss = torch.nn.functional.binary_cross_entropy_with_logits(f, truth[part], reduction="sum") / len(h)
                shares[index] = torch.autograd.grad(loss, self.network.layers)

        self.team.run(job)
        return [torch.stack(parts).sum(0) for parts in zip(*shares, strict=True)]
