"""``union``: bounders of which any may say *maybe*, each of one part of an object; together they hold all of it.

A part holds the whole shape, some *pieces* of a shape that is a union by itself (``Shape.piece``: the links of an arm;
it may then have fewer coordinates, the first ones), or what lies in a *region*, a box. Each is proven by itself for
what it holds; what is left to show is that nothing of the object is held by no part (``Union.obligations``), which
``certify`` does from the shape alone.

f is 1 where a part says *maybe*, else ``DENIED``. The parts are queried in order, on a CPU in full lanes of the queries
that no part has granted yet. In memory a row for each part comes first (``ROW`` numbers: which code it has, where its
own numbers and its words begin, its threshold), then the numbers of the parts, each at a multiple of
``kernels.source.ALIGN``: so the code depends on how many parts there are and on the different sources among them.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from warp_bounding.bounders.bounder import (
    BIT_FIELDS,
    Bounder,
    check_members,
    composed,
    holding,
    members_of,
    word_places,
    words_of,
)
from warp_bounding.bounders.cascade import ABOUT, check_objects
from warp_bounding.certificates import Certificate, together
from warp_bounding.certificates.claim import differing
from warp_bounding.errors import BounderError
from warp_bounding.kernels.source import ALIGN, DENIED, GRANTED, Early, Lanes, Source, aligned, fill, words_at
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.queries.domain import Domain
from warp_bounding.queries.region_domain import AnyDomain
from warp_bounding.runtime.native import literal
from warp_bounding.shapes.parts import part_of
from warp_bounding.shapes.shape import Pieces, Shape

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
Held = list[int] | Region | None  # what a part holds: pieces, what lies in a box, or all

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


@composed
class Union(Bounder):
    """Bounders of which any may say *maybe*; made by ``warp_bounding.union`` and ``warp_bounding.hierarchy``.

    Tensors: those of part i, each under ``i.`` and its role there; ``thresholds`` ``(parts,)``. Sizes: ``parts``, a
    list of ``method``, ``sizes``, the ``domain`` of a part with its own, and what it holds, where that is not the whole
    shape: ``pieces``, their numbers, or ``region``, float32 corners of a box in object space, ``null`` where it has no
    end.
    """

    method = "union"
    composed = True
    exact_on_cells = False
    bit_fields = BIT_FIELDS

    @classmethod
    def supports(cls, query: str, ndim: int) -> bool:
        return True  # whatever its parts support

    @classmethod
    def of(cls, parts: list[Bounder], held: list[Held] | None = None) -> "Union":
        """Parts at their own thresholds, without a certificate; ``held`` is what each of them holds, ``None`` for all.

        Raises ``BounderError`` if they are bounders of other queries or domains, or cannot be put together.
        """
        check_members(cls.method, parts, domains=False)
        domain = _common([part.domain for part in parts])
        tensors, sizes = holding(parts)
        for entry, part, own in zip(sizes["parts"], parts, held or [None] * len(parts), strict=True):
            entry |= {} if part.domain.to_dict() == domain.to_dict() else {"domain": part.domain.to_dict()}
            if isinstance(own, list):
                entry["pieces"] = own
            elif own is not None:
                entry["region"] = [[float(x) if np.isfinite(x) else None for x in np.float32(end)] for end in own]
        tensors["thresholds"] = np.array([part.threshold for part in parts], np.float32)
        return cls(domain, tensors, sizes, parts[0]._device)

    def check_tensors(self) -> None:
        self.members, shapes = members_of(self, 1, MOST_PARTS, lambda kind: not kind.composed, own_domains=True)
        self.expect_shapes(shapes | {"thresholds": (len(self.members),)})
        self.held = [self._held(entry) for entry in self.sizes["parts"]]
        kinds = {type(own) for own in self.held}
        if len(kinds - {type(None)}) > 1:
            raise BounderError(f"{self.method}: expected parts of pieces or parts in boxes, got both")
        for part, own, threshold in zip(self.members, self.held, self.tensors["thresholds"], strict=True):
            if fault := _unfit(self.domain, part.domain):
                raise BounderError(f"{self.method}: {fault}")
            if part.ndim != self.ndim and not isinstance(own, list):
                raise BounderError(
                    f"{self.method}: a part of {part.ndim} coordinates, of {self.ndim}, that holds no pieces"
                )
            part.freeze(threshold, None)

    def _held(self, entry: dict[str, Any]) -> Held:
        """What a part's entry says that it holds, checked."""
        pieces, region, n = entry.get("pieces"), entry.get("region"), self.domain.space_ndim
        if pieces is not None:
            if not isinstance(pieces, list) or not pieces or not all(type(p) is int and p >= 0 for p in pieces):
                raise BounderError(f"{self.method}: expected numbers of pieces, got {pieces!r}")
            return pieces
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
            BounderError: If something of the object is held by no part; the message names a point, or pieces.
        """
        if all(own is not None for own in self.held):
            if isinstance(self.held[0], list):
                self._check_pieces(shape)
            else:
                check_cover(shape, self.held)
        pairs = [(part, self.owed(shape, own)) for part, own in zip(self.parts, self.held, strict=True)]
        for part, own in pairs:
            if own is not None and own.ndim != part.ndim:
                raise BounderError(
                    f"{own.name}: {own.ndim} coordinates, and the part that is to hold it has {part.ndim}"
                )
        # A part may be several tests that must all pass, such as a network with exits.
        return [(each, own) for part, own in pairs if own is not None for each in part.parts]

    def _check_pieces(self, shape: Shape) -> None:
        if shape.pieces is None:
            raise BounderError(f"{shape.name}: it has no pieces, and parts of this bounder hold some each")
        if left := sorted(set(shape.pieces.held) - {number for own in self.held for number in own}):
            raise BounderError(f"{shape.name}: no part holds the pieces {left}")

    @staticmethod
    def owed(shape: Shape, held: Held) -> Shape | None:
        """What a part must hold of a shape: its pieces, or its region's; ``None`` where the shape is elsewhere."""
        if held is None:
            return shape
        if isinstance(held, list):
            return shape.piece(held)
        low, high = held
        return part_of(shape, held) if (low <= shape.upper).all() and (high >= shape.lower).all() else None

    @property
    def delta_share(self) -> np.ndarray | None:
        """See ``Bounder``: what is left of the error that the proof of the part with most coordinates covers."""
        widest = max((part.domain for part in self.members), key=lambda domain: domain.space_ndim)
        return None if widest is self.domain else self.domain.delta / widest.delta

    @property
    def provable(self) -> bool:
        return all(part.provable for part in self.members)

    @cached_property
    def _codes(self) -> list[Any]:
        return list(dict.fromkeys(part.source for part in self.members))

    @property
    def source(self) -> UnionSource:
        return self.source_of(UnionSource, tuple(self._codes), len(self.members))

    def weights(self) -> np.ndarray:
        """See ``Bounder``; the layout is described in the module's docstring."""
        place, fields = aligned(ROW * len(self.members)), word_places(self.members)
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

    def words(self) -> np.ndarray:
        words = words_of(self.members)
        return super().words() if words is None else words

    @property
    def nbytes(self) -> int:
        """See ``Bounder``: domain, rows and the parts' numbers; what they hold is the proof's."""
        header = 4 * (len(self.domain.header) + 1 + len(self.domain.extra))
        own = sum(part.nbytes - 4 * (len(part.domain.header) + 1 + len(part.domain.extra)) for part in self.members)
        return 4 * ROW * len(self.members) + header + own

    def reference(self, v: np.ndarray) -> np.ndarray:
        v = np.asarray(v, dtype=np.float64)
        held = [part.reference(v[:, : part.domain.ndim]) >= float(part.threshold) for part in self.members]
        return np.where(np.any(held, axis=0), 1.0, DENIED)

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """See ``Bounder``: 1 where a part's own bounds, less their rounding, decide for *maybe* on the whole box."""
        sure = np.zeros(len(lower), dtype=bool)
        for part in self.members:
            low, high, owner = part.cut(lower[:, : part.domain.ndim], upper[:, : part.domain.ndim])
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


