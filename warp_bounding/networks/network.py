"""A small network as numbers: layers, their exact evaluation, and bounds over boxes.

A hidden layer computes ``h' = act(W h + b)``, act one of ``activations``; the output is linear.

A neuron's argument on a box is ``z + x``, ``x = l + p + y``: z its value at the centre, l linear in the box's
coordinates, p the quadratic form that the parabolas of the layers below add up to, and y the rest. The relaxation of
its activation (``Activation.relaxation``) is a line or a cubic in l, the same for the lower and the upper bound, and an
error band around it. So layers compose exactly but for the bands, as zonotopes do (Singh et al., *Fast and Effective
Robustness Certification*, 2018), and Taylor models (Makino and Berz, *Taylor Models and Other Validated Functional
Inclusion Methods*, 2003). The forward pass keeps centres, linear parts, quadratic forms, in which terms of many neurons
cancel, and half-widths of the rest. The backward pass carries the output's actual coefficients down (CROWN, Zhang et
al. 2018): it adds the relaxations of all neurons to one cubic polynomial, in which they cancel again, and only the
bands in absolute value. So on small boxes the bound is off by the third power of their width, times what does not
cancel in the cubic terms. Any line or cubic is sound; the choice only decides how tight the bound is.
"""

from copy import copy
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from warp_bounding.activations import Activation, activation_of
from warp_bounding.errors import BounderError
from warp_bounding.networks.bounds import BoxBounds, NetworkShape, Parametrization, bound_boxes, bound_corners
from warp_bounding.rounding import LARGEST, TINY, UNIT64, gamma

# Rounding of a network: the error of any float32 evaluation, and of bounds in float64, layer by layer.
#
# The error model is that of ``rounding``: a sum of K products in any order, fused or not. Activations have slopes
# between -1 and 1, so an error of a layer's sums is passed on undiminished at worst, and each activation adds its own
# ``error``.


@dataclass(frozen=True)
class Layer:
    """``z = W h + b`` in float64, and the activation that is applied to z.

    Attributes:
        weight: ``(H, K)``.
        bias: ``(H,)``.
        activation: ``None`` for the output.
    """

    weight: np.ndarray
    bias: np.ndarray
    activation: Activation | None


class Rounding(NamedTuple):
    """Rounding of a network.

    Attributes:
        padding: Per layer, the output last: bounds the float64 rounding of everything that bounds compute there.
        error: E, a bound of the error of any float32 evaluation of the output.
    """

    padding: list[float]
    error: float


def measure(layers: list[Layer], limit: np.ndarray) -> Rounding:
    """The rounding of a network, in one walk through its layers.

    *float32.* Of a layer, ``largest`` bounds the exact |z|, ``computed`` the sum of the absolute terms that are added
    up, and ``rounding`` the distance of the computed z from the exact one.

    *Bounds in float64.* ``operations`` exceeds the roundings on any path so far. A layer has at most 4 sums of
    ``terms`` products (centre, linear parts, noise, and the backward pass) and fewer than 32 operations of a
    relaxation. One that bends has 4 more sums and 96 more operations of quadratic forms (entries, middle and half of
    the range). The parametrization and the last steps have 16. ``chain`` bounds the sum of absolute terms on a path,
    with activations of slope 1 and parabolas of height at most 1, the term 1.0 of each layer. The entries of quadratic
    forms add up to at most twice these heights, hence the factor 2. A mean is the centre's value up to its noise.

    Args:
        layers: The output last.
        limit: ``(n,)``, largest absolute values of the inputs, which are exact.

    Raises:
        BounderError: If float32 sums may overflow, or an argument can leave the range in which its activation is
            certified.
    """
    size, error = limit.copy(), np.zeros_like(limit)  # of h: largest absolute value; error of the computed h
    padding, operations, chain, bent = [], 16, limit.copy(), False
    for index, layer in enumerate(layers):
        terms, weight = layer.weight.shape[1], np.abs(layer.weight)
        largest = weight @ size + np.abs(layer.bias)
        computed = weight @ (size + error) + np.abs(layer.bias)
        flushed = (2 * terms + 2 + (size + error).sum() + weight.sum(axis=1)) * TINY  # factors or results set to zero
        rounding = weight @ error + gamma(terms + 2) * computed + flushed
        if not ((computed + rounding) < LARGEST).all():
            raise BounderError(
                f"values of layer {index} can reach {float(computed.max()):.3g}, float32 sums may overflow"
            )
        operations += 4 * terms + 32
        if bent := bent or (layer.activation is not None and layer.activation.bends):
            operations += 4 * terms + 96
        chain = weight @ chain + largest + 1.0
        padding.append(gamma(operations, UNIT64) * ((2.0 if bent else 1.0) * float(chain.max()) + 4.0))
        if (activation := layer.activation) is None:
            break
        argument = float((largest + rounding).max(initial=0.0))
        if not argument <= activation.limit:
            raise BounderError(
                f"hidden layer {index}: arguments of {activation.name} reach {argument:.3g}, it is certified up to "
                f"{activation.limit}"
            )
        error = rounding + activation.error(argument)
        size = largest if activation.largest is None else np.full_like(largest, activation.largest)
    # 1e-6 is far above what this function itself rounds in float64.
    return Rounding(padding, float(rounding[0]) * (1 + 1e-6))


