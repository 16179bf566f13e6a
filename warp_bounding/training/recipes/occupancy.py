"""Training ``occupancy``: binary cross-entropy on uniform queries with exact labels, nothing more (the paper's OccNet).

Both kinds of error weigh the same, so that a decision at probability one half leaves some of each: about as many false
negatives as false positives. The optimiser and the initial weights are those of the main recipe; it is trained as
well as that is, to be compared with fairly.
"""

import math
from collections.abc import Callable

import numpy as np
import torch
from torch.nn.functional import binary_cross_entropy_with_logits

from warp_bounding.activations import activation_of
from warp_bounding.coordinates.domain import Domain
from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.queries import oracle, sample
from warp_bounding.runtime.launch import cpu_threads
from warp_bounding.training.engine.clock import Clock
from warp_bounding.training.engine.soap import Soap
from warp_bounding.training.engine.team import Team, single_threaded_torch
from warp_bounding.training.engine.trainable_network import TrainableNetwork

__all__ = ["train_occupancy"]

BATCH = 4096
POOL = 65536  # samples, renewed
REFRESH = 50  # steps
POINT_GAINS = (20.0, 3.0)  # initial weights of waves of points: as in the main recipe; elsewhere as for supports
SHARPNESS = (
    10.0,
    100.0,
)  # a plane's log odds per f, from begin to end: f moves with the offset itself, its slope is fixed
RATE, RATE_END, WARM_UP = 1e-2, 1e-3, 0.02

Progress = Callable[[float, str], None]


def train_occupancy(
    grid: IndicatorGrid,
    domain: Domain | RegionDomain,
    hidden: tuple[int, ...],
    activation: str,
    clock: Clock,
    *,
    octaves: int = 0,
    seed: int = 0,
    progress: Progress | None = None,
) -> dict[str, np.ndarray]:
    """Train a network whose output is the log odds that a query meets the object.

    Args:
        grid: The object.
        domain: Of the kind of query.
        hidden: Hidden widths.
        activation: A name in ``ACTIVATIONS``.
        clock: The budget. Ctrl-C ends training early, with the network as it is.
        octaves: Of the positional encoding; none for planes.
        seed: Of everything random.
        progress: Called with the used fraction and a note.

    Returns:
        Tensors as ``Occupancy`` stores them.
    """
    learner = _Learner(grid, domain, hidden, activation, octaves, seed)
    with single_threaded_torch():
        team = Team(cpu_threads())
        try:
            learner.run(team, clock, progress)
        except KeyboardInterrupt:
            pass
        finally:
            team.close()
    return learner.tensors()


class _Learner:
    """The network, and the samples it learns from. Layers are ``(out, in + 1)`` matrices, samples are rows."""

    def __init__(self, grid, domain, hidden, activation, octaves, seed):
        self.grid, self.domain, self.activation = grid, domain, activation_of(activation)
        self.plane = domain.query == "plane"
        generator, self._rng = torch.Generator().manual_seed(seed), np.random.default_rng(seed)
        self.generator = generator
        self._oracle = oracle(domain.query, grid, "cpu", domain.length or 1.0)
        inputs = grid.ndim if self.plane else domain.ndim
        self._inputs = TrainableNetwork(inputs, hidden, activation, octaves)
        waves = domain.query == "point" and self.activation.wave and not octaves
        first, later = POINT_GAINS if waves else self.activation.support_gains
        self._inputs.initialise(first, later, generator)
        self.layers = [layer.clone() for layer in self._inputs.layers]
        if self.plane:
            self.layers[-1] = torch.cat([self.layers[-1], self.layers[-1].clone()])
        for layer in self.layers:
            layer.requires_grad_(True)

    def tensors(self) -> dict[str, np.ndarray]:
        out = {name: value.numpy().copy() for name, value in self._inputs.encoding.items()}
        for index, layer in enumerate(self.layers):
            out[f"layers.{index}.weight"] = layer.detach()[:, :-1].numpy().copy()
            out[f"layers.{index}.bias"] = layer.detach()[:, -1].numpy().copy()
        return out

    def draw(self, count: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Rows of inputs, offsets of planes (else zeros), and the truth as 0 and 1."""
        q = sample(self.domain.query, self.grid, count, self._rng)
        truth = torch.from_numpy(np.asarray(self._oracle(q), dtype=np.float32))
        v = torch.from_numpy(self.domain.to_local(q).astype(np.float32))
        offset = v[:, -1].clone() if self.plane else torch.zeros(count)
        v = v[:, : self.grid.ndim] if self.plane else v
        return self._inputs.encode(v.T)[:-1].T.contiguous(), offset, truth

    def forward(self, h: torch.Tensor, offset: torch.Tensor) -> torch.Tensor:
        """``f`` ``(N,)``: log odds, or for planes what they are proportional to."""
        for layer in self.layers[:-1]:
            h = self.activation.torch_value(torch.addmm(layer[:, -1], h, layer[:, :-1].T))
        out = torch.addmm(self.layers[-1][:, -1], h, self.layers[-1][:, :-1].T)
        return torch.minimum(out[:, 0] - offset, out[:, 1] + offset) if self.plane else out[:, 0]

    def run(self, team: Team, clock: Clock, progress: Progress | None) -> None:
        optimiser, step = Soap(self.layers, 0.95, 0.95), 0
        while (used := clock.fraction()) < 1:
            if step % REFRESH == 0:
                pool = self.draw(POOL)
                if progress:
                    f, truth = self.forward(pool[0], pool[1]) >= 0, pool[2] > 0
                    fp, fn = (float(x.float().mean()) for x in (f & ~truth, ~f & truth))
                    progress(used, f"FP {100 * fp:.1f} %, FN {100 * fn:.1f} %")
            pick = torch.randint(POOL, (BATCH,), generator=self.generator)
            sharpness = SHARPNESS[0] * (SHARPNESS[1] / SHARPNESS[0]) ** min(used, 1.0) if self.plane else 1.0
            gradients = self._gradients(team, sharpness, *(part[pick] for part in pool))
            warm = min(1.0, (used + 1e-3) / WARM_UP)
            rate = RATE * warm * (RATE_END + (1 - RATE_END) * 0.5 * (1 + math.cos(math.pi * min(used, 1.0))))
            optimiser.step(gradients, rate)
            step += 1
            clock.count += 1

    def _gradients(self, team: Team, sharpness: float, h, offset, truth) -> list[torch.Tensor]:
        shares: list = [None] * team.size

        def job(index: int) -> None:
            part = slice(*(len(h) * k // team.size for k in (index, index + 1)))
            with torch.enable_grad():
                f = sharpness * self.forward(h[part], offset[part])
                loss = binary_cross_entropy_with_logits(f, truth[part], reduction="sum") / len(h)
                shares[index] = torch.autograd.grad(loss, self.layers)

        team.run(job)
        return [torch.stack(parts).sum(0) for parts in zip(*shares, strict=True)]
