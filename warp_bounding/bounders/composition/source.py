"""Native code of a composition: parts asked one after the other, each with the part to ask next after a *maybe* and a *no*.

In memory a row for each part comes first (``ROW`` numbers: which code it has, where its own numbers begin, the next part
after a *maybe* and after a *no*, its threshold), or for each split (``SPLIT``, the axis, the next row where v is at least
the place along it, and where it is less, the place), two rows for the answers, then the numbers of the parts, each at a multiple of ``kernels.source.ALIGN``.
Where several parts have bit fields, a row tells where the words of its part begin, and where parts have domains of their own, it has at last
the numbers of ``moves.Moves``. The next part always stands behind; beyond the last one are the two answers. All of this is data: the code depends on how many
parts there are and on the different sources among them, not on how they are put together.

On a CPU the batch path keeps, for each part, a list of the queries of its block that wait for it, and asks them in full
lanes; so a query costs the parts on its own way only. Splits are passed one query at a time, on the way to a list.
"""

from dataclasses import dataclass
from typing import ClassVar

import warp as wp

from warp_bounding.kernels.plain import DENIED, GRANTED, Numbers, Words, plain_value, twin, vector_type
from warp_bounding.kernels.source import Early, Lanes, Source, fill, literal, words_at

__all__ = ["ROW", "SPLIT", "CompositionSource"]

ROW = 5  # numbers of a part's row: code, where its numbers begin, next after maybe, next after no, threshold
FIELDS = "const unsigned int* const fields_ = words.data;"  # C text: all words, while ``words`` are a part's
SPLIT = -1  # in place of a part's code

_BATCH = """
const float* const rows_ = w;
$fields
int waits_[$parts + 2], next_[$block];  // lists: the first query that waits for each part, and the one behind each
for (int p = 0; p < $parts + 2; ++p) waits_[p] = -1;
const auto send_ = [&](int g, int to) {  // without branches that depend on the query, which would be guessed wrongly
    for (const float* r = rows_ + $row * to; r[0] < 0.0f; r = rows_ + $row * to)
        to = (int)r[2 + (held[(int)r[1]][g] < r[4])];
    next_[g] = waits_[to];
    waits_[to] = g;
};
for (int g = kept - 1; g >= 0; --g) send_(g, 0);
for (int p = 0; p < $parts; ++p) {
    const float* const row_ = rows_ + $row * p;
    if (waits_[p] < 0) continue;
    const float* const w = rows_ + (int)row_[1];
    $words
    const int code_ = row_[0], ways_[2] = {(int)row_[2], (int)row_[3]};
    int at_ = waits_[p];
    while (at_ >= 0) {
        int pick_[L], m_ = 0;
        for (; m_ < L && at_ >= 0; ++m_) { pick_[m_] = at_; at_ = next_[at_]; }
        for (int l = m_; l < L; ++l) pick_[l] = pick_[0];
        V v[M];
#pragma unroll
        for (int k = 0; k < M; ++k) {
            float lanes_[L];
            for (int l = 0; l < L; ++l) lanes_[l] = held[k][pick_[l]];
            v[k] = *(const V*)lanes_;
            $move
        }
        V f;
        switch (code_) {
            $cases
        }
        int fails_[L];  // in memory: lanes of a vector are dear one by one
        *(J*)fails_ = f < row_[4];
        for (int l = 0; l < m_; ++l) send_(pick_[l], ways_[fails_[l] & 1]);
    }
}
for (int g = waits_[$parts]; g >= 0; g = next_[g]) out.data[where[g]] = $yes;
for (int g = waits_[$parts + 1]; g >= 0; g = next_[g]) out.data[where[g]] = $no;
"""
_ONE = """
int part_ = 0;
const float* const rows_ = w;
$fields
while (part_ < $parts) {
    const float* const row_ = rows_ + $row * part_;
    if (row_[0] < 0.0f) {
        part_ = (int)(v[(int)row_[1]] < row_[4] ? row_[3] : row_[2]);
        continue;
    }
    const float* const w = rows_ + (int)row_[1];
    $words
    float value_ = 0.0f;
    $moved
    switch ((int)row_[0]) {
        $cases
    }
    $back
    part_ = (int)(value_ < row_[4] ? row_[3] : row_[2]);
}
"""
# Coordinate k of a part; no positive's is cut off at the limit.
_MOVE = """
const auto limit_ = v[k] * 0.0f + row_[$limit + k];
auto own_ = v[k] * row_[$ratio + k] + row_[$shift + k];
own_ = own_ > limit_ ? limit_ : own_;
own_ = own_ < -limit_ ? -limit_ : own_;
"""
_MOVED = """
float moved_[$axes];
for (int k = 0; k < $axes; ++k) { $move moved_[k] = own_; }
{ const float* const v = moved_;
"""


