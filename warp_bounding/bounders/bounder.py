"""The contract of a bounder, and everything that all methods share.

A bounder maps a query to coordinates ``v`` (``Domain``), computes one float32 number ``f(v)`` and answers *maybe* iff
``not (f < threshold)``, which is not ``f >= threshold``: a NaN must be answered with *maybe*. A method supplies:

* ``source``: a ``Source`` with the native text of ``f`` (``body``); and
  ``weights()``, the float32 numbers that both read;
* ``reference(v)``: the same ``f`` in plain NumPy float64, which tests and proofs evaluate;
* ``bound(lower, upper)``: a certified lower bound of the exact ``f`` over boxes of ``v``;
* ``rounding_bound()``: ``E >= |f as any device computes it - exact f|`` wherever the domain test lets a query through;
* ``options``, which users can set, and ``supports``, what it bounds;
* ``fit(grid, domain, ...)``, where the volume is computed in closed form; where it is learned, an entry in
  ``training.fit.TRAINERS``.

It is proven when ``threshold <= (least bound over the widened object) - E``; ``proof`` establishes that, for every
method by the same code. A new method is one file with a subclass, and its name in ``bounders/__init__.py``
(``register``).
"""

from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property
from inspect import Parameter, signature
from types import MappingProxyType
from typing import Any, ClassVar, TypeVar

import numpy as np

from warp_bounding.bounders.batch import Queryable
from warp_bounding.bounders.file_format import save
from warp_bounding.certificates import Certificate
from warp_bounding.errors import BounderError
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.queries import QUERIES
from warp_bounding.queries.distance import DISTANCE
from warp_bounding.queries.region_domain import AnyDomain
from warp_bounding.rounding import UNIT32
from warp_bounding.runtime.launch import device_of
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.shape import Shape

# --- options ---------------------------------------------------------------------------------------------------------
#
# What users can set in addition to shape and query: each class of bounders lists its ``options``.
#
# ``fit`` and the command line read them there. An option that no part of a method takes is refused, never ignored.

ALIKE = 0.7  # least similarity, as ``difflib`` has it, of a name and the one that is suggested in its place


@dataclass(frozen=True)
class Option:
    """One option of a method.

    Attributes:
        name: As ``fit`` takes it, and the command line after two dashes.
        default: The value of an option that is not given. Where it is ``None`` the method decides.
        help: A few words for the command line.
        check: Turns a given value into the one that the method uses; raises ``BounderError`` if it makes no sense.
        parse: Turns the command line's text into a value; raises ``BounderError`` if the text is none.
        queries: Kinds of query that the option is for.
    """

    name: str
    default: Any
    help: str
    check: Callable[[Any], Any] = lambda value: value
    parse: Callable[[str], Any] = str
    queries: tuple[str, ...] = tuple(QUERIES)


def checked(name: str, expected: Callable[[], str], fits: Callable[[Any], bool], made: Callable = lambda value: value):
    """A check: raises ``BounderError`` unless a value ``fits``; ``made`` turns it into what the method uses."""

    def check(value: Any) -> Any:
        if not fits(value):
            raise BounderError(f"{name} must be {expected()}, got {value!r}")
        return made(value)

    return check


def whole(name: str, least: int, most: int | None = None) -> Callable[[Any], int]:
    """A check for whole numbers of at least ``least``, and where there is one, at most ``most``."""

    def fits(value: Any) -> bool:
        whole_number = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
        return whole_number and value >= least and (most is None or value <= most)

    limits = f"of at least {least}" if most is None else f"from {least} to {most}"
    return checked(name, lambda: f"a whole number {limits}", fits, int)


def one_of(name: str, names: Iterable[str]) -> Callable[[Any], str]:
    """A check for names; ``names`` may grow later."""
    return checked(name, lambda: f"one of {', '.join(names)}", lambda value: value in tuple(names))


def truth(name: str) -> Callable[[Any], bool]:
    """A check for truth values."""
    return checked(name, lambda: "True or False", lambda value: isinstance(value, bool))


_STEPS = "training steps, instead of seconds: repeatable to the bit on a machine"
STEPS = Option("steps", None, _STEPS, whole("steps", 1), int)


def taken(classes: Iterable[type], query: str) -> dict[str, Option]:
    """The options that one of these classes of bounders takes for a kind of query, by name."""
    return {
        option.name: option for cls in classes for option in cls.options if cls.of_distances or query in option.queries
    }


def resolved(
    classes: list[type], query: str, given: dict[str, Any], callers: Iterable[Callable] = ()
) -> list[dict[str, Any]]:
    """The value of every option of each class of bounders: as given, else the class's default.

    ``callers`` are the functions that pass the options on. Raises ``BounderError`` for a wrong value, or an option that
    none of the classes takes for this kind of query; the message names those that are taken.
    """
    known = taken(classes, query)
    if unknown := [name for name in given if name not in known]:
        raise BounderError(_unknown(unknown[0], list(known), classes, query, list(callers)))
    return [{name: _value(option, given) for name, option in taken([cls], query).items()} for cls in classes]


