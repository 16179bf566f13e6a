"""What a kind of query is: one object that knows all that this floor says of it.

A kind is written in a file of its own and put into ``queries.QUERIES`` under its name; everybody else finds it there,
and higher floors keep what they know of it under the same name. Nobody compares the name itself.
"""

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.queries.exact import ExactOracle

__all__ = ["Query"]

# of ``distribution``, before the words of the kind
UNIFORM = "half uniform queries that meet the object (or as many as an equal number of draws gives, where they are rare), half "


class Query(ABC):
    """A kind of query.

    Attributes:
        name: What users call it.
        is_region: It is a set of many points of space, given by 2n numbers: a bounder may test the set against a
            volume, or (in parametric space) its numbers as one point. A point query is not.
        has_length: Its queries share a length, which is an option: rays.
        every: In words, all queries of the kind; ``{length}`` stands for the length.
        hard_positives: In words, the half of ``draw_positives`` that is drawn to be missed.
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
        """Random queries ``(count, m)`` float32 in object space, drawn as the paper draws them."""

    @abstractmethod
    def oracle(self, grid: IndicatorGrid, device: str | None = None, length: float = 1.0) -> ExactOracle:
        """The exact truth as a Warp kernel: called with ``(N, m)`` float32 it answers ``(N,)`` bool."""

    @abstractmethod
    def truth(self, grid: IndicatorGrid, q: np.ndarray, length: float = 1.0) -> np.ndarray:
        """The truth in rational arithmetic, ``(N,)`` bool, one query after another: slow, and as simple as possible."""

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

    @abstractmethod
    def nudged(self, grid: IndicatorGrid, x: np.ndarray, move: np.ndarray) -> np.ndarray:
        """Queries ``(N, m)`` float64 near ``x``: points move in the domain by shares ``move`` of it, directions turn."""

    def hulls(self, grid: IndicatorGrid) -> list[np.ndarray]:
        """Of each component ``(V, 2 n)`` hull corners and a cell at each, for ``hard_draw``; zeros where it needs none."""
        return [np.zeros((1, 2 * grid.ndim))]
