"""What the exact oracles share: a kernel around their C text, its arrays, and rational numbers on the host.

A kernel writes 0 or 1 where float64 arithmetic is certain, and 2 where a comparison that matters is closer than its
error bound; those few queries are decided on the host, in integers. The cell coordinate ``t = cells_per_unit x -
offset`` of a float32 ``x`` needs two float64 numbers: the product is exact, and the rounding error of the difference
is computed too (Knuth's TwoSum), so that signs of ``face - t`` are exact and its relative error is a few roundings.
"""

from fractions import Fraction
from functools import cache
from math import ceil, floor, lcm
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from warp_bounding.errors import QueryError
from warp_bounding.runtime.launch import BLOCK, launch_blocks
from warp_bounding.runtime.native import constant, constants, fill, named, native_text
from warp_bounding.shapes.grid import Grid

if TYPE_CHECKING:
    from warp_bounding.queries.base import Query

text = native_text("truth.h")
RELATIVE_ERROR = 2.0**-48  # 32 roundings of float64: no quantity that carries it goes through more than 16 (n <= 16)


def loop_snippet(ndim: int, body: str, columns: int) -> str:
    """Native source: ``body`` for every query of a block on a CPU, for one query on CUDA.

    The body is given ``q``, M finite floats, the dimension N and ``rho`` (``RELATIVE_ERROR``). It sets ``answer``,
    which is 0 at first, to 1 (the query meets the object) or 2 (too close to say), and may end the query with
    ``break``.
    """
    sizes = constants(N=ndim, M=columns, BLOCK=BLOCK) + f" constexpr double rho = {constant(RELATIVE_ERROR)};"
    return sizes + text.COORDINATE + fill(text.LOOP, body=body)


@cache
def oracle_kernel(name: str, ndim: int, columns: int, body: str) -> wp.Kernel:
    """The kernel of an oracle, by a name of this body and dimension only.

    Besides the queries the body (``loop_snippet``) reads ``map`` (cells per unit, offset and shape, n float64 each, and
    more where the oracle adds it) and whichever it needs of ``numbers``, ``indices``, ``cells`` and ``length``.
    """

    @named(name).block_kernel(loop_snippet(ndim, body, columns))
    def oracle(
        x: wp.array(dtype=wp.float32),
        count: int,
        block: int,
        map: wp.array(dtype=wp.float64),
        numbers: wp.array(dtype=wp.float64),
        indices: wp.array(dtype=wp.int32),
        cells: wp.array(dtype=wp.uint8),
        length: wp.float64,
        out: wp.array(dtype=wp.uint8),
    ): ...

    return oracle


def cell_coordinates(grid: Grid, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The kernels' ``Coordinate`` of float32 ``(..., n)``: two float64 arrays, t and its rounding error."""
    product = np.asarray(x, dtype=np.float32).astype(np.float64) * grid.cells_per_unit
    t = product - grid.offset
    back = t - product
    return t, (product - (t - back)) + (-grid.offset - back)


def rational_map(grid: Grid, x: np.ndarray) -> list[Fraction]:
    """Exact cell coordinates of one float32 point ``(n,)``."""
    return [
        Fraction(float(v)) * Fraction(float(s)) - Fraction(float(o))
        for v, s, o in zip(x, grid.cells_per_unit, grid.offset, strict=True)
    ]


def integers(values: list[Fraction]) -> tuple[list[int], int]:
    """Numerators over the least common denominator, and that."""
    denominator = lcm(*(v.denominator for v in values))
    return [v.numerator * (denominator // v.denominator) for v in values], denominator


def any_occupied(grid: Grid, lower: list[Fraction], upper: list[Fraction]) -> bool:
    """Whether a closed occupied cell meets the closed box between two points in cell coordinates."""
    half = Fraction(1, 2)
    cells = [slice(max(0, ceil(a - half)), max(0, floor(b + half) + 1)) for a, b in zip(lower, upper, strict=True)]
    return bool(grid.occupancy[tuple(cells)].any())


class ExactOracle:
    """The exact truth for queries of a kind: its kernel decides nearly all, ``Query.truth`` the others.

    Args:
        kind: Of the queries.
        grid: The object.
        device: Warp device; the default device if ``None``.
        length: Of rays, object units.
        kernel: See ``oracle_kernel``.
        arrays: What the kernel reads besides, by name; ``map`` is appended to what all kernels find there.

    Attributes:
        device: Where the kernel runs.
        undecided: How many queries of the last call went to the host.
    """

    def __init__(self, kind: "Query", grid: Grid, device: str | None, length: float, kernel: wp.Kernel, arrays: dict):
        self.kind, self.grid, self.device, self.undecided = kind, grid, wp.get_device(device), 0
        self.columns, self.length, self._kernel = kind.columns(grid.ndim), float(length), kernel
        own = [grid.cells_per_unit, grid.offset, np.array(grid.shape), arrays.get("map", np.zeros(0)).reshape(-1)]
        types = {"map": wp.float64, "numbers": wp.float64, "indices": wp.int32, "cells": wp.uint8}
        held = {**dict.fromkeys(types, np.zeros(1)), **arrays, "map": np.concatenate(own)}
        self._inputs = [wp.array(held[k].reshape(-1), dtype=t, device=self.device) for k, t in types.items()]

    def _answers(self, q: np.ndarray) -> np.ndarray:
        """``(N,)`` uint8: 0, 1, or 2 for undecided."""
        out = wp.empty(len(q), dtype=wp.uint8, device=self.device)
        flat = wp.array(q.reshape(-1), dtype=wp.float32, device=self.device, copy=not self.device.is_cpu)
        inputs = [flat, len(q), 0, *self._inputs, wp.float64(self.length)]
        launch_blocks(self._kernel, len(q), inputs, [out], self.device, first_index=2)
        return out.numpy()

    def __call__(self, q: np.ndarray) -> np.ndarray:
        """The truth ``(N,)`` bool for ``(N, m)`` float32 queries, object space; ``QueryError`` for another shape.

        Invalid queries (NaN, infinity, zero direction or normal, min > max) meet nothing here; bounders answer *maybe*
        to them.
        """
        with np.errstate(over="ignore"):
            q = np.ascontiguousarray(q, dtype=np.float32)
        if q.ndim != 2 or q.shape[1] != self.columns:
            raise QueryError(f"{self.kind.name} queries must have shape (N, {self.columns}), got {q.shape}")
        if len(q) == 0:
            return np.zeros(0, dtype=bool)
        answer = self._answers(q)
        undecided = np.flatnonzero(answer == 2)
        self.undecided = len(undecided)
        truth = answer == 1
        for index in undecided:
            cells = self.kind.near(self.grid, q[index])
            truth[index] = self.kind.truth(self.grid, q[index, None], self.length, cells)[0]
        return truth
