"""Intersections of slabs (pairs of parallel half-spaces), which ``aabb``, ``obb`` and ``kdop`` have in common.

``f(v)`` is the least distance to a slab's faces, ``min_k min(a_k . v - low_k, high_k - a_k . v)``; it is concave, so
its minimum over a box is exact in closed form. The faces are the supports of the object's cells (Ericson, *Real-Time
Collision Detection*, ch. 4), widened so that rounding cannot cut anything off. Rays, planes and boxes are tested
against the same slabs.
"""

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, product
from typing import Any, ClassVar, NamedTuple

import numpy as np

from warp_bounding.bounders.bounder import Bounder, Option
from warp_bounding.errors import BounderError
from warp_bounding.geometry import MOST_VERTEX_DIMENSIONS, checked_inverse, polytope_vertices, whole_hull
from warp_bounding.kernels.source import Lanes, Source
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.queries.base import GUARD, PARALLEL
from warp_bounding.queries.boundary import ObjectSupport, outline
from warp_bounding.queries.domain import Domain
from warp_bounding.queries.region_domain import AnyDomain, RegionDomain
from warp_bounding.rounding import TINY, UNIT64, gamma, round_down, round_up
from warp_bounding.runtime.native import constants, fill, literal, native_text
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.shape import Shape

text = native_text("volumes.h")
SLOW = fill(text.SLOW, parallel=literal(PARALLEL))

# --- volumes ---------------------------------------------------------------------------------------------------------
#
# Volumes of points that regions are tested against as a whole: what slabs, ellipsoids and half-spaces have in common.


class VolumeTest:
    """The test of one kind of query against a volume; that of points also has ``bound``, as ``Bounder`` does."""

    weights: np.ndarray  # (K,) float32, as ``Bounder.weights`` gives them
    error: float  # of points: ``Bounder.rounding_bound``; of regions: how far computed f may lie under ``reference``

    def reference(self, v: np.ndarray) -> np.ndarray:
        """``(N,)`` float64: f of points; of regions the largest value of the volume's f on each, or more."""
        raise TypeError(f"{type(self).__name__} does not define reference")


@dataclass(frozen=True)
class VolumeSource(Source):
    """Native code of a volume's tests: a text for each kind; the class's own fields are its constants, in capitals."""

    texts: ClassVar[Mapping[str, str | Callable[[Any], str]]]  # by the kind of query that is tested
    numbers: ClassVar[Mapping[str, object]] = {
        "slow": SLOW,
        "clip": text.CLIP,
        "parallel": literal(PARALLEL),
        "guard": literal(GUARD),
    }

    def body(self, lanes: Lanes) -> str:
        test, shared = self.texts[self.query], Source.__dataclass_fields__
        own = {name.upper(): value for name, value in vars(self).items() if name not in shared}
        filled = fill(test(self) if callable(test) else test, **self.numbers)
        return f"{{ {constants(N=self.ndim, **own)}{filled}}}\n"


class VolumeBounder(Bounder):
    """A volume of points, which regions are tested against.

    A subclass has the numbers of its volume (``shape``), and tests made from these and a domain.
    """

    of_volume = True
    tests: ClassVar[Mapping[str, Callable[..., Any]]]  # by the kind of query that is tested

    @classmethod
    def supports(cls, query: str, ndim: int) -> bool:
        return super().supports(query, ndim) or (query in cls.tests and ndim >= 2)

    @classmethod
    def takes_shapes(cls, query: str) -> bool:
        return not cls.lays_cells

    @property
    @abstractmethod
    def shape(self) -> Any:
        """The numbers of the volume in float64, as its tests take them."""

    @cached_property
    def test(self) -> Any:
        """The test of the volume, a ``VolumeTest``."""
        return self.tests[self.query_kind](self.shape, self.domain)

    def weights(self) -> np.ndarray:
        return self.test.weights

    def reference(self, v: np.ndarray) -> np.ndarray:
        return self.test.reference(np.asarray(v, dtype=np.float64))

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """See ``Bounder``; exact up to float64 rounding. Raises ``BounderError`` for regions, which have a volume."""
        if self.volume is not None:
            raise BounderError(f"{self.method}: {self.query_kind} queries are proven by their volume")
        return self.test.bound(lower, upper)

    def rounding_bound(self) -> float:
        return self.test.error

    def exact_on_hull(self, shape: Shape) -> bool:
        """See ``Bounder``: f of points is concave, so least over a hull where it is least over the object."""
        return whole_hull(shape) is not None

    def least(self, grid: Shape) -> tuple[float, int]:
        """See ``Bounder``; of a shape without cells over the hull of the object (``geometry``)."""
        if isinstance(grid, Grid):
            return super().least(grid)
        hull, volume = whole_hull(grid), self.volume or self
        if hull is None:
            raise BounderError(f"{self.method}: {grid.name} has no known convex hull; give a resolution")
        least, count = volume.hull_least(ObjectSupport(grid, self.domain.base, hull))
        if self.volume is None:  # f is computed only within the limit, so its least there is a lower bound, too
            limit = self.domain.limit.astype(np.float64)[None]
            least = max(least, float(self.bound(-limit, limit).lower[0]))
        return least, count

    @abstractmethod
    def hull_least(self, support: ObjectSupport) -> tuple[float, int]:
        """``least`` over the convex hull of the object's points."""

    def check_range(self) -> None:
        if self.volume is not None:
            self.volume.check_range()
        super().check_range()

    @property
    def nbytes(self) -> int:
        """See ``Bounder``; of a region's test, the numbers that it reads, not the tensors that they follow from."""
        if self.volume is None:
            return super().nbytes
        return self._head_bytes + 4 * len(self.weights())


