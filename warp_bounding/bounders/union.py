"""``union``: bounders of which any may say *maybe*, each of one part of an object; together they hold all of it.

A part holds the whole shape, or what lies in a *region*, a box. Each is proven by itself for what it holds; what is
left to show is that nothing of the object is held by no part (``Union.obligations``), which ``certify`` does from the
shape alone.

f is 1 where a part says *maybe*, else ``DENIED``. The parts are queried in order, on a CPU in full lanes of the queries
that no part has granted yet. In memory a row for each part comes first (``ROW`` numbers: which code it has, where its
own numbers and its words begin, its threshold), then the numbers of the parts, each at a multiple of
``kernels.source.ALIGN``: so the code depends on how many parts there are and on the different sources among them.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.bounders.cascade import Composed, check_objects
from warp_bounding.certificates import Certificate, together
from warp_bounding.errors import BounderError
from warp_bounding.kernels.source import ALIGN, DENIED, GRANTED, Early, Lanes, Source, aligned, fill, words_at
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.runtime.native import literal
from warp_bounding.shapes.parts import part_of
from warp_bounding.shapes.shape import Shape

# --- covers ----------------------------------------------------------------------------------------------------------
#
# Whether boxes hold all of an object: what lies between them is cut into boxes, which the shape must certify empty.
#
# A box is closed and its corners are float32 numbers, or infinite. So are queries: a float32 point outside a box lies
# at least at the next float64 number behind its side, and the boxes between begin there.

Region = tuple[np.ndarray, np.ndarray]  # corners of a box, object space
SMALLEST = 2.0**-12  # of the longest side: pieces between the boxes that are not halved any more
MOST = 1_000_000  # pieces between the boxes that are asked about


def check_cover(shape: Shape, boxes: list[Region]) -> None:
    """Refuse boxes that do not hold every point of an object.

    Raises:
        BounderError: Naming a point of the object, or one where the shape may be, that no box holds.
    """
    if shape.unbounded:  # what lies beyond its box is object, too
        raise BounderError(f"{shape.name}: parts in boxes do not hold a shape without an end")
    low, high = shape.lower[None].copy(), shape.upper[None].copy()
    for first, last in boxes:
        low, high = _outside(low, high, first, last)
        if len(low) > MOST:
            raise BounderError(f"{shape.name}: {len(boxes)} boxes leave too many pieces between them to be looked at")
    smallest, queried = SMALLEST * float(shape.extent.max()), 0
    while len(low):
        left = ~shape.empty(low, high)
        low, high, queried = low[left], high[left], queried + len(left)
        middle = low + (high - low) / 2
        held = np.flatnonzero(shape.contains(middle))
        small = np.flatnonzero(((high - low) <= smallest).all(axis=1))
        if len(held) or len(small) or queried > MOST:
            place = middle[[*held, *small, 0][0]]
            point = ", ".join(f"{x:.6g}" for x in place)
            found = "is" if len(held) else "may be"
            raise BounderError(f"{shape.name}: the parts do not cover the object, which {found} at ({point})")
        if not len(low):
            return
        axis, row = (high - low).argmax(axis=1), np.arange(len(low))
        less, more = high.copy(), low.copy()
        less[row, axis] = more[row, axis] = middle[row, axis]
        low, high = np.concatenate([low, more]), np.concatenate([less, high])


def _outside(low: np.ndarray, high: np.ndarray, first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Boxes that hold every float64 point of some boxes that is not in the closed box from ``first`` to ``last``."""
    apart = ((low > last) | (high < first)).any(axis=1)
    kept = [(low[apart], high[apart])]
    low, high = low[~apart].copy(), high[~apart].copy()
    for axis in range(low.shape[1]):
        for side in (0, 1):
            beyond = low[:, axis] < first[axis] if side == 0 else high[:, axis] > last[axis]
            piece_low, piece_high = low[beyond].copy(), high[beyond].copy()
            if side == 0:
                piece_high[:, axis] = np.nextafter(first[axis], -np.inf)
                low[:, axis] = np.maximum(low[:, axis], first[axis])
            else:
                piece_low[:, axis] = np.nextafter(last[axis], np.inf)
                high[:, axis] = np.minimum(high[:, axis], last[axis])
            kept.append((piece_low, piece_high))
    return tuple(np.concatenate(side) for side in zip(*kept, strict=True))


