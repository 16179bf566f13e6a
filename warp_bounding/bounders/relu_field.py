"""``relu-field``: learned numbers on a grid, interpolated linearly in ``v`` and clamped (the paper's OurReLUField).

After Karnewar et al., *ReLU Fields* (SIGGRAPH 2022): no network, a look-up of ``2^m`` numbers. For points the grid has
the data's resolution, its nodes at the cells' centres; for regions of two-dimensional objects 32 nodes along each of
the 3 or 4 numbers. Between nodes f is linear in each coordinate alone, so on the part of a box that lies in one field
cell it is least at a corner: a bound over the object's cells is exact, and one over regions comes from a cover of all
positives by small boxes (``relu_field_cover``). The grid grows with the power m, so there is no field for regions in 3D
and above.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from math import prod

import numpy as np

from warp_bounding.bounders.bounder import STEPS, Bounder, Option, whole
from warp_bounding.errors import BounderError
from warp_bounding.geometry import components
from warp_bounding.kernels.source import Lanes, Source, fill
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.queries.base import direction_rounding
from warp_bounding.queries.domain import Domain
from warp_bounding.queries.region_domain import AnyDomain, RegionDomain
from warp_bounding.rounding import TINY, UNIT64, gamma
from warp_bounding.shapes.grid import Grid, block_counts, summed_area

# --- native ----------------------------------------------------------------------------------------------------------
#
# The C text of the field's look-up: multilinear interpolation between the 2^M nodes around a point, neighbours in
# pairs.

TEXT = """
{
    constexpr int M = $m;
    constexpr int NODES[M] = {$nodes}, STRIDES[M] = {$strides};
    V share[M], c[1 << M];
    $integer base = {};
#pragma unroll
    for (int k = 0; k < M; ++k) {  // node coordinate t, cut at the grid's ends, and the node below
        const float last = NODES[k] - 1;
        V t = v[k] * w[k] + w[M + k];
        t = t < 0.0f ? t * 0.0f : t;
        t = t > last ? t * 0.0f + last : t;
        const V low = t > last - 1.0f ? t * 0.0f + (last - 1.0f) : t;
        const $integer i = $to_integer;
        share[k] = t - $to_real;
        base += i * STRIDES[k];
    }
#pragma unroll
    for (int corner = 0; corner < 1 << M; ++corner) {  // bit M - 1 - k tells whether it is the upper one along axis k
        int at = 2 * M;
#pragma unroll
        for (int k = 0; k < M; ++k) at += (corner >> (M - 1 - k) & 1) * STRIDES[k];
        $gather
    }
#pragma unroll
    for (int k = M - 1; k >= 0; --k)
#pragma unroll
        for (int pair = 0; pair < 1 << k; ++pair)
            c[pair] = c[2 * pair] + (c[2 * pair + 1] - c[2 * pair]) * share[k];
    f = c[0] < 0.0f ? c[0] * 0.0f : c[0];
    f = f > 1.0f ? f * 0.0f + 1.0f : f;
}
"""

TOGETHER = {
    "integer": "I",
    "to_integer": "__builtin_convertvector(low, I)",
    "to_real": "__builtin_convertvector(i, V)",
    "gather": "for (int l = 0; l < L; ++l) c[corner][l] = w[base[l] + at];",
}
ALONE = {"integer": "int", "to_integer": "(int)low", "to_real": "(float)i", "gather": "c[corner] = w[base + at];"}


# --- cover -----------------------------------------------------------------------------------------------------------
#
# Small boxes of ``v`` that together hold every positive query the pipeline can make: what a ``relu-field`` is proven
# on.
#
# * points: the cells themselves.
# * boxes in 2D: whether a box meets the object depends only on the cells that its corners lie in, so products of cells
# are exact.
# * planes in 2D: normals lie on two edges of a square; for an interval of normals the offsets that meet a connected
# component are an interval, between the largest and the least support at its ends (supports are convex).
# * rays in 2D: boxes of origins times arcs of directions; kept unless the region they sweep, cut into steps, meets only
# empty cells.
#
# Everything is widened by the proofs' input error ``delta``.

CHUNK = 1 << 17  # boxes at a time
NORMALS = 8  # intervals of normals in each field cell
ORIGINS = 2  # boxes of origins along each cell: a field's node is in a cell's middle
ARCS = 256
STEPS_PER_CELL = 2  # along a ray
WIDENED = 1 + 1e-9

Boxes = tuple[np.ndarray, np.ndarray]


def positive_boxes(grid: Grid, domain: AnyDomain, field) -> Iterator[Boxes]:
    """Boxes ``(N, m)`` lower and upper, in chunks; those of planes are cut at the nodes of the ``FieldMap``."""
    kind = {"point": _points, "box": _boxes, "plane": _planes, "ray": _rays}[domain.query]
    for lower, upper in kind(grid, domain, field):
        if len(lower):
            yield lower, upper


def positive_cells(grid: Grid, domain: AnyDomain, field) -> np.ndarray:
    """Which nodes belong to a field cell that may hold a positive: bool, one a node."""
    marked = np.zeros(field.nodes, dtype=bool)
    for lower, upper in positive_boxes(grid, domain, field):
        first = np.floor(field.coordinates(lower)).astype(np.int64)
        last = np.ceil(field.coordinates(upper)).astype(np.int64)
        for step in np.ndindex(tuple(int(s) + 1 for s in (last - first).max(axis=0))):
            marked[tuple(np.minimum(first + step, last).T)] = True
    return marked


def _points(grid: Grid, domain: Domain, field) -> Iterator[Boxes]:
    for start in range(0, len(grid.occupied), CHUNK):
        part = grid.occupied[start : start + CHUNK]
        yield domain.widened(grid.position(part - 0.5), grid.position(part + 0.5))


def _boxes(grid: Grid, domain: RegionDomain, field) -> Iterator[Boxes]:
    base, table = domain.base, summed_area(grid.occupancy)
    reach, limit = base.delta * WIDENED + 1e-14, base.limit.astype(np.float64)
    edges = [_on_axis(grid, base, k, np.arange(r + 1) - 0.5) for k, r in enumerate(grid.shape)] * 2
    both, ends, last = np.tile(reach, 2), np.tile(limit, 2), np.tile(grid.shape, 2) - 1
    pairs = [np.array([(i, j) for i in range(r) for j in range(i, r)]) for r in grid.shape]  # cells of low and of high
    for low, high in pairs[0]:
        cells = np.insert(pairs[1], [0, 1], (low, high), axis=1)
        cells = cells[block_counts(table, cells[:, :2], cells[:, 2:] + 1) > 0]
        lower, upper = (np.stack([e[c + s] for e, c in zip(edges, cells.T, strict=True)], axis=1) for s in (0, 1))
        # low <= p + delta, high >= p - delta; the ends of the domain reach to its limit
        lower, upper = np.maximum(lower - both, -ends), np.minimum(upper + both, ends)
        yield np.where(cells == 0, -ends, lower), np.where(cells == last, ends, upper)


def _on_axis(grid: Grid, base: Domain, axis: int, t: np.ndarray) -> np.ndarray:
    """Local coordinates of points on one axis of the grid, at cell coordinates t."""
    full = np.zeros((len(t), grid.ndim))
    full[:, axis] = t
    return base.to_local(grid.position(full))[:, axis]


def _planes(grid: Grid, domain: RegionDomain, field) -> Iterator[Boxes]:
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


def _rays(grid: Grid, domain: RegionDomain, field) -> Iterator[Boxes]:
    base, table = domain.base, summed_area(grid.occupancy)
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


PLACES = {"ray": 1, "plane": 0, "box": 2}  # how many of a region's numbers are points, by the kind of query
REGION_NODES = 32  # along each number of a region
MOST_NODES = 1 << 24
LARGEST_COORDINATE = 2.0**60  # of a node: kernels cut them at the grid's ends, which they could not do with infinity
MOST_POINT_NODES = 1024  # along each axis of a field of points
MOST_BREAKS = 4  # of the field along one axis of a box whose bound is taken exactly
SNAP = 1e-3  # nodes: an end of a box this near to a node is moved there, and its slope paid for
AT_ONCE = 4096  # boxes
POINTS_AT_ONCE = 1 << 16


@dataclass(frozen=True)
class FieldMap:
    """Where the nodes are: node coordinate ``t = factor v + summand``, cut at [0, nodes - 1]; exact float32 numbers."""

    factor: np.ndarray
    summand: np.ndarray
    nodes: tuple[int, ...]

    @classmethod
    def of(cls, grid: Grid, domain: AnyDomain, along: int | None = None) -> "FieldMap":
        """Nodes at the cells' centres for coordinates of points, corners and origins; evenly spaced for other numbers.

        Of points, there may be ``along`` nodes along each axis instead, even from the first to the last cell's centre.
        """
        base, shape = domain.base, np.array(grid.shape)
        first = base.to_local(grid.position(np.where(shape > 1, 0.0, -0.5)))
        last = base.to_local(grid.position(np.where(shape > 1, shape - 1.0, 0.5)))
        nodes = np.maximum(shape, 2) if along is None else np.full(len(shape), along)
        if domain.tested_as_region:
            places = PLACES[domain.query]
            limit = domain.limit.astype(np.float64)[places * base.ndim :]
            first = np.concatenate([*[first] * places, -limit])
            last = np.concatenate([*[last] * places, limit])
            nodes = np.concatenate([*[np.minimum(nodes, REGION_NODES)] * places, np.full(len(limit), REGION_NODES)])
        while np.prod(nodes.astype(float)) > MOST_NODES:
            nodes = np.maximum(2, nodes // 2)
        factor = ((nodes - 1) / (last - first)).astype(np.float32)
        return cls(factor, (-factor.astype(np.float64) * first).astype(np.float32), tuple(int(r) for r in nodes))

    def coordinates(self, v: np.ndarray) -> np.ndarray:
        """The node coordinates of v ``(..., m)``, float64."""
        t = np.asarray(v, dtype=np.float64) * self.factor.astype(np.float64) + self.summand
        return np.clip(t, 0, np.array(self.nodes) - 1)

    def to_v(self, t: np.ndarray) -> np.ndarray:
        """The v of node coordinates."""
        return (np.asarray(t, dtype=np.float64) - self.summand) / self.factor.astype(np.float64)


@dataclass(frozen=True)
class ReluFieldSource(Source):
    """Native code of the look-up. Numbers: factor, summand (m each), then the nodes' values in array order."""

    nodes: tuple[int, ...]

    packed = True

    def body(self, lanes: Lanes) -> str:
        strides = [prod(self.nodes[k + 1 :]) for k in range(len(self.nodes))]
        listed = {"nodes": ", ".join(map(str, self.nodes)), "strides": ", ".join(map(str, strides))}
        return fill(TEXT, m=len(self.nodes), **listed, **(TOGETHER if lanes.vector else ALONE))


