"""Networks on tensor cores: the batch path of cards on which what the proof needs of the hardware was verified.

A warp takes 32 queries through all layers in registers, as two tiles of 16 (``mma.sync``, float16 factors, float32
sums). Each factor is split into two float16 numbers, high and low, which together hold 22 bits; of the four products
that of both low parts is left out, but in the first layer, where it costs nothing. The accumulators of one layer,
after the sine, are the factors of the next one, in the lanes where they are: lane ``4 g + t`` holds neurons ``8 j + 2
t`` and ``8 j + 2 t + 1`` of queries g and g + 8 of a tile. The sine is the hardware's.

``rounding`` bounds what all this may err by. Where it exceeds the network's ``rounding``, a threshold is lowered by
the difference (``lowered``): a certificate says ``threshold + E <= L`` with the E of its proof, so ``threshold + E -
rounding <= L - rounding``.

*What is taken from the hardware*, and tested on it (``benchmarks/gpu``): (1) ``sin.approx`` is within
``sine_error(z)`` of the sine, for all float32 numbers up to ``LIMIT``, one by one; (2) an ``mma`` of n products errs
by at most ``2^-23`` times the sum that it finds, and ``(n + 1) 2^-24`` times the largest of the products and what
they are added to. That is enough for hardware which cuts each term 24 bits behind the first bit of the largest one,
and then their sum to a float32 number (Fasi, Higham, Mikaitis, Pranesh, *Numerical behavior of NVIDIA tensor cores*,
2021); a card of capability 9.0 keeps one bit more. Products of float16 numbers are exact.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from warp_bounding.activations import SINE
from warp_bounding.rounding import TINY, gamma, round_down
from warp_bounding.runtime.launch import BlockLaunch
from warp_bounding.runtime.native import fill, native_text

PARTS = native_text("tensor_cores.h")

if TYPE_CHECKING:
    from warp_bounding.networks.inference import MlpSource
    from warp_bounding.networks.network import Layer, Network

VERIFIED = (90,)  # compute capabilities, times ten, of which cards passed the tests
WIDEST, DEEPEST = 64, 4  # neurons of a hidden layer, hidden layers: more would not stay in registers
LIMIT = 4096.0  # largest |argument| of the sine
LARGEST_HALF = 2.0**15  # weights, biases and coordinates are under it
BLOCK = 128  # threads of a block, so that more registers a thread leave room for as many of them
MOST_THREADS = 2**20  # they take turns: enough to fill a card a few times over
HEADER = 8  # numbers in front of the words: the threshold, the output's bias

HALF, LEAST_HALF = 2.0**-11, 2.0**-25  # largest relative error of float16, and absolute one of what is subnormal there
CUT = 2.0**-23
SINE_LEAST, SINE_SLOPE = 2.0**-21, 3 * 2.0**-24  # of the error of the sine, and of its growth with the argument

TOOLS = PARTS.TOOLS


def fits(source: "MlpSource") -> bool:
    """Whether a network's sizes are ones that the text is for: sines of moderate widths, one output."""
    widths = source.hidden
    small = len(widths) <= DEEPEST and max(widths) <= WIDEST and source.coordinates < 12
    return small and source.activation == SINE.name


class TensorCores:
    """What a bounder with a network adds; batches run on tensor cores where ``tensor_numbers`` is not ``None``."""

    _held: tuple[object, wp.array | None] | None = None

    @property
    def tensor_text(self) -> str:
        """``text`` of the bounder's f."""
        return text(self.source)

    def _launch_of(
        self, kernel_of: Callable[..., wp.Kernel], count: int, inputs: list, outputs: list, *, exact=False, **more
    ) -> BlockLaunch:
        numbers = None if exact else self.tensor_numbers
        if numbers is None:
            return super()._launch_of(kernel_of, count, inputs, outputs, **more)
        kernel, inputs = kernel_of(body=self.tensor_text), [*inputs, numbers]
        return BlockLaunch(kernel, threads(count), inputs, outputs, self.device, first_index=2, block_dim=BLOCK)

    @property
    def tensor_numbers(self) -> wp.array | None:
        """The data that ``text`` reads, threshold lowered by its larger error of f; ``None`` for the float32 path."""
        source, device, data, held = self.source, self.device, self.data, self._held
        if not (device.is_cuda and device.arch in VERIFIED and fits(source)):
            return None
        if held is None or held[0] is not data:
            proven = min(self.rounding_bound(), getattr(self.certificate, "rounding_bound", np.inf))
            own = self.rounding_bound() + (rounding(self.network) - self.network.rounding) * (1 + 1e-6)
            held = data, None
            if np.isfinite(own):
                values = numbers(source, self.layers, lowered(self.threshold, proven, own))
                held = data, wp.array(values, dtype=wp.float32, device=device)
            self._held = held
        return held[1]


