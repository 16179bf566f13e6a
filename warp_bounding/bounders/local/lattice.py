"""The domain of a bounder, cut at edges into a lattice of parts."""

from collections.abc import Callable
from math import prod

import numpy as np

from warp_bounding.errors import BounderError
from warp_bounding.kernels.lattice import PER_WORD

__all__ = ["NEAREST_TO_ZERO", "Lattice", "packed", "unpacked"]

# Edges keep this far from 0, so that a device that takes tiny v for 0 finds the same part.
NEAREST_TO_ZERO = 2.0**-64


class Lattice:
    """The domain cut at edges.

    Args:
        edges: For each axis of v, its inner edges in ascending order, float32.
    """

    def __init__(self, edges: list[np.ndarray]):
        self.edges = [np.array(axis, dtype=np.float32) for axis in edges]
        for axis in self.edges:
            axis[np.abs(axis) < NEAREST_TO_ZERO] = NEAREST_TO_ZERO
        self.shape = tuple(len(axis) + 1 for axis in self.edges)

    @classmethod
    def of(cls, lower: np.ndarray, upper: np.ndarray, shape: tuple[int, ...]) -> "Lattice":
        """Parts of equal size between two corners ``(n,)``; the outer ones go on to the end of the domain."""
        ends = zip(lower, upper, shape, strict=True)
        return cls([np.linspace(low, high, count + 1)[1:-1].astype(np.float32) for low, high, count in ends])

    def moved(self, to: Callable[[np.ndarray], np.ndarray]) -> "Lattice":
        """The same parts in other coordinates, which each axis has of its own: ``to`` takes ``(N, n)`` and gives ``(N, n)``."""
        moved = []
        for k, axis in enumerate(self.edges):
            at = np.zeros((len(axis), len(self.edges)))
            at[:, k] = axis
            moved.append(to(at)[:, k].astype(np.float32))
        return Lattice(moved)

    @property
    def count(self) -> int:
        """Number of parts."""
        return prod(self.shape)

    def place(self, v: np.ndarray) -> np.ndarray:
        """``(N,)`` int64: index of the part that holds each v ``(N, n)``."""
        along = [np.searchsorted(axis, v[:, k], side="right") for k, axis in enumerate(self.edges)]
        return np.ravel_multi_index(along, self.shape) if along else np.zeros(len(v), np.int64)

    def cut(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Boxes ``(N, n)`` cut at the edges, so that each piece lies in the closure of one part, with its lower corner in it.

        A box that ends on an edge has a piece without width beyond it.

        Returns:
            Corners of the pieces, ``(K, n)`` float64 each, and which box each one is a piece of.
        """
        owner = np.arange(len(lower))
        for k, axis in enumerate(self.edges):
            first = np.searchsorted(axis, lower[:, k], side="right")
            last = np.searchsorted(axis, upper[:, k], side="right")
            times = last - first + 1
            row = np.repeat(np.arange(len(lower)), times)
            step = np.arange(len(row)) - np.repeat(np.cumsum(times) - times, times)
            ends = np.concatenate([[-np.inf], axis.astype(np.float64), [np.inf]])
            lower, upper, owner = lower[row], upper[row], owner[row]
            lower[:, k] = np.maximum(lower[:, k], ends[first[row] + step])
            upper[:, k] = np.minimum(upper[:, k], ends[first[row] + step + 1])
        return lower, upper, owner

    def ranges(self, lower: np.ndarray, upper: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each axis the first and the last part that the box's inside meets, of pieces the one that they lie in."""
        pairs = []
        for k, axis in enumerate(self.edges):
            first = np.searchsorted(axis, lower[:, k], side="right")
            pairs.append((first, np.maximum(first, np.searchsorted(axis, upper[:, k], side="left"))))
        return pairs

    def extremes(
        self, values: np.ndarray, lower: np.ndarray, upper: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Least and largest ``values`` ``(parts,)`` of parts that boxes ``(N, n)`` meet, and which boxes meet one only."""
        ranges, every = self.ranges(lower, upper), values.reshape(self.shape)
        single = np.all([first == last for first, last in ranges], axis=0)
        least = every[tuple(first for first, _ in ranges)]
        most = least.copy()
        for row in np.flatnonzero(~single):
            inside = every[tuple(slice(first[row], last[row] + 1) for first, last in ranges)]
            least[row], most[row] = inside.min(), inside.max()
        return least, most, single

    @classmethod
    def stored(cls, edges: np.ndarray, shape: tuple[int, ...], method: str) -> "Lattice":
        """The lattice of a file: the edges of each axis in turn.

        Raises:
            BounderError: If they do not ascend, or one of them is too near to 0.
        """
        lattice = cls(np.split(edges, np.cumsum([count - 1 for count in shape])[:-1]))
        if not (all((np.diff(axis) > 0).all() for axis in lattice.edges) and (np.abs(edges) >= NEAREST_TO_ZERO).all()):
            raise BounderError(f"{method}: edges must ascend, none of them 0")
        return lattice


def packed(levels: np.ndarray) -> np.ndarray:
    """``(ceil(parts / 4),)`` uint32, words of levels ``(parts,)`` uint8."""
    return np.pad(levels, (0, -len(levels) % PER_WORD)).view("<u4").astype(np.uint32)


def unpacked(words: np.ndarray, count: int) -> np.ndarray:
    """``(count,)`` uint8, the levels in words."""
    return words.astype("<u4").view(np.uint8)[:count]
