"""A network's native code of inference, and its numbers in the order in which that reads them.

In the batch path and on CUDA each lane is a query (``V`` a vector of lanes, or a float), and each weight that is
loaded serves all of them. The function for other kernels asks one query on a CPU: there the lanes are neurons,
so that one query is fast by itself. Every text below is C as it stands; what it calls by capitals are constants of
the layer, written in front of it.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from warp_bounding.activations import SINE, activation_of, constants
from warp_bounding.kernels.source import Lanes, Source
from warp_bounding.networks.network import Head, head_of

__all__ = ["MlpSource", "head_numbers", "layer_numbers", "padded"]

EIGHT = 8  # floats of one AVX vector: activations and an output's weights are padded to a multiple of it
ALIGN = 16  # floats of one AVX-512 vector, a line of cache: where rows of the copy for neurons in lanes begin

# In all texts w are the method's numbers, f and other the first and the second output (``Head.outputs``), and T is V or
# float.
# From the coordinates v to the inputs h0: themselves, and the FEATURES sines of the positional encoding; its biases
# stand first, then N weights of each feature.
_ENCODE = """
for (int k = 0; k < N; ++k) h0[k] = v[k];
for (int j = 0; j < FEATURES; ++j) {
    const float* c = w + FEATURES + j * N;
    T z = v[0] * c[0];
    for (int k = 1; k < N; ++k) z += v[k] * c[k];
    h0[N + j] = sine(z + w[j]);
}
"""

# BLOCKS blocks of J neurons, from the inputs x on: J biases, then J weights of each of K inputs stand together, so that
# each input that is loaded serves J sums. KEEP their activations in y, and add them up to the OUTPUTS that stand at
# OUTPUT_AT and at SECOND_AT, and to those that stand at SURE_AT and at SURER_AT.
_QUERIES_IN_LANES = """
for (int b = 0; b < BLOCKS; ++b) {
    const float* p = w + AT + b * J * (K + 1);
    V s[J];
#pragma unroll
    for (int r = 0; r < J; ++r) s[r] = x[0] * p[J + r] + p[r];
    for (int k = 1; k < K; ++k) {
        const V input = x[k]; const float* c = p + J + k * J;
#pragma unroll
        for (int r = 0; r < J; ++r) s[r] += input * c[r];
    }
#pragma unroll
    for (int r = 0; r < J; ++r) {
        const int j = FIRST + b * J + r;
        const V h = act(s[r]);
        if (KEEP) y[j] = h;
        if (OUTPUTS > 0) f += h * w[OUTPUT_AT + 1 + j];
        if (OUTPUTS > 1) other += h * w[SECOND_AT + 1 + j];
        if (SURES > 0) sure += h * w[SURE_AT + 1 + j];
        if (SURES > 1) surer += h * w[SURER_AT + 1 + j];
    }
}
"""

# Lanes of neurons: as many as a register has. Behind the last of NEURONS a row has zeros, so that no register is loaded from two lines of cache.
_LANES = """
#if defined(__AVX512F__)
constexpr int L = 16;
#else
constexpr int L = 8;
#endif
constexpr int REGISTERS = (NEURONS + L - 1) / L;
typedef float V __attribute__((vector_size(4 * L), aligned(4), may_alias));
typedef int I __attribute__((vector_size(4 * L)));
"""

# One layer of one query: from K inputs x to NEURONS y; a row of biases, then one of weights an input, ROW floats each.
# Every WAYS-th input is summed apart, so that there are sums enough that need not wait for each other.
_NEURONS_IN_LANES = """
constexpr int WAYS = REGISTERS > 3 ? 2 : 4;
V a[WAYS][REGISTERS];
const float* p = w + AT;
#pragma unroll
for (int q = 0; q < REGISTERS; ++q) {
    a[0][q] = *(const V*)(p + q * L);
    for (int r = 1; r < WAYS; ++r) a[r][q] = a[0][q] * 0.0f;
}
p += ROW;
#pragma unroll
for (int k = 0; k < K / WAYS * WAYS; k += WAYS)
    for (int r = 0; r < WAYS; ++r) {
        const float input = x[k + r]; const float* c = p + ROW * (k + r);
        for (int q = 0; q < REGISTERS; ++q) a[r][q] += *(const V*)(c + q * L) * input;
    }
