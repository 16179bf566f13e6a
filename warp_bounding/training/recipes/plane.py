"""Training a plane's network: two learned support functions above the object's own, as near as the worst normal allows.

For a normal m (its largest entry 1) the object's planes ``m . y = c`` have ``-h(-m) <= c <= h(m)``. The network's H
and G overestimate ``h(m)`` and ``h(-m)`` by gaps; the threshold is the least gap, so false positives are what the
gaps exceed it by, times the density of the queries' offsets there. The loss is that mean, plus a soft maximum of what
falls short, ever sharper: no label is needed, the supports are known exactly (``geometry``).
"""

from __future__ import annotations

import math

import numpy as np

from warp_bounding.activations import activation_of
from warp_bounding.queries.boundary import ObjectSupport
from warp_bounding.training.engine import (
    Clock,
    RowNetwork,
    Soap,
    cosine,
    geometric,
    initial_layers,
    tensors_of,
)
from warp_bounding.training.lazy_torch import torch
from warp_bounding.training.samples import Problem

__all__ = ["SupportTrainer"]

AT_ONCE = 4096  # normals that are multiplied with all points at a time, so that memory stays small
POOL = 16384  # normals distributed as those of queries, renewed every REFRESH steps
REFRESH = 100  # steps
# Normals of a step: from the pool; uniform on the cube's faces; and the worst ones known.
BATCH, WIDE, HARD = 2048, 1024, 1024
# The density of the queries' offsets is estimated from so many points of the domain, in intervals of c of this
# half-width.
DENSITY_POINTS, DENSITY_WIDTH = 512, 0.1
SHARPNESS, RAMP = (10.0, 3000.0), 0.85  # of the soft maximum: from begin to end, which is at the used fraction RAMP
RATE, RATE_END, WARM_UP = 1e-2, 1e-3, 0.02  # arguments of ``cosine``, the learning rate


class SupportTrainer:
    """Two supports in training, for a problem of planes in their geometric domain."""

    def __init__(self, problem: Problem, hidden: tuple[int, ...], activation: str):
        grid, domain, seed = problem.grid, problem.domain, problem.seed
        self.grid, self.domain, self.ndim, self._problem = grid, domain, grid.ndim, problem
        self.generator, self._rng = torch.Generator().manual_seed(seed), np.random.default_rng(seed)
        hull = ObjectSupport(grid, domain.base)
        self._corners, self._ball = (torch.from_numpy(a.astype(np.float32)) for a in (hull.points, hull.ball))
        self.activation, act = activation, activation_of(activation)
        self.network = RowNetwork(initial_layers([self.ndim, *hidden, 2], act.support_gains, self.generator), act)
        self._best = (math.inf, self.network.copy())

    def finish(self) -> dict[str, np.ndarray]:
        """The parameters with the fewest estimated false positives so far, as a bounder stores them."""
        return tensors_of(self._best[1])

    def worst_points(self) -> None:
        """No normals: the search for the least gap begins without."""

    def _supports(self, m: torch.Tensor) -> torch.Tensor:
        """``h(m)`` and ``h(-m)``, ``(N, 2)``."""
        out = torch.empty(len(m), 2)
        for start in range(0, len(m), AT_ONCE):
            low, high = torch.aminmax(m[start : start + AT_ONCE] @ self._corners.T, dim=1)
            out[start : start + AT_ONCE, 0], out[start : start + AT_ONCE, 1] = high, -low
        return out + (m * self._ball).norm(dim=1, keepdim=True)

    def _faces(self, count: int) -> torch.Tensor:
        """Normals ``(count, n)`` uniform on the cube's faces, some of them on edges."""
        m = torch.rand(count, self.ndim, generator=self.generator) * 2 - 1
        edge = torch.rand(count, self.ndim, generator=self.generator) < 0.15
        m = torch.where(edge, torch.sign(m), m)
        m[torch.arange(count), torch.randint(self.ndim, (count,), generator=self.generator)] = 1.0
        return m

    def _queried(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Normals as queries have them, and the density of the queries' offsets at both supports."""
        v = self.domain.to_local(self._problem.sample(count, self._rng))
        m = torch.from_numpy(v[:, :-1].astype(np.float32))
        first = self.domain.base.to_local(self.grid.sample_lower)
        last = self.domain.base.to_local(self.grid.sample_upper)
        points = torch.from_numpy(self._rng.uniform(first, last, (DENSITY_POINTS, self.ndim)).astype(np.float32))
        supports, density = self._supports(m), torch.empty(count, 2)
        for start in range(0, count, AT_ONCE):
            part = slice(start, start + AT_ONCE)
            offset = m[part] @ points.T
            for side, sign in ((0, 1.0), (1, -1.0)):
                near = (sign * offset - supports[part, side, None]).abs() < DENSITY_WIDTH
                density[part, side] = near.float().mean(1) / (2 * DENSITY_WIDTH)
        return m, density

    def run(self, clock: Clock, on_refresh=None) -> None:
        """Train until the clock's budget is used up, or an interrupt; ``on_refresh`` is not called."""
        optimiser, hard = Soap(self.network.layers, 0.95, 0.95), self._faces(HARD)
        for step, used in clock.steps():
            if step % REFRESH == 0:
                m, density = self._queried(POOL)
                supports = self._supports(m)
                hard = self._refresh(m, density, supports, hard)
                clock.tell(used, f"FP {100 * self._best[0]:.2f} %")
            pick = torch.randint(POOL, (BATCH,), generator=self.generator)
            wide = torch.cat([self._faces(WIDE), hard])
            target = torch.cat([supports[pick], self._supports(wide)])
            sharpness = geometric(*SHARPNESS, min(1.0, used / RAMP))
            with torch.enable_grad():
                gap = self.network(torch.cat([m[pick], wide])) - target
                short = torch.logsumexp(-sharpness * gap.flatten(), 0) - math.log(gap.numel())
                weight = density[pick]
                loss = (gap[:BATCH] * weight).sum() / BATCH + weight.sum() / BATCH * short / sharpness
                gradients = torch.autograd.grad(loss, self.network.layers)
            with torch.no_grad():
                optimiser.step(list(gradients), cosine(RATE, RATE_END, WARM_UP, used))
        m, density = self._queried(POOL)
        self._refresh(m, density, self._supports(m), hard)

    def _refresh(self, m, density, supports, hard) -> torch.Tensor:
        """Estimate the false positives, remember the best parameters, return the worst normals."""
        candidates = torch.cat([self._faces(POOL), hard, m])
        with torch.no_grad():
            gap = (self.network(candidates) - self._supports(candidates)).amin(1)
            least = float(gap.min())
            rate = float((density * (self.network(m) - supports - least)).sum(1).mean())
            if rate <= self._best[0]:
                self._best = (rate, self.network.copy())
            return candidates[gap.topk(HARD, largest=False)[1]]
