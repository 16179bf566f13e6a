"""Samples of rays: a positive is a point p of the object, and the share t of the ray that lies before it.

``v = (a, w)``: origin and displacement over the whole length, in local space, so a = p - t w. The origin stays in the
domain, which bounds t. Hard for a network is what barely touches: p on a cell's edge or corner with the ray passing
outside, p on a face where the ray ends as it arrives or begins as it leaves. A third of the positives are other rays
through the object, and the protocol's own directions are half of all.
"""

import math
from itertools import product

import numpy as np
import torch

from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.training.samples.base import LEAST, RegionSamples
from warp_bounding.training.samples.cell_points import columns

__all__ = ["RaySamples"]

TOUCHING_SHARE = 0.5  # of the positives: rays that touch their cell from outside
BORDER_SHARE = 0.25  # of the positives: rays from the domain's border to the object's boundary
BORDER_FACE_SHARE = 0.5  # of the coordinates of their origins: on the border
FACE_SHARE = 0.65  # of the coordinates of p: on a face of the cell
END_SHARES = (0.2, 0.5)  # of the other rays: up to the first share begin at p, from there to the second end at p
REACH = 3.0  # t and the direction move by so many cells where p moves by one
ON_BORDER = 1e-5  # of t: an origin this near to the domain's border is on it
SLOWEST = 0.05  # local units: least |w| across a border in its gradient; along the border a slide would be endless
ASIDE = 1e-4  # of a cell: how far beside a point of a face its cell is looked for


