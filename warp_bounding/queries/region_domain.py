"""From a region (a query that is a set of points) to the coordinates ``v`` that a bounder computes with.

The file of each kind of query says what v is. Only the part of a region inside the domain counts, in time too; a region
wholly outside the range of time is *maybe*. So is one that is given from farther away than ``FAR`` (``queries.base``)
and may meet the domain.

``base`` is the domain of points, with a ``delta`` that covers what the map of regions rounds: *for every point x of
the object in an exact region, the region that the pipeline computes with passes x within* ``base.delta`` *on every
axis.* ``base.delta`` is larger than that map needs, by up to ``PLACED``, so that a shape may be placed in the world
(``Placement``).
"""

from dataclasses import dataclass, replace
from functools import cached_property
from operator import attrgetter

import numpy as np

from warp_bounding.errors import BounderError
from warp_bounding.queries import QUERIES
from warp_bounding.queries.base import Query
from warp_bounding.queries.domain import DELTA_LARGEST_SHARE, GROWTH, POSITIONS_ROUNDING, Domain, json_bool, json_number
from warp_bounding.rounding import round_down
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.shape import Shape

SPACE = "geometric"  # a constant field of files: queries are tested against what bounds the object
PLACED = 2.0**-12  # local units: what delta allows for the rounding of a placement, beyond the map's own
# Local units, a ray's displacement on each axis: the least is far above ``PARALLEL``; a ray as long as the largest
# rounds by more than delta may be, unless a cell is half of the domain or more.
STRETCHES = (2.0**-60, 2.0**16)
PLACED_SHARE = 1.0 / 32.0  # of a cell: map and placement together get no more than this, unless the map alone needs it


def domain_of(grid: Grid, query: str = "point", length: float = 1.0) -> "Domain | RegionDomain":
    """The domain of a kind of query; rays have ``length``, object units.

    Raises ``ShapeError`` if float32 cannot resolve cells where the grid lies, ``BounderError`` if it cannot at the end
    of such a ray.
    """
    return RegionDomain.of(grid, query, length) if QUERIES[query].is_region else Domain.of(grid)


