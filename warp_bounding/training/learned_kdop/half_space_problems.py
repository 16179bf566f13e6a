"""What learning half-spaces needs of a kind of query: the faces of given normals and f of negatives, differentiable.

Normals have length 1 in the coordinates of what is bounded. Faces are supports in float32 without any room for
rounding: they steer the search only, ``LearnedKdop.of_normals`` sets the real ones.
"""

from itertools import combinations

import numpy as np
import torch

from warp_bounding.coordinates.domain import Domain
from warp_bounding.coordinates.object_support import ObjectSupport
from warp_bounding.coordinates.region_domain import RegionDomain

__all__ = ["HalfSpaceProblem", "problem_of"]

HALVINGS = 12  # of the interval in which f is highest along a ray


class HalfSpaceProblem:
    """Half-spaces around points.

    Args:
        domain: Of the kind of query.
        support: Certified, of what is bounded.
    """

    def __init__(self, domain: Domain | RegionDomain, support: ObjectSupport):
        self.domain, self.support = domain, support
        self.points = tensor(support.points)
        self.columns = domain.space_ndim

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


def problem_of(domain: Domain | RegionDomain, support: ObjectSupport) -> HalfSpaceProblem:
    """The problem of a kind of query."""
    kinds = {"ray": RayInObject, "plane": PlaneInObject, "box": BoxInObject}
    return kinds.get(domain.query, HalfSpaceProblem)(domain, support)
