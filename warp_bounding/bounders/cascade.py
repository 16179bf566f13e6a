"""``cascade``: bounders that are asked in turn, of which each must say *maybe*; ``two_sided``: one from each side.

A ``cascade`` are several bounders of the same queries, the cheap ones first; it answers *maybe* iff each of them does.
A conjunction of conservative tests is conservative, so every part is proven by itself (``parts``). Where the first
parts deny, the later ones cost nothing. On a CPU the batch path asks a part for a block of queries and moves its
survivors together for the next one; other code asks one query at a time. ``f`` is the last part's where all others say
*maybe*, and ``DENIED`` elsewhere.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate

import numpy as np
import warp as wp

from warp_bounding.bounders.bounder import COMPOSED, Bounder, class_named
from warp_bounding.certificates import Certificate, conjunction
from warp_bounding.certificates.claim import differing
from warp_bounding.errors import BounderError
from warp_bounding.kernels.functions import Data
from warp_bounding.kernels.source import DENIED, Early, Lanes, Source, aligned, words_at
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.queries.domain import GROWTH
from warp_bounding.queries.point import POINT
from warp_bounding.runtime.arrays import Picklable, new_output
from warp_bounding.runtime.launch import launch_on_cores
from warp_bounding.runtime.native import literal, named, vector_type
from warp_bounding.shapes.complement import SIDES

MOST_PARTS = 8
# Entries of ``info`` that the whole has of one of its members.
ABOUT = ("indicator", "margin", "resolution", "shape", "name", "grid_shape", "seed", "note")
CLAIMED = ("margin", "length", "resolution", "indicator")  # fields of certificates that must agree


@dataclass(frozen=True)
class CascadeSource(Source):
    """Native code of a cascade.

    In memory the last part's numbers come first, because with lanes its body runs alone and reads ``w`` from there;
    then those of each other part, at a multiple of
    ``kernels.source.ALIGN``; and at last the thresholds of the others. Bit fields stand in the same order.
    """

    sources: tuple[Source, ...]  # of the parts, in the order in which they are asked
    counts: tuple[int, ...]  # how many numbers each part has, in the same order
    fields: tuple[int, ...]  # where the words of each begin; 0 of the last one

    packed = True

    @property
    def width(self) -> dict[str, int]:
        """See ``Source``: that of the last part, which costs most."""
        return self.sources[-1].width

    @property
    def places(self) -> list[int]:
        """Index in ``w`` of each part's first number, in the order of ``sources``; at last, that of the thresholds."""
        order = (self.counts[-1], *self.counts[:-1])
        places = list(accumulate(map(aligned, order), initial=0))
        return [*places[1:-1], 0, places[-1]]

    @property
    def depth(self) -> int:
        """How many cascades are in each other.

        Each has names of its own, as the innermost of two alike would hide the other.
        """
        last = self.sources[-1]
        return 1 + last.depth if isinstance(last, CascadeSource) else 1

    def early(self) -> list[Early]:
        lanes = Lanes(vector=True)
        own = [Early(_at(place, source.body(lanes)), bar) for place, source, bar in self._before_last()]
        return [*own, *self.sources[-1].early()]

    def body(self, lanes: Lanes) -> str:
        """See ``Source.body``: all parts for a single query; the last one for lanes, where ``early`` has the others."""
        last = self.sources[-1].body(lanes)
        if lanes.vector:
            return last
        lines = []
        for place, source, threshold in self._before_last():
            lines += [_at(place, source.body(lanes)), f"if (f < {threshold}) {{ f = {literal(DENIED)}; }} else {{"]
        return "\n".join([*lines, _at((0, 0), last), "}" * (len(self.sources) - 1)])

    def function_body(self) -> str:
        part, answer = f"part_f_{self.depth}_", f"answer_{self.depth}_"
        lines = [f"float {part}, {answer} = {literal(DENIED)}; do {{ /* runs once; break: denied */"]
        for place, source, threshold in self._before_last():
            lines += [_at(place, f"{source.function_body()} {part} = f;"), f"if ({part} < {threshold}) break;"]
        lines += [_at((0, 0), f"{self.sources[-1].function_body()} {answer} = f;")]
        return "\n".join([*lines, f"}} while (false); const float f = {answer};"])

    def _before_last(self) -> list[tuple[tuple[int, int], Source, str]]:
        """For all parts but the last: offsets of its numbers and words, its source, and the C text of its threshold."""
        *places, _, thresholds_at = self.places
        own = enumerate(zip(zip(places, self.fields[:-1], strict=True), self.sources[:-1], strict=True))
        return [(place, source, f"w[{thresholds_at + i}]") for i, (place, source) in own]


