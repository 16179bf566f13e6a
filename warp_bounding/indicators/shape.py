"""What every shape is: a closed set of points in a box, asked about points and about whole boxes.

Two questions carry everything else. ``contains`` is the truth for points. ``empty`` is a certificate: it is True only
where no point of a closed box is in the object, and False proves nothing. A proof divides the boxes of queries that a
bounder would deny until the shape certifies each of them empty, so it needs no grid, and no cell limits how tight it
is. A shape without ``empty`` (``certified`` is False) can be bounded too, but its bounders are only attested by samples.

Whatever a shape cannot decide it counts as object; ``decide`` tells these cases apart, so that they can be counted.
"""

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import ClassVar

import numpy as np

from warp_bounding.errors import IndicatorError
from warp_bounding.indicators.half_spaces import HalfSpaces
from warp_bounding.indicators.joints import Joints
from warp_bounding.indicators.limits import checked_margin
from warp_bounding.indicators.parts.pieces import Pieces
from warp_bounding.runtime.pickling import Picklable

__all__ = ["DETAILS", "IN", "OUT", "UNDECIDED", "Shape", "dilated_digest"]

HOLLOW = ("filled", "empty")  # what air may count as that an object encloses: inside, outside
OUT, IN, UNDECIDED = 0, 1, 2  # answers of ``decide``
BALL = 1 + 2.0**-40  # outweighs what float64 rounds in a length and a difference
PADDING = 0.1  # of the longest side: by how much random queries reach beyond the box that holds the object
DETAILS = 64  # along the longest side: float32 must tell apart points that are a DETAILS-th of it from each other


def dilated_digest(geometry: str, margin: float) -> str:
    """The digest of an object, from those of its geometry and its margin."""
    return hashlib.sha256(f"{geometry} dilated by {float(margin)!r}".encode()).hexdigest() if margin else geometry


