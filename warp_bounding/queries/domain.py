"""From object coordinates to the coordinates that a bounder computes with, and what rounding does on the way.

A point ``x`` in object space becomes ``v = (x - center) * scale``, two float32 operations. ``center`` and ``scale``
are float32 numbers, so the map itself is exact and only its evaluation rounds: relatively, by ``gamma(2)``. Input
given in float64 is rounded to float32 first. Every ``v`` that the pipeline can make of a point of the object is within
``delta`` of the exact one, and proofs run over the object widened by ``delta``. It is chosen larger than the rounding
of this map needs (a 4096th of a cell), so that the rounding of a placement, given at query time, fits in as well;
``Placement`` checks that it does.

``|v| <= limit`` is the widened domain. Nothing outside it can be in the object, and no bounder is queried there. On
the axis of time, where the answer outside is *maybe*, the limit lies inside the range instead, by twice the rounding.
Where the object is unbounded (``Complement``) the answer outside is *maybe* on every axis, and proofs run over
all of ``|v| <= limit``. Values of joints are *maybe* beyond their limits; angles are reduced to one turn before the map
(``joints``).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from warp_bounding.errors import ShapeError
from warp_bounding.rounding import TINY, UNIT32, UNIT64, gamma, round_down, round_up
from warp_bounding.shapes.joints import Joints
from warp_bounding.shapes.shape import Shape

DELTA_SHARE = 1.0 / 4096.0  # of a detail (of a grid, a cell): the input error allowed for where rounding needs less
# Delta is at least this many times the map's rounding: with room for a placement, or of periodic joints without it.
PLACED, TURNED = 4.0, 1.0 + 2.0**-4
DELTA_LARGEST_SHARE = 1.0 / 16.0  # of a detail: a shape that needs more is refused
EXTENTS = (2.0**-60, 2.0**60)  # object units, of a domain: products with its scale then stay far from float32's ends
LIMIT_LEAST, LIMIT_MOST = 0.5, 2.0  # of |v|: a domain's ends and limit lie between; all methods' rounding counts on it
# Leaves room, 2^-44 of the largest coordinate, for the float64 rounding of cells' positions far from the origin, and of
# the difference between a query and a frame's origin (2^-53 of it).
POSITIONS_ROUNDING = 1.0 + 2.0**-20
SINGLE, DOUBLE = ("center", "scale", "limit"), ("delta", "lower", "upper")  # float32 and float64 fields of a domain
GROWTH = 1.0 + 1e-9  # covers the float64 evaluation of the bounds below, whose relative error is under 1e-14


class PointMap:
    """What domains of points share: the map ``v = (x - center) * scale``."""

    query: ClassVar[str]
    length = None
    tested_as_point, tested_as_region = True, False  # ``v`` is one point of the space that is bounded

    @property
    def ndim(self) -> int:
        """Number of coordinates."""
        return len(self.center)

    space_ndim = columns = ndim  # the dimension of the object, and how many numbers a query has

    @property
    def base(self):
        """The domain of points: this one."""
        return self

    def to_local(self, x: np.ndarray) -> np.ndarray:
        """``v`` of object coordinates ``(..., n)``, in float64."""
        return (np.asarray(x, dtype=np.float64) - self.center) * self.scale.astype(np.float64)

    def to_object(self, v: np.ndarray) -> np.ndarray:
        """Object coordinates of ``v``, in float64."""
        return np.asarray(v, dtype=np.float64) / self.scale.astype(np.float64) + self.center

    @staticmethod
    def read(values: dict, double: Sequence[str]) -> dict[str, np.ndarray]:
        """Arrays of a file: float64 ones, and float32 ones; raises ``ValueError`` for numbers that are not float32."""
        found = {k: np.array([json_number(a, k) for a in values[k]]) for k in (*SINGLE, *double)}
        for name in SINGLE:
            with np.errstate(over="ignore"):
                single = found[name].astype(np.float32)
            if not (single == found[name]).all():
                raise ValueError(f"the domain's {name} must be float32 numbers, got {values[name]}")
            found[name] = single
        return found


@dataclass(frozen=True, eq=False)
class Domain(PointMap):
    """The box that a bounder was made for, and the map to local space, where that box is about [-1, 1]^n.

    Attributes:
        center: ``(n,)`` float32, object space.
        scale: ``(n,)`` float32, per object unit; ``v`` runs over about [-1, 1].
        limit: ``(n,)`` float32: a query with a larger ``|v|`` is certainly outside; on the axis of time, one with no
            larger ``|v|`` is certainly inside.
        delta: ``(n,)`` float64, input error that the proofs cover, in units of ``v``.
        time: Coordinate 0 is time: outside its range the answer is *maybe*.
        lower: ``(n,)`` float64, lower corner of the domain in object space.
        upper: ``(n,)`` float64, upper corner.
        unbounded: The object may be anywhere outside the domain: there the answer is *maybe*.
        joints: Limits and periods, where the coordinates are those of joints.
    """

    center: np.ndarray
    scale: np.ndarray
    limit: np.ndarray
    delta: np.ndarray
    time: bool
    lower: np.ndarray
    upper: np.ndarray
    unbounded: bool = False
    joints: Joints | None = None

    query, oracle_length = "point", 1.0

    @classmethod
    def of(cls, shape: Shape, *, least_delta: np.ndarray | float = 0.0) -> "Domain":
        """The domain of a shape; ``delta``, in units of ``v``, is at least ``least_delta``.

        Raises:
            ShapeError: If float32 cannot resolve details of the shape where it lies (``Shape.details_per_unit``;
                the input error would exceed a 16th of one), or the shape is too large or too small for float32
                arithmetic.
        """
        lower, upper = shape.frame
        if not ((upper - lower >= EXTENTS[0]) & (upper - lower <= EXTENTS[1])).all():
            found = ", ".join(f"{e:.3g}" for e in upper - lower)
            raise ShapeError(
                f"{shape.name}: expected extents from {EXTENTS[0]:.3g} to {EXTENTS[1]:.3g}, got {found}; choose other "
                "units"
            )
        center = ((lower + upper) / 2).astype(np.float32)
        scale = (2 / (upper - lower)).astype(np.float32)
        detail = scale / shape.details_per_unit
        extent = np.maximum(np.abs(lower - center), np.abs(upper - center)) * scale.astype(np.float64) * GROWTH
        needed = input_rounding(center, scale, extent, lower, upper, shape.joints)
        turns = np.zeros(len(lower)) if shape.joints is None else np.array(shape.joints.period)
        room = np.where(turns > 0, TURNED, PLACED)
        delta = np.maximum(np.maximum(DELTA_SHARE * detail, room * needed), least_delta)
        if (delta > shape.largest_delta * detail).any():
            axis = int(np.argmax(delta / detail))
            raise ShapeError(
                f"{shape.name}: float32 cannot tell details of {1 / shape.details_per_unit[axis]:.3g} apart at "
                f"coordinates up to {max(abs(lower[axis]), abs(upper[axis])):.3g} (axis {axis}); move the shape to "
                "its origin or use a lower resolution"
            )
        limit = round_up(extent + delta * (1 + 1e-6))
        if shape.time:
            inner = min(upper[0] - center[0], center[0] - lower[0]) * float(scale[0])
            limit[0] = round_down(inner - 2 * needed[0])
        return cls(center, scale, limit, delta, shape.time, lower, upper, shape.unbounded, shape.joints)

    def fault(self, blur: np.ndarray | float = 0.0) -> str | None:
        """What is wrong with these numbers, in a few words; ``None`` if every claim of this class holds for them.

        ``delta`` must also cover ``blur``, ``(n,)``, object units (``shapes.recentred``).
        """
        arrays = [self.center, self.scale, self.limit, self.delta, self.lower, self.upper]
        if not all(a.shape == (self.ndim,) and np.isfinite(a).all() for a in arrays) or self.ndim == 0:
            return "the domain's numbers are not finite or not one per axis"
        extents = self.upper - self.lower
        if not ((extents >= EXTENTS[0]) & (extents <= EXTENTS[1]) & (self.scale > 0)).all():
            return "the domain's extents or scale are impossible"
        if self.joints is not None and (len(self.joints.lower) != self.ndim or self.joints.fault()):
            return "the limits and periods of joints are none, or not one per axis"
        low, high = -self.to_local(self.lower), self.to_local(self.upper)
        if not ((np.minimum(low, high) >= LIMIT_LEAST) & (self.limit <= LIMIT_MOST)).all():
            return "the domain's map does not take it to about [-1, 1]"
        extent = np.maximum(low, high) * GROWTH
        needed = input_rounding(self.center, self.scale, extent, self.lower, self.upper, self.joints)
        blurred = blur * self.scale.astype(np.float64) * GROWTH
        if not (needed * POSITIONS_ROUNDING + blurred <= self.delta).all():
            return "the domain's delta does not cover the rounding of its own map"
        covered = self.limit >= np.maximum(low, high) * (1 + 1e-12) + self.delta
        if self.time:
            covered[0] = 0 < self.limit[0] <= (np.minimum(low, high) - needed - blurred)[0]
        return None if covered.all() else "the domain's limit does not fit its corners"

    @cached_property
    def reach(self) -> np.ndarray:
        """``(n,)`` float64: largest coordinates of a point of the domain, in absolute value, object space."""
        return np.maximum(np.abs(self.lower), np.abs(self.upper)) + self.delta / self.scale.astype(np.float64)

    @property
    def header(self) -> np.ndarray:
        """float32 numbers in front of the threshold in a kernel's ``parameters``."""
        return np.concatenate([self.center, self.scale, self.limit])

    @property
    def extra(self) -> np.ndarray:
        """float32 numbers behind the threshold: those of joints."""
        return np.zeros(0, np.float32) if self.joints is None else self.joints.numbers

    def widened(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The boxes, in ``v``, that hold every input the pipeline can make from boxes in object space (P_delta).

        They are cut at ``limit``, as the domain test lets nothing else through.
        """
        reach = self.delta * GROWTH + 1e-15 * (1 + np.abs(self.to_local(self.lower)))
        limit = self.limit.astype(np.float64)
        return np.maximum(self.to_local(lower) - reach, -limit), np.minimum(self.to_local(upper) + reach, limit)

    def origins(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The boxes in object space that hold every point of which the pipeline can make a v in boxes of ``v``.

        A query given in float64 counts as it is given.
        """
        scale, center = self.scale.astype(np.float64), self.center.astype(np.float64)
        reach = self.delta * GROWTH
        low, high = (lower - reach) / scale, (upper + reach) / scale
        room = 8 * UNIT64 * (np.maximum(np.abs(low), np.abs(high)) + np.abs(center))  # of five roundings
        return low + center - room, high + center + room

    def to_dict(self) -> dict:
        """JSON-ready numbers; float32 values survive the trip exactly."""
        arrays = {k: getattr(self, k) for k in ("center", "scale", "limit", "delta", "lower", "upper")}
        flags = {"time": self.time} | ({"unbounded": True} if self.unbounded else {})
        flags |= {} if self.joints is None else {"joints": self.joints.to_dict()}
        return {k: [float(a) for a in v] for k, v in arrays.items()} | flags

    @classmethod
    def from_dict(cls, values: dict) -> "Domain":
        """Inverse of ``to_dict``; raises ``ValueError`` for numbers that are not a domain's (``fault``)."""
        arrays = cls.read(values, DOUBLE)
        flags = {"time": values["time"], "unbounded": values.get("unbounded", False)}
        flags = {name: json_bool(value, name) for name, value in flags.items()}
        joints = Joints.from_dict(values["joints"], json_number) if "joints" in values else None
        domain = cls(**arrays, **flags, joints=joints)
        fault = domain.fault()
        if fault:
            raise ValueError(fault)
        return domain


def json_number(value: Any, name: str) -> float:
    """``value`` as a float, if it is a JSON number; raises ``ValueError`` for anything else, also for ``true``."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{name} must be a number, got {value!r}")
    return float(value)


def json_bool(value: Any, name: str) -> bool:
    """``value`` itself, if it is a JSON truth value; raises ``ValueError`` for anything else."""
    if not isinstance(value, bool):
        raise ValueError(f"{name} must be true or false, got {value!r}")
    return value


def rounding_of_map(extent: np.ndarray) -> np.ndarray:
    """Largest error of the evaluated ``(x - center) * scale`` for ``|v| <= extent``: two roundings, relative."""
    return gamma(2) * extent


def input_rounding(center, scale, extent, lower, upper, joints: Joints | None = None) -> np.ndarray:
    """Largest error of ``v`` of a float64 point in the domain: from rounding it, reducing angles, and the map."""
    reach = np.maximum(np.abs(lower), np.abs(upper))
    reach = reach if joints is None else np.maximum(reach, joints.reach)
    flushed = 2 * TINY * scale.astype(np.float64) + TINY  # the input or the difference set to zero; the product
    return rounding_of_map(extent) + UNIT32 * reach * scale.astype(np.float64) * (1 + gamma(2)) + flushed
