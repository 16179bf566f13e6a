"""The contract of a distance bounder: a function g with ``g(x) <= distance(x, object)`` for every float32 x anywhere, proven.

A method supplies a function F of local coordinates (``DistanceDomain``), and everything else is the same for all of them:

* ``source``: a ``DistanceSource`` with the native text of F (``body``), and ``whole``, whether F is
  a bound everywhere or in the domain only; and ``weights()``, the float32 numbers that both read;
* ``reference(v)``: the same F in plain NumPy float64, which tests and proofs evaluate;
* ``rounding_bound()``: ``E >= computed F - exact F`` wherever F is asked, ``FLUSHED`` included; where ``whole``, also ``growth()``;
* ``volume``, a proven bounder of points, where F is the distance to a volume that holds the object; else ``corners``, certified upper bounds
  of F over boxes, ``pieces``, the boxes that a proof begins with, and ``steepness``;
* ``options``, what users can tell it, and ``supports``.

It is proven when ``threshold <= L - E``, where ``d - F >= L`` on all of the domain, d the local distance (0 in the object): so the claim has the form of every
other certificate's, of ``f = d - F``. ``-threshold`` is the *slack*, what is taken off F. A new method is one file with a subclass, and a line
in ``methods.py`` (``register_distance``).
"""

from abc import abstractmethod
from typing import Any, ClassVar

import numpy as np

from warp_bounding.bounders.base import Bounder
from warp_bounding.bounders.distances.asking import AskingDistance
from warp_bounding.bounders.file_format import save
from warp_bounding.bounders.options import Option
from warp_bounding.certificates.certificate import Certificate
from warp_bounding.coordinates.distance_domain import DistanceDomain
from warp_bounding.errors import BounderError
from warp_bounding.indicators.shape import Shape
from warp_bounding.kernels.distances.source import MOST_DIMENSIONS
from warp_bounding.queries.distance import DISTANCE
from warp_bounding.runtime.devices import device_of

__all__ = ["DistanceBounder"]


