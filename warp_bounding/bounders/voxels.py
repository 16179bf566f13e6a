"""``voxels``: the occupancy grid itself as a bit field; exact on its own grid, at the cost of memory.

A coordinate ``v`` becomes a cell coordinate ``t`` with a rounding error; a point within ``reach`` of a cell's border is
tested against the cells on both sides, so that no rounding can push a point of the object into an empty cell. That
widens the object by less than a thousandth of a cell, the proofs' ``delta`` included.
"""

from dataclasses import dataclass
from math import prod

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.errors import BounderError
from warp_bounding.kernels.source import Lanes, Source
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.queries.domain import GROWTH, Domain
from warp_bounding.rounding import TINY, UNIT32, gamma, round_up
from warp_bounding.runtime.native import fill, native_text
from warp_bounding.shapes.grid import Grid

text = native_text("cells.h")

MOST_CELLS = 2**31 - 1  # kernels count cells in 32 bits
MOST_ALONG = 2**24  # cells along an axis, which float32 can distinguish

_TOGETHER = {
    "integer": "I",
    "first": "__builtin_convertvector(a, I)",
    "last": "__builtin_convertvector(b, I)",
    "lanes": "for (int l = 0; l < L; ++l)",
}
_ALONE = {"integer": "int", "first": "(int)a", "last": "(int)b", "lanes": ""}


@dataclass(frozen=True)
class VoxelsSource(Source):
    """Native code of the bit test. Numbers, per axis: factor and summand of ``t + 1/2``, and reach."""

    shape: tuple[int, ...]

    packed = True

    def body(self, lanes: Lanes) -> str:
        at = "[l]" if lanes.vector else ""
        along = range(self.ndim)
        loops = "".join(f"for (int i{k} = first[{k}]{at}; i{k} <= last[{k}]{at}; ++i{k})\n" for k in along)
        index = "i0"
        for k in along[1:]:
            index = f"({index}) * {self.shape[k]} + i{k}"
        sizes = {"n": self.ndim, "shape": ", ".join(map(str, self.shape)), "at": at, "loops": loops, "index": index}
        return f"{{{fill(text.VOXELS, **sizes, **(_TOGETHER if lanes.vector else _ALONE))}}}\n"


