"""The contract of a distance bounder: a proven function g with ``g(x) <= distance(x, object)`` for any float32 x.

A method supplies a function F of local coordinates (``DistanceDomain``), and everything else is the same for all of
them:

* ``source``: a ``DistanceSource`` with the native text of F (``body``), and ``whole``, whether F is
  a bound everywhere or in the domain only; and ``weights()``, the float32 numbers that both read;
* ``reference(v)``: the same F in plain NumPy float64, which tests and proofs evaluate;
* ``rounding_bound()``: ``E >= computed F - exact F`` wherever F is queried, ``FLUSHED`` included; where ``whole``, also
  ``growth()``;
* ``volume``, a proven bounder of points, where F is the distance to a volume that holds the object; else ``corners``,
  certified upper bounds of F over boxes, ``pieces``, the boxes that a proof begins with, and ``steepness``;
* ``options``, what users can tell it, and ``supports``.

It is proven when ``threshold <= L - E``, where ``d - F >= L`` on all of the domain, d the local distance (0 in the
object): so the claim has the form of every other certificate's, of ``f = d - F``. ``-threshold`` is the *slack*, what
is taken off F. A new method is one file with a subclass, and a line in ``bounders/__init__.py`` (``register``).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from operator import attrgetter
from typing import Any, ClassVar, NamedTuple

import numpy as np
import warp as wp

from warp_bounding.bounders.bounder import Bounder, Option, checked, taken
from warp_bounding.bounders.volumes import Aabb, Kdop, Obb
from warp_bounding.certificates import Certificate
from warp_bounding.errors import BounderError, QueryError
from warp_bounding.kernels.distances import (
    BOX_STEPS,
    FLUSHED,
    MOST_DIMENSIONS,
    SEGMENT_STEPS,
    DistanceSource,
    box_func,
    box_kernel,
    distance_func,
    lanes_kernel,
    lines_kernel,
    ray_func,
    segment_func,
    share_of,
)
from warp_bounding.kernels.source import Lanes, fill
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.queries.distance import DISTANCE, DistanceDomain
from warp_bounding.queries.domain import Domain, json_number
from warp_bounding.queries.placement import numbers_of
from warp_bounding.queries.point import POINT
from warp_bounding.rounding import TINY, UNIT32, UNIT64, round_down, round_up
from warp_bounding.runtime.arrays import compact, new_output
from warp_bounding.runtime.launch import launch_blocks

# --- float64 queries -------------------------------------------------------------------------------------------------
#
# What float64 queries of a distance lose when they are rounded to float32, and lengths that are never too short.
#
# g knows the float32 point alone. The float64 one is farther from it by what is told here, which is added to its radius
# or taken off its bound.

GROWTH = 1.0 + 1e-12  # covers the float64 evaluation of a few sums and products


def moved(bounder: "DistanceBounder", queries: wp.array, count: int, columns: int | None = None) -> np.ndarray:
    """``(N,)`` float64, object units: how far a float64 point is at most from its float32 one, and g's fall meanwhile.

    ``queries`` are flat float32, the point the first ``ndim`` numbers of each.
    """
    x = np.abs(_rows(queries, count, columns or bounder.ndim)[:, : bounder.ndim])
    by, first = (UNIT32 * x + TINY) * GROWTH, int(bounder.domain.time)
    if bounder.frame is not None:  # taking off its origin rounds as well, and its blur counts with it
        by += 2 * UNIT64 * x + bounder.frame.blur
    return (np.linalg.norm(by[:, first:], axis=1) + bounder.pace * by[:, :first].sum(axis=1)) * GROWTH


def turned(rays: wp.array, count: int, lengths: np.ndarray) -> np.ndarray:
    """``(N,)`` float64, object units: how far the end of a ray is at most from where its float64 direction leads."""
    ndim = len(rays) // (2 * count) if count else 1
    largest = np.abs(_rows(rays, count, 2 * ndim)[:, ndim:]).max(axis=1)
    with np.errstate(divide="ignore"):
        turn = UNIT32 + np.sqrt(ndim) * TINY / largest  # twice as much between directions of length 1
    return 2 * turn * lengths.astype(np.float64) * GROWTH


def outwards(flat: wp.array, side: float) -> wp.array:
    """Corners that were float64, each at the next float32 number towards ``side``."""
    return wp.array(np.nextafter(flat.numpy(), np.float32(side)), dtype=wp.float32, device=flat.device)


def longer(lengths: np.ndarray, by: np.ndarray) -> np.ndarray:
    """Lengths, one or ``(N,)``, longer by ``(N,)``, as float32, rounded up; what is not finite is infinite."""
    with np.errstate(invalid="ignore"):
        found = (lengths.astype(np.float64) + by) * GROWTH
    found = np.where(np.isnan(found), np.inf, found)
    return round_up(found).astype(np.float32) if len(found) else lengths


def lengths_of(name: str, given, count: int) -> np.ndarray:
    """A length, or one per query, as float32, rounded up; raises ``QueryError`` for others."""
    if isinstance(given, wp.array):
        given = given.numpy()
    values = numbers_of(given)
    if values is None or values.shape not in ((), (count,)):
        got = repr(given) if values is None else f"shape {values.shape}"
        raise QueryError(f"{name} must be a number of at least 0, or {count} of them, one per query; got {got}")
    values = values.reshape(-1)
    bad = ~(np.isfinite(values) & (values >= 0))
    if bad.any():
        raise QueryError(f"{name} must be finite and at least 0, got {values[bad][0]:g}")
    rounded = round_up(values).astype(np.float32)
    return rounded if len(rounded) else np.zeros(1, np.float32)


def _rows(flat: wp.array, count: int, columns: int) -> np.ndarray:
    """Queries ``(N, columns)`` float64 on the host."""
    return flat.numpy()[: count * columns].reshape(count, columns).astype(np.float64)


# --- the base --------------------------------------------------------------------------------------------------------


def _is_reach(value) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value <= 4


_REACH = "by how much F is asked beyond the object's box, as a share of its longest side"
REACH = Option("reach", 0.1, _REACH, checked("reach", lambda: "a number from 0 to 4", _is_reach, float), float)


class DistanceBounder(Bounder):
    """A lower bound of the distance to an object, 0 in it and wherever nothing better is proven.

    Attributes:
        domain: The box that holds the object, and the map into it.
        threshold: float32, at most 0: what is added to F, the slack with its sign turned. Others are as in ``Bounder``.

    Example:
        >>> far = wb.fit(ball, "distance", "kdop", device="cpu")
        >>> far.certificate.proven
        True
        >>> bool((far.distance(points).numpy() <= ball_distances).all())
        True
    """

    of_distances = True
    highest_threshold = 0.0  # a higher one does not account for rounding
    moving: ClassVar[bool] = False  # whether it has distances of shapes that move
    domain: DistanceDomain

    @classmethod
    def check_domain(cls, domain: Any) -> None:
        if not isinstance(domain, DistanceDomain):
            raise BounderError(f"{cls.method}: expected the domain of a distance, got {type(domain).__name__}")
        if domain.time and not cls.moving:
            raise BounderError(f"{cls.method}: there is no distance of shapes that move")
        if domain.ndim > MOST_DIMENSIONS:
            raise BounderError(f"{cls.method}: distances have at most {MOST_DIMENSIONS} dimensions, got {domain.ndim}")

    # --- what a method supplies --------------------------------------------------------------------------------------

    def growth(self) -> float:
        """Excess of the computed f over F beyond ``rounding_bound``.

        In units ``UNIT32 (|v|_1 + |f|)``; 0 in the domain.
        """
        return 0.0

    def corners(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Numbers at the corners of boxes ``(N, n)``: F is at most what is multilinear between them, certified.

        Each box lies in one of ``pieces``. Returns ``(N, 2^n)`` float64; the corner at place i is the upper one on axis
        k where bit k of i is set.
        """
        raise TypeError(f"{type(self).__name__} does not define corners")

    def pieces(self) -> tuple[np.ndarray, np.ndarray]:
        """Float64 boxes ``(P, n)``, ``(P, n)`` over the domain, where a proof begins; by default the domain."""
        limit = self.domain.limit.astype(np.float64)
        return -limit[None], limit[None]

    @property
    def rate(self) -> float:
        """Where coordinate 0 is time: more than F changes in a local unit of time; local units."""
        raise TypeError(f"{type(self).__name__} does not define rate")

    @property
    def steepness(self) -> float:
        """Bound of how much the corner numbers change by one local unit along each axis, in sum; at least 1."""
        return 1.0

    @classmethod
    def supports(cls, query: str, ndim: int) -> bool:
        """Whether the method has distances of n-dimensional objects."""
        return query == DISTANCE.name and 1 <= ndim <= MOST_DIMENSIONS

    # --- what follows ------------------------------------------------------------------------------------------------

    @cached_property
    def pace(self) -> float:
        """How fast g falls with time at most, and the object moves; object units a unit of time, float32, 0 at rest.

        The distance itself may jump to 0 where a hole closes around a point; g is below it before and after, and falls
        no faster than this.
        """
        if not self.domain.time:
            return 0.0
        own = self.rate * float(self.domain.scale[0]) * self.domain.unit
        return float(round_up(max(own, self.domain.speed)))

    @property
    def extra(self) -> np.ndarray:
        """float32 numbers behind threshold and share: where there is time, its scale, the speed and the pace."""
        return np.append(self.domain.extra, np.float32(self.pace)) if self.domain.time else self.domain.extra

    def _header(self, threshold: np.float32) -> np.ndarray:
        """See ``Bounder``: threshold and the share of a query's size that rounding takes."""
        pace = self.pace / (float(self.domain.scale[0]) * self.domain.unit)  # local units
        share = round_up(share_of(self.ndim, self.growth() + pace))
        return np.concatenate([self.domain.header, [threshold, share], self.extra])

    @property
    def summary(self) -> str:
        return f"distance bounder, {self.ndim}D"

    @property
    def slack(self) -> float:
        """What is taken off F so that it is a lower bound, rounding included; object units."""
        return -float(self.threshold) * self.domain.unit

    @property
    def size(self) -> float:
        """The longest side in space of the box that holds the object, with the domain's room; object units."""
        return float((self.domain.upper - self.domain.lower)[int(self.domain.time) :].max())

    def exact(self, x: np.ndarray) -> np.ndarray:
        """G of points ``(N, n)`` in float64, without what float32 rounds; ``distance`` is close to it, from below."""
        v, n = self.domain.to_local(x), self.ndim
        whole = self.source.whole
        p = v if whole else self.domain.clipped(v)
        value = self.reference(p.reshape(-1, n)) + float(self.threshold)
        if not whole:
            value = np.hypot(np.linalg.norm(v - p, axis=1), np.maximum(value, 0.0))
        if self.domain.time:
            value = np.where(np.abs(v[:, 0]) > self.domain.limit[0], 0.0, value)
        return np.maximum(value, 0.0) * self.domain.unit

    def freeze(self, threshold: float, certificate: Certificate | None) -> "DistanceBounder":
        """See ``Bounder``; raises ``BounderError`` for a threshold above 0, which leaves no room for rounding."""
        if not np.float32(threshold) <= 0:
            raise BounderError(f"{self.method}: the threshold of a distance is at most 0, got {threshold:g}")
        return super().freeze(threshold, certificate)

    @property
    def nbytes(self) -> int:
        """Bytes of data that one query can read; the tag and the lengths in front of them are not counted."""
        words = self.words()
        return self._head_bytes + 4 * len(self.weights()) + (words.nbytes if len(words) > 1 else 0)

    @property
    def tightness(self) -> str:
        """False positives of points at radius 0 in words, as ``fit`` measured them; empty where it did not."""
        rates = self.info.get("rates")
        if not rates:
            return ""
        text = f"{rates['fp_rate']:.2f} % false positives at radius 0 ({rates['samples']:,} samples)"
        return f"{text}, slack {self.slack:.3g}"

    # --- what there is not: a value that is compared with the threshold ----------------------------------------------

    def values(self, *_args, **_options):
        """Refused with ``QueryError``: of a distance ask ``distance``."""
        raise QueryError(
            f"{self.method}: a distance is compared with a radius, not with a threshold; ask distance or query"
        )

    prepare = values
    func = property(fget=None, doc="There is none: kernels ask ``distance_func`` and its like.")

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """Refused with ``BounderError``: proofs of distances ask ``corners``."""
        raise BounderError(f"{self.method}: a distance is bounded by numbers at corners")

    # --- in kernels --------------------------------------------------------------------------------------------------

    @cached_property
    def distance_func(self) -> wp.Function:
        """``distance(data, x: vec_n) -> float`` in object units, for your kernels.

        ``wp.static(b.distance_func)(b.data, x)`` calls it.

        Never above the distance from x to the object, for any float32 x; 0 for NaN and infinity, and for the data of
        another bounder.

        Example:
            >>> @wp.kernel
            ... def step(data: wb.Data, x: wp.array(dtype=wp.vec3), d: wp.array(dtype=float)):
            ...     i = wp.tid()
            ...     d[i] = wp.static(far.distance_func)(data, x[i])
            >>> x, d = wp.array(points, dtype=wp.vec3, device="cpu"), wp.zeros(len(points), dtype=float, device="cpu")
            >>> wp.launch(step, len(points), [far.data, x, d], device="cpu")
            >>> bool((d.numpy() == far.distance(points).numpy()).all())
            True
        """
        self.expect_local("distance_func")
        return distance_func(self.source)

    @cached_property
    def segment_func(self) -> wp.Function:
        """``maybe, t = segment(data, start: vec_n, end: vec_n, radius, steps=32)`` for kernels; see ``segments``."""
        self.expect_local("segment_func")
        return segment_func(self.source)

    @cached_property
    def ray_func(self) -> wp.Function:
        """``maybe, t = ray(data, origin: vec_n, direction: vec_n, length, radius, steps=32)``; see ``rays``."""
        self.expect_local("ray_func")
        return ray_func(self.source)

    @cached_property
    def box_func(self) -> wp.Function:
        """``maybe = box(data, lower: vec_n, upper: vec_n, steps=64)``, for kernels of your own; see ``boxes``."""
        self.expect_local("box_func")
        return box_func(self.source)

    # --- in batches --------------------------------------------------------------------------------------------------

    def distance(self, x, *, out: wp.array | None = None) -> wp.array:
        """Lower bounds of the distance from points to the object.

        Args:
            x: ``(N, n)`` NumPy array, torch tensor, ``wp.array`` or sequence of numbers, or ``wp.array`` of ``vec_n``
                ``(N,)``; object space. float64 is rounded to float32, and what that may move a point by is taken off
                its bound, on the host. Whole numbers must be ones that float32 holds exactly.
            out: ``(N,)`` float32 to write to, instead of a new array.

        Returns:
            ``(N,)`` float32 ``wp.array``, object units, at least 0. 0 for NaN and infinity.

        Raises:
            QueryError: For a wrong shape, dtype or device.

        Example:
            >>> float(far.distance(np.array([[9.0, 0.5, 0.5]], np.float32)).numpy()[0]) > 8
            True
        """
        queries, count, double = self._flat(x, self.ndim, (False,))
        out = new_output(out, count, wp.float32, self.device)
        self.batch_launch(queries, count, None, out, values=True).launch_once()
        if double:
            out.assign(np.fmax(round_down(out.numpy() - moved(self, queries, count)), np.float32(0)))
        return out

    def query(self, x, radius=0.0, *, xform=None, scale=None, out: wp.array | None = None) -> wp.array:
        """Which points may be within a radius of the object.

        Args:
            x: As for ``distance``.
            radius: Number of at least 0, or one per query; object units. float64 is rounded up to float32.
            xform: Not taken: a distance is queried in object space.
            scale: Not taken.
            out: ``(N,)`` bool to write to, instead of a new array.

        Returns:
            ``(N,)`` bool ``wp.array``: true = maybe, false = certainly farther than the radius: ``g(x) > radius``.

        Raises:
            QueryError: For a wrong shape, dtype or device, or a radius that is negative, NaN or not one per query.

        Example:
            >>> far.query(np.array([[0.5, 0.5, 0.5], [9.0, 9.0, 9.0]], np.float32), radius=0.1).numpy()
            array([ True, False])
        """
        if xform is not None or scale is not None:
            raise QueryError(
                "a distance is asked in object space: move the points by the inverse of xform and scale first"
            )
        queries, count, double = self._flat(x, self.ndim, (False,))
        radii = lengths_of("radius", radius, count)
        if double:
            radii = longer(radii, moved(self, queries, count))
        out = new_output(out, count, wp.bool, self.device)
        radii = wp.array(radii, dtype=wp.float32, device=self.device)
        self.batch_launch(queries, count, radii, out).launch_once()
        return out

    def candidates(self, x, radius=0.0) -> tuple[wp.array, wp.array]:
        """Which points may be within a radius, compacted on the device.

        Arguments as in ``query``, result as in ``Bounder.candidates``.
        """
        return compact(self.query(x, radius))

    def segments(self, start, end, radius=0.0, steps: int = SEGMENT_STEPS) -> tuple[wp.array, wp.array]:
        """Which segments may come within a radius of the object, and when first; with a radius they are swept balls.

        Of a shape that moves, segments are of time and space: points (or balls) that move, too. This is conservative
        advancement: *no* means
        that a point which is outside at the start touches no face on its way. It does not mean that the object never
        encloses it on the way without touching it, as a lid does that closes over a point; ``boxes`` and
        ``clear_segments`` mean that, too.

        Args:
            start: ``(N, n)``, as for ``distance``.
            end: ``(N, n)``.
            radius: As for ``query``.
            steps: Evaluations of each at most, at least 1; more of them clear more segments that pass close to the
                object.

        Returns:
            ``(N,)`` bool ``wp.array``, true = maybe; and ``(N,)`` float32, a lower bound of the time of first contact,
            from 0 at the start to 1 at the end; 1 where there is none. NaN and infinity: maybe, at 0.

        Raises:
            QueryError: As in ``query``, and for ``steps`` that is no whole number of at least 1.

        Example:
            >>> start, end = np.array([[[-9.0, 0.5, 0.5]], [[0.5, 0.5, 0.5]]], np.float32)
            >>> maybe, t = far.segments(start, end)
            >>> bool(maybe.numpy()[0]), bool(t.numpy()[0] > 0.9)
            (True, True)
        """
        (a, one), (b, other), count = self._flats(start=start, end=end)
        radii = lengths_of("radius", radius, count)
        if one or other:
            radii = longer(radii, np.maximum(moved(self, a, count), moved(self, b, count)))
        return self._march(a, b, count, np.zeros(1, np.float32), radii, steps, ray=False)

    def rays(self, x, *, length, radius=0.0, steps: int = SEGMENT_STEPS) -> tuple[wp.array, wp.array]:
        """Which rays may come within a radius of the object, and where first.

        Args:
            x: ``(N, 2 n)``, origins and directions of any length.
            length: Of the rays, a number of at least 0, or one per ray; object units.
            radius: As for ``query``.
            steps: As for ``segments``.

        Returns:
            As in ``segments``; times are shares of the length. A direction without a length: maybe, at 0.

        Raises:
            QueryError: As in ``segments``, and for a shape that moves.

        Example:
            >>> maybe, t = far.rays(np.array([[9.0, 0.5, 0.5, 1.0, 0.0, 0.0]], np.float32), length=100.0)
            >>> bool(maybe.numpy()[0])
            False
        """
        if self.domain.time:
            raise QueryError("rays are of shapes at rest; of one that moves ask segments of time and space")
        queries, count, double = self._flat(x, 2 * self.ndim, (False, True))
        lengths, radii = lengths_of("length", length, count), lengths_of("radius", radius, count)
        if double:
            radii = longer(radii, moved(self, queries, count, 2 * self.ndim) + turned(queries, count, lengths))
        return self._march(queries, queries, count, lengths, radii, steps, ray=True)

    def boxes(self, lower, upper, steps: int = BOX_STEPS, *, out: wp.array | None = None) -> wp.array:
        """Which closed boxes may meet the object, by halving them until each part is proven to be clear.

        Of a shape that moves, boxes are of time and space; *no* means that no point of one is in the object at its
        time, enclosed ones included. Long ones in time need many steps.

        Args:
            lower: ``(N, n)``, lower corners, as for ``distance``.
            upper: ``(N, n)``, upper corners.
            steps: Evaluations of each at most, at least 1.
            out: ``(N,)`` bool to write to, instead of a new array.

        Returns:
            ``(N,)`` bool ``wp.array``, true = maybe. NaN, infinity and a box upside down: maybe.

        Raises:
            QueryError: As in ``segments``.

        Example:
            >>> far.boxes(np.array([[2.0, 0, 0]], np.float32), np.array([[3.0, 1, 1]], np.float32)).numpy()
            array([False])
        """
        (a, one), (b, other), count = self._flats(lower=lower, upper=upper)
        if self.frame is not None and any(self.frame.blur):
            raise QueryError(
                "boxes of a grid whose cells stand a little beside the ones asked for are not asked: fit box queries"
            )
        a, b = outwards(a, -np.inf) if one else a, outwards(b, np.inf) if other else b
        out = new_output(out, count, wp.bool, self.device)
        inputs = [0, self.data, a, b, steps_of(steps)]
        launch_blocks(box_kernel(self.source), count, inputs, [out], self.device, first_index=0, block=1)
        return out

    def _flats(self, **points):
        """Two arguments, flat, each with whether it is float64; and how many points each of them has."""
        (first, second), (a, b) = points, [self._flat(x, self.ndim, (False,)) for x in points.values()]
        if a[1] != b[1]:
            raise QueryError(f"{first} and {second} must be as many, got {a[1]} and {b[1]}")
        return (a[0], a[2]), (b[0], b[2]), a[1]

    def _march(self, a, b, count: int, lengths: np.ndarray, radii: np.ndarray, steps: int, *, ray: bool):
        numbers = [wp.array(values, dtype=wp.float32, device=self.device) for values in (lengths, radii)]
        maybe, t = (wp.empty(count, dtype=kind, device=self.device) for kind in (wp.bool, wp.float32))
        many = [int(len(values) > 1) for values in (lengths, radii)]
        data, source, steps = self.data, self.source, steps_of(steps)
        if count:
            lines = wp.empty(count * (2 * self.ndim + 4), dtype=wp.float32, device=self.device)
            inputs = [0, data, a, b, numbers[0], many[0], numbers[1], many[1]]
            launch_blocks(lines_kernel(source, ray), count, inputs, [lines], self.device, first_index=0, block=1)
            inputs = [lines, count, 0, data.parameters, data.words, steps]
            self._launch_of(partial(lanes_kernel, source), count, inputs, [maybe, t]).launch_once()
        return maybe, t