#pragma unroll
for (int k = K / WAYS * WAYS; k < K; ++k) {
    const float input = x[k]; const float* c = p + ROW * k;
    for (int q = 0; q < REGISTERS; ++q) a[k % WAYS][q] += *(const V*)(c + q * L) * input;
}
#pragma unroll
for (int q = 0; q < REGISTERS; ++q) {
    V sum = a[0][q] + a[1][q];
    if (WAYS > 2) sum += a[2 % WAYS][q] + a[3 % WAYS][q];
    *(V*)(y + q * L) = act(sum);
}
"""

# One output of one query, from ROW activations x; those behind the last neuron are 0, and so are their weights. The lanes are eight here, and
# added by halves; the rounding bound holds for every order.
_SUM = """
typedef float V __attribute__((vector_size(32), aligned(4), may_alias));
V sum = *(const V*)x * *(const V*)(w + AT + 1);
for (int q = 1; q < ROW / 8; ++q) sum += *(const V*)(x + q * 8) * *(const V*)(w + AT + 1 + q * 8);
OUTPUT = ((sum[0] + sum[4]) + (sum[2] + sum[6])) + ((sum[1] + sum[5]) + (sum[3] + sum[7])) + w[AT];
"""


@dataclass(frozen=True)
class MlpSource(Source):
    """Native code of a network, for its sizes.

    Numbers: the encoding's biases and weights, then per layer the copy for queries in lanes (``_QUERIES_IN_LANES``:
    blocks of J neurons, input by input) and the one for neurons in lanes (``_NEURONS_IN_LANES``: a row of all neurons
    for each input), and for each output its bias and its weights.
    """

    hidden: tuple[int, ...]
    activation: str
    features: int = 0  # sine features of the positional encoding

    packed = True
    exits: ClassVar[tuple[int, ...]] = ()
    # Lanes of a block, two registers: each weight that is loaded serves both.
    width: ClassVar[dict[str, int]] = {"avx512": 32, "other": 16}

    @property
    def head(self) -> Head:
        """How the outputs become f."""
        return head_of(self.query)

    @property
    def raw(self) -> int:
        """Coordinates of v that the network takes: all but a plane's offset, with which its outputs are compared."""
        return self.coordinates - self.head.offsets

    @property
    def inputs(self) -> int:
        """Numbers that enter the first layer: these coordinates, and the sine features of them."""
        return self.raw + self.features

    @property
    def layers(self) -> list[tuple[int, int]]:
        """``(inputs, outputs)`` of each hidden layer."""
        return list(zip((self.inputs, *self.hidden[:-1]), self.hidden, strict=True))

    @property
    def places(self) -> list[int]:
        """Index in the numbers at which each layer's copies begin, and last that of the output."""
        places = [self.features * (self.raw + 1)]
        for k, h in self.layers:
            places.append(places[-1] + h * (k + 1) + _filling(h, k) + _row(h) * (k + 1))
        return places

    @property
    def neuron_rows(self) -> list[tuple[int, int]]:
        """Where each layer's copy for neurons in lanes begins, and the length of its rows."""
        starts = zip(self.places, self.layers, strict=False)
        return [(place + h * (k + 1) + _filling(h, k), _row(h)) for place, (k, h) in starts]

    def head_size(self, index: int) -> int:
        """Numbers of the outputs behind hidden layer ``index``."""
        return self.head.outputs * (1 + padded(self.hidden[index]))

    # --- a query in each lane ----------------------------------------------------------------------------------------

    def body(self, lanes: Lanes) -> str:
        return self.chain(lanes, len(self.hidden), self.places[-1])

    def chain(self, lanes: Lanes, depth: int, output_at: int, sure_at: int | None = None) -> str:
        """C statements from ``v`` to ``f``: the first ``depth`` hidden layers, and the output at ``w[output_at]``.

        Where another output stands at ``w[sure_at]``, they compute ``sure`` by it as well.
        """
        last = depth - 1
        layers = [self.layer(index, None, keep=True) for index in range(last)]
        layers.append(self.layer(last, output_at, keep=False, sure_at=sure_at))
        return "\n".join([self.encode(lanes), *layers])

    def encode(self, lanes: Lanes) -> str:
        """C statements from ``v`` to the inputs ``h0``, and the activation that the layers behind call."""
        act = _function("act", activation_of(self.activation), lanes)
        return "\n".join([act, "const V none = {}; V other = none, sure, surer;", self._inputs(lanes, "V")])

    def layer(self, index: int, output_at: int | None, *, keep: bool, sure_at: int | None = None) -> str:
        """C statements of a hidden layer: ``keep`` its activations, add them up to ``f`` by an output, or both.

        Where an output stands at ``sure_at``, they add them up to ``sure`` as well.
        """
        (k, h), at, row = self.layers[index], self.places[index], 1 + padded(self.layers[index][1])
        heads = {"OUTPUT": output_at, "SURE": sure_at}
        counts = {f"{name}S": self.head.outputs if place is not None else 0 for name, place in heads.items()}
        places = {"OUTPUT_AT": output_at or 0, "SECOND_AT": (output_at or 0) + row}
        places |= {"SURE_AT": sure_at or 0, "SURER_AT": (sure_at or 0) + row}
        lines = [f"V h{index + 1}[{h if keep else 1}];", "f = other = sure = surer = none;"]
        lines.append(f"{{ const V* x = h{index}; V* y = h{index + 1}; (void)y;")
        j = _block(h)
        for first, size, blocks in ((0, j, h // j), (h // j * j, h % j, 1)):
            if size:
                place = at + first * (k + 1)
                own = constants(K=k, J=size, FIRST=first, BLOCKS=blocks, AT=place, KEEP=int(keep))
                lines += [
                    "{",
                    own,
                    constants(**counts, **places),
                    _QUERIES_IN_LANES,
                    "}",
                ]
        lines.append("}")
        for place, names in ((output_at, ("f", "other")), (sure_at, ("sure", "surer"))):
            if place is not None:
                both = zip(names, (place, place + row), strict=True)
                biases = [f"{name} = {name} + w[{at}];" for name, at in both][: self.head.outputs]
                lines += [*biases, self._finish(*names)]
        return "\n".join(lines)

    # --- one query on a CPU, a neuron in each lane -------------------------------------------------------------------

    def function_body(self) -> str:
        last = len(self.hidden) - 1
        layers = (self.function_layer(index) for index in range(last + 1))
        return "\n".join([self.function_encode(), *layers, self.function_output(last, self.places[-1])])

    def function_encode(self) -> str:
        """C statements from ``v`` to the inputs ``float h0[]``."""
        return self._inputs(Lanes(vector=False), "float")

    def function_layer(self, index: int) -> str:
        """One hidden layer, a register of neurons at a time."""
        place, row = self.neuron_rows[index]
        inputs, neurons = self.layers[index]
        own = constants(K=inputs, NEURONS=neurons, ROW=row, AT=place)
        names = f"const float* x = h{index}; float* y = h{index + 1};"
        act = _function("act", activation_of(self.activation), Lanes(vector=True))
        return "\n".join([f"float h{index + 1}[{row}]; {{", own, _LANES, act, names, _NEURONS_IN_LANES, "}"])

    def function_output(self, index: int, output_at: int) -> str:
        """``float f``, the output behind hidden layer ``index`` that stands at ``w[output_at]``; in a block of its own."""
        row, lines = padded(self.hidden[index]), ["float f, other = 0.0f; (void)other;"]
        for output, name in zip(range(self.head.outputs), ("f", "other"), strict=False):
            own = constants(ROW=row, AT=output_at + output * (1 + row))
            names = f"const float* x = h{index + 1}; float& OUTPUT = {name};"
            lines += ["{", own, names, _SUM, "}"]
        return "\n".join([*lines, self._finish()])

    def _inputs(self, lanes: Lanes, type_: str) -> str:
        sizes = constants(N=self.raw, FEATURES=self.features)
        sine = _function("sine", SINE, lanes, type_) if self.features else f"auto sine = []({type_} z) {{ return z; }};"
        return "\n".join([f"{type_} h0[{self.inputs}]; {{ typedef {type_} T;", sizes, sine, _ENCODE, "}"])

    def _finish(self, first: str = "f", second: str = "other") -> str:
        """C statements that make of two outputs, under these names, the first."""
        if not self.head.finish:
            return ""
        names = "" if first == "f" else f"V& f = {first}; V& other = {second};"
        return f"{{ {constants(OFFSET=self.coordinates - 1)} {names} {self.head.finish} }}"


def _function(name: str, activation, lanes: Lanes, type_: str = "V") -> str:
    """A C lambda of an activation."""
    own = "" if type_ == "V" else f"typedef {type_} V;"
    return f"auto {name} = [&]({type_} z) {{ {own} V h; {activation.statement(lanes, 'h', 'z')} return h; }};"


def padded(neurons: int) -> int:
    """Activations behind a layer, and an output's weights of them, with the zeros behind the last."""
    return -(-neurons // EIGHT) * EIGHT


def _row(neurons: int) -> int:
    """Length of a row of the copy for neurons in lanes."""
    return -(-neurons // ALIGN) * ALIGN


def _block(neurons: int) -> int:
    """Neurons that are summed at a time: the largest divisor up to 10 if that is 5 at least, else 8 and a remainder."""
    best = max(d for d in range(1, 11) if neurons % d == 0)
    return best if best >= 5 else min(8, neurons)


def _filling(neurons: int, inputs: int) -> int:
    """Floats behind a layer's copy for queries in lanes that align what follows."""
    return -(neurons * (inputs + 1)) % ALIGN


def layer_numbers(weight: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """A hidden layer, ``(H, K)`` and ``(H,)`` float32, as ``MlpSource`` reads it: both copies, one behind the other."""
    (h, k), parts = weight.shape, []
    for first in range(0, h, _block(h)):
        rows = slice(first, first + _block(h))
        parts += [bias[rows], weight[rows].T.reshape(-1)]
    rows = np.zeros((k + 1, _row(h)), np.float32)
    rows[0, :h], rows[1:, :h] = bias, weight.T
    return np.concatenate([*parts, np.zeros(_filling(h, k), np.float32), rows.reshape(-1)])


def head_numbers(weight: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """Outputs as ``MlpSource`` reads them: per row of ``weight`` its bias and the weights, padded."""
    rows = np.zeros((len(bias), 1 + padded(weight.shape[1])), np.float32)
    rows[:, 0], rows[:, 1 : 1 + weight.shape[1]] = bias, weight
    return rows.reshape(-1)
