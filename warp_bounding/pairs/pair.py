"""A pair: may two placed meshes be within a gap, how far apart are they at least, and when can they first touch?"""

from functools import cache, cached_property

import numpy as np
import warp as wp

from warp_bounding.bounders.distance import DistanceBounder, lengths_of, steps_of
from warp_bounding.bounders.export import about, numbers_of, texts_of
from warp_bounding.errors import BounderError, QueryError
from warp_bounding.kernels.distances import DistanceSource
from warp_bounding.pairs.balls import Balls
from warp_bounding.pairs.kernels import GROUP, STEPS, PairData, closest_func, contact_func, search_alone
from warp_bounding.rounding import LARGEST, UNIT32, round_down, round_up
from warp_bounding.runtime.arrays import flat_queries, new_output
from warp_bounding.runtime.header import array, write
from warp_bounding.runtime.launch import launch_blocks
from warp_bounding.runtime.native import Numbers, fill, literal, named, native_text, unique_name

ROUNDED = 8 * UNIT32  # of what float64 placements round to float32
_PLACE, _SCALE, _VELOCITY = 7, 3, 6  # numbers


@cache
def query_func(source: DistanceSource) -> wp.Function:
    """``maybe = query(data, xform_a, xform_b, gap)``; see ``Pair.func``."""
    closest = closest_func(source)

    @named(unique_name(source, "pair_query")).func
    def query(data: PairData, xform_a: wp.transform, xform_b: wp.transform, gap: float) -> bool:
        one = wp.vec3(1.0, 1.0, 1.0)
        return not (closest(data, xform_a, xform_b, one, one, gap, False) > gap)

    return query


@cache
def distance_func(source: DistanceSource) -> wp.Function:
    """``distance(data, xform_a, xform_b)``; see ``Pair.distance_func``."""
    closest = closest_func(source)

    @named(unique_name(source, "pair_distance")).func
    def distance(data: PairData, xform_a: wp.transform, xform_b: wp.transform) -> float:
        one = wp.vec3(1.0, 1.0, 1.0)
        return wp.max(closest(data, xform_a, xform_b, one, one, wp.inf, True), 0.0)

    return distance


@wp.func
def _place(x: Numbers, i: int) -> wp.transform:
    k = 7 * i
    p = wp.vec3(x[k], x[k + 1], x[k + 2])
    return wp.transform(p, wp.quat(x[k + 3], x[k + 4], x[k + 5], x[k + 6]))


@wp.func
def _vector(x: Numbers, at: int) -> wp.vec3:
    return wp.vec3(x[at], x[at + 1], x[at + 2])


@wp.struct
class Placements:
    """Rows of numbers, of which ``many`` is 0 where there is one for all pairs."""

    a: Numbers
    b: Numbers
    scale_a: Numbers
    scale_b: Numbers
    gap: Numbers
    many: wp.types.vector(length=5, dtype=wp.int32)


@cache
def batch_kernel(source: DistanceSource, exact: bool) -> wp.Kernel:
    """``(first, data, places, maybe or distances)``, one pair a thread."""
    closest, whole = closest_func(source), bool(exact)

    def batch(first: int, data: PairData, places: Placements, out: wp.array(dtype=wp.float32 if whole else wp.bool)):
        i, _ = wp.tid()
        i += first
        gap = places.gap[places.many[4] * i]
        low = closest(
            data,
            _place(places.a, places.many[0] * i),
            _place(places.b, places.many[1] * i),
            _vector(places.scale_a, 3 * places.many[2] * i),
            _vector(places.scale_b, 3 * places.many[3] * i),
            gap,
            whole,
        )
        if wp.static(whole):
            out[i] = wp.max(low, 0.0)
        else:
            out[i] = not (low > gap)

    return named(unique_name(source, f"pairs_{'distance' if exact else 'query'}")).kernel(batch)


@cache
def contact_kernel(source: DistanceSource) -> wp.Kernel:
    """``(first, data, places, velocity_a, velocity_b, many_a, many_b, duration, steps, maybe, times)``."""
    contact = contact_func(source)

    def batch(
        first: int,
        data: PairData,
        places: Placements,
        velocity_a: Numbers,
        velocity_b: Numbers,
        many_a: int,
        many_b: int,
        duration: float,
        steps: int,
        maybe: wp.array(dtype=wp.bool),
        times: wp.array(dtype=wp.float32),
    ):
        i, _ = wp.tid()
        i += first
        own, other = 6 * many_a * i, 6 * many_b * i
        may, t = contact(
            data,
            _place(places.a, places.many[0] * i),
            _place(places.b, places.many[1] * i),
            _vector(places.scale_a, 3 * places.many[2] * i),
            _vector(places.scale_b, 3 * places.many[3] * i),
            _vector(velocity_a, own),
            _vector(velocity_a, own + 3),
            _vector(velocity_b, other),
            _vector(velocity_b, other + 3),
            places.gap[places.many[4] * i],
            duration,
            steps,
        )
        maybe[i] = may
        times[i] = t

    return named(unique_name(source, "pairs_contact")).kernel(batch)


