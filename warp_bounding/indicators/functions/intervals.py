"""Interval arithmetic in float64, rounded outwards: what a formula can be over whole boxes, as certified bounds.

IEEE 754 rounds sums, products, quotients and square roots correctly, so the exact result lies strictly between the
neighbours of the computed one, and each operation here gives these neighbours. A sum that is computed as 0 is exactly
0, because float64 keeps subnormal numbers, so the sign of a difference is always known: a point on the face of a box
is known to be on it.
"""

from collections.abc import Iterable
from functools import reduce

import numpy as np

__all__ = ["Interval", "columns", "lower_of", "norm", "upper_of", "widened"]


def lower_of(value: np.ndarray) -> np.ndarray:
    """The float64 below each number: a lower bound of what was rounded to it."""
    return np.nextafter(value, -np.inf)


def upper_of(value: np.ndarray) -> np.ndarray:
    """The float64 above each number: an upper bound of what was rounded to it."""
    return np.nextafter(value, np.inf)


def widened(corner: np.ndarray, step: np.ndarray, sign: int) -> np.ndarray:
    """``corner + sign * step``, exactly where float64 holds it, else the neighbour on the far side."""
    step = sign * step
    with np.errstate(over="ignore", invalid="ignore"):
        moved = corner + step
        back = moved - corner
        lost = (corner - (moved - back)) + (step - back)  # what rounding took off, exactly (Knuth's two-sum)
        return np.where(lost == 0, moved, np.nextafter(moved, sign * np.inf))


class Interval:
    """Closed intervals ``[low, high]``, one for each of N boxes; numbers among the operands are exact.

    Overflow makes a bound infinite or the largest number, which is sound; a NaN bounds nothing, and every comparison
    with it is false. The caller silences the warnings of NumPy (``np.errstate``).

    Args:
        low: ``(N,)`` float64.
        high: ``(N,)`` float64; as ``low`` where it is left out.
    """

    __slots__ = ("high", "low")

    def __init__(self, low, high=None):
        self.low = np.asarray(low, dtype=np.float64)
        self.high = self.low if high is None else np.asarray(high, dtype=np.float64)

    def __neg__(self) -> "Interval":
        return Interval(-self.high, -self.low)

    def __add__(self, other) -> "Interval":
        other = _interval(other)
        low, high = self.low + other.low, self.high + other.high
        return Interval(np.where(low == 0, low, lower_of(low)), np.where(high == 0, high, upper_of(high)))

    def __sub__(self, other) -> "Interval":
        return self + -_interval(other)

    def __rsub__(self, other) -> "Interval":
        return -self + other

    def __mul__(self, other) -> "Interval":
        other = _interval(other)
        products = [_product(a, b) for a in self._ends() for b in other._ends()]
        return Interval(reduce(np.minimum, (p[0] for p in products)), reduce(np.maximum, (p[1] for p in products)))

    def _ends(self) -> tuple[np.ndarray, ...]:
        return (self.low,) if self.low is self.high else (self.low, self.high)

    def __truediv__(self, other) -> "Interval":
        """By an interval of positive numbers."""
        other = _interval(other)
        low = self.low / np.where(self.low > 0, other.high, other.low)
        high = self.high / np.where(self.high > 0, other.low, other.high)
        return Interval(np.where(self.low == 0, 0.0, lower_of(low)), np.where(self.high == 0, 0.0, upper_of(high)))

    def magnitude(self) -> "Interval":
        """The absolute value."""
        least = np.maximum(np.maximum(self.low, -self.high), 0.0)
        return Interval(least, np.maximum(-self.low, self.high))

    def square(self) -> "Interval":
        """The square."""
        size = self.magnitude()
        low, high = size.low * size.low, size.high * size.high
        return Interval(np.maximum(lower_of(low), 0.0), np.where(size.high == 0, 0.0, upper_of(high)))

    def root(self) -> "Interval":
        """The square root of what is at least 0."""
        low, high = np.sqrt(np.maximum(self.low, 0.0)), np.sqrt(np.maximum(self.high, 0.0))
        return Interval(np.maximum(lower_of(low), 0.0), np.where(high == 0, 0.0, upper_of(high)))

    def maximum(self, other) -> "Interval":
        """The larger one of two."""
        other = _interval(other)
        return Interval(np.maximum(self.low, other.low), np.maximum(self.high, other.high))

    def minimum(self, other) -> "Interval":
        """The smaller one of two."""
        other = _interval(other)
        return Interval(np.minimum(self.low, other.low), np.minimum(self.high, other.high))

    def both(self, other: "Interval") -> "Interval":
        """What lies in both of two enclosures of the same numbers."""
        return Interval(np.maximum(self.low, other.low), np.minimum(self.high, other.high))


def _interval(value) -> Interval:
    return value if isinstance(value, Interval) else Interval(value)


def _product(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of products, which are exactly 0 where a factor is."""
    product, nothing = a * b, (a == 0) | (b == 0)
    return np.where(nothing, 0.0, lower_of(product)), np.where(nothing, 0.0, upper_of(product))


def norm(parts: Iterable[Interval]) -> Interval:
    """The Euclidean length of a vector, whose coordinates vary independently of each other."""
    first, *others = parts
    if not others:
        return first.magnitude()
    total = first.square()
    for part in others:
        total = total + part.square()
    return total.root()


def columns(lower: np.ndarray, upper: np.ndarray) -> list[Interval]:
    """The coordinates of ``(N, n)`` boxes."""
    return [Interval(lower[:, k], upper[:, k]) for k in range(lower.shape[1])]
