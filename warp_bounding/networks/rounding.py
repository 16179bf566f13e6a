"""What a network rounds: the error of any float32 evaluation, and that of bounds in float64, layer by layer.

The error model is that of ``arithmetic``: a sum of K products in any order, fused or not. Activations have slopes
between -1 and 1, so an error of a layer's sums is passed on undiminished at worst, and each activation adds its own
``error``.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from warp_bounding.activations import Activation
from warp_bounding.arithmetic import LARGEST, TINY, UNIT64, gamma
from warp_bounding.errors import BounderError

__all__ = ["Layer", "Rounding", "measure"]


@dataclass(frozen=True)
class Layer:
    """``z = W h + b`` in float64, and what is applied to z.

    Attributes:
        weight: ``(H, K)``.
        bias: ``(H,)``.
        activation: ``None`` for the output.
        linear: Number of leading rows to which no activation is applied.
    """

    weight: np.ndarray
    bias: np.ndarray
    activation: Activation | None
    linear: int = 0


class Rounding(NamedTuple):
    """What a network rounds.

    Attributes:
        padding: Per layer, the output last: a bound of what float64 rounds in anything that bounds compute there.
        error: E, a bound of the error of any float32 evaluation of the output.
        largest: Bound of the output's absolute value.
    """

    padding: list[float]
    error: float
    largest: float


def measure(layers: list[Layer], limit: np.ndarray, terms: np.ndarray | None = None) -> Rounding:
    """Walk through the layers once.

    Of a layer, ``largest`` bounds the exact |z|, ``computed`` the sum of the absolute terms that float32 adds up, and
    ``rounding`` the distance of the computed z from the exact one. For bounds in float64, ``operations`` is more than
    the roundings on any path so far: in each layer at most 4 sums of ``terms`` products (centre, linear parts, noise,
    and the way back), and fewer than 32 operations of a relaxation; 4 more sums and 96 operations more of quadratic
    forms (entries, middle and half of the range) where a layer bends; 16 are left for the chart and the last steps.
    ``chain`` bounds the sum of absolute terms on a path, with activations of slope 1 and parabolas whose heights, at
    most 1, are in the term 1.0 of each layer. A mean differs from the value at the box's centre by no more than its
    noise, so sums of means are values and noise. The entries of quadratic forms together are at most twice the
    parabolas' heights: hence the factor 2.

    Args:
        layers: The output last.
        limit: ``(n,)``, largest size of the inputs, which are exact.
        terms: ``(n,)``, bound of the sum of the absolute terms of which a chart makes an input over a box: its centre,
            linear and quadratic parts and noise; ``limit`` if ``None``.

    Raises:
        BounderError: If float32 sums may overflow, or an argument can leave the range in which its activation is
            certified.
    """
    size, error = limit.copy(), np.zeros_like(limit)  # of h: largest absolute value; error of the computed h
    padding, operations, chain, bent = [], 16, (limit if terms is None else terms).copy(), False
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
        argument = float((largest + rounding)[layer.linear :].max(initial=0.0))
        if not argument <= activation.limit:
            where = "encoding" if layer.linear else f"hidden layer {index}"
            raise BounderError(
                f"{where}: arguments of {activation.name} reach {argument:.3g}, it is certified up to {activation.limit}"
            )
        error = rounding + activation.error(argument)
        size = largest if activation.largest is None else np.full_like(largest, activation.largest)
        error[: layer.linear] = 0.0  # copied, not computed
        size[: layer.linear] = limit[: layer.linear]
    # 1e-6 is far above what this function itself rounds in float64.
    return Rounding(padding, float(rounding[0]) * (1 + 1e-6), float(largest[0]) * (1 + 1e-6))
