"""Native code of local thresholds: where v lies among the edges, the level that stands there, and what is left of f.

The lattice is that of ``kernels.lattice``. A threshold is ``step * (first + level)``, a power of two times a whole number under 2^24: float32
holds it, however it is computed.
"""

from dataclasses import dataclass
from math import prod

from warp_bounding.kernels.lattice import level_text
from warp_bounding.kernels.source import DENIED, Early, Lanes, Source, literal

__all__ = ["CERTAIN", "EVERYWHERE", "NOWHERE", "LocalSource"]

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
        return f"{{ {self._level(vector=False)} {self._given('f')} else {{ {self.member.body(lanes)} f -= {self._rest()}; }} }}"

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
