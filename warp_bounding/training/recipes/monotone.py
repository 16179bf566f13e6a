"""Training of ``monotone-mlp``: a monotone network of boxes, in terms of the square roots of its weights.

A weight is ``s r^2`` with a fixed sign s, and r is what the optimiser changes. Against clamping at zero or ``|r|``
that is the difference between training and not training: a gradient step in r multiplies a weight, so weights grow
and vanish geometrically, few of them stay, and a weight near zero moves slowly enough to come back. The first layer
begins as supports of boxes, ``max over the box of d . x``, in random directions d.

The positives are points p of the object, boxes ``low = high = p``: the least f is among them. So they are as cheap to
draw, to walk and to search as a point network's, the prover's own counterexamples are among them, and the threshold
is proven.
"""

from __future__ import annotations

import math

import numpy as np

from warp_bounding.training.engine import Soap, TrainableNetwork
from warp_bounding.training.lazy_torch import torch
from warp_bounding.training.recipes.default import NetworkTrainer, Recipe
from warp_bounding.training.samples import LeastBoxes

__all__ = ["MonotoneTrainer"]

RECIPE = Recipe(first_gain=5.0, later_gain=3.0, sharpness=0.3)
SPREAD = 0.8  # largest |coordinate| of the random point through which an initial plane of the first layer goes
LEAST_ROOT = 0.1  # least root of an initial weight: one at 0 would stay there
MOST_ADDED = 256  # points of a search that join the hard ones


class MonotoneTrainer(NetworkTrainer):
    """A monotone network in training, on samples whose positives are points; see ``NetworkTrainer``."""

    samples: LeastBoxes

    def __init__(self, samples: LeastBoxes, hidden: tuple[int, ...], activation: str):
        super().__init__(samples, hidden, activation, recipe=RECIPE)

    def add(self, v: np.ndarray) -> None:
        """Add points, lowest first; one a cell is kept, because a search's points crowd around few minima."""
        self.add_states(self.samples.spread(self.samples.locate(v), MOST_ADDED))

    def worst_points(self) -> np.ndarray:
        """``(K, n)`` float64, the worst points of the object known, local space: where a proof's search may begin."""
        return super().worst_points()[:, : self.samples.grid.ndim]

    def _initialise(self) -> None:
        """Supports of boxes in random directions, behind them positive weights around zero arguments."""
        network, generator, recipe = self.network, self.generator, self.recipe
        n, act = self.samples.grid.ndim, network.act
        self._signs = _signs(network, act.falling)
        for index, (layer, sign) in enumerate(zip(network.layers, self._signs, strict=True)):
            rows, inputs = sign.shape
            if index == 0:
                # An axis of few cells carries less detail than its range in v would suggest.
                d = torch.randn(rows, n, generator=generator) * self.samples.points.detail.T
                d /= d.norm(dim=1, keepdim=True)
                foot = (torch.rand(rows, n, generator=generator) * 2 - 1) * SPREAD
                gain = recipe.first_gain * (0.5 + torch.rand(rows, 1, generator=generator))
                weight = torch.cat([d.clamp(max=0), d.clamp(min=0), -(d * foot).sum(1, keepdim=True)], 1)
                layer.copy_(weight * gain * sign[:, -1:])
            else:
                layer[:, :-1] = torch.rand(rows, inputs, generator=generator) * sign * (2 * recipe.later_gain)
                layer[:, :-1] /= math.sqrt(inputs)
                layer[:, -1] = torch.randn(rows, generator=generator) * (recipe.later_gain / 2)
                layer[:, -1] -= act.mean * recipe.first_gain * layer[:, :-1].sum(1)

    def _optimiser(self) -> Soap:
        return _RootSoap(self.network.layers, self._signs, self.recipe)


class _RootSoap(Soap):
    """Soap over the square roots of weights, and biases as they are; writes the weights after each step.

    Layers are ``(out, in + 1)`` matrices, the last column the biases; ``signs`` ``(out, in)`` are those of their
    weights.
    """

    def __init__(self, layers: list[torch.Tensor], signs: list[torch.Tensor], recipe: Recipe):
        self._layers, self._signs = layers, signs
        roots = [layer.clone() for layer in layers]
        for root, sign in zip(roots, signs, strict=True):
            root[:, :-1] = (root[:, :-1] * sign).clamp_(min=LEAST_ROOT**2).sqrt_()
        super().__init__(roots, recipe.beta1, recipe.beta2)
        self._write()

    def step(self, gradients: list[torch.Tensor], rate: float) -> None:
        """One step with this learning rate; the gradients, by the weights, are overwritten."""
        for gradient, root, sign in zip(gradients, self.weights, self._signs, strict=True):
            gradient[:, :-1].mul_(root[:, :-1]).mul_(2 * sign)
        super().step(gradients, rate)
        self._write()

    def _write(self) -> None:
        for layer, root, sign in zip(self._layers, self.weights, self._signs, strict=True):
            layer.copy_(root)
            layer[:, :-1].mul_(root[:, :-1]).mul_(sign)


def _signs(network: TrainableNetwork, falling: float) -> list[torch.Tensor]:
    """``(out, in)`` signs of each layer's weights, a share of the hidden neurons falling as the box grows."""
    n, signs = network.ndim // 2, []
    below = torch.cat([-torch.ones(n), torch.ones(n)])
    for width in (*network.hidden, 1):
        way = torch.ones(width)
        if len(signs) < len(network.hidden):
            way[: int(falling * width)] = -1.0
        signs.append(way[:, None] * below)
        below = way
    return signs