class SearchBounds:
    """Bounds of networks by the kernels of ``networks.bounds``; ``certify`` has others (``proof.taylor``)."""

    def boxes(self, network: "Network", lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """See ``Network.bound``."""
        return bound_boxes(network.kernel_shape(), network.packed, np.array(network.padding), lower, upper)

    def corners(self, network: "Network", lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """See ``Network.corners``."""
        return bound_corners(network.kernel_shape(), network.packed, np.array(network.padding), lower, upper)


class Network:
    """The exact function of a stored network; weights are float32 numbers, stored in float64.

    Args:
        layers: ``[(weight (H, K), bias (H,)), ...]``, the last one the scalar output; or a ``Layer`` for each.
        activation: A name in ``ACTIVATIONS``, of the hidden layers; ``None`` where each ``Layer`` has its own.
        limit: ``(n,)``, largest ``|v|`` that is ever evaluated.

    Attributes:
        padding: As in ``Rounding``.
        rounding: E, a bound of the error of any float32 evaluation.
        packed: As ``bound_boxes`` reads them: of each hidden layer the biases, the weights row by row and their
            absolute values, then the output's bias and weights.
        bounds: What bounds it over boxes, wherever it is sent; those of the search, unless it is ``bounded_by`` others.

    Raises:
        BounderError: If an argument can leave the range in which the kernels' activation is certified.
    """

    bounds = SearchBounds()

    def __init__(self, layers, activation: str | None, limit: np.ndarray):
        if activation is not None:
            kept = [*[activation_of(activation)] * (len(layers) - 1), None]
            pairs = zip(layers, kept, strict=True)
            layers = [Layer(w.astype(np.float64), b.astype(np.float64), act) for (w, b), act in pairs]
        *self.hidden, self.output = layers
        self.limit = np.asarray(limit, dtype=np.float64)
        self.padding, self.rounding = measure([*self.hidden, self.output], self.limit)
        parts = [part for x in self.hidden for part in (x.bias, x.weight.reshape(-1), np.abs(x.weight).reshape(-1))]
        self.packed = np.concatenate([*parts, self.output.bias, self.output.weight[0]])

    def bounded_by(self, bounds) -> "Network":
        """The same network with other bounds, which have the methods of ``SearchBounds``."""
        made = copy(self)
        made.bounds = bounds
        return made

    def kernel_shape(self, parametrization: Parametrization | None = None) -> NetworkShape:
        """What kernels of bounds are compiled for; without a parametrization, boxes are of the inputs themselves."""
        layers = tuple((x.weight.shape[1], x.weight.shape[0], x.activation.name) for x in self.hidden)
        return NetworkShape(len(self.limit), layers, parametrization or Parametrization(len(self.limit)))

    def __call__(self, v: np.ndarray) -> np.ndarray:
        """``f`` of ``(N, n)`` float64 coordinates, ``(N,)`` float64."""
        h = np.asarray(v, dtype=np.float64)
        for layer in self.hidden:
            h = layer.activation.value(h @ layer.weight.T + layer.bias)
        return (h @ self.output.weight.T + self.output.bias)[:, 0]

    def padding_for(self, limit: np.ndarray) -> np.ndarray:
        """``padding`` for boxes with centres ``|v| <= limit``, ``(n,)``; errors as in ``measure``."""
        return np.array(measure([*self.hidden, self.output], limit).padding)

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """Lower bounds of f over boxes of its inputs, ``(N, n)`` float64 corners, by the fused kernel."""
        return self.bounds.boxes(self, lower, upper)

    def corners(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Multilinear lower bounds of f over boxes of its inputs, as ``bound_corners`` gives them."""
        return self.bounds.corners(self, lower, upper)