def steps_of(steps: int) -> int:
    """The number of evaluations, checked."""
    if isinstance(steps, bool) or not isinstance(steps, (int, np.integer)) or not 1 <= steps < 2**31:
        raise QueryError(f"steps must be a whole number of at least 1, got {steps!r}")
    return int(steps)


# --- distances to volumes --------------------------------------------------------------------------------------------
#
# Distances to volumes: what the closed forms have in common.
#
# A proven bounder of points denies only points outside a volume ``{x: f(x) >= threshold}`` that holds the object: that
# is its certificate. The distance to the volume, or less, is therefore a lower bound of the distance to the object, and
# needs no proof of its own. The file holds the bounder of points (its tensors; in ``sizes`` its domain, sizes and
# threshold), and everything that the kernel reads follows from these numbers, rounded outwards; ``certify`` proves the
# bounder of points again.
#
# What follows is computed in the coordinates of the ``DistanceDomain``, y, in float64, and charged ``NOISE`` relative
# to all that enters, which is some hundred times what its few sums and products round.

NOISE = 1e-13  # relative to the sizes of all terms: more than float64 rounds in sums and products of them


class Form(NamedTuple):
    """What a kernel computes a distance to a volume from.

    The source is made from ``(ndim, time)`` and sizes, ``numbers`` are its float32 ones, ``error`` is E without
    ``FLUSHED``, ``reference`` is F of ``(N, n)`` float64 local coordinates; for ``growth`` see ``DistanceBounder``.
    """

    source: DistanceSource
    numbers: np.ndarray
    error: float
    growth: float
    reference: Callable[[np.ndarray], np.ndarray]


