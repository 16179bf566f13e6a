"""What a kind of query is: one object that knows all that this floor says of it.

A kind is written in a file of its own and put into ``queries.QUERIES`` under its name; everybody else finds it there, and
higher floors keep what they know of it under the same name. Nobody compares the name itself.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np

from warp_bounding.indicators.grid import IndicatorGrid

__all__ = ["Query"]


class Query(ABC):
    """A kind of query.

    Attributes:
        name: What users call it.
        is_region: It is a set of many points of space, given by 2n numbers: a bounder may test the set against a volume, or
            (in parametric space) its numbers as one point. A point query is not.
        has_length: Its queries share a length, which is an option: rays.
    """

    name: str
    is_region: bool = True
    has_length: bool = False

    def columns(self, ndim: int) -> int:
        """Numbers of one query about an object of dimension ``ndim``."""
        return 2 * ndim if self.is_region else ndim

    def valid(self, q: np.ndarray) -> np.ndarray:
        """Which queries mean something: ``(N,)`` bool for ``(N, m)`` numbers. Oracles call the others False, bounders answer *maybe*."""
        return np.isfinite(q).all(axis=1)

    @abstractmethod
    def sample(self, grid: IndicatorGrid, count: int, rng: np.random.Generator) -> np.ndarray:
        """Random queries ``(count, m)`` float32 in object space, drawn as the paper draws them."""

    @abstractmethod
    def oracle(
        self, grid: IndicatorGrid, device: str | None = None, length: float = 1.0
    ) -> Callable[[np.ndarray], np.ndarray]:
        """The exact truth as a Warp kernel: called with ``(N, m)`` float32 it answers ``(N,)`` bool."""

    @abstractmethod
    def truth(self, grid: IndicatorGrid, q: np.ndarray, length: float = 1.0) -> np.ndarray:
        """The truth in rational arithmetic, ``(N,)`` bool, one query after another: slow, and plainly right."""