# --- native text -----------------------------------------------------------------------------------------------------


def _plane(source: Source) -> str:
    """Of a parallelepiped by its edges, of other polytopes by their vertices."""
    return text.CORNERS if source.slabs > source.ndim else text.SLABS_EDGES


TEXTS = {"point": text.SLABS_POINT, "ray": text.SLABS_RAY, "plane": _plane, "box": text.SLABS_BOX}


# --- regions ---------------------------------------------------------------------------------------------------------
#
# Points, rays, planes and boxes against an intersection of slabs ``P = {y: low_k <= d_k . y <= high_k}``.
#
# * Point: the least distance to a face.
# * Ray: the segment is clipped by every slab (Kay and Kajiya 1986). The slabs are widened by the largest rounding of
# ``d . a`` and ``d . w``; a quotient then has a relative error of a few roundings, and parameters lie in [0, 1].
# * Plane: against P's support. Where there are n slabs, P is a parallelepiped and its support a sum over its edges;
# with more slabs the support is the largest value at P's vertices. Exact.
# * Box: the intervals of the box and of P on the slabs' directions. Where P is a box that is turned, also on the
# coordinate axes and, in 3D, on the cross products of the edges (Gottschalk et al. 1996): exact in 2D and 3D. For
# turned boxes in 4D and above, and for k-DOPs (whose classic test this is), conservative: an exact test would need
# more directions.
#
# Every test of a region decides between *meets P* (f >= 0 up to rounding) and *misses P*: nothing is claimed of points
# outside P. What a test reads (edges, vertices, widened faces) follows from the slabs alone, so a file holds nothing
# that could contradict them.

CLEARANCE = 2.0**-60  # a face is at least this far from P where a ray may run along it: far more than PARALLEL