class VolumeDistance(DistanceBounder):
    """The distance to the volume of a bounder of points.

    A subclass names its class and tells how far the volume is (``form_of``).

    Tensors: those of the bounder of points. Sizes: ``volume``, a table of its ``domain``, ``sizes`` and ``threshold``.
    """

    bounds: ClassVar[type[Bounder]]  # the class of bounders of points

    @classmethod
    def form_of(cls, volume: Bounder, domain: DistanceDomain) -> Form:
        """How far the volume is."""
        raise TypeError(f"{cls.__name__} does not define form_of")

    def __init_subclass__(cls) -> None:
        if "bounds" in cls.__dict__:
            cls.options = tuple(taken([cls.bounds], POINT.name).values())
        super().__init_subclass__()

    @classmethod
    def supports(cls, query: str, ndim: int) -> bool:
        return super().supports(query, ndim) and cls.bounds.supports(POINT.name, ndim)

    @classmethod
    def around(cls, volume: Bounder, domain: DistanceDomain, device: str | None = None):
        """The distance to the volume of a bounder of points, with a threshold that covers rounding and nothing else."""
        told = {"domain": volume.domain.to_dict(), "sizes": volume.sizes, "threshold": float(volume.threshold)}
        return cls(domain, volume.tensors, {"volume": told}, device)

    def check_tensors(self) -> None:
        told = self.sizes.get("volume")
        if not isinstance(told, dict) or set(told) != {"domain", "sizes", "threshold"}:
            raise BounderError(f"{self.method}: expected the volume's domain, sizes and threshold")
        domain, threshold = Domain.from_dict(told["domain"]), json_number(told["threshold"], "the volume's threshold")
        if domain.ndim != self.ndim or domain.time or domain.unbounded:
            raise BounderError(f"{self.method}: the volume is of another kind of object")
        if not np.isfinite(threshold) or float(np.float32(threshold)) != threshold:
            raise BounderError(f"{self.method}: the volume's threshold {threshold} is not a finite float32 number")
        self.volume = self.bounds(domain, self.tensors, told["sizes"], self._device).freeze(threshold, None)
        self._form = self.form_of(self.volume, self.domain)
        if not (np.isfinite(self._form.numbers).all() and np.isfinite(self._form.error)):
            raise BounderError(f"{self.method}: numbers are so large that float32 cannot hold them")

    source = property(attrgetter("_form.source"))

    def weights(self) -> np.ndarray:
        return self._form.numbers

    def reference(self, v: np.ndarray) -> np.ndarray:
        return self._form.reference(np.asarray(v, dtype=np.float64))

    def rounding_bound(self) -> float:
        return self._form.error + FLUSHED

    def growth(self) -> float:
        return self._form.growth