def _common(domains: list[AnyDomain]) -> AnyDomain:
    """The domain in which parts are queried together: with the most coordinates, and the least margin for rounding.

    Raises ``BounderError`` if the first coordinates of one are not those of another.
    """
    widest = max(domains, key=lambda domain: domain.space_ndim)
    if all(domain.to_dict() == widest.to_dict() for domain in domains):
        return widest
    if all(isinstance(domain, Domain) and not domain.unbounded and domain.ndim <= widest.ndim for domain in domains):
        delta, limit = widest.delta.copy(), widest.limit.copy()
        for domain in domains:
            k = domain.ndim
            delta[:k], limit[:k] = np.minimum(delta[:k], domain.delta), np.minimum(limit[:k], domain.limit)
        common = replace(widest, delta=delta, limit=limit)
        faults = [common.fault(), *(_unfit(common, domain) for domain in domains)]
        if not any(faults):
            return common
    raise BounderError("union: expected bounders of the same queries and domain, or of pieces of one shape")


def _unfit(whole: AnyDomain, part: AnyDomain) -> str | None:
    """Why the coordinates of a whole are not those of a part, which may be the first ones; ``None`` if they are.

    The map to v is then the same, and the error that the part's proof covers is no smaller than the one that the whole
    allows itself.
    """
    if part is whole:
        return None
    if not isinstance(whole, Domain) or not isinstance(part, Domain) or whole.unbounded or part.unbounded:
        return "only parts of points of a bounded object may have domains of their own"
    k = part.ndim
    joints = None if whole.joints is None else whole.joints.first(k)
    same = k <= whole.ndim and part.time == whole.time and part.joints == joints
    if not same or (part.center != whole.center[:k]).any() or (part.scale != whole.scale[:k]).any():
        return "expected parts in the coordinates of the whole, or the first ones of them"
    if (whole.delta[:k] > part.delta).any() or (whole.limit[:k] > part.limit).any():
        return "the proof of a part does not cover the coordinates of the whole"
    return None