def _unknown(name: str, known: list[str], classes: list[type], query: str, callers: list[Callable]) -> str:
    """The message for an unknown option: the option or argument of a caller probably meant, and all options."""
    own = [
        p.name for caller in callers for p in signature(caller).parameters.values() if p.kind != Parameter.VAR_KEYWORD
    ]
    near, method = get_close_matches(name, [*known, *own], 1, ALIKE), "+".join(cls.method for cls in classes)
    beside = f"besides the arguments of {' and '.join(caller.__name__ for caller in callers)}, " if callers else ""
    asked = "distances" if query == DISTANCE.name else f"{query} queries"
    takes = f"{beside}{method} takes {', '.join(known) or 'no options of its own'} for {asked}"
    if not near:
        return f"{method} takes no option {name!r}; {takes}"
    return f"there is no option {name!r}; did you mean {near[0]!r}? {takes[0].upper() + takes[1:] if beside else takes}"


def _value(option: Option, given: dict[str, Any]) -> Any:
    value = given.get(option.name, option.default)
    return None if value is None and option.default is None else option.check(value)


# --- the base --------------------------------------------------------------------------------------------------------


class OnlyOfDistances:
    """What bounders of distances have and others do not, which say so."""

    def __get__(self, bounder, kind=None):
        raise AttributeError("only distances have this: wb.fit(shape, 'distance')")


CELLS_AT_A_TIME = 16384  # cells whose boxes are bounded in one call, so that memory stays small


