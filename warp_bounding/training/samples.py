"""Labelled points for training: ``Problem``, random points with their truth, and positives that can be moved.

A positive is a column of *state* numbers, such as a cell and an offset in [-1/2, 1/2]^n inside it, from which its
coordinates ``v`` follow by a formula. Every state in the allowed range is a positive, so a positive can walk down a
network's output without ever leaving the object. Labels are those of the exact oracles; no sample is ever taken for a
proof. ``Samples`` is the contract, with a class for grids and one for other shapes (``samples_of``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.errors import QueryError
from warp_bounding.queries import QUERIES, oracle, sample
from warp_bounding.queries.boundary import border_points, held_points, pulled, random_points
from warp_bounding.queries.domain import Domain
from warp_bounding.queries.region_domain import RegionDomain
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.recentred import Frame
from warp_bounding.shapes.shape import Shape
from warp_bounding.training.engine import torch

# Queries of the caller's own: false positives are weighed where these lie, and a proof does not care.

# Of the samples that stand for what is asked. The others are the protocol's, for what the caller's few queries do not
# tell of their like.
CALLERS_SHARE = 0.8
MOST = 1 << 20  # queries that are kept, a random choice of more


class CallersQueries:
    """Some queries ``(Q, m)``, object space, float32 in ``x``, labelled by the exact truth.

    Of too many a random choice is kept; the ``frame``'s origin is taken off them. Raises ``QueryError`` for another
    shape, none at all, or numbers that mean nothing.
    """

    def __init__(self, x, shape: Shape, domain: Domain | RegionDomain, seed: int = 0, frame: Frame | None = None):
        shift = 0.0 if frame is None else frame.shift(QUERIES[domain.query].directed)
        self.x = _checked(x, domain, shift)
        if domain.joints is not None:  # where nothing is known every bounder says maybe
            self.x = domain.joints.turned_back(self.x[domain.joints.within(self.x)]).astype(np.float32)
            if not len(self.x):
                raise QueryError("queries must lie within the limits of joints, got none that does")
        if len(self.x) > MOST:
            self.x = self.x[np.random.default_rng(seed).choice(len(self.x), MOST, replace=False)]
        truth = np.asarray(oracle(domain.query, shape, "cpu", domain.oracle_length)(self.x), dtype=bool)
        self.positives = float(truth.mean())
        v = domain.to_local(self.x[~truth])
        # what lies outside the domain is denied whatever a network says
        self._free = np.ascontiguousarray(v[(np.abs(v) <= domain.limit).all(axis=1)].T, dtype=np.float32)

    def negatives(self, count: int, generator: torch.Generator) -> torch.Tensor:
        """``v`` of the negatives of ``count`` random queries that can be anything else for a network."""
        free = torch.from_numpy(self._free)
        if not free.shape[1]:
            return free
        chosen = torch.randint(free.shape[1], (round(count * free.shape[1] / len(self.x)),), generator=generator)
        return free.index_select(1, chosen)

    def draw(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """``(count, m)`` random ones of them."""
        return self.x[rng.integers(len(self.x), size=count)]


def _checked(x, domain: Domain | RegionDomain, shift: np.ndarray | float) -> np.ndarray:
    try:
        x = np.asarray(x.numpy() if hasattr(x, "numpy") else x)
        x = (x.astype(np.float64) - shift if np.any(shift) and x.ndim == 2 else x).astype(np.float32)
    except (TypeError, ValueError) as error:
        raise QueryError(f"queries must be numbers ({error})") from None
    columns_ = domain.columns
    if x.ndim != 2 or x.shape[1] != columns_ or not len(x):
        raise QueryError(f"queries must be (Q, {columns_}) {domain.query} queries, at least one of them, got {x.shape}")
    bad = int((~QUERIES[domain.query].valid(x)).sum())
    if bad:
        raise QueryError(
            f"queries must all mean something, got {bad:,} of {len(x):,} with NaN, infinity or no direction"
        )
    return np.ascontiguousarray(x)


class Samples:
    """Random points, as columns; made of the object, a domain and a source of randomness.

    ``detail`` ``(ndim, 1)`` are the object's cells along each axis of ``v``, relative to the axis with most; ``waves``
    ``(2 K, ndim + 1)`` a first layer whose sines are those of the object (``Shape.waves``); ``vertices`` ``(ndim, K)``
    all positives where a minimum of f is likely, such as corners; ``callers`` queries of the caller's own, which take
    the place of some of the negatives. ``reaching`` says of queries ``(N, ndim)`` which ones the bounders in front
    leave: no others are negatives.
    """

    ndim: int
    generator: torch.Generator
    detail: torch.Tensor
    waves: torch.Tensor | None = None
    vertices: torch.Tensor
    callers: CallersQueries | None = None
    reaching: Callable[[np.ndarray], np.ndarray] | None = None
    domain: Domain

    def those_reaching(self, v: torch.Tensor) -> torch.Tensor:
        """Those of ``v`` ``(ndim, N)`` that the bounders in front leave."""
        if self.reaching is None:
            return v
        x = self.domain.to_object(v.T.double().numpy())
        return v[:, torch.from_numpy(self.reaching(x.astype(np.float32)))]

    def uniform(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """``v`` ``(ndim, count)`` of samples of the protocol, and their truth ``(count,)``."""
        raise NotImplementedError

    def negatives(self, count: int) -> torch.Tensor:
        """``v`` of the negatives among ``count`` samples, of the protocol and of the caller's own.

        Of a few other queries where none is.
        """
        if self.callers is None:
            return self.usual_negatives(count)
        own = round(CALLERS_SHARE * count)
        callers = self.those_reaching(self.callers.negatives(own, self.generator))
        return torch.cat([callers, self.usual_negatives(count - own)], 1)

    def usual_negatives(self, count: int) -> torch.Tensor:
        """``negatives`` of the protocol."""
        raise NotImplementedError

    def positives(self, count: int) -> torch.Tensor:
        """States ``(S, count)``, most where a network is likely to fail."""
        raise NotImplementedError

    def coordinates(self, state: torch.Tensor) -> torch.Tensor:
        """``v`` ``(ndim, N)`` of states."""
        raise NotImplementedError

    def move(self, state: torch.Tensor, slope: torch.Tensor, step: float | torch.Tensor) -> torch.Tensor:
        """States ``(S, N)`` after one step down ``slope`` ``(ndim, N)``, which may be overwritten.

        They stay positives, or ``resolved`` makes them positives again; ``step`` is in cells, about, one or ``(N,)``.
        """
        raise NotImplementedError

    def resolved(self, before: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
        """States after several moves, as positives: those that left the object are taken back towards ``before``."""
        return after

    def locate(self, v: np.ndarray) -> torch.Tensor:
        """States of positives ``(N, ndim)`` float64 found elsewhere, but those that rounding moved off the object."""
        raise NotImplementedError


# Samples of points of a grid: a positive is a cell and an offset inside it.
#
# What is hard for a network lies on the boundary: most points are in cells that touch an empty one, and most of their
# coordinates on a face of the cell.

BOUNDARY_SHARE = 2 / 3  # of the points: in cells that touch an empty one
FACE_SHARE = 0.6  # of the coordinates of these points: on a face of the cell
FEWEST_NEGATIVES = 64  # samples that stand for negatives where uniform samples gave none


class PointSamples(Samples):
    """Random points of a grid; see ``Samples``. A state is a cell (n rows) and an offset from its middle (n rows)."""

    def __init__(self, grid: Grid, domain: Domain, generator: torch.Generator, reaching: Callable | None):
        self.grid, self.domain, self.generator, self.reaching = grid, domain, generator, reaching
        self.ndim = grid.ndim
        origin, one = (domain.to_local(grid.position(at(grid.ndim))) for at in (np.zeros, np.ones))
        self._origin, self._unit = (columns(a[None]) for a in (origin, one - origin))  # of cells, in local space
        shape = np.array(grid.shape)
        self._shape = torch.from_numpy(shape)[:, None]
        self.detail = self._shape.float() / float(shape.max())
        self._occupied, self._boundary = columns(grid.occupied), columns(grid.boundary)
        self.vertices = self._to_local(columns(_boundary_vertices(grid.occupancy)) - 0.5)
        self._first = columns(np.where(shape > 1, 0.0, -0.5)[None])
        self._extent = columns(np.where(shape > 1, shape - 1.0, 1.0)[None])
        self._table = torch.from_numpy(grid.occupancy.reshape(-1).copy())
        self._stride = torch.tensor([int(np.prod(shape[k + 1 :])) for k in range(grid.ndim)])[:, None]

    def _to_local(self, t: torch.Tensor) -> torch.Tensor:
        """Local coordinates of cell coordinates, both ``(n, N)``."""
        return t * self._unit + self._origin

    def _pick(self, cells: torch.Tensor, count: int) -> torch.Tensor:
        """``(n, count)`` random ones of the cells ``(n, C)``."""
        if not count:
            return cells[:, :0]
        return cells.index_select(1, torch.randint(cells.shape[1], (count,), generator=self.generator))

    def _rand(self, count: int) -> torch.Tensor:
        """``(n, count)`` uniform numbers in [0, 1)."""
        return torch.rand(self.ndim, count, generator=self.generator)

    def uniform(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        t = self._rand(count) * self._extent + self._first
        cell = torch.minimum(torch.round(t).long().clamp_(min=0), self._shape - 1)
        return self._to_local(t), self._table[(cell * self._stride).sum(0)]

    def usual_negatives(self, count: int) -> torch.Tensor:
        v, truth = self.uniform(count)
        free = self.those_reaching(v[:, ~truth])
        if free.shape[1]:
            return free
        cells = self._pick(columns(np.argwhere(~self.grid.occupancy)), FEWEST_NEGATIVES)
        return self._to_local(cells + self._rand(cells.shape[1]) - 0.5)

    def positives(self, count: int) -> torch.Tensor:
        near = int(count * BOUNDARY_SHARE) if self._boundary.shape[1] else 0
        offset = self._rand(count) - 0.5
        snap = self._rand(near) < FACE_SHARE
        offset[:, :near] = torch.where(snap, torch.sign(offset[:, :near]) * 0.5, offset[:, :near])
        cells = torch.cat([self._pick(self._boundary, near), self._pick(self._occupied, count - near)], 1)
        return torch.cat([cells, offset])

    def coordinates(self, state: torch.Tensor) -> torch.Tensor:
        return self._to_local(state[: self.ndim] + state[self.ndim :])

    def move(self, state: torch.Tensor, slope: torch.Tensor, step: float | torch.Tensor) -> torch.Tensor:
        # all points stay in their cells
        slope = slope * self._unit
        slope /= slope.abs().amax(0, keepdim=True) + 1e-12
        cell, offset = state.chunk(2)
        return torch.cat([cell, (offset - step * slope).clamp_(-0.5, 0.5)])

    def locate(self, v: np.ndarray) -> torch.Tensor:
        t = (v - self._origin.numpy().T.astype(np.float64)) / self._unit.numpy().T
        cell = np.rint(t).astype(np.int64)
        inside = ((cell >= 0) & (cell < self.grid.shape)).all(axis=1)
        inside[inside] = self.grid.occupancy[tuple(cell[inside].T)]
        cell, t = cell[inside], t[inside]
        return torch.cat([columns(cell), columns(np.clip(t - cell, -0.5, 0.5))])


def _boundary_vertices(occupancy: np.ndarray) -> np.ndarray:
    """``(P, n)`` indices of cell corners between occupied and empty cells; corner i is at ``t = i - 1/2``."""
    padded = np.pad(occupancy, 1)
    some, every = np.zeros([r + 1 for r in occupancy.shape], bool), np.ones([r + 1 for r in occupancy.shape], bool)
    for shift in product((0, 1), repeat=occupancy.ndim):
        part = padded[tuple(slice(s, s + r + 1) for s, r in zip(shift, occupancy.shape, strict=True))]
        some |= part
        every &= part
    return np.argwhere(some & ~every)


def columns(rows: np.ndarray) -> torch.Tensor:
    """``(N, n)`` numbers as ``(n, N)`` float32."""
    return torch.from_numpy(np.ascontiguousarray(rows.T, dtype=np.float32))


# Samples of points of a shape without cells: a positive is a point of the object, and stays one by being asked.
#
# Labelled points, and points of the border, which bisection finds, are kept: their number grows with every refresh of
# the training up to a limit, so that training begins at once, and each refresh takes others of them. A positive that
# walks out of the object is taken back along its way to the last point that is known to be in it.

POINTS = 1 << 20  # random points of the domain that are labelled in the end
BORDER = 1 << 17  # points of the border in the end
PARTS = 16  # in which points are found, one for each of the first refreshes
NEAREST = 2.0**-9  # local units: how near to the border a point is brought back that has walked out
BORDER_SHARE = 2 / 3  # of the points: on the border
FEWEST_HELD = 4096  # points of the object, at least
FEW = 1024  # points of the border that stand for landmarks where a shape has none
STEP = 2 / 64  # local units: what ``move`` calls a cell
# Of joints: the share of the positives that lie at some joints' limits, and of their coordinates that do. Random points
# seldom come near several limits at once, where f is often least.
LIMITS_SHARE, AT_LIMITS = 1 / 8, 0.4


class ShapePointSamples(Samples):
    """Random points of a shape; see ``Samples``. A state is the point itself, in local coordinates (n rows)."""

    def __init__(self, shape: Shape, domain: Domain, generator: torch.Generator, reaching: Callable | None):
        self.shape, self.domain, self.generator, self.reaching = shape, domain, generator, reaching
        self.ndim = shape.ndim
        self._rng = np.random.default_rng(int(torch.randint(2**62, (1,), generator=generator)))
        self._limit = torch.from_numpy(np.array(domain.limit))[:, None]
        self._truth, nothing = torch.empty(0, dtype=torch.bool), torch.empty(self.ndim, 0)
        self._labelled = self._held = self._free = self._border = self._at_limits = nothing
        self.grow()
        size = torch.from_numpy((shape.upper - shape.lower).astype(np.float32))[:, None]
        if shape.time:
            size[0] = size[1:].max()
        self.detail = size / size.max()
        self.waves = _first_layer(shape, domain)
        landmarks = columns(domain.to_local(shape.landmarks()))
        self.vertices = torch.cat([landmarks, self._border[:, :FEW]], 1)

    def grow(self) -> None:
        """Once a refresh: label more random points and find more of the border, up to what training can use."""
        if len(self._truth) >= POINTS:
            return
        shape, local = self.shape, self.domain.to_local
        points, truth = random_points(shape, POINTS // PARTS, self._rng)
        held = held_points(shape, FEWEST_HELD, self._rng, points[truth])
        border = border_points(shape, BORDER // PARTS, self._rng, held, NEAREST / 4)
        self._labelled = torch.cat([self._labelled, columns(local(points))], 1)
        self._truth = torch.cat([self._truth, torch.from_numpy(truth)])
        self._held = torch.cat([self._held, columns(local(held))], 1)
        self._border = torch.cat([self._border, columns(local(border))], 1)
        if shape.joints is not None:
            self._at_limits = torch.cat([self._at_limits, columns(local(self._held_at_limits(len(points))))], 1)
        self._free = torch.cat([self._free, self.those_reaching(columns(local(points[~truth])))], 1)

    def _held_at_limits(self, count: int) -> np.ndarray:
        """``(K, n)``: those of some random points with coordinates at the ends of the shape that lie in it."""
        shape, size = self.shape, (count, self.ndim)
        end = np.where(self._rng.random(size) < 0.5, shape.lower, shape.upper)
        x = self._rng.uniform(shape.lower, shape.upper, size)
        x = np.where(self._rng.random(size) < AT_LIMITS, end, x)
        return x[shape.contains(x)]

    def _pick(self, points: torch.Tensor, count: int) -> torch.Tensor:
        return points.index_select(1, torch.randint(points.shape[1], (count,), generator=self.generator))

    def uniform(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        chosen = torch.randint(len(self._truth), (count,), generator=self.generator)
        return self._labelled.index_select(1, chosen), self._truth[chosen]

    def usual_negatives(self, count: int) -> torch.Tensor:
        self.grow()
        if not self._free.shape[
            1
        ]:  # the object fills its box: another point stands for negatives, which the loss needs
            return columns(self.domain.to_local(self.shape.sample_lower)[None])
        return self._pick(self._free, max(round(count * self._free.shape[1] / len(self._truth)), 1))

    def positives(self, count: int) -> torch.Tensor:
        at_limits = int(count * LIMITS_SHARE) if self._at_limits.shape[1] else 0
        near = int((count - at_limits) * BORDER_SHARE)
        parts = [self._pick(self._border, near), self._pick(self._held, count - at_limits - near)]
        return torch.cat([*parts, self._pick(self._at_limits, at_limits)] if at_limits else parts, 1)

    def coordinates(self, state: torch.Tensor) -> torch.Tensor:
        return state

    def move(self, state: torch.Tensor, slope: torch.Tensor, step: float | torch.Tensor) -> torch.Tensor:
        # one of many moves: ``resolved`` takes back those that have left the object
        slope /= slope.abs().amax(0, keepdim=True) + 1e-12
        moved = state - step * STEP * slope
        # a complement has no end, but nobody is asked about it outside the domain
        return torch.maximum(torch.minimum(moved, self._limit), -self._limit) if self.shape.unbounded else moved

    def resolved(self, before: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
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


def samples_of(shape: Shape, domain: Domain, seed: int = 0, reaching: Callable | None = None) -> Samples:
    """The samples of a domain of points; the seed is also that of its trainer."""
    kind = PointSamples if isinstance(shape, Grid) else ShapePointSamples
    return kind(shape, domain, torch.Generator().manual_seed(seed), reaching)


# What is given to every way of training: the object, its queries, and what the result may depend on.

Trained = tuple[Bounder, dict[str, Any]]  # the bounder, and a record of the training for ``info["training"]``


@dataclass(frozen=True)
class Problem:
    """What is to be bounded, for which queries, where.

    Attributes:
        front: Bounders that are queried first. Only queries that they let through are asked further, so only those can
            be false positives.
    """

    grid: Shape  # the object
    domain: Domain | RegionDomain  # of the queries
    query: str  # kind of query
    seed: int  # of everything random
    device: str | None  # Warp device of the bounder
    front: tuple[Bounder, ...] = ()
    in_front: bool = False  # whether the bounder stands before a network in a cascade
    callers: CallersQueries | None = None  # queries of the caller's own: where false positives count
    scheduler: str | int | None = None  # whose workers prove
    repeatable: bool = False  # whether the result is to be the same on every run, so that no clock may enter

    def sample(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """``(count, m)`` float32, random queries like those to come: the protocol's, or mostly the caller's own."""
        if self.callers is None:
            return sample(self.query, self.grid, count, rng)
        own = round(CALLERS_SHARE * count)
        usual = sample(self.query, self.grid, count - own, rng)
        return np.concatenate([self.callers.draw(own, rng), np.asarray(usual, dtype=np.float32)])

    def reaching(self, x: np.ndarray) -> np.ndarray:
        """``(N,)`` bool: which queries, in object space, all bounders of ``front`` answer with *maybe*."""
        left = np.ones(len(x), dtype=bool)
        for bounder in self.front:
            left[left] = bounder.query(np.asarray(x[left], dtype=np.float32)).numpy()
        return left
