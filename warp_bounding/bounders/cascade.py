"""Bounders that are made of others: what they share; ``cascade``; and ``local``, a network with many thresholds.

A ``cascade`` are several bounders of the same queries, the cheap ones first; it answers *maybe* iff each of them does.
A conjunction of conservative tests is conservative, so every part is proven by itself (``parts``). Where the first
parts deny, the later ones cost nothing. On a CPU the batch path asks a part for a block of queries and moves its
survivors together for the next one; other code asks one query at a time. ``f`` is the last part's where all others say
*maybe*, and ``DENIED`` elsewhere.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from math import prod
from typing import Any

import numpy as np

from warp_bounding.bounders.bounder import COMPOSED, Bounder, class_named
from warp_bounding.bounders.mlp import MOST_PARTS as MOST_LOCAL
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.bounders.mlp_early import MlpEarly, bounds_of_all, denied_early
from warp_bounding.certificates import Certificate, conjunction
from warp_bounding.certificates.claim import differing
from warp_bounding.errors import BounderError
from warp_bounding.kernels.source import DENIED, Early, Lanes, Source, aligned, fill, words_at
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.queries.point import POINT
from warp_bounding.rounding import TINY, UNIT32, gamma
from warp_bounding.runtime.native import literal
from warp_bounding.shapes.shape import Shape

# --- what they share -------------------------------------------------------------------------------------------------

# Entries of ``info`` that the whole has of one of its members.
ABOUT = ("indicator", "margin", "resolution", "shape", "name", "grid_shape", "seed", "note")
CLAIMED = ("margin", "length", "resolution")  # fields of certificates, beside the object (``differing``)


class Composed(Bounder):
    """Bounders that are made of others, the ``members``.

    Tensor ``r`` of member i is the tensor ``i.r`` of the whole; ``sizes["parts"]`` has an entry for each member, its
    ``method`` and its ``sizes``.
    """

    exact_on_cells = False
    bit_fields = ("bits", "levels")
    members: list[Bounder]

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        COMPOSED[cls.method] = cls

    @classmethod
    def supports(cls, query: str, ndim: int) -> bool:
        return True  # whatever its members support

    @classmethod
    def check_kinds(cls, kinds: Sequence[type[Bounder]]) -> None:
        """Refuse classes of members that say *no* to positives, with ``BounderError``."""
        if any(kind.of_distances for kind in kinds):
            raise BounderError(f"{cls.method}: expected bounders that answer yes or no, got one of distances")
        if wrong := [kind.method for kind in kinds if not kind.conservative]:
            raise BounderError(f"{cls.method}: {wrong[0]} is not conservative")

    @classmethod
    def holding(cls, members: Sequence[Bounder]) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Tensors and sizes that hold members, which must be conservative, of the same queries and domain."""
        for member in members:
            if not isinstance(member, Bounder):
                raise BounderError(f"{cls.method}: expected bounders, got {type(member).__name__}")
        cls.check_kinds([type(member) for member in members])
        for member in members:
            if member.domain.to_dict() != members[0].domain.to_dict():
                got = f"got {members[0]!r} and {member!r}"
                raise BounderError(f"{cls.method}: expected bounders of the same queries and domain, {got}")
        tensors = {f"{i}.{role}": value for i, member in enumerate(members) for role, value in member.tensors.items()}
        return tensors, {"parts": [{"method": member.method, "sizes": member.sizes} for member in members]}

    def read_members(
        self, least: int, most: int, fits: Callable[[type[Bounder]], bool] = lambda kind: True
    ) -> dict[str, tuple[int, ...]]:
        """Make the members, from ``least`` to ``most``, of tensors and sizes; returns the shapes of their tensors.

        They are not yet at their thresholds. Raises ``BounderError`` if there are more or fewer, or one cannot be a
        member (``fits``) or is not conservative.
        """
        entries = self.sizes.get("parts")
        if not isinstance(entries, list) or not least <= len(entries) <= most:
            expected = f"{least} to {most} parts" if least < most else f"a list of parts, {least} of them"
            got = len(entries) if isinstance(entries, list) else repr(entries)
            raise BounderError(f"{self.method}: expected {expected}, got {got}")
        own: list[dict[str, np.ndarray]] = [{} for _ in entries]
        for name, value in self.tensors.items():
            number, _, role = name.partition(".")
            if role and number.isdecimal() and str(int(number)) == number and int(number) < len(own):
                own[int(number)][role] = value
        self.members = []
        for i, (entry, tensors) in enumerate(zip(entries, own, strict=True)):
            kind = class_named(entry.get("method")) if isinstance(entry, dict) else None
            if kind is None or not fits(kind):
                raise BounderError(f"{self.method}: part {i} is no bounder that can be a part: {entry!r}")
            self.members.append(kind(self.domain, tensors, entry["sizes"], self._device))
        self.check_kinds([type(member) for member in self.members])
        return {f"{i}.{role}": t.shape for i, tensors in enumerate(own) for role, t in tensors.items()}

    def describe(self, bounders: Sequence[Bounder], one: Bounder) -> None:
        """Take from ``one`` of the bounders that this is made of what is known of their object.

        Raises ``BounderError`` if they were made for different objects or margins.
        """
        self.frame = one.frame
        for bounder in bounders:
            if other := differing(bounder, one):
                raise BounderError(f"{self.method}: expected bounders of the same object, got {other}")
        self.info = {key: one.info.get(key) for key in ABOUT}
        self.info["training"] = {"parts": [bounder.info.get("training") for bounder in bounders]}

    @property
    def in_memory(self) -> list[Bounder]:
        """The members in the order in which their words stand behind each other."""
        return self.members

    def words(self) -> np.ndarray:
        fields = [member.words() for member in self.in_memory if has_bits(member)]
        return np.concatenate(fields) if fields else super().words()

    def word_places(self) -> list[int]:
        """For each member, as they stand in memory, where its own words begin; 0 where it has none."""
        counts = [len(member.words()) if has_bits(member) else 0 for member in self.in_memory]
        return [place if own else 0 for own, place in zip(counts, accumulate(counts, initial=0), strict=False)]