class Bounder(Queryable):
    """A conservative test: *maybe* (true) or certainly *no* (false). Never *no* where the truth is *yes*.

    Attributes:
        method: The name that ``method=`` takes.
        query_kind: The kind of query: ``"point"``, ``"ray"``, ``"plane"`` or ``"box"``.
        domain: The box it was made for, and the map into it.
        threshold: float32; the answer is *maybe* iff ``not (f < threshold)``.
        certificate: The claim that is proven or tested of it, or ``None``.
        info: How it was made, by the names in ``file_format.INFO_FIELDS``. ``training`` is a record of the fit, with
            its seconds; ``rates`` are false positives on a few queries, its own and an axis-aligned box's
            (``quick_rates``).
        device: The Warp device that queries run on.

    Example:
        >>> bounder = wb.fit(ball, method="obb", device="cpu")
        >>> bounder.certificate.proven
        True
        >>> bounder.query(np.array([[0.5, 0.5, 0.5], [9.0, 9.0, 9.0]], np.float32)).numpy()
        array([ True, False])
    """

    method: ClassVar[str]
    highest_threshold: ClassVar[float] = np.inf  # the highest that a proof may set
    exact_on_cells: ClassVar[bool] = True  # one pass over the cells (``least``) is the proof, without a search
    of_volume: ClassVar[bool] = False  # regions are tested against a volume of points
    lays_cells: ClassVar[bool] = False  # it is made of cells, also where the shape has none
    conservative: ClassVar[bool] = True  # False: it has false negatives, for comparison, and never a certificate
    bit_fields: ClassVar[tuple[str, ...]] = ()  # how the names of uint32 tensors end, also of members' tensors
    takes_seconds: ClassVar[bool] = False  # ``fit`` has an argument ``seconds``; when they are over it ends, looser
    options: ClassVar[tuple[Option, ...]] = ()  # what ``fit`` and the command line can set
    instead: ClassVar[str] = ""  # more of the message about a kind of query that the method does not bound
    distance = segments = rays = boxes = OnlyOfDistances()
    distance_func = segment_func = ray_func = box_func = slack = OnlyOfDistances()

    def __init__(
        self, domain: AnyDomain, tensors: dict[str, np.ndarray], sizes: dict[str, Any], device: str | None = None
    ):
        """Copy and check what a bounder is made of.

        Args:
            domain: See class.
            tensors: Arrays by role, float32 or of the method's ``tensor_types``; copied, so that nothing can change
                them later.
            sizes: JSON-ready structure that does not follow from the tensors.
            device: Warp device; the default device if ``None``.

        Raises:
            BounderError: If a tensor is not finite or of the wrong type, or the method does not bound such queries.
            DeviceError: If there is no such device.
        """
        device_of(device)
        self.check_domain(domain)
        if not isinstance(sizes, dict):
            raise BounderError(f"sizes must be a table of names, got {sizes!r}")
        self.domain = domain
        self.sizes = dict(sizes)
        self.tensors = {name: np.array(value, order="C") for name, value in tensors.items()}
        for name, value in self.tensors.items():
            expected = self.tensor_types(name)
            if value.dtype not in expected:
                names = " or ".join(kind.__name__ for kind in expected)
                raise BounderError(f"tensor {name} must be {names}, got {value.dtype}")
            if value.dtype.kind == "f" and not np.isfinite(value).all():
                raise BounderError(f"tensor {name} holds a value that is not finite")
            value.setflags(write=False)
        self._threshold = np.float32(0.0)
        self.certificate: Certificate | None = None
        self.info: dict[str, Any] = {}
        self._device = device
        self.check_tensors()

    @classmethod
    def check_domain(cls, domain: Any) -> None:
        """Refuse a domain that the method has no bounders in, with ``BounderError``."""
        if not cls.supports(domain.query, domain.space_ndim):
            raise BounderError(unsupported(cls, domain.query, domain.space_ndim))

    @classmethod
    def tensor_types(cls, name: str) -> tuple[type, ...]:
        """NumPy types that a tensor may have."""
        return (np.uint32,) if name.rpartition(".")[2] in cls.bit_fields else (np.float32,)

    def expect_shapes(self, expected: dict[str, tuple[int, ...]]) -> None:
        """Refuse tensors of other names or shapes, with ``BounderError``."""
        found = {name: tensor.shape for name, tensor in self.tensors.items()}
        if found != expected:
            raise BounderError(f"{self.method}: expected tensors {expected}, got {found}")

    # --- what a method supplies --------------------------------------------------------------------------------------

    def check_tensors(self) -> None:
        """Refuse tensors and sizes that do not fit together, and derive attributes from them; part of the constructor.

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
            The bounds, the axis to halve next, and a point of each box where f is likely to be least, with f there. The
            other fields of ``BoxBounds`` are for networks.
        """

    @abstractmethod
    def rounding_bound(self) -> float:
        """``E``: bound of the error of ``f`` as any device computes it, for ``|v| <= domain.limit``.

        For regions that are tested against a volume, the computed ``f(v)`` is at least the largest value that the
        volume's exact f has on the region ``v``, less E.
        """

    @property
    def parts(self) -> "list[Bounder]":
        """The bounders whose conjunction this is, each at its threshold; they are proven one by one."""
        return [self]

    @cached_property
    def volume(self) -> "Bounder | None":
        """The volume that regions are tested against, as a bounder of points; ``None`` where f is a function of v."""
        if not (self.of_volume and self.domain.tested_as_region):
            return None
        return type(self)(self.domain.base, self.tensors, self.sizes, self._device)

    @classmethod
    def fit(cls, grid: Grid, domain: AnyDomain, *, device: str | None = None, **options) -> "Bounder":
        """The method's volume of a grid, in closed form, or ``BounderError``; ``prove`` sets its threshold."""
        raise BounderError(f"{cls.method}: there is no closed form")

    def least(self, grid: Grid) -> tuple[float, int]:
        """Certified least ``f`` over all v that a positive query can give, by one pass over the cells of an object.

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

    @property
    def threshold(self) -> np.float32:
        """See class; ``freeze`` sets it, as the certificate is about it."""
        return self._threshold

    @threshold.setter
    def threshold(self, value):
        raise BounderError(
            f"the certificate is about this threshold, which cannot be assigned: bounder.freeze({value!r}, None)"
        )

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
        self._threshold = np.float32(threshold)
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
        return self._head_bytes + sum(t.nbytes for t in self.tensors.values())

    @property
    def _head_bytes(self) -> int:
        return 4 * len(self._header(self.threshold))

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

    @property
    def summary(self) -> str:
        """What it bounds, in a few words."""
        return f"bounder, {self.ndim}D {self.query_kind} queries"

    # --- keeping it --------------------------------------------------------------------------------------------------

    def save(self, path) -> None:
        """Write one ``.safetensors`` file, whole or not at all.

        It holds tensors, domain, threshold, certificate, ``info`` and a digest of all of them.

        Args:
            path: File to write. An existing file is replaced only if it is a bounder's, by its name or its content.

        Raises:
            FileFormatError: If it cannot be written, or if another kind of file is there, which stays.

        Example:
            >>> bounder.save("ball.safetensors")
            >>> wb.load("ball.safetensors", device="cpu").certificate == bounder.certificate
            True
        """
        save(self, path)

    def export(self, path, name: str | None = None) -> None:
        """Write a header for C99, C++11 and CUDA that answers single queries without this library; see *In C++*.

        Args:
            path: File to write. An existing one is replaced only if it is an export.
            name: What the functions' names begin with; the file's name without its suffix if ``None``.

        Raises:
            BounderError: If functions in C cannot have such names.
            FileFormatError: If the file cannot be written, or is something else, which stays.
            QueryError: For a bounder with an origin: export ``local``, and subtract ``origin`` in float64.

        Example:
            >>> bounder.export("ball.h")
            >>> "int ball_maybe(const float q[3])" in open("ball.h").read()
            True
        """
        from warp_bounding.bounders.export import export  # a query needs no text of headers

        export(self, path, name)

    def __repr__(self) -> str:
        proof = self.certificate.kind if self.certificate else "no certificate"
        text = f"{self.method} {self.summary}, {self.nbytes} bytes, {proof}"
        return f"<{text}, {self.tightness}>" if self.tightness else f"<{text}>"


# --- registry --------------------------------------------------------------------------------------------------------
#
# The methods by name. ``register`` adds one, from inside the package (``bounders/__init__.py``) or from outside it.

_registered: dict[str, type[Bounder]] = {}
_distances: dict[str, type[Bounder]] = {}
METHODS: Mapping[str, type[Bounder]] = MappingProxyType(_registered)  # in the order in which they were registered
DISTANCES: Mapping[str, type[Bounder]] = MappingProxyType(_distances)  # of distances; a name in both is of one volume
Kind = TypeVar("Kind", bound=Bounder)
COMPOSED: dict[str, type[Bounder]] = {}  # made of others (``cascade``): files name them, ``fit`` does not


def register(kind: type[Kind]) -> type[Kind]:
    """Make a method known by its name to ``fit``, ``load``, cascades and the command line. Also a decorator of a class.

    Args:
        kind: A class of bounders with a ``method`` of its own; see ``Bounder`` for what it supplies, and
            ``DistanceBounder``.

    Returns:
        The class.

    Raises:
        BounderError: If it is no class of bounders, or another one has its name.
    """
    if not (isinstance(kind, type) and issubclass(kind, Bounder)):
        raise BounderError(f"expected a class of bounders, got {kind!r}")
    name, known = getattr(kind, "method", None), _distances if kind.of_distances else _registered
    if not isinstance(name, str) or not name or "+" in name or name in COMPOSED:
        others = ", ".join(sorted(COMPOSED))
        raise BounderError(f"{kind.__name__}.method must be a name without +, none of {others}, got {name!r}")
    if known.setdefault(name, kind) is not kind:
        raise BounderError(f"method {name} is {known[name].__name__} already, got {kind.__name__}")
    return kind


def class_named(name: str, query: str = "point") -> type[Bounder] | None:
    """The class that a file calls by a name, of a method or of composed bounders; ``None`` for unknown names."""
    return _distances.get(name) if query == DISTANCE.name else _registered.get(name) or COMPOSED.get(name)


def unregister(kind: type[Bounder]) -> None:
    """Undo ``register``."""
    known = _distances if kind.of_distances else _registered
    if known.get(kind.method) is kind:
        del known[kind.method]


def known_method(method: str) -> type[Bounder]:
    """The class of a method, whatever queries it supports; raises ``BounderError`` for an unknown name."""
    if method not in METHODS:
        near = get_close_matches(str(method), METHODS, n=1)
        meant = f"; did you mean {near[0]!r}?" if near else ""
        known = f"{', '.join(METHODS)}, or a cascade such as 'aabb+mlp'"
        raise BounderError(f"method must be one of {known}, got {method!r}{meant}")
    return METHODS[method]


def method_class(method: str, query: str = "point", ndim: int = 3) -> type[Bounder]:
    """The class of a method that bounds a kind of query, or the distance.

    Raises:
        BounderError: For an unknown method, or one that does not support the query.
    """
    if query == DISTANCE.name:
        if method not in DISTANCES:
            raise BounderError(f"method of a distance must be one of {', '.join(DISTANCES)}, got {method!r}")
        if not DISTANCES[method].supports(query, ndim):
            raise BounderError(f"method {method} has no distance of {ndim}D objects")
        return DISTANCES[method]
    if not known_method(method).supports(query, ndim):
        raise BounderError(f"method {unsupported(METHODS[method], query, ndim)}")
    return METHODS[method]


def unsupported(cls: type[Bounder], query: str, ndim: int) -> str:
    """The message for a method that cannot bound a kind of query of n-dimensional objects; it names those that can."""
    others = [name for name, kind in METHODS.items() if kind.conservative and kind.supports(query, ndim)]
    can = f"{', '.join(others) or 'none'} can{cls.instead}"
    return f"{cls.method} does not bound {query} queries of {ndim}D objects; {can}"


def supports(method: str, query: str, ndim: int) -> bool:
    """Whether a method can bound a kind of query of an n-dimensional object; ``False`` for unknown methods.

    A cascade such as ``"kdop+mlp"`` can if each of its parts can.
    """
    return all(name in METHODS and METHODS[name].supports(query, ndim) for name in method.split("+"))