def union(*bounders: Bounder) -> Union:
    """A bounder that says *maybe* iff one of these does, asked in this order.

    Args:
        bounders: Bounders of the same queries of the same object, or of pieces of one shape (``Shape.piece``), which
            may have fewer coordinates, the first ones: the whole is one of their union, of the shape itself where no
            piece is missing.

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
        held += bounder.held if isinstance(bounder, Union) else [_pieces(bounder) and list(_pieces(bounder).held)]
    whole = Union.of(parts, held).freeze(0.0, None)
    widest = max(bounders, key=lambda bounder: bounder.ndim)
    whole.frame = widest.frame
    pieces, indicator = [_pieces(bounder) for bounder in bounders], widest.info.get("indicator")
    for bounder in bounders:
        if other := None if all(pieces) else differing(bounders[0], bounder):
            raise BounderError(f"union: expected bounders of the same object, got {other}")
    if all(pieces):
        if any(bounder.frame for bounder in bounders):
            raise BounderError("union: expected pieces of a shape without an origin")
        joined = pieces[0]
        for other, bounder in zip(pieces, bounders, strict=True):
            same = all(bounder.info.get(name) == widest.info.get(name) for name in ("margin", "resolution"))
            if not same or (other.whole, other.count) != (joined.whole, joined.count):
                raise BounderError("union: expected bounders of pieces of the same shape, of one margin")
            joined = joined.joined(other)
        indicator = joined.digest
    whole.info = {key: widest.info.get(key) for key in ABOUT} | {"indicator": indicator}
    whole.info["shape"] = None if all(pieces) else whole.info["shape"]
    whole.info["pieces"] = joined.to_dict() if all(pieces) and not joined.all else None
    whole.info["training"] = {"parts": [bounder.info.get("training") for bounder in bounders]}
    certificates = [bounder.certificate for bounder in (*(b for b in bounders if b is not widest), widest)]
    if all(certificates):
        check_objects(certificates)
        whole.freeze(0.0, together(whole, certificates, indicator))
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


def _pieces(bounder: Bounder) -> Pieces | None:
    """The pieces that a bounder holds; ``None`` where it is not known to hold any, or holds the shape."""
    reported = bounder.info.get("pieces")
    return None if reported is None else Pieces.from_dict(reported)
