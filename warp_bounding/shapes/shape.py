"""What every shape is: a closed set of points in a box, queried at points and over whole boxes.

Two methods matter most. ``contains`` is the truth for points. ``empty`` is a certificate: it is True only where no
point of a closed box is in the object, and False proves nothing. A proof halves the boxes where a bounder answers *no*
until the shape certifies each of them empty; it needs no grid, so no size of cells limits how tight it is. A shape
without ``empty`` (``certified`` is False) can be bounded, too, but its bounders are only tested by samples.

A point that a shape cannot decide counts as object; ``decide`` reports such points as ``UNDECIDED``.
"""

import hashlib
import math
import operator
import os
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar, NamedTuple

import numpy as np
import warp as wp

from warp_bounding.errors import QueryError, ShapeError
from warp_bounding.runtime.arrays import Picklable
from warp_bounding.shapes.joints import PER_JOINT, Joints

# --- Limits of requests -----------------------------------------------------------------------------------------------
#
# Limits: resolutions, margins, cells that float32 can divide an object into, and memory. An error before a step is
# better than a process that is killed in it.

MAX_CELLS = 2**31 - 1  # cells of a grid: their indices are 32-bit integers
MAX_OFFSET = 2**22  # cells: what ``Grid`` allows for an offset
SCALE_BITS = 16  # significant bits of cells_per_unit: cell coordinates of float32 points are then exact in float64
DEFAULT_RESOLUTION, MAX_RESOLUTION = 64, 1024  # cells along the longest axis of a mesh


def check_memory(needed: float, what: str, advice: str) -> None:
    """Raise ``ShapeError`` if ``what`` needs more bytes (about ``needed``) than this machine has memory."""
    there = _memory()
    if there is not None and needed > there:
        raise ShapeError(
            f"{what} needs about {needed / 1e9:.3g} GB of memory, this machine has {there / 1e9:.3g}; {advice}"
        )


def _memory() -> int | None:
    """Bytes of memory of this machine; ``None`` where that is unknown."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):
        return None


def checked_resolution(resolution: int | None) -> int:
    """The resolution, or the default one for ``None``; raises ``ShapeError`` for an impossible one."""
    if resolution is None:
        return DEFAULT_RESOLUTION
    try:
        value = operator.index(resolution)
    except TypeError:
        value = -1
    if isinstance(resolution, bool | np.bool_) or not 2 <= value <= MAX_RESOLUTION:
        raise ShapeError(f"resolution must be an integer from 2 to {MAX_RESOLUTION}, got {resolution!r}")
    return value


def checked_margin(margin: float) -> float:
    """The margin as a float; raises ``ShapeError`` for one that is negative or not finite."""
    try:
        value = float(margin)
    except (TypeError, ValueError):
        value = math.nan
    if not (math.isfinite(value) and value >= 0):
        raise ShapeError(f"margin must be finite and non-negative, got {margin!r}")
    return value


def cells_per_unit(extent: float, resolution: int, name: str) -> float:
    """Cubic cells per unit of length, for ``resolution`` of them along an extent, or fewer: rounded down to few bits.

    Raises ``ShapeError`` if float32 cells cannot divide the extent.
    """
    mantissa, exponent = math.frexp(resolution / extent)
    scale = math.ldexp(math.floor(math.ldexp(mantissa, SCALE_BITS)), exponent - SCALE_BITS)
    limits = np.finfo(np.float32)
    if not float(limits.tiny) <= scale <= float(limits.max):  # float(): else NumPy would round scale to float32
        raise ShapeError(f"{name}: expected an object that float32 cells can divide, got extent {extent:g}")
    return scale


def cells_around(lower: np.ndarray, upper: np.ndarray, reach: float, name: str) -> tuple[np.ndarray, np.ndarray]:
    """First and last cell of a grid around an object: all cells that it may meet, and one more on every side.

    Corners ``(3,)`` and ``reach``, the dilation, are in cells. Raises ``ShapeError`` for an object too far from the
    origin.
    """
    from warp_bounding.shapes.triangles.cells import SLACK

    reach = reach + 0.5 + 2 * SLACK  # all rounding included: 2 * SLACK > SLACK
    first = np.ceil(lower - reach).astype(np.int64) - 1
    last = np.floor(upper + reach).astype(np.int64) + 1
    if np.abs(first).max() >= MAX_OFFSET:
        raise ShapeError(
            f"{name}: expected a mesh within {MAX_OFFSET} cells of the origin, got {int(np.abs(first).max())} cells; "
            "move it there"
        )
    return first, last


def checked_vector(value, what: str, name: str) -> np.ndarray:
    """``(n,)`` float64, read-only; raises ``ShapeError`` for anything but at least one finite number in a row."""
    try:
        vector = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        vector = np.empty(0)
    if vector.ndim != 1 or vector.size == 0 or not np.isfinite(vector).all():
        raise ShapeError(f"{name}: {what} must be finite numbers of shape (n,), got {value!r}")
    vector.setflags(write=False)
    return vector


def checked_number(value, what: str, name: str, least: float = 0.0) -> float:
    """A finite float above ``least``; raises ``ShapeError`` for any other."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not (math.isfinite(number) and number > least):
        needed = "finite" if math.isinf(least) else f"finite and above {least:g}"
        raise ShapeError(f"{name}: {what} must be {needed}, got {value!r}")
    return number