def threads(count: int) -> int:
    """Threads of a launch for so many queries, whole blocks."""
    return min(-(-count // BLOCK) * BLOCK, MOST_THREADS)


def _tiles(count: int) -> int:
    return -(-count // 8)


def _groups(source: "MlpSource") -> int:
    """Groups of four coordinates, a 1 behind the last one."""
    return -(-(source.coordinates + 1) // 4)


def _words(source: "MlpSource") -> list[int]:
    """Words of a lane for a tile of each hidden layer, a multiple of four.

    They are biases (behind the first layer), factors, and behind the last layer weights of the output.
    """
    sizes = [2 * _groups(source), *(4 + 2 * _tiles(k) for k in source.hidden[:-1])]
    sizes[-1] += 2
    return [-(-size // 4) * 4 for size in sizes]


def text(source: "MlpSource") -> str:
    """C statements from ``V v[]`` to ``V f``, by all lanes of a warp together."""
    lines, at = [TOOLS, fill(PARTS.BEGIN, groups=_groups(source), coordinates=source.coordinates)], 0
    last = len(source.hidden) - 1
    for index, (width, words) in enumerate(zip(source.hidden, _words(source), strict=True)):
        tiles, inputs = _tiles(width), _tiles(source.hidden[index - 1]) if index else 0
        sums = PARTS.NEXT if index else PARTS.FIRST
        if index < last:
            lines.append(f"U y{index}_high[2][{tiles}][2], y{index}_low[2][{tiles}][2];")
        names = (
            f"U (*y_high)[{tiles}][2] = y{index}_high; U (*y_low)[{tiles}][2] = y{index}_low;" if index < last else ""
        )
        if index:
            names += (
                f"const U (*x_high)[{inputs}][2] = y{index - 1}_high; const U (*x_low)[{inputs}][2] = y{index - 1}_low;"
            )
        sums = fill(sums, words=words, at=at, header=HEADER, inputs=inputs, groups=_groups(source))
        out = 4 + 2 * inputs if index else 2 * _groups(source)
        finish = PARTS.KEEP if index < last else fill(PARTS.LAST, out=out)
        lines.append(f"{{ {names}\n#pragma unroll\nfor (int j = 0; j < {tiles}; ++j) {{ {sums} {finish} }} }}")
        at += tiles * words // 4
    return "\n".join([*lines, PARTS.END])


def _split(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """High and low parts as float16."""
    high = np.asarray(x, np.float32).astype(np.float16)
    return high, (np.asarray(x, np.float64) - high).astype(np.float16)


def _pairs(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """uint32 words of two float16 numbers."""
    both = np.stack([first, second], axis=-1).astype(np.float16)
    return np.ascontiguousarray(both).view(np.uint32)[..., 0]


def numbers(source: "MlpSource", layers: list[tuple[np.ndarray, np.ndarray]], threshold: np.float32) -> np.ndarray:
    """float32 numbers as the text reads them at ``tensor``.

    Of layers, the output last, of a source that ``fits``, and the ``lowered`` threshold.
    """
    *hidden, (out_weight, out_bias) = layers
    lane = np.arange(32)
    g, t = lane // 4, lane % 4
    parts = [np.array([threshold, out_bias[0], *[0.0] * (HEADER - 2)], np.float32).view(np.uint32)]
    for index, ((weight, bias), size) in enumerate(zip(hidden, _words(source), strict=True)):
        (h, k), tiles = weight.shape, _tiles(weight.shape[0])
        words = np.zeros((tiles, 32, size), np.uint32)
        if index == 0:
            wide = np.zeros((8 * tiles, 4 * _groups(source)), np.float32)
            wide[:h, :k], wide[:h, k] = weight, bias
            high, low = _split(wide)
            used = 2 * _groups(source)
            for j in range(tiles):
                for c in range(_groups(source)):
                    a, b = high[8 * j + g, 4 * c + t], low[8 * j + g, 4 * c + t]
                    words[j, :, 2 * c], words[j, :, 2 * c + 1] = _pairs(a, a), _pairs(b, b)
        else:
            inputs = _tiles(k)
            wide, row = np.zeros((8 * tiles, 8 * inputs), np.float32), np.zeros(8 * tiles, np.float32)
            wide[:h, :k], row[:h] = weight, bias
            used = 4 + 2 * inputs
            for j in range(tiles):
                for part, values in enumerate(_split(wide)):
                    for i in range(inputs):
                        columns = values[8 * j + g]
                        pair = _pairs(columns[lane, 8 * i + 2 * t], columns[lane, 8 * i + 2 * t + 1])
                        words[j, :, 4 + part * inputs + i] = pair
                for i in range(4):
                    words[j, :, i] = row[8 * j + 2 * t + i % 2].view(np.uint32)
        if index == len(hidden) - 1:
            row = np.zeros(8 * tiles, np.float32)
            row[:h] = out_weight[0]
            for j in range(tiles):
                words[j, :, used], words[j, :, used + 1] = (row[8 * j + 2 * t + i].view(np.uint32) for i in range(2))
        parts.append(words.reshape(tiles, 32, size // 4, 4).transpose(0, 2, 1, 3).reshape(-1))
    return np.concatenate(parts).view(np.float32)


def sine_error(limit: float) -> float:
    """Bound of ``|sin.approx(z) - sin z|`` for ``|z| <= limit``."""
    return SINE_LEAST + SINE_SLOPE * limit


def _chain(products: list[np.ndarray], start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``(H,)``: what an ``mma`` after the other is off by, and the largest size of their sum.

    ``products`` are sizes of the products of each, ``(H, n)``; ``start`` ``(H,)`` that of what they are added to.
    """
    lost, size = np.zeros_like(start), start
    for terms in products:
        largest = np.maximum(terms.max(axis=1), size)
        size = size + terms.sum(axis=1)
        own = ((terms.shape[1] + 1) / 2 * largest + size) * CUT
        lost, size = lost + own, size + own
    return lost, size


def rounding(network: "Network") -> float:
    """Bound of the error of f as the text computes it, as ``networks.network.measure`` has it of float32.

    It is infinite where a number is out of range.
    """
    size, error = network.limit.copy(), np.zeros_like(network.limit)
    for index, layer in enumerate(network.hidden):
        weight = np.abs(layer.weight)
        largest = weight @ size + np.abs(layer.bias)
        off = weight @ error + _of_sums(layer, size + error, first=index == 0)
        argument = float((largest + off).max())
        if not (argument <= LIMIT and weight.max() < LARGEST_HALF and np.abs(layer.bias).max() < LARGEST_HALF):
            return np.inf
        if not (size + error).max() < LARGEST_HALF:
            return np.inf
        error, size = off + sine_error(argument), np.ones_like(largest)
    weight = np.abs(network.output.weight[0])
    computed = weight @ (size + error) + abs(float(network.output.bias[0]))
    terms = len(weight) + 4
    total = weight @ error + gamma(terms + 2) * computed + (2 * terms + 2 + (size + error).sum() + weight.sum()) * TINY
    return float(total) * (1 + 1e-6)


def _of_sums(layer: "Layer", size: np.ndarray, *, first: bool) -> np.ndarray:
    """``(H,)``: what is off in sums of exact products of inputs up to ``size``."""
    weight, bias = np.abs(layer.weight), np.abs(layer.bias)
    high, low = (np.abs(part.astype(np.float64)) for part in _split(layer.weight))
    rest = np.abs(layer.weight - sum(part.astype(np.float64) for part in _split(layer.weight)))
    # An input is high + low + what is cut: |x - high| <= HALF |x| + LEAST_HALF, and low is that, rounded likewise.
    of_high, of_low = size * (1 + HALF) + LEAST_HALF, (HALF * size + LEAST_HALF) * (1 + HALF) + LEAST_HALF
    left = weight @ (HALF * (HALF * size + LEAST_HALF) + LEAST_HALF) + rest @ size
    if first:
        of_bias = [np.abs(part.astype(np.float64)) for part in _split(layer.bias)]
        rest_of_bias = np.abs(layer.bias - sum(part.astype(np.float64) for part in _split(layer.bias)))
        terms = [part * x for part in (high, low) for x in (of_high, of_low)]
        # Of each coordinate four, and of the last one the bias.
        inputs = np.stack([*terms, np.zeros_like(high)], axis=-1)
        inputs = np.concatenate([inputs[..., :4], np.zeros((len(bias), 1, 4))], axis=1)
        inputs[:, -1, 0], inputs[:, -1, 1] = of_bias
        inputs = np.pad(inputs, ((0, 0), (0, -inputs.shape[1] % 4), (0, 0))).reshape(len(bias), -1)
        lost, _ = _chain(np.split(inputs, inputs.shape[1] // 16, axis=1), np.zeros_like(bias))
        return left + rest_of_bias + lost + 64 * TINY
    edges = [*range(16, 8 * _tiles(len(size)), 16)]
    passes = [np.pad(terms, ((0, 0), (0, -len(size) % 8))) for terms in (high * of_low, low * of_high, high * of_high)]
    lost, _ = _chain([part for terms in passes for part in np.split(terms, edges, axis=1)], bias)
    return left + low @ of_low + lost + 64 * 3 * _tiles(len(size)) * TINY


def lowered(threshold: np.float32, proven: float, own: float) -> np.float32:
    """The threshold of the text's f: by as much lower as its rounding bound exceeds the one that was proven with."""
    return np.float32(round_down(float(threshold) - max(own - proven, 0.0)))
