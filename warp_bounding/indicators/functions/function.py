"""A function as a shape: the truth about points, and what its author knows about boxes.

What certifies boxes is either the author's own ``empty``, such as interval arithmetic, or a distance with a Lipschitz
constant L: over a box with centre c no point is farther from c than the half-diagonal r, so the distance stays above 0
where ``distance(c) > L r``. A shape cannot look into a function; ``refute`` looks for points that contradict what its
author says.
"""

import hashlib
from collections.abc import Callable
from copy import copy
from functools import cached_property

import numpy as np

from warp_bounding.errors import IndicatorError
from warp_bounding.indicators.functions.answers import Answers
from warp_bounding.indicators.functions.combination import Combinable
from warp_bounding.indicators.functions.intervals import Interval, columns, norm, widened
from warp_bounding.indicators.functions.parameters import checked_corners, checked_number
from warp_bounding.indicators.functions.refute import Counterexample, Distance, refute
from warp_bounding.indicators.functions.solid import Formula
from warp_bounding.indicators.shape import IN, OUT

__all__ = ["ALLOWANCE", "IndicatorFunction"]

# By how much the distance that a function computes may be off, in units of L times the largest absolute coordinate of
# the point and of the object's box; twice as much is taken off. That is 512 roundings, more than short formulas make.
ALLOWANCE = 2.0**-44
TRIES = 64  # points that are asked twice when a shape is made
LATTICE = 4096  # points, about, whose answers enter the digest


