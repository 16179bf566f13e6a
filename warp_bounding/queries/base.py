"""What a kind of query is: one object that knows all that this floor says of it.

A kind is written in a file of its own and put into ``queries.QUERIES`` under its name; everybody else finds it there,
and higher floors keep what they know of it under the same name. Nobody compares the name itself.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar

import numpy as np
import warp as wp

from warp_bounding.errors import QueryError
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.shape import IN, OUT, Shape
from warp_bounding.queries.exact import oracle_kernel
from warp_bounding.runtime.launch import launch_blocks

__all__ = ["ExactOracle", "Query"]

# of ``distribution``, before the words of the kind
UNIFORM = "half uniform queries that meet the object (or as many as an equal number of draws gives, where they are rare), half "


class Query(ABC):
    """A kind of query.

    Attributes:
        name: What users call it.
        is_region: It is a set of many points of space, given by 2n numbers: a bounder tests the set, not its numbers as one
            point. A point query is not.
        has_length: Its queries share a length, which is an option: rays.
        every: In words, all queries of the kind; ``{length}`` stands for the length.
        hard_positives: In words, the half of ``draw_positives`` that is drawn to be missed.
        oracle_body: C text of the exact truth (``exact.loop_snippet``).
        sampled_point: C text that sets ``y[N]`` to a random point of the region ``q`` (``sampled``), by its paper's
            recipe.
        hard_draw: C text of a hard positive (``hard``): from a point ``p`` of the object to a query's numbers ``a[N]``
            and ``b[N]``.
        hard_to_world: C text from these to the numbers ``q`` of the query in the world.
        hard_certain: C text that clears ``sure`` unless the rounded query ``x`` meets the cell for certain. It is given
            ``cell``, ``at``, ``vector``, ``normal`` and their errors, ``rho``, ``slack`` and ``inset`` (``hard``).
        hard_certain_placed: The same for a query in the world, where it is another text.
    """

    name: str
    is_region: bool = True
    has_length: bool = False
    every: str
    hard_positives: str
    oracle_body: ClassVar[str]
    sampled_point: ClassVar[str] = ""
    hard_draw: ClassVar[str]
    hard_to_world: ClassVar[str]
    hard_certain: ClassVar[str]
    hard_certain_placed: ClassVar[str] = ""

    @property
    def positive(self) -> str:
        """In words and without an article, a query that meets the object."""
        return f"{self.name} that meets the object"

    @property
    def distribution(self) -> str:
        """In words, what ``draw_positives`` draws."""
        return UNIFORM + self.hard_positives

    def columns(self, ndim: int) -> int:
        """Numbers of one query about an object of dimension ``ndim``."""
        return 2 * ndim if self.is_region else ndim

    def valid(self, q: np.ndarray) -> np.ndarray:
        """``(N,)`` bool, which queries ``(N, m)`` mean something. Oracles call the others False, bounders *maybe*."""
        return np.isfinite(q).all(axis=1)

    @abstractmethod
    def sample(self, grid: IndicatorGrid, count: int, rng: np.random.Generator) -> np.ndarray:
        """Random queries ``(count, m)`` float32 in object space, drawn as the paper draws them.

        The paper's coordinates 0 and 1 are the centres of the grid's first and last cells.
        """

    @abstractmethod
    def truth(
        self, grid: IndicatorGrid, q: np.ndarray, length: float = 1.0, cells: np.ndarray | None = None
    ) -> np.ndarray:
        """The truth in rational arithmetic, one query after another: slow, and as simple as possible.

        Args:
            grid: The object.
            q: ``(N, m)`` float32, object space.
            length: Of rays, object units.
            cells: ``(M, n)`` cells that may be looked at; all occupied cells if ``None``.

        Returns:
            ``(N,)`` bool.
        """

    def certain(self, shape: Shape, q: np.ndarray, length: float = 1.0) -> np.ndarray:
        """``(N,)`` bool: which queries meet the object beyond doubt; of a grid ``truth``, against every cell."""
        return self.truth(shape, q, length) if isinstance(shape, IndicatorGrid) else self.decide(shape, q, length) == IN

    def near(self, grid: IndicatorGrid, q: np.ndarray) -> np.ndarray:
        """``(M, n)``, the occupied cells that one query ``(m,)`` meets or nearly meets, by the kernel's error bound."""
        return grid.occupied

    @abstractmethod
    def arrays(self, grid: IndicatorGrid) -> dict[str, np.ndarray]:
        """What ``oracle_body`` reads of an object, by the names of ``exact.oracle_kernel``."""

    def kernel(self, ndim: int) -> wp.Kernel:
        """The kernel of the exact truth."""
        return oracle_kernel(f"wb_{self.name}_oracle_{ndim}d", ndim, self.columns(ndim), self.oracle_body)

    def oracle(self, grid: Shape, device: str | None = None, length: float = 1.0) -> Callable[[np.ndarray], np.ndarray]:
        """The exact truth for many queries: of a grid a Warp kernel, with ``truth`` as its plain twin, else ``decide``.

        What a shape without cells cannot decide counts as meeting the object.

        Args:
            grid: The object.
            device: Warp device; the default device if ``None``.
            length: Of rays, object units, finite and not negative.

        Raises:
            QueryError: For another length.
        """
        if self.has_length and not 0 <= length < np.inf:
            raise QueryError(f"length must be finite and non-negative, got {length}")
        if not isinstance(grid, IndicatorGrid):
            return lambda q: self.decide(grid, q, length) != OUT
        return ExactOracle(self, grid, device, length, self.kernel(grid.ndim), self.arrays(grid))

    @abstractmethod
    def barely(
        self, grid: IndicatorGrid, p: np.ndarray, rng: np.random.Generator, length: float, outside: bool
    ) -> np.ndarray:
        """Queries that barely pass points of the object: what ``hard_draw`` does, in NumPy, with other random numbers.

        Args:
            grid: The object.
            p: ``(N, n)`` float64, object space.
            rng: Source of randomness.
            length: Of a ray.
            outside: Queries that are given by points outside the domain are among them.

        Returns:
            ``(N, m)`` float64; rounding may move some off the object.
        """

    def decides(self, shape: Shape) -> bool:
        """Whether a shape without cells can tell the truth for queries of this kind."""
        return False

    def decide(self, shape: Shape, q: np.ndarray, length: float = 1.0) -> np.ndarray:
        """``(N,)`` uint8, the truth of such a shape for float32 queries ``(N, m)``: ``OUT``, ``IN`` or ``UNDECIDED``."""
        raise QueryError(f"{shape.name}: cannot tell the truth for {self.name} queries; give a resolution")

    @abstractmethod
    def nudged(self, grid: IndicatorGrid, x: np.ndarray, move: np.ndarray) -> np.ndarray:
        """Queries ``(N, m)`` float64 near ``x``: points move in the domain by shares ``move`` of it, directions turn."""

    def hulls(self, grid: IndicatorGrid) -> list[np.ndarray]:
        """Of each component ``(V, 2 n)`` hull corners and a cell at each, for ``hard_draw``; zeros where it needs none."""
        return [np.zeros((1, 2 * grid.ndim))]


