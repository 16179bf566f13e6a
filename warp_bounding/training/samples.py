"""Labelled queries for training: ``Problem``, random queries with their truth, and positives that can be moved.

A positive is a column of *state* numbers, such as a cell and an offset in [-1/2, 1/2]^n inside it for a point, from
which its coordinates ``v`` follow by a formula. Every state in the allowed range is a positive, so a positive can walk
down a network's output without ever leaving the object. Labels are those of the exact oracles; no sample is ever taken
for a proof. ``Samples`` is the contract, with a class for each kind of query, found by its name (``samples_of``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.errors import BounderError, QueryError
from warp_bounding.queries import QUERIES, oracle, sample
from warp_bounding.queries.boundary import border_points, held_points, pulled, random_points
from warp_bounding.queries.domain import Domain
from warp_bounding.queries.region_domain import RegionDomain
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.recentred import Frame
from warp_bounding.shapes.shape import Shape
from warp_bounding.training.lazy_torch import torch

# Random points in the cells of a grid: a cell's index and an offset in [-1/2, 1/2]^n, as columns.
#
# What is hard for a network lies on the boundary: most points are in cells that touch an empty one, and most of their
# coordinates on a face of the cell, for regions rather on a face behind which it is empty.

BOUNDARY_SHARE = 2 / 3  # of the points: in cells that touch an empty one
FACE_SHARE = 0.6  # of the coordinates of these points: on a face of the cell
EXPOSED_SHARE = 0.9  # of the coordinates on a face, where just one of the two is exposed: on that one


class ObjectPoints:
    """Random points of an object, given as a cell and an offset from its middle, in cells.

    Attributes:
        unit: ``(n, 1)``, sides of a cell in local space.
        origin: ``(n, 1)``, the middle of cell 0.
        lower: ``(n, 1)``, of the object's box in local space.
        upper: ``(n, 1)``.
        detail: ``(n, 1)``, cells along each axis, relative to the axis with most.
    """

    ndim: int
    generator: torch.Generator
    unit: torch.Tensor
    origin: torch.Tensor
    lower: torch.Tensor
    upper: torch.Tensor
    detail: torch.Tensor

    def draw(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Cells and offsets: most in boundary cells and on cell faces, the rest uniform in the object."""
        raise NotImplementedError

    def draw_touching(self, count: int, share: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Boundary cells, offsets, and sides ``(n, count)``: 1 or -1 on a cell's upper or lower face, else 0.

        A ``share`` of the coordinates is on a face.
        """
        raise NotImplementedError

    def resolved(self, before: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
        """Cells and offsets ``(2 n, N)`` of points of the object, after offsets have moved."""
        return after

    def grow(self) -> None:
        """Called once a refresh, by those who find points as training goes on."""

    def to_local(self, t: torch.Tensor) -> torch.Tensor:
        """Local coordinates of cell coordinates, both ``(n, N)``."""
        return t * self.unit + self.origin

    def pick(self, cells: torch.Tensor, count: int) -> torch.Tensor:
        """``(n, count)`` random ones of the cells ``(n, C)``."""
        if not count:
            return cells[:, :0]
        return cells.index_select(1, self.integers(cells.shape[1], count))

    def rand(self, *shape: int) -> torch.Tensor:
        """Uniform numbers in [0, 1) of this shape."""
        return torch.rand(*shape, generator=self.generator)

    def integers(self, end: int, count: int) -> torch.Tensor:
        """``(count,)`` uniform whole numbers from 0 to ``end - 1``."""
        return torch.randint(end, (count,), generator=self.generator)


class CellPoints(ObjectPoints):
    """Points of a grid's object, in its cells; the domain of points gives the map to local space."""

    def __init__(self, grid: Grid, domain: Domain, generator: torch.Generator):
        self.grid, self.generator, self.ndim = grid, generator, grid.ndim
        origin, one = (domain.to_local(grid.position(at(grid.ndim))) for at in (np.zeros, np.ones))
        sides = [domain.to_local(side) for side in (grid.lower, grid.upper)]
        self.origin, self.unit, self.lower, self.upper = (columns(a[None]) for a in (origin, one - origin, *sides))
        cells = torch.tensor(grid.shape, dtype=torch.float32)[:, None]
        self.detail = cells / cells.max()
        self.occupied, self.boundary = columns(grid.occupied), columns(grid.boundary)
        self._exposed = torch.from_numpy(_exposed_sides(grid))

    def walk(self, state: torch.Tensor, slope: torch.Tensor, step: float | torch.Tensor) -> torch.Tensor:
        """Cells and offsets ``(2 n, N)`` after a move down a slope in local space; all points stay in their cells.

        The largest component moves by ``step`` cells.
        """
        slope = slope * self.unit
        slope /= slope.abs().amax(0, keepdim=True) + 1e-12
        cell, offset = state.chunk(2)
        return torch.cat([cell, (offset - step * slope).clamp_(-0.5, 0.5)])

    def draw(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        near = int(count * BOUNDARY_SHARE) if self.boundary.shape[1] else 0
        offset = self.rand(self.ndim, count) - 0.5
        snap = self.rand(self.ndim, near) < FACE_SHARE
        offset[:, :near] = torch.where(snap, torch.sign(offset[:, :near]) * 0.5, offset[:, :near])
        return torch.cat([self.pick(self.boundary, near), self.pick(self.occupied, count - near)], 1), offset

    def draw_touching(self, count: int, share: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        cells, exposed = (self.boundary, self._exposed) if self.boundary.shape[1] else (self.occupied, None)
        index = self.integers(cells.shape[1], count)
        offset = self.rand(self.ndim, count) - 0.5
        side = torch.sign(offset)
        if exposed is not None:
            known = exposed.index_select(1, index)
            side = torch.where((known != 0) & (self.rand(self.ndim, count) < EXPOSED_SHARE), known.float(), side)
        side = side * (self.rand(self.ndim, count) < share)
        return cells.index_select(1, index), torch.where(side != 0, 0.5 * side, offset), side

    def boundary_vertices(self) -> torch.Tensor:
        """``(n, K)`` local coordinates of the corners between occupied and empty cells."""
        return self.to_local(columns(_boundary_vertices(self.grid.occupancy)) - 0.5)

    def locate(self, y: np.ndarray) -> tuple[torch.Tensor, torch.Tensor, np.ndarray]:
        """Cells and offsets of points ``(N, n)`` float64, local space, and which these are.

        A point in no occupied cell, by rounding, is dropped: ``(N,)`` bool says so.
        """
        t = (y - self.origin.numpy().T.astype(np.float64)) / self.unit.numpy().T
        cell = np.rint(t).astype(np.int64)
        inside = ((cell >= 0) & (cell < self.grid.shape)).all(axis=1)
        inside[inside] = self.grid.occupancy[tuple(cell[inside].T)]
        cell, t = cell[inside], t[inside]
        return columns(cell), columns(np.clip(t - cell, -0.5, 0.5)), inside


def _boundary_vertices(occupancy: np.ndarray) -> np.ndarray:
    """``(P, n)`` indices of cell corners between occupied and empty cells; corner i is at ``t = i - 1/2``."""
    padded = np.pad(occupancy, 1)
    some, every = np.zeros([r + 1 for r in occupancy.shape], bool), np.ones([r + 1 for r in occupancy.shape], bool)
    for shift in product((0, 1), repeat=occupancy.ndim):
        part = padded[tuple(slice(s, s + r + 1) for s, r in zip(shift, occupancy.shape, strict=True))]
        some |= part
        every &= part
    return np.argwhere(some & ~every)


def _exposed_sides(grid: Grid) -> np.ndarray:
    """``(n, B)`` int8: on which side of a boundary cell it is empty, 1 above, -1 below, 0 for both or neither."""
    padded = np.pad(grid.occupancy, 1, constant_values=True)
    index = grid.boundary + 1
    sides = []
    for axis in range(grid.ndim):
        step = np.arange(grid.ndim) == axis
        above, below = (~padded[tuple((index + s * step).T)] for s in (1, -1))
        sides.append(above.astype(np.int8) - below.astype(np.int8))
    return np.array(sides).reshape(grid.ndim, -1)


def columns(rows: np.ndarray) -> torch.Tensor:
    """``(N, n)`` numbers as ``(n, N)`` float32."""
    return torch.from_numpy(np.ascontiguousarray(rows.T, dtype=np.float32))


# Random points of a shape without cells, in the form of those in cells: a cell is then anywhere, with its middle at
# the point.
#
# Points of the border, which bisection finds, and others of the object are kept; their number grows with every refresh
# of the training up to a limit, so that training begins at once. A point whose offset has moved it out of the object
# is taken back along its way to the last point that is known to be in it.

CELLS = 128  # along the shape's longest side: how far an offset reaches
BORDER = 1 << 17  # points of the border in the end
HELD = 1 << 16  # other points of the object
PARTS = 16  # in which points of the border are found, one for each of the first refreshes
NEAREST = 2.0**-9  # local units: how near to the border a point is brought back that has walked out
BORDER_SHARE = 2 / 3  # of the points: on the border
ASIDE = 0.25  # cells: how far beside a point of the border it is tried whether the object ends there


class ShapePoints(ObjectPoints):
    """Points of a shape; see ``ObjectPoints``. A cell's number is then not whole, and its offset 0."""

    def __init__(self, shape: Shape, domain: Domain, generator: torch.Generator):
        self.shape, self.domain, self.generator, self.ndim = shape, domain, generator, shape.ndim
        self._rng = np.random.default_rng(int(torch.randint(2**62, (1,), generator=generator)))
        size = shape.upper - shape.lower
        self._side = size.max() / CELLS
        self.unit = torch.from_numpy((self._side * domain.scale).astype(np.float32))[:, None]
        self.origin = torch.zeros(self.ndim, 1)
        self.lower, self.upper = (columns(domain.to_local(side)[None]) for side in (domain.lower, domain.upper))
        self.detail = torch.from_numpy((size / size.max()).astype(np.float32))[:, None]
        self._points = held_points(shape, HELD, self._rng)
        self._held = self._cells(self._points)
        self._border, self._ends = torch.empty(self.ndim, 0), torch.empty(self.ndim, 0)
        self.grow()

    def _cells(self, x: np.ndarray) -> torch.Tensor:
        """Cells ``(n, N)`` whose middles are points ``(N, n)`` of object space."""
        return columns(self.domain.to_local(x)) / self.unit

    def grow(self) -> None:
        """See ``ObjectPoints``: more of the border, until there is as much as training can use."""
        if self._border.shape[1] >= BORDER:
            return
        nearest = NEAREST / 4
        border = border_points(self.shape, BORDER // PARTS, self._rng, self._points, nearest)
        ends = []
        for axis in range(self.ndim):
            step = ASIDE * self._side * np.eye(self.ndim)[axis]
            above, below = (~self.shape.contains(border + sign * step) for sign in (1, -1))
            ends.append(above.astype(np.float32) - below)
        self._border = torch.cat([self._border, self._cells(border)], 1)
        self._ends = torch.cat([self._ends, torch.from_numpy(np.stack(ends).astype(np.float32))], 1)

    def draw(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        near = int(count * BORDER_SHARE)
        cells = torch.cat([self.pick(self._border, near), self.pick(self._held, count - near)], 1)
        return cells, torch.zeros_like(cells)

    def draw_touching(self, count: int, share: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """See ``ObjectPoints``: the sides on which the object ends there."""
        index = self.integers(self._border.shape[1], count)
        cells, ends = self._border.index_select(1, index), self._ends.index_select(1, index)
        return cells, torch.zeros_like(cells), ends * (self.rand(self.ndim, count) < share)

    def resolved(self, before: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
        start, moved = (self._points_of(each) for each in (before, after))
        left = np.flatnonzero(~self.shape.contains(moved))
        nearest = NEAREST / float(self.domain.scale.min())
        moved[left] = pulled(self.shape.contains, start[left], moved[left], nearest)[0]
        cells = self._cells(moved)
        return torch.cat([cells, torch.zeros_like(cells)])

    def _points_of(self, state: torch.Tensor) -> np.ndarray:
        """``(N, n)`` float64 points in object space of cells and offsets."""
        cell, offset = state.chunk(2)
        return self.domain.to_object(self.to_local(cell + offset).T.double().numpy())


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


FEWEST_NEGATIVES = 64  # samples that stand for negatives where uniform samples gave none
LEAST = 1e-12  # local units: added below divisors
APART = 2.0  # cells: edge of the boxes of v of which ``spread`` keeps one state each
REGIONS, REGION_PARTS = 1 << 19, 32  # regions of a shape that are labelled and kept in the end, and in how many draws
ATTEMPTS = 20  # batches in which a negative is looked for


class Samples:
    """Random samples of one kind of query, as columns; made of the object, a domain and a source of randomness.

    ``detail`` ``(ndim, 1)`` are the object's cells along each axis of ``v``, relative to the axis with most; ``waves``
    ``(2 K, ndim + 1)`` a first layer whose sines are those of the object (``Shape.waves``); ``vertices`` ``(ndim, K)``
    all positives where a minimum of f is likely, such as corners; ``callers`` queries of the caller's own, which take
    the place of some of the negatives.
    """

    query = ""
    ndim: int
    generator: torch.Generator
    detail: torch.Tensor
    waves: torch.Tensor | None = None
    vertices: torch.Tensor
    callers: CallersQueries | None = None

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
        return torch.cat([self.callers.negatives(own, self.generator), self.usual_negatives(count - own)], 1)

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
        raise NotImplementedError(f"{self.query}: counterexamples come as states")

    def at(self, z: np.ndarray) -> torch.Tensor:
        """States of positives given as numbers ``(N, Z)`` of a proof's parametrization; some may be dropped."""
        raise NotImplementedError(f"{self.query}: there is no chart")


class RegionSamples(Samples):
    """What rays and boxes share: random regions of 2n numbers, labelled by the exact oracle of a grid or a shape.

    Labels of a shape without cells are retained. The first 2n rows of a state are a cell and an offset, a point of the
    object in the region.
    """

    def __init__(self, grid: Shape, domain: RegionDomain, generator: torch.Generator):
        self.cells: ObjectPoints = (CellPoints if isinstance(grid, Grid) else ShapePoints)(grid, domain.base, generator)
        self.grid, self.domain, self.generator, self.ndim = grid, domain, generator, 2 * grid.ndim
        self._oracle = oracle(self.query, grid, "cpu", domain.oracle_length)
        self._rng = np.random.default_rng(int(torch.randint(2**62, (1,), generator=generator)))
        self._kept, self._truth = torch.empty(self.ndim, 0), torch.empty(0, dtype=torch.bool)
        self.detail, self.vertices = self.cells.detail.repeat(2, 1), torch.empty(self.ndim, 0)

    def uniform(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        if isinstance(self.grid, Grid):
            return self._labelled(count)
        if len(self._truth) < REGIONS:  # of a shape labels take longer
            v, truth = self._labelled(REGIONS // REGION_PARTS)
            self._kept, self._truth = torch.cat([self._kept, v], 1), torch.cat([self._truth, truth])
        chosen = torch.randint(len(self._truth), (count,), generator=self.generator)
        return self._kept.index_select(1, chosen), self._truth[chosen]

    def _labelled(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """``uniform``, of fresh samples."""
        q = sample(self.query, self.grid, count, self._rng)
        return columns(self.domain.to_local(q)), torch.from_numpy(self._oracle(q))

    def usual_negatives(self, count: int) -> torch.Tensor:
        self.cells.grow()
        # Where (almost) every region meets the object, a few positives stand for them: the loss needs a few columns,
        # and the threshold, which is set on positives, does not depend on them.
        for _ in range(ATTEMPTS):
            v, truth = self.uniform(count)
            if not truth.all():
                return v[:, ~truth]
        return v[:, :FEWEST_NEGATIVES]

    def spread(self, state: torch.Tensor, most: int) -> torch.Tensor:
        """Of states, hardest first, the first one in each box of ``APART`` cells of v, and no more than ``most``.

        A search's points crowd around few minima, and would fill the hard pool with one place.
        """
        place = (self.coordinates(state) / (APART * self.cells.unit.repeat(2, 1))).floor()
        first = np.unique(place.numpy(), axis=1, return_index=True)[1]
        return state[:, torch.from_numpy(np.sort(first)[:most])]

    def resolved(self, before: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
        n = self.grid.ndim
        points = after[: 2 * n]
        held = self.cells.resolved(before[: 2 * n], points)
        return after if held is points else torch.cat([held, after[2 * n :]])

    def point(self, state: torch.Tensor) -> torch.Tensor:
        """``(n, N)`` local coordinates of the point of the object."""
        n = self.grid.ndim
        return self.cells.to_local(state[:n] + state[n : 2 * n])


# Samples of points: a positive is a cell and an offset inside it.


class PointSamples(Samples):
    """Random points of a grid; see ``Samples``. A state is a cell (n rows) and an offset (n rows)."""

    query = "point"

    def __init__(self, grid: Grid, domain: Domain, generator: torch.Generator):
        self.grid, self.generator, self.ndim = grid, generator, grid.ndim
        self.cells = CellPoints(grid, domain, generator)
        self.detail, self.vertices = self.cells.detail, self.cells.boundary_vertices()
        shape = np.array(grid.shape)
        self._first = columns(np.where(shape > 1, 0.0, -0.5)[None])
        self._extent = columns(np.where(shape > 1, shape - 1.0, 1.0)[None])
        self._table = torch.from_numpy(grid.occupancy.reshape(-1).copy())
        self._stride = torch.tensor([int(np.prod(shape[k + 1 :])) for k in range(grid.ndim)])[:, None]
        self._shape = torch.from_numpy(shape)[:, None]

    def uniform(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        t = self.cells.rand(self.ndim, count) * self._extent + self._first
        cell = torch.minimum(torch.round(t).long().clamp_(min=0), self._shape - 1)
        return self.cells.to_local(t), self._table[(cell * self._stride).sum(0)]

    def usual_negatives(self, count: int) -> torch.Tensor:
        v, truth = self.uniform(count)
        if truth.all():
            cells = self.cells.pick(columns(np.argwhere(~self.grid.occupancy)), FEWEST_NEGATIVES)
            return self.cells.to_local(cells + self.cells.rand(*cells.shape) - 0.5)
        return v[:, ~truth]

    def positives(self, count: int) -> torch.Tensor:
        return torch.cat(self.cells.draw(count))

    def coordinates(self, state: torch.Tensor) -> torch.Tensor:
        return self.cells.to_local(state[: self.ndim] + state[self.ndim :])

    def move(self, state: torch.Tensor, slope: torch.Tensor, step: float | torch.Tensor) -> torch.Tensor:
        return self.cells.walk(state, slope, step)

    def locate(self, v: np.ndarray) -> torch.Tensor:
        return torch.cat(self.cells.locate(v)[:2])


# Samples of points of a shape without cells: a positive is a point of the object, and stays one by being asked.
#
# Labelled points, and points of the border, which bisection finds, are kept: their number grows with every refresh of
# the training up to a limit, so that training begins at once, and each refresh takes others of them. A positive that
# walks out of the object is taken back along its way to the last point that is known to be in it.

POINTS = 1 << 20  # random points of the domain that are labelled in the end
FEWEST_HELD = 4096  # points of the object, at least
FEW = 1024  # points of the border that stand for landmarks where a shape has none
STEP = 2 / 64  # local units: what ``move`` calls a cell
# Of joints: the share of the positives that lie at some joints' limits, and of their coordinates that do. Random points
# seldom come near several limits at once, where f is often least.
LIMITS_SHARE, AT_LIMITS = 1 / 8, 0.4


class ShapePointSamples(Samples):
    """Random points of a shape; see ``Samples``. A state is the point itself, in local coordinates (n rows)."""

    query = "point"

    def __init__(self, shape: Shape, domain: Domain, generator: torch.Generator):
        self.shape, self.domain, self.generator, self.ndim = shape, domain, generator, shape.ndim
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
        self._free = self._labelled[:, ~self._truth]
        if not self._free.shape[
            1
        ]:  # the object fills its box: another point stands for negatives, which the loss needs
            self._free = columns(local(shape.sample_lower)[None])

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


# Samples of rays: a positive is a point p of the object, and the share t of the ray that lies before it.
#
# ``v = (a, w)``: origin and displacement over the whole length, in local space, so a = p - t w. The origin stays in the
# domain, which bounds t. Hard for a network is what barely touches: p on a cell's edge or corner with the ray passing
# outside, p on a face where the ray ends as it arrives or begins as it leaves. A third of the positives are other rays
# through the object, and the protocol's own directions are half of all.

RAY_TOUCHING = 0.5  # of the positives: rays that touch their cell from outside
RAY_FROM_BORDER = 0.25  # of the positives: rays from the domain's border to the object's boundary
BORDER_FACE_SHARE = 0.5  # of the coordinates of their origins: on the border
RAY_FACES = 0.65  # of the coordinates of p: on a face of the cell
END_SHARES = (0.2, 0.5)  # of the other rays: up to the first share begin at p, from there to the second end at p
REACH = 3.0  # t and the direction move by so many cells where p moves by one
ON_BORDER = 1e-5  # of t: an origin this near to the domain's border is on it
SLOWEST = 0.05  # local units: least |w| across a border in its gradient; along the border a slide would be endless
BESIDE = 1e-4  # of a cell: how far beside a point of a face its cell is looked for


class RaySamples(RegionSamples):
    """Random rays; see ``Samples``. A state: cell, offset (n rows each), t (1), unit direction in object space (n)."""

    query = "ray"

    def __init__(self, grid: Grid, domain: RegionDomain, generator: torch.Generator):
        super().__init__(grid, domain, generator)
        self._stretch = torch.from_numpy(np.asarray(domain.stretch, dtype=np.float32))[:, None]
        self._cells_long = (self._stretch / self.cells.unit).abs()  # cells that a ray along each axis crosses

    def positives(self, count: int) -> torch.Tensor:
        touching, from_border = int(count * RAY_TOUCHING), int(count * RAY_FROM_BORDER)
        parts = [
            self._touching(touching),
            self._from_border(from_border),
            self._through(count - touching - from_border),
        ]
        return torch.cat(parts, 1)

    def _touching(self, count: int) -> torch.Tensor:
        """Rays that touch the cell of p from outside, if its neighbours are empty."""
        cells, offset, side = self.cells.draw_touching(count, RAY_FACES)
        direction = self.directions(count)
        away = side * direction
        leaves, arrives = (away >= 0).all(0), (away <= 0).all(0)
        longest = self._longest(self.cells.to_local(cells + offset), direction)
        share = torch.where(leaves, 0.0, torch.where(arrives, 1.0, self.cells.rand(count) * longest))
        return torch.cat([cells, offset, torch.minimum(share, longest)[None], direction])

    def _from_border(self, count: int) -> torch.Tensor:
        """Rays from the domain, mostly from its border, to the object's boundary, cut to their length."""
        cells, offset, _ = self.cells.draw_touching(count, RAY_FACES)
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

    def resolved(self, before: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
        resolved, n = super().resolved(before, after), self.grid.ndim
        if resolved is after:
            return after
        longest = self._longest(self.point(resolved), resolved[2 * n + 1 :])
        return torch.cat([resolved[: 2 * n], torch.minimum(resolved[2 * n], longest)[None], resolved[2 * n + 1 :]])

    def at(self, z: np.ndarray) -> torch.Tensor:
        # z = (p, t, m) of ``networks.parametrizations.RayParametrization``
        n = self.grid.ndim
        p, t, m = z[:, :n], z[:, n], z[:, n + 1 :]
        u = m / np.linalg.norm(m, axis=1, keepdims=True)
        cells, offset = np.zeros_like(p), np.zeros_like(p)
        found = np.zeros(len(p), dtype=bool)
        for side in product((-1.0, 1.0), repeat=n):  # p lies on a face or an edge: beside it there is a cell
            cell, part, kept = self.cells.locate(p + np.array(side) * BESIDE * self.cells.unit.numpy()[:, 0])
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


# Samples of boxes: a positive is a point p of the object, and how far the box reaches below and above it.
#
# ``v = (low, high)`` in local space, inside the domain: low = p - e (p - lower), high = p + e' (upper - p) with e, e'
# in [0, 1] per axis. Positives are an up-set (a larger box is one too), so its boundary is made of boxes that touch:
# where p is on a cell's face, they reach away from it only. They are most of the positives, of all sizes from 0 to the
# domain.

BOX_TOUCHING = 3 / 4  # of the positives: boxes that touch their cell from outside
NONE_SHARE = 0.25  # of the reaches e: 0
FULL_SHARES = (0.1, 0.6)  # of the reaches e: 1, up to the domain's border; and of those of slabs
SLABS = 0.3  # of the positives: boxes that reach the domain's border on most sides
REACH_POWERS = (1.0, 4.0)  # the other reaches e are a uniform number to a power between these


class BoxSamples(RegionSamples):
    """Random boxes; see ``Samples``. A state: cell, offset, reach below, reach above (n rows each)."""

    query = "box"

    def positives(self, count: int) -> torch.Tensor:
        n, near = self.grid.ndim, int(count * BOX_TOUCHING)
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
        # z of ``networks.parametrizations.box``: low and high in cells
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


# of grids, and of shapes without cells
SAMPLES: dict[str, type[Samples]] = {kind.query: kind for kind in (PointSamples, RaySamples, BoxSamples)}
SHAPE_SAMPLES: dict[str, type[Samples]] = SAMPLES | {ShapePointSamples.query: ShapePointSamples}


def samples_of(shape: Shape, domain: Domain | RegionDomain, seed: int = 0) -> Samples:
    """The samples of a domain's kind of query; the seed is also that of its trainer."""
    if domain.query not in SAMPLES:
        raise BounderError(f"training knows {', '.join(SAMPLES)}, got {domain.query}")
    kinds = SAMPLES if isinstance(shape, Grid) else SHAPE_SAMPLES
    return kinds[domain.query](shape, domain, torch.Generator().manual_seed(seed))


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
    target: Domain | None = None  # where a network of points is queried, if it is trained in another domain, its own
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
