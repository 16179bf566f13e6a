"""The contract of a bounder, and everything that all methods share.

A bounder maps a query to coordinates ``v`` (``Domain``), computes one float32 number ``f(v)`` and answers *maybe* iff
``not (f < threshold)``. A method supplies:

* ``source``: the native code of ``f`` (``Source``) and ``weights()``, the float32 numbers that it reads;
* ``reference(v)``: the same ``f`` in plain NumPy float64, the twin that tests and proofs evaluate;
* ``bound(lower, upper)``: a certified lower bound of the exact ``f`` over boxes of ``v``;
* ``rounding_bound()``: ``E >= |f as any device computes it - exact f|`` wherever the domain test lets a query through;
* ``fit(grid, domain, ...)``, where there is a closed form, or a trainer elsewhere.

It is proven when ``threshold <= (least bound over the widened object) - E``; ``proof`` establishes that, for every
method by the same code. A new method is one file with a subclass, and a line in the registry.
"""

from abc import ABC, abstractmethod
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np
import warp as wp

from warp_bounding.arithmetic import UNIT32
from warp_bounding.bounders.file_format import save
from warp_bounding.bounders.options import Option
from warp_bounding.bounders.prepared import Prepared, batch_launch
from warp_bounding.certificates.certificate import Certificate
from warp_bounding.coordinates.domain import Domain
from warp_bounding.coordinates.placement import Placement
from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.errors import BounderError
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.kernels.functions import Data, point_func
from warp_bounding.kernels.plain import plain_func
from warp_bounding.kernels.source import FRONT, Source
from warp_bounding.runtime.arrays import flat_queries, new_output
from warp_bounding.runtime.compaction import compact

__all__ = ["Bounder", "BoxBounds", "checked_device"]

CELLS_AT_A_TIME = 16384


def checked_device(device: str | None) -> wp.Device:
    """The Warp device of this name; the default device if ``None``.

    Raises:
        BounderError: If there is none.
    """
    try:
        return wp.get_device(device)
    except (ValueError, RuntimeError) as error:
        names = ", ".join(str(d) for d in wp.get_devices())
        raise BounderError(f"device must be one of {names}, got {device!r}") from error


class BoxBounds(NamedTuple):
    """What a method knows about ``f`` over N boxes.

    Attributes:
        lower: ``(N,)`` float64, certified lower bound.
        axis: ``(N,)`` int, the axis along which halving the box helps the bound most.
        point: ``(N, n)`` float64, a point of the box where ``f`` is likely to be least.
        value: ``(N,)`` float64, ``f`` there.
        next_axis: ``(N,)`` int, the axis to halve after ``axis``, or ``None`` where the method does not know.
    """

    lower: np.ndarray
    axis: np.ndarray
    point: np.ndarray
    value: np.ndarray
    next_axis: np.ndarray | None = None


