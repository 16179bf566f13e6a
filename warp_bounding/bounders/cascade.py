"""``cascade``: several bounders of the same queries, the cheap ones first; the answer is *maybe* iff each of them says so.

A conjunction of conservative tests is conservative, so every part is proven by itself (``parts``), and the whole costs what the
first ones cost wherever these deny. On a CPU the batch path asks a part for a block of queries and moves its survivors together
for the next one; other code asks one query at a time.

``f`` is the last part's where all others pass, and ``DENIED`` elsewhere.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate

import numpy as np
import warp as wp

from warp_bounding.bounders.base import Bounder, BoxBounds
from warp_bounding.bounders.neural.mlp_early import MlpEarly
from warp_bounding.bounders.registry import METHODS
from warp_bounding.errors import BounderError
from warp_bounding.kernels.plain import Numbers, Words, plain_value, twin, vector_type
from warp_bounding.kernels.source import DENIED, Lanes, Source, literal

__all__ = ["Cascade", "CascadeSource"]

MOST_PARTS = 8
ALIGN = 16  # floats: where a part's numbers begin, as in a bounder by itself


@dataclass(frozen=True)
class CascadeSource(Source):
    """Native code of a cascade.

    Numbers: the last part's; then for each of the others, at a multiple of ``ALIGN``, its own, and at last their thresholds.

    Attributes:
        tests: The parts' sources, in the order in which they are asked.
        counts: How many numbers each has.
    """

    tests: tuple[Source, ...]
    counts: tuple[int, ...]

    packed = True

    @property
    def width(self) -> dict[str, int]:
        """See ``Source``: that of the last part, which costs most."""
        return self.tests[-1].width

    @property
    def places(self) -> list[int]:
        """Where each part's numbers begin, and behind them the thresholds; the last part comes first."""
        order = (self.counts[-1], *self.counts[:-1])
        places = list(accumulate((-(-count // ALIGN) * ALIGN for count in order), initial=0))
        return [*places[1:-1], 0, places[-1]]

    def early(self) -> list[tuple[str, str]]:
        *places, _, bars = self.places
        lanes = Lanes(vector=True)
        own = [
            (_at(p, t.body(lanes)), f"w[{bars + i}]") for i, (p, t) in enumerate(zip(places, self.tests, strict=False))
        ]
        return [*own, *self.tests[-1].early()]

    def body(self, lanes: Lanes) -> str:
        """See ``Source.body``; with all parts for a single query, with the last one for lanes, where ``early`` comes before."""
        if lanes.vector:
            return self.tests[-1].body(lanes)
        *places, last, bars = self.places
        lines = []
        for index, (place, test) in enumerate(zip(places, self.tests, strict=False)):
            lines += [_at(place, test.body(lanes)), f"if (f < w[{bars + index}]) {{ f = {literal(DENIED)}; }} else {{"]
        return "\n".join([*lines, _at(last, self.tests[-1].body(lanes)), "}" * len(places)])

    def function_body(self) -> str:
        """See ``Source.function_body``."""
        *places, last, bars = self.places
        lines = [f"float first_, answer_ = {literal(DENIED)}; do {{"]
        for index, (place, test) in enumerate(zip(places, self.tests, strict=False)):
            lines += [_at(place, test.function_body() + " first_ = f;"), f"if (first_ < w[{bars + index}]) break;"]
        lines += [_at(last, self.tests[-1].function_body() + " answer_ = f;")]
        return "\n".join([*lines, "} while (false); const float f = answer_;"])

    def plain(self) -> wp.Function:
        f = plain_value(self.tests[-1])
        for index in reversed(range(len(self.tests) - 1)):
            f = _behind(self, index, f)
        return f


def _behind(source: CascadeSource, index: int, rest: wp.Function) -> wp.Function:
    """The twin from part ``index`` on: ``rest`` where it passes."""
    test, place, bar = plain_value(source.tests[index]), source.places[index], source.places[-1] + index
    vector = vector_type(source.coordinates)

    @twin(source, f"value_{index}")
    def f(w: Numbers, words: Words, at: int, v: vector) -> float:
        if test(w, words, at + place, v) < w[at + bar]:
            return DENIED
        return rest(w, words, at, v)

    return f


def _at(place: int, code: str) -> str:
    """A part's code, with its own numbers at ``w``."""
    return f"{{ const float* const whole_ = w; {{ const float* w = whole_ + {place}; (void)w; {code} }} }}"


class Cascade(Bounder):
    """A conjunction of bounders; made by ``warp_bounding.cascade``.

    Tensors: part i's, each by ``i.`` and its role there, and ``thresholds`` of all parts but the last. Sizes: ``parts``, a list of
    ``method`` and ``sizes``.
    """

    method = "cascade"
    closed_form = False
    bit_fields = tuple(f"{i}.bits" for i in range(MOST_PARTS))

    @classmethod
    def supports(cls, query: str, ndim: int, space: str = "geometric") -> bool:
        """See ``Bounder``: what its parts support."""
        return True

    @classmethod
    def check(cls, kinds: list[type[Bounder]]) -> None:
        """Refuse bounders that cannot be put together.

        Raises:
            BounderError: If there is one only, or more than 8; one is not conservative; one but the last is a cascade or has exits; or
                more than one has a bit field.
        """
        if not 2 <= len(kinds) <= MOST_PARTS:
            raise BounderError(f"{cls.method}: expected 2 to {MOST_PARTS} bounders, got {len(kinds)}")
        for kind in kinds:
            if not kind.conservative:
                raise BounderError(f"{cls.method}: {kind.method} is not conservative")
        if any(issubclass(kind, (MlpEarly, Cascade)) for kind in kinds[:-1]):
            raise BounderError(f"{cls.method}: only the last part may have exits")
        if sum(bool(kind.bit_fields) for kind in kinds) > 1:
            raise BounderError(f"{cls.method}: only one part may have a bit field")

    @classmethod
    def of(cls, parts: list[Bounder]) -> "Cascade":
        """The conjunction, at the parts' thresholds; it holds no certificate yet.

        Raises:
            BounderError: If they are bounders of other queries or domains, or cannot be put together (``check``).
        """
        for part in parts:
            if not isinstance(part, Bounder):
                raise BounderError(f"{cls.method}: expected bounders, got {type(part).__name__}")
        cls.check([type(part) for part in parts])
        last = parts[-1]
        for part in parts:
            if part.domain.to_dict() != last.domain.to_dict():
                raise BounderError(
                    f"{cls.method}: expected bounders of the same queries and domain, got {part!r} and {last!r}"
                )
        tensors = {f"{i}.{name}": value for i, part in enumerate(parts) for name, value in part.tensors.items()}
        tensors["thresholds"] = np.array([part.threshold for part in parts[:-1]], dtype=np.float32)
        sizes = {"parts": [{"method": part.method, "sizes": part.sizes} for part in parts]}
        return cls(last.domain, tensors, sizes, last._device).freeze(last.threshold, None)

    def __init__(self, domain, tensors: dict[str, np.ndarray], sizes: dict, device: str | None = None):
        """See ``Bounder``; raises ``BounderError`` where tensors and sizes do not fit together."""
        super().__init__(domain, tensors, sizes, device)
        entries, self._tests = self.sizes.get("parts"), []
        if not isinstance(entries, list) or not entries:
            raise BounderError(f"{self.method}: expected a list of parts, got {entries!r}")
        known = {"thresholds"}
        for i, entry in enumerate(entries):
            kind = METHODS.get(entry.get("method")) if isinstance(entry, dict) else None
            if kind is None:
                raise BounderError(f"{self.method}: part {i} is no bounder: {entry!r}")
            own = {name.removeprefix(f"{i}."): t for name, t in self.tensors.items() if name.startswith(f"{i}.")}
            known |= {f"{i}.{name}" for name in own}
            self._tests.append(kind(domain, own, entry["sizes"], device))
        self.check([type(part) for part in self._tests])
        thresholds = self.tensors.get("thresholds")
        if set(self.tensors) != known or thresholds is None or thresholds.shape != (len(entries) - 1,):
            raise BounderError(
                f"{self.method}: expected the tensors of {len(entries)} parts, got {sorted(self.tensors)}"
            )
        for part, threshold in zip(self._tests, thresholds, strict=False):
            part.freeze(threshold, None)

    @property
    def parts(self) -> list[Bounder]:
        """See ``Bounder``: all that must pass, in order; of a network with exits each exit."""
        *firsts, last = (part.to(self._device) for part in self._tests)
        return [*firsts, *last.freeze(self.threshold, None).parts]

    @property
    def provable(self) -> bool:
        return all(part.provable for part in self._tests)

    @cached_property
    def source(self) -> CascadeSource:
        domain, sources = self.domain, tuple(part.source for part in self._tests)
        counts = tuple(len(part.weights()) for part in self._tests)
        kind = {"query": self.query_kind, "space": domain.space}
        return CascadeSource(self.ndim, domain.time, sources, counts, **kind)

    def weights(self) -> np.ndarray:
        """See ``Bounder``; the layout is described in ``CascadeSource``."""
        *places, bars = self.source.places
        numbers = np.zeros(bars + len(self._tests) - 1, np.float32)
        for place, part in zip(places, self._tests, strict=True):
            own = part.weights()
            numbers[place : place + len(own)] = own
        numbers[bars:] = self.tensors["thresholds"]
        return numbers

    def words(self) -> np.ndarray:
        held = [part.words() for part in self._tests if part.bit_fields]
        return held[0] if held else super().words()

    def reference(self, v: np.ndarray) -> np.ndarray:
        f = self._tests[-1].reference(v)
        for part in self._tests[:-1]:
            f = np.where(part.reference(v) < float(part.threshold), DENIED, f)
        return f

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """See ``Bounder``: the last part's bound where every other part passes on every device, ``DENIED`` elsewhere."""
        bounds = self._tests[-1].bound(lower, upper)
        least, axis, point = (np.array(x) for x in bounds[:3])
        for part in self._tests[:-1]:
            own = part.bound(lower, upper)
            fails = ~(own.lower >= float(part.threshold) + part.rounding_bound() * (1 + 1e-9))
            least[fails], axis[fails], point[fails] = DENIED, own.axis[fails], own.point[fails]
        return BoxBounds(least, axis, point, self.reference(point))

    def rounding_bound(self) -> float:
        """See ``Bounder``; that of the last part."""
        return self._tests[-1].rounding_bound()