class Slabs(NamedTuple):
    """The numbers of P, as float64: directions ``(k, n)``, low and high ``(k,)``; diagonal: axes are directions.

    Half-spaces are slabs whose low is minus infinity.
    """

    directions: np.ndarray
    low: np.ndarray
    high: np.ndarray
    diagonal: bool

    def numbers(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """float32, as bodies read slabs with these faces: the directions follow them unless they are the axes."""
        return np.concatenate([low, high, () if self.diagonal else self.directions.reshape(-1)]).astype(np.float32)

    @property
    def largest(self) -> np.ndarray:
        """``(k,)``, the larger size of each slab's faces."""
        return np.maximum(np.abs(self.low), np.abs(self.high))


class SlabPoint(VolumeTest):
    """The least distance to a face; numbers: low, high, directions unless diagonal."""

    def __init__(self, slabs: Slabs, domain: AnyDomain):
        self.slabs, self.weights = slabs, slabs.numbers(slabs.low, slabs.high)
        self.sizes = np.abs(slabs.low) + np.abs(slabs.high)
        # |d . v| is at most ``reach``. Its n products and sums (none if diagonal) round by gamma(n + 1) reach, the
        # subtraction of a face by gamma(2) of all that enters. Each of 2 n + 2 results may be set to zero, which takes
        # up to TINY; so may a factor, which takes up to TINY times the other factor, an entry of d or of the limit.
        n, limit, size = domain.ndim, domain.limit.astype(np.float64), np.abs(slabs.directions)
        reach = size @ limit
        product = 0.0 if slabs.diagonal else gamma(n + 1) * reach
        flushed = (2 * n + 2 + size.sum(axis=1) + domain.limit.sum()) * TINY
        self.error = float((product + gamma(2) * (reach + product + slabs.largest) + flushed).max())

    def reference(self, v: np.ndarray) -> np.ndarray:
        y = v @ self.slabs.directions.T
        return np.minimum(y - self.slabs.low, self.slabs.high - y).min(axis=1)

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """``Bounder.bound`` of boxes of points."""
        d, low, high, _ = self.slabs
        center, half = (lower + upper) / 2, (upper - lower) / 2
        y, reach = center @ d.T, half @ np.abs(d).T
        slack = np.concatenate([y - reach - low, high - y - reach], axis=1)
        size = np.abs(lower).max(axis=0) + np.abs(upper).max(axis=0)
        rounding = gamma(2 * d.shape[1] + 8, UNIT64) * float((size @ np.abs(d).T + self.sizes).max())
        normal = np.concatenate([d, -d])[np.argmin(slack, axis=1)]
        point = np.where(normal > 0, lower, upper)
        return BoxBounds(slack.min(axis=1) - rounding, np.argmax(half, axis=1), point, self.reference(point))


class SlabRay(VolumeTest):
    """Slab clipping; numbers: widened low, widened high, directions unless diagonal; f is 0 or -1, without an error."""

    error = 0.0

    def __init__(self, slabs: Slabs, domain: RegionDomain):
        n = domain.space_ndim
        limit, size = domain.limit.astype(np.float64), np.abs(slabs.directions)
        largest = size @ limit[:n] + size @ limit[n:] + slabs.largest
        if not (largest < 2.0**40).all():
            raise BounderError("numbers are so large that float32 quotients may overflow")
        # At a point a + t w of P in the domain, |a| and t |w| are at most the limit and twice that, however long the
        # ray is.
        flushed = 8 * (n + 1) * (1 + largest) * TINY
        rounding = 0.0 if slabs.diagonal else gamma(n + 2) * 3 * (size @ limit[:n]) + flushed
        room = (rounding + 2 * CLEARANCE) * (1 + 1e-9)
        # And one float32 more: where low is so large that float64 loses CLEARANCE, float32 numbers are farther apart
        # than that.
        low = np.nextafter(round_down(slabs.low - room), np.float32(-np.inf))
        high = np.nextafter(round_up(slabs.high + room), np.float32(np.inf))
        self.slabs, self.weights = slabs, slabs.numbers(low, high)

    def reference(self, v: np.ndarray) -> np.ndarray:
        """See ``VolumeTest``; without the widening for rounding."""
        d, low, high, _ = self.slabs
        n = d.shape[1]
        y, s = v[:, :n] @ d.T, v[:, n:] @ d.T
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.sort(np.stack([(low - y) / s, (high - y) / s]), axis=0)
        within = (y >= low) & (y <= high)
        near = np.where(s != 0, ends[0], np.where(within, -np.inf, np.inf)).max(axis=1)
        away = np.where(s != 0, ends[1], np.inf).min(axis=1)
        return np.where(np.maximum(near, 0) <= np.minimum(away, 1), 0.0, -1.0)


class SlabPlane(VolumeTest):
    """Support of P; f is a distance.

    Its numbers are the centre and half edges (only these if diagonal), or a number of vertices and the vertices.
    """

    def __init__(self, slabs: Slabs, domain: RegionDomain):
        n, reach = domain.space_ndim, float(domain.limit[-1])
        if len(slabs.low) == n:
            inverse, error = (np.eye(n), np.zeros((n, n))) if slabs.diagonal else _inverse(slabs.directions)
            error = error + gamma(n + 3, UNIT64) * np.abs(inverse)
            middle, half = (slabs.low + slabs.high) / 2, (slabs.high - slabs.low) / 2
            exact = np.concatenate([(inverse @ middle)[None], (inverse * half).T])  # (1 + n, n)
            away = np.concatenate([(error @ np.abs(middle))[None], (error * np.abs(half)).T])
            numbers = exact.astype(np.float32)
            size = np.abs(numbers.astype(np.float64)).sum() + reach
            moved = (np.abs(numbers - exact) + away).sum()
            self.weights = np.concatenate([numbers[0], np.diag(numbers[1:])]) if slabs.diagonal else numbers.reshape(-1)
            self.corners = False
        else:
            numbers, away = polytope_vertices(slabs.directions, slabs.low, slabs.high)
            size, moved = np.abs(numbers.astype(np.float64)).sum(axis=1).max() + reach, away.sum(axis=1).max()
            self.weights, self.corners = np.concatenate([[np.float32(len(numbers))], numbers.reshape(-1)]), True
        self.numbers, self.slabs = numbers.astype(np.float64), slabs
        # Entries of m are at most 1. Products and sums of up to n + 1 rows, in any order, and two subtractions.
        self.error = float((moved + gamma(2 * n + 5) * size) * (1 + 1e-9) + 8 * (n + 1) ** 2 * (1 + size) * TINY)

    def reference(self, v: np.ndarray) -> np.ndarray:
        at, offset = v[:, :-1] @ self.numbers.T, v[:, -1]
        if self.corners:
            return np.minimum(at.max(axis=1) - offset, offset - at.min(axis=1))
        return np.abs(at[:, 1:]).sum(axis=1) - np.abs(offset - at[:, 0])


class SlabBox(VolumeTest):
    """Intervals on directions; numbers: low, high, directions unless diagonal. f is the least overlap."""

    def __init__(self, slabs: Slabs, domain: RegionDomain):
        n = domain.space_ndim
        tested = slabs if slabs.diagonal or len(slabs.low) != n else _separating(slabs)
        limit, size = domain.limit[:n].astype(np.float64), np.abs(tested.directions)
        reach = size @ limit
        # The middle and the half of the box round once, products and sums as ever; |middle| + half <= limit.
        product = 0.0 if slabs.diagonal else gamma(n + 3) * reach + 8 * (n + 1) * (1 + reach) * TINY
        self.error = float((product + gamma(3) * (reach + product + tested.largest) + 4 * TINY).max() * (1 + 1e-9))
        self.slabs, self.weights = tested, tested.numbers(tested.low, tested.high)

    def reference(self, v: np.ndarray) -> np.ndarray:
        d, low, high, _ = self.slabs
        n = d.shape[1]
        y, r = (v[:, :n] + v[:, n:]) / 2 @ d.T, (v[:, n:] - v[:, :n]) / 2 @ np.abs(d).T
        return np.minimum(y + r - low, high - (y - r)).min(axis=1)


def _inverse(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    found = checked_inverse(directions)
    if found is None:
        raise BounderError("the slabs' directions are not independent")
    return found


def _separating(slabs: Slabs) -> Slabs:
    """The slabs of a parallelepiped, and those along the axes and, in 3D, products of axes and edges."""
    n = slabs.directions.shape[1]
    inverse, error = _inverse(slabs.directions)
    more = list(np.eye(n))
    if n == 3:
        for axis, edge in product(np.eye(3), inverse.T):
            normal = np.cross(axis, edge / np.abs(edge).max())
            if np.abs(normal).max() > 1e-3:
                more.append(normal / np.abs(normal).max())
    more = np.array(more).astype(np.float32).astype(np.float64)
    share = more @ inverse  # each direction as a sum of the slabs' directions
    away = np.abs(more) @ (error + gamma(n + 2, UNIT64) * np.abs(inverse))
    first, last = share * slabs.low, share * slabs.high
    room = (away + gamma(n + 2, UNIT64) * np.abs(share)) @ slabs.largest
    low = round_down(np.minimum(first, last).sum(axis=1) - room).astype(np.float64)
    high = round_up(np.maximum(first, last).sum(axis=1) + room).astype(np.float64)
    sides = zip(slabs[:3], (more, low, high), strict=True)
    return Slabs(*(np.concatenate(pair) for pair in sides), False)


TESTS = {"point": SlabPoint, "ray": SlabRay, "plane": SlabPlane, "box": SlabBox}  # by the name of the kind of query


AT_ONCE = 1 << 16  # cells or points whose boxes are projected at a time, so that memory stays small


@dataclass(frozen=True)
class SlabsSource(VolumeSource):
    """Native code of the slab test; ``diagonal`` slabs are the axes of ``v`` themselves and cost no product.

    Numbers: ``low[k] high[k]``, then the ``k x n`` directions unless diagonal; of regions, see *regions*.
    """

    slabs: int
    diagonal: bool

    texts = TEXTS
    numbers = VolumeSource.numbers | {"row": text.SLABS_ROW}


class FaceBounder(VolumeBounder):
    """Volumes between flat faces; f of a region is 0 or more where it meets the volume."""

    shape: Slabs

    def least(self, grid: Shape) -> tuple[float, int]:
        """See ``Bounder``; 0 for regions. Raises ``BounderError`` if the volume does not hold all of the object.

        A region that meets the object meets a volume that holds it, and the tests of regions are 0 or more there.
        """
        least, count = super().least(grid)
        if self.volume is None:
            return least, count
        if not least >= 0:
            raise BounderError(f"{self.method}: the faces do not hold all of the object")
        return 0.0, count

    def hull_least(self, support: ObjectSupport) -> tuple[float, int]:
        directions, low, high, _ = self.shape
        two_sided = np.isfinite(low).all()
        reach = support(np.concatenate([directions, -directions]) if two_sided else directions)
        slack = np.concatenate([high, -low] if two_sided else [high]) - reach
        return float(np.nextafter(slack.min(), -np.inf)), len(reach)


class SlabBounder(FaceBounder):
    """Base of the slab methods: they differ in their directions only.

    Tensors: ``directions`` ``(k, n)`` in the coordinates of points (absent for ``aabb``), ``low`` and ``high``
        ``(k,)``.
    """

    tests = TESTS
    diagonal = False
    of_samples: ClassVar[bool] = False  # the directions follow from samples, and not from their dimension alone

    @classmethod
    def fit(cls, grid: Shape, domain: AnyDomain, *, device: str | None = None, **options) -> "SlabBounder":
        """The tightest faces around a grid's occupied cells, or around the outline of a shape without cells.

        ``options`` are those of ``sampled_directions``.
        """
        base, gridded = domain.base, isinstance(grid, Grid)
        points = np.empty((0, base.ndim))
        if cls.of_samples:
            points = grid.position(grid.occupied) if gridded else outline(grid)
        local = np.eye(base.ndim)
        if not cls.diagonal:
            local = cls.sampled_directions(points, **options) / base.scale.astype(np.float64)
            local = local.astype(np.float32).astype(np.float64)
        if gridded:
            low, high = cls._faces_of_cells(grid, base, local)
        else:
            support = ObjectSupport(grid, base, whole_hull(grid))
            low, high = -support(-local), support(local)
        room = 2 * SlabPoint(Slabs(local, low, high, cls.diagonal), base).error
        # Of faces that are widened by twice the rounding bound, the proof finds a threshold of about zero.
        tensors = {} if cls.diagonal else {"directions": local.astype(np.float32)}
        return cls(domain, tensors | {"low": round_down(low - room), "high": round_up(high + room)}, {}, device)

    @staticmethod
    def _faces_of_cells(grid: Grid, base: Domain, local: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        cells = _ends(grid.occupancy)
        low, high = np.full(len(local), np.inf), np.full(len(local), -np.inf)
        for start in range(0, len(cells), AT_ONCE):
            part = cells[start : start + AT_ONCE]
            lower, upper = base.widened(grid.position(part - 0.5), grid.position(part + 0.5))
            center, half = (lower + upper) / 2 @ local.T, (upper - lower) / 2 @ np.abs(local).T
            low, high = np.minimum(low, (center - half).min(axis=0)), np.maximum(high, (center + half).max(axis=0))
        return low, high

    @classmethod
    def sampled_directions(cls, samples: np.ndarray) -> np.ndarray:
        """``(k, m)`` float64, slab normals for ``(N, m)`` samples, in their units; the axes by default.

        Unless the class is ``of_samples``, N may be 0.
        """
        return np.eye(samples.shape[1])

    def check_tensors(self) -> None:
        n = self.domain.base.ndim
        count = n if self.diagonal else max(len(self.tensors.get("directions", ())), 1)
        directions = {} if self.diagonal else {"directions": (count, n)}
        self.expect_shapes(directions | {"low": (count,), "high": (count,)})
        self.check_range()

    @property
    def shape(self) -> Slabs:
        low, high = self.tensors["low"].astype(np.float64), self.tensors["high"].astype(np.float64)
        if self.domain.tested_as_region and (low > high).any():
            raise BounderError(f"{self.method}: a slab's low face is above its high face")
        return Slabs(self.directions, low, high, self.diagonal)

    @property
    def directions(self) -> np.ndarray:
        """``(k, n)`` float64, slab normals in the coordinates of points."""
        return np.eye(self.domain.base.ndim) if self.diagonal else self.tensors["directions"].astype(np.float64)

    @property
    def source(self) -> SlabsSource:
        return self.source_of(SlabsSource, len(self.test.slabs.low), self.diagonal)


def _ends(occupancy: np.ndarray) -> np.ndarray:
    """First and last occupied cells of every grid line along the last axis, where linear functions are extreme."""
    first = occupancy & (np.cumsum(occupancy, axis=-1) == 1)
    last = occupancy & (np.cumsum(occupancy[..., ::-1], axis=-1)[..., ::-1] == 1)
    return np.argwhere(first | last)


# --- aabb, obb and kdop ----------------------------------------------------------------------------------------------


class Aabb(SlabBounder):
    """Axis-aligned box (the paper's AABox): n slabs along the coordinates, tested without a product."""

    method = "aabb"
    diagonal = True


class Obb(SlabBounder):
    """Oriented box (the paper's OBox); its axes are eigenvectors of the cells' covariance, as in the paper's code."""

    method = "obb"
    of_samples = True

    @classmethod
    def sampled_directions(cls, samples: np.ndarray) -> np.ndarray:
        return np.linalg.eigh(np.atleast_2d(np.cov(samples.T, ddof=0)))[1].T


HEXAGON = np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)], [-0.5, np.sqrt(0.75)]])  # unit normals of the slabs of a hexagon
BY_VERTICES = ("plane",)  # kinds of query that are tested against the polytope's vertices


