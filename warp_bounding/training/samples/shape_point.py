"""Samples of points of a shape without cells: a positive is a point of the object, and stays one by being asked.

Labelled points, and points of the border, which bisection finds, are kept: their number grows with every refresh of the
training up to a limit, so that training begins at once, and each refresh takes others of them.
A positive that walks out of the object is taken back along its way to the last point that is known to be in it.
"""

import numpy as np
import torch

from warp_bounding.coordinates.domain import Domain
from warp_bounding.indicators.shape import Shape
from warp_bounding.queries.boundary import border_points, held_points, pulled, random_points
from warp_bounding.training.samples.base import Samples, columns
from warp_bounding.training.samples.shape_points import NEAREST

__all__ = ["ShapePointSamples"]

LABELLED = 1 << 20  # random points of the domain that are labelled in the end
BORDER = 1 << 17  # points of the border in the end
PARTS = 16  # in which these are drawn, one for each of the first refreshes
LEAST = 4096  # points of the object, at least
BORDER_SHARE = 2 / 3  # of positives: on the border; the others anywhere in the object
FEW = 1024  # points of the border that stand for landmarks where a shape has none
STEP = 2 / 64  # local units: what ``move`` calls a cell


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
        self._rng = np.random.default_rng(int(torch.randint(2**62, (1,), generator=generator)))
        self._limit = torch.from_numpy(np.array(domain.limit))[:, None]
        self._truth, nothing = torch.empty(0, dtype=torch.bool), torch.empty(self.ndim, 0)
        self._labelled = self._held = self._free = self._border = nothing
        self.grow()
        size = torch.from_numpy((shape.upper - shape.lower).astype(np.float32))[:, None]
        if shape.time:
            size[0] = size[1:].max()
        self.detail = size / size.max()
        self.waves = _first_layer(shape, domain)
        landmarks = columns(domain.to_local(shape.landmarks()))
        self.vertices = torch.cat([landmarks, self._border[:, :FEW]], 1)

    def grow(self) -> None:
        """Once a refresh: label more random points and find more of the border, until there are as many as training can use."""
        if len(self._truth) >= LABELLED:
            return
        shape, local = self.shape, self.domain.to_local
        points, truth = random_points(shape, LABELLED // PARTS, self._rng)
        held = held_points(shape, LEAST, self._rng, points[truth])
        border = border_points(shape, BORDER // PARTS, self._rng, held, NEAREST / 4)
        self._labelled = torch.cat([self._labelled, columns(local(points))], 1)
        self._truth = torch.cat([self._truth, torch.from_numpy(truth)])
        self._held = torch.cat([self._held, columns(local(held))], 1)
        self._border = torch.cat([self._border, columns(local(border))], 1)
        self._free = self._labelled[:, ~self._truth]
        if not self._free.shape[
            1
        ]:  # the object fills its box: another point stands for negatives, which the loss needs
            self._free = columns(local(shape.sample_lower)[None])

    def _pick(self, points: torch.Tensor, count: int) -> torch.Tensor:
        return points.index_select(1, torch.randint(points.shape[1], (count,), generator=self.generator))

    def uniform(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        chosen = torch.randint(len(self._truth), (count,), generator=self.generator)
        return self._labelled.index_select(1, chosen), self._truth[chosen]

    def usual_negatives(self, count: int) -> torch.Tensor:
        self.grow()
        return self._pick(self._free, max(round(count * self._free.shape[1] / len(self._truth)), 1))

    def positives(self, count: int) -> torch.Tensor:
        near = int(count * BORDER_SHARE)
        return torch.cat([self._pick(self._border, near), self._pick(self._held, count - near)], 1)

    def coordinates(self, state: torch.Tensor) -> torch.Tensor:
        return state

    def move(self, state: torch.Tensor, slope: torch.Tensor, step: float | torch.Tensor) -> torch.Tensor:
        # one of many moves: ``settled`` takes back those that have left the object
        slope /= slope.abs().amax(0, keepdim=True) + 1e-12
        moved = state - step * STEP * slope
        # a complement has no end, but nobody is asked about it outside the domain
        return torch.maximum(torch.minimum(moved, self._limit), -self._limit) if self.shape.unbounded else moved

    def settled(self, before: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
        local, domain = after.T.double().numpy(), self.domain
        moved = domain.to_object(local)
        if not self.shape.unbounded:  # where the object is cut off, it is walked along the end
            moved = moved.clip(self.shape.lower, self.shape.upper)
        left = np.flatnonzero(~self.shape.contains(moved))
        start = domain.to_object(before.T.double().numpy()[left])
        nearest = NEAREST / float(domain.scale[int(self.shape.time) :].min())
        moved[left] = pulled(self.shape.contains, start, moved[left], nearest)[0]
        return columns(domain.to_local(moved))

    def locate(self, v: np.ndarray) -> torch.Tensor:
        x = self.domain.to_object(v)
        return columns(v[self.shape.contains(x)])


def _first_layer(shape: Shape, domain: Domain) -> torch.Tensor | None:
    """Sines and cosines of a shape's waves as a layer of sines of v."""
    if shape.waves is None:
        return None
    weight, phase = shape.waves / domain.scale.astype(np.float64), shape.waves @ domain.center.astype(np.float64)
    rows = np.column_stack([weight, phase])
    shifted = rows + np.append(np.zeros(weight.shape[1]), np.pi / 2)
    return torch.from_numpy(np.concatenate([rows, shifted]).astype(np.float32))
