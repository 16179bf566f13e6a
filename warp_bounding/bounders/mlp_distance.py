"""The distance as a network learns it: F is the network's output, asked at the nearest point of the domain.

A network is smooth, and so is a distance away from the object, so that few weights tell it nearly. What it
overestimates anywhere is its slack, which is proven (``proof.distances``). The domain may be cut into a lattice of
parts: then each part has a *relief*, a byte, by which its own slack is smaller than that of the worst part; F is the
network's output and the relief, and jumps at the edges.
"""

from dataclasses import dataclass, replace

import numpy as np

from warp_bounding.bounders.bounder import STEPS
from warp_bounding.bounders.cascade import PER_WORD, Lattice, checked_parts, level_text, packed, unpacked
from warp_bounding.bounders.distance import REACH, DistanceBounder
from warp_bounding.bounders.mlp import ACTIVATION, HIDDEN, PARTS, Layered, Mlp
from warp_bounding.errors import BounderError
from warp_bounding.kernels.distances import FLUSHED, DistanceSource
from warp_bounding.kernels.source import Lanes
from warp_bounding.networks.inference import MlpSource
from warp_bounding.networks.network import Network
from warp_bounding.rounding import UNIT32, UNIT64

MOST_AXES = 8  # 2^n corners of each box are requested
RELIEF_ROUNDING = 4.0  # units: more than a sum rounds in float64
NORMS = 1 + 1e-9  # outweighs what float64 rounds in products of norms


LEVELS = 255  # the highest level of relief
STEPS_OF_RELIEF = (2.0**-100, 2.0**10)  # local units between two levels
# Parts of a domain of so many axes, where no number is given; of fewer axes one: slack is small there.
MANY, AXES_OF_MANY = 256, 4


@dataclass(frozen=True)
class MlpDistanceSource(DistanceSource, MlpSource):
    """Native code of the network, in a distance.

    Numbers: the network's, and where the domain is cut, the inner edges of each axis in turn, and the step between two
        levels. Words: the levels.
    """

    count: int = 0  # how many numbers the network has, where the domain is cut
    shape: tuple[int, ...] = ()  # parts along each axis

    whole = False

    @property
    def several(self) -> int:
        return 1 if self.shape else super().several

    def _relief(self, vector: bool) -> str:
        """C statements that add the relief to ``f``."""
        step_at = self.count + sum(self.shape) - len(self.shape)
        return f"{level_text(self.shape, self.count, vector)} f = f + level_ * w[{step_at}];"

    def body(self, lanes: Lanes) -> str:
        return self.relieved(super().body(lanes), lanes)

    def relieved(self, network: str, lanes: Lanes) -> str:
        """C statements that compute ``f``, where ``network`` are those without the relief."""
        return f"{{ {network} }}\n{{ {self._relief(lanes.vector)} }}" if self.shape else network

    def function_body(self) -> str:
        network = super().function_body()
        if not self.shape:
            return network
        return (
            f"float relieved_;\n{{ {network}\n{self._relief(vector=False)} relieved_ = f; }}\nconst float f = "
            "relieved_;"
        )


SLACKS = replace(PARTS, default=None, help="parts of the domain, each with a slack of its own")


