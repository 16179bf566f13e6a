"""``distance-grid``: distances at the nodes of a grid, interpolated; the honest rival of a network, by bytes and by ns.

F is multilinear in each cell between the values at its nodes. These begin as the distance to the object, in it as minus
the depth. What multilinear interpolation makes too large is found cell by cell (``proof.distances``) and taken off the
values at the cell's own nodes, so that one bad cell does not cost all of them; values are then rounded down to how they
are stored. The proof goes through all cells again with the stored values.

A *refined* grid is adaptive: cells that come near the object's border are cut into ``refine`` to the power n finer
ones, whose nodes are a block of their own. F may jump where they meet others.

*Rounding*, u = 2^-24, R nodes along an axis, D the largest difference of neighbours along it: the place ``t = (p +
limit) inverse`` is off by ``4 u R``, which changes F by ``4 u R D`` at most, summed over the axes (a cell beside the
right one has the same values at the face between them); n interpolations of values up to M by ``4 u`` each of ``3 M``;
values of 8 bits, ``low + step q``, by ``3 u M``. Where F jumps, what is computed is F at a point as near as that, so
the distance there counts, which differs by less than ``4 u R / inverse``, summed over the axes; ``refine`` is a power
of two, so a place in a block is exact.
"""

from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from warp_bounding.bounders.bounder import Option, one_of, whole
from warp_bounding.bounders.distance import DistanceBounder
from warp_bounding.errors import BounderError
from warp_bounding.kernels.distances import FLUSHED, DistanceSource
from warp_bounding.kernels.source import Lanes, fill
from warp_bounding.queries.distance import DistanceDomain
from warp_bounding.rounding import UNIT32, round_down
from warp_bounding.shapes.shape import Shape

# --- stored values ---------------------------------------------------------------------------------------------------
#
# How a ``distance-grid`` stores its values: rounded down, in 32, 16 or 8 bits; and how they are read, natively and in
# Warp's own Python.

SMALLEST_HALF = 2.0**-14  # the least normal number of 16 bits; smaller ones are rounded down to 0, or to minus this
LEVELS = 255  # of 8 bits, above the lowest

_DECODE = {
    "float32": "[&](int i, float, float) { union { unsigned int u; float f; } x; x.u = words.data[i]; return x.f; }",
    "float16": """[&](int i, float, float) {
        const unsigned int h = words.data[i >> 1] >> (16 * (i & 1)) & 0xffffu;
        union { unsigned int u; float f; } x;
        x.u = (h & 0x8000u) << 16 | (h & 0x7fffu ? ((h & 0x7fffu) << 13) + 0x38000000u : 0u);
        return x.f;
    }""",
    "uint8": "[&](int i, float low, float step) { return low + step * (float)(words.data[i >> 2] >> (8 * (i & 3)) & "
    "0xffu); }",
}
STORAGES = tuple(_DECODE)


class Values(NamedTuple):
    """Numbers as they are stored, float32, float16 or uint8.

    Of 8 bits ``meaning`` ``(2,)`` float32 is the value of 0 and the step; zeros of others.
    """

    stored: np.ndarray
    meaning: np.ndarray

    @classmethod
    def of(cls, values: np.ndarray, storage: str) -> "Values":
        """Values ``(...)`` float64, rounded down to how they are stored."""
        none = np.zeros(2, np.float32)
        if storage == STORAGES[0] or not values.size:
            return cls(round_down(values).astype(storage), none)
        if storage == STORAGES[1]:
            half = values.astype(np.float16)
            half = np.where(half.astype(np.float64) > values, np.nextafter(half, np.float16(-np.inf)), half)
            small = (half != 0) & (np.abs(half) < SMALLEST_HALF)
            return cls(np.where(small, np.where(half > 0, 0.0, -SMALLEST_HALF), half).astype(np.float16), none)
        low = np.float32(np.nextafter(round_down(values.min()), np.float32(-np.inf)))
        step = np.nextafter(np.float32((values.max() - low) / LEVELS), np.float32(np.inf))
        numbers = np.floor((values - low) / float(step) * (1 - 1e-12)).clip(0, LEVELS)
        return cls(numbers.astype(np.uint8), np.array([low, step], np.float32))

    @property
    def exact(self) -> np.ndarray:
        """``(...)`` float64, what they stand for."""
        low, step = self.meaning.astype(np.float64)
        return (
            low + step * self.stored.astype(np.float64) if self.stored.dtype == np.uint8 else self.stored.astype(float)
        )

    @property
    def subnormal(self) -> bool:
        """Whether one of 16 bits is, which is not read as it stands."""
        half = self.stored.dtype == np.float16
        return half and bool(((self.stored != 0) & (np.abs(self.exact) < SMALLEST_HALF)).any())


