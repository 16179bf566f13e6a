"""Training a plane's network: two learned support functions above the object's own, as near as the worst normal allows.

For a normal m (its largest entry 1) the object's planes ``m . y = c`` have ``-h(-m) <= c <= h(m)``. The network's H and G
overestimate ``h(m)`` and ``h(-m)`` by gaps; the threshold is the least gap, so false positives are what the gaps exceed
it by, times the density of the queries' offsets there. The loss is that mean, plus a soft maximum of what falls short,
ever sharper: no label is needed, the supports are known exactly (``hull_corners``).
"""

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import torch

from warp_bounding.activations import activation_of
from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.geometry.hull import hull_corners
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.queries import sample
from warp_bounding.training.engine.clock import Clock
from warp_bounding.training.engine.soap import Soap

__all__ = ["SupportTrainer"]

POOL = 16384  # normals as queries have them, renewed now and then
BATCH = 2048  # of them a step
WIDE = 1024  # normals uniform on the cube's faces, a step
HARD = 1024  # the worst normals, in every step
REFRESH = 100  # steps
DENSITY_POINTS = 512  # of the domain, per density estimate
DENSITY_WIDTH = 0.1  # in c, likewise
SHARPNESS = (10.0, 3000.0)  # of the soft maximum, from begin to end of the ramp
RAMP = 0.85
RATE, RATE_END, WARM_UP = 1e-2, 1e-3, 0.02


class SupportTrainer:
    """Two supports in training.

    Args:
        grid: The object.
        domain: Of plane queries, geometric.
        hidden: Hidden widths.
        activation: A name in ``ACTIVATIONS``.
        seed: Of everything random.
    """

    def __init__(
        self, grid: IndicatorGrid, domain: RegionDomain, hidden: tuple[int, ...], activation: str, seed: int = 0
    ):
        self.grid, self.domain, self.activation, self.ndim = grid, domain, activation_of(activation), grid.ndim
        self.generator, self._rng = torch.Generator().manual_seed(seed), np.random.default_rng(seed)
        corners = domain.base.to_local(grid.position(hull_corners(grid.occupied) - 0.5))
        self._corners = torch.from_numpy(corners.astype(np.float32))
        first, later = self.activation.support_gains
        self._layers = []
        gains = [first, *[later] * (len(hidden) - 1), 1.0]
        for gain, (k, h) in zip(gains, pairwise([grid.ndim, *hidden, 2]), strict=True):
            layer = (torch.rand(h, k + 1, generator=self.generator) * 2 - 1) / math.sqrt(k)
            layer[:, :-1] *= gain
            self._layers.append(layer.requires_grad_(True))
        self._best = (math.inf, self._copy())

    def _copy(self) -> list[torch.Tensor]:
        return [layer.detach().clone() for layer in self._layers]

    def tensors(self) -> dict[str, np.ndarray]:
        """The best parameters as a bounder stores them."""
        out = {}
        for index, layer in enumerate(self._best[1]):
            out[f"layers.{index}.weight"] = layer[:, :-1].numpy().copy()
            out[f"layers.{index}.bias"] = layer[:, -1].numpy().copy()
        return out

    def _forward(self, m: torch.Tensor) -> torch.Tensor:
        """H and G ``(N, 2)``."""
        for layer in self._layers[:-1]:
            m = self.activation.torch_value(torch.addmm(layer[:, -1], m, layer[:, :-1].T))
        return torch.addmm(self._layers[-1][:, -1], m, self._layers[-1][:, :-1].T)

    def _supports(self, m: torch.Tensor) -> torch.Tensor:
        """``h(m)`` and ``h(-m)``, ``(N, 2)``."""
        out = torch.empty(len(m), 2)
        for start in range(0, len(m), 4096):
            low, high = torch.aminmax(m[start : start + 4096] @ self._corners.T, dim=1)
            out[start : start + 4096, 0], out[start : start + 4096, 1] = high, -low
        return out

    def _faces(self, count: int) -> torch.Tensor:
        """Normals uniform on the cube's faces, a third of them on edges."""
        m = torch.rand(count, self.ndim, generator=self.generator) * 2 - 1
        edge = torch.rand(count, self.ndim, generator=self.generator) < 0.15
        m = torch.where(edge, torch.sign(m), m)
        m[torch.arange(count), torch.randint(self.ndim, (count,), generator=self.generator)] = 1.0
        return m

    def _asked(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Normals as queries have them, and the density of the queries' offsets at both supports."""
        v = self.domain.to_local(sample("plane", self.grid, count, self._rng))
        m = torch.from_numpy(v[:, :-1].astype(np.float32))
        first = self.domain.base.to_local(self.grid.sample_lower)
        last = self.domain.base.to_local(self.grid.sample_upper)
        points = torch.from_numpy(self._rng.uniform(first, last, (DENSITY_POINTS, self.ndim)).astype(np.float32))
        supports, density = self._supports(m), torch.empty(count, 2)
        for start in range(0, count, 4096):
            part = slice(start, start + 4096)
            offset = m[part] @ points.T
            for side, sign in ((0, 1.0), (1, -1.0)):
                near = (sign * offset - supports[part, side, None]).abs() < DENSITY_WIDTH
                density[part, side] = near.float().mean(1) / (2 * DENSITY_WIDTH)
        return m, density

    def run(self, clock: Clock, *, progress: Callable[[float, str], None] | None = None) -> None:
        """Train until the clock's budget is used up, or an interrupt; the best parameters stay."""
        optimiser = Soap(self._layers, 0.95, 0.95)
        step, hard = 0, self._faces(HARD)
        while (used := clock.fraction()) < 1:
            if step % REFRESH == 0:
                m, density = self._asked(POOL)
                supports = self._supports(m)
                hard = self._refresh(m, density, supports, hard)
                if progress:
                    progress(used, f"FP {100 * self._best[0]:.2f} %")
            pick = torch.randint(POOL, (BATCH,), generator=self.generator)
            wide = torch.cat([self._faces(WIDE), hard])
            target = torch.cat([supports[pick], self._supports(wide)])
            share = min(1.0, used / RAMP)
            sharpness = SHARPNESS[0] * (SHARPNESS[1] / SHARPNESS[0]) ** share
            with torch.enable_grad():
                gap = self._forward(torch.cat([m[pick], wide])) - target
                short = torch.logsumexp(-sharpness * gap.flatten(), 0) - math.log(gap.numel())
                weight = density[pick]
                loss = (gap[:BATCH] * weight).sum() / BATCH + weight.sum() / BATCH * short / sharpness
                gradients = torch.autograd.grad(loss, self._layers)
            warm = min(1.0, (used + 1e-3) / WARM_UP)
            rate = RATE * warm * (RATE_END + (1 - RATE_END) * 0.5 * (1 + math.cos(math.pi * min(used, 1.0))))
            with torch.no_grad():
                optimiser.step(list(gradients), rate)
            step += 1
            clock.count += 1
        m, density = self._asked(POOL)
        self._refresh(m, density, self._supports(m), hard)

    def _refresh(self, m, density, supports, hard) -> torch.Tensor:
        """Estimate the false positives, remember the best parameters, return the worst normals."""
        candidates = torch.cat([self._faces(POOL), hard, m])
        with torch.no_grad():
            gap = (self._forward(candidates) - self._supports(candidates)).amin(1)
            least = float(gap.min())
            rate = float((density * (self._forward(m) - supports - least)).sum(1).mean())
            if rate <= self._best[0]:
                self._best = (rate, self._copy())
            return candidates[gap.topk(HARD, largest=False)[1]]