class MlpDistance(Layered, DistanceBounder):
    """A network's distance; see module.

    Tensors: ``layers.i.weight`` ``(H, K)`` and ``layers.i.bias`` ``(H,)``, the last layer with H = 1; where the domain
    is cut ``edges``, the inner edges of each axis in turn, ``levels`` ``(ceil(parts / 4),)`` uint32, a byte for each
    part, and ``step`` ``(1,)``, a power of two. Sizes: ``hidden``, ``activation``, and ``shape``, the parts along each
    axis.
    """

    method = Mlp.method
    bit_fields = ("levels",)
    options = (HIDDEN, ACTIVATION, SLACKS, STEPS, REACH)
    moving = True

    @classmethod
    def supports(cls, query: str, ndim: int) -> bool:
        return super().supports(query, ndim) and ndim <= MOST_AXES

    def check_tensors(self) -> None:
        expected = self.layer_shapes(self.domain.ndim, 1)
        shape, of_lattice = checked_parts(self) if self.sizes.get("shape", []) != [] else ([], {})
        self.expect_shapes(expected | of_lattice | ({"step": (1,)} if shape else {}))
        self.lattice = Lattice.stored(self.tensors["edges"], shape, self.method) if shape else None
        step = float(self.tensors["step"][0]) if shape else 1.0
        if not (STEPS_OF_RELIEF[0] <= step <= STEPS_OF_RELIEF[1] and np.frexp(step)[0] == 0.5):
            raise BounderError(f"{self.method}: expected a power of two as the step between two levels, got {step}")
        limit = self.domain.limit.astype(np.float64)
        *layers, (weight, bias) = self.layers
        self.network = Network(self.layers, self.activation, limit)
        self._negative = Network([*layers, (-weight, -bias)], self.activation, limit)

    @property
    def relief(self) -> np.ndarray:
        """``(parts,)`` float64, exact: how much smaller each part's slack is, local units, in array order."""
        return self._levels * np.float64(self.tensors["step"][0])

    @property
    def _levels(self) -> np.ndarray:
        """``(parts,)`` uint8; of parts that differ in time alone (in older files) the least: F does not jump then."""
        levels = unpacked(self.tensors["levels"], self.lattice.count)
        if not self.domain.time:
            return levels
        by_place = levels.reshape(self.lattice.shape).min(axis=0)
        return np.broadcast_to(by_place, self.lattice.shape).reshape(-1)

    def cut_in(self, parts: int) -> "MlpDistance":
        """This bounder with a lattice of at most so many parts, about cubes, of equal slack; itself for one part."""
        limit, counts = self.domain.limit.astype(np.float64), np.ones(self.ndim, dtype=int)
        limit_of_parts = limit.copy()
        limit_of_parts[: int(self.domain.time)] = 0.0  # parts are places, at all times: F does not jump with time
        while True:
            longest = np.argmax(limit_of_parts / counts)
            if counts.prod() // counts[longest] * (counts[longest] + 1) > parts:
                break
            counts[longest] += 1
        if parts < 2 or counts.prod() == 1:
            return self
        shape = tuple(int(count) for count in counts)
        lattice = Lattice.of(-limit, limit, shape)
        levels = np.zeros(-(-lattice.count // PER_WORD), np.uint32)
        own = {"edges": np.concatenate(lattice.edges), "levels": levels, "step": np.ones(1, np.float32)}
        return type(self)(self.domain, self.tensors | own, self.sizes | {"shape": list(shape)}, self._device)

    @property
    def part_count(self) -> int:
        return 1 if self.lattice is None else self.lattice.count

    def part_of(self, v: np.ndarray) -> np.ndarray:
        return super().part_of(v) if self.lattice is None else self.lattice.place(v)

    def relieve(self, overestimate: np.ndarray) -> None:
        """See ``DistanceBounder``: what a part is better than the worst, rounded down to a level."""
        if self.lattice is None:
            return
        room = (overestimate.max() - overestimate) * (1 - 2.0**-40)
        step = 2.0 ** np.clip(np.ceil(np.log2(max(float(room.max()), 2.0**-60) / LEVELS)), -60, 10)
        levels = np.clip(np.floor(room / step), 0, LEVELS).astype(np.uint8)
        self.tensors = self.tensors | {"levels": packed(levels), "step": np.array([step], np.float32)}
        for tensor in self.tensors.values():
            tensor.setflags(write=False)
        self._data = None

    def pieces(self) -> tuple[np.ndarray, np.ndarray]:
        """See ``DistanceBounder``: the parts, in array order."""
        lower, upper = super().pieces()
        return (lower, upper) if self.lattice is None else self.lattice.cut(lower, upper)[:2]

    @property
    def source(self) -> MlpDistanceSource:
        cut = {} if self.lattice is None else {"count": len(super().weights()), "shape": self.lattice.shape}
        return MlpDistanceSource(self.ndim, self.domain.time, hidden=self.hidden, activation=self.activation, **cut)

    def weights(self) -> np.ndarray:
        numbers = super().weights()
        if self.lattice is None:
            return numbers
        return np.concatenate([numbers, self.tensors["edges"], self.tensors["step"]])

    def words(self) -> np.ndarray:
        return super().words() if self.lattice is None else packed(self._levels)

    @property
    def nbytes(self) -> int:
        """See ``DistanceBounder``; a query reads one of two copies of the numbers, for lanes of queries or neurons."""
        head = len(self.domain.header) + 2 + len(self.domain.extra)
        return 4 * head + sum(tensor.nbytes for tensor in self.tensors.values())

    def reference(self, v: np.ndarray) -> np.ndarray:
        v = np.asarray(v, dtype=np.float64)
        return self.network(v) + self._relief_at(v)

    def _relief_at(self, v: np.ndarray) -> np.ndarray:
        return np.zeros(len(v)) if self.lattice is None else self.relief[self.lattice.place(v)]

    def rounding_bound(self) -> float:
        error = self.network.rounding + FLUSHED
        if self.lattice is None:
            return error
        # The sum rounds once; a relief is a whole number of up to 8 bits times a power of two.
        return error + 2 * UNIT32 * (self.network.largest + error + float(self.relief.max()))

    @property
    def tensor_text(self) -> str:
        return self.source.relieved(super().tensor_text, Lanes(vector=False))

    def corners(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """See ``DistanceBounder``: the network's own multilinear bound (``Network.corners``), and the relief."""
        values = self._negative.corners(lower, upper)
        relief = self._relief_at(lower / 2 + upper / 2)[:, None]  # a box lies in one part
        return relief - values + RELIEF_ROUNDING * UNIT64 * (np.abs(values) + relief)

    @property
    def rate(self) -> float:
        """See ``DistanceBounder``; two kinds of products of layer norms, as activations have slopes up to 1."""
        (weight, _), *others = self.layers
        first = weight[:, 0].astype(np.float64)
        entries, spectral = np.abs(first), float(np.linalg.norm(first))
        for weight, _ in others:
            weight = weight.astype(np.float64)
            entries, spectral = np.abs(weight) @ entries, spectral * float(np.linalg.norm(weight, 2))
        return min(float(entries.max()), spectral) * NORMS

    @property
    def steepness(self) -> float:
        """See ``DistanceBounder``: slopes of bounds are within the products of the layers' largest row sums."""
        size = float(np.abs(self.network.output.weight).sum())
        for layer in self.network.hidden:
            size *= max(float(np.abs(layer.weight).sum(axis=1).max()), 1.0)
        return max(size, 1.0)
