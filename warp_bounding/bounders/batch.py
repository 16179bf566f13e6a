"""How a bounder is queried: in batches, repeatedly, and in users' kernels.

A call of ``query`` checks and views its input, makes memory for the answers, checks a placement and packs a kernel's
arguments, which takes longer than the answers to a thousand queries. ``prepare`` does so once; ``Prepared.launch`` only
runs.
"""

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property, partial
from typing import Any, ClassVar

import numpy as np
import warp as wp

from warp_bounding.errors import BounderError, QueryError, warn
from warp_bounding.kernels.functions import Data, batch_kernel, point_func
from warp_bounding.kernels.source import LABEL, SEVERAL_DIM, Source
from warp_bounding.queries import QUERIES
from warp_bounding.queries.placement import Placement
from warp_bounding.queries.region_domain import AnyDomain
from warp_bounding.runtime.arrays import Compaction, compact, flat_queries, memory_of, new_output
from warp_bounding.runtime.launch import BlockLaunch
from warp_bounding.shapes.joints import PER_JOINT
from warp_bounding.shapes.recentred import Frame


class Prepared:
    """Queries of one bounder, prepared for repeated launches; made by ``Bounder.prepare``.

    It keeps the memory of the queries and of the answers. The queries are read anew in every launch: write the next
    ones to the same memory. Answers are written to the same memory in every launch; nothing is allocated, and nothing
    read back. A new threshold (``Bounder.freeze``) is seen by the next launch. One thread at a time may use it; several
    of them may run in several threads.

    Attributes:
        out: ``(N,)`` bool, true = maybe, false = certainly not.
        indices: ``(N,)`` int32, ascending indices of the candidates; ``None`` unless they are requested.
        count: How many candidates there are, a 1-element int32 array; ``None`` unless they are requested.

    Example:
        >>> prepared = bounder.prepare(points, candidates=True)
        >>> indices, count = prepared.launch()
        >>> prepared.out.shape, indices.shape, count.shape
        ((100,), (100,), (1,))
    """

    def __init__(self, bounder: "Queryable", x, *, out: wp.array | None, xform, scale, candidates: bool):
        bounder.expect_local("prepare")
        self._bounder, self._x = bounder, x
        self._queries, self._number, _ = bounder._flat(x, bounder.domain.columns, ())
        self._memory = memory_of(x)
        if self._memory is None or (self._number and self._memory[0] != self._queries.ptr):
            dtype = getattr(x, "dtype", "numbers")
            got = f"{type(x).__name__} of {getattr(dtype, '__name__', dtype)} that would have to be copied"
            expected = f"float32, in one piece and on {bounder.device}: every launch reads it there"
            raise QueryError(f"x must be {expected}; got {got}")
        self.out = new_output(out, self._number, wp.bool, bounder.device)
        self._place: wp.array | None = None
        if xform is not None or scale is not None:
            self._place = wp.array(self._placement(xform, scale), dtype=wp.float32, device=bounder.device)
        self._compaction = Compaction(self.out) if candidates else None
        self.indices, self.count = (self._compaction.indices, self._compaction.count) if candidates else (None, None)
        self._record()

    def launch(self) -> wp.array | tuple[wp.array, wp.array]:
        """Answer the queries.

        Returns:
            ``out``; where candidates are requested, ``(indices, count)`` as in ``Bounder.candidates``, and ``out`` is
            filled, too.

        Raises:
            QueryError: If the memory or the shape of ``x`` has changed, as after ``resize_`` or a new ``data`` of a
                torch tensor.

        Example:
            >>> bounder.prepare(points).launch().dtype.__name__
            'bool'
        """
        if memory_of(self._x) != self._memory:
            raise QueryError("x lies elsewhere than when it was prepared, or has another shape; prepare it again")
        if self._bounder.data is not self._data:
            self._record()
        self._launch.launch()
        return self.out if self._compaction is None else self._compaction.launch()

    def move(self, *, xform=None, scale=None) -> None:
        """Place the shape elsewhere in the world, for the launches to come.

        Args:
            xform: As for ``Bounder.query``. If only one of both is given, the other one is reset.
            scale: As for ``Bounder.query``.

        Raises:
            QueryError: If neither is given, or ``prepare`` was given neither, or for a placement that the certificate
                does not cover; the old placement stays.

        Example:
            >>> prepared = bounder.prepare(points, scale=1.0)
            >>> prepared.move(xform=wp.transform(wp.vec3(9.0), wp.quat_identity()))
            >>> int(prepared.launch().numpy().sum())
            0
        """
        if self._place is None:
            raise QueryError("move: expected queries that were prepared with xform or scale, got ones in object space")
        values = self._placement(xform, scale)
        if self._place.device.is_cpu:
            self._place.numpy()[:] = values
        else:
            self._place.assign(values)

    def __repr__(self) -> str:
        where = "object space" if self._place is None else "the world"
        asked = f"{where}, with candidates" if self._compaction else where
        return f"<{self._number:,} {self._bounder.query_kind} queries in {asked}, prepared for {self._bounder!r}>"

    def _placement(self, xform, scale) -> np.ndarray:
        domain = self._bounder.domain
        placement = Placement.of(domain, xform, scale)
        if placement is None:
            raise QueryError("move: expected xform or scale, got neither")
        placement.check(domain, double=False)
        return placement.values

    def _record(self) -> None:
        self._data = self._bounder.data
        self._launch = self._bounder.batch_launch(self._queries, self._number, self._place, self.out)


