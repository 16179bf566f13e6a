"""Samples of points of a shape without cells: a positive is a point of the object, and stays one by being asked.

Labels are drawn once, and so are points of the border, by bisection; every refresh of the training takes others of them.
A positive that walks out of the object is taken back along its way to the last point that is known to be in it.
"""

import numpy as np
import torch

from warp_bounding.coordinates.domain import Domain
from warp_bounding.indicators.shape import Shape
from warp_bounding.queries.boundary import border_points, held_points, pulled, random_points
from warp_bounding.training.samples.base import Samples, columns

__all__ = ["ShapePointSamples"]

LABELLED = 1 << 20  # random points of the domain that are labelled
BORDER = 1 << 16  # points of the border
LEAST = 4096  # points of the object, at least
BORDER_SHARE = 2 / 3  # of positives: on the border; the others anywhere in the object
FEW = 1024  # points of the border that stand for landmarks where a shape has none
STEP = 2 / 64  # local units: what ``move`` calls a cell
NEAREST = 2.0**-9  # local units: how near to the border a point is brought back that has walked out


class ShapePointSamples(Samples):
    """Random points of a shape; see ``Samples``. A state is the point itself, in local coordinates (n rows).

    Args:
        shape: The object.
        domain: Its domain, which gives the map to ``v``.
        generator: Source of randomness.
    """

    query = "point"

    def __init__(self, shape: Shape, domain: Domain, generator: torch.Generator):
        self.shape, self.domain, self.generator, self.ndim = shape, domain, generator, shape.ndim
        rng = np.random.default_rng(int(torch.randint(2**62, (1,), generator=generator)))
        points, truth = random_points(shape, LABELLED, rng)
        held = held_points(shape, LEAST, rng, points[truth])
        border = border_points(shape, BORDER, rng, held, NEAREST / 4)
        self._labelled, self._truth = columns(domain.to_local(points)), torch.from_numpy(truth)
        self._held, self._free = columns(domain.to_local(held)), self._labelled[:, ~self._truth]
        if not self._free.shape[1]:  # the object fills its box: other points stand for negatives, which the loss needs
            self._free = columns(domain.to_local(shape.sample_lower)[None])
        self._border = columns(domain.to_local(border))
        size = torch.from_numpy((shape.upper - shape.lower).astype(np.float32))[:, None]
        if shape.time:
            size[0] = size[1:].max()
        self.detail = size / size.max()
        landmarks = columns(domain.to_local(shape.landmarks()))
        self.vertices = torch.cat([landmarks, self._border[:, :FEW]], 1)

    def _pick(self, points: torch.Tensor, count: int) -> torch.Tensor:
        return points.index_select(1, torch.randint(points.shape[1], (count,), generator=self.generator))

    def uniform(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        chosen = torch.randint(len(self._truth), (count,), generator=self.generator)
        return self._labelled.index_select(1, chosen), self._truth[chosen]

    def negatives(self, count: int) -> torch.Tensor:
        return self._pick(self._free, max(round(count * self._free.shape[1] / len(self._truth)), 1))

    def positives(self, count: int) -> torch.Tensor:
        near = int(count * BORDER_SHARE)
        return torch.cat([self._pick(self._border, near), self._pick(self._held, count - near)], 1)

    def coordinates(self, state: torch.Tensor) -> torch.Tensor:
        return state

    def move(self, state: torch.Tensor, slope: torch.Tensor, step: float | torch.Tensor) -> torch.Tensor:
        # one of many moves: ``settled`` takes back those that have left the object
        slope /= slope.abs().amax(0, keepdim=True) + 1e-12
        return state - step * STEP * slope

    def settled(self, before: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
        local, domain = after.T.double().numpy(), self.domain
        moved = domain.to_object(local)
        left = np.flatnonzero(~self.shape.contains(moved))
        start = domain.to_object(before.T.double().numpy()[left])
        nearest = NEAREST / float(domain.scale[int(self.shape.time) :].min())
        moved[left] = pulled(self.shape, start, moved[left], nearest)[0]
        return columns(domain.to_local(moved))

    def locate(self, v: np.ndarray) -> torch.Tensor:
        x = self.domain.to_object(v)
        return columns(v[self.shape.contains(x)])