def decode_text(storage: str) -> str:
    """Native text of a function of a value's number among those stored, and of what 8 bits mean."""
    return _DECODE[storage]


# --- native text -----------------------------------------------------------------------------------------------------
#
# Native code of ``distance-grid``: the cell of a query, the values at its corners, and what is multilinear between
# them.
#
# Of a refined grid each cell has a bit that says whether it has a block of finer nodes of its own; the number of bits
# before it is the block's number.

_INTERPOLATION = """
{
    const float* inverse = w;
    const float* stride = w + N;
    const float* last = w + 2 * N;  // the last cell's number
    const auto value = $decode;
    V share[N], at = zero;
    $begin
#pragma unroll
    for (int k = 0; k < N; ++k) {
        const V t = (v[k] + limit[k]) * inverse[k];
        const V cell = $floor(least(most(t, zero), zero + last[k]));
        share[k] = t - cell;
        at = at + cell * stride[k];
        $place
    }
    V node[1 << N];
    $lanes {
        int first = (int)at$l, step[N];
        float low = w[3 * N], unit = w[3 * N + 1];
#pragma unroll
        for (int k = 0; k < N; ++k) step[k] = (int)stride[k];
        $enter
#pragma unroll
        for (int c = 0; c < 1 << N; ++c) {
            int i = first;
            for (int k = 0; k < N; ++k) i += (c >> k & 1) * step[k];
            node[c]$l = value(i, low, unit);
        }
    }
#pragma unroll
    for (int k = 0; k < N; ++k)
#pragma unroll
        for (int j = 0; j < 1 << (N - 1 - k); ++j) node[j] = node[2 * j] + share[k] * (node[2 * j + 1] - node[2 * j]);
    f = node[0];
}
"""
_BEGIN = """
    const float* fine = w + 3 * N + 2;  // strides of cells; what 8 bits mean; where blocks and bits begin
    V inner[N], sub[N], which = zero;
"""
_PLACE = """
        which = which + cell * fine[k];
        const V s = share[k] * $refine.0f;
        sub[k] = $floor(least(most(s, zero), zero + $last.0f));
        inner[k] = s - sub[k];
"""
_ENTER = """
        const int cell = (int)which$l, bit = cell & 31, word = (int)fine[N + 3] + 2 * (cell >> 5);
        const unsigned int bits = words.data[word];
        if (bits >> bit & 1u) {
            unsigned int x = bits & ((1u << bit) - 1u);
            x -= x >> 1 & 0x55555555u;
            x = (x & 0x33333333u) + (x >> 2 & 0x33333333u);
            x = ((x + (x >> 4)) & 0x0f0f0f0fu) * 0x01010101u >> 24;
            first = (int)fine[N + 2] + (int)(words.data[word + 1] + x) * $size;
            for (int k = N - 1, wide = 1; k >= 0; --k, wide *= $nodes) {
                step[k] = wide;
                first += (int)sub[k]$l * wide;
                share[k]$l = inner[k]$l;
            }
            low = fine[N], unit = fine[N + 1];
        }
"""