class Shape(Picklable, ABC):
    """A closed set in n dimensions, the object; all coordinates are in object space, all lengths in object units.

    Attributes:
        name: For people and messages; of a file its name, never the folder that it lies in.
        note: A restriction that a user should know; may be empty. ``restriction`` has it, and what the shape itself knows.
        remark: What a user may want to know and what restricts nothing, such as what counts as unknown in a map; may be empty.
        time: Coordinate 0 is time; a query outside its range has no certain answer.
        margin: How far the object was dilated (Euclidean, in space); what is asked is the dilated object.
        resolution: Of cells that were laid over a shape; ``None`` where the shape itself is asked.
        certified: Whether ``empty`` can certify anything, so that bounders of this shape can be proven.
        unbounded: The object is all that lies beyond the box, too (``complement``); a query there is *maybe* in it.
        joints: Where the coordinates are values of joints, their limits, beyond which nothing is known, and their periods.
    """

    name: str = "shape"
    note: str = ""
    remark: str = ""
    time: bool = False
    margin: float = 0.0
    resolution: int | None = None
    certified: bool = True
    unbounded: ClassVar[bool] = False
    joints: Joints | None = None
    largest_delta: ClassVar[float] = 8.0  # details: where float32 blurs queries by more, the shape is refused
    # Truth of regions, where a shape can tell it: called with what is said in ``IndicatorMesh``, they answer as ``decide``.
    decide_boxes: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    decide_segments: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    decide_planes: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None

    @property
    def restriction(self) -> str:
        """What of the object is not bounded, for users: the note, and what the geometry tells, such as an open surface; may be empty."""
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
        """``(n,)`` float64 each: beyond which coordinates nothing is known, which are times and values of joints with limits; else infinite."""
        end = np.full(self.ndim, np.inf)
        lower, upper = -end, end
        if self.time:
            lower[0], upper[0] = self.lower[0], self.upper[0]
        return lower, upper

    @property
    def speed(self) -> float | None:
        """Where coordinate 0 is time: how fast points of the object move at most, object units per unit of time; ``None`` where it is not known."""
        return None

    @property
    def knots(self) -> np.ndarray:
        """``(K,)`` float64, times at which its motion may bend; of a shape at rest none."""
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
        """``(n,)`` float64, per object unit, of what float32 must tell apart wherever the object is (a grid's cells)."""
        size = np.full(self.ndim, self.extent.max())
        if self.time:
            size[0] = self.upper[0] - self.lower[0]
        return DETAILS / size

    @property
    def waves(self) -> np.ndarray | None:
        """``(K, n)`` float64, per object unit: whether a point x lies in it follows from the sines and cosines of ``waves @ x``, as far as that is known."""
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

    @abstractmethod
    def decide(self, x: np.ndarray) -> np.ndarray:
        """``(N,)`` uint8 for points ``(N, n)``, float32 or float64: ``OUT`` or ``IN`` for certain, else ``UNDECIDED``."""

    def contains(self, x: np.ndarray) -> np.ndarray:
        """The truth for points; those that cannot be decided count as object.

        Args:
            x: ``(N, n)`` float32 or float64, object space. NaN is nowhere.

        Returns:
            ``(N,)`` bool.
        """
        return self.decide(x) != OUT

    @abstractmethod
    def empty(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Certified: which closed boxes hold no point of the object.

        Args:
            lower: ``(N, n)`` float64, lower corners.
            upper: ``(N, n)`` float64, upper corners.

        Returns:
            ``(N,)`` bool. False proves nothing; for NaN, and lower above upper, it is False.
        """

    def inside(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Certified: which closed boxes lie in the object whole; ``(N,)`` bool, False proves nothing."""
        return np.zeros(len(lower), dtype=bool)

    def half_spaces(self, lower: np.ndarray, upper: np.ndarray) -> HalfSpaces | None:
        """Half-spaces that hold the object's points in closed boxes, ``(N, n)`` finite corners; ``None`` where none are known.

        Points that are ``UNDECIDED`` by themselves may lie beyond: of the box more is known than of them.
        """
        return None

    def distance(self, x: np.ndarray) -> np.ndarray | None:
        """Lower bounds ``(N,)`` of the distance from points to the object (0 in it); ``None`` where none is known.

        Where coordinate 0 is time, the distance is in space, to the object at the point's time; 0 out of its time.
        """
        return None

    def distances(self, x: np.ndarray) -> np.ndarray | None:
        """``(N, 2)`` float64, certified lower and upper bounds of the distance from points; ``None`` where none is known.

        An upper bound is infinite where nothing is known of it. In the object both are 0, if the shape can tell.
        """
        low = self.distance(x)
        if low is None:
            return None
        return np.stack([low, np.where(self.decide(x) == IN, 0.0, np.inf)], axis=1)

    def clearance(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray | None:
        """Lower bounds ``(N,)`` of the distance from boxes to the object; ``None`` where none is known."""
        return None

    def depth(self, x: np.ndarray) -> np.ndarray:
        """About how deep points ``(N, n)`` lie in the object, ``(N,)``; 0 outside, and where it is not known. No proof rests on it."""
        return np.zeros(len(x))

    def excess(
        self,
        lower: np.ndarray,
        upper: np.ndarray,
        values: np.ndarray,
        least: float,
        enough: np.ndarray | float = np.inf,
    ) -> np.ndarray | None:
        """By how much functions may exceed the distance to the object in boxes; here as the distance at the centres tells, which grows by no more than the way.

        Args:
            lower: ``(N, n)`` float64, lower corners.
            upper: ``(N, n)`` float64, upper corners.
            values: ``(N, 2^n)`` float64, of a function at each box's corners, the one at place i the upper one on axis k where bit k of i is set. In
                between, the function is at most what is multilinear between the corners.
            least: Excesses under it need not be told apart.
            enough: Of each box, or of all: no more need be known of an excess than that it is above this, which takes less time.

        Returns:
            ``(N,)`` float64, certified: the function is nowhere in the box above the distance by more. ``None`` where no distance is known.
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
        """``(P, n)`` float64 points whose convex hull, dilated by ``margin`` in space, is that of the object; ``None`` if unknown."""
        return None

    def points(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Random points of the object, up to rounding, where the shape can name some however thin it is.

        Args:
            count: How many.
            rng: Source of randomness.

        Returns:
            ``(count, n)`` float64, or ``(0, n)`` where it cannot.
        """
        return np.empty((0, self.ndim))

    def check(self) -> None:
        """Look for points that contradict what the shape claims of itself, where it rests on somebody's word.

        Raises:
            IndicatorError: With the counterexample.
        """

    def check_contents(self) -> None:
        """Refuse a shape that holds nothing, or everything, as far as a search tells.

        Raises:
            IndicatorError: If no point was found in the object, or none outside.
        """

    # --- what can be made of it --------------------------------------------------------------------------------------

    @property
    def pieces(self) -> Pieces | None:
        """Which pieces of which whole this is, where it can be bounded piece by piece; ``None`` where it cannot."""
        return None

    def piece(self, held: Sequence[int]) -> "Shape":
        """The union of some pieces, whose bounders ``a | b`` puts together; it may have fewer coordinates, the first ones, where it depends on no others.

        Args:
            held: Numbers of pieces, those of the whole.

        Raises:
            IndicatorError: For numbers of no pieces, or a shape that is not taken apart.
        """
        raise IndicatorError(f"{self.name}: it has no pieces")

    @abstractmethod
    def dilated(self, margin: float) -> "Shape":
        """The object and all points within ``margin`` of it (in space, where there is a time); itself for its own margin.

        Raises:
            IndicatorError: For a margin that is negative or not finite, or a shape that is dilated already.
        """

    @abstractmethod
    def to_grid(self, *, resolution: int | None = None, margin: float = 0.0):
        """An ``IndicatorGrid`` of closed cells that hold every point within ``margin`` of the shape.

        Args:
            resolution: Cells along the longest side of the dilated object, 2 to 1024; a default of the shape's own for
                ``None``.
            margin: Object units, at least 0.

        Raises:
            IndicatorError: For an impossible resolution or margin, or more cells than this machine can hold.
        """

    def _new_margin(self, margin: float) -> float | None:
        """A margin to dilate by, checked; ``None`` where the shape has it already, or there is none."""
        margin = checked_margin(margin)
        if margin in (0.0, self.margin):
            return None
        if self.margin:
            raise IndicatorError(f"{self.name}: the shape is dilated by {self.margin} already, got margin={margin}")
        return margin
