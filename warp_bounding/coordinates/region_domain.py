"""From a region (ray, plane, box) in object space to the coordinates ``v`` that a bounder computes with.

In local space, where the domain is about [-1, 1]^n:

* ray: ``v = (a, w)``, the segment ``a + t w``, 0 <= t <= 1: origin, moved up to where the ray enters the domain, and displacement
  over the whole length (so a ray from outside is bounded by a longer one, never a shorter one);
* plane: ``v = (m, c)``, all y with ``m . y = c``, where the entry of m that is largest in absolute value is exactly 1: the
  normals are the faces of a cube, and a plane has one pair of them, not two;
* box: ``v = (low, high)``, cut at the domain;
* in parametric space (the paper's way to fit its classic volumes) v are a query's own numbers: ray and box as above, a plane
  its unit normal and its point; a point outside the domain is answered with *maybe*.

A region counts by its part inside the domain, in time too; one that lies wholly outside the range of time is answered with
*maybe*. So is one that is given from farther away than ``locate.FAR`` half-widths and may meet the domain.

``base`` is the domain of points, with a ``delta`` that covers what the map of regions rounds: *for every point x of the
object in an exact region, the region that the pipeline computes with passes x within* ``base.delta`` *on every axis.* It is
larger than that map needs by ``PLACED``, so that a shape may be placed in the world (``Placement``).
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from warp_bounding.arithmetic import TINY, gamma, round_down, round_up
from warp_bounding.coordinates.domain import (
    DELTA_LARGEST_SHARE,
    GROWTH,
    POSITIONS,
    Domain,
    input_rounding,
    number,
    truth,
)
from warp_bounding.coordinates.native_map import FAR, GUARD, SMALLEST, SUMMED
from warp_bounding.errors import BounderError
from warp_bounding.indicators.grid import IndicatorGrid

__all__ = ["RegionDomain", "domain_of"]

REGIONS = ("ray", "plane", "box")
PARAMETRIC = "parametric"
SPACES = ("geometric", PARAMETRIC)
PLACED = 2.0**-12  # domain half-widths: the error of a placement that proofs allow for,
PLACED_SHARE = 1.0 / 32.0  # but no more than this share of a cell in all


def domain_of(
    grid: IndicatorGrid, query: str = "point", length: float = 1.0, space: str = "geometric"
) -> "Domain | RegionDomain":
    """The domain of a kind of query.

    Args:
        grid: The object.
        query: Kind of query.
        length: Of a ray, object units.
        space: ``"geometric"`` or ``"parametric"``; the same for points.

    Raises:
        IndicatorError: If float32 cannot resolve the grid's cells where the grid lies.
        BounderError: If the length is so large that float32 cannot resolve the cells along a ray.
    """
    return Domain.of(grid) if query == "point" else RegionDomain.of(grid, query, length, space)


@dataclass(frozen=True, eq=False)
class RegionDomain:
    """The coordinates of a kind of region.

    Attributes:
        query: ``"ray"``, ``"plane"`` or ``"box"``.
        space: ``"geometric"`` or ``"parametric"``.
        base: The domain of points.
        time: Coordinate 0 of the object is time.
        length: Of a ray, object units; ``None`` for other regions.
    """

    query: str
    space: str
    base: Domain
    time: bool
    length: float | None = None

    @classmethod
    def of(cls, grid: IndicatorGrid, query: str, length: float = 1.0, space: str = "geometric") -> "RegionDomain":
        """See ``domain_of``."""
        still = replace(grid, time=False)
        base = Domain.of(still)
        length = float(length) if query == "ray" else None
        cell = base.scale / grid.cells_per_unit
        largest = replace(
            base, limit=(base.limit + DELTA_LARGEST_SHARE * cell).astype(np.float32)
        )  # limit grows with delta
        needed = region_rounding(largest, query, length)
        if (
            length
            and (needed > DELTA_LARGEST_SHARE * cell).any()
            and (region_rounding(largest, query, 0.0) <= DELTA_LARGEST_SHARE * cell).all()
        ):
            raise BounderError(
                f"{grid.name}: a ray of length {length:g} is so long that float32 cannot tell cells apart at its end"
            )
        spare = np.minimum(needed + PLACED, PLACED_SHARE * cell)
        domain = cls(
            query, space, Domain.of(still, room=np.maximum(needed * POSITIONS * GROWTH, spare)), grid.time, length
        )
        fault = domain.fault()
        if fault:
            raise BounderError(f"{grid.name}: {fault}")
        return domain

    def fault(self) -> str | None:
        """What is wrong with these numbers, in a few words; ``None`` if every claim of this class holds for them."""
        if self.query not in REGIONS or self.space not in SPACES:
            return f"{self.query} in {self.space} space is not a kind of region"
        if (
            (self.length is None) != (self.query != "ray")
            or not np.isfinite(self.length or 1.0)
            or (self.length or 1) <= 0
        ):
            return f"a ray's length must be positive, got {self.length}"
        fault = self.base.fault()
        if fault or self.base.time:
            return fault or "a region's base domain has no time of its own"
        if not np.isfinite(self.stretch).all() or (self.stretch > 2.0**16).any() or (self.stretch < 2.0**-60).any():
            return f"a ray of length {self.length} does not fit a domain of this size"
        needed = region_rounding(self.base, self.query, self.length)
        if not (needed * POSITIONS <= self.base.delta).all():
            return "the domain's delta does not cover the rounding of its own map"
        return None

    @property
    def parametric(self) -> bool:
        """The numbers of a query are themselves the point that is bounded, in a space of 2n dimensions."""
        return self.space == PARAMETRIC

    @property
    def tested_as_point(self) -> bool:
        """``v`` is one point of the space that is bounded."""
        return self.parametric

    @property
    def tested_as_region(self) -> bool:
        """``v`` is a set of points of the space that is bounded: the object's."""
        return not self.parametric

    # --- sizes -------------------------------------------------------------------------------------------------------

    @property
    def space_ndim(self) -> int:
        """Dimension n of the indicator."""
        return self.base.ndim

    @property
    def columns(self) -> int:
        """Numbers of a query."""
        return 2 * self.base.ndim

    @property
    def ndim(self) -> int:
        """Number of coordinates ``v``."""
        return self.base.ndim + 1 if self.query == "plane" and self.space == "geometric" else self.columns

    @property
    def lower(self) -> np.ndarray:
        """``(n,)`` float64, lower corner of the domain in object space."""
        return self.base.lower

    @property
    def upper(self) -> np.ndarray:
        """``(n,)`` float64, upper corner."""
        return self.base.upper

    @property
    def center(self) -> np.ndarray:
        """``(n,)`` float32, object space."""
        return self.base.center

    @property
    def scale(self) -> np.ndarray:
        """``(n,)`` float32, per object unit."""
        return self.base.scale

    @cached_property
    def stretch(self) -> np.ndarray:
        """``(n,)`` float32, a ray's displacement in local space, per axis and unit direction; ones for other regions."""
        if self.query != "ray":
            return np.ones(self.base.ndim, np.float32)
        with np.errstate(over="ignore"):
            return (self.base.scale.astype(np.float64) * self.length).astype(np.float32)

    @cached_property
    def limit(self) -> np.ndarray:
        """``(ndim,)`` float32, largest ``|v|`` that a bounder is asked about."""
        n, base = self.base.ndim, self.base.limit.astype(np.float64)
        if self.query == "box":
            return np.concatenate([self.base.limit, self.base.limit])
        if self.query == "ray":
            return np.concatenate([self.base.limit, round_up(self.stretch * (1 + gamma(16)))])
        if self.parametric:
            return np.concatenate([round_up(np.full(n, 1 + gamma(16))), self.base.limit])
        offset = (base.sum() * (1 + GUARD) + FAR * SUMMED) * (1 + gamma(2 * n + 16))
        return np.concatenate([np.ones(n, np.float32), [round_up(offset)]]).astype(np.float32)

    @cached_property
    def delta(self) -> np.ndarray:
        """``(ndim,)`` float64, the input error of ``v`` that proofs cover.

        A plane's m counts as exact: what it rounds is added to the offset, which is then off by that from every point.
        """
        n = self.base.ndim
        if self.query == "box":
            return np.concatenate([self.base.delta, self.base.delta])
        if self.query == "ray":
            return np.concatenate([self.base.delta, direction_rounding(n) * self.stretch.astype(np.float64)])
        if self.parametric:
            return np.concatenate([np.full(n, direction_rounding(n)), self.base.delta])
        return np.concatenate([np.zeros(n), [self.base.delta.sum()]])  # |m| <= 1 on every axis

    @property
    def header(self) -> np.ndarray:
        """float32 numbers in front of the threshold, and those behind it (``extra``)."""
        return self.base.header

    @property
    def extra(self) -> np.ndarray:
        """float32, see ``locate.extra_count``."""
        own = {"ray": self.stretch, "plane": (1 / self.base.scale.astype(np.float64)).astype(np.float32)}
        parts = [own.get(self.query, np.zeros(0, np.float32)), self._time_limit]
        return np.concatenate(parts)

    @property
    def _time_limit(self) -> np.ndarray:
        """``(1,)`` float32, or none where there is no time: twice the rounding inside its range, as for points."""
        if not self.time:
            return np.zeros(0, np.float32)
        low, high = -self.base.to_local(self.lower)[0], self.base.to_local(self.upper)[0]
        return round_down([min(low, high) - 2 * region_rounding(self.base, self.query, self.length)[0]])

    # --- the map, in float64 -----------------------------------------------------------------------------------------

    def to_local(self, q: np.ndarray) -> np.ndarray:
        """``v`` of finite queries that meet the domain, in float64.

        Args:
            q: ``(N, 2 n)``, object space.

        Returns:
            ``(N, ndim)`` float64. A ray's origin is taken as it is, not moved to where it enters the domain.
        """
        q, n = np.asarray(q, dtype=np.float64), self.base.ndim
        first, second = q[:, :n], q[:, n:]
        if self.query == "box":
            limit = self.base.limit.astype(np.float64)
            return np.clip(np.concatenate([self.base.to_local(first), self.base.to_local(second)], 1), *_both(limit))
        if self.query == "ray":
            unit = second / np.linalg.norm(second, axis=1, keepdims=True)
            return np.concatenate([self.base.to_local(first), unit * self.stretch.astype(np.float64)], axis=1)
        if self.parametric:
            return np.concatenate([first / np.linalg.norm(first, axis=1, keepdims=True), self.base.to_local(second)], 1)
        normal = first / self.base.scale.astype(np.float64)
        pivot = np.argmax(np.abs(normal), axis=1)
        normal = normal / normal[np.arange(len(q)), pivot][:, None]
        return np.concatenate([normal, (normal * self.base.to_local(second)).sum(axis=1, keepdims=True)], axis=1)

    def to_object(self, v: np.ndarray) -> np.ndarray:
        """A query ``(N, 2 n)`` float64 in object space for each ``v`` ``(N, ndim)``."""
        v, n = np.asarray(v, dtype=np.float64), self.base.ndim
        if self.query == "box":
            return np.concatenate([self.base.to_object(v[:, :n]), self.base.to_object(v[:, n:])], axis=1)
        if self.query == "ray":
            return np.concatenate([self.base.to_object(v[:, :n]), v[:, n:] / self.stretch.astype(np.float64)], axis=1)
        if self.parametric:
            return np.concatenate([v[:, :n], self.base.to_object(v[:, n:])], axis=1)
        normal = v[:, :n]
        foot = normal * (v[:, n:] / (normal * normal).sum(axis=1, keepdims=True))
        return np.concatenate([normal * self.base.scale.astype(np.float64), self.base.to_object(foot)], axis=1)

    # --- keeping it --------------------------------------------------------------------------------------------------

    def to_dict(self) -> dict:
        """JSON-ready numbers."""
        return self.base.to_dict() | {
            "query": self.query,
            "space": self.space,
            "moving": self.time,
            "length": self.length,
        }

    @classmethod
    def from_dict(cls, values: dict) -> "Domain | RegionDomain":
        """The domain of points or of regions that ``to_dict`` wrote; raises ``ValueError`` for numbers that are not a domain's."""
        base = Domain.from_dict(values)
        if "query" not in values:
            return base
        length = values["length"]
        length = None if length is None else number(length, "length")
        domain = cls(values["query"], values["space"], base, truth(values["moving"], "moving"), length)
        fault = domain.fault()
        if fault:
            raise ValueError(fault)
        return domain