# --- unions ----------------------------------------------------------------------------------------------------------

MOST_PARTS = 1024
ROW = 4  # numbers of a part's row: code, where its numbers begin, where its words begin, threshold
Held = Region | None  # what a part holds: what lies in a box, or all

_BATCH = """
const float* const rows_ = w;
const unsigned int* const fields_ = words.data;
(void)fields_;
for (int p = 0; p < $parts && kept; ++p) {
    const float* const row_ = rows_ + $row * p;
    const float* const w = rows_ + (int)row_[1];
    $words
    int stay_ = 0;
    for (int g = 0; g < kept; g += L) {
        V v[M];
#pragma unroll
        for (int k = 0; k < M; ++k) v[k] = *(const V*)(held[k] + g);
        V f;
        switch ((int)row_[0]) {
            $cases
        }
        const int m = kept - g < L ? kept - g : L;
        int fails_[L], pick_[L], n_ = 0;  // in memory: lanes of a vector are dear one by one
        *(J*)fails_ = (f < row_[3]) & 1;
        for (int l = 0; l < m; ++l) { out.data[where[g + l]] = fails_[l] ? $no : $yes; pick_[n_] = g + l; n_ += fails_[l]; }
        for (int l = 0; l < n_; ++l) {
            const int from = pick_[l];
            where[stay_ + l] = where[from];
#pragma unroll
            for (int k = 0; k < M; ++k) held[k][stay_ + l] = held[k][from];
        }
        stay_ += n_;
    }
    kept = stay_;
    end_of_held();
}
"""  # noqa: E501
_ONE = """
float whole_ = $denied;
const float* const rows_ = w;
const unsigned int* const fields_ = words.data;
(void)fields_;
for (int p = 0; p < $parts && whole_ < 0.0f; ++p) {
    const float* const row_ = rows_ + $row * p;
    const float* const w = rows_ + (int)row_[1];
    $words
    float value_ = 0.0f;
    switch ((int)row_[0]) {
        $cases
    }
    if (!(value_ < row_[3])) whole_ = 1.0f;
}
"""


@dataclass(frozen=True)
class UnionSource(Source):
    """Native code of a union. f is 1 where the answer is *maybe*, else ``DENIED``."""

    codes: tuple[Source, ...]  # the different sources of the parts
    parts: int

    block: ClassVar[int] = 4096  # so that a part of many finds enough queries for its lanes
    packed: ClassVar[bool] = True

    @property
    def _texts(self) -> dict[str, object]:
        """What both ways of asking have in common."""
        return {"parts": self.parts, "row": ROW, "words": words_at("fields_", "(int)row_[2]")}

    @property
    def width(self) -> dict[str, int]:
        """See ``Source``: that of the costliest code."""
        return {device: max(code.width[device] for code in self.codes) for device in self.codes[0].width}

    def ask(self, values: bool) -> str:
        lanes, cases = Lanes(vector=True), []
        for index, code in enumerate(self.codes):
            lines = ["I denied_ = {}, granted_ = {};"]
            lines += [_decided(test) for test in code.early()]
            lines += [f"{{ {code.body(lanes)} }}", f"f = denied_ ? V{{}} + {literal(DENIED)} : f;"]
            lines += [f"f = granted_ ? V{{}} + {literal(GRANTED)} : f;"]
            cases.append(f"case {index}: {{ {' '.join(lines)} }} break;")
        yes, no = ("1.0f", literal(DENIED)) if values else ("1", "0")
        return fill(_BATCH, **self._texts, cases="\n".join(cases), yes=yes, no=no)

    def _one(self, cases: list[str]) -> str:
        return fill(_ONE, **self._texts, denied=literal(DENIED), cases="\n".join(cases))

    def body(self, lanes: Lanes) -> str:
        if lanes.vector:
            raise TypeError("a union has no body for lanes of queries: ``ask`` takes its place")
        cases = [f"case {i}: {{ V f; {code.body(lanes)} value_ = f; }} break;" for i, code in enumerate(self.codes)]
        return f"{{ {self._one(cases)} f = whole_; }}"

    def function_body(self) -> str:
        cases = [f"case {i}: {{ {code.function_body()} value_ = f; }} break;" for i, code in enumerate(self.codes)]
        return f"{self._one(cases)} const float f = whole_;"


