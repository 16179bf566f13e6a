"""Distance queries: n numbers, the coordinates of a point in object space. How far is the object, at least?

It is no kind of query with a yes or no (``QUERIES``), so there is no oracle of it: the truth is what shapes tell
(``Shape.distances``), and a radius makes a yes or no of it.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_bounding.errors import ShapeError
from warp_bounding.queries.domain import EXTENTS, PointMap, json_number
from warp_bounding.rounding import UNIT32, round_up
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.shape import Shape


@dataclass(frozen=True)
class DistanceQuery:
    """What other floors say of distance queries."""

    name: str = "distance"
    positive: str = "distance"
    every: str = "every point, inside the domain or outside"
    is_region: bool = False

    @staticmethod
    def columns(ndim: int) -> int:
        """Numbers of a query."""
        return ndim

    coordinates = columns


DISTANCE = DistanceQuery()


# From object coordinates to those that a distance is computed in, which are larger or smaller alike on all axes.
#
# A point ``x`` becomes ``v = (x - center) * scale``, where ``center`` is float32 and ``scale`` a power of two, the
# same on all axes: a distance in v is one in object space times ``scale``, exactly. So the map rounds once, in the
# difference: on each axis by ``UNIT32 |v|`` at most, or by ``TINY scale`` where a difference is set to zero. A float32
# query is exact; there is no ``delta``.
#
# The object lies in the box ``|v_k| <= limit_k``. For any point v, with p the point of the box that is nearest to it,
# and any point y of the object, ``|v - y|^2 >= |v - p|^2 + |p - y|^2``, since the box is convex and so ``(v - p) . (y
# - p) <= 0``. Hence
#
#     d(v)^2 >= |v - p|^2 + d(p)^2,
#
# and whoever knows a lower bound of the distance in the box knows one everywhere. No tighter combination of these two
# numbers holds for all objects in the box: it is the distance itself for an object that lies at right angles behind p.
#
# Where coordinate 0 is time, distances are in space at a time, so that this holds at each time for the other
# coordinates. Time has a power of two of its own. The object's points move by no more than ``speed`` a unit of time,
# so that a distance at one time bounds those at others. Outside the range of time nothing is known: ``limit`` is
# rounded up there as well, so that the first and the last keyframe are inside; the few float32 numbers beyond them
# that are inside with them are times at which there is no object to miss.

EVALUATED = 1.0 + 1e-12  # covers the float64 evaluation of a few sums and products
COARSEST = 2.0**-12  # of the domain's longest side: float32 must tell apart points in it that are this far apart


def object_box(shape: Shape) -> tuple[np.ndarray, np.ndarray]:
    """``(n,)`` float64 each, corners of a box that holds the object; of a grid the box around the occupied cells."""
    if not isinstance(shape, Grid):
        return shape.lower, shape.upper
    cells = shape.occupied
    low, high = shape.position(cells.min(axis=0) - 0.5), shape.position(cells.max(axis=0) + 0.5)
    return np.nextafter(low, -np.inf), np.nextafter(high, np.inf)


@dataclass(frozen=True, eq=False)
class DistanceDomain(PointMap):
    """The box that holds the object, and the map to local space, where it lies in about [-1, 1]^n.

    Attributes:
        center: ``(n,)`` float32, object space.
        scale: ``(n,)`` float32, per object unit: the same power of two n times; per unit of time another one.
        limit: ``(n,)`` float32: no point of the object has a larger ``|v|``.
        lower: ``(n,)`` float64, lower corner of the box in object space.
        upper: ``(n,)`` float64, upper corner.
        time: Coordinate 0 is time.
        speed: Then, how fast points of the object move at most; object units per unit of time, float32.
    """

    center: np.ndarray
    scale: np.ndarray
    limit: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    time: bool = False
    speed: float = 0.0

    query = DISTANCE.name
    unbounded, joints = False, None  # as ``Domain`` has them

    @classmethod
    def of(cls, shape: Shape, room: float = 0.0) -> "DistanceDomain":
        """The domain of a shape; ``ShapeError`` if it is too large, too small or too far away, or its speed is unknown.

        The domain reaches beyond the object by ``room`` of the longest side, on every side: methods that are asked in
        the domain only are tighter around the object with some.
        """
        if not shape.time:
            return cls.around(*object_box(shape), room, shape.name)
        if shape.speed is None:
            raise ShapeError(f"{shape.name}: it is not known how fast it moves")
        lower, upper = shape.lower, shape.upper
        still = cls.around(lower[1:], upper[1:], room, shape.name)
        times = cls.around(lower[:1], upper[:1], 0.0, f"{shape.name}, its time")
        joined = [
            np.concatenate([getattr(part, k) for part in (times, still)])
            for k in ("center", "scale", "limit", "lower", "upper")
        ]
        return cls(*joined, time=True, speed=float(round_up(shape.speed)))

    @classmethod
    def around(cls, lower: np.ndarray, upper: np.ndarray, room: float = 0.0, name: str = "box") -> "DistanceDomain":
        """The domain of all in a box ``(n,)``, ``(n,)`` float64; ``name`` is for messages, the rest as for ``of``."""
        longest = float((upper - lower).max())
        if not EXTENTS[0] <= longest <= EXTENTS[1]:
            raise ShapeError(
                f"{name}: expected an extent from {EXTENTS[0]:.3g} to {EXTENTS[1]:.3g}, got {longest:.3g}; choose "
                "other units"
            )
        lower, upper = lower - room * longest, upper + room * longest
        center = ((lower + upper) / 2).astype(np.float32)
        reach = np.maximum(upper - center, center - lower).max() * EVALUATED
        if not UNIT32 * max(np.abs(lower).max(), np.abs(upper).max()) <= COARSEST * longest:
            far = max(np.abs(lower).max(), np.abs(upper).max())
            raise ShapeError(
                f"{name}: float32 tells points too coarsely apart at coordinates up to {far:.3g} for an extent of "
                f"{longest:.3g}; move the shape to its origin"
            )
        scale = np.full(len(center), 2.0 ** -np.ceil(np.log2(reach)), dtype=np.float32)
        limit = round_up(np.maximum(upper - center, center - lower) * scale * EVALUATED)
        return cls(center, scale, limit, lower, upper)

    def fault(self) -> str | None:
        """What is wrong with these numbers, in a few words; ``None`` if every claim of this class holds for them."""
        arrays = [self.center, self.scale, self.limit, self.lower, self.upper]
        if not all(a.shape == (self.ndim,) and np.isfinite(a).all() for a in arrays) or self.ndim == 0:
            return "the domain's numbers are not finite or not one per axis"
        scales = self.scale[[-1, 0] if self.time else [-1]]
        mantissas, exponents = np.frexp(scales.astype(np.float64))
        one = (self.scale[int(self.time) :] == self.scale[-1]).all()
        if not (one and (mantissas == 0.5).all() and (np.abs(exponents) <= 62).all()):
            return "the domain's scale is not one power of two"
        if not (0 <= self.speed < np.inf and self.speed == np.float32(self.speed)) or (
            self.speed > 0 and not self.time
        ):
            return "the domain's speed is not a float32 number of at least 0, or there is no time"
        if not (self.lower <= self.upper).all():
            return "the domain's corners are no box's"
        low, high = -self.to_local(self.lower), self.to_local(self.upper)
        if not (self.limit >= np.maximum(low, high) * (1 + 1e-13)).all() or not (self.limit <= 2).all():
            return "the domain's limit does not fit its corners"
        if self.time and not self.limit[0] <= round_up(np.maximum(low, high)[0] * EVALUATED):
            return "the domain's limit reaches beyond its range of time"
        return None

    @property
    def delta(self) -> np.ndarray:
        """``(n,)`` float64, zeros: a float32 query is exact."""
        return np.zeros(self.ndim)

    @property
    def unit(self) -> float:
        """Object units of one local unit, a power of two."""
        return 1.0 / float(self.scale[-1])

    @property
    def header(self) -> np.ndarray:
        """float32 numbers in front of the threshold in a kernel's ``parameters``: center, limit, scale, unit."""
        return np.concatenate([self.center, self.limit, [self.scale[-1], np.float32(self.unit)]])

    @property
    def extra(self) -> np.ndarray:
        """float32 numbers behind the threshold and the share: where there is time, its scale and the speed."""
        return np.array([self.scale[0], self.speed] if self.time else [], np.float32)

    def clipped(self, v: np.ndarray) -> np.ndarray:
        """The nearest points of the domain to ``(N, n)`` local coordinates, at their time."""
        limit = self.limit.astype(np.float64)
        p = np.clip(v, -limit, limit)
        if self.time:
            p[:, 0] = v[:, 0]
        return p

    def sample_at(self, v: np.ndarray) -> np.ndarray:
        """``to_object`` of samples ``(N, n)`` within the range of time.

        ``limit`` is that rounded up, and beyond it nothing is known to compare with.
        """
        x = self.to_object(v)
        if self.time:
            x[:, 0] = np.clip(x[:, 0], self.lower[0], self.upper[0])
        return x

    def to_dict(self) -> dict:
        """JSON-ready numbers; float32 values survive the trip exactly."""
        numbers = {k: [float(a) for a in getattr(self, k)] for k in ("center", "scale", "limit", "lower", "upper")}
        return numbers | ({"speed": self.speed} if self.time else {})

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "DistanceDomain":
        """Inverse of ``to_dict``; raises ``ValueError`` for numbers that are not a domain's (``fault``)."""
        arrays = cls.read(values, ("lower", "upper"))
        moving = {"time": True, "speed": float(json_number(values["speed"], "speed"))} if "speed" in values else {}
        domain = cls(**arrays, **moving)
        if fault := domain.fault():
            raise ValueError(fault)
        return domain
