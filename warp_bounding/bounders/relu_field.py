"""``relu-field``: learned numbers on a grid, interpolated linearly in ``v`` and clamped (the paper's OurReLUField).

After Karnewar et al., *ReLU Fields* (SIGGRAPH 2022): no network, a look-up of ``2^n`` numbers. For points; the grid has
the data's resolution, its nodes at the cells' centres. Between nodes f is linear in each coordinate alone, so on the
part of a box that lies in one field cell it is least at a corner: a bound over the object's cells is exact.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from math import prod

import numpy as np

from warp_bounding.bounders.bounder import STEPS, Bounder, Option, whole
from warp_bounding.errors import BounderError
from warp_bounding.kernels.source import Lanes, Source
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.queries import QUERIES
from warp_bounding.queries.domain import Domain
from warp_bounding.rounding import TINY, UNIT64, gamma
from warp_bounding.runtime.native import fill, native_text
from warp_bounding.shapes.grid import Grid

text = native_text("cells.h")
TOGETHER = {
    "integer": "I",
    "to_integer": "__builtin_convertvector(low, I)",
    "to_real": "__builtin_convertvector(i, V)",
    "gather": "for (int l = 0; l < L; ++l) c[corner][l] = w[base[l] + at];",
}
ALONE = {"integer": "int", "to_integer": "(int)low", "to_real": "(float)i", "gather": "c[corner] = w[base + at];"}

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
    def of(cls, grid: Grid, domain: Domain, along: int | None = None) -> "FieldMap":
        """Nodes at the cells' centres; or ``along`` of them along each axis, even from the first to the last one."""
        shape = np.array(grid.shape)
        first = domain.to_local(grid.position(np.where(shape > 1, 0.0, -0.5)))
        last = domain.to_local(grid.position(np.where(shape > 1, shape - 1.0, 0.5)))
        nodes = np.maximum(shape, 2) if along is None else np.full(len(shape), along)
        while np.prod(nodes.astype(float)) > MOST_NODES:
            nodes = np.maximum(2, nodes // 2)
        factor = ((nodes - 1) / (last - first)).astype(np.float32)
        return cls(factor, (-factor.astype(np.float64) * first).astype(np.float32), tuple(int(r) for r in nodes))

    def coordinates(self, v: np.ndarray) -> np.ndarray:
        """The node coordinates of v ``(..., m)``, float64."""
        t = np.asarray(v, dtype=np.float64) * self.factor.astype(np.float64) + self.summand
        return np.clip(t, 0, np.array(self.nodes) - 1)

    def cells(self, grid: Grid, domain: Domain) -> tuple[np.ndarray, np.ndarray]:
        """Corners ``(N, n)``, node coordinates, of boxes with all that the pipeline can make of points of cells."""
        sides = domain.widened(grid.position(grid.occupied - 0.5), grid.position(grid.occupied + 0.5))
        return tuple(self.coordinates(side) for side in sides)

    def touched(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Which nodes belong to a field cell that one of these boxes meets: bool, one a node."""
        marked = np.zeros(self.nodes, dtype=bool)
        first, last = np.floor(low).astype(np.int64), np.ceil(high).astype(np.int64)
        for step in np.ndindex(tuple(int(s) + 1 for s in (last - first).max(axis=0))):
            marked[tuple(np.minimum(first + step, last).T)] = True
        return marked

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
        filled = fill(text.FIELD, m=len(self.nodes), **listed, **(TOGETHER if lanes.vector else ALONE))
        return f"{{{filled}}}\n"


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
        return not QUERIES[query].is_region and 1 <= ndim <= 4

    @classmethod
    def fit(cls, grid: Grid, domain: Domain, *, nodes: int | None = None, device: str | None = None) -> "ReluField":
        """Where training starts: 1 at nodes of field cells that may hold a positive, else 0; ``nodes`` by axis."""
        field = FieldMap.of(grid, domain, nodes)
        return cls.of_values(domain, field, field.touched(*field.cells(grid, domain)).astype(np.float32), device)

    @classmethod
    def of_values(cls, domain: Domain, field: FieldMap, values: np.ndarray, device: str | None = None) -> "ReluField":
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