@dataclass(frozen=True)
class CompositionSource(Source):
    """Native code of a composition. f is 1 where the answer is *maybe*, else ``DENIED``."""

    codes: tuple[Source, ...]  # the different sources of the parts
    parts: int  # how many rows there are: parts and splits
    places: bool  # whether rows tell where words begin
    moves: bool  # whether rows tell how v of the whole becomes v of a part

    block: ClassVar[int] = 4096  # so that a part of many finds enough queries for its lanes
    packed: ClassVar[bool] = True

    @property
    def row(self) -> int:
        """Numbers of a row."""
        return ROW + self.places + 3 * self.coordinates * self.moves

    @property
    def _texts(self) -> dict[str, object]:
        """What both ways of asking have in common."""
        told = (FIELDS, words_at("fields_", f"(int)row_[{ROW}]")) if self.places else ("", "")
        texts = {"parts": self.parts, "row": self.row, "fields": told[0], "words": told[1]}
        axes, first = self.coordinates, ROW + self.places
        move = fill(_MOVE, ratio=first, shift=first + axes, limit=first + 2 * axes)
        texts |= {"move": f"{move} v[k] = own_;", "moved": fill(_MOVED, axes=axes, move=move), "back": "}"}
        return texts if self.moves else texts | dict.fromkeys(("move", "moved", "back"), "")

    @property
    def width(self) -> dict[str, int]:
        """See ``Source``: that of the costliest code."""
        return {device: max(code.width[device] for code in self.codes) for device in self.codes[0].width}

    def ask(self, values: bool) -> str:
        """See ``Source.ask``."""
        lanes, cases = Lanes(vector=True), []
        for index, code in enumerate(self.codes):
            lines = ["I denied_ = {}, granted_ = {};"]
            lines += [_decided(test) for test in code.early()]
            lines += [f"{{ {code.body(lanes)} }}", f"f = denied_ ? V{{}} + {literal(DENIED)} : f;"]
            lines += [f"f = granted_ ? V{{}} + {literal(GRANTED)} : f;"]
            cases.append(f"case {index}: {{ {' '.join(lines)} }} break;")
        yes, no = ("1.0f", literal(DENIED)) if values else ("1", "0")
        return fill(_BATCH, **self._texts, block=self.block, cases="\n".join(cases), yes=yes, no=no)

    def _one(self, cases: list[str]) -> str:
        text = fill(_ONE, **self._texts, cases="\n".join(cases))
        return f"float whole_; {{ {text} whole_ = part_ == {self.parts} ? 1.0f : {literal(DENIED)}; }}"

    def body(self, lanes: Lanes) -> str:
        if lanes.vector:
            raise TypeError("a composition has no body for lanes of queries: ``ask`` takes its place")
        cases = [
            f"case {index}: {{ V f; {code.body(lanes)} value_ = f; }} break;" for index, code in enumerate(self.codes)
        ]
        return f"{self._one(cases)} f = whole_;"

    def function_body(self) -> str:
        cases = [
            f"case {index}: {{ {code.function_body()} value_ = f; }} break;" for index, code in enumerate(self.codes)
        ]
        return f"{self._one(cases)} const float f = whole_;"

    def plain(self) -> wp.Function:
        found_at, vector, parts, row = _of_row(self), vector_type(self.coordinates), self.parts, self.row

        @twin(self)
        def f(w: Numbers, words: Words, at: int, v: vector) -> float:
            part = wp.int32(0)
            while part < parts:
                here = at + row * part
                if w[here] < 0.0:
                    part = int(wp.where(v[int(w[here + 1])] < w[here + 4], w[here + 3], w[here + 2]))
                    continue
                found = found_at(w, words, at, here, v)
                part = int(wp.where(found < w[here + 4], w[here + 3], w[here + 2]))
            return wp.where(part == parts, 1.0, DENIED)

        return f


def _of_row(source: CompositionSource) -> wp.Function:
    """The plain f of the part whose row begins at ``here``."""
    value, vector, axes = _of_code(source, 0), vector_type(source.coordinates), source.coordinates
    first = ROW + source.places

    @twin(source, "moved")
    def moved(w: Numbers, here: int, v: vector) -> vector:
        own = vector()
        for k in range(axes):
            limit = w[here + first + 2 * axes + k]
            own[k] = wp.clamp(v[k] * w[here + first + k] + w[here + first + axes + k], -limit, limit)
        return own

    @twin(source, "same")
    def same(w: Numbers, here: int, v: vector) -> vector:
        return v

    coordinates = moved if source.moves else same

    @twin(source, "of_row")
    def found(w: Numbers, words: Words, at: int, here: int, v: vector) -> float:
        return value(w, words, at + int(w[here + 1]), coordinates(w, here, v), int(w[here]))

    @twin(source, "of_row_words")
    def with_words(w: Numbers, words: Words, at: int, here: int, v: vector) -> float:
        own = words[int(w[here + 5]) :]
        return value(w, own, at + int(w[here + 1]), coordinates(w, here, v), int(w[here]))

    return with_words if source.places else found


def _decided(test: Early) -> str:
    """C statements of an early test, of the queries that no test before it has decided."""
    grant = f"granted_ |= (sure > {test.sure_bar}) & ~denied_;" if test.sure_bar is not None else ""
    return f"{{ {test.code} denied_ |= (f < {test.bar}) & ~granted_; {grant} }}"


def _of_code(source: CompositionSource, index: int) -> wp.Function:
    """The plain f of a part, by the number of its code, from ``index`` on."""
    own, vector, last = _of_first(source, index), vector_type(source.coordinates), index + 1 == len(source.codes)
    if last:

        @twin(source, f"code_{index}")
        def only(w: Numbers, words: Words, at: int, v: vector, code: int) -> float:
            return own(w, words, at, v)

        return only
    others = _of_code(source, index + 1)

    @twin(source, f"code_{index}")
    def either(w: Numbers, words: Words, at: int, v: vector, code: int) -> float:
        if code == index:
            return own(w, words, at, v)
        return others(w, words, at, v, code)

    return either


def _of_first(source: CompositionSource, index: int) -> wp.Function:
    """The plain f of a code, of the whole's v: a part may have the first coordinates only."""
    code = source.codes[index]
    value, vector, short, count = (
        plain_value(code),
        vector_type(source.coordinates),
        vector_type(code.coordinates),
        code.coordinates,
    )
    if count == source.coordinates:
        return value

    @twin(source, f"first_{index}")
    def first(w: Numbers, words: Words, at: int, v: vector) -> float:
        own = short()
        for k in range(count):
            own[k] = v[k]
        return value(w, words, at, own)

    return first