def has_bits(member: Bounder) -> bool:
    """Whether a member has a bit field, or holds members that do."""
    return any(tensor.dtype == np.uint32 for tensor in member.tensors.values())


def check_objects(certificates: list[Certificate], names: tuple[str, ...] = CLAIMED) -> None:
    """Refuse certificates of different objects, margins, lengths of rays, or cells."""
    for certificate in certificates:
        for name in names:
            one, other = getattr(certificates[0], name), getattr(certificate, name)
            if None not in (one, other) and one != other:  # (older certificates do not name all of these)
                raise BounderError(f"expected certificates of the same object, got {name} {one} and {other}")


# --- cascades --------------------------------------------------------------------------------------------------------

MOST_PARTS = 8


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

    def ask(self, values: bool) -> str | None:
        return self.sources[-1].ask(values)

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
        code = f"const auto* const fields_ = words.data; {{ {words_at('fields_', field)} {code} }}"
    return f"{{ const float* const whole_ = w; {{ const float* w = whole_ + {numbers}; (void)w; {code} }} }}"


class Cascade(Composed):
    """A conjunction of bounders; made by ``warp_bounding.cascade``.

    Tensors: those of part i, each under ``i.`` and its role there, and ``thresholds`` of all parts but the last. Sizes:
    ``parts``, a list of ``method`` and ``sizes``.
    """

    method = "cascade"

    @classmethod
    def check(cls, classes: list[type[Bounder]]) -> None:
        """Refuse bounders that cannot be put together, with ``BounderError``."""
        if not 2 <= len(classes) <= MOST_PARTS:
            raise BounderError(f"{cls.method}: expected 2 to {MOST_PARTS} bounders, got {len(classes)}")
        cls.check_kinds(classes)
        if any(part.composed or issubclass(part, (MlpEarly, Local, Cascade)) for part in classes[:-1]):
            raise BounderError(f"{cls.method}: only the last part may have exits, thresholds or parts of its own")

    @classmethod
    def of(cls, parts: list[Bounder]) -> "Cascade":
        """The conjunction of bounders at their own thresholds, without a certificate.

        Raises:
            BounderError: If they are bounders of other queries or domains, or cannot be put together (``check``).
        """
        (tensors, sizes), last = cls.holding(parts), parts[-1]
        cls.check([type(part) for part in parts])
        tensors["thresholds"] = np.array([part.threshold for part in parts[:-1]], dtype=np.float32)
        return cls(last.domain, tensors, sizes, last._device).freeze(last.threshold, None)

    def check_tensors(self) -> None:
        shapes = self.read_members(2, MOST_PARTS)
        self.check([type(part) for part in self.members])
        self.composed = self.members[-1].composed  # a union, whose f it then has
        self.expect_shapes(shapes | {"thresholds": (len(self.members) - 1,)})
        for part, threshold in zip(self.members[:-1], self.tensors["thresholds"], strict=True):
            part.freeze(threshold, None)

    @property
    def parts(self) -> list[Bounder]:
        """See ``Bounder``: copies of the members, in order; a last member with exits counts as its own parts."""
        *firsts, last = (part.to(self._device) for part in self.members)
        last = last.freeze(self.threshold, None)
        return [*firsts, last] if last.composed else [*firsts, *last.parts]

    def obligations(self, shape: Shape) -> list[tuple[Bounder, Shape]]:
        """See ``Bounder``: a union at the end has obligations of its own."""
        *firsts, last = self.parts
        return [*((part, shape) for part in firsts), *last.obligations(shape)]

    @property
    def in_memory(self) -> list[Bounder]:
        return [self.members[-1], *self.members[:-1]]

    @cached_property
    def source(self) -> CascadeSource:
        sources = tuple(part.source for part in self.members)
        last, *firsts = self.word_places()
        counts = tuple(len(part.weights()) for part in self.members)
        return self.source_of(CascadeSource, sources, counts, (*firsts, last))

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
        return denied_early(self.members[:-1], v, self.members[-1].reference(v))

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        last = BoxBounds(*self.members[-1].bound(lower, upper)[:4])
        return bounds_of_all(self.members[:-1], last, lower, upper, self.reference)

    def rounding_bound(self) -> float:
        return self.members[-1].rounding_bound()  # that of the others is in ``bound``


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
    whole.describe(bounders, last)
    certificates = [bounder.certificate for bounder in bounders]
    if all(certificates):
        check_objects(certificates, (*CLAIMED, "indicator"))
        whole.freeze(float(whole.threshold), conjunction(certificates))
    return whole