def _size(factor: np.ndarray, summand: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """``(n,)`` float64: the largest sum of absolute terms of a cell coordinate."""
    return np.abs(factor) * limit.astype(np.float64) + np.abs(summand)


class Voxels(Bounder):
    """The occupied cells as bits, in array order.

    Tensors: ``bits`` ``(ceil(cells / 32),)`` uint32, ``factor``, ``summand`` and ``reach`` ``(n,)`` float32. Sizes:
    ``shape``.
    """

    method = "voxels"
    lays_cells = True
    bit_fields = ("bits",)

    @classmethod
    def fit(cls, grid: Grid, domain: Domain, *, device: str | None = None) -> "Voxels":
        packed = np.packbits(grid.occupancy.reshape(-1), bitorder="little")
        bits = np.pad(packed, (0, -len(packed) % 4)).view("<u4").astype(np.uint32)
        scale, center, limit = (x.astype(np.float64) for x in (domain.scale, domain.center, domain.limit))
        exact_factor, exact_summand = grid.cells_per_unit / scale, center * grid.cells_per_unit - grid.offset + 0.5
        factor, summand = exact_factor.astype(np.float32), exact_summand.astype(np.float32)
        rounding = gamma(4) * (_size(factor, summand, limit) + 1)
        rounding = rounding + np.abs(factor - exact_factor) * limit + np.abs(summand - exact_summand)
        rounding += (4 + np.abs(factor) + limit) * TINY
        reach = (rounding * 2 + exact_factor * domain.delta) * GROWTH + UNIT32
        if (reach >= 0.5).any():
            raise BounderError(f"voxels: float32 cannot resolve a grid of {grid.shape} cells")
        tensors = {"bits": bits, "factor": factor, "summand": summand, "reach": round_up(reach)}
        return cls(domain, tensors, {"shape": list(grid.shape)}, device)

    def check_tensors(self) -> None:
        domain, shape = self.domain, tuple(self.sizes.get("shape", ()))
        whole = len(shape) == domain.ndim and all(type(r) is int and 0 < r <= MOST_ALONG for r in shape)
        if not whole or prod(shape) > MOST_CELLS:
            expected = f"{domain.ndim} grid sizes up to {MOST_ALONG}, {MOST_CELLS} cells in all"
            raise BounderError(f"voxels: expected {expected}, got {shape}")
        along_axes = dict.fromkeys(("factor", "summand", "reach"), (domain.ndim,))
        self.expect_shapes({"bits": (-(-prod(shape) // 32),)} | along_axes)
        self.shape = shape
        factor, summand, reach = (self.tensors[name] for name in along_axes)
        if not (_size(factor, summand, domain.limit) + np.abs(reach) < 2.0**60).all():
            raise BounderError("voxels: numbers are so large that float32 sums may overflow")
        # ``bound`` maps the ends of a box to the ends of its cells, and needs every cell within reach to be tested.
        if not ((factor > 0) & (reach >= 0) & (reach <= 0.5)).all():
            got = f"{factor.tolist()} and {reach.tolist()}"
            raise BounderError(f"voxels: expected positive factors and reaches from 0 to 1/2, got {got}")

    @property
    def source(self) -> VoxelsSource:
        return self.source_of(VoxelsSource, self.shape)

    def weights(self) -> np.ndarray:
        return np.concatenate([self.tensors[k] for k in ("factor", "summand", "reach")])

    def words(self) -> np.ndarray:
        return self.tensors["bits"]

    def _occupied(self, cell: np.ndarray) -> np.ndarray:
        """Whether cells ``(N, n)`` int64 inside the grid are occupied."""
        index = np.ravel_multi_index(tuple(cell.T), self.shape)
        return (self.tensors["bits"][index >> 5] >> (index & 31).astype(np.uint32)) & 1 == 1

    def _cells(self, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """``t + 1/2`` in float64, and the reach."""
        factor, summand, reach = (self.tensors[k].astype(np.float64) for k in ("factor", "summand", "reach"))
        return np.asarray(v, dtype=np.float64) * factor + summand, reach

    def reference(self, v: np.ndarray) -> np.ndarray:
        """See ``Bounder``; 1.0 where a cell within reach is occupied. At the end of the reach devices may differ."""
        t, reach = self._cells(v)
        last = np.array(self.shape) - 1
        first, final = (np.clip(t + s * reach, 0, last).astype(np.int64) for s in (-1, 1))
        found = np.zeros(len(t), dtype=bool)
        for choice in np.ndindex((2,) * self.ndim):
            found |= self._occupied(np.where(choice, final, first))
        return found.astype(np.float64)

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """See ``Bounder``: 1 where *every* device finds one and the same occupied cell for all of the box, else 0."""
        low, reach = self._cells(lower)
        high, _ = self._cells(upper)
        size = _size(self.tensors["factor"], self.tensors["summand"], self.domain.limit) + 1
        sure = reach - gamma(4) * size - (4 + size) * TINY - 1e-12 * size  # what rounding leaves of the reach
        cell = np.clip(np.floor((low + high) / 2), 0, np.array(self.shape) - 1).astype(np.int64)
        holds = ((low >= cell - sure) & (high <= cell + 1 + sure)).all(axis=1)
        found, center = (holds & self._occupied(cell)).astype(np.float64), (lower + upper) / 2
        return BoxBounds(found, np.argmax(upper - lower, axis=1), center, self.reference(center))

    def rounding_bound(self) -> float:
        return 0.0  # ``bound`` is about what devices compute
