"""Native code of local thresholds: where v lies among the edges, the level that stands there, and what is left of f.

Comparisons with edges are exact, so every device finds the same part of the domain, and what is proven of a part holds
for each v in it. A threshold is ``step * (first + level)``, a power of two times a whole number under 2^24: float32
holds it, however it is computed.
"""

from dataclasses import dataclass
from math import prod

import warp as wp

from warp_bounding.kernels.plain import DENIED, Numbers, Words, plain_value, twin, vector_type
from warp_bounding.kernels.source import Early, Lanes, Source, fill, literal

__all__ = ["CERTAIN", "EVERYWHERE", "NOWHERE", "PER_WORD", "LocalSource"]

NOWHERE = 255  # the level of a part without positives: there every query is denied
EVERYWHERE = 254  # the level of a part where the network denies next to nothing: there no query is
CERTAIN = -DENIED  # f where no query is denied
PER_WORD = 4  # levels, a byte each, in a word

# The index of v's part, in array order: along each axis, how many edges v has reached.
_PLACE = {
    True: "I part_ = {};\n$axes",
    False: "int part_ = 0;\n$axes",
}
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
        lines, first = [], self.count
        for k, count in enumerate(self.shape):
            if count > 1:
                lines.append(fill(_AXIS[vector], k=k, first=first, last=first + count - 1, count=count))
            first += count - 1
        return fill(_PLACE[vector], axes="\n".join(lines)) + _LEVEL[vector]

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
        return f"{{ {self._level(vector=False)} {self._given('f')} else {{ {self.member.body(lanes)} f -= {self._rest()}; }} }}"

    def _given(self, name: str) -> str:
        """C text of the answers that a level alone gives."""
        levels = (NOWHERE, DENIED), (EVERYWHERE, CERTAIN)
        return " else ".join(f"if (level_ == {level}.0f) {{ {name} = {literal(value)}; }}" for level, value in levels)

    def function_body(self) -> str:
        own = f"else {{ {self.member.function_body()} local_f_ = f - {self._rest()}; }} }}"
        lines = ["float local_f_;", f"{{ {self._level(vector=False)}", self._given("local_f_"), own]
        return "\n".join([*lines, "const float f = local_f_;"])

    def plain(self) -> wp.Function:
        member, vector, counts = (
            plain_value(self.member),
            vector_type(self.coordinates),
            wp.types.vector(length=len(self.shape), dtype=wp.int32),
        )
        axes, start, scale_at, shape = len(self.shape), self.count, self.scale_at, counts(*self.shape)
        nowhere, everywhere = float(NOWHERE), float(EVERYWHERE)

        @twin(self)
        def f(w: Numbers, words: Words, at: int, v: vector) -> float:
            part, edge = wp.int32(0), at + start
            for k in range(axes):
                place = wp.int32(0)
                for _ in range(shape[k] - 1):
                    if v[k] >= w[edge]:
                        place += 1
                    edge += 1
                part = part * shape[k] + place
            level = float(words[part >> 2] >> wp.uint32(8 * (part & 3)) & wp.uint32(255))
            if level == nowhere:
                return DENIED
            if level == everywhere:
                return CERTAIN
            return member(w, words, at, v) - (level + w[at + scale_at]) * w[at + scale_at + 1]

        return f

    @property
    def parts(self) -> int:
        """Number of parts."""
        return prod(self.shape)
