"""The unit sphere in n dimensions as patches: cells of the faces of a cube, seen from its centre.

A unit vector of a patch is ``f y``, where y is a mean of the patch's unit vertices ``u_i`` and ``1 <= f <= outer``; so
a convex function is largest, over the patch, at some ``u_i`` or ``outer u_i``.
"""

from dataclasses import dataclass

import numpy as np

__all__ = ["DirectionPatches"]

NARROWEST = 1e-6  # edge length, on a cube of edge 2, under which patches are not split
SHRUNK = 1 - 1e-12  # factor that covers the float64 rounding of cosines


@dataclass(frozen=True)
class DirectionPatches:
    """N patches."""

    axis: np.ndarray  # (N,) int, the axis on which the face of the cube lies
    sign: np.ndarray  # (N,) 1.0 or -1.0, its side
    lower: np.ndarray  # (N, n - 1), the lower corner of the cell on it
    upper: np.ndarray  # (N, n - 1), its upper corner

    @classmethod
    def cover(cls, ndim: int, edge: int) -> "DirectionPatches":
        """The whole sphere, ``edge`` patches along each edge of a face."""
        cells = np.array(list(np.ndindex((edge,) * (ndim - 1))), dtype=np.float64).reshape(edge ** (ndim - 1), ndim - 1)
        lower, upper = -1 + 2 * cells / edge, -1 + 2 * (cells + 1) / edge
        faces = [(axis, sign) for axis in range(ndim) for sign in (1.0, -1.0)]
        axis, sign = (np.repeat(column, len(cells)) for column in zip(*faces, strict=True))
        return cls(axis, sign, np.tile(lower, (len(faces), 1)), np.tile(upper, (len(faces), 1)))

    def __len__(self) -> int:
        return len(self.axis)

    @property
    def ndim(self) -> int:
        """Dimension n."""
        return self.lower.shape[1] + 1

    @property
    def finest(self) -> bool:
        """Whether no patch is worth splitting."""
        return self.ndim == 1 or float((self.upper - self.lower).max(initial=0.0)) < NARROWEST

    def _on_sphere(self, cell: np.ndarray) -> np.ndarray:
        others = np.array([[k for k in range(self.ndim) if k != axis] for axis in range(self.ndim)], dtype=np.int64)
        full = np.empty((len(self), self.ndim))
        row = np.arange(len(self))
        full[row, self.axis] = self.sign
        full[row[:, None], others[self.axis].reshape(len(self), -1)] = cell
        return full / np.linalg.norm(full, axis=1, keepdims=True)

    @property
    def centers(self) -> np.ndarray:
        """``(N, n)`` unit vectors."""
        return self._on_sphere((self.lower + self.upper) / 2)

    def _corners(self) -> np.ndarray:
        """``(N, 2^(n-1), n)`` unit vectors."""
        choices = np.ndindex((2,) * (self.ndim - 1))
        return np.stack([self._on_sphere(np.where(c, self.upper, self.lower)) for c in choices], axis=1)

    @property
    def outer(self) -> np.ndarray:
        """``(N,)``, the largest factor f of each patch; see the module."""
        nearest = np.einsum("nvk,nk->nv", self._corners(), self.centers).min(axis=1)
        return 1 / (nearest * SHRUNK)

    def vertices(self, slack: float) -> np.ndarray:
        """``(N, 2^n, n)``: ``u_i (1 - slack)`` and ``outer u_i (1 + slack)`` in turn.

        Their hull holds all vectors in the directions of the patch whose length is within ``slack`` of 1.
        """
        u, outer = self._corners(), self.outer[:, None, None]
        return np.stack([u * (1 - slack), u * outer * (1 + slack)], axis=2).reshape(len(self), -1, self.ndim)

    def take(self, which: np.ndarray) -> "DirectionPatches":
        """The patches at these indices, or where a mask is true."""
        return DirectionPatches(self.axis[which], self.sign[which], self.lower[which], self.upper[which])

    def joined(self, other: "DirectionPatches") -> "DirectionPatches":
        """These patches, then those of another set."""
        names = ("axis", "sign", "lower", "upper")
        return DirectionPatches(*(np.concatenate([getattr(self, k), getattr(other, k)]) for k in names))

    def split(self) -> "DirectionPatches":
        """Each patch in ``2^(n-1)`` parts."""
        middle, choices = (self.lower + self.upper) / 2, list(np.ndindex((2,) * (self.ndim - 1)))
        lower = np.concatenate([np.where(choice, middle, self.lower) for choice in choices])
        upper = np.concatenate([np.where(choice, self.upper, middle) for choice in choices])
        return DirectionPatches(np.tile(self.axis, len(choices)), np.tile(self.sign, len(choices)), lower, upper)
