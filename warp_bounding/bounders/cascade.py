"""``cascade``: several bounders of the same queries, the cheap ones first; it answers *maybe* iff each of them does.

A conjunction of conservative tests is conservative, so every part is proven by itself (``parts``). Where the first
parts deny, the later ones cost nothing. On a CPU the batch path asks a part for a block of queries and moves its
survivors together for the next one; other code asks one query at a time.

``f`` is the last part's where all others say *maybe*, and ``DENIED`` elsewhere.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate

import numpy as np

from warp_bounding.bounders.bounder import (
    BIT_FIELDS,
    Bounder,
    check_kinds,
    check_members,
    composed,
    holding,
    members_of,
    word_places,
    words_of,
)
from warp_bounding.bounders.mlp import Local
from warp_bounding.bounders.mlp_early import MlpEarly, bounds_of_all, denied_early
from warp_bounding.certificates import Certificate, conjunction
from warp_bounding.certificates.claim import differing
from warp_bounding.errors import BounderError
from warp_bounding.kernels.source import DENIED, Early, Lanes, Source, aligned, words_at
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.runtime.native import literal
from warp_bounding.shapes.shape import Shape

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


@composed
class Cascade(Bounder):
    """A conjunction of bounders; made by ``warp_bounding.cascade``.

    Tensors: those of part i, each under ``i.`` and its role there, and ``thresholds`` of all parts but the last. Sizes:
    ``parts``, a list of ``method`` and ``sizes``.
    """

    method = "cascade"
    exact_on_cells = False
    bit_fields = BIT_FIELDS

    @classmethod
    def supports(cls, query: str, ndim: int) -> bool:
        return True  # whatever its parts support

    @classmethod
    def check(cls, classes: list[type[Bounder]]) -> None:
        """Refuse bounders that cannot be put together, with ``BounderError``."""
        if not 2 <= len(classes) <= MOST_PARTS:
            raise BounderError(f"{cls.method}: expected 2 to {MOST_PARTS} bounders, got {len(classes)}")
        check_kinds(cls.method, classes)
        if any(part.composed or issubclass(part, (MlpEarly, Local, Cascade)) for part in classes[:-1]):
            raise BounderError(f"{cls.method}: only the last part may have exits, thresholds or parts of its own")

    @classmethod
    def of(cls, parts: list[Bounder]) -> "Cascade":
        """The conjunction of bounders at their own thresholds, without a certificate.

        Raises:
            BounderError: If they are bounders of other queries or domains, or cannot be put together (``check``).
        """
        check_members(cls.method, parts)
        cls.check([type(part) for part in parts])
        (tensors, sizes), last = holding(parts), parts[-1]
        tensors["thresholds"] = np.array([part.threshold for part in parts[:-1]], dtype=np.float32)
        return cls(last.domain, tensors, sizes, last._device).freeze(last.threshold, None)

    def check_tensors(self) -> None:
        self.members, shapes = members_of(self, 2, MOST_PARTS)
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
    def provable(self) -> bool:
        return all(part.provable for part in self.members)

    @cached_property
    def source(self) -> CascadeSource:
        sources = tuple(part.source for part in self.members)
        last, *firsts = word_places([self.members[-1], *self.members[:-1]])
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

    def words(self) -> np.ndarray:
        words = words_of([self.members[-1], *self.members[:-1]])
        return super().words() if words is None else words

    def reference(self, v: np.ndarray) -> np.ndarray:
        return denied_early(self.members[:-1], v, self.members[-1].reference(v))

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        last = BoxBounds(*self.members[-1].bound(lower, upper)[:4])
        return bounds_of_all(self.members[:-1], last, lower, upper, self.reference)

    def rounding_bound(self) -> float:
        return self.members[-1].rounding_bound()  # that of the others is in ``bound``


# Entries of ``info`` that the whole has of one of its parts.
ABOUT = ("indicator", "margin", "resolution", "shape", "name", "grid_shape", "seed", "note")

CLAIMED = ("margin", "length", "resolution")  # fields of certificates, beside the object (``differing``)


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
    whole.frame = last.frame
    for bounder in bounders:
        if other := differing(bounder, last):
            raise BounderError(f"cascade: expected bounders of the same object, got {other}")
    whole.info = {key: last.info.get(key) for key in ABOUT}
    whole.info["training"] = {"parts": [bounder.info.get("training") for bounder in bounders]}
    certificates = [bounder.certificate for bounder in bounders]
    if all(certificates):
        check_objects(certificates, (*CLAIMED, "indicator"))
        whole.freeze(float(whole.threshold), conjunction(certificates))
    return whole


def check_objects(certificates: list[Certificate], names: tuple[str, ...] = CLAIMED) -> None:
    """Refuse certificates of different objects, margins, lengths of rays, or cells."""
    for certificate in certificates:
        for name in names:
            one, other = getattr(certificates[0], name), getattr(certificate, name)
            if None not in (one, other) and one != other:  # (older certificates do not name all of these)
                raise BounderError(f"expected certificates of the same object, got {name} {one} and {other}")