def _both(limit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    both = np.concatenate([limit, limit])
    return -both, both


def direction_rounding(ndim: int) -> float:
    """Relative error of an entry of a unit direction: a division, the norm of n squares, a division, a float64 input's rounding."""
    return gamma(ndim + 10)


def region_rounding(base: Domain, query: str, length: float | None) -> np.ndarray:
    """``(n,)``: how far, per axis of local space, the computed region may pass a point of the exact one.

    An origin or a plane's point lies within FAR half-widths (``locate``); ``reach`` is what float64 input is rounded by there.
    """
    n = base.ndim
    scale = base.scale.astype(np.float64)
    if query == "box":
        return input_rounding(base.center, base.scale, base.limit.astype(np.float64), base.lower, base.upper)
    around = FAR * (1 + gamma(4)) / scale
    extent = np.full(n, FAR * (1 + gamma(4)))
    origin = input_rounding(base.center, base.scale, extent, base.center - around, base.center + around)
    if query == "ray":
        # Moved by up to its distance to the domain, in one product and one sum, by a t that is early by GUARD at most.
        moved = (gamma(8) + 3 * GUARD) * (FAR + 2)
        turned = (direction_rounding(n) + gamma(4)) * scale * length
        return origin + moved + turned + 4 * TINY
    # The offset m . a of a plane: entries of m are off by gamma(7), of which 2 are float64 input's, and by numbers that are
    # subnormal or flushed; products and sum by gamma(n + 2).
    limit = base.limit.astype(np.float64)
    tilt = (gamma(7) + 4 * TINY / SMALLEST) * (FAR * (1 + gamma(4)) + limit.sum()) + (2 * n + 4) * TINY
    return np.full(n, float(tilt + gamma(n + 2) * FAR * (1 + gamma(8)) + origin.sum() * (1 + gamma(8))))
