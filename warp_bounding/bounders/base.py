"""The contract of a bounder, and everything that all methods share.

A bounder maps a query to coordinates ``v`` (``Domain``), computes one float32 number ``f(v)`` and answers *maybe* iff
``not (f < threshold)``, which is not ``f >= threshold``: a NaN must be answered with *maybe*. A method supplies:

* ``source``: a ``Source`` with the native text of ``f`` (``body``); and
  ``weights()``, the float32 numbers that both read;
* ``reference(v)``: the same ``f`` in plain NumPy float64, which tests and proofs evaluate;
* ``bound(lower, upper)``: a certified lower bound of the exact ``f`` over boxes of ``v``;
* ``rounding_bound()``: ``E >= |f as any device computes it - exact f|`` wherever the domain test lets a query through;
* ``options``, what users can tell it, and ``supports``, what it bounds;
* ``fit(grid, domain, ...)``, where the volume is computed in closed form; where it is learned, an entry in
  ``training.trainers.TRAINERS``.

It is proven when ``threshold <= (least bound over the widened object) - E``; ``proof`` establishes that, for every
method by the same code. A new method is one file with a subclass, and a line in ``methods.py`` (``register``).
"""

from abc import abstractmethod
from typing import Any, ClassVar

import numpy as np

from warp_bounding.arithmetic import UNIT32
from warp_bounding.bounders.asking import Asking
from warp_bounding.bounders.file_format import save
from warp_bounding.bounders.options import Option
from warp_bounding.certificates.certificate import Certificate
from warp_bounding.coordinates.region_domain import AnyDomain
from warp_bounding.errors import BounderError
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.shape import Shape
from warp_bounding.networks.box_bounds import BoxBounds
from warp_bounding.queries import QUERIES
from warp_bounding.runtime.devices import device_of

__all__ = ["Bounder", "BoxBounds"]

CELLS_AT_A_TIME = 16384  # cells whose boxes are bounded in one call, so that memory stays small