def _at(place: tuple[int, int], code: str) -> str:
    """A part's code, with its own numbers at ``w`` and its own words in ``words``."""
    numbers, field = place
    if field:
        code = f"const unsigned int* const fields_ = words.data; {{ {words_at('fields_', field)} {code} }}"
    return f"{{ const float* const whole_ = w; {{ const float* w = whole_ + {numbers}; (void)w; {code} }} }}"


def _has_bits(member: Bounder) -> bool:
    """Whether a member has a bit field, or holds members that do."""
    return any(tensor.dtype == np.uint32 for tensor in member.tensors.values())


class Cascade(Bounder):
    """A conjunction of bounders, the ``members``; made by ``warp_bounding.cascade``.

    Tensors: those of member i, each under ``i.`` and its role there, and ``thresholds`` of all members but the last.
    Sizes: ``parts``, a list of each member's ``method`` and ``sizes``.
    """

    method = "cascade"
    exact_on_cells = False
    bit_fields = ("bits",)
    members: list[Bounder]

    @classmethod
    def supports(cls, query: str, ndim: int) -> bool:
        return True  # whatever its members support

    @classmethod
    def check(cls, classes: Sequence[type[Bounder]]) -> None:
        """Refuse bounders that cannot be put together, with ``BounderError``."""
        if not 2 <= len(classes) <= MOST_PARTS:
            raise BounderError(f"{cls.method}: expected 2 to {MOST_PARTS} bounders, got {len(classes)}")
        if any(kind.of_distances for kind in classes):
            raise BounderError(f"{cls.method}: expected bounders that answer yes or no, got one of distances")
        if wrong := [kind.method for kind in classes if not kind.conservative]:
            raise BounderError(f"{cls.method}: {wrong[0]} is not conservative")
        if any(issubclass(kind, Cascade) for kind in classes[:-1]):
            raise BounderError(f"{cls.method}: only the last part may have parts of its own")

    @classmethod
    def of(cls, members: Sequence[Bounder]) -> "Cascade":
        """The conjunction of bounders at their own thresholds, without a certificate.

        Raises:
            BounderError: If they are bounders of other queries or domains, or cannot be put together (``check``).
        """
        cls.check([type(member) for member in members])
        *firsts, last = members
        for member in firsts:
            if member.domain.to_dict() != last.domain.to_dict():
                got = f"got {last!r} and {member!r}"
                raise BounderError(f"{cls.method}: expected bounders of the same queries and domain, {got}")
        tensors = {f"{i}.{role}": value for i, member in enumerate(members) for role, value in member.tensors.items()}
        tensors["thresholds"] = np.array([member.threshold for member in firsts], dtype=np.float32)
        sizes = {"parts": [{"method": member.method, "sizes": member.sizes} for member in members]}
        return cls(last.domain, tensors, sizes, last._device).freeze(last.threshold, None)

    def check_tensors(self) -> None:
        entries = self.sizes.get("parts")
        if not isinstance(entries, list):
            raise BounderError(f"{self.method}: expected a list of parts, got {entries!r}")
        own: list[dict[str, np.ndarray]] = [{} for _ in entries]
        for name, value in self.tensors.items():
            number, _, role = name.partition(".")
            if role and number.isdecimal() and str(int(number)) == number and int(number) < len(own):
                own[int(number)][role] = value
        self.members = []
        for i, (entry, tensors) in enumerate(zip(entries, own, strict=True)):
            kind = class_named(entry.get("method")) if isinstance(entry, dict) else None
            if kind is None:
                raise BounderError(f"{self.method}: part {i} is no bounder that can be a part: {entry!r}")
            self.members.append(kind(self.domain, tensors, entry["sizes"], self._device))
        self.check([type(member) for member in self.members])
        shapes = {f"{i}.{role}": tensor.shape for i, tensors in enumerate(own) for role, tensor in tensors.items()}
        self.expect_shapes(shapes | {"thresholds": (len(self.members) - 1,)})
        for part, threshold in zip(self.members[:-1], self.tensors["thresholds"], strict=True):
            part.freeze(threshold, None)

    @property
    def parts(self) -> list[Bounder]:
        """See ``Bounder``: copies of the members, in order, with those of a cascade at the end."""
        *firsts, last = (part.to(self._device) for part in self.members)
        return [*firsts, *last.freeze(self.threshold, None).parts]

    @property
    def _in_memory(self) -> list[Bounder]:
        """The members in the order in which their words stand behind each other."""
        return [self.members[-1], *self.members[:-1]]

    @cached_property
    def source(self) -> CascadeSource:
        counts = [len(member.words()) if _has_bits(member) else 0 for member in self._in_memory]
        places = accumulate(counts, initial=0)
        last, *firsts = [place if own else 0 for own, place in zip(counts, places, strict=False)]
        numbers = tuple(len(part.weights()) for part in self.members)
        return self.source_of(CascadeSource, tuple(part.source for part in self.members), numbers, (*firsts, last))

    def words(self) -> np.ndarray:
        fields = [member.words() for member in self._in_memory if _has_bits(member)]
        return np.concatenate(fields) if fields else super().words()

    def weights(self) -> np.ndarray:
        """See ``Bounder``; the layout is described in ``CascadeSource``."""
        *places, thresholds_at = self.source.places
        numbers = np.zeros(thresholds_at + len(self.members) - 1, np.float32)
        for place, part in zip(places, self.members, strict=True):
            own = part.weights()
            numbers[place : place + len(own)] = own
        numbers[thresholds_at:] = self.tensors["thresholds"]
        return numbers

    def reference(self, v: np.ndarray) -> np.ndarray:
        *firsts, last = self.members
        f = last.reference(v)
        for part in firsts:
            f = np.where(part.reference(v) < float(part.threshold), DENIED, f)
        return f

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """See ``Bounder``: the last part's bounds where every part before it passes on every device."""
        *firsts, last = self.members
        least, axis, point = (np.array(x) for x in last.bound(lower, upper)[:3])
        for part in firsts:
            own = part.bound(lower, upper)
            # Where a part may deny on some device, f may be DENIED: no better bound holds there, and halving goes by
            # that part's axis.
            fails = ~(own.lower >= float(part.threshold) + part.rounding_bound() * GROWTH)
            least[fails], axis[fails], point[fails] = DENIED, own.axis[fails], own.point[fails]
        return BoxBounds(least, axis, point, self.reference(point))

    def rounding_bound(self) -> float:
        return self.members[-1].rounding_bound()  # that of the others is in ``bound``


