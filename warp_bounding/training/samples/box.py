"""Samples of boxes: a positive is a point p of the object, and how far the box reaches below and above it.

``v = (low, high)`` in local space, inside the domain: low = p - e (p - lower), high = p + e' (upper - p) with e, e' in
[0, 1] per axis. Positives are an up-set (a larger box is one too), so its boundary is made of boxes that touch: where
p is on a cell's face, they reach away from it only. They are most of the positives, of all sizes from 0 to the domain.
"""

import numpy as np
import torch

from warp_bounding.training.samples.base import LEAST, RegionSamples
from warp_bounding.training.samples.cell_points import columns

__all__ = ["BoxSamples"]

TOUCHING_SHARE = 3 / 4  # of the positives: boxes that touch their cell from outside
FACE_SHARE = 0.6  # of the coordinates of p: on a face of the cell
NONE_SHARE = 0.25  # of the reaches e: 0
FULL_SHARES = (0.1, 0.6)  # of the reaches e: 1, up to the domain's border; and of those of slabs
SLABS = 0.3  # of the positives: boxes that reach the domain's border on most sides
REACH_POWERS = (1.0, 4.0)  # the other reaches e are a uniform number to a power between these
REACH = 3.0  # low and high move by so many cells where p moves by one


class BoxSamples(RegionSamples):
    """Random boxes; see ``Samples``. A state: cell, offset, reach below, reach above (n rows each)."""

    query = "box"

    def positives(self, count: int) -> torch.Tensor:
        n, near = self.grid.ndim, int(count * TOUCHING_SHARE)
        cells, offset, side = self.cells.draw_touching(near, FACE_SHARE)
        reach = self._reaches(2 * n, count)
        reach[:n, :near] *= side <= 0
        reach[n:, :near] *= side >= 0
        other_cells, other_offset = self.cells.draw(count - near)
        return torch.cat([torch.cat([cells, other_cells], 1), torch.cat([offset, other_offset], 1), reach])

    def _reaches(self, rows: int, count: int) -> torch.Tensor:
        kind, power = self.cells.rand(rows, count), self.cells.rand(1, count)
        power = REACH_POWERS[0] * (REACH_POWERS[1] / REACH_POWERS[0]) ** power  # large and small boxes
        reach = self.cells.rand(rows, count) ** power
        full = torch.where(self.cells.rand(1, count) < SLABS, FULL_SHARES[1], FULL_SHARES[0])
        reach = torch.where(kind < full, 1.0, reach)
        return torch.where(kind > 1 - NONE_SHARE, 0.0, reach)

    def at(self, z: np.ndarray) -> torch.Tensor:
        # z of ``networks.charts.box``: low and high in cells
        n = self.grid.ndim
        cells, points = [], []
        for low, high in zip(z[:, :n], z[:, n:], strict=True):
            first, last = np.ceil(low - 0.5).astype(int).clip(0), np.floor(high + 0.5).astype(int) + 1
            met = np.argwhere(self.grid.occupancy[tuple(slice(a, b) for a, b in zip(first, last, strict=True))])
            if len(met):
                cell = first + met[0]
                cells.append(cell)
                points.append((np.maximum(low, cell - 0.5) + np.minimum(high, cell + 0.5)) / 2)
            else:
                cells.append(np.full(n, -1))
                points.append(np.zeros(n))
        cells, points = np.array(cells).reshape(-1, n), np.array(points).reshape(-1, n)
        kept = (cells >= 0).all(axis=1)
        state = [columns(cells[kept]), columns(points[kept] - cells[kept])]
        p, low, high = (self.cells.to_local(columns(x[kept])) for x in (points, z[:, :n], z[:, n:]))
        below = (p - low) / (p - self.cells.lower).clamp_(min=LEAST)
        above = (high - p) / (self.cells.upper - p).clamp_(min=LEAST)
        return torch.cat([*state, below.clamp_(0, 1), above.clamp_(0, 1)])

    def coordinates(self, state: torch.Tensor) -> torch.Tensor:
        n, p = self.grid.ndim, self.point(state)
        below, above = state[2 * n : 3 * n], state[3 * n :]
        return torch.cat([p - below * (p - self.cells.lower), p + above * (self.cells.upper - p)])

    def move(self, state: torch.Tensor, slope: torch.Tensor, step: float | torch.Tensor) -> torch.Tensor:
        # components that would leave their range are left out before the step's length is set
        n, unit, p = self.grid.ndim, self.cells.unit, self.point(state)
        offset, below, above = state[n : 2 * n], state[2 * n : 3 * n], state[3 * n :]
        by_low, by_high = slope[:n], slope[n:]
        g_offset = (by_low * (1 - below) + by_high * (1 - above)) * unit
        g_offset = torch.where((offset.abs() >= 0.5) & (g_offset * offset < 0), 0.0, g_offset)
        g_below, g_above = -by_low * (REACH * unit), by_high * (REACH * unit)
        g_below = torch.where(((below <= 0) & (g_below > 0)) | ((below >= 1) & (g_below < 0)), 0.0, g_below)
        g_above = torch.where(((above <= 0) & (g_above > 0)) | ((above >= 1) & (g_above < 0)), 0.0, g_above)
        largest = torch.maximum(g_offset.abs().amax(0), torch.maximum(g_below.abs().amax(0), g_above.abs().amax(0)))
        step = step / (largest + LEAST)
        room_below, room_above = (r.clamp_(min=LEAST) for r in (p - self.cells.lower, self.cells.upper - p))
        return torch.cat(
            [
                state[:n],
                (offset - step * g_offset).clamp_(-0.5, 0.5),
                (below - step * g_below * (REACH * unit / room_below)).clamp_(0, 1),
                (above - step * g_above * (REACH * unit / room_above)).clamp_(0, 1),
            ]
        )