class RaySamples(RegionSamples):
    """Random rays; see ``Samples``. A state: cell, offset (n rows each), t (1), unit direction in object space (n)."""

    query = "ray"

    def __init__(self, grid: IndicatorGrid, domain: RegionDomain, generator: torch.Generator):
        super().__init__(grid, domain, generator)
        self._stretch = torch.from_numpy(np.asarray(domain.stretch, dtype=np.float32))[:, None]
        self._cells_long = (self._stretch / self.cells.unit).abs()  # cells that a ray along each axis crosses

    def positives(self, count: int) -> torch.Tensor:
        touching, from_border = int(count * TOUCHING_SHARE), int(count * BORDER_SHARE)
        parts = [
            self._touching(touching),
            self._from_border(from_border),
            self._through(count - touching - from_border),
        ]
        return torch.cat(parts, 1)

    def _touching(self, count: int) -> torch.Tensor:
        """Rays that touch the cell of p from outside, if its neighbours are empty."""
        cells, offset, side = self.cells.draw_touching(count, FACE_SHARE)
        direction = self.directions(count)
        away = side * direction
        leaves, arrives = (away >= 0).all(0), (away <= 0).all(0)
        longest = self._longest(self.cells.to_local(cells + offset), direction)
        share = torch.where(leaves, 0.0, torch.where(arrives, 1.0, self.cells.rand(count) * longest))
        return torch.cat([cells, offset, torch.minimum(share, longest)[None], direction])

    def _from_border(self, count: int) -> torch.Tensor:
        """Rays from the domain, mostly from its border, to the object's boundary, cut to their length."""
        cells, offset, _ = self.cells.draw_touching(count, FACE_SHARE)
        low, high = self.cells.lower, self.cells.upper
        n = self.grid.ndim
        u = (self.cells.rand(n, count) * 2 - 1) * 0.5
        u = torch.where(self.cells.rand(n, count) < BORDER_FACE_SHARE, torch.sign(u) * 0.5, u)
        direction = (self.cells.to_local(cells + offset) - (low + (u + 0.5) * (high - low))) / self._stretch
        t = direction.square().sum(0).sqrt_()
        direction /= t.clamp(min=LEAST)
        longest = self._longest(self.cells.to_local(cells + offset), direction)
        return torch.cat([cells, offset, torch.minimum(t, longest)[None], direction])

    def _through(self, count: int) -> torch.Tensor:
        """Rays through any point of the object, that begin or end there or anywhere."""
        cells, offset = self.cells.draw(count)
        direction, kind = self.directions(count), self.cells.rand(count)
        longest = self._longest(self.cells.to_local(cells + offset), direction)
        share = torch.where(
            kind < END_SHARES[0], 0.0, torch.where(kind < END_SHARES[1], 1.0, self.cells.rand(count) * longest)
        )
        return torch.cat([cells, offset, torch.minimum(share, longest)[None], direction])

    def directions(self, count: int) -> torch.Tensor:
        """``(n, count)`` unit vectors: half by uniform angles as in the protocol, half uniform on the sphere."""
        n = self.grid.ndim
        by_angles = count // 2 if n > 1 else 0
        normal = torch.randn(n, count - by_angles, generator=self.generator)
        normal /= normal.square().sum(0).sqrt().clamp_(min=LEAST)
        if not by_angles:
            return normal
        angle = self.cells.rand(n - 1, by_angles) * math.pi
        angle[-1] *= 2
        direction = torch.ones(n, by_angles)
        for k in range(n - 1):
            direction[k] *= torch.cos(angle[k])
            direction[k + 1 :] *= torch.sin(angle[k])
        both = torch.cat([direction, normal], 1)
        return both.index_select(1, torch.randperm(count, generator=self.generator))

    def settled(self, before: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
        settled, n = super().settled(before, after), self.grid.ndim
        if settled is after:
            return after
        longest = self._longest(self.point(settled), settled[2 * n + 1 :])
        return torch.cat([settled[: 2 * n], torch.minimum(settled[2 * n], longest)[None], settled[2 * n + 1 :]])

    def at(self, z: np.ndarray) -> torch.Tensor:
        # z = (p, t, m) of ``networks.charts.ray``
        n = self.grid.ndim
        p, t, m = z[:, :n], z[:, n], z[:, n + 1 :]
        u = m / np.linalg.norm(m, axis=1, keepdims=True)
        cells, offset = np.zeros_like(p), np.zeros_like(p)
        found = np.zeros(len(p), dtype=bool)
        for side in product((-1.0, 1.0), repeat=n):  # p lies on a face or an edge: beside it there is a cell
            cell, part, kept = self.cells.locate(p + np.array(side) * ASIDE * self.cells.unit.numpy()[:, 0])
            new = kept & ~found
            cells[new], offset[new] = (x.numpy().T[new[kept]] for x in (cell, part))
            found |= new
        return torch.cat([columns(x[found]) for x in (cells, offset, t[:, None], u)])

    def coordinates(self, state: torch.Tensor) -> torch.Tensor:
        n = self.grid.ndim
        w = state[2 * n + 1 :] * self._stretch
        return torch.cat([self.point(state) - state[2 * n] * w, w])

    def move(self, state: torch.Tensor, slope: torch.Tensor, step: float | torch.Tensor) -> torch.Tensor:
        # Components that would leave their range are left out before the step's length is set. An origin that would
        # leave the domain slides along the face that it is on.
        n = self.grid.ndim
        cell, offset, t, direction = state[:n], state[n : 2 * n], state[2 * n], state[2 * n + 1 :]
        w = direction * self._stretch
        by_a, by_w = slope[:n], slope[n:]
        along = (by_a * w).sum(0)
        longest, axis = self._room(self.point(state), direction)
        stuck = (t >= longest - ON_BORDER) & (along > 0)  # f falls with t, which cannot grow
        crossing = w.gather(0, axis[None])[0]
        crossing = torch.where(crossing < 0, crossing.clamp(max=-SLOWEST), crossing.clamp(min=SLOWEST))
        slide = torch.where(stuck & (longest < 1), along / crossing, 0.0)
        by_a = by_a.scatter_add(0, axis[None], -slide[None])
        reach_t = REACH / (direction * self._cells_long).square().sum(0).sqrt_()  # over the ray, in cells
        g_t = torch.where(stuck | ((t <= 0) & (along < 0)), 0.0, -along * reach_t)
        g_offset = by_a * self.cells.unit
        g_offset = torch.where((offset.abs() >= 0.5) & (g_offset * offset < 0), 0.0, g_offset)
        reach_d = REACH / self._cells_long.max()
        g_d = (by_w - t * by_a) * self._stretch
        g_d = (g_d - (g_d * direction).sum(0) * direction) * reach_d
        largest = torch.maximum(torch.maximum(g_offset.abs().amax(0), g_d.abs().amax(0)), g_t.abs())
        step = step / (largest + LEAST)
        offset = (offset - step * g_offset).clamp_(-0.5, 0.5)
        direction = direction - step * reach_d * g_d
        direction /= direction.square().sum(0).sqrt_()
        longest = self._longest(self.cells.to_local(cell + offset), direction)
        t = torch.where(stuck, longest, torch.minimum((t - step * reach_t * g_t).clamp_(min=0), longest))
        return torch.cat([cell, offset, t[None], direction])

    def _longest(self, p: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
        return self._room(p, direction)[0]

    def _room(self, p: torch.Tensor, direction: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """``(N,)`` the largest t <= 1 with p - t w in the domain, and the axis ``(N,)`` whose face is met first."""
        w = direction * self._stretch
        room = torch.where(w > 0, p - self.cells.lower, self.cells.upper - p).clamp_(min=0)
        longest, axis = (room / w.abs().clamp_(min=LEAST)).min(0)
        return longest.clamp_(max=1.0), axis
