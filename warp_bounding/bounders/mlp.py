"""``mlp``: a multi-layer perceptron (the paper's OurNN), of any widths and activation.

The network's output before the paper's sigmoid is ``f`` (of planes, two outputs make it: ``Head``); the
threshold on it is set by a proof or a search, not at a probability of one half.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import prod
from typing import ClassVar

import numpy as np

from warp_bounding.activations import ACTIVATIONS, DEFAULT, activation_of
from warp_bounding.bounders.bounder import STEPS, Bounder, Option, composed, holding, members_of, one_of, truth, whole
from warp_bounding.certificates import Certificate
from warp_bounding.errors import BounderError
from warp_bounding.kernels.source import DENIED, PER_WORD, Early, Lanes, Source, level_text
from warp_bounding.networks import tensor_cores
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.networks.inference import MlpSource, head_numbers, layer_numbers
from warp_bounding.networks.network import Network, head_of
from warp_bounding.queries import QUERIES
from warp_bounding.queries.domain import Domain
from warp_bounding.queries.point import POINT
from warp_bounding.rounding import TINY, UNIT32, gamma
from warp_bounding.runtime.native import literal

# --- networks --------------------------------------------------------------------------------------------------------

LARGEST_WIDTH = 1024  # neurons of a hidden layer
MOST_LAYERS = 8  # hidden layers
# Neurons of all hidden layers: proofs hold some 64 (2 n + 7) bytes for each on a thread's stack, 2 MB in 4D.
MOST_NEURONS = 2048


def check_hidden(hidden) -> tuple[int, ...]:
    """Hidden widths as a tuple.

    Raises ``BounderError`` for none, too many, or a width that is no whole number in its range.
    """
    if not isinstance(hidden, Iterable) or isinstance(hidden, str | bytes):
        raise BounderError(f"hidden must be the widths of the layers, such as (24, 24), got {hidden!r}")
    widths = tuple(hidden)
    known = all(isinstance(h, (int, np.integer)) and not isinstance(h, bool) for h in widths)
    known = known and all(1 <= h <= LARGEST_WIDTH for h in widths)
    if not 1 <= len(widths) <= MOST_LAYERS or not known or sum(widths) > MOST_NEURONS:
        limits = f"1 to {MOST_LAYERS} widths from 1 to {LARGEST_WIDTH}, {MOST_NEURONS} in all"
        got = repr(hidden) if len(widths) <= MOST_LAYERS else f"{len(widths)} of them"
        raise BounderError(f"hidden must be {limits}, such as (50, 50), got {got}")
    return tuple(int(h) for h in widths)


def _widths(text: str) -> tuple[int, ...]:
    """Hidden widths as the command line writes them, such as 50,50."""
    try:
        return tuple(int(width) for width in text.split(","))
    except ValueError:
        raise BounderError(f"hidden must be widths such as 50,50, got {text!r}") from None


_HELP = f"of the hidden layers: {', '.join(ACTIVATIONS)}"
MOST_PARTS = 65_536  # parts of a domain that have one each (``bounders.mlp``)

HIDDEN = Option("hidden", (50, 50), "widths of the hidden layers", check_hidden, _widths)
ACTIVATION = Option("activation", DEFAULT.name, _HELP, one_of("activation", ACTIVATIONS))
PARTS = Option(
    "parts",
    1,
    "parts of the domain, each with a threshold of its own",
    whole("parts", 1, MOST_PARTS),
    int,
    ("point",),
)
STATISTICAL = Option(
    "statistical",
    False,
    "take a threshold that samples attest, where a proof in many dimensions leaves nothing",
    truth("statistical"),
    bool,
    queries=("point",),
)


class Mlp(tensor_cores.TensorCores, Bounder):
    """A network; *maybe* where its output reaches the threshold.

    Tensors: ``layers.i.weight`` ``(H, K)``, ``layers.i.bias`` ``(H,)``, the last layer with H = 1, or 2 for planes.
    Sizes: ``hidden``, ``activation``; older files also hold ``octaves`` and ``moments``, 0 and false.
    """

    method = "mlp"
    exact_on_cells = False
    options = (HIDDEN, ACTIVATION, PARTS, STATISTICAL, STEPS)
    source_kind: ClassVar[type[MlpSource]] = MlpSource

    @classmethod
    def supports(cls, query: str, ndim: int) -> bool:
        return not QUERIES[query].is_region or ndim >= 2

    @classmethod
    def takes_shapes(cls, query: str) -> bool:
        return True

    def check_tensors(self) -> None:
        self.hidden = check_hidden(self.sizes.get("hidden", ()))
        self.activation = activation_of(self.sizes.get("activation")).name
        for name in ("octaves", "moments"):
            if self.sizes.get(name, 0) != 0:
                raise BounderError(f"networks with {name}={self.sizes[name]!r} are no longer read; fit wider layers")
        self.head = head_of(self.query_kind)
        self.expect_shapes(self._shapes())
        limit = self.domain.limit[: self.source.inputs].astype(np.float64)
        self.networks = [Network(self._layers(o), self.activation, limit) for o in range(self.head.outputs)]

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the tensors."""
        shapes, sizes = {}, (self.source.inputs, *self.hidden, self.head.outputs)
        for i, (k, h) in enumerate(pairwise(sizes)):
            shapes |= {f"layers.{i}.weight": (h, k), f"layers.{i}.bias": (h,)}
        return shapes

    def _layers(self, output: int = 0) -> list[tuple[np.ndarray, np.ndarray]]:
        names = [f"layers.{i}" for i in range(len(self.hidden) + 1)]
        *layers, (weight, bias) = [(self.tensors[f"{name}.weight"], self.tensors[f"{name}.bias"]) for name in names]
        return [*layers, (weight[output : output + 1], bias[output : output + 1])]

    def rebased(self, domain: Domain) -> "Mlp":
        """The same network of points for another domain: its first layer takes the map between both, in float32.

        It is not proven: its threshold is this one's, and it has no certificate. Raises ``BounderError`` for networks
        of regions.
        """
        if not self.domain.tested_as_point:
            raise BounderError(f"{self.method}: only a network of points can be asked in another domain")
        own, scale = self.domain, self.domain.scale.astype(np.float64)
        weight, bias = (self.tensors[f"layers.0.{name}"].astype(np.float64) for name in ("weight", "bias"))
        shift = (domain.center.astype(np.float64) - own.center) * scale
        first = {
            "layers.0.weight": weight * (scale / domain.scale.astype(np.float64)),
            "layers.0.bias": bias + weight @ shift,
        }
        tensors = self.tensors | {name: value.astype(np.float32) for name, value in first.items()}
        return type(self)(domain, tensors, self.sizes, self._device).freeze(float(self.threshold), None)

    @property
    def network(self) -> Network:
        """The network of the first output."""
        return self.networks[0]

    @property
    def source(self) -> MlpSource:
        return self.source_of(self.source_kind, self.hidden, self.activation)

    def weights(self) -> np.ndarray:
        parts = [layer_numbers(weight, bias) for weight, bias in self._layers()[:-1]]
        last = f"layers.{len(self.hidden)}"
        return np.concatenate([*parts, head_numbers(self.tensors[f"{last}.weight"], self.tensors[f"{last}.bias"])])

    def reference(self, v: np.ndarray) -> np.ndarray:
        return self.head.value(self.networks, np.asarray(v, dtype=np.float64))

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        if self.head.outputs > 1:
            raise BounderError(f"{self.method}: boxes of {self.query_kind} coordinates are not bounded one by one")
        return self.network.bound(lower, upper)

    def rounding_bound(self) -> float:
        return self.head.rounding(self.networks, self.domain.limit)


