"""What a distance bounder is asked, in batches and in kernels: points, radii, segments, rays and boxes, of one function g.

Every answer follows from ``g(x) <= distance(x, object)`` (``kernels.distances``), so a method that has g has all of them.
"""

from abc import ABC, abstractmethod
from functools import cached_property

import numpy as np
import warp as wp

from warp_bounding.arithmetic import round_down, round_up
from warp_bounding.bounders.distances.double_queries import lengths_of, longer, moved, outwards, turned
from warp_bounding.bounders.framed import Framed
from warp_bounding.bounders.pickling import PicklableBounder
from warp_bounding.coordinates.distance_domain import DistanceDomain
from warp_bounding.errors import QueryError
from warp_bounding.kernels.distances.batch import (
    box_kernel,
    distance_kernel,
    lines_kernel,
)
from warp_bounding.kernels.distances.functions import (
    BOX_STEPS,
    SEGMENT_STEPS,
    box_func,
    distance_func,
    ray_func,
    segment_func,
)
from warp_bounding.kernels.distances.lanes import lanes_kernel
from warp_bounding.kernels.distances.source import DistanceSource, share_of
from warp_bounding.kernels.functions import Data
from warp_bounding.kernels.source import LABEL
from warp_bounding.runtime.arrays import new_output
from warp_bounding.runtime.compaction import compact
from warp_bounding.runtime.launch import BlockLaunch

__all__ = ["AskingDistance"]


