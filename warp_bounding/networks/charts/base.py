"""How a box of numbers z becomes inputs of a network: ``center + generators zeta + noise``, ``|zeta| <= 1``.

A proof searches over boxes of numbers that parametrise positive queries (a point; the point where a ray enters the
object, its parameter there and its direction; a box's corners). The network's inputs are a linear function of these
numbers plus a rest. A chart writes this down as C text over a type V (a box a SIMD lane on a CPU, a double on CUDA):

* ``expand``: from ``V low[Z], high[Z]`` to ``V center[K]``, ``V gen[P]`` (the generators that are not always zero), ``V
  noise[K]`` (all that is left over), ``V rest[K]`` (that without the quadratic terms that ``bend`` adds) and ``V dead``
  (1 where the box holds no positive); it may shrink the box;
* ``constraints``: linear functions ``q0 + q . zeta`` that are at most 0 at positives, where a box holds other queries
  too;
* ``realize``: from the signs of ``V slope[C]`` to ``V z[Z]``, a positive near the corner where f looks lowest, its
  inputs ``V h[K]`` and ``V valid`` (0 where there is none);
* ``owners``: ``V owner[C]``, the number of z that halving a column halves;
* ``blame``: what adds to ``V score[C]`` the loss by ``noise`` (``|gradient|`` times it) that smaller boxes avoid;
* ``bend``: what adds to ``V square[]`` the inputs' quadratic terms, times ``gradient``; of columns ``k <= m`` its index
  is ``entry(k, m)``;
* ``split``: what sets ``double middle`` of number ``axis`` between ``double a`` and ``double b``.

K, C and Z are constants: the inputs, the columns of generators and the numbers of z. ``absolute`` is a function of V.
``numbers.data`` holds float64 parameters, ``table.data`` int32 ones. Rounding in float64 is part of ``noise``.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

__all__ = ["Chart", "PlainChart"]


@dataclass(frozen=True)
class Chart:
    """What the kernels need to know of a chart; the C texts are explained above.

    Attributes:
        inputs: Inputs K of the network.
        noisy: Whether ``expand`` sets ``noise`` and ``rest``; else they are 0.
    """

    inputs: int

    noisy = True
    expand: ClassVar[str]
    realize: ClassVar[str]
    owners: ClassVar[str] = "for (int k = 0; k < C; ++k) owner[k] = zero + (double)k;"
    blame: ClassVar[str] = ""
    bend: ClassVar[str] = ""
    split: ClassVar[str] = "middle = (a + b) * 0.5;"

    @property
    def size(self) -> int:
        """Numbers Z of a point z."""
        return self.inputs

    @property
    def columns(self) -> int:
        """Number C of coordinates zeta, and so of columns of the generators."""
        return self.inputs

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """``(input, column)`` of the generators' entries that may differ from 0, in the order of ``gen``."""
        return [(k, k) for k in range(self.inputs)]

    def constraints(self) -> list[tuple[str, list[tuple[int, str]]]]:
        """``(q0, [(input, factor), ...])`` for each; the column of an input's generators enters with the factor."""
        return []

    def middle(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """The twin of ``split``: where intervals ``(N,)`` of a number are halved."""
        return (a + b) * 0.5

    def coordinates(self, z: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        """Coordinates ``v`` of a query ``(N, K)`` for points ``(N, Z)`` of a chart with these ``numbers``, float64."""
        raise NotImplementedError

    def hull(self, lower: np.ndarray, upper: np.ndarray, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Corners ``(N, K)`` between which the inputs of all queries of boxes ``(N, Z)`` lie, computed ones too."""
        raise NotImplementedError


@dataclass(frozen=True)
class PlainChart(Chart):
    """The chart of points, whose numbers are the inputs themselves."""

    noisy = False
    expand = "for (int k = 0; k < K; ++k) { center[k] = (low[k] + high[k]) * 0.5; gen[k] = (high[k] - low[k]) * 0.5; }"
    realize = "for (int k = 0; k < K; ++k) h[k] = z[k] = slope[k] > zero ? low[k] : high[k];"

    def coordinates(self, z: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        return z