@dataclass(frozen=True)
class DistanceGridSource(DistanceSource):
    """Native code of the interpolation.

    Numbers: per axis nodes per local unit, stride and last cell; then what 8 bits mean; where cells are refined per
    axis the stride of a cell's number, what 8 bits of blocks mean, and where blocks (in values) and bits (in words)
    begin. Words: values, blocks, then for 32 cells each their bits, and how many bits there are before.
    """

    storage: str
    refine: int

    whole = False

    def body(self, lanes: Lanes) -> str:
        floor = "__builtin_elementwise_floor" if lanes.vector else "floorf"
        lane, loop = ("[l]", "for (int l = 0; l < L; ++l)") if lanes.vector else ("", "")
        own = {"begin": "", "place": "", "enter": ""}
        if self.refine > 1:
            nodes = self.refine + 1
            place = fill(_PLACE, refine=self.refine, last=self.refine - 1, floor=floor)
            own = {"begin": _BEGIN, "place": place, "enter": fill(_ENTER, size=nodes**self.ndim, nodes=nodes, l=lane)}
        return fill(_INTERPOLATION, decode=decode_text(self.storage), floor=floor, lanes=loop, l=lane, **own)


# --- the grid --------------------------------------------------------------------------------------------------------

NODES = 32  # along the longest side, where none are requested
MOST_NODES = 2**24  # in all: their indices are float32 numbers, exactly
MOST_AXES = 6  # 2^n values are read for each query
REFINED = (1, 2, 4, 8, 16)  # finer cells along each axis of a refined one
PER_WORD = 32  # cells