class ReluField(Bounder):
    """A learned grid; see module. ``f = min(max(interpolated, 0), 1)``.

    Tensors: ``values`` ``(R_0, ..., R_{m-1})``, ``factor`` and ``summand`` ``(m,)``.
    """

    method = "relu-field"
    lays_cells = True
    options = (
        Option(
            "nodes",
            None,
            "along each axis of a field of points; by default as many as the object has cells",
            whole("nodes", 2, MOST_POINT_NODES),
            int,
            ("point",),
        ),
        STEPS,
    )

    @classmethod
    def supports(cls, query: str, ndim: int) -> bool:
        if query in PLACES:
            return ndim == 2
        return super().supports(query, ndim) and 1 <= ndim <= 4

    @classmethod
    def fit(cls, grid: Grid, domain: AnyDomain, *, nodes: int | None = None, device: str | None = None) -> "ReluField":
        """Where training starts: 1 at nodes of field cells that may hold a positive, else 0; ``nodes`` by axis."""
        field = FieldMap.of(grid, domain, nodes)
        return cls.of_values(domain, field, positive_cells(grid, domain, field).astype(np.float32), device)

    @classmethod
    def of_values(
        cls, domain: AnyDomain, field: FieldMap, values: np.ndarray, device: str | None = None
    ) -> "ReluField":
        """A bounder of node values."""
        tensors = {"values": values.astype(np.float32), "factor": field.factor, "summand": field.summand}
        return cls(domain, tensors, {"nodes": list(field.nodes)}, device)

    def check_tensors(self) -> None:
        domain, nodes = self.domain, tuple(self.sizes.get("nodes", ()))
        if len(nodes) != domain.ndim or not all(type(r) is int and r > 1 for r in nodes):
            raise BounderError(f"relu-field: expected {domain.ndim} numbers of nodes, got {nodes}")
        self.expect_shapes({"values": nodes, "factor": (domain.ndim,), "summand": (domain.ndim,)})
        if np.prod(nodes, dtype=object) > MOST_NODES or not (self.tensors["factor"] > 0).all():
            raise BounderError(f"relu-field: expected at most {MOST_NODES} nodes, and positive factors")
        self.field = FieldMap(self.tensors["factor"], self.tensors["summand"], nodes)
        self.check_range()
        if not (self._coordinate_sizes < LARGEST_COORDINATE).all():  # of a field that is flat, too
            raise BounderError("relu-field: numbers are so large that float32 sums may overflow")

    @property
    def source(self) -> ReluFieldSource:
        return self.source_of(ReluFieldSource, self.field.nodes)

    def weights(self) -> np.ndarray:
        return np.concatenate([self.tensors[k].reshape(-1) for k in ("factor", "summand", "values")])

    @cached_property
    def _values(self) -> np.ndarray:
        return self.tensors["values"].astype(np.float64).reshape(-1)

    def reference(self, v: np.ndarray) -> np.ndarray:
        t, nodes = self.field.coordinates(v), self.field.nodes
        starts = range(0, len(t), POINTS_AT_ONCE)
        parts = [interpolate(self._values, nodes, t[i : i + POINTS_AT_ONCE]) for i in starts]
        return np.clip(np.concatenate([*parts, np.zeros(0)]), 0, 1)

    @cached_property
    def _coordinate_sizes(self) -> np.ndarray:
        """``(m,)``, largest sum of absolute terms of a node coordinate before it is cut at the grid's ends."""
        field = self.field
        return np.abs(field.factor).astype(np.float64) * self.domain.limit + np.abs(field.summand.astype(np.float64))

    @cached_property
    def _blur(self) -> np.ndarray:
        """``(m,)``, what float64 rounds in a node coordinate."""
        return gamma(8, UNIT64) * (self._coordinate_sizes + 1)

    @cached_property
    def _steepest(self) -> np.ndarray:
        """``(m,)``, largest slope of f along every axis, per node."""
        values = self.tensors["values"].astype(np.float64)
        return np.array([np.abs(np.diff(values, axis=k)).max() for k in range(values.ndim)])

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """See ``Bounder``: exact up to ``SNAP`` for boxes over few field cells; of others it only says that f >= 0."""
        low, high = self.field.coordinates(lower), self.field.coordinates(upper)
        inner, outer = np.ceil(low), np.floor(high)
        # A box that passes a node by a hair is cut there; f changes by no more than its slope allows.
        wide = outer > inner
        cut_low, cut_high = (np.where(wide & (s < SNAP), s, 0) for s in (inner - low, high - outer))
        low, high = np.where(cut_low > 0, inner, low), np.where(cut_high > 0, outer, high)
        breaks, least, point = field_breaks(low, high), np.zeros(len(low)), (low + high) / 2
        few = (breaks >= 0).all(axis=1)
        for most in np.unique(breaks[few].max(axis=1, initial=0)):
            part = few & (breaks.max(axis=1) == most)
            least[part], point[part] = self._least(low[part], high[part], int(most))
        rounding = gamma(64, UNIT64) * (1 + float(np.abs(self._values).max())) + float(self._blur @ self._steepest)
        least = least - (cut_low + cut_high) @ self._steepest - rounding
        point = np.clip(self.field.to_v(point), lower, upper)
        axis = np.argmax(high - low, axis=1)
        axis = np.where((high > low).any(axis=1), axis, np.argmax(upper - lower, axis=1))
        return BoxBounds(np.clip(least, 0, 1), axis, point, self.reference(point))

    def _least(self, low: np.ndarray, high: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
        """The least value over boxes, at one of the products of their ends and the nodes between."""
        best, point = np.full(len(low), np.inf), low.copy()
        for t in break_points(low, high, most):
            value = interpolate(self._values, self.field.nodes, t)
            point = np.where((value < best)[:, None], t, point)
            best = np.minimum(best, value)
        return best, point

    def least(self, grid: Grid) -> tuple[float, int]:
        """See ``Bounder``; for regions over boxes that cover all positives, but those with all nodes higher."""
        if self.domain.tested_as_point:
            return super().least(grid)
        least, count, cells, most = 1.0, 0, self._cell_minima, np.array(self.field.nodes) - 2
        for lower, upper in positive_boxes(grid, self.domain, self.field):
            count += len(lower)
            first = np.floor(self.field.coordinates(lower) - self._blur).astype(np.int64)
            last = np.ceil(self.field.coordinates(upper) + self._blur).astype(np.int64) - 1
            first, last = np.clip(first, 0, most), np.clip(last, 0, most)
            last = np.maximum(first, last)
            quick = np.full(len(lower), np.inf)
            for step in np.ndindex(tuple(int(s) + 1 for s in (last - first).max(axis=0))):
                quick = np.minimum(quick, cells[tuple(np.minimum(first + step, last).T)])
            order = np.argsort(quick)
            for start in range(0, len(order), AT_ONCE):
                part = order[start : start + AT_ONCE]
                if quick[part[0]] >= least:
                    break
                least = np.minimum(least, self.bound(lower[part], upper[part]).lower.min())
        return float(least), count

    @cached_property
    def _cell_minima(self) -> np.ndarray:
        """The least of its nodes' values, for every field cell."""
        least = self.tensors["values"].astype(np.float64)
        for k in range(least.ndim):
            least = np.minimum(*(np.take(least, range(s, least.shape[k] - 1 + s), axis=k) for s in (0, 1)))
        return least

    def rounding_bound(self) -> float:
        """See ``Bounder``: the node coordinate moves, and f with it; then m levels of interpolation."""
        moved = gamma(3) * (self._coordinate_sizes + 1) + (4 + np.abs(self.field.factor) + self.domain.limit) * TINY
        largest = float(np.abs(self._values).max())
        return float((moved @ self._steepest + gamma(12 * len(moved)) * 2 * largest + 64 * TINY) * (1 + 1e-9))


def interpolate(values: np.ndarray, nodes: tuple[int, ...], t: np.ndarray) -> np.ndarray:
    """Multilinear interpolation of flat ``values`` at node coordinates ``(N, m)`` inside the grid."""
    index, share = corners_of(nodes, t)
    c = values[index]
    for k in range(len(nodes) - 1, -1, -1):
        c = c[:, 0::2] + (c[:, 1::2] - c[:, 0::2]) * share[:, k, None]
    return c[:, 0]


def corners_of(nodes: tuple[int, ...], t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Flat indices ``(N, 2^m)`` of the nodes around points, in axis order, and the points' fractions ``(N, m)``."""
    low = np.clip(np.floor(t).astype(np.int64), 0, np.array(nodes) - 2)
    strides = np.array([int(np.prod(nodes[k + 1 :])) for k in range(len(nodes))])
    corners = np.array(list(np.ndindex((2,) * len(nodes))), dtype=np.int64)
    return (low @ strides)[:, None] + corners @ strides, t - low


def field_breaks(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """``(N, m)``: how many nodes lie strictly inside boxes of node coordinates, by axis; -1 for too many."""
    count = np.maximum(np.ceil(high) - np.floor(low) - 1, 0).astype(np.int64)
    return np.where(count + 2 <= MOST_BREAKS, count, -1)


def break_points(low: np.ndarray, high: np.ndarray, most: int) -> Iterator[np.ndarray]:
    """The ``(most + 2)^m`` products of the ends of boxes and of up to ``most`` nodes inside: where f may be least."""
    inner = np.floor(low) + 1
    breaks = np.stack([low, *(np.minimum(inner + j, high) for j in range(most)), high], axis=2)
    for choice in np.ndindex((most + 2,) * low.shape[1]):
        yield np.stack([breaks[:, k, c] for k, c in enumerate(choice)], axis=1)