@dataclass(frozen=True, eq=False)
class RegionDomain:
    """The coordinates of a kind of region.

    ``space_ndim`` is the dimension n of the object; ``ndim`` is the length of v: 2n, or n + 1 for planes.

    Attributes:
        query: ``"ray"``, ``"plane"`` or ``"box"``.
        base: The domain of points.
        time: Coordinate 0 of the object is time.
        length: Of a ray, object units; ``None`` for other regions.
    """

    query: str
    base: Domain
    time: bool
    length: float | None = None

    @classmethod
    def of(cls, grid: Shape, query: str, length: float = 1.0) -> "RegionDomain":
        if grid.unbounded:
            raise BounderError(f"{grid.name}: {query} queries are not bounded from the inside, points are")
        if grid.joints is not None:
            raise BounderError(
                f"{grid.name}: {query} queries of configurations are not bounded, points are; see clear_segments"
            )
        # The base takes time as an axis like the others; the region's own test compares it with the range of time
        # (``extra``).
        still = replace(grid, time=False) if isinstance(grid, Grid) else grid
        base, kind = Domain.of(still), QUERIES[query]
        length = float(length) if kind.has_length else None
        cell = base.scale / grid.details_per_unit
        # The rounding of the map grows with the limit, and the limit with delta: take the largest that delta may reach.
        most_delta = DELTA_LARGEST_SHARE * cell
        widest_base = replace(base, limit=(base.limit + most_delta).astype(np.float32))
        needed = kind.rounding(widest_base, length)
        # Refuses only what is due to the length; ``Domain.of`` refuses the rest, with its own message.
        if length and (needed > most_delta).any() and (kind.rounding(widest_base, 0.0) <= most_delta).all():
            raise BounderError(
                f"{grid.name}: a ray of length {length:g} is so long that float32 cannot tell cells apart at its end"
            )
        # What the map needs (``fault`` checks it again), and room for a placement unless that would cost too much.
        with_placement = np.minimum(needed + PLACED, PLACED_SHARE * cell)
        least_delta = np.maximum(needed * POSITIONS_ROUNDING * GROWTH, with_placement)
        domain = cls(query, Domain.of(still, least_delta=least_delta), grid.time, length)
        fault = domain.fault()
        if fault:
            raise BounderError(f"{grid.name}: {fault}")
        return domain

    def fault(self, blur: np.ndarray | float = 0.0) -> str | None:
        kind = QUERIES.get(self.query)
        if kind is None or not kind.is_region:
            return f"{self.query} is not a kind of region"
        if (self.length is None) == kind.has_length or not np.isfinite(self.length or 1.0) or (self.length or 1) <= 0:
            return f"a ray's length must be positive, got {self.length}"
        fault = self.base.fault(blur)
        if fault or self.base.time or self.base.unbounded or self.base.joints is not None:
            return fault or "a region's base domain has no time and no joints of its own, and ends"
        least, most = STRETCHES
        if not ((self.stretch >= least) & (self.stretch <= most)).all():
            return f"a ray of length {self.length} does not fit a domain of this size"
        needed = kind.rounding(self.base, self.length)
        blurred = blur * self.base.scale.astype(np.float64) * GROWTH
        if not (needed * POSITIONS_ROUNDING + blurred <= self.base.delta).all():
            return "the domain's delta does not cover the rounding of its own map"
        return None

    # The domain of points has these under the same names: they are about the object.
    space_ndim, lower, upper, center, scale, header = (
        property(attrgetter(f"base.{name}")) for name in ("ndim", "lower", "upper", "center", "scale", "header")
    )

    unbounded, joints = False, None  # as ``Domain`` has them
    tested_as_point, tested_as_region = False, True  # v is a set of points of the object's space

    @property
    def oracle_length(self) -> float:
        """A ray's length, as oracles and samplers take it; for other regions 1, which they do not read."""
        return 1.0 if self.length is None else self.length

    @property
    def kind(self) -> Query:
        """The kind of query."""
        return QUERIES[self.query]

    @property
    def columns(self) -> int:
        return 2 * self.base.ndim

    @property
    def ndim(self) -> int:
        """Length of v."""
        return self.kind.coordinates(self.base.ndim)

    @cached_property
    def stretch(self) -> np.ndarray:
        return self.kind.stretch(self.base, self.length)

    @cached_property
    def limit(self) -> np.ndarray:
        return self.kind.limit(self)

    @cached_property
    def delta(self) -> np.ndarray:
        return self.kind.delta(self)

    @property
    def extra(self) -> np.ndarray:
        """float32 numbers behind the threshold in ``parameters``.

        Of a ray ``stretch`` (n), of a plane ``1 / scale`` (n), which takes an object-space normal to local space, of a
        box nothing. Where coordinate 0 is time, one more: a local coordinate 0 of at most this, in absolute value,
        certainly lies inside the range of time, rounding included.
        """
        own = self.kind.extra(self)
        if not self.time:
            return own
        low, high = -self.base.to_local(self.lower)[0], self.base.to_local(self.upper)[0]
        return np.append(own, round_down(min(low, high) - 2 * self.kind.rounding(self.base, self.length)[0]))

    def to_local(self, q: np.ndarray) -> np.ndarray:
        """``v`` ``(N, ndim)`` float64 of finite queries ``(N, 2 n)`` in object space that meet the domain."""
        return self.kind.to_local(self, np.asarray(q, dtype=np.float64))

    def to_object(self, v: np.ndarray) -> np.ndarray:
        """A query ``(N, 2 n)`` float64 in object space for each ``v`` ``(N, ndim)``."""
        return self.kind.to_object(self, np.asarray(v, dtype=np.float64))

    def to_dict(self) -> dict:
        own = {"query": self.query, "space": SPACE, "length": self.length}
        return self.base.to_dict() | own | {"moving": self.time}  # "time" is a key of the base, whose time is False

    @classmethod
    def from_dict(cls, values: dict) -> "Domain | RegionDomain":
        """The domain of points or of regions that ``to_dict`` wrote; raises ``ValueError`` for other numbers."""
        base = Domain.from_dict(values)
        if "query" not in values:
            return base
        length = values["length"]
        length = None if length is None else json_number(length, "length")
        if values["space"] != SPACE:
            raise ValueError(f"volumes in {values['space']} space are gone: fit one around the object")
        domain = cls(values["query"], base, json_bool(values["moving"], "moving"), length)
        fault = domain.fault()
        if fault:
            raise ValueError(fault)
        return domain


AnyDomain = Domain | RegionDomain