class Kdop(SlabBounder):
    """Discretely oriented polytope (Klosowski et al. 1998; the paper's kDOP): k half-spaces in k/2 slabs.

    By default k = 4 m as in the paper: the m axes and the m normals that are all ones but for one zero. In 2D those
    would be the axes again, so the diagonals take their place; 6 half-spaces in 2D are a hexagon's. In 3D the usual 14,
    18 and 26 are offered too.
    """

    method = "kdop"
    options = (
        Option(
            "k", None, "half-spaces, 4 for each dimension by default; in 2D also 6, in 3D 6, 14, 18 or 26", parse=int
        ),
    )

    @classmethod
    def supports(cls, query: str, ndim: int) -> bool:
        """See ``Bounder``; planes are tested against the vertices, whose number grows quickly."""
        return super().supports(query, ndim) and (query not in BY_VERTICES or ndim <= MOST_VERTEX_DIMENSIONS)

    @classmethod
    def sampled_directions(cls, samples: np.ndarray, k: int | None = None) -> np.ndarray:
        return kdop_directions(samples.shape[1], k)


def kdop_directions(ndim: int, k: int | None = None) -> np.ndarray:
    """``(k / 2, n)`` float64, unit slab normals of a k-DOP.

    ``k`` is ``None`` for 4 n half-spaces, 6 in 2D, or 6, 14, 18 or 26 in 3D.

    Raises:
        BounderError: If ``k`` is not offered in this dimension.
    """
    if ndim == 2 and k == len(HEXAGON) * 2:
        return HEXAGON
    axes = np.eye(ndim)
    edges = [axes[a] + s * axes[b] for a, b in combinations(range(ndim), 2) for s in (1, -1)]
    edges = np.array(edges).reshape(-1, ndim)
    if k is None or k == 4 * ndim:
        more = edges if ndim == 2 else 1 - axes if ndim > 2 else axes[:0]
    elif ndim == 3 and k in (6, 14, 18, 26):
        corners = np.array([(1, *s) for s in product((1, -1), repeat=2)])
        more = np.concatenate([corners] * (k in (14, 26)) + [edges] * (k in (18, 26)) + [axes[:0]])
    else:
        offered = {2: "8 and 6", 3: "12, 6, 14, 18 and 26"}.get(ndim, str(4 * ndim))
        raise BounderError(f"kdop offers k = {offered} in {ndim}D, got k={k!r}")
    directions = np.concatenate([axes, more])
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)
