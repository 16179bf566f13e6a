"""``distance-grid``: distances at the nodes of a grid, interpolated; the honest rival of a network, by bytes and by ns.

F is multilinear in each cell between the values at its nodes. These begin as the distance to the object, in it as minus the depth. What multilinear interpolation
makes too large is found cell by cell (``proof.distances.excesses``) and taken off the values at the cell's own nodes, so that one bad cell does not cost all of them; values are then rounded down to how they are
stored. The proof goes through all cells again with the stored values.

*Rounding*, u = 2^-24, R nodes along an axis, D the largest difference of neighbours along it: the place ``t = (p + limit) inverse`` is off by ``4 u R``, which changes F by ``4 u R D`` at most, summed over the
axes (a cell beside the right one has the same values at the face between them); n interpolations of values up to M by ``4 u`` each of ``3 M``; values of 8 bits, ``low + step q``, by ``3 u M``.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
import warp as wp

from warp_bounding.arithmetic import UNIT32, round_down
from warp_bounding.bounders.distances.base import DistanceBounder
from warp_bounding.bounders.options import Option, one_of, whole
from warp_bounding.coordinates.distance_domain import DistanceDomain
from warp_bounding.errors import BounderError
from warp_bounding.indicators.shape import Shape
from warp_bounding.kernels.distances.source import FLUSHED, DistanceSource
from warp_bounding.kernels.plain import Numbers, Words, twin, vector_type
from warp_bounding.kernels.source import LABEL, Lanes, fill

__all__ = ["STORAGES", "DistanceGrid", "DistanceGridSource"]

NODES = 32  # along the longest side, where none are asked for
MOST_NODES = 2**24  # in all: their indices are float32 numbers, exactly
MOST_AXES = 6  # 2^n values are read for each query
SMALLEST_HALF = 2.0**-14  # the least normal number of 16 bits; smaller ones are rounded down to 0, or to minus this

_DECODE = {
    "float32": "[&](int i) { union { unsigned int u; float f; } x; x.u = words.data[i]; return x.f; }",
    "float16": """[&](int i) {
        const unsigned int h = words.data[i >> 1] >> (16 * (i & 1)) & 0xffffu;
        union { unsigned int u; float f; } x;
        x.u = (h & 0x8000u) << 16 | (h & 0x7fffu ? ((h & 0x7fffu) << 13) + 0x38000000u : 0u);
        return x.f;
    }""",
    "uint8": "[&](int i) { return low + step * (float)(words.data[i >> 2] >> (8 * (i & 3)) & 0xffu); }",
}
STORAGES = tuple(_DECODE)

_BODY = """
{
    const float* inverse = w;
    const float* stride = w + N;
    const float* last = w + 2 * N;  // the last cell's number
    const float low = w[3 * N], step = w[3 * N + 1];
    (void)low; (void)step;
    const auto value = $decode;
    V share[N], at = zero;
#pragma unroll
    for (int k = 0; k < N; ++k) {
        const V t = (v[k] + limit[k]) * inverse[k];
        const V cell = $floor(least(most(t, zero), zero + last[k]));
        share[k] = t - cell;
        at = at + cell * stride[k];
    }
    V node[1 << N];
    $gather
#pragma unroll
    for (int k = 0; k < N; ++k)
#pragma unroll
        for (int j = 0; j < 1 << (N - 1 - k); ++j) node[j] = node[2 * j] + share[k] * (node[2 * j + 1] - node[2 * j]);
    f = node[0];
}
"""
_GATHER = {
    True: """
    for (int l = 0; l < L; ++l) {
        const int first = (int)at[l];
#pragma unroll
        for (int c = 0; c < 1 << N; ++c) {
            int i = first;
            for (int k = 0; k < N; ++k) i += (c >> k & 1) * (int)stride[k];
            node[c][l] = value(i);
        }
    }
""",
    False: """
    {
        const int first = (int)at;
#pragma unroll
        for (int c = 0; c < 1 << N; ++c) {
            int i = first;
            for (int k = 0; k < N; ++k) i += (c >> k & 1) * (int)stride[k];
            node[c] = value(i);
        }
    }
