"""A function as a shape: the truth about points, and what its author knows about boxes.

What certifies boxes is either the author's own ``empty``, such as interval arithmetic, or a distance with a Lipschitz
constant L: over a box with centre c no point is farther from c than the half-diagonal r, so the distance stays above 0
where ``distance(c) > L r``. A shape cannot look into a function; ``check`` looks for points that contradict what its
author says.
"""

import hashlib
import pickle
from collections.abc import Callable
from copy import copy, deepcopy
from functools import cached_property

import numpy as np

from warp_bounding.errors import ShapeError
from warp_bounding.shapes.formula import Formula
from warp_bounding.shapes.shape import IN, OUT, checked_corners, checked_number

# --- A user's function ------------------------------------------------------------------------------------------------
#
# A user's function as a shape may rely on it: each answer has the right shape and type, no NaN, and is the same again.
#
# What cannot be relied on is an ``ShapeError`` in one line that names the function and shows what came.

AGAIN = 64  # every so many calls one is queried twice
MOST_AGAIN = 4096  # rows; a larger call is not asked twice
UNSURE = 1e-9  # of the largest answer: numbers that differ by less are the same, in another order of summation


class Answers:
    """A function of arrays, checked.

    Args:
        function: Takes one or two ``(N, n)`` float64 arrays, copies that it may write to.
        what: Its name, for messages.
        name: The shape's name, for messages.
        numbers: Whether it returns ``(N,)`` numbers instead of ``(N,)`` truth values.
    """

    def __init__(self, function: Callable, what: str, name: str, *, numbers: bool = False):
        if not callable(function):
            raise ShapeError(f"{name}: {what} must be a function of arrays, got {function!r}")
        self.function, self.what, self.name, self.numbers = function, what, name, numbers
        self._calls = 0

    def __getstate__(self) -> dict:
        try:
            pickle.dumps(self.function)
        except Exception as error:  # what it holds may raise anything
            needed = "define it in a module, and not as a lambda or in a function"
            raise ShapeError(f"{self.name}: {self.what} cannot be pickled ({error}); {needed}") from error
        return vars(self)

    def __deepcopy__(self, memo: dict) -> "Answers":
        return Answers(deepcopy(self.function, memo), self.what, self.name, numbers=self.numbers)

    def __call__(self, *arrays: np.ndarray) -> np.ndarray:
        """The answers ``(N,)``, bool or float64, to finite arrays; ``ShapeError`` where they cannot be relied on."""
        if not len(arrays[0]):
            return np.zeros(0, dtype=np.float64 if self.numbers else bool)
        answer = self._query(arrays)
        self._calls += 1
        if self._calls % AGAIN == 1 and len(answer) <= MOST_AGAIN:
            self.compare(answer, arrays, np.arange(len(answer)))
        return answer

    def compare(self, answer: np.ndarray, arrays: tuple[np.ndarray, ...], order: np.ndarray) -> None:
        """Ask again, with the rows in another order; ``ShapeError`` if a row gets another answer."""
        again = self._query([array[order] for array in arrays])
        before = answer[order]
        if self.numbers:
            with np.errstate(invalid="ignore"):
                finite = np.abs(before[np.isfinite(before)])
                near = np.abs(again - before) <= UNSURE * finite.max(initial=0.0)
            changed = ~(near | (again == before))
        else:
            changed = again != before
        if changed.any():
            row = int(np.argmax(changed))
            at = " to ".join(shown(array[order[row]]) for array in arrays)
            raise ShapeError(
                f"{self.name}: {self.what} must answer each point on its own and always the same, got "
                f"{before[row]} and then {again[row]} at {at}"
            )

    def _query(self, arrays) -> np.ndarray:
        count = len(arrays[0])
        try:
            answer = self.function(*(np.array(array, dtype=np.float64, order="C") for array in arrays))
        except Exception as error:
            reason = " ".join(str(error).split())
            raise ShapeError(
                f"{self.name}: {self.what} raised {type(error).__name__} for {count} points: {reason}"
            ) from error
        answer = np.asarray(answer)
        kinds, needed = ("iu", "float64") if self.numbers else ("", "bool")
        right = answer.dtype == np.dtype(needed) or answer.dtype.kind in kinds
        if answer.shape != (count,) or not right:
            got = f"{answer.dtype} of shape {answer.shape}"
            raise ShapeError(f"{self.name}: {self.what} must return {needed} of shape ({count},), got {got}")
        answer = answer.astype(needed)
        if self.numbers and np.isnan(answer).any():
            row = int(np.argmax(np.isnan(answer)))
            raise ShapeError(f"{self.name}: {self.what} must return numbers, got NaN at {shown(arrays[0][row])}")
        return answer