# --- distances to flat faces -----------------------------------------------------------------------------------------
#
# Distances to volumes between flat faces: ``aabb``, ``obb``, ``kdop`` and ``learned-kdop``.
#
# A face ``a . y <= h`` with ``|a| <= 1`` is ``a . y - h`` away from y, or farther, so the largest of these numbers is a
# lower bound of the distance to the volume. That is the distance itself where the nearest point lies within a face, and
# less beside edges and corners. Where the first n pairs of faces are at right angles to each other (a box, whose axes a
# k-DOP has, too), the n distances together are a vector ``m`` whose length is the distance to that box: exact for
# ``aabb`` and ``obb``; the others take the larger one of both numbers.
#
# Of free half-spaces (``learned-kdop``) there is no such box, and at a sharp edge the bound may be much under the
# distance.
#
# *Directions.* Those of the bounder of points belong to its own coordinates; here they are turned into unit normals,
# shortened by ``SHORTENED`` so that after rounding to float32 none is longer than 1, and a frame of n of them, as a
# matrix, has a norm of at most 1 (``frame_norm``). What the rounding of a normal moves a face by is at most
# ``|rounding| . limit``, since the object lies in the domain, and is added to the face.
#
# *Rounding*, u = 2^-24: a product of a normal with v is off by ``gamma(n + 1) |v|_1``, the difference to a face by ``u
# (|v|_1 + |h|)``; n of them at right angles by ``root(n)`` times as much, their squares, sum and root by ``(n + 4) u``
# of what they give.