def checked_corners(lower, upper, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Corners of a box, each ``(n,)``; raises ``ShapeError`` unless lower is below upper in each coordinate."""
    lower, upper = checked_vector(lower, "lower", name), checked_vector(upper, "upper", name)
    if lower.shape != upper.shape or not (lower < upper).all():
        raise ShapeError(f"{name}: lower must be below upper in each coordinate, got {lower} and {upper}")
    return lower, upper


# --- What is known of the part of a shape in a box --------------------------------------------------------------------
#
# A shape may know more of its part in a box than whether there is one: a half-space that holds that part.
#
# A box may hold both points of the object and, outside it, points where f is low. Then neither the bound of f nor
# ``Shape.empty`` closes the box. But only the least f over the box's part in the half-space counts, and the linear
# bound of f and the half-space together bound that.


class HalfSpaces(NamedTuple):
    """Certified half-spaces, one for each of N closed boxes in n dimensions, that hold the object's points in the box.

    Attributes:
        empty: ``(N,)`` bool, certified as in ``Shape.empty``; the half-spaces of empty boxes mean nothing.
        center: ``(N, n)`` float64, object space.
        level: ``(N,)`` float64.
        slope: ``(N, n)`` float64: a point x of the object in the box has ``level + slope . (x - center) >= 0``.
        axis: ``(N,)`` int, the axis along which halving the box helps the half-space most.
        loss: ``(N,)`` float64, about how far the linear function exceeds the function that it bounds.
    """

    empty: np.ndarray
    center: np.ndarray
    level: np.ndarray
    slope: np.ndarray
    axis: np.ndarray
    loss: np.ndarray

    @classmethod
    def blank(cls, lower: np.ndarray, upper: np.ndarray) -> "HalfSpaces":
        """Half-spaces that hold everything, for boxes between ``(N, n)`` float64 corners of which nothing is known."""
        count, n = lower.shape
        center = lower * 0.5 + upper * 0.5
        return cls(
            np.zeros(count, dtype=bool),
            center,
            np.ones(count),
            np.zeros((count, n)),
            np.zeros(count, dtype=np.int32),
            np.zeros(count),
        )

    def arrays(self) -> list[wp.array]:
        """All but ``center`` as Warp arrays over the same memory, which kernels fill."""
        vector = wp.types.vector(length=self.slope.shape[1], dtype=wp.float64)
        parts = (
            (self.empty, wp.uint8),
            (self.level, wp.float64),
            (self.slope, vector),
            (self.axis, wp.int32),
            (self.loss, wp.float64),
        )
        return [
            wp.array(x.view(np.uint8) if x.dtype == bool else x, dtype=dtype, device="cpu", copy=False)
            for x, dtype in parts
        ]


# --- Shapes -----------------------------------------------------------------------------------------------------------

HOLLOW = ("filled", "empty")  # enclosed air counts as inside, or as outside
OUT, IN, UNDECIDED = 0, 1, 2  # answers of ``decide``
BALL = 1 + 2.0**-40  # a factor that covers the float64 rounding of a length and a difference
PADDING = 0.1  # of the longest side: by how much random queries reach beyond the box that holds the object
DETAILS = 64  # along the longest side: float32 must distinguish points that are a DETAILS-th of it from each other


def dilated_digest(geometry: str, margin: float) -> str:
    """The digest of an object, from those of its geometry and its margin."""
    return hashlib.sha256(f"{geometry} dilated by {float(margin)!r}".encode()).hexdigest() if margin else geometry


class Shape(Picklable, ABC):
    """A closed set in n dimensions, the object; all coordinates are in object space, all lengths in object units.

    Attributes:
        name: For messages; a file's name without its folder.
        note: A restriction that a user should know; may be empty. ``restriction`` adds those of the geometry.
        remark: Something else that a user may want to know, such as what counts as unknown in a map; may be empty.
        time: Coordinate 0 is time; a query outside its range has no certain answer.
        margin: How far the object was dilated (Euclidean, in space); queries are about the dilated object.
        resolution: Cells along the longest axis, if a shape was divided into cells; else ``None``.
        certified: Whether ``empty`` can certify anything, so that bounders of this shape can be proven.
        identified: Whether its digest tells it from every other shape; of functions it does not.
        unbounded: The object includes everything outside the box (``complement``): queries there are *maybe*.
        joints: If the coordinates are values of joints: their limits, beyond which nothing is known, and periods.
    """

    name: str = "shape"
    note: str = ""
    remark: str = ""
    time: bool = False
    margin: float = 0.0
    resolution: int | None = None
    certified: bool = True
    identified: bool = True
    unbounded: ClassVar[bool] = False
    joints: Joints | None = None
    largest_delta: ClassVar[float] = 8.0  # details: where float32 blurs queries by more, the shape is refused
    # The truth of regions, if a shape can decide it: arguments as in ``Mesh``, answers as in ``decide``.
    decide_boxes: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    decide_segments: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    decide_planes: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None

    def __repr__(self) -> str:
        words = [f"{self.ndim}D", *self.counts, f"extent {' x '.join(f'{side:.4g}' for side in self.extent)}"]
        words += ["time first"] if self.time else []
        words += [f"margin {self.margin:g}"] if self.margin else []
        words += [f"resolution {self.resolution}"] if self.resolution else []
        words += filter(None, [self.restriction, self.remark])
        return f"<{type(self).__name__} {self.name}: {', '.join(words)}>"

    @property
    def counts(self) -> list[str]:
        """What it is made of, in words."""
        return []

    @property
    def restriction(self) -> str:
        """For users: what is not bounded, from the note and the geometry (such as an open surface); may be empty."""
        return self.note

    # --- where it is -------------------------------------------------------------------------------------------------

    @property
    @abstractmethod
    def ndim(self) -> int:
        """Number of coordinates n."""

    @property
    @abstractmethod
    def lower(self) -> np.ndarray:
        """``(n,)`` float64, lower corner of a box that holds the object, margin included."""

    @property
    @abstractmethod
    def upper(self) -> np.ndarray:
        """``(n,)`` float64, upper corner of that box."""

    @property
    def extent(self) -> np.ndarray:
        """``(n,)`` float64, sides of that box; without time, if coordinate 0 is time."""
        return (self.upper - self.lower)[1 if self.time else 0 :]

    @property
    def known_times(self) -> tuple[float, float]:
        """Where coordinate 0 is time: first and last time at which it is known what the object is."""
        return float(self.lower[0]), float(self.upper[0])

    @property
    def known(self) -> tuple[np.ndarray, np.ndarray]:
        """``(n,)`` float64 each: limits beyond which nothing is known, of times and joint values; else infinite."""
        end = np.full(self.ndim, np.inf)
        lower, upper = -end, end
        if self.time:
            lower[0], upper[0] = self.lower[0], self.upper[0]
        return lower, upper

    @property
    def speed(self) -> float | None:
        """The largest speed of the object's points, object units per unit of time; ``None`` if unknown.

        Coordinate 0 is time.
        """
        return None

    @property
    def knots(self) -> np.ndarray:
        """``(K,)`` float64, times at which the velocity of its points may jump; none for a shape at rest."""
        return np.empty(0)

    @property
    def frame(self) -> tuple[np.ndarray, np.ndarray]:
        """``(n,)`` float64 each, corners of a bounder's domain: the box, no side thinner than a detail."""
        least = 1 / self.details_per_unit
        room = np.maximum(least - (self.upper - self.lower), 0.0) / 2
        return self.lower - room, self.upper + room

    @property
    def sample_lower(self) -> np.ndarray:
        """``(n,)`` float64, where random queries begin: a tenth of the longest side outside the box, in space."""
        return self.lower - self._padding

    @property
    def sample_upper(self) -> np.ndarray:
        """``(n,)`` float64, where random queries end."""
        return self.upper + self._padding

    @property
    def details_per_unit(self) -> np.ndarray:
        """``(n,)`` float64, details per object unit: float32 must distinguish points a detail (a grid cell) apart."""
        size = np.full(self.ndim, self.extent.max())
        if self.time:
            size[0] = self.upper[0] - self.lower[0]
        return DETAILS / size

    @property
    def waves(self) -> np.ndarray | None:
        """``(K, n)`` float64: sines and cosines of ``waves @ x`` determine whether x is in it; ``None`` if unknown."""
        return None

    @property
    def _padding(self) -> np.ndarray:
        padding = np.full(self.ndim, PADDING * self.extent.max())
        if self.time:
            padding[0] = 0.0
        return padding

    # --- what it is --------------------------------------------------------------------------------------------------

    @property
    @abstractmethod
    def geometry(self) -> str:
        """SHA-256 of the geometry, the margin not included; name and note do not enter."""

    @property
    def digest(self) -> str:
        """SHA-256 of the object: of its geometry, and of the margin where there is one."""
        return dilated_digest(self.geometry, self.margin)

    def expect_identified(self, what: str) -> None:
        """Refuse to store ``what`` under the digest of a shape that is not ``identified``, with ``ShapeError``."""
        if not self.identified:
            raise ShapeError(
                f"{self.name}: {what} needs a shape that its digest identifies, got one that is decided by a "
                "function of yours, which may change unnoticed; give none"
            )

    @abstractmethod
    def decide(self, x: np.ndarray) -> np.ndarray:
        """``(N,)`` uint8 for points ``(N, n)``, float32 or float64: certainly ``OUT`` or ``IN``, or ``UNDECIDED``."""

    def contains(self, x: np.ndarray) -> np.ndarray:
        """The truth ``(N,)`` bool for points ``(N, n)``; what cannot be decided counts as object. NaN is nowhere.

        Raises:
            QueryError: For another shape, or values of joints that are far beyond their limits, such as degrees.

        Example:
            >>> grid.contains(np.array([[0.5, 0.5, 0.5], [0.0, 0.0, 0.0]]))
            array([ True, False])
        """
        x = np.asarray(x)
        if x.ndim != 2 or x.shape[1] != self.ndim:
            mend = "" if self.joints is None else PER_JOINT
            raise QueryError(f"{self.name}: points must have shape (N, {self.ndim}), got {x.shape}{mend}")
        if self.joints is not None and (fault := self.joints.other_units(x)):
            raise QueryError(f"{self.name}: {fault}")
        return self.decide(x) != OUT

    @abstractmethod
    def empty(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Certified, ``(N,)`` bool: which closed boxes ``(N, n)`` float64 hold no point of the object.

        False proves nothing; for NaN, and lower above upper, it is False.
        """

    def inside(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Certified: which closed boxes lie in the object whole; ``(N,)`` bool, False proves nothing."""
        return np.zeros(len(lower), dtype=bool)

    def reaches_beyond(self, lower: np.ndarray, upper: np.ndarray) -> bool:
        """Whether the object may have points outside the closed box with these corners ``(n,)``."""
        for side, axis in np.argwhere([self.lower < lower, self.upper > upper]):
            beyond = np.array([self.lower, self.upper])
            beyond[1 - side, axis] = (lower, upper)[side][axis]
            if not self.empty(*beyond[:, None])[0]:
                return True
        return False

    def half_spaces(self, lower: np.ndarray, upper: np.ndarray) -> HalfSpaces | None:
        """Half-spaces that hold the object's points in closed boxes of finite corners ``(N, n)``; ``None`` if unknown.

        Points that are ``UNDECIDED`` by themselves may lie beyond: more is known about the box than about them.
        """
        return None

    def distance(self, x: np.ndarray) -> np.ndarray | None:
        """Lower bounds ``(N,)`` of the distance from points to the object (0 in it); ``None`` where none is known.

        Where coordinate 0 is time, the distance is in space, to the object at the point's time; 0 out of its time.
        """
        return None

    def distances(self, x: np.ndarray) -> np.ndarray | None:
        """``(N, 2)`` float64, certified lower and upper bounds of the distance from points; ``None`` if unknown.

        An upper bound is infinite where nothing is known. In the object both are 0, if the shape can decide that.
        """
        low = self.distance(x)
        if low is None:
            return None
        return np.stack([low, np.where(self.decide(x) == IN, 0.0, np.inf)], axis=1)

    def depth(self, x: np.ndarray) -> np.ndarray:
        """About how deep points ``(N, n)`` lie in the object, ``(N,)``; 0 outside, and where it is not known.

        No proof rests on it.
        """
        return np.zeros(len(x))

    def overestimate(
        self,
        lower: np.ndarray,
        upper: np.ndarray,
        values: np.ndarray,
        least: float,
        enough: np.ndarray | float = np.inf,
    ) -> np.ndarray | None:
        """Upper bounds of how far functions exceed the distance to the object over boxes.

        By default they follow from the distance at the boxes' centres, which is 1-Lipschitz.

        Args:
            lower: ``(N, n)`` float64, lower corners.
            upper: ``(N, n)`` float64, upper corners.
            values: ``(N, 2^n)`` float64, of a function at each box's corners; corner i is the upper one on axis k if
                bit k of i is set. On the box the function is at most the multilinear interpolation of these.
            least: Smaller results may be raised to this.
            enough: For each box, or for all: a result above this need not be tight, which saves time.

        Returns:
            ``(N,)`` float64, certified: the function is nowhere in the box above the distance by more. ``None`` where
            no distance is known.
        """
        low = self.distance(lower / 2 + upper / 2)
        if low is None:
            return None
        reach = np.linalg.norm(upper - lower, axis=1) / 2 * BALL
        highest = values.max(axis=1)
        return np.maximum(
            highest - np.maximum(low - reach, 0.0) * (1 / BALL) + (BALL - 1) * np.abs(values).max(axis=1), least
        )

    def landmarks(self) -> np.ndarray:
        """``(P, n)`` float64 points, about on the object's border where it sticks out; a proof never relies on them."""
        return np.empty((0, self.ndim))

    def corners(self) -> np.ndarray | None:
        """``(P, n)`` float64 points whose hull, dilated by ``margin`` in space, is the object's; else ``None``."""
        return None

    def points(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Random points ``(count, n)`` of the object, up to rounding; ``(0, n)`` if the shape cannot draw any."""
        return np.empty((0, self.ndim))

    def check(self) -> None:
        """Raise ``ShapeError`` with a point that contradicts what the caller claimed of the shape."""

    def check_contents(self) -> None:
        """Raise ``ShapeError`` where a search finds no point in the object, or none outside."""

    # --- what can be made of it --------------------------------------------------------------------------------------

    @abstractmethod
    def dilated(self, margin: float) -> "Shape":
        """The object and all points within ``margin`` of it (in space only); itself for its own margin.

        Raises:
            ShapeError: For a margin that is negative or not finite, or a shape that is dilated already.
        """

    @abstractmethod
    def to_grid(self, *, resolution: int | None = None, margin: float = 0.0):
        """A ``Grid`` of closed cells that hold every point within ``margin`` of the shape.

        Args:
            resolution: Cells along the longest side of the dilated object, 2 to 1024; the shape's default if ``None``.
            margin: Object units, at least 0.

        Raises:
            ShapeError: For an impossible resolution or margin, or more cells than this machine can hold.
        """

    def _new_margin(self, margin: float) -> float | None:
        """A margin to dilate by, checked; ``None`` if it is 0 or the shape has it already."""
        margin = checked_margin(margin)
        if margin in (0.0, self.margin):
            return None
        if self.margin:
            raise ShapeError(f"{self.name}: the shape is dilated by {self.margin} already, got margin={margin}")
        return margin


class Derived(Shape):
    """A shape made of another one, ``whole``, from which it takes what it does not define itself."""

    def __init__(self, whole: Shape):
        self.whole = whole
        for key in ("name", "note", "time", "margin", "certified", "identified", "joints"):
            setattr(self, key, getattr(whole, key))

    @property
    def restriction(self) -> str:
        return self.whole.restriction

    @property
    def ndim(self) -> int:
        return self.whole.ndim

    def check(self) -> None:
        self.whole.check()
