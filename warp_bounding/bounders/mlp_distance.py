"""The distance as a network learns it: F is the network's output, asked at the nearest point of the domain.

A network is smooth, and so is a distance away from the object, so that few weights tell it nearly. What it
overestimates anywhere is its slack, which is proven (``proof.distances``). The domain may be cut into a lattice of
parts: then each part has a *relief*, a byte, by which its own slack is smaller than that of the worst part; F is the
network's output and the relief, and jumps at the edges.
"""

from dataclasses import dataclass
from math import prod

import numpy as np

from warp_bounding.bounders.bounder import STEPS, Bounder, Option, whole
from warp_bounding.bounders.distance import REACH, DistanceBounder
from warp_bounding.bounders.mlp import ACTIVATION, HIDDEN, Layered, Mlp
from warp_bounding.errors import BounderError
from warp_bounding.kernels.distances import FLUSHED, DistanceSource
from warp_bounding.kernels.source import Lanes, fill
from warp_bounding.networks.inference import MlpSource
from warp_bounding.networks.network import Network
from warp_bounding.rounding import UNIT32, UNIT64

# --- a lattice of parts ----------------------------------------------------------------------------------------------

MOST_PARTS = 65_536  # parts of a domain
# Edges keep this far from 0, so that a device that takes tiny v for 0 finds the same part.
NEAREST_TO_ZERO = 2.0**-64


class Lattice:
    """The domain cut at edges.

    Args:
        edges: For each axis of v, its inner edges in ascending order, float32.
    """

    def __init__(self, edges: list[np.ndarray]):
        self.edges = [np.array(axis, dtype=np.float32) for axis in edges]
        for axis in self.edges:
            axis[np.abs(axis) < NEAREST_TO_ZERO] = NEAREST_TO_ZERO
        self.shape = tuple(len(axis) + 1 for axis in self.edges)

    @classmethod
    def of(cls, lower: np.ndarray, upper: np.ndarray, shape: tuple[int, ...]) -> "Lattice":
        """Parts of equal size between two corners ``(n,)``; the outer ones go on to the end of the domain."""
        ends = zip(lower, upper, shape, strict=True)
        return cls([np.linspace(low, high, count + 1)[1:-1].astype(np.float32) for low, high, count in ends])

    @property
    def count(self) -> int:
        """Number of parts."""
        return prod(self.shape)

    def place(self, v: np.ndarray) -> np.ndarray:
        """``(N,)`` int64: index of the part that holds each v ``(N, n)``."""
        along = [np.searchsorted(axis, v[:, k], side="right") for k, axis in enumerate(self.edges)]
        return np.ravel_multi_index(along, self.shape) if along else np.zeros(len(v), np.int64)

    def cut(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Boxes ``(N, n)`` cut at the edges: each piece lies in the closure of one part, its lower corner in it.

        A box that ends on an edge has a piece without width beyond it. Returns corners of the pieces, ``(K, n)``
        float64 each, and which box each one is a piece of.
        """
        owner = np.arange(len(lower))
        for k, axis in enumerate(self.edges):
            first = np.searchsorted(axis, lower[:, k], side="right")
            last = np.searchsorted(axis, upper[:, k], side="right")
            times = last - first + 1
            row = np.repeat(np.arange(len(lower)), times)
            step = np.arange(len(row)) - np.repeat(np.cumsum(times) - times, times)
            ends = np.concatenate([[-np.inf], axis.astype(np.float64), [np.inf]])
            lower, upper, owner = lower[row], upper[row], owner[row]
            lower[:, k] = np.maximum(lower[:, k], ends[first[row] + step])
            upper[:, k] = np.minimum(upper[:, k], ends[first[row] + step + 1])
        return lower, upper, owner

    @classmethod
    def stored(cls, edges: np.ndarray, shape: tuple[int, ...], method: str) -> "Lattice":
        """The lattice of a file: the edges of each axis in turn.

        Raises ``BounderError`` if they do not ascend, or one of them is too near to 0.
        """
        lattice = cls(np.split(edges, np.cumsum([count - 1 for count in shape])[:-1]))
        if not (all((np.diff(axis) > 0).all() for axis in lattice.edges) and (np.abs(edges) >= NEAREST_TO_ZERO).all()):
            raise BounderError(f"{method}: edges must ascend, none of them 0")
        return lattice


def checked_parts(bounder: Bounder) -> tuple[list[int], dict[str, tuple[int, ...]]]:
    """How many parts there are along each axis, as the sizes say, and the shapes of the lattice's tensors.

    Raises ``BounderError`` for what cannot be.
    """
    shape, ndim = bounder.sizes.get("shape"), bounder.domain.ndim
    whole = isinstance(shape, list) and all(type(count) is int and count >= 1 for count in shape)
    if not whole or len(shape) != ndim or prod(shape) > MOST_PARTS:
        raise BounderError(f"{bounder.method}: expected {ndim} counts, at most {MOST_PARTS} parts, got {shape!r}")
    return shape, {"edges": (sum(shape) - ndim,), "levels": (-(-prod(shape) // PER_WORD),)}


def packed(levels: np.ndarray) -> np.ndarray:
    """``(ceil(parts / 4),)`` uint32, words of levels ``(parts,)`` uint8."""
    return np.pad(levels, (0, -len(levels) % PER_WORD)).view("<u4").astype(np.uint32)


def unpacked(words: np.ndarray, count: int) -> np.ndarray:
    """``(count,)`` uint8, the levels in words."""
    return words.astype("<u4").view(np.uint8)[:count]


# Native text.
#
# A lattice of parts in native code: where v lies among the edges of each axis, and the level, a byte, that stands
# there.
#
# Comparisons with edges are exact, so every device finds the same part of the domain, and what is proven of a part
# holds for each v in it.

PER_WORD = 4  # levels, a byte each, in a word

# The index of v's part, in array order: along each axis, how many edges v has reached.
_PLACE = {True: "I part_ = {};\n$axes", False: "int part_ = 0;\n$axes"}
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


def level_text(shape: tuple[int, ...], first: int, vector: bool) -> str:
    """C statements that compute ``level_`` from ``v``, ``w``, where edges begin at ``first``, and ``words``."""
    lines = []
    for k, count in enumerate(shape):
        if count > 1:
            lines.append(fill(_AXIS[vector], k=k, first=first, last=first + count - 1, count=count))
        first += count - 1
    return fill(_PLACE[vector], axes="\n".join(lines)) + _LEVEL[vector]


# --- the distance -----------------------------------------------------------------------------------------------------

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


PARTS = Option("parts", None, "parts of the domain, each with a slack of its own", whole("parts", 1, MOST_PARTS), int)


class MlpDistance(Layered, DistanceBounder):
    """A network's distance; see module.

    Tensors: ``layers.i.weight`` ``(H, K)`` and ``layers.i.bias`` ``(H,)``, the last layer with H = 1; where the domain
    is cut ``edges``, the inner edges of each axis in turn, ``levels`` ``(ceil(parts / 4),)`` uint32, a byte for each
    part, and ``step`` ``(1,)``, a power of two. Sizes: ``hidden``, ``activation``, and ``shape``, the parts along each
    axis.
    """

    method = Mlp.method
    bit_fields = ("levels",)
    options = (HIDDEN, ACTIVATION, PARTS, STEPS, REACH)
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