SHORTENED = 1.0 - 2.0**-21  # of a normal: more than rounding to float32 makes it longer, n <= 64
UPRIGHT = 1e-5  # entries of a frame's products less the identity's: rounding to float32 makes no larger ones

_FACES = """
{
    enum { K = $faces };
    const float* high = w;
    const float* low = w + K;
    const float* a = w + ($two_sided ? 2 : 1) * K;
    V square = zero, farthest = zero - 3e38f;
#pragma unroll $unrolled
    for (int k = 0; k < K; ++k) {
        V z;
        if ($diagonal) {
            z = v[k];
        } else {
            z = v[0] * a[k * N];
#pragma unroll
            for (int j = 1; j < N; ++j) z = z + v[j] * a[k * N + j];
        }
        V m = z - high[k];
        if ($two_sided) m = wb_most(m, low[k] - z);
        farthest = wb_most(farthest, m);
        if (k < $frame) {
            const V out = wb_most(m, zero);
            square = square + out * out;
        }
    }
    f = farthest;
    if ($frame > 0) f = wb_most(f, wb_root(square));
}
"""
_MOST_UNROLLED = 16


@dataclass(frozen=True)
class FacesSource(DistanceSource):
    """Native code. Numbers: ``high[k]``, ``low[k]`` where two-sided, and ``a`` ``(k, n)`` unless diagonal."""

    faces: int
    frame: int  # the first so many are at right angles to each other: n, or 0
    two_sided: bool
    diagonal: bool

    def body(self, lanes: Lanes) -> str:
        own = {name: int(value) if isinstance(value, bool) else value for name, value in vars(self).items()}
        return fill(_FACES, **own, unrolled=min(self.faces, _MOST_UNROLLED))