def shown(x: np.ndarray) -> str:
    """A point in a message, with all digits."""
    return f"({', '.join(repr(float(each)) for each in x)})"


# --- Counterexamples --------------------------------------------------------------------------------------------------
#
# The search for points that contradict what is said of a function: its box, its ``empty`` and its distance.
#
# What lies about boxes is found where it matters. Points of the object at its very border are found by bisection
# between points inside and outside; every box around such a point must not be empty, however small it is and on
# whichever of its faces the point lies. What lies about distances is found between such points and all others, and by
# steps of all sizes along the steepest slope.

HALVINGS = 40  # bisections from a point inside and one outside to a point at the border
NEAREST, FARTHEST = -9.0, 0.5  # powers of ten: sizes of boxes and steps, in units of the longest side
SLOPE_STEPS = 0.1  # of other steps: those from which the steepest direction is told
BEYOND = 1.0  # longest sides: how far outside of the box that holds the object points of it are looked for


class _Search:
    """Looks for what contradicts an undilated function, and tells it in a sentence with the points."""

    def __init__(self, shape: "Function", count: int, seed: int):
        self.shape, self.count, self.rng = shape, count, np.random.default_rng(seed)
        self.n, self.longest = shape.ndim, float(shape.extent.max())

    def run(self) -> str | None:
        shape, lower, upper = self.shape, self.shape.lower, self.shape.upper
        within, around = self._uniform(lower, upper), self._uniform(shape.sample_lower, shape.sample_upper)
        x = np.concatenate([within, around, self._outside(), self._shell()])
        held = shape.contains(x)
        beyond = held & ((x < lower) | (x > upper)).any(axis=1)
        if beyond.any():
            return f"the point {shown(x[beyond][0])} is in the object, but not between lower and upper"
        inside = np.concatenate([x[held][: self.count], self._border(x[held], x[~held])])
        if shape.certified:
            for boxes in (self._boxes_around(inside), self._boxes_at_random()):
                if (found := self._in_empty_box(*boxes)) is not None:
                    return found
        return None if shape._distance is None else self._wrong_distance(x, inside)

    # --- points and boxes --------------------------------------------------------------------------------------------

    def _uniform(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        return self.rng.uniform(lower, upper, (self.count, self.n))

    def _sizes(self, count: int) -> np.ndarray:
        """``(count, 1)`` lengths of all sizes."""
        return self.longest * 10.0 ** self.rng.uniform(NEAREST, FARTHEST, (count, 1))

    def _outside(self) -> np.ndarray:
        beyond = BEYOND * self.longest
        return self._in_time(self._uniform(self.shape.lower - beyond, self.shape.upper + beyond))

    def _shell(self) -> np.ndarray:
        """Points just outside of the faces of the box."""
        x, axis = self._uniform(self.shape.lower, self.shape.upper), self.rng.integers(0, self.n, self.count)
        side, step = self.rng.random(self.count) < 0.5, self._sizes(self.count)[:, 0] * 0.1
        rows = np.arange(self.count)
        x[rows, axis] = np.where(side, self.shape.lower[axis] - step, self.shape.upper[axis] + step)
        return self._in_time(x)

    def _in_time(self, x: np.ndarray) -> np.ndarray:
        if self.shape.time:
            x[:, 0] = np.clip(x[:, 0], self.shape.lower[0], self.shape.upper[0])
        return x

    def _border(self, held: np.ndarray, free: np.ndarray) -> np.ndarray:
        """Points of the object beside which there are others."""
        if not len(held) or not len(free):
            return np.empty((0, self.n))
        a = held[self.rng.integers(0, len(held), self.count)]
        b = free[self.rng.integers(0, len(free), self.count)]
        for _ in range(HALVINGS):
            middle = a + (b - a) / 2
            found = self.shape.contains(middle)[:, None]
            a, b = np.where(found, middle, a), np.where(found, b, middle)
        return a

    def _boxes_around(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points of the object with boxes that they lie in, half of them on faces, and some boxes that are points."""
        points = np.repeat(points, 4, axis=0)
        shares = self.rng.random(points.shape)
        shares = np.where(self.rng.random(points.shape) < 0.5, np.round(shares), shares)
        sides = self._sizes(len(points)) * self.rng.random(points.shape)
        sides[self.rng.random(len(points)) < 0.1] = 0.0
        return points, points - shares * sides, points + (1 - shares) * sides

    def _boxes_at_random(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Boxes that are certified empty, with points of the object that were found in them or at their corners."""
        lower = self._uniform(self.shape.sample_lower, self.shape.sample_upper)
        upper = lower + self._sizes(self.count) * self.rng.random(lower.shape)
        empty = self.shape.empty(lower, upper)
        lower, upper = (np.repeat(corner[empty], 8, axis=0) for corner in (lower, upper))
        shares = self.rng.random(lower.shape)
        shares = np.where(self.rng.random((len(lower), 1)) < 0.5, np.round(shares), shares)
        points = np.clip(lower + shares * (upper - lower), lower, upper)
        held = self.shape.contains(points) if len(points) else np.zeros(0, dtype=bool)
        return points[held], lower[held], upper[held]

    # --- contradictions ----------------------------------------------------------------------------------------------

    def _in_empty_box(self, points: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> str | None:
        """Of points of the object, one that lies in a box that is certified empty."""
        wrong = self.shape.empty(lower, upper) if len(points) else np.zeros(0, dtype=bool)
        if not wrong.any():
            return None
        x, a, b = (shown(each[wrong][0]) for each in (points, lower, upper))
        return f"the point {x} is in the object, but the box from {a} to {b}, which holds it, is called empty"

    def _wrong_distance(self, x: np.ndarray, inside: np.ndarray) -> str | None:
        from scipy.spatial import cKDTree

        value, lipschitz = self.shape._distance, self.shape.lipschitz
        above = value(inside) > self._allowed(inside)
        if above.any():
            at = inside[above][0]
            return f"the point {shown(at)} is in the object, but its distance is {value(at[None])[0]:g}, above 0"
        others = x[self.rng.permutation(len(x))]
        pairs = [(x, others), (x, x + self._steps(x)), (x, x + self._steps(x, steepest=True))]
        if len(inside):
            pairs.append((x, inside[self.rng.integers(0, len(inside), len(x))]))
            pairs.append((x, inside[cKDTree(inside).query(x)[1]]))
        for a, b in pairs:
            apart = np.linalg.norm(a - b, axis=1) * (1 + 1e-12)  # what the length rounds, and more
            change = np.abs(value(a) - value(b))
            steep = change > lipschitz * apart + self._allowed(a) + self._allowed(b)
            if steep.any():
                row = int(np.argmax(np.where(steep, change / np.maximum(apart, 1e-300), 0.0)))
                return (
                    f"the distance changes by {change[row]:g} between {shown(a[row])} and {shown(b[row])}, which are "
                    f"{apart[row]:g} apart, so lipschitz={lipschitz:g} is too little"
                )
        return None

    def _allowed(self, x: np.ndarray) -> np.ndarray:
        return self.shape._allowance(np.abs(x).max(axis=1, initial=0.0))

    def _steps(self, x: np.ndarray, steepest: bool = False) -> np.ndarray:
        """Steps of all sizes, in random directions or along the slope."""
        direction = self.rng.normal(size=x.shape)
        if steepest:
            value, step = self.shape._distance, SLOPE_STEPS * self._sizes(len(x))
            at = value(x)
            slope = np.stack([value(x + step * axis) - at for axis in np.eye(self.n)], axis=1)
            known = np.isfinite(slope).all(axis=1) & slope.any(axis=1)
            direction = np.where(known[:, None], np.where(np.isfinite(slope), slope, 0.0), direction)
        direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-300)
        return direction * self._sizes(len(x))


# --- Rounding ---------------------------------------------------------------------------------------------------------
#
# IEEE 754 rounds sums, products, quotients and square roots correctly, so the exact result lies strictly between the
# neighbours of the computed one. A sum that is computed as 0 is exactly 0, because float64 keeps subnormal numbers.


def _below(total: np.ndarray) -> np.ndarray:
    """A lower bound of what was rounded to a sum."""
    return np.where(total == 0, total, np.nextafter(total, -np.inf))


def _above(total: np.ndarray) -> np.ndarray:
    """An upper bound of what was rounded to a sum, or to the root of a number."""
    return np.where(total == 0, total, np.nextafter(total, np.inf))


def _length(sides: np.ndarray) -> np.ndarray:
    """``(N,)``, upper bounds of the lengths of vectors ``(N, n)`` of numbers of at least 0."""
    first, *others = np.where(sides == 0, 0.0, np.nextafter(sides * sides, np.inf)).T
    if not others:
        return sides[:, 0]
    for square in others:
        first = _above(first + square)
    return _above(np.sqrt(first))


def _widened(corner: np.ndarray, step: float, sign: int) -> np.ndarray:
    """``corner + sign * step``, exactly where float64 holds it, else the neighbour on the far side."""
    step = sign * step
    with np.errstate(over="ignore", invalid="ignore"):
        moved = corner + step
        back = moved - corner
        lost = (corner - (moved - back)) + (step - back)  # what rounding took off, exactly (Knuth's two-sum)
        return np.where(lost == 0, moved, np.nextafter(moved, sign * np.inf))


# --- The shape --------------------------------------------------------------------------------------------------------

# By how much the distance that a function computes may be off, in units of L times the largest absolute coordinate of
# the point and of the object's box; twice as much is taken off. That is 512 roundings, more than short formulas make.
ALLOWANCE = 2.0**-44
TRIES = 64  # points that are queried twice when a shape is made
LATTICE = 4096  # points, about, whose answers enter the digest


class Function(Formula):
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
        identified: False: other functions may have the same digest, so nothing is stored under it.

    Raises:
        ShapeError: For corners that are none, or functions whose answers cannot be relied on.

    Example:
        >>> def star(x):
        ...     angle = np.arctan2(x[:, 1], x[:, 0])
        ...     return np.hypot(x[:, 0], x[:, 1]) <= 0.7 + 0.2 * np.sin(5 * angle)
        >>> wb.shapes.Function(star, [-1, -1], [1, 1]).certified
        False
        >>> def distance(x):
        ...     return np.linalg.norm(x, axis=1) - 1.0
        >>> ball5 = wb.shapes.Function(None, np.full(5, -1.0), np.full(5, 1.0), distance=distance)
        >>> ball5.empty(np.full((1, 5), 0.5), np.full((1, 5), 0.6))
        array([ True])
    """

    identified = False

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
            raise ShapeError(f"{name}: expected contains, or a distance that is 0 or less in the object, got neither")
        if distance is None and lipschitz is not None:
            raise ShapeError(f"{name}: lipschitz is that of a distance, got lipschitz={lipschitz!r} without one")
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
        for queried, arrays in (
            (self._contains, (x,)),
            (self._distance, (x,)),
            (self._empty, (x, x + 0.01 * self._size)),
        ):
            if queried is not None:
                queried.compare(queried(*arrays), arrays, backwards)

    @property
    def _size(self) -> np.ndarray:
        return self._bounds[1] - self._bounds[0]

    # --- where it is -------------------------------------------------------------------------------------------------

    @property
    def lower(self) -> np.ndarray:
        return _widened(self._bounds[0], self.margin, -1)

    @property
    def upper(self) -> np.ndarray:
        return _widened(self._bounds[1], self.margin, 1)

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
            way = np.where(reach == 0, 0.0, np.nextafter(reach * self.lipschitz, np.inf))
            high = _above(_above(value + allowed) + way)
        within = not self.margin or ((lower >= self.lower) & (upper <= self.upper)).all(axis=1)
        return (high <= self._level) & real & within

    def distance(self, x: np.ndarray) -> np.ndarray | None:
        if self._distance is None:
            return None
        x, _, real = _finite_boxes(x, x)
        return np.where(real, np.maximum(self._apart(x, x), 0.0), 0.0)

    def _apart(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Lower bounds of the distance from boxes to the dilated object, under 0 where none is known."""
        center, reach, allowed = self._balls(lower, upper)
        value = self._distance(center)
        with np.errstate(all="ignore"):
            low = _below(_below(value - allowed) - self._level)
            low = np.where(low == 0, 0.0, np.nextafter(low / self.lipschitz, -np.inf))
            return _below(low - reach)

    def _balls(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Centres, bounds of the half-diagonals, and what the distances at the centres may be off, doubled."""
        with np.errstate(all="ignore"):
            center = lower / 2 + upper / 2
            reach = _length(np.maximum(_above(upper - center), _above(center - lower)))
        size = np.maximum(np.abs(lower), np.abs(upper)).max(axis=1)
        return center, reach, 2 * self._allowance(size)

    def _allowance(self, size: np.ndarray) -> np.ndarray:
        """By how much a distance may be off where the largest absolute coordinate is ``size``."""
        return ALLOWANCE * self.lipschitz * np.maximum(size, np.abs(self._bounds).max())

    # --- what can be made of it --------------------------------------------------------------------------------------

    def dilated(self, margin: float) -> "Function":
        """The object, and all points of its box, wider by ``margin``, whose distance, over L, is at most ``margin``.

        Among them are all points within ``margin`` of the object, and there are no others if ``distance`` is the
        Euclidean distance and L is 1. Raises ``ShapeError`` also for a function without a distance, or one of time.
        """
        margin = self._new_margin(margin)
        if margin is None:
            return self
        if self._distance is None:
            raise ShapeError(
                f"{self.name}: a function is dilated by its distance, and this one has none, got margin={margin}; "
                "give a distance, or a function that is dilated itself"
            )
        if self.time:
            raise ShapeError(f"{self.name}: a function of time cannot be dilated in space, got margin={margin}")
        found = copy(self)
        found.margin, found._level = margin, float(np.nextafter(self.lipschitz * margin, np.inf))
        return found

    # --- whether it is what its author says --------------------------------------------------------------------------

    def check(self, *, count: int = 4096, seed: int = 0) -> None:
        """Look for points that contradict what the author says of this function; finding none proves nothing.

        Args:
            count: Random points of each kind; the time that it takes is proportional to it.
            seed: Of the random numbers.

        Raises:
            ShapeError: With a point that contradicts, or if the answers of a function cannot be relied on.

        Example:
            >>> def twice(x):
            ...     return 2 * (np.linalg.norm(x, axis=1) - 1.0)
            >>> wb.shapes.Function(None, [-1, -1], [1, 1], distance=twice, lipschitz=2.0).check()
            >>> try:
            ...     wb.shapes.Function(None, [-1, -1], [1, 1], distance=twice).check()
            ... except wb.ShapeError as error:
            ...     print("called empty" in str(error))
            True
        """
        undilated = copy(self)
        undilated.margin = undilated._level = 0.0
        with np.errstate(invalid="ignore", over="ignore"):  # infinite distances
            found = _Search(undilated, count, seed).run()
        if found is not None:
            raise ShapeError(f"{self.name}: {found}")


def _finite_boxes(lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Boxes, and which of them are some; others are replaced by the origin."""
    lower, upper = np.asarray(lower, dtype=np.float64), np.asarray(upper, dtype=np.float64)
    real = (np.isfinite(lower) & np.isfinite(upper) & (lower <= upper)).all(axis=1)
    return np.where(real[:, None], lower, 0.0), np.where(real[:, None], upper, 0.0), real
