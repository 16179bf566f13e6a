"""A small network in torch with a hand-written backward pass, for many short steps on a CPU.

Autograd's bookkeeping and fresh allocations cost more than the arithmetic at these sizes, so forward, backward and
the gradient in the input run in preallocated buffers. Columns are samples: data is ``(features + 1, N)``, its last
row ones, so that a layer's weight and bias are one ``(out, in + 1)`` matrix.
"""

from itertools import pairwise

import numpy as np
import torch

from warp_bounding.activations import activation_of
from warp_bounding.bounders.mlp import encoding_tensors
from warp_bounding.training.engine.row_network import initial_layers, tensors_of

__all__ = ["Evaluator", "TrainableNetwork"]


class TrainableNetwork:
    """Parameters of a network, flat and as one matrix a layer.

    Args:
        ndim: Number of coordinates ``v``.
        hidden: Hidden widths.
        activation: A name in ``ACTIVATIONS``.
        octaves: Octaves of the positional encoding; 0 for none.
    """

    def __init__(self, ndim: int, hidden: tuple[int, ...], activation: str, octaves: int = 0):
        self.ndim, self.hidden, self.activation, self.octaves = ndim, hidden, activation, octaves
        self.act = activation_of(activation)
        fixed = encoding_tensors(ndim, octaves)
        self.encoding = {name: torch.from_numpy(value) for name, value in fixed.items()} if octaves else {}
        self.widths = [ndim + 2 * ndim * octaves, *hidden, 1]
        self.flat = torch.zeros(sum(o * (i + 1) for i, o in pairwise(self.widths)))
        self.layers = self.split(self.flat)

    def split(self, flat: torch.Tensor) -> list[torch.Tensor]:
        """Views of a flat vector, one ``(out, in + 1)`` matrix a layer."""
        views, start = [], 0
        for i, o in pairwise(self.widths):
            views.append(flat[start : start + o * (i + 1)].view(o, i + 1))
            start += o * (i + 1)
        return views

    def initialise(self, first: float, later: float, generator: torch.Generator) -> None:
        """Uniform weights in ``+-gain / sqrt(inputs)``; the gains are ``first``, then ``later``, of the output 1."""
        for layer, values in zip(self.layers, initial_layers(self.widths, (first, later), generator), strict=True):
            layer.copy_(values)

    def encode(self, v: torch.Tensor) -> torch.Tensor:
        """Columns ``(n, N)`` as the network's input ``(features + 1, N)``."""
        out = torch.ones(self.widths[0] + 1, v.shape[1])
        out[: self.ndim] = v
        if self.encoding:
            weight, bias = self.encoding.values()
            out[self.ndim : -1] = torch.sin(weight @ v + bias[:, None])
        return out

    def decode_gradient(self, gradient: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        """Gradient in ``v`` ``(n, N)`` from the gradient in the network's input, without its row of ones."""
        if not self.encoding:
            return gradient
        weight, bias = self.encoding.values()
        slope = torch.cos(weight @ v + bias[:, None]) * gradient[self.ndim :]
        return gradient[: self.ndim] + weight.T @ slope

    def tensors(self, flat: torch.Tensor | None = None) -> dict[str, np.ndarray]:
        """The parameters as a bounder stores them."""
        fixed = {name: value.numpy().copy() for name, value in self.encoding.items()}
        return fixed | tensors_of(self.layers if flat is None else self.split(flat))


class Evaluator:
    """Forward and backward passes of one thread, in buffers of its own; the network's parameters are only read."""

    def __init__(self, network: TrainableNetwork):
        self.network = network
        self.gradient = torch.zeros_like(network.flat)
        self.gradients = network.split(self.gradient)
        self._buffers: dict[int, tuple[list[torch.Tensor], ...]] = {}

    def _buffer(self, count: int) -> tuple[list[torch.Tensor], ...]:
        if count not in self._buffers:
            hidden = self.network.hidden
            outputs = [torch.ones(h + 1, count) for h in hidden]
            scratch = [[torch.empty(h, count) for h in hidden] for _ in range(3)]
            self._buffers[count] = (outputs, *scratch, [torch.empty(1, count)])
        return self._buffers[count]

    def forward(self, x: torch.Tensor, *, keep: bool = False) -> torch.Tensor:
        """Outputs ``(N,)`` for columns ``x``, valid until the next call; ``keep`` what ``backward`` needs."""
        outputs, values, slopes, _, last = self._buffer(x.shape[1])
        act = self.network.act
        for index, layer in enumerate(self.network.layers[:-1]):
            torch.mm(layer, x, out=values[index])
            act.torch_value(values[index], out=outputs[index][:-1])
            if keep:
                act.torch_slope(values[index], outputs[index][:-1], slopes[index])
            x = outputs[index]
        return torch.mm(self.network.layers[-1], x, out=last[0])[0]

    def backward(self, x: torch.Tensor, weight: torch.Tensor) -> None:
        """Add ``sum_i weight_i d f(x_i) / d parameters`` to ``gradient``; ``forward(x, keep=True)`` comes first."""
        outputs, _, slopes, scratch, _ = self._buffer(x.shape[1])
        signal = weight.view(1, -1)
        for index in range(len(self.network.layers) - 1, -1, -1):
            below = outputs[index - 1] if index else x
            self.gradients[index].addmm_(signal, below.T.contiguous())  # the product with a transposed view is slower
            if index:
                torch.mm(self.network.layers[index][:, :-1].T, signal, out=scratch[index - 1])
                signal = scratch[index - 1].mul_(slopes[index - 1])

    def input_gradient(self, x: torch.Tensor) -> torch.Tensor:
        """``d f / d x`` ``(features, N)``."""
        self.forward(x, keep=True)
        slopes = self._buffer(x.shape[1])[2]
        signal = torch.ones(1, x.shape[1])
        for index in range(len(self.network.layers) - 1, 0, -1):
            signal = (self.network.layers[index][:, :-1].T @ signal).mul_(slopes[index - 1])
        return self.network.layers[0][:, :-1].T @ signal