class DistanceGrid(DistanceBounder):
    """Values at nodes; see module.

    Tensors: ``values``, an axis for each coordinate, float32, float16 or uint8; of uint8 also ``range`` ``(2,)``, the
    value of 0 and the step. Where ``refine`` is over 1 also ``blocks`` ``(B, refine + 1, ...)`` of the same type,
    ``block_range`` as ``range``, and ``refined`` ``(ceil(cells / 32),)`` uint32, a bit for each cell in array order.
    Sizes: ``storage``; ``refine``, 1 if there is none.
    """

    method = "distance-grid"
    room = 0.1
    bit_fields = ("refined",)
    options = (
        Option("nodes", NODES, "of a distance-grid, along the longest side", whole("nodes", 2, 1024), int),
        Option("storage", STORAGES[1], f"of a distance-grid: {', '.join(STORAGES)}", one_of("storage", STORAGES)),
        Option("refine", 1, "of a distance-grid: how much finer it is at the border, a power of two up to 16",
            whole("refine", 1, REFINED[-1]), int),
    )  # fmt: skip

    @classmethod
    def supports(cls, query: str, ndim: int) -> bool:
        return super().supports(query, ndim) and ndim <= MOST_AXES

    @classmethod
    def tensor_types(cls, name: str) -> tuple[type, ...]:
        return (np.float32, np.float16, np.uint8) if name in ("values", "blocks") else super().tensor_types(name)

    @classmethod
    def fit(
        cls,
        shape: Shape,
        domain: DistanceDomain,
        *,
        lowered,
        nodes: int = NODES,
        storage: str = STORAGES[1],
        refine: int = 1,
        device: str | None = None,
    ) -> "DistanceGrid":
        """The distances at nodes, lowered by what interpolation makes too large, and rounded down.

        ``lowered`` is called with a grid in float32, and returns by how much F may exceed the distance in each of its
        ``pieces`` (local units). Raises ``BounderError`` for more nodes than float32 can count, or a ``refine`` that is
        no power of two.
        """
        if refine not in REFINED:
            raise BounderError(f"{cls.method}: refine must be one of {', '.join(map(str, REFINED))}, got {refine!r}")
        limit = domain.limit.astype(np.float64)
        spacing = 2 * limit.max() / (nodes - 1)
        counts = np.maximum(np.ceil(2 * limit / spacing - 1e-6).astype(int) + 1, 2)
        if np.prod(counts.astype(np.float64)) > MOST_NODES:
            raise BounderError(f"{cls.method}: {' x '.join(map(str, counts))} nodes are more than {MOST_NODES:,}")

        def signed(v: np.ndarray) -> np.ndarray:
            """Distances, in the object minus depths, of local coordinates ``(..., n)``; local units."""
            x = domain.to_object(v.reshape(-1, len(counts)))
            return ((shape.distances(x)[:, 0] - shape.depth(x)) / domain.unit).reshape(v.shape[:-1])

        axes = [np.linspace(-edge, edge, count) for edge, count in zip(limit, counts, strict=True)]
        at = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
        values, blocks, cells = signed(at), None, np.zeros((0, len(counts)), int)
        if refine > 1:
            side = 2 * limit / (counts - 1)
            middles = at[(slice(-1),) * len(counts)] + side / 2
            cells = np.argwhere(np.abs(signed(middles)) <= np.linalg.norm(side) / 2)
            if np.prod(counts.astype(float)) + len(cells) * (refine + 1.0) ** len(counts) > MOST_NODES:
                raise BounderError(
                    f"{cls.method}: nodes and those of {len(cells):,} refined cells are more than {MOST_NODES:,}"
                )
            inside = np.stack(np.meshgrid(*[np.arange(refine + 1) / refine] * len(counts), indexing="ij"), -1)
            corner = (at[tuple(cells.T)]).reshape(-1, *[1] * len(counts), len(counts))
            blocks = signed(corner + inside * side)
        first = cls._of(domain, values, blocks, cells, STORAGES[0], refine, device)
        overestimate = lowered(first) * (1 + 1e-6)
        plain = ~first.refined
        _take_off(values, np.argwhere(plain), overestimate[: plain.sum()])
        if refine > 1:
            fine = np.stack(np.meshgrid(*[np.arange(refine)] * len(counts), indexing="ij"), -1).reshape(-1, len(counts))
            block = np.repeat(np.arange(len(cells)), len(fine))
            _take_off(blocks, np.tile(fine, (len(cells), 1)), overestimate[plain.sum() :], block)
        return cls._of(domain, values, blocks, cells, storage, refine, device)

    @classmethod
    def _of(cls, domain, values, blocks, cells, storage: str, refine: int, device) -> "DistanceGrid":
        """Of numbers in float64, and the cells that have blocks, in array order."""
        parts = {"": Values.of(values, storage)}
        tensors, sizes = {"values": parts[""].stored}, {"storage": storage}
        if refine > 1:
            counts = np.array(values.shape) - 1
            bits = np.zeros(-(-counts.prod() // PER_WORD) * PER_WORD, np.uint8)
            bits[np.ravel_multi_index(tuple(cells.T), counts)] = 1
            parts["block_"] = Values.of(blocks, storage)
            words = np.packbits(bits, bitorder="little").view("<u4").astype(np.uint32)
            tensors |= {"blocks": parts["block_"].stored, "refined": words}
            sizes |= {"refine": refine}
        if storage == STORAGES[2]:
            tensors |= {f"{name}range": part.meaning for name, part in parts.items()}
        return cls(domain, tensors, sizes, device)

    def check_tensors(self) -> None:
        values, storage, refine = self.tensors.get("values"), self.sizes.get("storage"), self.sizes.get("refine", 1)
        if storage not in STORAGES or values is None or values.dtype != storage:
            raise BounderError(
                f"{self.method}: expected values stored as one of {', '.join(STORAGES)}, got {storage!r}"
            )
        if type(refine) is not int or refine not in REFINED:
            raise BounderError(f"{self.method}: refine must be one of {', '.join(map(str, REFINED))}, got {refine!r}")
        if values.ndim != self.ndim or min(values.shape) < 2 or values.size > MOST_NODES:
            raise BounderError(f"{self.method}: expected {self.ndim} axes of 2 nodes or more, got {values.shape}")
        self.refine, eight = refine, storage == STORAGES[2]
        counts, limit = np.array(values.shape), self.domain.limit.astype(np.float64)
        shapes: dict[str, tuple[int, ...]] = {"values": values.shape} | ({"range": (2,)} if eight else {})
        cells = int((counts - 1).prod())
        bits = np.zeros(cells, bool)
        if refine > 1:
            words = self.tensors.get("refined", np.zeros(0, np.uint32))
            shapes["refined"] = (-(-cells // PER_WORD),)
            if words.shape == shapes["refined"]:
                every = np.unpackbits(words.astype("<u4").view(np.uint8), bitorder="little").astype(bool)
                if every[cells:].any():
                    raise BounderError(f"{self.method}: a bit stands for no cell")
                bits = every[:cells]
            shapes["blocks"] = (int(bits.sum()), *[refine + 1] * self.ndim)
            shapes |= {"block_range": (2,)} if eight else {}
        self.expect_shapes(shapes)
        self.refined = bits.reshape(counts - 1)
        self._cells = np.argwhere(self.refined)
        self._number = np.cumsum(bits) - bits  # of a cell's block
        none = np.zeros(2, np.float32)
        parts = [Values(values, self.tensors.get("range", none))]
        if refine > 1:
            blocks = self.tensors["blocks"]
            if blocks.dtype != values.dtype or blocks.size + values.size > MOST_NODES:
                raise BounderError(
                    f"{self.method}: expected blocks of {values.dtype}, got {blocks.size:,} {blocks.dtype}"
                )
            parts.append(Values(blocks, self.tensors.get("block_range", none)))
        if any(part.subnormal for part in parts):
            raise BounderError(f"{self.method}: a value of 16 bits is subnormal")
        self._exact, self._fine = parts[0].exact, parts[-1].exact
        if not max(np.abs(part.exact).max(initial=0.0) for part in parts) <= 2.0**20:
            raise BounderError(f"{self.method}: a value is larger than any distance in the domain")
        self._inverse = round_down((counts - 1) / (2 * limit)).astype(np.float64)

    @property
    def source(self) -> DistanceGridSource:
        return DistanceGridSource(self.ndim, False, self.sizes["storage"], self.refine)

    def weights(self) -> np.ndarray:
        shape, none = self.tensors["values"].shape, np.zeros(2, np.float32)
        numbers = [self._inverse, _strides(shape), np.array(shape) - 2, self.tensors.get("range", none)]
        if self.refine > 1:
            values, blocks = (len(_as_words(self.tensors[name])) for name in ("values", "blocks"))
            begin = values * 4 // self.tensors["values"].itemsize, values + blocks
            numbers += [_strides(self.refined.shape), self.tensors.get("block_range", none), begin]
        return np.concatenate(numbers).astype(np.float32)

    def words(self) -> np.ndarray:
        if self.refine == 1:
            return _as_words(self.tensors["values"])
        bits = self.tensors["refined"]
        before = np.append(self._number[::PER_WORD], 0)[: len(bits)]
        index = np.stack([bits, before.astype(np.uint32)], axis=1).ravel()
        return np.concatenate([_as_words(self.tensors["values"]), _as_words(self.tensors["blocks"]), index])

    def _located(self, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
        """The cells that points ``(N, n)`` of the domain lie in: lower corners, sides ``(N, 1)``, and corner values.

        Corners are in cells of the whole grid. Values are ``2^n`` arrays ``(N,)``: at place i the upper one on axis k
        where bit k of i is set.
        """
        t, n = (v + self.domain.limit.astype(np.float64)) * self._inverse, self.ndim
        cell = np.clip(np.floor(t), 0, np.array(self._exact.shape) - 2).astype(int)
        corners = [np.array([i >> k & 1 for k in range(n)]) for i in range(2**n)]
        held = [self._exact[tuple((cell + corner).T)] for corner in corners]
        origin, side = cell.astype(np.float64), np.ones((len(v), 1))
        fine = self.refined[tuple(cell.T)]
        if fine.any():
            sub = np.clip(np.floor((t[fine] - cell[fine]) * self.refine), 0, self.refine - 1).astype(int)
            block = self._number[np.ravel_multi_index(tuple(cell[fine].T), self.refined.shape)]
            for values, corner in zip(held, corners, strict=True):
                values[fine] = self._fine[(block, *(sub + corner).T)]
            origin[fine] += sub / self.refine
            side[fine] = 1 / self.refine
        return origin, side, held

    def _between(self, v: np.ndarray, origin: np.ndarray, side: np.ndarray) -> np.ndarray:
        """``(N, n)``, places in cells: 0 at the lower corner, 1 at the upper one."""
        return ((v + self.domain.limit.astype(np.float64)) * self._inverse - origin) / side

    def reference(self, v: np.ndarray) -> np.ndarray:
        v = np.asarray(v, dtype=np.float64)
        origin, side, held = self._located(v)
        share, total = self._between(v, origin, side), np.zeros(len(v))
        for i, values in enumerate(held):
            chosen = [i >> k & 1 for k in range(self.ndim)]
            total += np.where(chosen, share, 1 - share).prod(axis=1) * values
        return total

    def corners(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """See ``DistanceBounder``; boxes lie in one cell each."""
        origin, side, held = self._located((lower + upper) / 2)
        sides = [self._between(v, origin, side) for v in (lower, upper)]
        for k in range(self.ndim):  # from the cell's corners to the box's, one axis after the other
            for i in range(2**self.ndim):
                if not i >> k & 1:
                    low, high = held[i], held[i | 1 << k]
                    rise = high - low
                    held[i], held[i | 1 << k] = low + sides[0][:, k] * rise, low + sides[1][:, k] * rise
        return np.stack(held, axis=1)

    def pieces(self) -> tuple[np.ndarray, np.ndarray]:
        """Cells that are not refined, in array order, then the finer ones block by block."""
        last, limit, m = np.array(self.refined.shape), self.domain.limit.astype(np.float64), self.refine
        plain = np.argwhere(~self.refined)
        fine = np.stack(np.meshgrid(*[np.arange(m)] * self.ndim, indexing="ij"), -1).reshape(-1, self.ndim)
        inner = (self._cells[:, None] * m + fine).reshape(-1, self.ndim)
        low = np.concatenate([plain.astype(np.float64), inner / m])
        high = np.concatenate([plain + 1.0, (inner + 1) / m])
        lower, upper = low / self._inverse - limit, high / self._inverse - limit
        return lower, np.where(high == last, np.maximum(upper, limit), upper)

    def _rises(self) -> list[float]:
        """For each axis the most that F changes on the way of one cell of the whole grid."""
        rises = [np.abs(np.diff(self._exact, axis=k)).max() for k in range(self.ndim)]
        if self.refined.any():
            within = [self.refine * np.abs(np.diff(self._fine, axis=k + 1)).max() for k in range(self.ndim)]
            rises = [max(pair) for pair in zip(rises, within, strict=True)]
        return [float(rise) for rise in rises]

    @property
    def steepness(self) -> float:
        """More than the values change on the way of one local unit along any axis, and at least 1."""
        return max(1.0, float(sum(self._rises() * self._inverse)))

    def rounding_bound(self) -> float:
        most = float(max(np.abs(self._exact).max(), np.abs(self._fine).max(initial=0.0)))
        off = 4 * UNIT32 * np.array(self._exact.shape)  # cells
        moved = float((off * self._rises()).sum())
        if self.refine > 1:
            moved += float((off / self._inverse).sum())
        return float(moved + (12 * self.ndim + 3) * UNIT32 * most) * (1 + 1e-6) + FLUSHED


def _strides(shape: tuple[int, ...]) -> list[int]:
    """Of an array in array order, by axis."""
    return [int(np.prod(shape[k + 1 :])) for k in range(len(shape))]


def _as_words(values: np.ndarray) -> np.ndarray:
    """Their bytes, as uint32, with zeros behind them."""
    raw = np.ascontiguousarray(values).tobytes()
    return np.frombuffer(raw + b"\0" * (-len(raw) % 4), dtype=np.uint32)


def _take_off(values: np.ndarray, cells: np.ndarray, overestimate: np.ndarray, block: np.ndarray | None = None) -> None:
    """Lower the values at the nodes of cells ``(N, n)`` in place, each by the largest overestimate of its cells.

    Each cell has ``block`` ``(N,)`` and overestimate ``(N,)``.
    """
    off, first = np.zeros(values.shape), () if block is None else (block,)
    for corner in product((0, 1), repeat=cells.shape[1]):
        np.maximum.at(off, (*first, *(cells + corner).T), overestimate)
    values -= off