class Pair:
    """A mesh with a distance bounder, and another one that balls hold; both may be placed, turned, scaled, mirrored.

    Attributes:
        bounder: Of the distance to mesh A.
        balls: That hold mesh B.
        device: The Warp device that queries run on.

    Example:
        >>> pair = wb.pairs.Pair(far, balls)
        >>> here, there = [0, 0, 0, 0, 0, 0, 1], [9, 0, 0, 0, 0, 0, 1]
        >>> pair.query([here], [there]).numpy()
        array([False])
    """

    def __init__(self, bounder: DistanceBounder, balls: Balls):
        """Take both together.

        Args:
            bounder: A distance bounder in 3D of a shape at rest; its device is the pair's.
            balls: Of another mesh, or of the same one.

        Raises:
            BounderError: For another bounder, one in a frame of its own, or what are no balls.
        """
        if not getattr(bounder, "of_distances", False) or bounder.ndim != 3 or bounder.domain.time:
            got = f"got {bounder!r}"
            raise BounderError(f"a pair needs a distance bounder of a 3D shape at rest, {got}; fit one with 'distance'")
        if bounder.frame is not None:
            raise BounderError(
                "a pair needs a bounder in local coordinates: pass bounder.local, and place it by origin"
            )
        if not isinstance(balls, Balls):
            raise BounderError(f"a pair needs balls (Balls.of), got {type(balls).__name__}")
        self.bounder, self.balls, self.device = bounder, balls, bounder.device

    @property
    def proven(self) -> bool:
        """Whether the bounder is; balls are made proven, and certified from their file (``Balls.certify``)."""
        return self.bounder.certificate is not None and self.bounder.certificate.proven

    @cached_property
    def data(self) -> PairData:
        """What the functions need, for your kernels."""
        data = PairData()
        data.bounder, (data.slots, data.links) = self.bounder.data, self.balls.arrays(str(self.device))
        base = self.bounder.domain
        corner = np.maximum(np.abs(base.lower), np.abs(base.upper)).astype(np.float64)
        balls = self.balls.centers.astype(np.float64)
        data.reach_a = _longer(np.sqrt((corner**2).sum()))
        data.reach_b = _longer((np.sqrt((balls**2).sum(axis=1)) + self.balls.radii).max())
        return data

    @cached_property
    def func(self) -> wp.Function:
        """``maybe = query(data, xform_a, xform_b, gap)`` for your kernels: ``wp.static(pair.func)(pair.data, ...)``.

        Placements are ``wp.transform``, the gap is in world units. False only if all of one mesh is farther than the
        gap from all of the other. Scaled meshes: ``kernels.closest_func``.

        Example:
            >>> @wp.kernel
            ... def cull(data: wb.pairs.PairData, x: wp.array(dtype=wp.transform), keep: wp.array(dtype=wp.bool)):
            ...     i = wp.tid()
            ...     keep[i] = wp.static(pair.func)(data, x[0], x[i], 0.01)
            >>> places = [wp.transform([3.0 * i, 0, 0], [0, 0, 0, 1]) for i in range(3)]
            >>> x = wp.array(places, dtype=wp.transform, device="cpu")
            >>> keep = wp.zeros(3, dtype=wp.bool, device="cpu")
            >>> wp.launch(cull, 3, [pair.data, x, keep], device="cpu")
            >>> keep.numpy()
            array([ True, False, False])
        """
        return query_func(self.bounder.source)

    @cached_property
    def distance_func(self) -> wp.Function:
        """``distance(data, xform_a, xform_b)`` for your kernels: a lower bound, world units, at least 0."""
        return distance_func(self.bounder.source)

    def export(self, path, name: str | None = None) -> None:
        """Write a header for C99, C++11 and CUDA that answers single pairs without this library; see *In C++*.

        Args:
            path: As for ``Bounder.export``.
            name: As for ``Bounder.export``.

        Raises:
            BounderError: As ``Bounder.export`` does.
            FileFormatError: As ``Bounder.export`` does.

        Example:
            >>> pair.export("pair.h")
            >>> "int pair_maybe(const float place_a[7]" in open("pair.h").read()
            True
        """
        slots, links = (array.numpy().reshape(-1).tolist() for array in self.balls.arrays("cpu"))
        texts = texts_of(self.bounder) | {"groups": len(links) // GROUP, "search": search_alone(self.bounder.source)}
        balls = [
            array("slots", "float", (literal(x) if np.isfinite(x) else "-INFINITY" for x in slots)),
            array("links", "int", map(str, links)),
        ]
        parts = [*numbers_of(self.bounder), *balls, fill(native_text("export.h").PAIR, **texts)]
        write(path, name, [*about(self.bounder), f"The other mesh: {self.balls!r}"], parts)

    def query(self, xform_a, xform_b, gap=0.0, *, scale_a=None, scale_b=None, out: wp.array | None = None) -> wp.array:
        """Which pairs may be within a gap.

        Args:
            xform_a: Placements of mesh A, ``(N, 7)`` numbers, position and quaternion (x, y, z, w), or a ``wp.array``
                of ``wp.transform``; or one for all, ``(1, 7)``. A quaternion whose squared length differs from 1 by
                more than 1e-6 makes the answer *maybe*. float64 is rounded, and counted.
            xform_b: The same of mesh B.
            gap: World units, a number of at least 0 or one per pair.
            scale_a: Of each axis of mesh A before it is turned, ``(N, 3)`` or ``(1, 3)``; negative ones mirror. 1 if
                ``None``. 0, or sizes outside 2^-40 to 2^40, make the answer *maybe*.
            scale_b: The same of mesh B.
            out: ``(N,)`` bool to write to.

        Returns:
            ``(N,)`` bool ``wp.array``: true = maybe, false = certainly farther apart than the gap.

        Raises:
            QueryError: For a wrong shape, dtype or device.

        Example:
            >>> pair.query([[0, 0, 0, 0, 0, 0, 1]], [[0.1, 0, 0, 0, 0, 0, 1], [9, 0, 0, 0, 0, 0, 1]]).numpy()
            array([ True, False])
        """
        places, count, blur = self._placements(xform_a, xform_b, scale_a, scale_b)
        places.gap, places.many[4] = self._gaps(gap, count, blur)
        out = new_output(out, count, wp.bool, self.device)
        self._launch(batch_kernel(self.bounder.source, exact=False), count, [places], [out])
        return out

    def distance(self, xform_a, xform_b, *, scale_a=None, scale_b=None, out: wp.array | None = None) -> wp.array:
        """Lower bounds of the distance between the two.

        Args:
            xform_a: As for ``query``.
            xform_b: As for ``query``.
            scale_a: As for ``query``.
            scale_b: As for ``query``.
            out: ``(N,)`` float32 to write to.

        Returns:
            ``(N,)`` float32 ``wp.array``, world units, at least 0; 0 for NaN, and whatever else has no answer.

        Raises:
            QueryError: As in ``query``.

        Example:
            >>> float(pair.distance([[0, 0, 0, 0, 0, 0, 1]], [[9, 0, 0, 0, 0, 0, 1]]).numpy()[0]) > 6
            True
        """
        places, count, blur = self._placements(xform_a, xform_b, scale_a, scale_b)
        places.gap, places.many[4] = wp.full(1, np.inf, dtype=float, device=self.device), 0
        out = new_output(out, count, wp.float32, self.device)
        self._launch(batch_kernel(self.bounder.source, exact=True), count, [places], [out])
        if blur is not None:
            out.assign(np.fmax(round_down(out.numpy() - blur), np.float32(0)))
        return out

    def contact_time(
        self,
        xform_a,
        xform_b,
        velocity_a,
        velocity_b,
        gap=0.0,
        *,
        duration: float = 1.0,
        scale_a=None,
        scale_b=None,
        steps: int = STEPS,
    ) -> tuple[wp.array, wp.array]:
        """Which pairs may come within a gap, and when first, if both move by constant velocities.

        Args:
            xform_a: As for ``query``, at time 0.
            xform_b: As for ``query``.
            velocity_a: ``(N, 6)`` or ``(1, 6)``: of mesh A's origin, then angular, about an axis in the world.
            velocity_b: The same of mesh B.
            gap: As for ``query``.
            duration: How long they move, above 0.
            scale_a: As for ``query``.
            scale_b: As for ``query``.
            steps: Distances that are computed for each pair at most, at least 1.

        Returns:
            ``(N,)`` bool ``wp.array``, true = maybe; and ``(N,)`` float32, before which they are farther apart than the
            gap; the duration where they are so all the time.

        Raises:
            QueryError: As in ``query``, and for another duration or number of steps.

        Example:
            >>> at_rest, falling = [[0, 0, 0, 0, 0, 0]], [[-1, 0, 0, 0, 0, 0]]
            >>> here, there = [[0, 0, 0, 0, 0, 0, 1]], [[9, 0, 0, 0, 0, 0, 1]]
            >>> maybe, t = pair.contact_time(here, there, at_rest, falling, duration=20.0)
            >>> bool(maybe.numpy()[0]), bool(6 < t.numpy()[0] < 9)
            (True, True)
        """
        steps = steps_of(steps)
        if isinstance(duration, bool) or not isinstance(duration, int | float) or not 0 < duration <= LARGEST:
            raise QueryError(f"duration must be a number above 0, at most {LARGEST:g}, got {duration!r}")
        places, count, blur = self._placements(xform_a, xform_b, scale_a, scale_b, velocity_a, velocity_b)
        velocities, moving = [], np.zeros(count)
        for given in (velocity_a, velocity_b):
            flat, own, double = flat_queries(given, _VELOCITY, self.device)
            velocities.append((flat, int(own > 1)))
            if double:  # of turns a march leaves out more than that
                rows = np.abs(flat.numpy()[: own * _VELOCITY].reshape(own, _VELOCITY).astype(np.float64))
                moving = moving + ROUNDED * duration * rows[:, :3].sum(axis=1)
        if moving.any():
            blur = moving if blur is None else blur + moving
        places.gap, places.many[4] = self._gaps(gap, count, blur)
        maybe = wp.empty(count, dtype=wp.bool, device=self.device)
        times = wp.empty(count, dtype=wp.float32, device=self.device)
        (a, many_a), (b, many_b) = velocities
        inputs = [places, a, b, many_a, many_b, float(round_up(duration)), steps]
        self._launch(contact_kernel(self.bounder.source), count, inputs, [maybe, times])
        return maybe, times

    def _launch(self, kernel: wp.Kernel, count: int, inputs: list, outputs: list) -> None:
        launch_blocks(kernel, count, [0, self.data, *inputs], outputs, self.device, first_index=0, block=1)

    def _placements(self, xform_a, xform_b, scale_a, scale_b, *others) -> tuple[Placements, int, np.ndarray | None]:
        """The rows, how many pairs there are, and by how much float64 numbers were rounded, ``(N,)`` or ``None``."""
        places, counts, doubles = Placements(), [], []
        given = (
            ("a", xform_a, _PLACE),
            ("b", xform_b, _PLACE),
            ("scale_a", scale_a, _SCALE),
            ("scale_b", scale_b, _SCALE),
        )
        for k, (name, x, columns) in enumerate(given):
            x = np.ones((1, columns), np.float32) if x is None else x
            flat, count, double = flat_queries(x, columns, self.device)
            setattr(places, name, flat)
            places.many[k] = int(count > 1)
            counts.append(count)
            doubles.append(double)
        counts += [flat_queries(x, _VELOCITY, self.device)[1] for x in others]
        pairs = {count for count in counts if count != 1} or {1}
        if len(pairs) > 1:
            raise QueryError(
                f"placements, scales and velocities must be as many, or one for all, got {sorted(pairs)} rows"
            )
        blur = None
        if any(doubles):
            rows = [getattr(places, name).numpy().astype(np.float64) for name, *_ in given]
            size = [np.abs(rows[k][: counts[k] * 7].reshape(-1, 7)[:, :3]).sum(axis=1) for k in (0, 1)]
            largest = [np.abs(rows[k][: counts[k] * 3].reshape(-1, 3)).max(axis=1) for k in (2, 3)]
            blur = ROUNDED * (size[0] + size[1] + largest[0] * self.data.reach_a + largest[1] * self.data.reach_b)
            blur = np.broadcast_to(blur, (next(iter(pairs)),))
        return places, next(iter(pairs)), blur

    def _gaps(self, gap, count: int, blur: np.ndarray | None) -> tuple[wp.array, int]:
        """Gaps as they are compared, and whether there is one per pair."""
        gaps = lengths_of("gap", gap, count)
        if blur is not None:
            gaps = round_up((gaps.astype(np.float64) + blur) * (1 + 1e-12)).astype(np.float32)
        return wp.array(gaps, dtype=float, device=self.device), int(len(gaps) > 1)


def _longer(length: float) -> float:
    return float(round_up(length * (1 + 1e-12)))
