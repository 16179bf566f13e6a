"""Small boxes of ``v`` that together hold every positive query the pipeline can make: what a ``relu-field`` is proven on.

* points: the cells themselves.
* boxes in 2D: whether a box meets the object depends only on the cells that its corners lie in, so products of cells are exact.
* planes in 2D: normals lie on two edges of a square; for an interval of normals the offsets that meet a connected component are
  an interval, between the largest and the least support at its ends (supports are convex).
* rays in 2D: boxes of origins times arcs of directions; kept unless the region they sweep, cut into steps, meets only empty cells.

Everything is widened by the proofs' input error ``delta``.
"""

from collections.abc import Iterator

import numpy as np

from warp_bounding.coordinates.base import direction_rounding
from warp_bounding.coordinates.domain import Domain
from warp_bounding.coordinates.region_domain import AnyDomain, RegionDomain
from warp_bounding.geometry.hull import components
from warp_bounding.indicators.grid import IndicatorGrid

__all__ = ["positive_boxes", "positive_cells"]

CHUNK = 1 << 17  # boxes at a time
NORMALS = 8  # intervals of normals in each field cell
ORIGINS = 2  # boxes of origins along each cell: a field's node is in a cell's middle
ARCS = 256
STEPS_PER_CELL = 2  # along a ray
WIDENED = 1 + 1e-9

Boxes = tuple[np.ndarray, np.ndarray]


def positive_boxes(grid: IndicatorGrid, domain: AnyDomain, field) -> Iterator[Boxes]:
    """Boxes ``(N, m)`` lower and upper, in chunks; those of planes are cut at the nodes of the ``FieldMap``."""
    kind = {"point": _points, "box": _boxes, "plane": _planes, "ray": _rays}[domain.query]
    for lower, upper in kind(grid, domain, field):
        if len(lower):
            yield lower, upper


def positive_cells(grid: IndicatorGrid, domain: AnyDomain, field) -> np.ndarray:
    """Which nodes belong to a field cell that may hold a positive: bool, one a node."""
    marked = np.zeros(field.nodes, dtype=bool)
    for lower, upper in positive_boxes(grid, domain, field):
        first = np.floor(field.coordinates(lower)).astype(np.int64)
        last = np.ceil(field.coordinates(upper)).astype(np.int64)
        for step in np.ndindex(tuple(int(s) + 1 for s in (last - first).max(axis=0))):
            marked[tuple(np.minimum(first + step, last).T)] = True
    return marked


def _points(grid: IndicatorGrid, domain: Domain, field) -> Iterator[Boxes]:
    for start in range(0, len(grid.occupied), CHUNK):
        part = grid.occupied[start : start + CHUNK]
        yield domain.widened(grid.position(part - 0.5), grid.position(part + 0.5))


def _table(grid: IndicatorGrid) -> np.ndarray:
    """Summed-area table, one row and column of zeros before it."""
    return np.pad(grid.occupancy, [(1, 0)] * 2).astype(np.int32).cumsum(axis=0).cumsum(axis=1)


