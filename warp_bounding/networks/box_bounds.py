"""What is known about a function over boxes: what every bounder's ``bound`` gives, and networks a little more."""

from typing import NamedTuple

import numpy as np

__all__ = ["BoxBounds"]


class BoxBounds(NamedTuple):
    """Bounds of ``f`` over N boxes of m numbers: a query's coordinates, or the numbers of a network's chart.

    Attributes:
        lower: ``(N,)`` float64, certified lower bounds; infinity where a box of a chart holds no positive.
        axis: ``(N,)`` int, the axis along which halving the box helps the bound most.
        point: ``(N, m)`` float64, a point of the box where ``f`` is likely to be least; of a chart, a positive.
        value: ``(N,)`` float64, ``f`` there; infinity where a box of a chart holds no positive.
        next_axis: ``(N,)`` int, the axis to halve after ``axis``; this and the attributes below may be ``None``.
        slope: ``(N, K)``, networks only: slopes of a linear bound in the network's inputs. It is one of this very ``f``: whoever makes
            the bounds of another function of these makes them without what follows.
        level: ``(N,)``, networks only: where the chart's numbers are the inputs themselves, ``f >= level + slope .
            (v - center)`` on the box.
        boxes: ``(N, 2, m)``, networks only: corners of the boxes without what the chart cut off, which holds no
            positive.
    """

    lower: np.ndarray
    axis: np.ndarray
    point: np.ndarray
    value: np.ndarray
    next_axis: np.ndarray | None = None
    slope: np.ndarray | None = None
    level: np.ndarray | None = None
    boxes: np.ndarray | None = None

    def part(self, rows: np.ndarray) -> "BoxBounds":
        """The same of some of the boxes."""
        return BoxBounds(*(each if each is None else each[rows] for each in self))
