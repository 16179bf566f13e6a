"""The part of a space that is seen: two or three coordinates run, the others are held at values, as time is."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from warp_bounding.errors import QueryError

__all__ = ["MOST_SEEN", "Section"]

LEAST_SEEN, MOST_SEEN = 2, 3  # coordinates that a picture has
NAMES = ("x", "y", "z")


@dataclass(frozen=True)
class Section:
    """A plane or a space that cuts an n-dimensional one at right angles to its axes.

    Attributes:
        ndim: n.
        held: The value of each coordinate that is held, by its number.
        time: Coordinate 0 is time.

    Raises:
        QueryError: If a coordinate does not exist, or other than two or three coordinates run.
    """

    ndim: int
    held: Mapping[int, float]
    time: bool = False

    def __post_init__(self) -> None:
        for axis, value in self.held.items():
            if not 0 <= axis < self.ndim:
                raise QueryError(f"slice: expected coordinates 0 to {self.ndim - 1}, got {axis}")
            if not np.isfinite(value):
                raise QueryError(f"slice: expected a finite value of coordinate {axis}, got {value}")
        seen = len(self.axes)
        if seen > MOST_SEEN:
            raise QueryError(
                f"at most {MOST_SEEN} coordinates can be shown, the bounder has {self.ndim}: "
                f"hold {seen - MOST_SEEN} more of them by --slice, such as --slice {self.axes[-1]}=0"
            )
        if seen < LEAST_SEEN:
            raise QueryError(f"at least {LEAST_SEEN} coordinates must run, got {seen} of the bounder's {self.ndim}")

    @property
    def axes(self) -> list[int]:
        """The coordinates that run, ascending."""
        return [axis for axis in range(self.ndim) if axis not in self.held]

    @property
    def names(self) -> list[str]:
        """What the coordinates that run are called: x, y and z where these are all of space, else by their numbers."""
        space = list(range(int(self.time), self.ndim))
        if self.axes == space and len(space) <= len(NAMES):
            return list(NAMES[: len(space)])
        return [f"coordinate {axis}" for axis in self.axes]

    def lift(self, points: np.ndarray) -> np.ndarray:
        """Points ``(N, k)`` of the section as points ``(N, n)`` float32 of the whole space."""
        found = np.empty((len(points), self.ndim), dtype=np.float32)
        found[:, self.axes] = points
        for axis, value in self.held.items():
            found[:, axis] = value
        return found
