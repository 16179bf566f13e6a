"""``mlp``: a multi-layer perceptron (the paper's OurNN): sine, ReLU or tanh hidden layers, any widths, optional encoding.

Points, rays and boxes: the network's output before the paper's sigmoid is ``f``; the threshold on it is set by a proof
or a search, not at a probability of one half.

Planes ``m . y = c``: a connected object meets all planes of normal m whose c lies between two supports of its hull, so
the network has two outputs of m alone, ``H`` and ``G``, and ``f = min(H(m) - c, G(m) + c)``: a learned support function.

On a CPU the batch path puts a query in each SIMD lane, the function for other kernels puts a neuron there.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import warp as wp

from warp_bounding.activations import ACTIVATIONS, DEFAULT, SINE, activation_of
from warp_bounding.arithmetic import TINY, gamma
from warp_bounding.bounders.base import Bounder, BoxBounds
from warp_bounding.bounders.options import STEPS, Option, one_of
from warp_bounding.errors import BounderError
from warp_bounding.kernels.source import Lanes, Source
from warp_bounding.networks.network import Network
from warp_bounding.networks.plain import plain_network

__all__ = [
    "ACTIVATION",
    "HIDDEN",
    "OCTAVES",
    "RECIPE",
    "RECIPES",
    "Mlp",
    "MlpSource",
    "check_hidden",
    "check_octaves",
    "encoding_tensors",
    "head_numbers",
    "padded",
]

LARGEST_WIDTH = 1024
MOST_LAYERS = 8  # hidden
MOST_NEURONS = 2048  # in all: proofs hold some 64 (2 n + 7) bytes for each on a thread's stack, 2 MB in 4D
MOST_OCTAVES = 10
RECIPES = ("default", "paper")  # of training
ALIGN = 8  # floats, one vector: rows of the neuron-major copy are padded to it


@dataclass(frozen=True)
class MlpSource(Source):
    """Native code of a network, for its sizes.

    Numbers: per layer the query-major copy (blocks of ``J`` neurons: J biases, then K rows of J weights), then the neuron-major
    one (bias row, then K rows, padded to ``ALIGN``), and the encoding's ``F`` biases and ``F x n`` weights before all.
    """

    hidden: tuple[int, ...]
    activation: str
    features: int = 0  # sine features of the positional encoding

    packed = True
    exits: ClassVar[tuple[int, ...]] = ()
    width: ClassVar[dict[str, int]] = {
        "avx512": 32,
        "other": 16,
    }  # two registers a block: each weight that is loaded serves both

    @property
    def raw(self) -> int:
        """Coordinates that enter the first layer: all, or a plane's normal."""
        return self.ndim if self.supports else self.coordinates

    @property
    def supports(self) -> bool:
        """Whether there are two outputs, a plane's supports."""
        return self.query == "plane"

    @property
    def inputs(self) -> int:
        """Numbers that enter the first layer."""
        return self.raw + self.features

    @property
    def layers(self) -> list[tuple[int, int]]:
        """``(inputs, outputs)`` of each hidden layer."""
        return list(zip((self.inputs, *self.hidden[:-1]), self.hidden, strict=True))

    def activate(self, lanes: Lanes, target: str, z: str) -> str:
        """C statement ``target = act(z)``."""
        return activation_of(self.activation).statement(lanes, target, z)

    def encode(self, lanes: Lanes) -> list[str]:
        """C statements from ``v`` to the inputs ``h0``."""
        n, count = self.raw, self.features
        lines = [f"V h0[{self.inputs}]; for (int k = 0; k < {n}; ++k) h0[k] = v[k];"]
        if count:
            terms = " + ".join(f"v[{k}] * w[{count} + j * {n} + {k}]" for k in range(n))
            lines += [
                f"for (int j = 0; j < {count}; ++j) {{ V z = {terms} + w[j]; V s;",
                SINE.statement(lanes, "s", "z"),
                f"h0[{n} + j] = s; }}",
            ]
        return lines

    @property
    def places(self) -> list[int]:
        """Where in the numbers each layer's copies begin, and at last where the output stands."""
        places = [self.features * (self.raw + 1)]
        for k, h in self.layers:
            places.append(places[-1] + h * (k + 1) + query_padding(h, k) + neuron_size(h, k))
        return places

    @property
    def neuron_rows(self) -> list[tuple[int, int]]:
        """Where each layer's neuron-major copy begins, and the length of its rows."""
        starts = zip(self.places, self.layers, strict=False)
        return [(place + h * (k + 1) + query_padding(h, k), padded(h)) for place, (k, h) in starts]

    def plain(self) -> wp.Function:
        """See ``Source.plain``."""
        return plain_network(self)

    def body(self, lanes: Lanes) -> str:
        """See ``Source.body``; one query per lane."""
        return "\n".join(self.chain(lanes, len(self.hidden), self.places[-1]))

    def chain(self, lanes: Lanes, depth: int, head: int) -> list[str]:
        """C statements from ``v`` to ``f``: the first ``depth`` hidden layers, and the output that stands at ``head``."""
        lines = self.encode(lanes)
        for index in range(depth):
            lines += self.layer(lanes, index, head if index == depth - 1 else None, keep=index < depth - 1)
        return lines

    def layer(self, lanes: Lanes, index: int, head: int | None, *, keep: bool) -> list[str]:
        """One hidden layer: ``keep`` its activations, add them up to ``f`` by the output that stands at ``head``, or both."""
        (k, h), at, lines = self.layers[index], self.places[index], []
        if head is not None:
            start = "V zero_ = {}; f = zero_; V other = zero_;" if lanes.vector else "f = 0.0f; V other = 0.0f;"
            lines.append(f"{start} (void)other;")
        if keep:
            lines.append(f"V h{index + 1}[{h}];")
        j = block_size(h)
        for first, size, blocks in ((0, j, h // j), (h // j * j, h % j, 1)):
            if size:
                lines += self._block(lanes, index, first, size, blocks, at + first * (k + 1), head, keep)
        if head is not None:
            lines.append(f"f = f + w[{head}];")
            if self.supports:
                second = self.second(head, index)
                lines.append(
                    f"f = f - v[{self.ndim}]; other = other + w[{second}] + v[{self.ndim}]; f = other < f ? other : f;"
                )
        return lines

    def second(self, at: int, index: int = -1) -> int:
        """Where the second output behind hidden layer ``index`` stands, given where the first does."""
        return at + 1 + padded(self.hidden[index])

    def _block(
        self, lanes: Lanes, index: int, first: int, size: int, blocks: int, at: int, head: int | None, keep: bool
    ) -> list[str]:
        """A loop over blocks of neurons that share each input as it is loaded."""
        rows, k = range(size), self.layers[index][0]
        lines = [f"for (int b = 0; b < {blocks}; ++b) {{ const float* p = w + {at} + b * {size * (k + 1)};"]
        lines += [f"V s{r} = h{index}[0] * p[{size + r}] + p[{r}];" for r in rows]
        lines += [
            f"for (int k = 1; k < {k}; ++k) {{ const V x = h{index}[k]; const float* c = p + {size} + k * {size};"
        ]
        lines += [f"s{r} += x * c[{r}];" for r in rows] + ["}"]
        for r in rows:
            lines.append(self.activate(lanes, f"s{r}", f"s{r}"))
            neuron = f"{first} + b * {size} + {r}"
            if keep:
                lines.append(f"h{index + 1}[{neuron}] = s{r};")
            if head is not None:
                lines.append(f"f += s{r} * w[{head + 1} + {neuron}];")
                if self.supports:
                    lines.append(f"other += s{r} * w[{self.second(head, index) + 1} + {neuron}];")
        return [*lines, "}"]

    def function_body(self) -> str:
        """See ``Source.function_body``; neurons share the lanes, so that one query is fast by itself."""
        lines = self.function_encode()
        for index in range(len(self.hidden)):
            lines += self.function_layer(index)
        return "\n".join([*lines, *self.function_head(len(self.hidden) - 1, self.places[-1])])

    def function_encode(self) -> list[str]:
        """C statements from ``v`` to the inputs ``float h0[]``, and the vector type of the layers behind."""
        lines = [
            f"constexpr int L = {ALIGN}; typedef float V __attribute__((vector_size(4 * L), aligned(4), may_alias));"
        ]
        lines += ["typedef int I __attribute__((vector_size(4 * L)));"]
        n, count = self.raw, self.features
        lines.append(f"float h0[{self.inputs}]; for (int k = 0; k < {n}; ++k) h0[k] = v[k];")
        if count:
            terms = " + ".join(f"v[{k}] * w[{count} + j * {n} + {k}]" for k in range(n))
            lines += [f"for (int j = 0; j < {count}; ++j) {{ typedef float V; V z = {terms} + w[j]; V s;"]
            lines += [SINE.statement(Lanes(vector=False), "s", "z"), f"h0[{n} + j] = s; }}"]
        return lines

    def function_layer(self, index: int) -> list[str]:
        """One hidden layer, eight neurons at a time."""
        (k, h), lines = self.layers[index], []
        at, row = self.places[index] + h * (k + 1) + query_padding(h, k), padded(h)
        lines.append(f"float h{index + 1}[{row}]; {{ V a[{row} / L], b[{row} / L]; const float* p = w + {at};")
        lines.append(f"for (int q = 0; q < {row} / L; ++q) {{ a[q] = *(const V*)(p + q * L); b[q] = a[q] * 0.0f; }}")
        lines.append(f"int k = 0; for (; k + 1 < {k}; k += 2) {{ const float* c = p + {row} * (k + 1);")
        lines.append(f"const float x = h{index}[k], y = h{index}[k + 1]; for (int q = 0; q < {row} / L; ++q) {{")
        lines.append(f"a[q] += *(const V*)(c + q * L) * x; b[q] += *(const V*)(c + {row} + q * L) * y; }} }}")
        lines.append(
            f"if (k < {k}) for (int q = 0; q < {row} / L; ++q) a[q] += *(const V*)(p + {row} * (k + 1) + q * L) * h{index}[k];"
        )
        vector = Lanes(vector=True)
        lines.append(f"for (int q = 0; q < {row} / L; ++q) {{ V s; {self.activate(vector, 's', 'a[q] + b[q]')}")
        lines.append(f"*(V*)(h{index + 1} + q * L) = s; }} }}")
        return lines

    def function_head(self, index: int, head: int) -> list[str]:
        """``float f``, the output behind hidden layer ``index`` that stands at ``head``."""
        last, row, lines = f"h{index + 1}", padded(self.hidden[index]), []
        # neurons behind the last are 0, and so are their weights
        for name, start in (("f", head), ("other", self.second(head, index)))[: 1 + self.supports]:
            lines.append(f"float {name}; {{ V sum = *(const V*){last} * *(const V*)(w + {start + 1});")
            lines.append(
                f"for (int q = 1; q < {row} / L; ++q) sum += *(const V*)({last} + q * L) * *(const V*)(w + {start + 1} + q * L);"
            )
            lines.append(
                f"{name} = ((sum[0] + sum[4]) + (sum[2] + sum[6])) + ((sum[1] + sum[5]) + (sum[3] + sum[7])) + w[{start}]; }}"
            )
        if self.supports:
            n = self.ndim
            lines.append(f"f = f - v[{n}]; other = other + v[{n}]; f = other < f ? other : f;")
        return lines


def block_size(neurons: int) -> int:
    """Neurons that are summed at a time: the largest divisor up to 10, or 8 and a remainder."""
    best = max(d for d in range(1, 11) if neurons % d == 0)
    return best if best >= 5 else min(8, neurons)


def padded(neurons: int) -> int:
    """Length of a row of the neuron-major copy."""
    return -(-neurons // ALIGN) * ALIGN


def query_padding(neurons: int, inputs: int) -> int:
    """Floats behind a layer's query-major copy that align what follows."""
    return -(neurons * (inputs + 1)) % ALIGN


def neuron_size(neurons: int, inputs: int) -> int:
    """Floats of a layer's neuron-major copy."""
    return padded(neurons) * (inputs + 1)


def head_numbers(weight: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """An output as ``MlpSource`` reads it: per row of ``weight`` its bias and the weights, padded."""
    rows = np.zeros((len(bias), 1 + padded(weight.shape[1])), np.float32)
    rows[:, 0], rows[:, 1 : 1 + weight.shape[1]] = bias, weight
    return rows.reshape(-1)


def encoding_tensors(ndim: int, octaves: int) -> dict[str, np.ndarray]:
    """The positional encoding of the supplement: sine and cosine of ``2^i pi v`` for each coordinate and octave.

    Args:
        ndim: Coordinates n.
        octaves: Octaves; 4 give the supplement's 18 inputs in 2D.

    Returns:
        ``encoding.weight`` ``(2 n octaves, n)`` and ``encoding.bias``: the features are ``sin(weight v + bias)``.
    """
    frequency = np.float32(np.pi) * 2.0 ** np.arange(octaves)
    weight = np.kron(np.kron(frequency[:, None], np.eye(ndim)), np.ones((2, 1)))
    bias = np.tile([0.0, np.pi / 2], ndim * octaves)
    return {"encoding.weight": weight.astype(np.float32), "encoding.bias": bias.astype(np.float32)}


def check_hidden(hidden) -> tuple[int, ...]:
    """Hidden widths as a tuple.

    Raises:
        BounderError: If there is none, too many, or one is not a whole number from 1 to ``LARGEST_WIDTH``.
    """
    try:
        widths = tuple(hidden)
    except TypeError:
        widths = (hidden,)
    whole = all(
        isinstance(h, (int, np.integer)) and not isinstance(h, bool) and 1 <= h <= LARGEST_WIDTH for h in widths
    )
    if not 1 <= len(widths) <= MOST_LAYERS or not whole or sum(widths) > MOST_NEURONS:
        limits = f"1 to {MOST_LAYERS} widths from 1 to {LARGEST_WIDTH}, {MOST_NEURONS} in all"
        got = repr(hidden) if len(widths) <= MOST_LAYERS else f"{len(widths)} of them"
        raise BounderError(f"hidden must be {limits}, such as (50, 50), got {got}")
    return tuple(int(h) for h in widths)


def check_octaves(octaves) -> int:
    """Octaves of positional encoding.

    Raises:
        BounderError: If that is not a whole number from 0 to ``MOST_OCTAVES``.
    """
    if not isinstance(octaves, (int, np.integer)) or isinstance(octaves, bool) or not 0 <= octaves <= MOST_OCTAVES:
        raise BounderError(f"octaves must be a whole number from 0 to {MOST_OCTAVES}, got {octaves}")
    return int(octaves)


def _widths(text: str) -> tuple[int, ...]:
    """Hidden widths as the command line writes them, such as 50,50."""
    try:
        return tuple(int(width) for width in text.split(","))
    except ValueError:
        raise BounderError(f"hidden must be widths such as 50,50, got {text!r}") from None


HIDDEN = Option("hidden", (50, 50), "widths of the hidden layers", check_hidden, _widths)
ACTIVATION = Option(
    "activation", DEFAULT.name, f"of the hidden layers: {', '.join(ACTIVATIONS)}", one_of("activation", ACTIVATIONS)
)
OCTAVES = Option(
    "octaves", 0, "of positional encoding, 0 for none", check_octaves, int, queries=("point", "ray", "box")
)
RECIPE = Option(
    "recipe",
    "default",
    "default, or paper for the paper's schedule",
    one_of("recipe", RECIPES),
    queries=("point", "ray", "box"),
)


class Mlp(Bounder):
    """A network; *maybe* where its output reaches the threshold.

    Tensors: ``layers.i.weight`` ``(H, K)``, ``layers.i.bias`` ``(H,)``, the last layer with H = 1, or 2 for planes;
    ``encoding.weight`` and ``encoding.bias`` where there is an encoding. Sizes: ``hidden``, ``activation``, ``octaves``;
    older files also hold ``moments``, always false.
    """

    method = "mlp"
    closed_form = False
    options = (HIDDEN, ACTIVATION, OCTAVES, RECIPE, STEPS)

    @classmethod
    def supports(cls, query: str, ndim: int, space: str = "geometric") -> bool:
        """See ``Bounder``: everything, from its own coordinates."""
        return space == "geometric" and (query == "point" or ndim >= 2)

    def __init__(self, domain, tensors: dict[str, np.ndarray], sizes: dict, device: str | None = None):
        """See ``Bounder``; raises ``BounderError`` where tensors and sizes do not fit together."""
        super().__init__(domain, tensors, sizes, device)
        self.hidden = check_hidden(self.sizes.get("hidden", ()))
        self.activation = activation_of(self.sizes.get("activation")).name
        octaves = check_octaves(self.sizes.get("octaves", 0))
        if (moments := self.sizes.get("moments", False)) is not False:
            raise BounderError(f"networks that are given a ray's moments are no longer read, got moments={moments!r}")
        raw = domain.space_ndim if domain.query == "plane" else domain.ndim
        self.features = 2 * raw * octaves
        self.outputs = outputs = 2 if domain.query == "plane" else 1
        expected = self._shapes()
        if octaves:
            expected |= {"encoding.weight": (self.features, raw), "encoding.bias": (self.features,)}
        if {k: t.shape for k, t in self.tensors.items()} != expected:
            raise BounderError(
                f"{self.method}: expected tensors {expected}, got { {k: t.shape for k, t in self.tensors.items()} }"
            )
        encoding = (self.tensors["encoding.weight"], self.tensors["encoding.bias"]) if octaves else None
        limit = self.domain.limit[:raw].astype(np.float64)
        self.networks = [Network(self._layers(o), self.activation, encoding, limit) for o in range(outputs)]

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the tensors, but for the encoding."""
        shapes = {}
        for i, (k, h) in enumerate(zip((self.source.inputs, *self.hidden), (*self.hidden, self.outputs), strict=True)):
            shapes |= {f"layers.{i}.weight": (h, k), f"layers.{i}.bias": (h,)}
        return shapes

    def _layers(self, output: int = 0) -> list[tuple[np.ndarray, np.ndarray]]:
        layers = [
            (self.tensors[f"layers.{i}.weight"], self.tensors[f"layers.{i}.bias"]) for i in range(len(self.hidden) + 1)
        ]
        weight, bias = layers[-1]
        return [*layers[:-1], (weight[output : output + 1], bias[output : output + 1])]

    @property
    def network(self) -> Network:
        """The network of the first output."""
        return self.networks[0]

    @property
    def source(self) -> MlpSource:
        """See ``Bounder``."""
        return MlpSource(
            self.ndim,
            self.domain.time,
            self.hidden,
            self.activation,
            self.features,
            query=self.query_kind,
        )

    def weights(self) -> np.ndarray:
        """See ``Bounder``; the layout is described in ``MlpSource``."""
        parts = []
        if self.features:
            parts += [self.tensors["encoding.bias"], self.tensors["encoding.weight"].reshape(-1)]
        for weight, bias in self._layers()[:-1]:
            h, k = weight.shape
            j = block_size(h)
            for first in [*range(0, h // j * j, j), *([h // j * j] if h % j else [])]:
                rows = slice(first, min(first + j, h))
                parts += [bias[rows], weight[rows].T.reshape(-1)]
            parts.append(np.zeros(query_padding(h, k), np.float32))
            rows = np.zeros((k + 1, padded(h)), np.float32)
            rows[0, :h], rows[1:, :h] = bias, weight.T
            parts.append(rows.reshape(-1))
        last = len(self.hidden)
        return np.concatenate(
            [*parts, head_numbers(self.tensors[f"layers.{last}.weight"], self.tensors[f"layers.{last}.bias"])]
        )

    def reference(self, v: np.ndarray) -> np.ndarray:
        """See ``Bounder``."""
        v = np.asarray(v, dtype=np.float64)
        if self.query_kind != "plane":
            return self.network(v)
        values = [network(v[:, : self.ndim]) for network in self.networks]
        return np.minimum(values[0] - v[:, -1], values[1] + v[:, -1])

    @property
    def provable(self) -> bool:
        """See ``Bounder``: every kind of query."""
        return self.conservative

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """See ``Bounder``; linear relaxations (``network``)."""
        if self.query_kind == "plane":
            raise BounderError(f"{self.method}: boxes of {self.query_kind} coordinates are not bounded one by one")
        bounds = self.network.bound(lower, upper)
        return BoxBounds(bounds.lower, bounds.axes[0], bounds.point, bounds.value, bounds.axes[1])

    def rounding_bound(self) -> float:
        """See ``Bounder``."""
        if self.query_kind != "plane":
            return self.network.rounding
        offset = float(self.domain.limit[-1])
        return max(n.rounding + gamma(2) * (n.largest + n.rounding + offset) for n in self.networks) + 2 * TINY