""",
}


@dataclass(frozen=True)
class DistanceGridSource(DistanceSource):
    """Native code of the interpolation. Numbers: per axis nodes per local unit, stride and last cell; then what 8 bits mean. Words: values."""

    storage: str

    whole = False

    def body(self, lanes: Lanes) -> str:
        floor = "__builtin_elementwise_floor" if lanes.vector else "floorf"
        return fill(_BODY, decode=_DECODE[self.storage], floor=floor, gather=_GATHER[lanes.vector])

    def plain(self) -> wp.Function:
        n, corners = self.ndim, 2**self.ndim
        limit = LABEL + n - self.start  # of the domain, from the method's numbers on
        vector, held, decode = vector_type(self.ndim), wp.types.vector(2**self.ndim, wp.float32), self._decode()

        @twin(self)
        def f(w: Numbers, words: Words, at: int, v: vector) -> float:
            share, first, node = vector(), wp.int32(0), held()
            for k in range(n):
                t = (v[k] + w[at + limit + k]) * w[at + k]
                cell = wp.floor(wp.clamp(t, 0.0, w[at + 2 * n + k]))
                share[k] = t - cell
                first += int(cell) * int(w[at + n + k])
            for c in range(corners):
                i = wp.int32(first)
                for k in range(n):
                    i += ((c >> k) & 1) * int(w[at + n + k])
                node[c] = decode(w, words, at, i)
            count = wp.int32(corners)
            for k in range(n):
                count = count // 2
                for j in range(count):
                    node[j] = node[2 * j] + share[k] * (node[2 * j + 1] - node[2 * j])
            return node[0]

        return f

    def _decode(self) -> wp.Function:
        n = self.ndim

        @twin(self, "decode")
        def single(w: Numbers, words: Words, at: int, i: int) -> float:
            return wp.cast(words[i], wp.float32)

        @twin(self, "decode")
        def half(w: Numbers, words: Words, at: int, i: int) -> float:
            h = (words[i >> 1] >> wp.uint32(16 * (i & 1))) & wp.uint32(0xFFFF)
            size = h & wp.uint32(0x7FFF)
            value = wp.cast((size << wp.uint32(13)) + wp.uint32(0x38000000), wp.float32)
            value = wp.where(size == wp.uint32(0), 0.0, value)
            return wp.where(h > wp.uint32(0x7FFF), -value, value)

        @twin(self, "decode")
        def byte(w: Numbers, words: Words, at: int, i: int) -> float:
            q = (words[i >> 2] >> wp.uint32(8 * (i & 3))) & wp.uint32(0xFF)
            return w[at + 3 * n] + w[at + 3 * n + 1] * float(q)

        return dict(zip(STORAGES, (single, half, byte), strict=True))[self.storage]


class DistanceGrid(DistanceBounder):
    """Values at nodes; see module.

    Tensors: ``values``, an axis for each coordinate, float32, float16 or uint8; of uint8 also ``range`` ``(2,)``, the value of 0 and the step.
    Sizes: ``storage``.
    """

    method = "distance-grid"
    room = 0.1
    options = (
        Option("nodes", NODES, "of a distance-grid, along the longest side", whole("nodes", 2, 1024), int),
        Option("storage", STORAGES[1], f"of a distance-grid: {', '.join(STORAGES)}", one_of("storage", STORAGES)),
    )

    @classmethod
    def supports(cls, ndim: int) -> bool:
        return 1 <= ndim <= MOST_AXES

    @staticmethod
    def tensor_types(name: str) -> tuple[type, ...]:
        return (np.float32, np.float16, np.uint8) if name == "values" else (np.float32,)

    @classmethod
    def fit(
        cls,
        shape: Shape,
        domain: DistanceDomain,
        *,
        lowered,
        nodes: int = NODES,
        storage: str = STORAGES[1],
        device: str | None = None,
    ) -> "DistanceGrid":
        """The distances at nodes, lowered by what interpolation makes too large, and rounded down.

        Args:
            shape: The object.
            domain: Of it, with some room.
            lowered: Called with a grid in float32, it returns by how much F may exceed the distance in each of its cells (local units).
            nodes: Along the longest side.
            storage: How values are stored.
            device: Warp device.

        Raises:
            BounderError: For more nodes than float32 can count.
        """
        limit = domain.limit.astype(np.float64)
        spacing = 2 * limit.max() / (nodes - 1)
        counts = np.maximum(np.ceil(2 * limit / spacing - 1e-6).astype(int) + 1, 2)
        if np.prod(counts.astype(np.float64)) > MOST_NODES:
            raise BounderError(f"{cls.method}: {' x '.join(map(str, counts))} nodes are more than {MOST_NODES:,}")
        axes = [np.linspace(-edge, edge, count) for edge, count in zip(limit, counts, strict=True)]
        x = domain.to_object(np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, len(counts)))
        signed = (shape.distances(x)[:, 0] - shape.depth(x)) / domain.unit
        values = round_down(signed.reshape(counts))
        first = cls(domain, {"values": values.astype(np.float32)}, {"storage": STORAGES[0]}, device)
        off = np.zeros(counts)
        excess = lowered(first).reshape(counts - 1)
        for corner in product((0, 1), repeat=len(counts)):
            part = tuple(slice(c, c + count - 1) for c, count in zip(corner, counts, strict=True))
            off[part] = np.maximum(off[part], excess)
        values = values - off * (1 + 1e-6)
        return cls(domain, _stored(values, storage), {"storage": storage}, device)

    def check_tensors(self) -> None:
        values, storage = self.tensors.get("values"), self.sizes.get("storage")
        if storage not in STORAGES or values is None or values.dtype != storage:
            raise BounderError(
                f"{self.method}: expected values stored as one of {', '.join(STORAGES)}, got {storage!r}"
            )
        if values.ndim != self.ndim or min(values.shape) < 2 or values.size > MOST_NODES:
            raise BounderError(f"{self.method}: expected {self.ndim} axes of 2 nodes or more, got {values.shape}")
        self.expect_shapes({"values": values.shape} | ({"range": (2,)} if storage == STORAGES[2] else {}))
        exact = values.astype(np.float64)
        if storage == STORAGES[2]:
            low, step = self.tensors["range"].astype(np.float64)
            exact = low + step * exact
        if storage == STORAGES[1] and ((exact != 0) & (np.abs(exact) < SMALLEST_HALF)).any():
            raise BounderError(f"{self.method}: a value of 16 bits is subnormal")
        if not np.abs(exact).max() <= 2.0**20:
            raise BounderError(f"{self.method}: a value is larger than any distance in the domain")
        self._exact = exact
        counts, limit = np.array(values.shape), self.domain.limit.astype(np.float64)
        self._inverse = round_down((counts - 1) / (2 * limit)).astype(np.float64)

    @property
    def source(self) -> DistanceGridSource:
        return DistanceGridSource(self.ndim, False, self.sizes["storage"])

    def weights(self) -> np.ndarray:
        shape = self.tensors["values"].shape
        strides = [int(np.prod(shape[k + 1 :])) for k in range(self.ndim)]
        meaning = self.tensors.get("range", np.zeros(2, np.float32))
        return np.concatenate([self._inverse, strides, np.array(shape) - 2, meaning]).astype(np.float32)

    def words(self) -> np.ndarray:
        raw = np.ascontiguousarray(self.tensors["values"]).tobytes()
        return np.frombuffer(raw + b"\0" * (-len(raw) % 4), dtype=np.uint32)

    def _places(self, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cells ``(N, n)`` and places in them, of points of the domain."""
        t = (v + self.domain.limit.astype(np.float64)) * self._inverse
        cell = np.clip(np.floor(t), 0, np.array(self._exact.shape) - 2)
        return cell.astype(int), t - cell

    def reference(self, v: np.ndarray) -> np.ndarray:
        return self._interpolated(*self._places(np.asarray(v, dtype=np.float64)))

    def _interpolated(self, cell: np.ndarray, share: np.ndarray) -> np.ndarray:
        total = np.zeros(len(cell))
        for corner in product((0, 1), repeat=self.ndim):
            weight = np.where(corner, share, 1 - share).prod(axis=1)
            total += weight * self._exact[tuple((cell + corner).T)]
        return total

    def corners(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See ``DistanceBounder``; boxes lie in one cell each."""
        cell, _ = self._places((lower + upper) / 2)
        n, limit = self.ndim, self.domain.limit.astype(np.float64)
        sides = [(side + limit) * self._inverse - cell for side in (lower, upper)]
        held = [self._exact[tuple((cell + [i >> k & 1 for k in range(n)]).T)] for i in range(2**n)]
        for k in range(n):  # from the cell's corners to the box's, one axis after the other
            for i in range(2**n):
                if not i >> k & 1:
                    low, high = held[i], held[i | 1 << k]
                    rise = high - low
                    held[i], held[i | 1 << k] = low + sides[0][:, k] * rise, low + sides[1][:, k] * rise
        return np.stack(held, axis=1), np.argmax(upper - lower, axis=1)

    def pieces(self) -> tuple[np.ndarray, np.ndarray]:
        counts, limit = np.array(self._exact.shape), self.domain.limit.astype(np.float64)
        cells = np.stack(np.meshgrid(*[np.arange(c - 1) for c in counts], indexing="ij"), -1).reshape(-1, self.ndim)
        lower, upper = cells / self._inverse - limit, (cells + 1) / self._inverse - limit
        return lower, np.where(cells == counts - 2, np.maximum(upper, limit), upper)

    @property
    def steepness(self) -> float:
        """More than the values change on the way of one local unit along any axis, and at least 1."""
        return max(
            1.0, float(sum(np.abs(np.diff(self._exact, axis=k)).max() * self._inverse[k] for k in range(self.ndim)))
        )

    def rounding_bound(self) -> float:
        most, counts = float(np.abs(self._exact).max()), self._exact.shape
        moved = sum(4 * UNIT32 * counts[k] * np.abs(np.diff(self._exact, axis=k)).max() for k in range(self.ndim))
        return float(moved + (12 * self.ndim + 3) * UNIT32 * most) * (1 + 1e-6) + FLUSHED


def _stored(values: np.ndarray, storage: str) -> dict[str, np.ndarray]:
    """Values, rounded down, as they are stored."""
    if storage == STORAGES[0]:
        return {"values": round_down(values).astype(np.float32)}
    if storage == STORAGES[1]:
        half = values.astype(np.float16)
        half = np.where(half.astype(np.float64) > values, np.nextafter(half, np.float16(-np.inf)), half)
        small = (half != 0) & (np.abs(half) < SMALLEST_HALF)
        return {"values": np.where(small, np.where(half > 0, 0.0, -SMALLEST_HALF), half).astype(np.float16)}
    low = np.float32(np.nextafter(round_down(values.min()), np.float32(-np.inf)))
    step = np.nextafter(np.float32((values.max() - low) / 255), np.float32(np.inf))
    numbers = np.floor((values - low) / float(step) * (1 - 1e-12)).clip(0, 255)
    return {"values": numbers.astype(np.uint8), "range": np.array([low, step], np.float32)}