# --- thresholds by parts ---------------------------------------------------------------------------------------------
#
# ``local``: a network with a threshold of its own in each part of the domain, so that its worst place sets one price.
#
# The coordinates v are cut along each axis at *edges*, into a lattice of parts. Each part has a *level*, one byte: the
# threshold that f must reach there; or that no positive lies in the part at all, or hardly anything else, and the
# network is not even evaluated. f less the threshold of v's part is the f of this class; it jumps at the edges, and so
# proofs cut their boxes there (``cut``).

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
        """The same parts in other coordinates, each axis by itself: ``to`` maps ``(N, n)`` to ``(N, n)``."""
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
        """Least and largest ``values`` ``(parts,)`` of parts that boxes ``(N, n)`` meet; and which meet only one."""
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

        Raises ``BounderError`` if they do not ascend, or one of them is too near to 0.
        """
        lattice = cls(np.split(edges, np.cumsum([count - 1 for count in shape])[:-1]))
        if not (all((np.diff(axis) > 0).all() for axis in lattice.edges) and (np.abs(edges) >= NEAREST_TO_ZERO).all()):
            raise BounderError(f"{method}: edges must ascend, none of them 0")
        return lattice


def checked_parts(bounder: Bounder) -> list[int]:
    """How many parts there are along each axis, as the sizes say; raises ``BounderError`` for what cannot be."""
    shape, ndim = bounder.sizes.get("shape"), bounder.domain.ndim
    whole = isinstance(shape, list) and all(type(count) is int and count >= 1 for count in shape)
    if not whole or len(shape) != ndim or prod(shape) > MOST_PARTS:
        raise BounderError(f"{bounder.method}: expected {ndim} counts, at most {MOST_PARTS} parts, got {shape!r}")
    return shape


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
# The lattice is that of ``kernels.source.level_text``. A threshold is ``step * (first + level)``, a power of two times
# a whole number under 2^24: float32 holds it, however it is computed.

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
        return (
            f"{{ {self._level(vector=False)} {self._given('f')} else {{ {self.member.body(lanes)} f -= "
            f"{self._rest()}; }} }}"
        )

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
STEP_RANGE = (2.0**-60, 2.0**30)  # between two levels
MOST_NUMBER = 2.0**22  # of the first level: sums with a level stay whole numbers that float32 holds


@composed
class Local(Bounder):
    """A network at thresholds of the parts of its domain.

    Tensors: the network's, each under ``0.`` and its role there; ``edges``, the inner edges of each axis in turn;
    ``levels`` ``(ceil(parts / 4),)`` uint32, a byte for each part, which can be ``NOWHERE`` or ``EVERYWHERE``;
    ``scale`` ``(2,)``, the whole number of the first level, and the step, a power of two. Sizes: ``parts``, the
    network's ``method`` and ``sizes``; ``shape``.
    """

    method = "local"
    exact_on_cells = False
    bit_fields = ("levels",)

    @classmethod
    def supports(cls, query: str, ndim: int) -> bool:
        return query == POINT.name

    @classmethod
    def of(cls, member: Mlp, lattice: Lattice, thresholds: np.ndarray, step: float) -> "Local":
        """A network at thresholds ``(parts,)``, each rounded down to a level, as far at least as the lowest one.

        So the lowest one loses nothing, once what all are too low by is made the bounder's own threshold. Infinity
        stands where no positive lies, minus infinity where no query is to be denied; ``step``, a power of two, lies
        between two levels, of which the highest stands for all thresholds above it. Raises ``BounderError`` if float32
        cannot distinguish them.
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
        shape = checked_parts(self)
        self.members, shapes = members_of(self, 1, 1, lambda kind: kind is Mlp)
        (self.member,) = self.members
        expected = {"edges": (sum(shape) - len(shape),), "levels": (-(-prod(shape) // PER_WORD),), "scale": (2,)}
        self.expect_shapes(shapes | expected)
        self.lattice = Lattice.stored(self.tensors["edges"], shape, self.method)
        first, step = (float(x) for x in self.tensors["scale"])
        if not (
            STEP_RANGE[0] <= step <= STEP_RANGE[1]
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
        """Least and largest threshold of the parts that boxes ``(N, n)`` meet, and which boxes meet only one."""
        return self.lattice.extremes(self.thresholds, lower, upper)

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """See ``Bounder``. A box inside one part has the part's threshold everywhere, on its upper sides too."""
        bounds = self.member.bound(lower, upper)
        _, most, single = self.thresholds_in(lower, upper)
        # Not cut at DENIED: a part that is denied by its level is, whatever the threshold.
        least = np.minimum(np.nextafter(bounds.lower - most, -np.inf), CERTAIN)
        value = np.where(single, np.clip(bounds.value - most, DENIED, CERTAIN), self.reference(bounds.point))
        # A linear bound of the network is one of f, less the threshold, where that is one number and no value is cut.
        with np.errstate(over="ignore", invalid="ignore"):
            level = np.nextafter(bounds.level - most, -np.inf)
            reach = np.abs(level) + (np.abs(bounds.slope) * (upper - lower)).sum(axis=1)
        linear = single & (reach < CERTAIN)
        slope, level = np.where(linear[:, None], bounds.slope, 0.0), np.where(linear, level, least)
        return BoxBounds(least, bounds.axis, bounds.point, value, bounds.next_axis, slope, level)

    def rounding_bound(self) -> float:
        network, some = self.member.network, self.thresholds[np.isfinite(self.thresholds)]
        error = self.member.rounding_bound()
        size = network.largest + error + np.abs(some).max(initial=0.0)  # of f less a threshold, which rounds once
        return (error + gamma(2) * size + 2 * TINY) * (1 + 4 * UNIT32)


# --- occupancy networks ----------------------------------------------------------------------------------------------
#
# ``occupancy``, not conservative: the network of ``mlp``, trained with a symmetric loss (the paper's OccNet).
#
# It answers *maybe* where the probability that the query meets the object is at least one half (``f >= 0``), as
# occupancy networks do (Mescheder et al. 2019). It errs both ways alike: some queries that do meet the object are
# denied. It shows what the asymmetric loss and the proof are for, and is of no use as a broad phase; it can never hold
# a certificate.


class Occupancy(Mlp):
    """A network with false negatives: *maybe* where *yes* seems at least as likely as *no*. Tensors: ``Mlp``'s."""

    method = "occupancy"
    conservative = False
    options = (HIDDEN, ACTIVATION, STEPS)

    def freeze(self, threshold: float, certificate: Certificate | None) -> "Occupancy":
        """Set the threshold; raises ``BounderError`` for a certificate, which this bounder cannot hold."""
        if certificate is not None:
            raise BounderError("occupancy: is not conservative and cannot hold a certificate")
        return super().freeze(threshold, None)

    def __repr__(self) -> str:
        return f"{super().__repr__()[:-1]}, not conservative>"