def frame_norm(frame: np.ndarray) -> float:
    """An upper bound of the spectral norm of a matrix.

    Infinite unless its rows are about orthogonal, and of one length.
    """
    products = frame @ frame.T
    if not (np.abs(products - np.eye(len(frame))) <= UPRIGHT).all():
        return np.inf
    return float(np.sqrt(np.abs(products).sum(axis=1).max() + NOISE))


class FacesDistance(VolumeDistance):
    """Between flat faces; see module."""

    two_sided: ClassVar[bool] = True

    @classmethod
    def form_of(cls, volume: Bounder, domain: DistanceDomain) -> Form:
        shape, tau, n = volume.shape, float(volume.threshold), domain.ndim
        limit, per_unit = domain.limit.astype(np.float64), volume.domain.scale.astype(np.float64)
        slopes = shape.directions * per_unit / domain.scale.astype(np.float64)  # of y; a . v = slopes . y + moved
        apart = domain.center.astype(np.float64) - volume.domain.center.astype(np.float64)
        moved = (shape.directions * per_unit) @ apart
        size = np.abs(shape.directions * per_unit) @ np.abs(apart) + np.abs(slopes) @ limit + abs(tau)
        length = np.linalg.norm(slopes, axis=1)
        if not (length > 0).all():
            raise BounderError(f"{cls.method}: a face has no direction")
        diagonal = bool(shape.diagonal) and cls.two_sided
        unit = slopes / length[:, None]
        normals = unit if diagonal else (unit * SHORTENED).astype(np.float32).astype(np.float64)
        upright = diagonal or (cls.two_sided and len(normals) >= n and frame_norm(normals[:n]) <= 1.0)
        if not diagonal and not (np.linalg.norm(normals, axis=1) <= 1 - NOISE).all():
            raise BounderError(f"{cls.method}: a face's normal is longer than 1")
        turned = np.abs(normals - unit) @ limit
        high = (shape.high - tau - moved) / length
        room = turned + NOISE * (np.abs(shape.high) + size) / length + NOISE
        numbers = [round_up(high + room)]
        if cls.two_sided:
            low = (shape.low + tau - moved) / length
            numbers.append(round_down(low - turned - NOISE * (np.abs(shape.low) + size) / length - NOISE))
        largest = max(float(np.abs(part).max()) for part in numbers)
        if not diagonal:
            numbers.append(normals.astype(np.float32).reshape(-1))
        faces = [np.asarray(part, dtype=np.float64) for part in numbers[: 1 + cls.two_sided]]
        frame, root = (n, float(np.sqrt(n))) if upright else (0, 1.0)

        def reference(v: np.ndarray) -> np.ndarray:
            m = (z := v @ normals.T) - faces[0]
            if cls.two_sided:
                m = np.maximum(m, faces[1] - z)
            far = m.max(axis=1)
            return np.maximum(far, np.linalg.norm(np.maximum(m[:, :n], 0.0), axis=1)) if upright else far

        source = FacesSource(n, False, len(normals), frame, cls.two_sided, diagonal)
        error, growth = root * 2 * UNIT32 * largest, root * (n + 3) + n + 8
        return Form(source, np.concatenate(numbers).astype(np.float32), error, growth, reference)


class AabbDistance(FacesDistance):
    """The distance to the axis-aligned box, exact but for rounding."""

    method, bounds = Aabb.method, Aabb


class ObbDistance(FacesDistance):
    """The distance to the oriented box, exact but for rounding where its axes are at right angles in object space."""

    method, bounds = Obb.method, Obb


class KdopDistance(FacesDistance):
    """A lower bound of the distance to the k-DOP: that to its farthest face, or to the box among its faces."""

    method, bounds = Kdop.method, Kdop