# --- thresholds by parts ---------------------------------------------------------------------------------------------
#
# ``local``: a network with a threshold of its own in each part of the domain, so that its worst place sets one price.
#
# The coordinates v are cut along each axis at *edges*, into a lattice of parts. Each part has a *level*, one byte: the
# threshold that f must reach there; or that no positive lies in the part at all, or hardly anything else, and the
# network is not even evaluated. f less the threshold of v's part is the f of this class; it jumps at the edges, and so
# proofs cut their boxes there (``cut``).

# Edges keep this far from 0, so that a device that takes tiny v for 0 finds the same part.
NEAREST_TO_ZERO = 2.0**-64


class Lattice:
    """The domain cut at edges.

    Args:
        edges: For each axis of v, its inner edges in ascending order, float32.
    """

    def __init__(self, edges: list[np.ndarray]):
        self.edges = [np.array(axis, dtype=np.float32) for axis in edges]
        for axis in self.edges:
            axis[np.abs(axis) < NEAREST_TO_ZERO] = NEAREST_TO_ZERO
        self.shape = tuple(len(axis) + 1 for axis in self.edges)

    @classmethod
    def of(cls, lower: np.ndarray, upper: np.ndarray, shape: tuple[int, ...]) -> "Lattice":
        """Parts of equal size between two corners ``(n,)``; the outer ones go on to the end of the domain."""
        ends = zip(lower, upper, shape, strict=True)
        return cls([np.linspace(low, high, count + 1)[1:-1].astype(np.float32) for low, high, count in ends])

    def moved(self, to: Callable[[np.ndarray], np.ndarray]) -> "Lattice":
        """The same parts in other coordinates, each axis by itself: ``to`` maps ``(N, n)`` to ``(N, n)``."""
        moved = []
        for k, axis in enumerate(self.edges):
            at = np.zeros((len(axis), len(self.edges)))
            at[:, k] = axis
            moved.append(to(at)[:, k].astype(np.float32))
        return Lattice(moved)

    @property
    def count(self) -> int:
        """Number of parts."""
        return prod(self.shape)

    def place(self, v: np.ndarray) -> np.ndarray:
        """``(N,)`` int64: index of the part that holds each v ``(N, n)``."""
        along = [np.searchsorted(axis, v[:, k], side="right") for k, axis in enumerate(self.edges)]
        return np.ravel_multi_index(along, self.shape) if along else np.zeros(len(v), np.int64)

    def cut(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Boxes ``(N, n)`` cut at the edges: each piece lies in the closure of one part, its lower corner in it.

        A box that ends on an edge has a piece without width beyond it. Returns corners of the pieces, ``(K, n)``
        float64 each, and which box each one is a piece of.
        """
        owner = np.arange(len(lower))
        for k, axis in enumerate(self.edges):
            first = np.searchsorted(axis, lower[:, k], side="right")
            last = np.searchsorted(axis, upper[:, k], side="right")
            times = last - first + 1
            row = np.repeat(np.arange(len(lower)), times)
            step = np.arange(len(row)) - np.repeat(np.cumsum(times) - times, times)
            ends = np.concatenate([[-np.inf], axis.astype(np.float64), [np.inf]])
            lower, upper, owner = lower[row], upper[row], owner[row]
            lower[:, k] = np.maximum(lower[:, k], ends[first[row] + step])
            upper[:, k] = np.minimum(upper[:, k], ends[first[row] + step + 1])
        return lower, upper, owner

    def ranges(self, lower: np.ndarray, upper: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each axis the first and the last part that the box's inside meets, of pieces the one that they lie in."""
        pairs = []
        for k, axis in enumerate(self.edges):
            first = np.searchsorted(axis, lower[:, k], side="right")
            pairs.append((first, np.maximum(first, np.searchsorted(axis, upper[:, k], side="left"))))
        return pairs

    def extremes(
        self, values: np.ndarray, lower: np.ndarray, upper: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Least and largest ``values`` ``(parts,)`` of parts that boxes ``(N, n)`` meet; and which meet only one."""
        ranges, every = self.ranges(lower, upper), values.reshape(self.shape)
        single = np.all([first == last for first, last in ranges], axis=0)
        least = every[tuple(first for first, _ in ranges)]
        most = least.copy()
        for row in np.flatnonzero(~single):
            inside = every[tuple(slice(first[row], last[row] + 1) for first, last in ranges)]
            least[row], most[row] = inside.min(), inside.max()
        return least, most, single

    @classmethod
    def stored(cls, edges: np.ndarray, shape: tuple[int, ...], method: str) -> "Lattice":
        """The lattice of a file: the edges of each axis in turn.

        Raises ``BounderError`` if they do not ascend, or one of them is too near to 0.
        """
        lattice = cls(np.split(edges, np.cumsum([count - 1 for count in shape])[:-1]))
        if not (all((np.diff(axis) > 0).all() for axis in lattice.edges) and (np.abs(edges) >= NEAREST_TO_ZERO).all()):
            raise BounderError(f"{method}: edges must ascend, none of them 0")
        return lattice


def checked_parts(bounder: Bounder) -> tuple[list[int], dict[str, tuple[int, ...]]]:
    """How many parts there are along each axis, as the sizes say, and the shapes of the lattice's tensors.

    Raises ``BounderError`` for what cannot be.
    """
    shape, ndim = bounder.sizes.get("shape"), bounder.domain.ndim
    whole = isinstance(shape, list) and all(type(count) is int and count >= 1 for count in shape)
    if not whole or len(shape) != ndim or prod(shape) > MOST_LOCAL:
        raise BounderError(f"{bounder.method}: expected {ndim} counts, at most {MOST_LOCAL} parts, got {shape!r}")
    return shape, {"edges": (sum(shape) - ndim,), "levels": (-(-prod(shape) // PER_WORD),)}


def packed(levels: np.ndarray) -> np.ndarray:
    """``(ceil(parts / 4),)`` uint32, words of levels ``(parts,)`` uint8."""
    return np.pad(levels, (0, -len(levels) % PER_WORD)).view("<u4").astype(np.uint32)


def unpacked(words: np.ndarray, count: int) -> np.ndarray:
    """``(count,)`` uint8, the levels in words."""
    return words.astype("<u4").view(np.uint8)[:count]


# --- native text -----------------------------------------------------------------------------------------------------
#
# A lattice of parts in native code: where v lies among the edges of each axis, and the level, a byte, that stands
# there.
#
# Comparisons with edges are exact, so every device finds the same part of the domain, and what is proven of a part
# holds for each v in it.

PER_WORD = 4  # levels, a byte each, in a word

# The index of v's part, in array order: along each axis, how many edges v has reached.
_PLACE = {True: "I part_ = {};\n$axes", False: "int part_ = 0;\n$axes"}
_AXIS = {
    True: "{ I i = {}; for (int e = $first; e < $last; ++e) i -= v[$k] >= w[e]; part_ = part_ * $count + i; }",
    False: "{ int i = 0; for (int e = $first; e < $last; ++e) i += v[$k] >= w[e]; part_ = part_ * $count + i; }",
}
_LEVEL = {
    True: """
V level_;
{
    int at_[L]; float found_[L];  // in memory: lanes of a vector are dear one by one
    *(J*)at_ = part_;
    for (int l = 0; l < L; ++l) found_[l] = (float)(words.data[at_[l] >> 2] >> (8 * (at_[l] & 3)) & 255u);
    level_ = *(const V*)found_;
}
""",
    False: "const float level_ = (float)(words.data[part_ >> 2] >> (8 * (part_ & 3)) & 255u);\n",
}


def level_text(shape: tuple[int, ...], first: int, vector: bool) -> str:
    """C statements that compute ``level_`` from ``v``, ``w``, where edges begin at ``first``, and ``words``."""
    lines = []
    for k, count in enumerate(shape):
        if count > 1:
            lines.append(fill(_AXIS[vector], k=k, first=first, last=first + count - 1, count=count))
        first += count - 1
    return fill(_PLACE[vector], axes="\n".join(lines)) + _LEVEL[vector]


# --- source ----------------------------------------------------------------------------------------------------------
#
# Native code of local thresholds: where v lies among the edges, the level that stands there, and what is left of f.
#
# A threshold is ``step * (first + level)``, a power of two times
# a whole number under 2^24: float32 holds it, however it is computed.

NOWHERE = 255  # the level of a part without positives: there every query is denied
EVERYWHERE = 254  # the level of a part where the network denies next to nothing: there no query is
CERTAIN = -DENIED  # f where no query is denied


@dataclass(frozen=True)
class LocalSource(Source):
    """Native code of a bounder with local thresholds.

    Numbers: the member's, so that its text reads ``w`` as if it were alone; the inner edges of each axis in turn; the
    first level's number, and the step.
    """

    member: Source
    count: int  # how many numbers the member has
    shape: tuple[int, ...]  # parts along each axis of v

    packed = True

    @property
    def width(self) -> dict[str, int]:
        """See ``Source``: the member's."""
        return self.member.width

    @property
    def scale_at(self) -> int:
        """Index in ``w`` of the number of the first level; the step follows."""
        return self.count + sum(self.shape) - len(self.shape)

    def _level(self, vector: bool) -> str:
        """C statements that compute ``level_`` from ``v``."""
        return level_text(self.shape, self.count, vector)

    def _rest(self) -> str:
        """C text of the threshold."""
        return f"(level_ + w[{self.scale_at}]) * w[{self.scale_at + 1}]"

    def early(self) -> list[Early]:
        empty = f"f = {NOWHERE - 0.5}f - level_;"
        return [Early(self._level(vector=True) + empty, "0.0f"), *self.member.early()]

    def body(self, lanes: Lanes) -> str:
        if lanes.vector:  # ``early`` has denied the queries of parts without positives
            rest = f"f = level_ == {EVERYWHERE}.0f ? V{{}} + {literal(CERTAIN)} : f - {self._rest()};"
            return f"{{ {self.member.body(lanes)} }}\n{{ {self._level(vector=True)} {rest} }}"
        return (
            f"{{ {self._level(vector=False)} {self._given('f')} else {{ {self.member.body(lanes)} f -= "
            f"{self._rest()}; }} }}"
        )

    def _given(self, name: str) -> str:
        """C text of the answers that a level alone gives."""
        levels = (NOWHERE, DENIED), (EVERYWHERE, CERTAIN)
        return " else ".join(f"if (level_ == {level}.0f) {{ {name} = {literal(value)}; }}" for level, value in levels)

    def function_body(self) -> str:
        own = f"else {{ {self.member.function_body()} local_f_ = f - {self._rest()}; }} }}"
        lines = ["float local_f_;", f"{{ {self._level(vector=False)}", self._given("local_f_"), own]
        return "\n".join([*lines, "const float f = local_f_;"])

    @property
    def parts(self) -> int:
        """Number of parts."""
        return prod(self.shape)


LEVELS = EVERYWHERE  # how many levels are thresholds
STEP_RANGE = (2.0**-60, 2.0**30)  # between two levels
MOST_NUMBER = 2.0**22  # of the first level: sums with a level stay whole numbers that float32 holds


class Local(Composed):
    """A network at thresholds of the parts of its domain.

    Tensors: the network's, each under ``0.`` and its role there; ``edges``, the inner edges of each axis in turn;
    ``levels`` ``(ceil(parts / 4),)`` uint32, a byte for each part, which can be ``NOWHERE`` or ``EVERYWHERE``;
    ``scale`` ``(2,)``, the whole number of the first level, and the step, a power of two. Sizes: ``parts``, the
    network's ``method`` and ``sizes``; ``shape``.
    """

    method = "local"

    @classmethod
    def supports(cls, query: str, ndim: int) -> bool:
        return query == POINT.name

    @classmethod
    def of(cls, member: Mlp, lattice: Lattice, thresholds: np.ndarray, step: float) -> "Local":
        """A network at thresholds ``(parts,)``, each rounded down to a level, as far at least as the lowest one.

        So the lowest one loses nothing, once what all are too low by is made the bounder's own threshold. Infinity
        stands where no positive lies, minus infinity where no query is to be denied; ``step``, a power of two, lies
        between two levels, of which the highest stands for all thresholds above it. Raises ``BounderError`` if float32
        cannot distinguish them.
        """
        some = np.isfinite(thresholds)
        least = float(thresholds[some].min()) if some.any() else 0.0
        first = np.floor(least / step)
        levels = np.where(thresholds > 0, NOWHERE, EVERYWHERE).astype(np.uint8)
        levels[some] = np.clip(np.floor((thresholds[some] - least) / step), 0, LEVELS - 1)
        tensors, sizes = cls.holding([member])
        scale = np.array([first, step], np.float32)
        tensors |= {"edges": np.concatenate(lattice.edges), "levels": packed(levels), "scale": scale}
        return cls(member.domain, tensors, sizes | {"shape": list(lattice.shape)}, member._device)

    def check_tensors(self) -> None:
        shape, expected = checked_parts(self)
        shapes = self.read_members(1, 1, lambda kind: kind is Mlp)
        (self.member,) = self.members
        self.expect_shapes(shapes | expected | {"scale": (2,)})
        self.lattice = Lattice.stored(self.tensors["edges"], shape, self.method)
        first, step = (float(x) for x in self.tensors["scale"])
        if not (
            STEP_RANGE[0] <= step <= STEP_RANGE[1]
            and np.frexp(step)[0] == 0.5
            and first == np.floor(first)
            and abs(first) <= MOST_NUMBER
        ):
            raise BounderError(f"{self.method}: expected a whole number and a power of two, got {first} and {step}")
        self.check_range()

    @cached_property
    def thresholds(self) -> np.ndarray:
        """``(parts,)`` float64, exact; infinity where every query is denied, minus infinity where none is."""
        levels = unpacked(self.tensors["levels"], self.lattice.count).astype(np.float64)
        first, step = self.tensors["scale"].astype(np.float64)
        named = {NOWHERE: np.inf, EVERYWHERE: -np.inf}
        return np.select([levels == level for level in named], list(named.values()), (levels + first) * step)

    @property
    def source(self) -> LocalSource:
        return self.source_of(LocalSource, self.member.source, len(self.member.weights()), self.lattice.shape)

    def weights(self) -> np.ndarray:
        return np.concatenate([self.member.weights(), self.tensors["edges"], self.tensors["scale"]])

    def words(self) -> np.ndarray:
        return self.tensors["levels"]

    def cut(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.lattice.cut(lower, upper)

    def reference(self, v: np.ndarray) -> np.ndarray:
        v = np.asarray(v, dtype=np.float64)
        return np.clip(self.member.reference(v) - self.thresholds[self.lattice.place(v)], DENIED, CERTAIN)

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """See ``Bounder``. A box inside one part has the part's threshold everywhere, on its upper sides too."""
        bounds = self.member.bound(lower, upper)
        _, most, single = self.lattice.extremes(self.thresholds, lower, upper)
        # Not cut at DENIED: a part that is denied by its level is, whatever the threshold.
        least = np.minimum(np.nextafter(bounds.lower - most, -np.inf), CERTAIN)
        value = np.where(single, np.clip(bounds.value - most, DENIED, CERTAIN), self.reference(bounds.point))
        # A linear bound of the network is one of f, less the threshold, where that is one number and no value is cut.
        with np.errstate(over="ignore", invalid="ignore"):
            level = np.nextafter(bounds.level - most, -np.inf)
            reach = np.abs(level) + (np.abs(bounds.slope) * (upper - lower)).sum(axis=1)
        linear = single & (reach < CERTAIN)
        slope, level = np.where(linear[:, None], bounds.slope, 0.0), np.where(linear, level, least)
        return BoxBounds(least, bounds.axis, bounds.point, value, bounds.next_axis, slope, level)

    def rounding_bound(self) -> float:
        network, some = self.member.network, self.thresholds[np.isfinite(self.thresholds)]
        error = self.member.rounding_bound()
        size = network.largest + error + np.abs(some).max(initial=0.0)  # of f less a threshold, which rounds once
        return (error + gamma(2) * size + 2 * TINY) * (1 + 4 * UNIT32)
