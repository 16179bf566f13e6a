"""What a kind of query gives to training: uniform samples with their truth, and positives that can be moved.

A positive is a column of *state* numbers, such as a cell and an offset in [-1/2, 1/2]^n inside it for a point, from
which its coordinates ``v`` follow by a formula. Every state in the allowed range is a positive, so a positive can walk
down a network's output without ever leaving the object. Labels are those of the exact oracles; no sample is ever taken
for a proof.
"""

import numpy as np
import torch

__all__ = ["Samples", "columns"]


class Samples:
    """Random samples of one kind of query, as columns; made of the object, a domain and a source of randomness.

    Attributes:
        query: Kind of query.
        ndim: Length of ``v``.
        generator: Source of everything random.
        detail: ``(ndim, 1)``, the object's cells along each axis of ``v``, relative to the axis with most.
        vertices: ``(ndim, K)``, all of the positives where a minimum of f is likely, such as corners; may be none.
    """

    query = ""
    ndim: int
    generator: torch.Generator
    detail: torch.Tensor
    vertices: torch.Tensor

    def uniform(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """``v`` ``(ndim, count)`` of samples of the protocol, and their truth ``(count,)``."""
        raise NotImplementedError

    def negatives(self, count: int) -> torch.Tensor:
        """``v`` of the negatives among ``count`` samples of the protocol, or of a few other queries where none is."""
        raise NotImplementedError

    def positives(self, count: int) -> torch.Tensor:
        """States ``(S, count)``, most where a network is likely to fail."""
        raise NotImplementedError

    def coordinates(self, state: torch.Tensor) -> torch.Tensor:
        """``v`` ``(ndim, N)`` of states."""
        raise NotImplementedError

    def move(self, state: torch.Tensor, slope: torch.Tensor, step: float | torch.Tensor) -> torch.Tensor:
        """States after one step downhill; they stay positives, and queries that a bounder is asked about.

        Args:
            state: ``(S, N)``.
            slope: ``(ndim, N)``, gradient in ``v``; may be overwritten.
            step: Length, about in cells, one number or ``(N,)``.
        """
        raise NotImplementedError

    def locate(self, v: np.ndarray) -> torch.Tensor:
        """States of positives ``(N, ndim)`` float64 found elsewhere, but for those that rounding moved off the object."""
        raise NotImplementedError(f"{self.query}: counterexamples come as states")

    def at(self, z: np.ndarray) -> torch.Tensor:
        """States of positives given as numbers ``(N, Z)`` of a proof's chart; some may be dropped."""
        raise NotImplementedError(f"{self.query}: there is no chart")


def columns(rows: np.ndarray) -> torch.Tensor:
    """``(N, n)`` numbers as ``(n, N)`` float32."""
    return torch.from_numpy(np.ascontiguousarray(rows.T, dtype=np.float32))
