"""What learning half-spaces needs of a kind of query: the faces of given normals and f of negatives, differentiable.

Normals have length 1 in the coordinates of what is bounded. Faces are supports in float32 without any room for
rounding: they steer the search only, ``LearnedKdop.of_normals`` sets the real ones.
"""

from itertools import combinations, product

import numpy as np
import torch

from warp_bounding.coordinates.domain import Domain
from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.geometry.direction_patches import DirectionPatches
from warp_bounding.support_functions.parametric import ObjectSupport, ParametricSupport

__all__ = ["HalfSpaceProblem", "problem_of"]

HALVINGS = 12  # of the interval in which f is highest along a ray
DIRECTIONS = {2: 64, 3: 12, 4: 4}  # by dimension: directions along an edge of a cube's face, of those that set faces
ENDS = 150  # points of the object that set faces: rays begin or end there
FARTHEST = 64  # positive rays that each normal is set by, between two refreshes
TILTS = (1.0, 0.6, 1.6)  # weights of u relative to those of a in the first half-spaces around planes


class HalfSpaceProblem:
    """Half-spaces around points, or around regions in parametric space where faces are the only difference.

    Args:
        domain: Of the kind of query.
        support: Certified, of what is bounded.
    """

    def __init__(self, domain: Domain | RegionDomain, support: ObjectSupport | ParametricSupport):
        self.domain, self.support = domain, support
        self.points = tensor(support.points)
        self.columns = domain.ndim if domain.parametric else domain.space_ndim

    def offsets(self, normals: torch.Tensor) -> torch.Tensor:
        """``(k,)`` faces of normals ``(k, m)``."""
        return (normals @ self.points.T).amax(dim=1)

    def refresh(self, normals: torch.Tensor) -> None:
        """Called now and then with the normals as they are, before faces are asked for."""

    def start(self, count: int, generator: torch.Generator) -> torch.Tensor:
        """``(k, m)`` normals to begin with that are not ``kdop``'s."""
        return torch.randn(count, self.columns, generator=generator)

    def values(self, normals: torch.Tensor, offsets: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        """``(N,)``, f of ``v`` ``(N, ndim)``."""
        return (offsets - v @ normals.T).amin(dim=1)


class BoxParameters(HalfSpaceProblem):
    """Boxes in parametric space; see ``ParametricSupport``."""

    def offsets(self, normals: torch.Tensor) -> torch.Tensor:
        x, y = normals.chunk(2, dim=1)
        limit = tensor(self.support.region.limit)
        free = (-x).clamp(min=0) + y.clamp(min=0)
        return super().offsets(x.clamp(min=0) - (-y).clamp(min=0)) + free @ limit


class RayParameters(HalfSpaceProblem):
    """Rays in parametric space: faces are set by many extreme positives, which begin at the object or end there."""

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


class PlaneParameters(HalfSpaceProblem):
    """Planes in parametric space: for each of many u the highest a is known, a linear program of n + 1 candidates."""

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


class BoxInObject(HalfSpaceProblem):
    """Boxes against a polytope in object space."""

    def values(self, normals: torch.Tensor, offsets: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        low, high = v.chunk(2, dim=1)
        return (offsets - low @ normals.clamp(min=0).T - high @ normals.clamp(max=0).T).amin(dim=1)


class RayInObject(HalfSpaceProblem):
    """Rays against a polytope in object space: f is concave along a ray, and its highest point is found by halving."""

    def values(self, normals: torch.Tensor, offsets: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        start, slope = v.chunk(2, dim=1)
        height, fall = offsets - start @ normals.T, slope @ normals.T
        with torch.no_grad():
            low, high = torch.zeros(len(v)), torch.ones(len(v))
            for _ in range(HALVINGS):
                middle = (low + high) / 2
                active = (height - middle[:, None] * fall).argmin(dim=1, keepdim=True)
                rising = fall.gather(1, active)[:, 0] < 0
                low, high = torch.where(rising, middle, low), torch.where(rising, high, middle)
            best = (low + high) / 2
        return (height - best[:, None] * fall).amin(dim=1)


class PlaneInObject(HalfSpaceProblem):
    """Planes against a polytope in object space, by its vertices: where n faces meet and no other one cuts off."""

    def values(self, normals: torch.Tensor, offsets: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        n = normals.shape[1]
        chosen = torch.tensor(list(combinations(range(len(normals)), n)))
        with torch.no_grad():
            matrix, right = normals[chosen].double(), offsets[chosen].double()
            safe = torch.linalg.det(matrix).abs() > 1e-6
            chosen = chosen[safe]
            y = torch.linalg.solve(matrix[safe], right[safe])
            met = ((y @ normals.T.double() - offsets) <= 1e-5).all(dim=1)
            chosen = chosen[met]
        if not len(chosen):
            return (offsets.sum() * 0).expand(len(v))
        vertices = torch.linalg.solve(normals[chosen], offsets[chosen])
        at = v[:, :n] @ vertices.T
        return torch.minimum(at.amax(dim=1) - v[:, n], v[:, n] - at.amin(dim=1))


def tensor(values: np.ndarray) -> torch.Tensor:
    """As float32."""
    return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32))


def problem_of(domain: Domain | RegionDomain, support: ObjectSupport | ParametricSupport) -> HalfSpaceProblem:
    """The problem of a kind of query in its space."""
    inside = {"ray": RayInObject, "plane": PlaneInObject, "box": BoxInObject}
    parameters = {"ray": RayParameters, "plane": PlaneParameters, "box": BoxParameters}
    kinds = parameters if domain.parametric else inside
    return kinds.get(domain.query, HalfSpaceProblem)(domain, support)