class IndicatorFunction(Combinable, Formula):
    """A function of any number of coordinates as a shape; all functions take and return arrays of NumPy.

    The object is where ``contains`` is True; without ``contains``, where ``distance`` is at most 0. The functions are
    asked about any finite points, also outside of the box that holds the object, and get copies of arrays.

    Args:
        contains: Of ``(N, n)`` float64 points, object space: ``(N,)`` bool. ``None`` if ``distance`` is given.
        lower: ``(n,)``, lower corner of a box that holds the object.
        upper: ``(n,)``, upper corner, above the lower one in each coordinate.
        empty: Of ``(N, n)`` lower and ``(N, n)`` upper corners: ``(N,)`` bool, True only where the closed box holds no
            point of the object.
        lipschitz: A number L with ``|distance(x) - distance(y)| <= L |x - y|`` everywhere; 1 if it is left out.
        distance: Of ``(N, n)`` points: ``(N,)`` float64, 0 or less in the object. Its values may be off by
            ``ALLOWANCE`` times L times the largest absolute coordinate of the point and of the corners, for what
            float64 rounds.
        name: For people.
        note: A restriction that a user should know.
        time: Whether coordinate 0 is time. A distance is then one in space and time together.

    Attributes:
        certified: Whether boxes can be certified: there is ``empty`` or ``distance``.
        lipschitz: L, or ``None`` without a distance.

    Raises:
        IndicatorError: For corners that are none, or functions whose answers cannot be relied on.

    Example:
        >>> def star(x):
        ...     angle = np.arctan2(x[:, 1], x[:, 0])
        ...     return np.hypot(x[:, 0], x[:, 1]) <= 0.7 + 0.2 * np.sin(5 * angle)
        >>> wb.IndicatorFunction(star, [-1, -1], [1, 1]).certified
        False
        >>> def distance(x):
        ...     return np.linalg.norm(x, axis=1) - 1.0
        >>> ball5 = wb.IndicatorFunction(None, np.full(5, -1.0), np.full(5, 1.0), distance=distance)
        >>> ball5.empty(np.full((1, 5), 0.5), np.full((1, 5), 0.6))
        array([ True])
    """

    def __init__(
        self,
        contains: Callable[[np.ndarray], np.ndarray] | None,
        lower,
        upper,
        *,
        empty: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
        lipschitz: float | None = None,
        distance: Callable[[np.ndarray], np.ndarray] | None = None,
        name: str = "function",
        note: str = "",
        time: bool = False,
    ):
        self.name, self.note, self.time = name, note, bool(time)
        self._bounds = np.array(checked_corners(lower, upper, name))
        if contains is None and distance is None:
            raise IndicatorError(
                f"{name}: expected contains, or a distance that is 0 or less in the object, got neither"
            )
        if distance is None and lipschitz is not None:
            raise IndicatorError(f"{name}: lipschitz is that of a distance, got lipschitz={lipschitz!r} without one")
        self.lipschitz = None
        if distance is not None:
            self.lipschitz = checked_number(1.0 if lipschitz is None else lipschitz, "lipschitz", name)
        self._contains = None if contains is None else Answers(contains, "contains", name)
        self._empty = None if empty is None else Answers(empty, "empty", name)
        self._distance = None if distance is None else Answers(distance, "distance", name, numbers=True)
        self.certified = empty is not None or distance is not None
        self._level = 0.0  # what the distance of a point of the dilated object is at most
        self._try()

    def _try(self) -> None:
        """Ask a few points twice, the second time in another order."""
        rng, backwards = np.random.default_rng(0), np.arange(TRIES)[::-1]
        x = rng.uniform(self.sample_lower, self.sample_upper, (TRIES, self.ndim))
        for asked, arrays in (
            (self._contains, (x,)),
            (self._distance, (x,)),
            (self._empty, (x, x + 0.01 * self._size)),
        ):
            if asked is not None:
                asked.compare(asked(*arrays), arrays, backwards)

    @property
    def _size(self) -> np.ndarray:
        return self._bounds[1] - self._bounds[0]

    # --- where it is -------------------------------------------------------------------------------------------------

    @property
    def ndim(self) -> int:
        return self._bounds.shape[1]

    @property
    def lower(self) -> np.ndarray:
        return widened(self._bounds[0], self.margin, -1)

    @property
    def upper(self) -> np.ndarray:
        return widened(self._bounds[1], self.margin, 1)

    @cached_property
    def geometry(self) -> str:
        """SHA-256 of the box, the Lipschitz constant and the answers on a lattice of about ``LATTICE`` points.

        A function has no geometry that could be read: two functions that agree on the lattice have one digest.
        """
        per_axis = max(int(LATTICE ** (1 / self.ndim)), 2)
        sha = hashlib.sha256(b"warp-bounding function 1")
        sha.update(self._bounds.astype("<f8").tobytes() + np.array(self.lipschitz or 0.0, dtype="<f8").tobytes())
        sha.update(bytes([self.time, self._empty is not None]))
        if per_axis**self.ndim <= 4 * LATTICE:
            index = np.indices((per_axis,) * self.ndim).reshape(self.ndim, -1).T
        else:  # too many corners: about as many points of the lattice, always the same
            index = np.random.default_rng(0).integers(0, per_axis, (LATTICE, self.ndim))
        points = self._bounds[0] + self._size * ((index + 0.5) / per_axis)
        sha.update(np.packbits(self._holds(points, 0.0)).tobytes())
        return sha.hexdigest()

    # --- what it is --------------------------------------------------------------------------------------------------

    def decide(self, x: np.ndarray) -> np.ndarray:
        x = np.asarray(x, dtype=np.float64)
        finite, found = np.isfinite(x).all(axis=1), np.full(len(x), OUT, dtype=np.uint8)
        found[finite] = np.where(self._holds(x[finite], self._level), IN, OUT)
        return found

    def _holds(self, x: np.ndarray, level: float) -> np.ndarray:
        held = np.zeros(len(x), dtype=bool) if self._contains is None else self._contains(x)
        if self._distance is not None and (level or self._contains is None):
            near = self._distance(x) <= level
            if level:  # a distance that is too short holds points beyond the box, which are farther than the margin
                near &= ((x >= self.lower) & (x <= self.upper)).all(axis=1)
            held = held | near
        return held

    def empty(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Certified: which closed boxes hold no point of the object; as true as what their author says of the functions."""
        lower, upper, real = _finite_boxes(lower, upper)
        found = ((lower > self.upper) | (upper < self.lower)).any(axis=1)
        left = real & ~found
        if self._empty is not None and not self.margin:
            found[left] = self._empty(lower[left], upper[left])
            left &= ~found
        if self._distance is not None:
            found[left] = self._apart(lower[left], upper[left]) > 0
        return found & real

    def inside(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        lower, upper, real = _finite_boxes(lower, upper)
        if self._contains is not None or self._distance is None:  # how deep inside a point is, is unknown
            return np.zeros(len(lower), dtype=bool)
        center, reach, allowed = self._balls(lower, upper)
        value = self._distance(center)
        with np.errstate(all="ignore"):
            gap = Interval(value) + allowed + reach * self.lipschitz
        within = not self.margin or ((lower >= self.lower) & (upper <= self.upper)).all(axis=1)
        return (gap.high <= self._level) & real & within

    def distance(self, x: np.ndarray) -> np.ndarray | None:
        x = np.asarray(x, dtype=np.float64)
        return self.clearance(x, x)

    def clearance(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray | None:
        if self._distance is None:
            return None
        lower, upper, real = _finite_boxes(lower, upper)
        return np.where(real, np.maximum(self._apart(lower, upper), 0.0), 0.0)

    def _apart(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Lower bounds of the distance from boxes to the dilated object, under 0 where none is known."""
        center, reach, allowed = self._balls(lower, upper)
        value = self._distance(center)
        with np.errstate(all="ignore"):
            return ((Interval(value) - allowed - self._level) / self.lipschitz - reach).low

    def _balls(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, Interval, np.ndarray]:
        """Centres, bounds of the half-diagonals, and what the distances at the centres may be off, doubled."""
        with np.errstate(all="ignore"):
            center = lower / 2 + upper / 2
            reach = norm((x - c).magnitude() for x, c in zip(columns(lower, upper), center.T, strict=True))
        size = np.maximum(np.abs(lower), np.abs(upper)).max(axis=1)
        return center, Interval(reach.high), 2 * self._allowance(size)

    def _allowance(self, size: np.ndarray) -> np.ndarray:
        """By how much a distance may be off where the largest absolute coordinate is ``size``."""
        return ALLOWANCE * self.lipschitz * np.maximum(size, np.abs(self._bounds).max())

    # --- what can be made of it --------------------------------------------------------------------------------------

    def dilated(self, margin: float) -> "IndicatorFunction":
        """The object, and all points of its box, wider by ``margin``, whose distance, over L, is at most ``margin``.

        Among them are all points within ``margin`` of the object, and there are no others if ``distance`` is the
        Euclidean distance and L is 1.

        Raises:
            IndicatorError: For a margin that is negative or not finite, a shape that is dilated already, a function
                without a distance, or one of time.
        """
        margin = self._new_margin(margin)
        if margin is None:
            return self
        if self._distance is None:
            raise IndicatorError(
                f"{self.name}: a function is dilated by its distance, and this one has none, got margin={margin}; "
                "give a distance, or a function that is dilated itself"
            )
        if self.time:
            raise IndicatorError(f"{self.name}: a function of time cannot be dilated in space, got margin={margin}")
        found = copy(self)
        found.margin, found._level = margin, float(np.nextafter(self.lipschitz * margin, np.inf))
        return found

    # --- whether it is what its author says --------------------------------------------------------------------------

    def refute(self, *, count: int = 4096, seed: int = 0) -> Counterexample | None:
        """Look for points that contradict what the author says of this function.

        Args:
            count: Random points of each kind; the time that it takes is proportional to it.
            seed: Of the random numbers.

        Returns:
            What contradicts, or ``None``, which proves nothing.

        Raises:
            IndicatorError: If the answers of a function cannot be relied on.

        Example:
            >>> def twice(x):
            ...     return 2 * (np.linalg.norm(x, axis=1) - 1.0)
            >>> wrong = wb.IndicatorFunction(None, [-1, -1], [1, 1], distance=twice)
            >>> wrong.refute().broken
            'empty'
            >>> wb.IndicatorFunction(None, [-1, -1], [1, 1], distance=twice, lipschitz=2.0).refute()
        """
        undilated = copy(self)
        undilated.margin = undilated._level = 0.0
        told = None
        if self._distance is not None:
            told = Distance(self._distance, self.lipschitz, self._allowance)
        return refute(undilated, told, count, seed)

    def check(self) -> None:
        """Raise what ``refute`` finds.

        Raises:
            IndicatorError: With the counterexample.
        """
        found = self.refute()
        if found is not None:
            raise IndicatorError(f"{self.name}: {found.message}")


def _finite_boxes(lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Boxes, and which of them are some; others are replaced by the origin."""
    lower, upper = np.asarray(lower, dtype=np.float64), np.asarray(upper, dtype=np.float64)
    real = (np.isfinite(lower) & np.isfinite(upper) & (lower <= upper)).all(axis=1)
    return np.where(real[:, None], lower, 0.0), np.where(real[:, None], upper, 0.0), real
