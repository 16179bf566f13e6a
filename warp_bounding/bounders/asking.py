"""What a bounder is asked, and how: in batches, again and again, and in kernels of the user's own."""

from abc import ABC, abstractmethod
from functools import cached_property

import numpy as np
import warp as wp

from warp_bounding.bounders.prepared import Prepared, batch_launch
from warp_bounding.coordinates.domain import Domain
from warp_bounding.coordinates.placement import Placement
from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.kernels.functions import Data, point_func
from warp_bounding.kernels.plain import plain_func
from warp_bounding.kernels.source import FRONT, Source
from warp_bounding.runtime.arrays import flat_queries, new_output
from warp_bounding.runtime.compaction import compact

__all__ = ["Asking"]


class Asking(ABC):
    """The half of a ``Bounder`` that queries see.

    Attributes:
        domain: The box it was made for, and the map into it.
        threshold: float32; the answer is *maybe* iff ``not (f < threshold)``.
        native: Whether queries run as native text, or as its plain twin.
    """

    domain: Domain | RegionDomain
    threshold: np.float32
    native: bool
    _device: str | None
    _data: tuple[np.float32, Data] | None = None  # of a threshold

    @property
    @abstractmethod
    def source(self) -> Source:
        """The native code of ``f``; equal for bounders of equal sizes."""

    @abstractmethod
    def weights(self) -> np.ndarray:
        """``(K,)`` float32, the method's numbers in the order in which ``source`` reads them."""

    def words(self) -> np.ndarray:
        """``(W,)`` uint32, the method's bit field."""
        return np.zeros(1, dtype=np.uint32)

    @property
    def ndim(self) -> int:
        """Dimension n of the object."""
        return self.domain.space_ndim

    @property
    def query_kind(self) -> str:
        """What is asked."""
        return self.domain.query

    @property
    def device(self) -> wp.Device:
        """The Warp device that queries run on."""
        return wp.get_device(self._device)

    Data = Data

    @cached_property
    def func(self) -> wp.Function:
        """The test of one query, for kernels of your own: write ``wp.static(bounder.func)(data, q)``; true is *maybe*.

        Of points ``test(data, q: vec_n) -> bool``, of regions ``test(data, a: vec_n, b: vec_n) -> bool``: a ray's origin and direction, a
        plane's normal and point, a box's lower and upper corner; object space. ``data`` is ``bounder.data``, an argument of the kernel.

        The proof is of the float32 numbers that it gets, in IEEE arithmetic: it keeps to that in a module with ``fast_math``, and does not
        compile with ``-ffast-math`` in ``cpu_compiler_flags``; other such flags are outside the claim.

        A name for it, ``test = bounder.func``, can be bound to another bounder's function before Warp builds the module; see
        ``point_func``.

        Example:
            >>> @wp.kernel
            ... def ask(data: wb.Data, q: wp.array(dtype=wp.vec3), answers: wp.array(dtype=wp.bool)):
            ...     i = wp.tid()
            ...     answers[i] = wp.static(bounder.func)(data, q[i])
            >>> q, answers = wp.array(points, dtype=wp.vec3, device="cpu"), wp.zeros(len(points), dtype=wp.bool, device="cpu")
            >>> wp.launch(ask, len(points), [bounder.data, q, answers], device="cpu")
            >>> bool((answers.numpy() == bounder.query(points).numpy()).all())
            True
        """
        return point_func(self.source) if self.native else plain_func(self.source)

    @property
    def data(self) -> Data:
        """What ``func`` reads besides the query, on this bounder's device: pass it to the kernel as an argument of type ``wb.Data``.

        A new threshold (``freeze``) makes a new one.

        Example:
            >>> bounder.data.parameters.device
            'cpu'
        """
        threshold, held = self.threshold, self._data  # each read once: another thread may freeze it meanwhile
        if held is None or held[0] is not threshold:
            source, words = self.source, self.words()
            weights = np.asarray(self.weights(), dtype=np.float32)
            parameters = np.zeros(source.start + len(weights), dtype=np.float32)
            header = np.concatenate([self.domain.header, [threshold], self.domain.extra])
            parameters[:FRONT] = source.front(len(parameters), len(words))
            parameters[FRONT : FRONT + len(header)] = header
            parameters[source.start :] = weights
            data = Data()
            data.parameters = wp.array(parameters, dtype=wp.float32, device=self.device)
            data.words = wp.array(words, dtype=wp.uint32, device=self.device)
            held = self._data = threshold, data
        return held[1]

    def query(self, x, *, xform=None, scale=None, out: wp.array | None = None) -> wp.array:
        """Test many queries.

        Args:
            x: ``(N, m)`` NumPy array or torch tensor, float32 or float64, or ``wp.array`` of ``vec_m`` ``(N,)`` or float32 ``(N, m)``.
                Points: m = n. Regions, m = 2 n: a ray's origin and direction, a plane's normal and point, a box's lower
                and upper corner. Torch tensors on the CPU and ``wp.array`` are read in place.
            xform: Places the shape in the world: ``wp.transform``, 7 numbers or a homogeneous rigid matrix. ``x`` are then
                numbers in the world; time is not moved. A rotated box is tested by the axis-aligned box around it in object
                space; without a rotation, or by right angles, that is the box itself.
            scale: Positive number, or one per spatial axis; applied before ``xform``. The length of rays stays in object
                units: where the shape is scaled by one number s, its rays are s times as long in the world.
            out: ``(N,)`` uint8 to write to, instead of a new array.

        Returns:
            ``(N,)`` uint8 ``wp.array``: 1 = maybe, 0 = certainly not. NaN, infinity, a direction of no length, a box upside
            down: maybe. Outside the domain: no.

        Raises:
            QueryError: For a wrong shape, dtype or device, or a placement that the certificate does not cover.

        Example:
            >>> bounder.query(np.array([[0.5, 0.5, 0.5], [9.0, 9.0, 9.0]], np.float32)).numpy()
            array([1, 0], dtype=uint8)
            >>> bounder.query(points + np.float32(2), xform=wp.transform(wp.vec3(2.0), wp.quat_identity())).shape
            (100,)
        """
        return self._batch(x, xform, scale, out, values=False)

    def values(self, x, *, xform=None, scale=None) -> wp.array:
        """The number ``f`` that is compared with the threshold, as the device computes it; the arguments are those of ``query``.

        Returns:
            ``(N,)`` float32 ``wp.array``; +inf where the answer is *maybe* without asking, -inf outside the domain.

        Raises:
            QueryError: As ``query`` does.

        Example:
            >>> f = bounder.values(points).numpy()
            >>> bool(((f >= bounder.threshold) == (bounder.query(points).numpy() == 1)).all())
            True
        """
        return self._batch(x, xform, scale, None, values=True)

    def candidates(self, x, *, xform=None, scale=None) -> tuple[wp.array, wp.array]:
        """Which queries may meet the object, compacted on the device; ``x``, ``xform`` and ``scale`` are those of ``query``.

        Returns:
            ``(N,)`` int32 indices, ascending, of which the first ``n`` are valid, and ``n`` as a 1-element int32 array.
            Nothing is read back to the host.

        Raises:
            QueryError: As ``query`` does.

        Example:
            >>> indices, count = bounder.candidates(points)
            >>> kept = points[indices.numpy()[: int(count.numpy()[0])]]
            >>> len(kept) == int(bounder.query(points).numpy().sum())
            True
        """
        return compact(self.query(x, xform=xform, scale=scale))

    def prepare(self, x, *, out: wp.array | None = None, xform=None, scale=None, candidates: bool = False) -> Prepared:
        """Set up queries that are asked often, such as in every step of a simulation.

        Args:
            x: As for ``query``, but float32, on this device and in one piece: it is kept, and read at every launch, so what is written
                there is asked next.
            out: As for ``query``.
            xform: As for ``query``; ``Prepared.move`` changes it.
            scale: As for ``query``; ``Prepared.move`` changes it.
            candidates: Compact the answers, as ``candidates`` does.

        Returns:
            An object whose ``launch()`` asks.

        Raises:
            QueryError: As for ``query``, and for ``x`` that would have to be copied.

        Example:
            >>> asked = bounder.prepare(points)
            >>> points[0] = 0.5  # a step of a simulation writes to the same memory
            >>> int(asked.launch().numpy()[0])
            1
        """
        return Prepared(self, x, out=out, xform=xform, scale=scale, candidates=candidates)

    def _batch(self, x, xform, scale, out, *, values: bool) -> wp.array:
        device = self.device
        queries, count, double = flat_queries(x, self.domain.columns, device)
        placement, place = Placement.of(self.domain, xform, scale), None
        if placement is not None:
            placement.check(self.domain, double=double)
            place = wp.array(placement.values, dtype=wp.float32, device=device, copy=not device.is_cpu)
        out = new_output(out, count, wp.float32 if values else wp.uint8, device)
        batch_launch(self, queries, count, place, out, values=values).launch_once()
        return out