LOOKS = 8  # whoever has asked as many batches in the right units goes on with these


class Queryable(ABC):
    """What a ``Bounder`` needs to answer queries; ``Bounder`` adds fitting, bounds and proofs.

    A bounder of a shape that has an origin (``shapes.recentred``) follows one rule. ``query``, ``values`` and
    ``candidates`` take world coordinates, float32 or float64, and subtract the origin in float64. Whatever reads
    float32 in place takes local coordinates: kernels' functions, ``prepare``, placements. These are only for
    ``bounder.local``, which has no origin, so that nobody gives them world coordinates by mistake.

    Attributes:
        frame: Where its local coordinates begin; ``None`` where they are the world's.
        network_bounds: Which bounds its networks were given (``proof.taylor``); ``None`` for those of the search.
    """

    of_distances: ClassVar[bool] = False  # its value is a lower bound of the distance, compared with a radius
    domain: AnyDomain
    threshold: np.float32
    frame: Frame | None = None
    network_bounds: Any = None
    _device: str | None
    _data: tuple[np.float32, Data] | None = None  # the threshold for which ``data`` was made, and it
    _looks = LOOKS  # how many batches are still looked at for other units

    def __reduce__(self):
        """Pickle and copy through the class's constructor, which checks and copies all numbers: no memory is shared."""
        made = type(self), type(self.domain), self.domain.to_dict(), self.tensors, self.sizes, self._device
        return _remade, (*made, self.threshold, self.certificate, self.info, self.frame, self.network_bounds)

    @property
    @abstractmethod
    def source(self) -> Source:
        """The native code of ``f``; equal for bounders of equal sizes."""

    def source_of(self, kind: type[Source], *sizes: Any) -> Any:
        """A source for this bounder's queries, with the sizes that its class adds."""
        domain = self.domain
        named = {"query": domain.query, "unbounded": domain.unbounded, "joints": domain.joints is not None}
        return kind(self.ndim, domain.time, *sizes, **named)

    @abstractmethod
    def weights(self) -> np.ndarray:
        """``(K,)`` float32, the method's numbers in the order in which the native code reads them."""

    def words(self) -> np.ndarray:
        """``(W,)`` uint32, the method's bit field."""
        return np.zeros(1, dtype=np.uint32)

    @property
    def ndim(self) -> int:
        """Dimension n of the object."""
        return self.domain.space_ndim

    @property
    def query_kind(self) -> str:
        """The kind of query, by its name."""
        return self.domain.query

    @property
    def device(self) -> wp.Device:
        """The Warp device that queries run on."""
        return wp.get_device(self._device)

    Data = Data

    @property
    def origin(self) -> np.ndarray:
        """``(n,)`` float64, world coordinates of the local 0; zeros where local coordinates are the world's.

        Example:
            >>> bounder.origin
            array([0., 0., 0.])
        """
        return np.zeros(self.ndim) if self.frame is None else np.array(self.frame.origin)

    @property
    def local(self):
        """This bounder in world coordinates less ``origin``: for kernels of your own, ``prepare`` and ``xform=``."""
        if self.frame is None:
            return self
        made = self.to()
        made.frame = None
        return made

    def _flat(self, x, columns: int, directed: tuple[bool, ...]) -> tuple[wp.array, int, bool]:
        """``flat_queries``, in local coordinates."""
        try:
            return flat_queries(x, columns, self.device, None if self.frame is None else self.frame.shift(directed))
        except QueryError as error:
            if self.domain.joints is None or np.shape(x)[1:] in ((), (columns,)):
                raise
            raise QueryError(f"{error}{PER_JOINT}") from error

    @cached_property
    def _usual(self) -> list[list[float]]:
        """``Query.usual``, least and largest of each number."""
        return np.stack(QUERIES[self.query_kind].usual(self.domain), axis=1).tolist()

    def _warn_of_units(self, x) -> None:
        """Warn once of a batch that seems to be of other units; see ``LOOKS``.

        It looks at one query, and at all where that is far off. Only NumPy arrays and sequences are looked at, as
        nothing is read back from a device.
        """
        if not isinstance(x, np.ndarray | list | tuple) or not len(x):
            return
        self._looks -= 1
        row, shift = x[len(x) // 3], 0.0
        if self.frame is not None:
            shift = self.frame.shift(QUERIES[self.query_kind].directed)
            row = np.asarray(row) - shift
        numbers = zip(np.asarray(row).tolist(), self._usual, strict=True)
        if not any(value < low or value > high for value, (low, high) in numbers):
            return
        self._looks, x, (low, high), domain = 0, np.asarray(x) - shift, np.transpose(self._usual), self.domain
        if domain.joints is not None:
            text = domain.joints.other_units(x)
        else:
            far = (np.isfinite(x) & ((x < low) | (x > high))).any(axis=1).all()
            ends = " to ".join(str((end + self.origin).tolist()) for end in (domain.lower, domain.upper))
            text = f"all {len(x):,} queries lie far from {ends}: are they in other units?" if far else None
        if text:
            warn(f"{self.method}: {text}")

    def expect_local(self, what: str) -> None:
        """Refuse, with ``QueryError``, a bounder with an origin where ``what`` takes local coordinates."""
        if self.frame is not None:
            raise QueryError(
                f"{what} takes local coordinates, and of this bounder {self.frame.summary}: subtract bounder.origin in "
                "float64, then ask bounder.local"
            )

    def in_frame(self, frame: Frame | None):
        """This bounder of a local shape as one of the shape in its frame, in place.

        Raises ``BounderError`` where delta does not hold the blur.
        """
        if frame is not None:
            if fault := frame.fault(self):
                raise BounderError(f"{self.method}: {fault}")
            self.frame = frame
            if self.certificate is not None:
                self.certificate = frame.noted(self.certificate)
        return self

    @cached_property
    def func(self) -> wp.Function:
        """The test of one query, for kernels of your own: write ``wp.static(bounder.func)(data, q)``; true is *maybe*.

        Of points ``test(data, q: vec_n) -> bool``, of regions ``test(data, a: vec_n, b: vec_n) -> bool``: a ray's
        origin and direction, a plane's normal and point, a box's lower and upper corner; object space. ``data`` is
        ``bounder.data``, an argument of the kernel.

        The proof is about the float32 numbers that the function gets, in IEEE arithmetic. It keeps to IEEE arithmetic
        in a module with ``fast_math``, and does not compile with ``-ffast-math`` in ``cpu_compiler_flags``; other such
        flags void the proof.

        A name for it, ``test = bounder.func``, can be bound to another bounder's function before Warp builds the
        module; see ``point_func``.

        Example:
            >>> @wp.kernel
            ... def ask(data: wb.Data, q: wp.array(dtype=wp.vec3), answers: wp.array(dtype=wp.bool)):
            ...     i = wp.tid()
            ...     answers[i] = wp.static(bounder.func)(data, q[i])
            >>> q = wp.array(points, dtype=wp.vec3, device="cpu")
            >>> answers = wp.zeros(len(points), dtype=wp.bool, device="cpu")
            >>> wp.launch(ask, len(points), [bounder.data, q, answers], device="cpu")
            >>> bool((answers.numpy() == bounder.query(points).numpy()).all())
            True
        """
        self.expect_local("func")
        return point_func(self.source)

    def _header(self, threshold: np.float32) -> np.ndarray:
        """float32, what a function reads behind the label: the domain's numbers, and the threshold."""
        return np.concatenate([self.domain.header, [threshold], self.domain.extra])

    @property
    def data(self) -> Data:
        """What ``func`` reads in addition to the query, on this bounder's device: an argument of type ``wb.Data``.

        After a new threshold (``freeze``) it is another object.

        Example:
            >>> bounder.data.parameters.device
            'cpu'
        """
        threshold, held = self.threshold, self._data  # each read once: another thread may freeze it meanwhile
        if held is None or held[0] is not threshold:
            source, words = self.source, self.words()
            weights = np.asarray(self.weights(), dtype=np.float32)
            parameters = np.zeros(source.start + len(weights), dtype=np.float32)
            # label | center scale limit threshold extra | zeros up to ``source.start`` | the method's numbers
            head = self._header(threshold)
            parameters[:LABEL] = source.label(len(parameters), len(words))
            parameters[LABEL : LABEL + len(head)] = head
            parameters[source.start :] = weights
            data = Data()
            data.parameters = wp.array(parameters, dtype=wp.float32, device=self.device)
            data.words = wp.array(words, dtype=wp.uint32, device=self.device)
            held = self._data = threshold, data
        return held[1]

    def __ctype__(self):
        """Called by ``wp.launch`` where a kernel takes a structure: refuses the bounder, and says what to pass."""
        raise TypeError(f"pass bounder.data to a kernel, not the bounder itself, got {self!r}")

    def query(self, x, *, xform=None, scale=None, out: wp.array | None = None, radius=None) -> wp.array:
        """Test many queries.

        Args:
            x: ``(N, m)`` NumPy array, torch tensor, ``wp.array`` or sequence of numbers, or ``wp.array`` of ``vec_m``
                ``(N,)``. Points: m = n. Regions, m = 2 n: a ray's origin and direction, a plane's normal and point, a
                box's lower and upper corner. float32 is read in place where it lies on this device; float64 is rounded
                to float32, which the certificate covers. Of a shape with an ``origin`` these are world coordinates, of
                any type; the host first subtracts the origin in float64. Integers must be exact in float32, and no
                ``wp.array``.
            xform: Places the shape in the world: ``wp.transform``, 7 numbers or a homogeneous rigid matrix. ``x`` are
                then numbers in the world; time is not moved. A rotated box is tested by the axis-aligned box around it
                in object space; without a rotation, or by right angles, that is the box itself.
            scale: Positive number, or one per spatial axis; applied before ``xform``. The length of rays stays in
                object units: where the shape is scaled by one number s, its rays are s times as long in the world.
            out: ``(N,)`` bool to write to, instead of a new array.
            radius: Not taken: fit a distance.

        Returns:
            ``(N,)`` bool ``wp.array``: true = maybe, false = certainly not. NaN, infinity, a direction of no length, a
            box upside down: maybe. Outside the domain: no; but beyond the limits of an arm's joints: maybe.

        Raises:
            QueryError: For a wrong shape, dtype or device, or a placement that the certificate does not cover.

        Example:
            >>> bounder.query(np.array([[0.5, 0.5, 0.5], [9.0, 9.0, 9.0]], np.float32)).numpy()
            array([ True, False])
            >>> bounder.query(points + np.float32(2), xform=wp.transform(wp.vec3(2.0), wp.quat_identity())).shape
            (100,)
        """
        if radius is not None:
            raise QueryError(f"{self.method}: only distances are compared with a radius: wb.fit(shape, 'distance')")
        return self._batch(x, xform, scale, out, values=False)

    def values(self, x, *, xform=None, scale=None) -> wp.array:
        """The number ``f`` that is compared with the threshold, as the device computes it; arguments as in ``query``.

        Where ``query`` runs on tensor cores it says *maybe* of some values just below the threshold, too
        (``networks.tensor_cores``).

        Returns:
            ``(N,)`` float32 ``wp.array``; +inf where the answer is *maybe* without f, -inf outside the domain.

        Raises:
            QueryError: As ``query`` does.

        Example:
            >>> f = bounder.values(points).numpy()
            >>> bool(((f >= bounder.threshold) == bounder.query(points).numpy()).all())
            True
        """
        return self._batch(x, xform, scale, None, values=True)

    def candidates(self, x, *, xform=None, scale=None, radius=None) -> tuple[wp.array, wp.array]:
        """Which queries may meet the object, compacted on the device; arguments as in ``query``.

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
        return compact(self.query(x, xform=xform, scale=scale, radius=radius))

    def prepare(self, x, *, out: wp.array | None = None, xform=None, scale=None, candidates: bool = False) -> Prepared:
        """Set up queries that are repeated often, such as in every step of a simulation.

        Args:
            x: As for ``query``, but float32, on this device and contiguous: it is stored, and read at every launch, so
                what is written there is queried next.
            out: As for ``query``.
            xform: As for ``query``; ``Prepared.move`` changes it.
            scale: As for ``query``; ``Prepared.move`` changes it.
            candidates: Compact the answers, as ``candidates`` does.

        Returns:
            An object whose ``launch()`` answers them.

        Raises:
            QueryError: As for ``query``, and for ``x`` that would have to be copied.

        Example:
            >>> prepared = bounder.prepare(points)
            >>> points[0] = 0.5  # a step of a simulation writes to the same memory
            >>> int(prepared.launch().numpy()[0])
            1
        """
        return Prepared(self, x, out=out, xform=xform, scale=scale, candidates=candidates)

    def _batch(self, x, xform, scale, out, *, values: bool) -> wp.array:
        device = self.device
        if xform is not None or scale is not None:
            self.expect_local("xform= or scale=")
        directed = QUERIES[self.domain.query].directed
        queries, count, double = self._flat(x, self.domain.columns, directed)
        placement, place = Placement.of(self.domain, xform, scale), None
        if self._looks > 0 and placement is None:
            self._warn_of_units(x)
        if placement is not None:
            placement.check(self.domain, double=double)
            place = wp.array(placement.values, dtype=wp.float32, device=device, copy=not device.is_cpu)
        out = new_output(out, count, wp.float32 if values else wp.bool, device)
        self.batch_launch(queries, count, place, out, values=values).launch_once()
        return out

    def batch_launch(
        self, queries: wp.array, count: int, place: wp.array | None, out: wp.array, *, values: bool = False
    ) -> BlockLaunch:
        """The launch that answers a batch of flat queries into ``out``, with the threshold as it is now.

        ``place`` is ``Placement.values`` on the device, ``None`` for queries in object space; of a distance the radii.
        """
        data = self.data
        place_or_any = data.parameters if place is None else place  # kernels may not be given null pointers
        inputs = [queries, count, 0, data.parameters, data.words, place_or_any]
        kernel_of = partial(batch_kernel, self.source, place is not None, values)
        exact, several = values and not self.of_distances, self.source.several > 1
        return self._launch_of(kernel_of, count, inputs, [out], exact=exact, several=several)

    def _launch_of(
        self,
        kernel_of: Callable[..., wp.Kernel],
        count: int,
        inputs: list,
        outputs: list,
        *,
        exact: bool = False,
        several: bool = False,
    ) -> BlockLaunch:
        """A launch of ``kernel_of()``; its third input is the first block's number. ``exact``: f as ``func`` has it.

        ``several``: a thread of CUDA takes several queries.
        """
        if not (several and self.device.is_cuda):
            return BlockLaunch(kernel_of(), count, inputs, outputs, self.device, first_index=2, block=self.source.block)
        threads = self.source.threads(count)
        return BlockLaunch(kernel_of(), threads, inputs, outputs, self.device, first_index=2, block_dim=SEVERAL_DIM)


def _remade(kind, domain, numbers, tensors, sizes, device, threshold, certificate, info, frame, network_bounds):
    bounder = kind(domain.from_dict(numbers), tensors, copy.deepcopy(sizes), device)
    bounder.freeze(threshold, certificate).info = copy.deepcopy(info)
    bounder.frame = frame
    return bounder if network_bounds is None else network_bounds.given_to(bounder)