def _count(table: np.ndarray, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Occupied cells in blocks first .. last - 1 of a table, indices cut at its ends."""
    a, b = (np.clip(f, 0, s - 1) for f, s in zip(first, table.shape, strict=True))
    c, d = (np.clip(f, 0, s - 1) for f, s in zip(last, table.shape, strict=True))
    c, d = np.maximum(a, c), np.maximum(b, d)
    return table[c, d] - table[a, d] - table[c, b] + table[a, b]


def _boxes(grid: IndicatorGrid, domain: RegionDomain, field) -> Iterator[Boxes]:
    base, table = domain.base, _table(grid)
    reach, limit = base.delta * WIDENED + 1e-14, base.limit.astype(np.float64)
    edges = [_on_axis(grid, base, k, np.arange(r + 1) - 0.5) for k, r in enumerate(grid.shape)] * 2
    both, ends, last = np.tile(reach, 2), np.tile(limit, 2), np.tile(grid.shape, 2) - 1
    pairs = [np.array([(i, j) for i in range(r) for j in range(i, r)]) for r in grid.shape]  # cells of low and of high
    for low, high in pairs[0]:
        cells = np.insert(pairs[1], [0, 1], (low, high), axis=1)
        cells = cells[_count(table, cells[:, :2].T, cells[:, 2:].T + 1) > 0]
        lower, upper = (np.stack([e[c + s] for e, c in zip(edges, cells.T, strict=True)], axis=1) for s in (0, 1))
        # low <= p + delta, high >= p - delta; the ends of the domain reach to its limit
        lower, upper = np.maximum(lower - both, -ends), np.minimum(upper + both, ends)
        yield np.where(cells == 0, -ends, lower), np.where(cells == last, ends, upper)


def _on_axis(grid: IndicatorGrid, base: Domain, axis: int, t: np.ndarray) -> np.ndarray:
    """Local coordinates of points on one axis of the grid, at cell coordinates t."""
    full = np.zeros((len(t), grid.ndim))
    full[:, axis] = t
    return base.to_local(grid.position(full))[:, axis]


def _planes(grid: IndicatorGrid, domain: RegionDomain, field) -> Iterator[Boxes]:
    base = domain.base
    # The computed plane passes a point within delta on every axis, and entries of m are at most 1.
    room, limit = float(base.delta.sum()) * WIDENED + 1e-13, domain.limit.astype(np.float64)
    hulls = [base.to_local(grid.position(c.corners - 0.5)) for c in components(grid.occupancy)]
    nodes = [field.to_v(np.arange(count, dtype=float)[:, None])[:, k] for k, count in enumerate(field.nodes)]
    ends = np.concatenate([[-limit[2]], nodes[2][1:-1], [limit[2]]])
    for axis in range(2):  # the entry of the normal that is exactly 1
        inner = np.linspace(-1, 1, (field.nodes[1 - axis] - 1) * NORMALS + 1)
        along = nodes[1 - axis]
        inner = np.unique(np.concatenate([inner, along[(along > -1) & (along < 1)]]))
        normal = np.ones((len(inner), 2))
        normal[:, 1 - axis] = inner
        for corners in hulls:
            at = normal @ corners.T
            low, high = at.min(axis=1) - room, at.max(axis=1) + room
            low, high = np.minimum(low[:-1], low[1:]), np.maximum(high[:-1], high[1:])
            index, cell = np.nonzero((low[:, None] <= ends[None, 1:]) & (high[:, None] >= ends[None, :-1]))
            lower, upper = np.ones((len(index), 3)), np.ones((len(index), 3))
            lower[:, 1 - axis], upper[:, 1 - axis] = inner[index], inner[index + 1]
            lower[:, 2], upper[:, 2] = np.maximum(low[index], ends[cell]), np.minimum(high[index], ends[cell + 1])
            yield lower, upper


def _rays(grid: IndicatorGrid, domain: RegionDomain, field) -> Iterator[Boxes]:
    base, table = domain.base, _table(grid)
    reach, limit = base.delta * WIDENED + 1e-14, base.limit.astype(np.float64)
    stretch, slack = domain.stretch.astype(np.float64), 2 * direction_rounding(2)
    edges = []
    for k, r in enumerate(grid.shape):  # the ends of boxes of origins
        inner = _on_axis(grid, base, k, (np.arange(1, r * ORIGINS) / ORIGINS) - 0.5)
        edges.append(np.concatenate([[-limit[k]], inner, [limit[k]]]))
    i, j = (z.reshape(-1) for z in np.meshgrid(*(np.arange(len(e) - 1) for e in edges), indexing="ij"))
    low, high = np.stack([edges[0][i], edges[1][j]], axis=1), np.stack([edges[0][i + 1], edges[1][j + 1]], axis=1)
    angle = np.linspace(0, 2 * np.pi, ARCS + 1)
    ends = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    # ARCS is a multiple of 4: an arc ends where an axis is met, so an arc's box is that of its ends.
    ends[np.abs(ends) < 1e-12] = 0.0
    first, last = np.minimum(ends[:-1], ends[1:]), np.maximum(ends[:-1], ends[1:])
    room = slack + 1e-12
    first = np.where(first > 0, first * (1 - room), first * (1 + room)) * stretch - 1e-12
    last = np.where(last > 0, last * (1 + room), last * (1 - room)) * stretch + 1e-12
    per_cell = base.scale / grid.cells_per_unit  # local units
    steps = int(np.ceil(STEPS_PER_CELL * float((stretch / per_cell).max())))
    t = np.linspace(0, 1, min(max(steps, 1), 512) + 1)
    begin, end = t[:-1, None], t[1:, None]
    # The first and last cells that closed boxes meet are ceil(low), floor(high) in these coordinates.
    below = grid.cell_coordinate(base.to_object(low - reach)) - 0.5 - 1e-9
    above = grid.cell_coordinate(base.to_object(high + reach)) + 0.5 + 1e-9
    flat, width = table.reshape(-1), table.shape[1]
    ends_of = np.array(table.shape) - 1
    for w0, w1 in zip(first, last, strict=True):
        left = np.arange(len(low))
        near, far = np.minimum(begin * w0, end * w0) / per_cell, np.maximum(begin * w1, end * w1) / per_cell  # (T, 2)
        for n0, f0 in zip(near, far, strict=True):
            a = np.clip(np.ceil(below[left] + n0), 0, ends_of).astype(np.int64)
            b = np.maximum(np.clip(np.floor(above[left] + f0) + 1, 0, ends_of).astype(np.int64), a)
            a0, b0 = a[:, 0] * width, b[:, 0] * width
            count = flat[b0 + b[:, 1]] - flat[a0 + b[:, 1]] - flat[b0 + a[:, 1]] + flat[a0 + a[:, 1]]
            left = left[count == 0]
            if not len(left):
                break
        met = np.ones(len(low), dtype=bool)
        met[left] = False
        w = np.broadcast_to(np.concatenate([w0, w1]), (int(met.sum()), 4))
        yield np.concatenate([low[met], w[:, :2]], axis=1), np.concatenate([high[met], w[:, 2:]], axis=1)
