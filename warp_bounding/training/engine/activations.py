"""What training asks of an activation, in torch: values, derivatives, and the initial weights it learns best from.

One entry for each of ``bounders.activations``, under the same name.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch

__all__ = ["TRAINABLE", "Trainable"]


@dataclass(frozen=True)
class Trainable:
    """An activation in training.

    Attributes:
        value: A torch function, which autograd knows and which takes ``out=``.
        slope: ``slope(z, h, out)`` writes the derivative at z into ``out``, where ``h = value(z)``.
        wave: Whether it begins with steep first layers (``Recipe.first_gain``), which tell neighbouring cells apart.
        support_gains: Initial weights of a plane's supports and of regions' occupancy: +-gain / sqrt(inputs), the first layer's and
            later ones'.
        falling: Share of a monotone network's neurons that fall as the box grows; where the activation is odd they add nothing.
        mean: Of a monotone network's neurons behind the first layer, in units of its gain, about.
    """

    value: Callable[..., torch.Tensor]
    slope: Callable[[torch.Tensor, torch.Tensor, torch.Tensor], object]
    support_gains: tuple[float, float]
    wave: bool = False
    falling: float = 0.0
    mean: float = 0.0


def _slope_of_sin(z: torch.Tensor, h: torch.Tensor, out: torch.Tensor) -> None:
    torch.cos(z, out=out)


def _relu(z: torch.Tensor, out: torch.Tensor | None = None) -> torch.Tensor:
    return torch.clamp(z, min=0, out=out)


def _slope_of_relu(z: torch.Tensor, h: torch.Tensor, out: torch.Tensor) -> None:
    torch.gt(z, 0, out=out)


def _slope_of_tanh(z: torch.Tensor, h: torch.Tensor, out: torch.Tensor) -> None:
    torch.mul(h, h, out=out).neg_().add_(1)


TRAINABLE = {
    "sin": Trainable(torch.sin, _slope_of_sin, (3.0, 1.7), wave=True),
    "relu": Trainable(_relu, _slope_of_relu, (1.7, 1.7), falling=0.5, mean=0.3),  # those that fall are concave
    "tanh": Trainable(torch.tanh, _slope_of_tanh, (1.7, 1.7)),
}