# Files name it; ``fit`` takes names with + in its place.
COMPOSED[Cascade.method] = Cascade


def cascade(*bounders: Bounder) -> Cascade:
    """A bounder that says *maybe* iff all of these do, asked in this order.

    Args:
        bounders: Bounders of the same queries of the same object, such as an ``aabb`` and an ``mlp``. A query costs no
            more than the bounders up to the first one that denies it.

    Returns:
        The cascade. It is proven if all parts are, statistical if one of them is, and without a certificate if one has
        none.

    Raises:
        BounderError: If they were made for different objects, margins, queries or domains, or cannot be put together
            (``Cascade.of``).

    Example:
        >>> both = wb.cascade(wb.fit(ball, method="sphere", device="cpu"), bounder)
        >>> both.method, both.certificate.proven
        ('cascade', True)
    """
    last = bounders[-1]
    whole = Cascade.of([bounder.local for bounder in bounders])
    for bounder in bounders:
        if other := differing(bounder, last):
            raise BounderError(f"{whole.method}: expected bounders of the same object, got {other}")
    whole.frame = last.frame
    whole.info = {key: last.info.get(key) for key in ABOUT}
    whole.info["training"] = {"parts": [bounder.info.get("training") for bounder in bounders]}
    certificates = [bounder.certificate for bounder in bounders]
    if all(certificates):
        _check_objects(certificates)
        whole.freeze(float(whole.threshold), conjunction(certificates))
    return whole


def _check_objects(certificates: list[Certificate]) -> None:
    """Refuse certificates of different objects, margins, lengths of rays, or cells."""
    for certificate in certificates:
        for name in CLAIMED:
            one, other = getattr(certificates[0], name), getattr(certificate, name)
            if None not in (one, other) and one != other:  # (older certificates do not name all of these)
                raise BounderError(f"expected certificates of the same object, got {name} {one} and {other}")


# --- from both sides: certainly not, maybe, certainly -----------------------------------------------------------------

NO, MAYBE, YES = 0, 1, 2  # answers of ``classify``


@wp.kernel(enable_backward=False)
def _combine(
    first: int, outer: wp.array(dtype=wp.bool), inner: wp.array(dtype=wp.bool), found: wp.array(dtype=wp.uint8)
):
    i = first + wp.tid()
    found[i] = wp.uint8(outer[i]) * (wp.uint8(YES) - wp.uint8(inner[i]))