class Bounder(ABC):
    """A conservative test: *maybe* (1) or certainly *no* (0). Never *no* where the truth is *yes*.

    Attributes:
        method: The name that ``method=`` takes.
        query_kind: What is asked: ``"point"``, ``"ray"``, ``"plane"`` or ``"box"``.
        domain: The box it was made for, and the map into it.
        threshold: float32; the answer is *maybe* iff ``not (f < threshold)``.
        certificate: What is proven of it, or ``None``.
        info: How it was made: indicator digest and name, margin, resolution, seed, seconds, training record, and rates:
            false positives on a few queries, the bounder's own and those of the box around the same cells.
        device: The Warp device that queries run on.
        native: Whether queries run as native text, or as its plain twin (``to``).
    """

    method: ClassVar[str]
    closed_form: ClassVar[bool] = True  # ``bound`` is exact on a cell, so that one pass over the cells is the proof
    conservative: ClassVar[bool] = True  # false: kept to show what goes wrong; it never holds a certificate
    bit_fields: ClassVar[tuple[str, ...]] = ()  # tensors that are uint32
    takes_seconds: ClassVar[bool] = (
        False  # ``fit`` has an argument of that name, and makes something looser when they are over
    )
    options: ClassVar[tuple[Option, ...]] = ()  # what ``fit`` and the command line can tell the method

    def __init__(
        self,
        domain: Domain | RegionDomain,
        tensors: dict[str, np.ndarray],
        sizes: dict[str, Any],
        device: str | None = None,
    ):
        """Copy and check what a bounder is made of.

        Args:
            domain: See class.
            tensors: float32 arrays (uint32 for bit fields) by role; copied, so that nothing can change them later.
            sizes: JSON-ready structure that the tensors do not tell.
            device: Warp device; the default device if ``None``.

        Raises:
            BounderError: If a tensor is not finite or of the wrong type, the method does not bound such queries, or there is no
                such device.
        """
        checked_device(device)
        if not self.supports(domain.query, domain.space_ndim, domain.space):
            where = " in parametric space" if domain.space == "parametric" else ""
            raise BounderError(
                f"{self.method} does not bound {domain.query} queries of {domain.space_ndim}D objects{where}"
            )
        if not isinstance(sizes, dict):
            raise BounderError(f"sizes must be a table of names, got {sizes!r}")
        self.domain = domain
        self.sizes = dict(sizes)
        self.tensors = {name: np.array(value, order="C") for name, value in tensors.items()}
        for name, value in self.tensors.items():
            expected = np.uint32 if name in self.bit_fields else np.float32
            if value.dtype != expected:
                raise BounderError(f"tensor {name} must be {expected.__name__}, got {value.dtype}")
            if value.dtype == np.float32 and not np.isfinite(value).all():
                raise BounderError(f"tensor {name} holds a value that is not finite")
            value.setflags(write=False)
        self.threshold = np.float32(0.0)
        self.certificate: Certificate | None = None
        self.info: dict[str, Any] = {}
        self._device = device
        self._data: tuple[np.float32, Data] | None = None  # of a threshold
        self.native = True

    # --- what a method supplies --------------------------------------------------------------------------------------

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

    @abstractmethod
    def reference(self, v: np.ndarray) -> np.ndarray:
        """Exact ``f`` (up to float64 rounding) of ``(N, n)`` float64 coordinates ``v``; ``(N,)`` float64."""

    @abstractmethod
    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """Certified lower bounds of the exact ``f`` over boxes of ``v``, float64 rounding included.

        Args:
            lower: ``(N, n)`` float64.
            upper: ``(N, n)`` float64.
        """

    @abstractmethod
    def rounding_bound(self) -> float:
        """``E``: bound of the error of ``f`` as any device computes it, for ``|v| <= domain.limit``.

        Regions tested against a volume: the computed ``f(v)`` is at least the largest value of the volume's exact f on the
        region ``v``, less E.
        """

    @property
    def in_region_space(self) -> bool:
        """Whether f is a function of a region's own numbers (parametric space), not of the points of one."""
        return self.domain.space == "parametric" and self.query_kind != "point"

    @property
    def provable(self) -> bool:
        """Whether there is a proof for the method and its kind of query."""
        return self.conservative and (self.closed_form or self.query_kind in ("point", "plane"))

    @property
    def parts(self) -> "list[Bounder]":
        """The bounders whose conjunction this is, each at its threshold; they are proven one by one."""
        return [self]

    @property
    def volume(self) -> "Bounder | None":
        """The volume, as a bounder of points, where a region is tested against one; ``None`` where f is a function of v."""
        return None

    @classmethod
    def fit_regions(
        cls, grid: IndicatorGrid, domain: RegionDomain, samples: np.ndarray, *, device: str | None = None
    ) -> "Bounder":
        """A volume around all positive regions, in the space of their own numbers.

        Args:
            grid: The object.
            domain: Of a region, in parametric space.
            samples: ``(N, 2 n)`` float64, positive queries in their own units; they give the shape, not the size.
            device: Warp device.

        Raises:
            BounderError: If the method has none.
        """
        raise BounderError(f"{cls.method}: there is no such volume in parametric space")

    def least(self, grid: IndicatorGrid) -> tuple[float, int]:
        """Certified least ``f`` over all v that the pipeline can make of a positive query, in closed form.

        Args:
            grid: The object, inside the domain.

        Returns:
            The lower bound (float64 rounding included) and the number of boxes that were looked at.
        """
        if self.volume is not None:
            return self.volume.least(grid)
        if self.query_kind != "point":
            raise BounderError(f"{self.method}: there is no closed form for {self.query_kind} queries")
        least, cells = np.inf, grid.occupied
        for start in range(0, len(cells), CELLS_AT_A_TIME):
            part = cells[start : start + CELLS_AT_A_TIME]
            boxes = self.domain.widened(grid.position(part - 0.5), grid.position(part + 0.5))
            least = np.minimum(least, self.bound(*boxes).lower.min())  # NaN stays NaN, and proves nothing
        return float(least), len(cells)

    # --- where it runs -----------------------------------------------------------------------------------------------

    @classmethod
    def supports(cls, query: str, ndim: int, space: str = "geometric") -> bool:
        """Whether the method can bound this kind of query of an n-dimensional object, in this space."""
        return query == "point"

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

    def to(self, device: str | None = None, *, native: bool | None = None) -> "Bounder":
        """This bounder on another device; weights are copied, the certificate holds for both.

        Args:
            device: Warp device; the same one if ``None``.
            native: ``False`` runs ``func``, ``query``, ``candidates`` and ``prepare`` as the plain twin in Warp's own Python
                (``kernels.plain``), for devices without a compiler for native text. It answers the same but for rounding, which the
                certificate has room for, one query at a time, so it takes several times as long; and its kernels must be compiled without
                ``fast_math``. ``None`` keeps what it is.

        Raises:
            BounderError: If there is no such device.
        """
        device = self._device if device is None else device
        checked_device(device)
        twin = object.__new__(type(self))
        twin.__dict__.update({k: v for k, v in self.__dict__.items() if k not in ("func",)})
        twin._device, twin._data = device, None
        twin.native = self.native if native is None else native
        return twin

    def freeze(self, threshold: float, certificate: Certificate | None) -> "Bounder":
        """Set threshold and certificate; the only way that they change. Rates that were measured before say nothing any more."""
        self.info = {key: value for key, value in self.info.items() if key != "rates"}
        self.threshold = np.float32(threshold)
        self.certificate = certificate
        self._data = None
        return self

    def check_range(self) -> None:
        """Refuse numbers whose sums could overflow float32; the rounding bound is at least ``UNIT32`` times the largest sum.

        Raises:
            BounderError: If they could.
        """
        if not self.rounding_bound() < UNIT32 * 2.0**60:
            raise BounderError(f"{self.method}: numbers are so large that float32 sums may overflow")

    @property
    def nbytes(self) -> int:
        """Memory that a query computes with at most: parameters, without what tells whose they are, and bit field."""
        header = len(self.domain.header) + 1 + len(self.domain.extra)
        return 4 * header + sum(t.nbytes for t in self.tensors.values())

    Data = Data

    @cached_property
    def func(self) -> wp.Function:
        """``test(data, q)`` for your own kernels, or ``test(data, a, b)`` for regions; write ``wp.static(bounder.func)(data, q)``.

        The proof is of the float32 numbers that it gets, in IEEE arithmetic: it keeps to that in a module with ``fast_math``, and does not
        compile with ``-ffast-math`` in ``cpu_compiler_flags``; other such flags are outside the claim.

        A name for it, ``test = bounder.func``, can be bound to another bounder's function before Warp builds the module; see
        ``point_func``.
        """
        return point_func(self.source) if self.native else plain_func(self.source)

    @property
    def data(self) -> Data:
        """The instance of ``Data`` that ``func`` takes, on this bounder's device."""
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

    # --- asking it ---------------------------------------------------------------------------------------------------

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
        """
        return self._batch(x, xform, scale, out, values=False)

    def values(self, x, *, xform=None, scale=None) -> wp.array:
        """``f`` itself, as the device computes it: ``(N,)`` float32; +inf where the answer is *maybe* without asking, -inf outside."""
        return self._batch(x, xform, scale, None, values=True)

    def candidates(self, x, *, xform=None, scale=None) -> tuple[wp.array, wp.array]:
        """The queries that may meet the object, compacted on the device.

        Args:
            x: As for ``query``.
            xform: As for ``query``.
            scale: As for ``query``.

        Returns:
            ``(N,)`` int32 indices, ascending, of which the first ``n`` are valid, and ``n`` as a 1-element int32 array.
            Nothing is read back to the host.
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

    @property
    def tightness(self) -> str:
        """False positives in words, as the fit has measured them on few queries of its cells; empty where it has not."""
        rates = self.info.get("rates")
        if not rates:
            return ""
        resolution = self.info.get("resolution")
        cells = "its cells" + (f" at resolution {resolution}" if resolution else "")
        text = f"{rates['fp_rate']:.2f} % false positives of {cells} ({rates['samples']:,} samples)"
        looser = rates["fp_rate"] > rates["fp_rate_aabb"]
        return f"{text}, looser than a box ({rates['fp_rate_aabb']:.2f} %)" if looser else text

    # --- keeping it --------------------------------------------------------------------------------------------------

    def save(self, path) -> None:
        """Write one ``.safetensors`` file: whole or not at all (see ``warp_bounding.bounders.file_format``)."""
        save(self, path)

    def __repr__(self) -> str:
        proof = self.certificate.kind if self.certificate else "no certificate"
        text = f"{self.method} bounder, {self.ndim}D {self.query_kind} queries, {self.nbytes} bytes, {proof}"
        return f"<{text}, {self.tightness}>" if self.tightness else f"<{text}>"
