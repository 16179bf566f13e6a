"""Learning the normals of half-spaces around the numbers of regions: the paper's OurkDOP. Faces steer the search only."""

from itertools import product

import numpy as np
import torch

from paper.parametric.direction_patches import DirectionPatches
from paper.parametric.supports import ParametricSupport, to_local, v_per_unit
from warp_bounding.bounders.volumes import kdop_directions
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.queries import oracle, sample
from warp_bounding.queries.region_domain import RegionDomain
from warp_bounding.training.engine import Clock, interrupts, single_threaded_torch
from warp_bounding.training.learned_kdop import (
    FEW,
    FINALISTS,
    JITTER,
    MOST_SAMPLES,
    SAMPLES,
    STARTS,
    HalfSpaceProblem,
    descend,
    of_length_1,
    tensor,
)

__all__ = ["learned_normals"]

DIRECTIONS = {2: 64, 3: 12, 4: 4}  # by dimension: directions along an edge of a cube's face, of those that set faces
ENDS = 150  # points of the object that set faces: rays begin or end there
FARTHEST = 64  # positive rays that each normal is set by, between two refreshes
TILTS = (1.0, 0.6, 1.6)  # weights of u relative to those of a in the first half-spaces around planes


class Parameters(HalfSpaceProblem):
    """Half-spaces in R^2n: only the faces depend on the kind of region."""

    def __init__(self, domain: RegionDomain, support: ParametricSupport):
        self.domain, self.support, self.columns = domain, support, 2 * support.ndim
        self.points = tensor(support.points)


class BoxParameters(Parameters):
    """Boxes; see ``ParametricSupport``."""

    def offsets(self, normals: torch.Tensor) -> torch.Tensor:
        x, y = normals.chunk(2, dim=1)
        limit = tensor(self.support.region.limit)
        free = (-x).clamp(min=0) + y.clamp(min=0)
        return super().offsets(x.clamp(min=0) - (-y).clamp(min=0)) + free @ limit


class RayParameters(Parameters):
    """Rays: faces are set by many extreme positives, which begin at the object or end there."""

    def __init__(self, domain: RegionDomain, support: ParametricSupport):
        super().__init__(domain, support)
        n, points = support.ndim, support.points
        if len(points) > ENDS:
            points = points[np.random.default_rng(0).choice(len(points), ENDS, replace=False)]
        w = DirectionPatches.cover(n, DIRECTIONS.get(n, 3)).centers * support.region.stretch
        p, w = (z.reshape(-1, n) for z in np.broadcast_arrays(points[:, None], w[None]))
        with np.errstate(divide="ignore", invalid="ignore"):
            exits = np.where(
                w > 0, (p + support.region.limit) / w, np.where(w < 0, (p - support.region.limit) / w, np.inf)
            )
        back = np.minimum(exits.min(axis=1), 1)[:, None]
        self.all_points = tensor(np.concatenate([np.concatenate([p - t * w, w], axis=1) for t in (0 * back, back)]))
        self.points = self.all_points

    def refresh(self, normals: torch.Tensor) -> None:
        """Until the next call, faces are set by the positives that are farthest now."""
        count = min(FARTHEST, len(self.all_points))
        near = [(self.all_points @ normal).topk(count).indices for normal in normals.detach()]
        self.points = self.all_points[torch.cat(near).unique()]


class PlaneParameters(Parameters):
    """Planes: for each of many u the highest a is known, a linear program of n + 1 candidates."""

    def __init__(self, domain: RegionDomain, support: ParametricSupport):
        super().__init__(domain, support)
        n = support.ndim
        u = DirectionPatches.cover(n, DIRECTIONS.get(n, 3)).centers
        local = u / support.region.scale
        self.u, self.local, self.limit = tensor(u), tensor(local), tensor(support.region.limit)
        self.high, self.low = tensor(support.object_support(local)), tensor(support.object_support(-local))
        self.safe = torch.where(self.local.abs() < 1e-4, torch.full_like(self.local, 1e4), self.local)

    def start(self, count: int, generator: torch.Generator) -> torch.Tensor:
        """Planes that cut off a corner of the domain, from the one side and from the other."""
        n = self.support.ndim
        corners = torch.tensor(list(product((1.0, -1.0), repeat=n)))
        index = torch.arange(count)
        side = 1.0 - 2.0 * (index // len(corners) % 2)
        tilt = torch.tensor(TILTS)[index // (2 * len(corners)) % len(TILTS)]
        corner = corners[index % len(corners)]
        return torch.cat([corner * (side * tilt)[:, None], corner], dim=1) + 0.05 * torch.randn(
            count, 2 * n, generator=generator
        )

    def offsets(self, normals: torch.Tensor) -> torch.Tensor:
        x, y = normals.chunk(2, dim=1)
        kinks = y[:, None] / self.safe  # (k, J, n)
        kinks = torch.cat([kinks, torch.zeros_like(kinks[:, :, :1])], dim=2)
        rest = (y[:, None, None] - kinks[..., None] * self.local[:, None]).abs() @ self.limit
        hull = torch.maximum(kinks * self.high[:, None], -kinks * self.low[:, None])
        return ((rest + hull).amin(dim=2) + x @ self.u.T).amax(dim=1)


def learned_normals(
    grid: IndicatorGrid,
    domain: RegionDomain,
    support: ParametricSupport,
    *,
    seed: int,
    seconds: float,
    steps: int | None,
) -> np.ndarray:
    """``(k, 2 n)`` normals, of ``kdop``'s own and of what was learned those with the fewest negatives inside their certain faces."""
    kinds = {"ray": RayParameters, "plane": PlaneParameters, "box": BoxParameters}
    problem, v = kinds[domain.query](domain, support), _negatives(grid, domain, seed)
    directions, clock = kdop_directions(problem.columns) / v_per_unit(domain), Clock(seconds, steps, None)
    classic, generator = np.concatenate([directions, -directions]), torch.Generator().manual_seed(seed)
    start, found = of_length_1(tensor(classic)), []

    def learn() -> None:
        for index in range(STARTS):
            normals = start + JITTER * torch.randn(start.shape, generator=generator)
            if index % 2 == 1:
                normals = problem.start(len(start), generator)
            found.append((np.inf, start))
            descend(problem, v, of_length_1(normals), clock, ((index + 1) / STARTS, index / STARTS), generator, found)
            if clock.fraction() >= 1:
                break

    with single_threaded_torch():
        interrupts(learn)
    found.sort(key=lambda pair: pair[0])
    tried = [classic, *(normals.double().numpy() for _, normals in found[:FINALISTS])]
    return min(
        tried, key=lambda normals: float((v.double().numpy() @ normals.T <= support(normals)).all(axis=1).mean())
    )


def _negatives(grid: IndicatorGrid, domain: RegionDomain, seed: int) -> torch.Tensor:
    """V of sampled negatives, of other queries where there are none."""
    rng, truth = np.random.default_rng(seed), oracle(domain.query, grid, "cpu", domain.oracle_length)
    found, count, total = [], 0, 0
    while count < FEW * SAMPLES and total < MOST_SAMPLES:
        x = sample(domain.query, grid, SAMPLES, rng)
        found.append(x[~truth(x)])
        count, total = count + len(found[-1]), total + SAMPLES
    return tensor(to_local(domain, np.concatenate(found) if count else x[:64]))
