"""``local``: a network with a threshold of its own in each part of the domain, so that its worst place sets one price.

The coordinates v are cut along each axis at *edges*, into a lattice of parts. Each part has a *level*, one byte: the
threshold that f must reach there; or that no positive lies in the part at all, or hardly anything else, and the network
is not even asked. f less the threshold of v's part is the f of this class; it jumps at the edges, and so proofs cut their boxes there (``cut``);
those of rays and boxes, whose boxes are not of v, search each part by itself (``proof.parts``).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import prod

import numpy as np

from warp_bounding.arithmetic import TINY, UNIT32, gamma
from warp_bounding.bounders.base import Bounder, BoxBounds
from warp_bounding.bounders.members import holding, members_of
from warp_bounding.bounders.neural.mlp import MOST_THRESHOLDS, Mlp
from warp_bounding.bounders.registry import composed
from warp_bounding.errors import BounderError
from warp_bounding.kernels.lattice import PER_WORD, level_text
from warp_bounding.kernels.source import DENIED, Early, Lanes, Source, literal
from warp_bounding.networks.heads import head_of

__all__ = [
    "CERTAIN",
    "EVERYWHERE",
    "NEAREST_TO_ZERO",
    "NOWHERE",
    "Lattice",
    "Local",
    "LocalSource",
    "packed",
    "unpacked",
]

# --- lattice ---------------------------------------------------------------------------------------------------------
#
# The domain of a bounder, cut at edges into a lattice of parts.

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

    def moved(self, to: Callable[[np.ndarray], np.ndarray]) -> "Lattice":
        """The same parts in other coordinates, which each axis has of its own: ``to`` takes ``(N, n)`` and gives ``(N, n)``."""
        moved = []
        for k, axis in enumerate(self.edges):
            at = np.zeros((len(axis), len(self.edges)))
            at[:, k] = axis
            moved.append(to(at)[:, k].astype(np.float32))
        return Lattice(moved)

    @property
    def count(self) -> int:
        """Number of parts."""
        return prod(self.shape)

    def place(self, v: np.ndarray) -> np.ndarray:
        """``(N,)`` int64: index of the part that holds each v ``(N, n)``."""
        along = [np.searchsorted(axis, v[:, k], side="right") for k, axis in enumerate(self.edges)]
        return np.ravel_multi_index(along, self.shape) if along else np.zeros(len(v), np.int64)

    def cut(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Boxes ``(N, n)`` cut at the edges, so that each piece lies in the closure of one part, with its lower corner in it.

        A box that ends on an edge has a piece without width beyond it.

        Returns:
            Corners of the pieces, ``(K, n)`` float64 each, and which box each one is a piece of.
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

    def ranges(self, lower: np.ndarray, upper: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each axis the first and the last part that the box's inside meets, of pieces the one that they lie in."""
        pairs = []
        for k, axis in enumerate(self.edges):
            first = np.searchsorted(axis, lower[:, k], side="right")
            pairs.append((first, np.maximum(first, np.searchsorted(axis, upper[:, k], side="left"))))
        return pairs

    def extremes(
        self, values: np.ndarray, lower: np.ndarray, upper: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Least and largest ``values`` ``(parts,)`` of parts that boxes ``(N, n)`` meet, and which boxes meet one only."""
        ranges, every = self.ranges(lower, upper), values.reshape(self.shape)
        single = np.all([first == last for first, last in ranges], axis=0)
        least = every[tuple(first for first, _ in ranges)]
        most = least.copy()
        for row in np.flatnonzero(~single):
            inside = every[tuple(slice(first[row], last[row] + 1) for first, last in ranges)]
            least[row], most[row] = inside.min(), inside.max()
        return least, most, single

    @classmethod
    def stored(cls, edges: np.ndarray, shape: tuple[int, ...], method: str) -> "Lattice":
        """The lattice of a file: the edges of each axis in turn.

        Raises:
            BounderError: If they do not ascend, or one of them is too near to 0.
        """
        lattice = cls(np.split(edges, np.cumsum([count - 1 for count in shape])[:-1]))
        if not (all((np.diff(axis) > 0).all() for axis in lattice.edges) and (np.abs(edges) >= NEAREST_TO_ZERO).all()):
            raise BounderError(f"{method}: edges must ascend, none of them 0")
        return lattice


def packed(levels: np.ndarray) -> np.ndarray:
    """``(ceil(parts / 4),)`` uint32, words of levels ``(parts,)`` uint8."""
    return np.pad(levels, (0, -len(levels) % PER_WORD)).view("<u4").astype(np.uint32)


def unpacked(words: np.ndarray, count: int) -> np.ndarray:
    """``(count,)`` uint8, the levels in words."""
    return words.astype("<u4").view(np.uint8)[:count]


# --- source ----------------------------------------------------------------------------------------------------------
#
# Native code of local thresholds: where v lies among the edges, the level that stands there, and what is left of f.
#
# The lattice is that of ``kernels.lattice``. A threshold is ``step * (first + level)``, a power of two times a whole number under 2^24: float32
# holds it, however it is computed.

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


LEVELS = EVERYWHERE  # how many levels are thresholds
STEPS = (2.0**-60, 2.0**30)  # between two levels
MOST_NUMBER = 2.0**22  # of the first level: sums with a level stay whole numbers that float32 holds


@composed
class Local(Bounder):
    """A network at thresholds of the parts of its domain.

    Tensors: the network's, each under ``0.`` and its role there; ``edges``, the inner edges of each axis in turn;
    ``levels`` ``(ceil(parts / 4),)`` uint32, a byte for each part, which can be ``NOWHERE`` or ``EVERYWHERE``; ``scale``
    ``(2,)``, the whole number of the first level, and the step, a power of two. Sizes: ``parts``, the network's ``method`` and
    ``sizes``; ``shape``.
    """

    method = "local"
    exact_on_cells = False
    bit_fields = ("levels",)

    @classmethod
    def supports(cls, query: str, ndim: int) -> bool:
        return Mlp.supports(query, ndim) and head_of(query).outputs == 1

    @classmethod
    def of(cls, member: Mlp, lattice: Lattice, thresholds: np.ndarray, step: float) -> "Local":
        """A network at thresholds ``(parts,)``, each rounded down to a level, as far at least as the lowest one.

        So the lowest one loses nothing, once what all are too low by is made the bounder's own threshold.

        Args:
            member: The network; its own threshold is not used.
            lattice: The parts.
            thresholds: In array order of the parts; infinity where no positive lies, minus infinity where no query is
                to be denied.
            step: Between two levels, a power of two. The highest level stands for all thresholds above it.

        Raises:
            BounderError: If the thresholds cannot be told apart by float32 in such steps.
        """
        some = np.isfinite(thresholds)
        least = float(thresholds[some].min()) if some.any() else 0.0
        first = np.floor(least / step)
        levels = np.where(thresholds > 0, NOWHERE, EVERYWHERE).astype(np.uint8)
        levels[some] = np.clip(np.floor((thresholds[some] - least) / step), 0, LEVELS - 1)
        tensors, sizes = holding([member])
        scale = np.array([first, step], np.float32)
        tensors |= {"edges": np.concatenate(lattice.edges), "levels": packed(levels), "scale": scale}
        return cls(member.domain, tensors, sizes | {"shape": list(lattice.shape)}, member._device)

    def check_tensors(self) -> None:
        shape = self.sizes.get("shape")
        whole = isinstance(shape, list) and all(type(count) is int and count >= 1 for count in shape)
        if not whole or len(shape) != self.domain.ndim or prod(shape) > MOST_THRESHOLDS:
            raise BounderError(
                f"{self.method}: expected {self.domain.ndim} counts, at most {MOST_THRESHOLDS} parts, got {shape!r}"
            )
        self.members, shapes = members_of(self, 1, 1, lambda kind: kind is Mlp)
        (self.member,) = self.members
        expected = {"edges": (sum(shape) - len(shape),), "levels": (-(-prod(shape) // PER_WORD),), "scale": (2,)}
        self.expect_shapes(shapes | expected)
        self.lattice = Lattice.stored(self.tensors["edges"], shape, self.method)
        first, step = (float(x) for x in self.tensors["scale"])
        if not (
            STEPS[0] <= step <= STEPS[1]
            and np.frexp(step)[0] == 0.5
            and first == np.floor(first)
            and abs(first) <= MOST_NUMBER
        ):
            raise BounderError(f"{self.method}: expected a whole number and a power of two, got {first} and {step}")
        self.check_range()

    @cached_property
    def thresholds(self) -> np.ndarray:
        """``(parts,)`` float64, exact; infinity where every query is denied, minus infinity where none is."""
        levels = unpacked(self.tensors["levels"], self.lattice.count).astype(np.float64)
        first, step = self.tensors["scale"].astype(np.float64)
        named = {NOWHERE: np.inf, EVERYWHERE: -np.inf}
        return np.select([levels == level for level in named], list(named.values()), (levels + first) * step)

    @property
    def source(self) -> LocalSource:
        return self.source_of(LocalSource, self.member.source, len(self.member.weights()), self.lattice.shape)

    def weights(self) -> np.ndarray:
        return np.concatenate([self.member.weights(), self.tensors["edges"], self.tensors["scale"]])

    def words(self) -> np.ndarray:
        return self.tensors["levels"]

    def cut(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.lattice.cut(lower, upper)

    def reference(self, v: np.ndarray) -> np.ndarray:
        v = np.asarray(v, dtype=np.float64)
        return np.clip(self.member.reference(v) - self.thresholds[self.lattice.place(v)], DENIED, CERTAIN)

    def thresholds_in(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The least and the largest threshold of the parts that boxes ``(N, n)`` meet, and which boxes meet one only."""
        return self.lattice.extremes(self.thresholds, lower, upper)

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """See ``Bounder``. A box inside one part has the part's threshold everywhere, on its upper sides too."""
        bounds = self.member.bound(lower, upper)
        _, most, single = self.thresholds_in(lower, upper)
        # Not cut at DENIED: a part that is denied by its level is, whatever the threshold.
        least = np.minimum(np.nextafter(bounds.lower - most, -np.inf), CERTAIN)
        value = np.where(single, np.clip(bounds.value - most, DENIED, CERTAIN), self.reference(bounds.point))
        # The network's slopes are not those of this f, which is less by the threshold of the part.
        return BoxBounds(least, bounds.axis, bounds.point, value, bounds.next_axis)

    def rounding_bound(self) -> float:
        network, some = self.member.network, self.thresholds[np.isfinite(self.thresholds)]
        error = self.member.rounding_bound()
        size = network.largest + error + np.abs(some).max(initial=0.0)  # of f less a threshold, which rounds once
        return (error + gamma(2) * size + 2 * TINY) * (1 + 4 * UNIT32)