class DistanceBounder(AskingDistance):
    """A lower bound of the distance to an object, 0 in it and wherever nothing better is proven.

    Attributes:
        method: The name that ``method=`` takes.
        domain: The box that holds the object, and the map into it.
        threshold: float32, at most 0: what is added to F, the slack with its sign turned.
        certificate: What is proven of it, or ``None``.
        info: How it was made, by the names in ``file_format.INFO_FIELDS``.
        device: The Warp device that queries run on.

    Example:
        >>> far = wb.fit(ball, "distance", "sphere", device="cpu")
        >>> far.certificate.proven
        True
        >>> bool((far.distance(points).numpy() <= ball_distances).all())
        True
    """

    method: ClassVar[str]
    options: ClassVar[tuple[Option, ...]] = ()
    conservative: ClassVar[bool] = True
    composed: ClassVar[bool] = False
    provable: ClassVar[bool] = True
    query_kind: ClassVar[str] = DISTANCE.name

    def __init__(
        self,
        domain: DistanceDomain,
        tensors: dict[str, np.ndarray],
        sizes: dict[str, Any],
        device: str | None = None,
    ):
        """Copy and check what a bounder is made of.

        Args:
            domain: See class.
            tensors: Arrays by role, float32 or the method's ``tensor_types``; copied, so that nothing can change them later.
            sizes: JSON-ready structure that the tensors do not tell.
            device: Warp device; the default device if ``None``.

        Raises:
            BounderError: If a tensor is not finite or of the wrong type.
            DeviceError: If there is no such device.
        """
        device_of(device)
        if not isinstance(domain, DistanceDomain):
            raise BounderError(f"{self.method}: expected the domain of a distance, got {type(domain).__name__}")
        if domain.time and not self.moving:
            raise BounderError(f"{self.method}: there is no distance of shapes that move")
        if domain.ndim > MOST_DIMENSIONS:
            raise BounderError(f"{self.method}: distances have at most {MOST_DIMENSIONS} dimensions, got {domain.ndim}")
        if not isinstance(sizes, dict):
            raise BounderError(f"sizes must be a table of names, got {sizes!r}")
        self.domain, self.sizes = domain, dict(sizes)
        self.tensors = {name: np.array(value, order="C") for name, value in tensors.items()}
        for name, value in self.tensors.items():
            if value.dtype not in self.tensor_types(name):
                raise BounderError(f"tensor {name} must not be {value.dtype}")
            if value.dtype.kind == "f" and not np.isfinite(value).all():
                raise BounderError(f"tensor {name} holds a value that is not finite")
            value.setflags(write=False)
        self.threshold = np.float32(0.0)
        self.certificate: Certificate | None = None
        self.info: dict[str, Any] = {}
        self._device = device
        self.check_tensors()

    @staticmethod
    def tensor_types(name: str) -> tuple[type, ...]:
        """NumPy types that a tensor may have."""
        return (np.float32,)

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
        """Exact F (up to float64 rounding) of ``(N, n)`` float64 local coordinates; ``(N,)`` float64."""

    @abstractmethod
    def rounding_bound(self) -> float:
        """E; see module."""

    @property
    def volume(self) -> Bounder | None:
        """A bounder of points whose *maybe* holds the object, where F is a lower bound of the distance to it; else ``None``."""
        return None

    moving: ClassVar[bool] = False  # whether it has distances of shapes that move
    room: ClassVar[float] = 0.0  # of the longest side: by how much the domain reaches beyond the object

    def corners(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Numbers at the corners of boxes: F is at most what is multilinear between them, certified.

        Args:
            lower: ``(N, n)`` float64, local coordinates, in one of ``pieces`` each.
            upper: ``(N, n)`` float64.

        Returns:
            ``(N, 2^n)`` float64; the corner at place i is the upper one on axis k where bit k of i is set.
        """
        raise TypeError(f"{type(self).__name__} does not define corners")

    def pieces(self) -> tuple[np.ndarray, np.ndarray]:
        """``(P, n)`` and ``(P, n)`` float64, boxes that cover the domain, which a proof begins with; the domain itself by default."""
        limit = self.domain.limit.astype(np.float64)
        return -limit[None], limit[None]

    part_count: int = 1  # parts of the domain that have a slack of their own each; no piece lies in two of them

    def part_of(self, v: np.ndarray) -> np.ndarray:
        """``(N,)`` int, the parts in which local coordinates ``(N, n)`` lie."""
        return np.zeros(len(v), dtype=np.int64)

    def relieve(self, excess: np.ndarray) -> None:
        """Let each part have a slack of its own, in place: F grows by that, and no threshold is known any more.

        Args:
            excess: ``(parts,)`` float64: F exceeds the distance in each part by no more, local units. The largest stays as it is.
        """

    @property
    def rate(self) -> float:
        """Where coordinate 0 is time: more than F changes in a local unit of time; local units."""
        raise TypeError(f"{type(self).__name__} does not define rate")

    @property
    def steepness(self) -> float:
        """At least 1, and more than the numbers at corners change on the way of one local unit along any axis, all axes together."""
        return 1.0

    @classmethod
    def supports(cls, ndim: int) -> bool:
        """Whether the method has distances of n-dimensional objects."""
        return 1 <= ndim <= MOST_DIMENSIONS

    @classmethod
    def options_taken(cls) -> tuple[Option, ...]:
        """What ``fit`` and the command line can tell the method."""
        return cls.options

    # --- what follows ------------------------------------------------------------------------------------------------

    @property
    def parts(self) -> "list[DistanceBounder]":
        """This one: there are no conjunctions of distances."""
        return [self]

    @property
    def slack(self) -> float:
        """What is taken off F so that it is a lower bound, rounding included; object units."""
        return -float(self.threshold) * self.domain.unit

    @property
    def size(self) -> float:
        """The longest side in space of the box that holds the object, with the domain's room; object units."""
        return float((self.domain.upper - self.domain.lower)[int(self.domain.time) :].max())

    def exact(self, x: np.ndarray) -> np.ndarray:
        """G of points ``(N, n)`` as float64 has it, without what float32 rounds: what ``distance`` comes close to from below."""
        v, n = self.domain.to_local(x), self.ndim
        whole = self.source.whole
        p = v if whole else self.domain.clipped(v)
        value = self.reference(p.reshape(-1, n)) + float(self.threshold)
        if not whole:
            value = np.hypot(np.linalg.norm(v - p, axis=1), np.maximum(value, 0.0))
        if self.domain.time:
            value = np.where(np.abs(v[:, 0]) > self.domain.limit[0], 0.0, value)
        return np.maximum(value, 0.0) * self.domain.unit

    def to(self, device: str | None = None) -> "DistanceBounder":
        """This bounder on another device; arguments as of ``Bounder.to``.

        Raises:
            DeviceError: If there is no such device.

        Example:
            >>> far.to("cpu").certificate == far.certificate
            True
        """
        device = self._device if device is None else device
        device_of(device)
        copy = object.__new__(type(self))
        copy.__dict__.update(self.__dict__)
        copy._device, copy._data = device, None
        return copy

    def freeze(self, threshold: float, certificate: Certificate | None) -> "DistanceBounder":
        """Set threshold and certificate, in place; nothing else changes them.

        Args:
            threshold: Rounded to float32; at most 0.
            certificate: What is known of this threshold; ``None`` for nothing.

        Raises:
            BounderError: For a threshold above 0, with which rounding is not accounted for.
        """
        if not np.float32(threshold) <= 0:
            raise BounderError(f"{self.method}: the threshold of a distance is at most 0, got {threshold:g}")
        self.info = {key: value for key, value in self.info.items() if key != "rates"}
        self.threshold = np.float32(threshold)
        self.certificate = certificate
        self._data = None
        return self

    @property
    def nbytes(self) -> int:
        """Bytes of data that one query can read; the tag and the lengths in front of them are not counted."""
        head = len(self.domain.header) + 2 + len(self.extra)
        return 4 * (head + len(self.weights())) + (self.words().nbytes if len(self.words()) > 1 else 0)

    @property
    def tightness(self) -> str:
        """False positives of points at radius 0 in words, as ``fit`` measured them; empty where it did not."""
        rates = self.info.get("rates")
        if not rates:
            return ""
        text = f"{rates['fp_rate']:.2f} % false positives at radius 0 ({rates['samples']:,} samples)"
        return f"{text}, slack {self.slack:.3g}"

    def save(self, path) -> None:
        """Write one ``.safetensors`` file, whole or not at all; as ``Bounder.save``.

        Raises:
            FileFormatError: If it cannot be written, or if another kind of file is there, which is kept.

        Example:
            >>> far.save("far.safetensors")
            >>> wb.load("far.safetensors", device="cpu").certificate == far.certificate
            True
        """
        save(self, path)

    def __repr__(self) -> str:
        proof = self.certificate.kind if self.certificate else "no certificate"
        text = f"{self.method} distance bounder, {self.ndim}D, {self.nbytes} bytes, {proof}"
        return f"<{text}, {self.tightness}>" if self.tightness else f"<{text}>"

    @classmethod
    def fit(cls, shape: Shape, domain: DistanceDomain, *, device: str | None = None, **options) -> "DistanceBounder":
        """The method's F of a shape, in closed form, where there is one and no volume.

        Raises:
            BounderError: If there is none.
        """
        raise BounderError(f"{cls.method}: there is no closed form of its distance")
