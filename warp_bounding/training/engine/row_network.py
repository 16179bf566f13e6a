"""A small network of rows in torch, for autograd: several outputs, trained as a whole or only its last layer.

Layers are ``(out, in + 1)`` matrices, the last column the biases.
"""

import math
from itertools import pairwise

import numpy as np
import torch

from warp_bounding.activations import Activation

__all__ = ["RowNetwork", "initial", "initial_layers", "tensors_of"]


def initial(generator: torch.Generator, rows: int, inputs: int, gain: float = 1.0) -> torch.Tensor:
    """``(rows, inputs + 1)``, uniform in ``+-1 / sqrt(inputs)``; ``gain`` times that, but for the biases."""
    layer = (torch.rand(rows, inputs + 1, generator=generator) * 2 - 1) / math.sqrt(inputs)
    layer[:, :-1] *= gain
    return layer


def initial_layers(widths: list[int], gains: tuple[float, float], generator: torch.Generator) -> list[torch.Tensor]:
    """Random layers between ``widths``, with gains of the first and of later hidden ones; the output's gain is 1."""
    each = [gains[0], *[gains[1]] * (len(widths) - 3), 1.0]
    return [initial(generator, h, k, gain) for gain, (k, h) in zip(each, pairwise(widths), strict=True)]


class RowNetwork:
    """Hidden layers and linear outputs: ``fixed`` hidden layers, which stay as they are, and layers that are trained."""

    def __init__(self, layers: list[torch.Tensor], activation: Activation, fixed: tuple[torch.Tensor, ...] = ()):
        self.layers, self.activation, self.fixed = [layer.requires_grad_(True) for layer in layers], activation, fixed

    def __call__(self, h: torch.Tensor) -> torch.Tensor:
        """Outputs ``(N, outputs)`` of rows ``(N, inputs)``."""
        with torch.no_grad():
            for layer in self.fixed:
                h = self.hidden(layer, h)
        for layer in self.layers[:-1]:
            h = self.hidden(layer, h)
        return torch.addmm(self.layers[-1][:, -1], h, self.layers[-1][:, :-1].T)

    def hidden(self, layer: torch.Tensor, h: torch.Tensor) -> torch.Tensor:
        """Activations behind a layer."""
        return self.activation.torch_value(torch.addmm(layer[:, -1], h, layer[:, :-1].T))

    def copy(self) -> list[torch.Tensor]:
        """The layers that are trained, as they are now."""
        return [layer.detach().clone() for layer in self.layers]


def tensors_of(layers: list[torch.Tensor]) -> dict[str, np.ndarray]:
    """Layers as a bounder stores them."""
    out = {}
    for index, layer in enumerate(layers):
        out[f"layers.{index}.weight"] = layer[:, :-1].numpy().copy()
        out[f"layers.{index}.bias"] = layer[:, -1].numpy().copy()
    return out