class AskingDistance(Framed, PicklableBounder, ABC):
    """What a ``DistanceBounder`` needs to answer; see there."""

    domain: DistanceDomain
    threshold: np.float32
    _device: str | None
    _data: tuple[np.float32, Data] | None = None

    Data = Data

    @property
    @abstractmethod
    def source(self) -> DistanceSource:
        """The native code of ``f``; equal for bounders of equal sizes."""

    @abstractmethod
    def weights(self) -> np.ndarray:
        """``(K,)`` float32, the method's numbers in the order in which ``source`` reads them."""

    def words(self) -> np.ndarray:
        """``(W,)`` uint32, the method's bit field."""
        return np.zeros(1, dtype=np.uint32)

    def growth(self) -> float:
        """How much the computed f may exceed F besides ``rounding_bound``, in units ``UNIT32 (|v|_1 + |f|)``; 0 in the domain."""
        return 0.0

    @property
    @abstractmethod
    def rate(self) -> float:
        """See ``DistanceBounder``."""

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
    def haste(self) -> float:
        """``pace`` in local units."""
        return self.pace / (float(self.domain.scale[0]) * self.domain.unit)

    @property
    def extra(self) -> np.ndarray:
        """float32 numbers behind threshold and share: where there is time, its scale, the speed and the pace."""
        return np.append(self.domain.extra, np.float32(self.pace)) if self.domain.time else self.domain.extra

    @property
    def ndim(self) -> int:
        """Dimension n of the object."""
        return self.domain.ndim

    @property
    def device(self) -> wp.Device:
        """The Warp device that queries run on."""
        return wp.get_device(self._device)

    @property
    def data(self) -> Data:
        """What the functions read besides the query, on this bounder's device: your kernel's argument of type ``wb.Data``.

        Example:
            >>> far.data.parameters.device
            'cpu'
        """
        threshold, held = self.threshold, self._data
        if held is None or held[0] is not threshold:
            source, words, weights = self.source, self.words(), np.asarray(self.weights(), dtype=np.float32)
            parameters = np.zeros(source.start + len(weights), dtype=np.float32)
            share = round_up(share_of(self.ndim, self.growth() + self.haste))
            head = np.concatenate([self.domain.header, [threshold, share], self.extra])
            parameters[:LABEL] = source.label(len(parameters), len(words))
            parameters[LABEL : LABEL + len(head)] = head
            parameters[source.start :] = weights
            data = Data()
            data.parameters = wp.array(parameters, dtype=wp.float32, device=self.device)
            data.words = wp.array(words, dtype=wp.uint32, device=self.device)
            held = self._data = threshold, data
        return held[1]

    def __ctype__(self):
        """Asked by ``wp.launch`` where a kernel takes a structure: refuses the bounder itself, and says what to give."""
        raise TypeError(f"pass bounder.data to a kernel, not the bounder itself, got {self!r}")

    # --- in kernels --------------------------------------------------------------------------------------------------

    @cached_property
    def distance_func(self) -> wp.Function:
        """``distance(data, x: vec_n) -> float``, for kernels of your own: ``wp.static(b.distance_func)(b.data, x)``; object units.

        Never above the distance from x to the object, for any float32 x; 0 for NaN and infinity, and for the data of another bounder.

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
        """``maybe, t = segment(data, start: vec_n, end: vec_n, radius, steps=32)``, for kernels of your own; see ``segments``."""
        self.expect_local("segment_func")
        return segment_func(self.source)

    @cached_property
    def ray_func(self) -> wp.Function:
        """``maybe, t = ray(data, origin: vec_n, direction: vec_n, length, radius, steps=32)``, for kernels of your own; see ``rays``."""
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
            x: ``(N, n)`` NumPy array, torch tensor, ``wp.array`` or sequence of numbers, or ``wp.array`` of ``vec_n`` ``(N,)``; object space. float64
                is rounded to float32, and what that may move a point by is taken off its bound, on the host. Whole numbers must be ones that
                float32 holds exactly.
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
        self._points(queries, count, np.zeros(1, np.float32), out, values=True)
        if double:
            out.assign(np.fmax(round_down(out.numpy() - moved(self, queries, count)), np.float32(0)))
        return out

    def query(self, x, radius=0.0, *, xform=None, scale=None, out: wp.array | None = None) -> wp.array:
        """Which points may be within a radius of the object.

        Args:
            x: As for ``distance``.
            radius: Number of at least 0, or one per query; object units. float64 is rounded up to float32.
            xform: Not taken: a distance is asked in object space.
            scale: Not taken.
            out: ``(N,)`` uint8 to write to, instead of a new array.

        Returns:
            ``(N,)`` uint8 ``wp.array``: 1 = maybe, 0 = certainly farther than the radius: ``g(x) > radius``.

        Raises:
            QueryError: For a wrong shape, dtype or device, or a radius that is negative, NaN or not one per query.

        Example:
            >>> far.query(np.array([[0.5, 0.5, 0.5], [9.0, 9.0, 9.0]], np.float32), radius=0.1).numpy()
            array([1, 0], dtype=uint8)
        """
        if xform is not None or scale is not None:
            raise QueryError(
                "a distance is asked in object space: move the points by the inverse of xform and scale first"
            )
        queries, count, double = self._flat(x, self.ndim, (False,))
        radii = lengths_of("radius", radius, count)
        if double:
            radii = longer(radii, moved(self, queries, count))
        out = new_output(out, count, wp.uint8, self.device)
        self._points(queries, count, radii, out, values=False)
        return out

    def candidates(self, x, radius=0.0) -> tuple[wp.array, wp.array]:
        """Which points may be within a radius, compacted on the device; arguments as of ``query``, result as of ``Bounder.candidates``."""
        return compact(self.query(x, radius))

    def segments(self, start, end, radius=0.0, steps: int = SEGMENT_STEPS) -> tuple[wp.array, wp.array]:
        """Which segments may come within a radius of the object, and when first; with a radius they are swept balls.

        Of a shape that moves, segments are of time and space: points (or balls) that move, too. This is conservative
        advancement: *no* means
        that a point which is outside at the start touches no face on its way. It does not mean that the object never
        encloses it on the way
        without touching it, as a lid does that closes over a point; ``boxes`` and ``clear_segments`` mean that, too.

        Args:
            start: ``(N, n)``, as for ``distance``.
            end: ``(N, n)``.
            radius: As for ``query``.
            steps: Evaluations of each at most, at least 1; more of them clear more segments that pass close to the object.

        Returns:
            ``(N,)`` uint8 ``wp.array``, 1 = maybe; and ``(N,)`` float32, a lower bound of the time of first contact, from 0 at the start to 1
            at the end; 1 where there is none. NaN and infinity: maybe, at 0.

        Raises:
            QueryError: As of ``query``, and for ``steps`` that is no whole number of at least 1.

        Example:
            >>> maybe, t = far.segments(np.array([[-9.0, 0.5, 0.5]], np.float32), np.array([[0.5, 0.5, 0.5]], np.float32))
            >>> int(maybe.numpy()[0]), bool(t.numpy()[0] > 0.9)
            (1, True)
        """
        a, count, one = self._flat(start, self.ndim, (False,))
        b, others, other = self._flat(end, self.ndim, (False,))
        if count != others:
            raise QueryError(f"start and end must be as many, got {count} and {others}")
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
            As of ``segments``; times are shares of the length. A direction without a length: maybe, at 0.

        Raises:
            QueryError: As of ``segments``, and for a shape that moves.

        Example:
            >>> maybe, t = far.rays(np.array([[9.0, 0.5, 0.5, 1.0, 0.0, 0.0]], np.float32), length=100.0)
            >>> int(maybe.numpy()[0])
            0
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
        time, enclosed ones included. Long
        ones in time need many steps.

        Args:
            lower: ``(N, n)``, lower corners, as for ``distance``.
            upper: ``(N, n)``, upper corners.
            steps: Evaluations of each at most, at least 1.
            out: ``(N,)`` uint8 to write to, instead of a new array.

        Returns:
            ``(N,)`` uint8 ``wp.array``, 1 = maybe. NaN, infinity and a box upside down: maybe.

        Raises:
            QueryError: As of ``segments``.

        Example:
            >>> far.boxes(np.array([[2.0, 0, 0]], np.float32), np.array([[3.0, 1, 1]], np.float32)).numpy()
            array([0], dtype=uint8)
        """
        a, count, one = self._flat(lower, self.ndim, (False,))
        b, others, other = self._flat(upper, self.ndim, (False,))
        if count != others:
            raise QueryError(f"lower and upper must be as many, got {count} and {others}")
        if self.frame is not None and any(self.frame.blur):
            raise QueryError(
                "boxes of a grid whose cells stand a little beside the ones asked for are not asked: fit box queries"
            )
        a, b = (
            outwards(each, side) if double else each for each, double, side in ((a, one, -np.inf), (b, other, np.inf))
        )
        out = new_output(out, count, wp.uint8, self.device)
        data = self.data
        inputs = [0, data, a, b, _steps(steps)]
        self._run(box_kernel(self.source), count, inputs, [out], first_index=0)
        return out

    def _points(self, queries: wp.array, count: int, radii: np.ndarray, out: wp.array, *, values: bool) -> None:
        data, radius = self.data, wp.array(radii, dtype=wp.float32, device=self.device)
        many = int(len(radii) > 1)
        self._ask_points([queries, count, 0, data.parameters, data.words, radius, many], out, values)

    def _march(self, a, b, count: int, lengths: np.ndarray, radii: np.ndarray, steps: int, *, ray: bool):
        numbers = [wp.array(values, dtype=wp.float32, device=self.device) for values in (lengths, radii)]
        maybe, t = (wp.empty(count, dtype=kind, device=self.device) for kind in (wp.uint8, wp.float32))
        many = [int(len(values) > 1) for values in (lengths, radii)]
        data, steps, given = self.data, _steps(steps), [a, b, numbers[0], many[0], numbers[1], many[1]]
        if count:
            lines = wp.empty(count * (2 * self.ndim + 4), dtype=wp.float32, device=self.device)
            self._run(lines_kernel(self.source, ray), count, [0, data, *given, self._clock], [lines], first_index=0)
            self._march_lines([lines, count, 0, data.parameters, data.words, steps], [maybe, t])
        return maybe, t

    def _ask_points(self, inputs: list, out: wp.array, values: bool) -> None:
        """Run ``distance_kernel``."""
        kernel = distance_kernel(self.source, values)
        self._run(kernel, inputs[1], inputs, [out], first_index=2, block=self.source.block)

    def _march_lines(self, inputs: list, outputs: list) -> None:
        """Run ``lanes_kernel``."""
        self._run(lanes_kernel(self.source), inputs[1], inputs, outputs, first_index=2, block=self.source.block)

    @property
    def _clock(self) -> wp.vec3:
        """What ``clock_func`` tells."""
        domain = self.domain
        if not domain.time:
            return wp.vec3()
        return wp.vec3(float(domain.center[0]), float(domain.limit[0] / domain.scale[0]), domain.speed)

    def _run(self, kernel, count: int, inputs: list, outputs: list, *, first_index: int, **sizes: int) -> None:
        BlockLaunch(
            kernel, count, inputs, outputs, self.device, first_index=first_index, **{"block": 1} | sizes
        ).launch_once()


def _steps(steps: int) -> int:
    """The number of evaluations, checked."""
    if isinstance(steps, bool) or not isinstance(steps, (int, np.integer)) or not 1 <= steps < 2**31:
        raise QueryError(f"steps must be a whole number of at least 1, got {steps!r}")
    return int(steps)