class ExactOracle:
    """The exact truth for queries of a kind: its kernel decides nearly all, ``Query.truth`` the others.

    Args:
        kind: Of the queries.
        grid: The object.
        device: Warp device; the default device if ``None``.
        length: Of rays, object units.
        kernel: See ``exact.oracle_kernel``.
        arrays: What the kernel reads besides, by name; ``map`` is appended to what all kernels find there.

    Attributes:
        device: Where the kernel runs.
        undecided: How many queries of the last call went to the host.
    """

    def __init__(
        self, kind: Query, grid: IndicatorGrid, device: str | None, length: float, kernel: wp.Kernel, arrays: dict
    ):
        self.kind, self.grid, self.device, self.undecided = kind, grid, wp.get_device(device), 0
        self.columns, self.length, self._kernel = kind.columns(grid.ndim), float(length), kernel
        own = [grid.cells_per_unit, grid.offset, np.array(grid.shape), arrays.get("map", np.zeros(0)).reshape(-1)]
        types = {"map": wp.float64, "numbers": wp.float64, "indices": wp.int32, "cells": wp.uint8}
        held = {**dict.fromkeys(types, np.zeros(1)), **arrays, "map": np.concatenate(own)}
        self._inputs = [wp.array(held[k].reshape(-1), dtype=t, device=self.device) for k, t in types.items()]

    def _answers(self, q: np.ndarray, seed: int = 0, given: np.ndarray | None = None) -> np.ndarray:
        """``(N,)`` uint8: 0, 1, or 2 for undecided.

        Args:
            q: ``(N, m)`` float32.
            seed: That the kernel sees.
            given: ``(N,)`` uint8 that it finds in ``out``.
        """
        out = wp.empty(len(q), dtype=wp.uint8, device=self.device)
        if given is not None:
            out = wp.array(given, dtype=wp.uint8, device=self.device)
        flat = wp.array(q.reshape(-1), dtype=wp.float32, device=self.device, copy=not self.device.is_cpu)
        inputs = [flat, len(q), 0, *self._inputs, wp.float64(self.length), wp.uint32(seed % 2**32)]
        launch_blocks(self._kernel, len(q), inputs, [out], self.device, first_index=2)
        return out.numpy()

    def __call__(self, q: np.ndarray) -> np.ndarray:
        """The truth for queries.

        Args:
            q: ``(N, m)`` float32, object space. Invalid queries (NaN, infinity, zero direction or normal, min > max)
                meet nothing here; bounders answer *maybe* to them.

        Returns:
            ``(N,)`` bool.

        Raises:
            QueryError: For another shape.
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
