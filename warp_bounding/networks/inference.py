"""A network's native code of inference, and its numbers in the order in which that code reads them.

In the batch path and on CUDA each lane is a query (``V`` a vector of lanes, or a float), and each weight that is
loaded serves all of them. The function for other kernels evaluates one query on a CPU: there the lanes are neurons,
so that one query is fast by itself. Names in capitals in the C texts are constants of the layer, declared before the
text.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np

from warp_bounding.activations import activation_of
from warp_bounding.kernels.source import Lanes, Source
from warp_bounding.runtime.native import constants, fill, native_text

text = native_text("network.h")

EIGHT = 8  # floats of one AVX vector: activations and an output's weights are padded to a multiple of it
KEPT, MOST = 128, 3  # activations that a thread of CUDA keeps in registers, and queries that it takes, at most
ALIGN = 16  # floats of one AVX-512 vector, a line of cache: where rows of the copy for neurons in lanes begin


@dataclass(frozen=True)
class MlpSource(Source):
    """Native code of a network, for its sizes.

    Numbers: each layer twice, for queries in lanes (``QUERIES_IN_LANES``: blocks of J neurons, input by input) and for
    neurons in lanes (``NEURONS_IN_LANES``: a row of all neurons for each input); then the output's bias and weights.
    """

    hidden: tuple[int, ...]
    activation: str

    packed = True
    # Lanes of a block, two registers: each weight that is loaded serves both.
    width: ClassVar[dict[str, int]] = {"avx512": 32, "other": 16}

    @property
    def several(self) -> int:
        """As many as have room in registers."""
        kept = self.hidden[:-1]
        largest = max([self.coordinates, *kept, *map(sum, pairwise(kept))])
        return max(1, min(MOST, KEPT // largest))

    @property
    def layers(self) -> list[tuple[int, int]]:
        """``(inputs, outputs)`` of each hidden layer."""
        return list(zip((self.coordinates, *self.hidden[:-1]), self.hidden, strict=True))

    @property
    def places(self) -> list[int]:
        """Index in the numbers at which each layer's copies begin, and last where the output does."""
        places = [0]
        for k, h in self.layers:
            places.append(places[-1] + h * (k + 1) + _filling(h, k) + _row(h) * (k + 1))
        return places

    @property
    def neuron_rows(self) -> list[tuple[int, int]]:
        """Where each layer's copy for neurons in lanes begins, and the length of its rows."""
        starts = zip(self.places, self.layers, strict=False)
        return [(place + h * (k + 1) + _filling(h, k), _row(h)) for place, (k, h) in starts]

    # --- a query in each lane ----------------------------------------------------------------------------------------

    def body(self, lanes: Lanes) -> str:
        lines = ["const V none = {0.0f};", self.inputs_text("V")]
        lines += [self.layer(index, lanes) for index in range(len(self.hidden))]
        return "\n".join([*lines, f"f = f + w[{self.places[-1]}];"])

    def inputs_text(self, type_: str) -> str:
        """C statements from ``v`` to the inputs ``h0``, numbers of this type."""
        return f"{type_} h0[{self.coordinates}]; for (int k = 0; k < {self.coordinates}; ++k) h0[k] = v[k];"

    def layer(self, index: int, lanes: Lanes) -> str:
        """C statements of a hidden layer: keep its activations, or of the last one add them up to f."""
        (k, h), at, last = self.layers[index], self.places[index], index == len(self.hidden) - 1
        places = {"OUTPUT_AT": self.places[-1], "KEEP": int(not last)}
        lines = [f"V h{index + 1}[{1 if last else h}];", "f = none;"]
        lines.append(f"{{ const V* x = h{index}; V* y = h{index + 1}; (void)y;")
        unrolled = {"unroll_blocks": "#pragma unroll (KEEP ? BLOCKS : 1)", "unroll_inputs": "#pragma unroll"}
        unrolled = unrolled if lanes.several else dict.fromkeys(unrolled, "")
        queries = fill(text.QUERIES_IN_LANES, act=_act(self.activation, lanes, "s[r]"), **unrolled)
        j = _block(h)
        blocks = [(first, size, size, at + first * (k + 1)) for first, size in ((0, j), (h // j * j, h % j)) if size]
        if lanes.alone:  # all neurons at a time, from the copy that has a row of them for each input
            place, row = self.neuron_rows[index]
            blocks, j = [(0, row, h, place)], row
        for first, size, used, place in blocks:
            own = constants(K=k, J=size, USED=used, FIRST=first, BLOCKS=1 if first else max(1, h // j), AT=place)
            lines += ["{", own, constants(**places), queries, "}"]
        return "\n".join([*lines, "}"])

    # --- one query on a CPU, a neuron in each lane -------------------------------------------------------------------

    def function_body(self) -> str:
        layers = (self.function_layer(index) for index in range(len(self.hidden)))
        return "\n".join([self.inputs_text("float"), *layers, self.function_output()])

    def function_layer(self, index: int) -> str:
        """One hidden layer, a register of neurons at a time."""
        place, row = self.neuron_rows[index]
        inputs, neurons = self.layers[index]
        own = constants(K=inputs, NEURONS=neurons, ROW=row, AT=place)
        names = f"const float* x = h{index}; float* y = h{index + 1};"
        layer = fill(text.NEURONS_IN_LANES, act=_act(self.activation, Lanes(vector=True), "sum"))
        return "\n".join([f"float h{index + 1}[{row}]; {{", own, text.LANES, names, layer, "}"])

    def function_output(self) -> str:
        """``float f``, by the output behind the last layer."""
        own = constants(ROW=padded(self.hidden[-1]), AT=self.places[-1])
        return "\n".join(["float f; {", own, f"const float* x = h{len(self.hidden)};", text.SUM, "}"])


def _act(activation: str, lanes: Lanes, z: str) -> str:
    """C statements that set ``h`` to the activation of ``z``, both of type ``V``."""
    statement = activation_of(activation).statement
    if lanes.several:
        return f"for (int l = 0; l < L; ++l) {{ typedef float V; {statement(lanes, 'h[l]', f'{z}[l]')} }}"
    return statement(lanes, "h", z)


def padded(neurons: int) -> int:
    """The number of a layer's activations, and of an output's weights, padded with zeros."""
    return -(-neurons // EIGHT) * EIGHT


def _row(neurons: int) -> int:
    """Length of a row of the copy for neurons in lanes."""
    return -(-neurons // ALIGN) * ALIGN


def _block(neurons: int) -> int:
    """Neurons that are summed at a time: the largest divisor up to 10 if that is 5 at least, else 8 and a remainder."""
    best = max(d for d in range(1, 11) if neurons % d == 0)
    return best if best >= 5 else min(8, neurons)


def _filling(neurons: int, inputs: int) -> int:
    """The number of floats after a layer's copy for queries in lanes that align the next copy."""
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
    """The output, ``(1, H)`` and ``(1,)``, as ``MlpSource`` reads it: its bias, then the weights, padded."""
    return np.concatenate([bias, weight[0], np.zeros(padded(weight.shape[1]) - weight.shape[1], np.float32)])
