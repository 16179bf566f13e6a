"""``distance-grid``: distances at the nodes of a grid, interpolated; the honest rival of a network, by bytes and by ns.

F is multilinear in each cell between the values at its nodes. These begin as the distance to the object, in it as minus
the depth. What multilinear interpolation makes too large is found cell by cell (``proof.distances``) and taken off the
values at the cell's own nodes, so that one bad cell does not cost all of them; values are then rounded down to how they
are stored. The proof goes through all cells again with the stored values.

*Rounding*, u = 2^-24, R nodes along an axis, D the largest difference of neighbours along it: the place ``t = (p +
limit) inverse`` is off by ``4 u R``, which changes F by ``4 u R D`` at most, summed over the axes (a cell beside the
right one has the same values at the face between them); n interpolations of values up to M by ``4 u`` each of ``3 M``;
values of 8 bits, ``low + step q``, by ``3 u M``.
"""

from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from warp_bounding.bounders.bounder import Option, one_of, whole
from warp_bounding.bounders.distance import REACH, DistanceBounder
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

# By the storage, C text from a value's number i among those stored to the value.
_DECODE = {
    "float32": "union { unsigned int u; float f; } x; x.u = words.data[i]; const float value = x.f;",
    "float16": """const unsigned int h = words.data[i >> 1] >> (16 * (i & 1)) & 0xffffu;
            union { unsigned int u; float f; } x;
            x.u = (h & 0x8000u) << 16 | (h & 0x7fffu ? ((h & 0x7fffu) << 13) + 0x38000000u : 0u);
            const float value = x.f;""",
    "uint8": "const float value = w[3 * N] + w[3 * N + 1] * (float)(words.data[i >> 2] >> (8 * (i & 3)) & 0xffu);",
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


# --- native text -----------------------------------------------------------------------------------------------------
#
# Native code of ``distance-grid``: the cell of a query, the values at its corners, and what is multilinear between
# them.

_INTERPOLATION = """
{
    const float* inverse = w;
    const float* stride = w + N;
    const float* last = w + 2 * N;  // the last cell's number
    V share[N], at = zero;
#pragma unroll
    for (int k = 0; k < N; ++k) {
        const V t = (v[k] + limit[k]) * inverse[k];
        const V cell = $floor(wb_least(wb_most(t, zero), zero + last[k]));
        share[k] = t - cell;
        at = at + cell * stride[k];
    }
    V node[1 << N];
    $lanes {
#pragma unroll
        for (int c = 0; c < 1 << N; ++c) {
            int i = (int)at$l;
            for (int k = 0; k < N; ++k) i += (c >> k & 1) * (int)stride[k];
            $decode
            node[c]$l = value;
        }
    }
#pragma unroll
    for (int k = 0; k < N; ++k)
#pragma unroll
        for (int j = 0; j < 1 << (N - 1 - k); ++j) node[j] = node[2 * j] + share[k] * (node[2 * j + 1] - node[2 * j]);
    f = node[0];
}
"""


@dataclass(frozen=True)
class DistanceGridSource(DistanceSource):
    """Native code of the interpolation.

    Numbers: per axis nodes per local unit, stride and last cell; then what 8 bits mean. Words: values.
    """

    storage: str

    whole = False

    def body(self, lanes: Lanes) -> str:
        floor = "__builtin_elementwise_floor" if lanes.vector else "floorf"
        lane, loop = ("[l]", "for (int l = 0; l < L; ++l)") if lanes.vector else ("", "")
        return fill(_INTERPOLATION, decode=_DECODE[self.storage], floor=floor, lanes=loop, l=lane)


# --- the grid --------------------------------------------------------------------------------------------------------

NODES = 32  # along the longest side, where none are requested
MOST_NODES = 2**24  # in all: their indices are float32 numbers, exactly
MOST_AXES = 6  # 2^n values are read for each query


class DistanceGrid(DistanceBounder):
    """Values at nodes; see module.

    Tensors: ``values``, an axis for each coordinate, float32, float16 or uint8; of uint8 also ``range`` ``(2,)``, the
    value of 0 and the step. Sizes: ``storage``.
    """

    method = "distance-grid"
    options = (
        Option("nodes", NODES, "of a distance-grid, along the longest side", whole("nodes", 2, 1024), int),
        Option("storage", STORAGES[1], f"of a distance-grid: {', '.join(STORAGES)}", one_of("storage", STORAGES)),
        REACH,
    )

    @classmethod
    def supports(cls, query: str, ndim: int) -> bool:
        return super().supports(query, ndim) and ndim <= MOST_AXES

    @classmethod
    def tensor_types(cls, name: str) -> tuple[type, ...]:
        return (np.float32, np.float16, np.uint8) if name == "values" else super().tensor_types(name)

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

        ``lowered`` is called with a grid in float32, and returns by how much F may exceed the distance in each of its
        ``pieces`` (local units). Raises ``BounderError`` for more nodes than float32 can count.
        """
        limit = domain.limit.astype(np.float64)
        spacing = 2 * limit.max() / (nodes - 1)
        counts = np.maximum(np.ceil(2 * limit / spacing - 1e-6).astype(int) + 1, 2)
        if np.prod(counts.astype(np.float64)) > MOST_NODES:
            raise BounderError(f"{cls.method}: {' x '.join(map(str, counts))} nodes are more than {MOST_NODES:,}")

        axes = [np.linspace(-edge, edge, count) for edge, count in zip(limit, counts, strict=True)]
        x = domain.to_object(np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, len(counts)))
        values = ((shape.distances(x)[:, 0] - shape.depth(x)) / domain.unit).reshape(counts)
        overestimate = lowered(cls._of(domain, values, STORAGES[0], device)) * (1 + 1e-6)
        cells, off = np.argwhere(np.ones(counts - 1, bool)), np.zeros(values.shape)
        for corner in product((0, 1), repeat=len(counts)):  # off each node the largest overestimate of its cells
            np.maximum.at(off, tuple((cells + corner).T), overestimate)
        return cls._of(domain, values - off, storage, device)

    @classmethod
    def _of(cls, domain: DistanceDomain, values: np.ndarray, storage: str, device: str | None) -> "DistanceGrid":
        """Of numbers in float64."""
        found = Values.of(values, storage)
        tensors = {"values": found.stored} | ({"range": found.meaning} if storage == STORAGES[2] else {})
        return cls(domain, tensors, {"storage": storage}, device)

    def check_tensors(self) -> None:
        values, storage = self.tensors.get("values"), self.sizes.get("storage")
        if "refine" in self.sizes:
            raise BounderError(f"{self.method}: refined grids are no longer read; fit a plain one with more nodes")
        if storage not in STORAGES or values is None or values.dtype != storage:
            raise BounderError(
                f"{self.method}: expected values stored as one of {', '.join(STORAGES)}, got {storage!r}"
            )
        if values.ndim != self.ndim or min(values.shape) < 2 or values.size > MOST_NODES:
            raise BounderError(f"{self.method}: expected {self.ndim} axes of 2 nodes or more, got {values.shape}")
        self.expect_shapes({"values": values.shape} | ({"range": (2,)} if storage == STORAGES[2] else {}))
        part = Values(values, self.tensors.get("range", np.zeros(2, np.float32)))
        self._exact = part.exact
        if values.dtype == np.float16 and ((values != 0) & (np.abs(self._exact) < SMALLEST_HALF)).any():
            raise BounderError(f"{self.method}: a value of 16 bits is subnormal")  # which is not read as it stands
        if not np.abs(self._exact).max() <= 2.0**20:
            raise BounderError(f"{self.method}: a value is larger than any distance in the domain")
        per_unit = (np.array(values.shape) - 1) / (2 * self.domain.limit.astype(np.float64))
        self._inverse = round_down(per_unit).astype(np.float64)

    @property
    def source(self) -> DistanceGridSource:
        return DistanceGridSource(self.ndim, False, self.sizes["storage"])

    def weights(self) -> np.ndarray:
        shape = self.tensors["values"].shape
        strides = [int(np.prod(shape[k + 1 :])) for k in range(len(shape))]
        numbers = [self._inverse, strides, np.array(shape) - 2, self.tensors.get("range", np.zeros(2, np.float32))]
        return np.concatenate(numbers).astype(np.float32)

    def words(self) -> np.ndarray:
        """The values' bytes, as uint32, with zeros behind them."""
        raw = np.ascontiguousarray(self.tensors["values"]).tobytes()
        return np.frombuffer(raw + b"\0" * (-len(raw) % 4), dtype=np.uint32)

    def field(self, pose=None, name: str | None = None):
        """The ``arms.DistanceField`` of an object in space, an obstacle of ``arms.Motions``.

        Values are what is proven: exact ones with the threshold added.

        Args:
            pose: ``(4, 4)``, where the object stands.
            name: The object's for ``None``.

        Raises:
            BounderError: For what is not proven, has no three axes, or counts coordinates from an origin.

        Example:
            >>> far = wb.fit(mesh, "distance", "distance-grid", nodes=12, device="cpu")
            >>> wb.arms.Motions(arm, far.field(name="rock")).obstacles[0].name
            'rock'
        """
        from warp_bounding.arms.scan import DistanceField

        if self.ndim != 3 or self.frame is not None or self.certificate is None or not self.certificate.proven:
            raise BounderError(f"{self.method}: an obstacle is proven, 3D, and near its origin; pose= says where it is")
        unit, domain = self.domain.unit, self.domain
        values = (self._exact + float(self.threshold)) * unit
        center, half = domain.center.astype(np.float64), domain.limit.astype(np.float64) * unit
        placed, named = np.eye(4) if pose is None else pose, name or self.info.get("name") or "field"
        return DistanceField(values, center, half, unit / self._inverse, placed, named)

    def _located(self, v: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        """The cells that points ``(N, n)`` of the domain lie in: lower corners, and corner values.

        Values are ``2^n`` arrays ``(N,)``: at place i the upper one on axis k where bit k of i is set.
        """
        t, n = (v + self.domain.limit.astype(np.float64)) * self._inverse, self.ndim
        cell = np.clip(np.floor(t), 0, np.array(self._exact.shape) - 2).astype(int)
        corners = [np.array([i >> k & 1 for k in range(n)]) for i in range(2**n)]
        return cell.astype(np.float64), [self._exact[tuple((cell + corner).T)] for corner in corners]

    def _between(self, v: np.ndarray, origin: np.ndarray) -> np.ndarray:
        """``(N, n)``, places in cells: 0 at the lower corner, 1 at the upper one."""
        return (v + self.domain.limit.astype(np.float64)) * self._inverse - origin

    def reference(self, v: np.ndarray) -> np.ndarray:
        v = np.asarray(v, dtype=np.float64)
        origin, held = self._located(v)
        share, total = self._between(v, origin), np.zeros(len(v))
        for i, values in enumerate(held):
            chosen = [i >> k & 1 for k in range(self.ndim)]
            total += np.where(chosen, share, 1 - share).prod(axis=1) * values
        return total

    def corners(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """See ``DistanceBounder``; boxes lie in one cell each."""
        origin, held = self._located((lower + upper) / 2)
        sides = [self._between(v, origin) for v in (lower, upper)]
        for k in range(self.ndim):  # from the cell's corners to the box's, one axis after the other
            for i in range(2**self.ndim):
                if not i >> k & 1:
                    low, high = held[i], held[i | 1 << k]
                    rise = high - low
                    held[i], held[i | 1 << k] = low + sides[0][:, k] * rise, low + sides[1][:, k] * rise
        return np.stack(held, axis=1)

    def pieces(self) -> tuple[np.ndarray, np.ndarray]:
        """All cells, in array order."""
        last, limit = np.array(self._exact.shape) - 1, self.domain.limit.astype(np.float64)
        low = np.argwhere(np.ones(last, bool)).astype(np.float64)
        lower, upper = low / self._inverse - limit, (low + 1.0) / self._inverse - limit
        return lower, np.where(low + 1 == last, np.maximum(upper, limit), upper)

    def _rises(self) -> list[float]:
        """For each axis the most that F changes on the way of one cell."""
        return [float(np.abs(np.diff(self._exact, axis=k)).max()) for k in range(self.ndim)]

    @property
    def steepness(self) -> float:
        """More than the values change on the way of one local unit along any axis, and at least 1."""
        return max(1.0, float(sum(self._rises() * self._inverse)))

    def rounding_bound(self) -> float:
        off = 4 * UNIT32 * np.array(self._exact.shape)  # cells
        moved, most = float((off * self._rises()).sum()), float(np.abs(self._exact).max())
        return float(moved + (12 * self.ndim + 3) * UNIT32 * most) * (1 + 1e-6) + FLUSHED