class TwoSided(Picklable):
    """Two bounders of one object; made by ``two_sided``.

    Attributes:
        outer: Of the object: its *no* is certainly outside.
        inner: Of the object's complement (``fit(..., side="inside")``): its *no* is certainly inside.

    Example:
        >>> inner = wb.fit(ball, side="inside", hidden=(8,), steps=30, device="cpu")
        >>> both = wb.two_sided(bounder, inner)
        >>> both.nbytes == bounder.nbytes + inner.nbytes
        True
    """

    def __init__(self, outer: Bounder, inner: Bounder):
        self.outer, self.inner = outer, inner

    def classify(self, x, *, xform=None, scale=None, out: wp.array | None = None) -> wp.array:
        """Where points are; arguments as in ``Bounder.query``, but ``out`` is uint8.

        Returns:
            ``(N,)`` uint8 ``wp.array``: 0 = certainly not in the object dilated by the outer margin, 2 = certainly in
            the object dilated by the inner one, 1 = maybe.

        Raises:
            QueryError: As ``Bounder.query`` does.

        Example:
            >>> both = wb.two_sided(bounder, wb.fit(ball, side="inside", hidden=(8,), steps=30, device="cpu"))
            >>> int(both.classify(np.array([[9.0, 9.0, 9.0]], np.float32)).numpy()[0])
            0
        """
        placed = {"xform": xform, "scale": scale}
        maybe, device = self.outer.query(x, **placed), self.outer.device
        found = new_output(out, maybe.shape[0], wp.uint8, device)
        if device.is_cpu:  # only what is not outside for certain is asked whether it is inside
            answers, points = found.numpy(), x.numpy() if isinstance(x, wp.array) else x
            points = points if hasattr(points, "shape") else np.asarray(points, np.float64)
            answers[:] = maybe.numpy()
            left = np.flatnonzero(answers)
            answers[left] = YES - self.inner.query(points[left], **placed).numpy()
            return found
        within = self.inner.query(x, **placed)  # there, knowing how many are left would take longer than asking all
        launch_on_cores(_combine, found.shape[0], inputs=[maybe, within], outputs=[found], device=device)
        return found

    @cached_property
    def func(self) -> wp.Function:
        """The answer for one point in your kernels: ``wp.static(both.func)(both.outer.data, both.inner.data, q)``."""
        outer, inner = self.outer.func, self.inner.func
        vector = vector_type(self.outer.ndim)

        @named(f"{outer.key}_{inner.key}_sides").func
        def sides(outside: Data, inside: Data, q: vector) -> int:
            if not outer(outside, q):
                return NO
            if inner(inside, q):
                return MAYBE
            return YES

        return sides

    @property
    def nbytes(self) -> int:
        """Bytes of both."""
        return self.outer.nbytes + self.inner.nbytes

    def __repr__(self) -> str:
        return f"<two-sided: {self.outer!r}, {self.inner!r}>"


def two_sided(outer: Bounder, inner: Bounder) -> TwoSided:
    """A bounder from the outside and one from the inside, asked together.

    Args:
        outer: Of points, as ``fit`` makes it.
        inner: Of points, made by ``fit(..., side="inside")``, with a margin of at most the outer one. One of the two
            may bound cells of the other's shape.

    Returns:
        What classifies points; each half is proven, saved and certified by itself.

    Raises:
        BounderError: If these are not one of each, or of different objects, dimensions or devices.

    Example:
        >>> inner = wb.fit(ball, side="inside", hidden=(8,), steps=30, device="cpu")
        >>> wb.two_sided(bounder, inner).classify(points).shape
        (100,)
    """
    for bounder, name, side in ((outer, "outer", SIDES[0]), (inner, "inner", SIDES[1])):
        if not isinstance(bounder, Bounder) or bounder.query_kind != POINT.name:
            raise BounderError(f"two_sided: {name} must be a bounder of points, got {bounder!r}")
        if SIDES[bounder.domain.unbounded] != side:
            raise BounderError(f"two_sided: {name} must be fitted with side={side!r}, got {bounder!r}")
    kinds = [(b.ndim, b.domain.time, str(b.device)) for b in (outer, inner)]
    if kinds[0] != kinds[1]:
        raise BounderError(f"two_sided: expected the same dimension and device, got {kinds[0]} and {kinds[1]}")
    if other := differing(outer, inner, ()):
        raise BounderError(f"two_sided: expected bounders of the same object, got {other}")
    margins = [bounder.info.get("margin") or 0.0 for bounder in (outer, inner)]
    if not margins[0] >= margins[1]:
        raise BounderError(
            f"two_sided: expected an outer margin of at least the inner one, got {margins[0]} and {margins[1]}"
        )
    return TwoSided(outer, inner)