class Bounder(Asking):
    """A conservative test: *maybe* (1) or certainly *no* (0). Never *no* where the truth is *yes*.

    Attributes:
        method: The name that ``method=`` takes.
        query_kind: What is asked: ``"point"``, ``"ray"``, ``"plane"`` or ``"box"``.
        domain: The box it was made for, and the map into it.
        threshold: float32; the answer is *maybe* iff ``not (f < threshold)``.
        certificate: What is proven of it, or ``None``.
        info: How it was made, by the names in ``file_format.INFO_FIELDS``. ``training`` is a record of the fit, with its
            seconds; ``rates`` are false positives on a few queries, its own and an axis-aligned box's (``quick_rates``).
        device: The Warp device that queries run on.

    Example:
        >>> bounder = wb.fit(ball, method="obb", device="cpu")
        >>> bounder.certificate.proven
        True
        >>> bounder.query(np.array([[0.5, 0.5, 0.5], [9.0, 9.0, 9.0]], np.float32)).numpy()
        array([1, 0], dtype=uint8)
    """

    method: ClassVar[str]
    exact_on_cells: ClassVar[bool] = True  # one pass over the cells (``least``) is the proof, without a search
    composed: ClassVar[bool] = False  # a union of bounders, with an f and a threshold of its own
    delta_share: "np.ndarray | None" = None  # of a union whose parts have domains of their own, see there
    lays_cells: ClassVar[bool] = False  # it is made of cells, also where the shape has none
    conservative: ClassVar[bool] = True  # false: kept to show what goes wrong; it never holds a certificate
    bit_fields: ClassVar[tuple[str, ...]] = ()  # tensors, of members too, that are uint32: the end of their names
    takes_seconds: ClassVar[bool] = False  # ``fit`` has an argument ``seconds``; when they are over it ends, looser
    options: ClassVar[tuple[Option, ...]] = ()  # what ``fit`` and the command line can tell the method

    def __init__(
        self,
        domain: AnyDomain,
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
            BounderError: If a tensor is not finite or of the wrong type, or the method does not bound such queries.
            DeviceError: If there is no such device.
        """
        device_of(device)
        if not self.supports(domain.query, domain.space_ndim):
            raise BounderError(f"{self.method} does not bound {domain.query} queries of {domain.space_ndim}D objects")
        if not isinstance(sizes, dict):
            raise BounderError(f"sizes must be a table of names, got {sizes!r}")
        self.domain = domain
        self.sizes = dict(sizes)
        self.tensors = {name: np.array(value, order="C") for name, value in tensors.items()}
        for name, value in self.tensors.items():
            expected = np.uint32 if name.rpartition(".")[2] in self.bit_fields else np.float32
            if value.dtype != expected:
                raise BounderError(f"tensor {name} must be {expected.__name__}, got {value.dtype}")
            if value.dtype == np.float32 and not np.isfinite(value).all():
                raise BounderError(f"tensor {name} holds a value that is not finite")
            value.setflags(write=False)
        self.threshold = np.float32(0.0)
        self.certificate: Certificate | None = None
        self.info: dict[str, Any] = {}
        self._device = device
        self.check_tensors()

    def expect_shapes(self, expected: dict[str, tuple[int, ...]]) -> None:
        """Refuse tensors of other names or shapes, with ``BounderError``."""
        found = {name: tensor.shape for name, tensor in self.tensors.items()}
        if found != expected:
            raise BounderError(f"{self.method}: expected tensors {expected}, got {found}")

    # --- what a method supplies --------------------------------------------------------------------------------------

    def check_tensors(self) -> None:
        """Refuse tensors and sizes that do not fit together, and keep what follows from them; part of the constructor.

        Raises:
            BounderError: If they do not.
        """

    @abstractmethod
    def reference(self, v: np.ndarray) -> np.ndarray:
        """Exact ``f`` (up to float64 rounding) of ``(N, n)`` float64 coordinates ``v``; ``(N,)`` float64."""

    @abstractmethod
    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """Certified lower bounds of the exact ``f`` over boxes of ``v``, float64 rounding included.

        Args:
            lower: ``(N, n)`` float64.
            upper: ``(N, n)`` float64.

        Returns:
            The bounds; the axis to halve next; and a point of each box where f is likely to be least, with f there. The
            other fields of ``BoxBounds`` are for networks.
        """

    def cut(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Boxes ``(N, n)`` of v cut where f jumps: corners of the pieces, and which box each is a piece of. Here nothing is."""
        return lower, upper, np.arange(len(lower))

    @abstractmethod
    def rounding_bound(self) -> float:
        """``E``: bound of the error of ``f`` as any device computes it, for ``|v| <= domain.limit``.

        For regions that are tested against a volume, the computed ``f(v)`` is at least the largest value that the
        volume's exact f has on the region ``v``, less E.
        """

    @property
    def provable(self) -> bool:
        """Whether there is a proof for the method and its kind of query."""
        return self.conservative

    @property
    def parts(self) -> "list[Bounder]":
        """The bounders whose conjunction this is, each at its threshold; they are proven one by one."""
        return [self]

    def obligations(self, shape: Shape) -> "list[tuple[Bounder, Shape]]":
        """Parts, and what each must be proven for so that this is proven for a shape; or ``BounderError``: it never would."""
        return [(part, shape) for part in self.parts]

    @property
    def volume(self) -> "Bounder | None":
        """The volume that regions are tested against, as a bounder of points; ``None`` where f is a function of v."""
        return None

    @classmethod
    def fit(cls, grid: IndicatorGrid, domain: AnyDomain, *, device: str | None = None, **options) -> "Bounder":
        """The method's volume of a grid, in closed form; ``prove`` sets its threshold.

        Args:
            grid: The object.
            domain: ``domain_of(grid, query)``.
            device: Warp device.
            options: The method's own.

        Raises:
            BounderError: If there is no closed form.
        """
        raise BounderError(f"{cls.method}: there is no closed form")

    def least(self, grid: IndicatorGrid) -> tuple[float, int]:
        """Certified least ``f`` over all v that can arise from a positive query, by one pass over the cells of an object.

        It is the proof where the class is ``exact_on_cells``.

        Returns:
            The lower bound (float64 rounding included) and the number of boxes that were looked at.
        """
        if self.volume is not None:
            return self.volume.least(grid)
        if QUERIES[self.query_kind].is_region:
            raise BounderError(f"{self.method}: there is no closed form for {self.query_kind} queries")
        least, cells = np.inf, grid.occupied
        for start in range(0, len(cells), CELLS_AT_A_TIME):
            part = cells[start : start + CELLS_AT_A_TIME]
            boxes = self.domain.widened(grid.position(part - 0.5), grid.position(part + 0.5))
            least = np.minimum(least, self.bound(*boxes).lower.min())  # NaN stays NaN, and proves nothing
        return float(least), len(cells)

    def exact_on_hull(self, shape: Shape) -> bool:
        """Whether ``least`` of a shape without cells is exact, over its convex hull: the proof needs no search."""
        return False

    # --- where it runs -----------------------------------------------------------------------------------------------

    @classmethod
    def takes_shapes(cls, query: str) -> bool:
        """Whether it bounds a shape without cells, for a kind of query; else cells are laid over the shape."""
        return not cls.lays_cells and not QUERIES[query].is_region

    @classmethod
    def supports(cls, query: str, ndim: int) -> bool:
        """Whether the method bounds a kind of query of an n-dimensional object; by default only points."""
        return query in QUERIES and not QUERIES[query].is_region

    def to(self, device: str | None = None) -> "Bounder":
        """This bounder on another device; weights are copied, the certificate holds for both.

        Args:
            device: Warp device; the same one if ``None``.

        Raises:
            DeviceError: If there is no such device.

        Example:
            >>> bounder.to("cpu").certificate == bounder.certificate
            True
        """
        device = self._device if device is None else device
        device_of(device)
        copy = object.__new__(type(self))
        copy.__dict__.update(self.__dict__)  # tensors are shared, they cannot change
        copy._device, copy._data = device, None
        return copy

    def freeze(self, threshold: float, certificate: Certificate | None) -> "Bounder":
        """Set threshold and certificate, in place; nothing else changes them.

        ``info["rates"]`` is dropped: it was measured at the old threshold.

        Args:
            threshold: Rounded to float32; the answer is *maybe* iff ``not (f < threshold)``.
            certificate: What is known of this threshold; ``None`` for nothing.

        Returns:
            This bounder.

        Example:
            >>> looser = bounder.to("cpu").freeze(bounder.threshold - 0.5, None)
            >>> int(looser.query(points).numpy().sum()) >= int(bounder.query(points).numpy().sum())
            True
        """
        self.info = {key: value for key, value in self.info.items() if key != "rates"}
        self.threshold = np.float32(threshold)
        self.certificate = certificate
        self._data = None
        return self

    def check_range(self) -> None:
        """Refuse numbers whose sums could overflow float32, with ``BounderError``."""
        # The rounding bound is at least UNIT32 times the largest sum. float32 ends at 2^128, so that under 2^60 even
        # products of two sums are finite.
        if not self.rounding_bound() < UNIT32 * 2.0**60:
            raise BounderError(f"{self.method}: numbers are so large that float32 sums may overflow")

    @property
    def nbytes(self) -> int:
        """Bytes of data that one query can read: domain, threshold and the method's numbers, and the bit field.

        The tag and the lengths in front of them (``Source.label``) are not counted.
        """
        header = len(self.domain.header) + 1 + len(self.domain.extra)
        return 4 * header + sum(t.nbytes for t in self.tensors.values())

    @property
    def tightness(self) -> str:
        """False positives in words, as ``fit`` measured them on a few queries; empty where it did not."""
        if not (rates := self.info.get("rates")):
            return ""
        resolution, judge = self.info.get("resolution"), "against the shape itself"
        if not rates.get("itself", self.info.get("grid_shape", ()) is None):  # older files do not say it
            judge = f"of its cells at resolution {resolution}" if resolution else "of its cells"
        text = f"{rates['fp_rate']:.2f} % false positives {judge} ({rates['samples']:,} samples)"
        looser = rates["fp_rate"] > rates["fp_rate_aabb"]
        return f"{text}, looser than a box ({rates['fp_rate_aabb']:.2f} %)" if looser else text

    # --- keeping it --------------------------------------------------------------------------------------------------

    def save(self, path) -> None:
        """Write one ``.safetensors`` file, whole or not at all.

        It holds tensors, domain, threshold, certificate, ``info`` and a digest of all of them.

        Args:
            path: File to write. An existing file is replaced only if it is a bounder's, by its name or its content.

        Raises:
            FileFormatError: If it cannot be written, or if another kind of file is there, which is kept.

        Example:
            >>> bounder.save("ball.safetensors")
            >>> wb.load("ball.safetensors", device="cpu").certificate == bounder.certificate
            True
        """
        save(self, path)

    def __repr__(self) -> str:
        proof = self.certificate.kind if self.certificate else "no certificate"
        text = f"{self.method} bounder, {self.ndim}D {self.query_kind} queries, {self.nbytes} bytes, {proof}"
        return f"<{text}, {self.tightness}>" if self.tightness else f"<{text}>"