def _decided(test: Early) -> str:
    """C statements of an early test, of the queries that no test before it has decided."""
    grant = f"granted_ |= (sure > {test.sure_bar}) & ~denied_;" if test.sure_bar is not None else ""
    return f"{{ {test.code} denied_ |= (f < {test.bar}) & ~granted_; {grant} }}"


class Union(Composed):
    """Bounders of which any may say *maybe*; made by ``warp_bounding.union`` and ``warp_bounding.hierarchy``.

    Tensors: those of part i, each under ``i.`` and its role there; ``thresholds`` ``(parts,)``. Sizes: ``parts``, a
    list of ``method``, ``sizes``, and where a part does not hold the whole shape ``region``, float32 corners of a box
    in object space, ``null`` where it has no end.
    """

    method = "union"
    composed = True

    @classmethod
    def of(cls, parts: list[Bounder], held: list[Held] | None = None) -> "Union":
        """Parts at their own thresholds, without a certificate; ``held`` is what each of them holds, ``None`` for all.

        Raises ``BounderError`` if they are bounders of other queries or domains, or cannot be put together.
        """
        tensors, sizes = cls.holding(parts)
        for entry, own in zip(sizes["parts"], held or [None] * len(parts), strict=True):
            if own is not None:
                entry["region"] = [[float(x) if np.isfinite(x) else None for x in np.float32(end)] for end in own]
        tensors["thresholds"] = np.array([part.threshold for part in parts], np.float32)
        return cls(parts[0].domain, tensors, sizes, parts[0]._device)

    def check_tensors(self) -> None:
        shapes = self.read_members(1, MOST_PARTS, lambda kind: not kind.composed)
        self.expect_shapes(shapes | {"thresholds": (len(self.members),)})
        self.held = [self._held(entry) for entry in self.sizes["parts"]]
        for part, threshold in zip(self.members, self.tensors["thresholds"], strict=True):
            part.freeze(threshold, None)

    def _held(self, entry: dict[str, Any]) -> Held:
        """What a part's entry says that it holds, checked."""
        region, n = entry.get("region"), self.domain.space_ndim
        if entry.get("pieces") is not None:
            raise BounderError(f"{self.method}: parts of pieces of a shape are gone; fit the shape as a whole")
        if region is None:
            return None
        try:
            ends = [
                [sign * np.inf if x is None else float(x) for x in end]
                for sign, end in zip((-1, 1), region, strict=True)
            ]
            low, high = np.array(ends)
        except (TypeError, ValueError) as error:
            raise BounderError(f"{self.method}: expected the corners of a box, got {region!r}") from error
        if low.shape != (n,) or not (low <= high).all() or (np.float32(ends) != ends).any():
            raise BounderError(f"{self.method}: expected float32 corners of a box, got {region!r}")
        return low, high

    @property
    def parts(self) -> list[Bounder]:
        """See ``Bounder``: copies of the members; they are proven one by one, each for what it holds."""
        return [part.to(self._device) for part in self.members]

    def obligations(self, shape: Shape) -> list[tuple[Bounder, Shape]]:
        """See ``Bounder``: each part, for what it holds of the object; regions without any are not looked at.

        Raises:
            BounderError: If something of the object is held by no part; the message names a point.
        """
        if all(own is not None for own in self.held):
            check_cover(shape, self.held)
        pairs = [(part, self.owed(shape, own)) for part, own in zip(self.parts, self.held, strict=True)]
        # A part may be several tests that must all pass, such as a network with exits.
        return [(each, own) for part, own in pairs if own is not None for each in part.parts]

    @staticmethod
    def owed(shape: Shape, held: Held) -> Shape | None:
        """What a part must hold of a shape: it, or its region's part; ``None`` where the shape is elsewhere."""
        if held is None:
            return shape
        low, high = held
        return part_of(shape, held) if (low <= shape.upper).all() and (high >= shape.lower).all() else None

    @cached_property
    def _codes(self) -> list[Any]:
        return list(dict.fromkeys(part.source for part in self.members))

    @property
    def source(self) -> UnionSource:
        return self.source_of(UnionSource, tuple(self._codes), len(self.members))

    def weights(self) -> np.ndarray:
        """See ``Bounder``; the layout is described in the module's docstring."""
        place, fields = aligned(ROW * len(self.members)), self.word_places()
        rows, held = np.zeros((len(self.members), ROW), np.float32), [np.zeros(place, np.float32)]
        for i, part in enumerate(self.members):
            own = part.weights()
            rows[i] = self._codes.index(part.source), place, fields[i], part.threshold
            held.append(np.pad(own, (0, -len(own) % ALIGN)).astype(np.float32))
            place += len(held[-1])
        if max(place, *fields) >= 2**24:
            raise BounderError(f"{self.method}: {max(place, *fields)} numbers are more than float32 can count")
        held[0][: rows.size] = rows.reshape(-1)
        return np.concatenate(held)

    @property
    def nbytes(self) -> int:
        """See ``Bounder``: domain, rows and the parts' numbers; what they hold is the proof's."""
        own = sum(part.nbytes - part._head_bytes for part in self.members)
        return 4 * ROW * len(self.members) + self._head_bytes + own

    def reference(self, v: np.ndarray) -> np.ndarray:
        v = np.asarray(v, dtype=np.float64)
        held = [part.reference(v) >= float(part.threshold) for part in self.members]
        return np.where(np.any(held, axis=0), 1.0, DENIED)

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """See ``Bounder``: 1 where a part's own bounds, less their rounding, decide for *maybe* on the whole box."""
        sure = np.zeros(len(lower), dtype=bool)
        for part in self.members:
            low, high, owner = part.cut(lower, upper)
            own = np.ones(len(lower), dtype=bool)
            np.logical_and.at(own, owner, part.bound(low, high).lower >= float(part.threshold) + part.rounding_bound())
            sure |= own
        center = (lower + upper) / 2
        return BoxBounds(np.where(sure, 1.0, DENIED), np.argmax(upper - lower, axis=1), center, self.reference(center))

    def freeze(self, threshold: float, certificate: Certificate | None) -> "Union":
        """See ``Bounder``; the threshold is 0, its parts have theirs. Raises ``BounderError`` for another one."""
        if threshold != 0:
            raise BounderError(f"{self.method}: its parts have thresholds, its own is 0, got {threshold!r}")
        return super().freeze(threshold, certificate)

    def rounding_bound(self) -> float:
        return 0.0  # ``bound`` is about what devices compute


def union(*bounders: Bounder) -> Union:
    """A bounder that says *maybe* iff one of these does, asked in this order.

    Args:
        bounders: Bounders of the same queries of the same object.

    Returns:
        The union. It is proven if all parts are, statistical if one of them is, and without a certificate if one has
        none.

    Raises:
        BounderError: If they were made for different objects, margins, queries or domains.

    Example:
        >>> loose = wb.union(wb.fit(ball, method="obb", device="cpu"), bounder)
        >>> loose.certificate.proven
        True
    """
    if len(bounders) < 2:
        raise BounderError(f"union: expected at least 2 bounders, got {len(bounders)}")
    for bounder in bounders:
        if not isinstance(bounder, Bounder):
            raise BounderError(f"union: expected bounders, got {type(bounder).__name__}")
    parts, held = [], []
    for bounder in bounders:
        parts += bounder.parts if isinstance(bounder, Union) else [bounder.local]
        held += bounder.held if isinstance(bounder, Union) else [None]
    whole, first = Union.of(parts, held).freeze(0.0, None), bounders[0]
    whole.describe(bounders, first)
    certificates = [bounder.certificate for bounder in (*(b for b in bounders if b is not first), first)]
    if all(certificates):
        check_objects(certificates)
        whole.freeze(0.0, together(whole, certificates, first.info.get("indicator")))
    return whole


def united(parts: list[Bounder], regions: list[Region], shape: Shape) -> Union:
    """Bounders put together, each proven for what its region, a float32 box, holds of a shape (``part_of``).

    Raises ``BounderError`` if the regions do not cover the object, or a part has no certificate.
    """
    whole = Union.of(parts, regions)
    check_cover(shape, regions)
    certificates = []
    for number, (part, region) in enumerate(zip(parts, regions, strict=True)):
        own, known = whole.owed(shape, region), part.certificate
        if own is None:  # nothing of the object is there
            continue
        if known is None or (known.indicator, known.margin) != (own.digest, own.margin):
            raise BounderError(f"{whole.method}: part {number} has no certificate for its region")
        certificates.append(known)
    return whole.freeze(0.0, together(whole, certificates, shape.digest))
