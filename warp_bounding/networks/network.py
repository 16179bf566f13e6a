"""A small network as numbers: layers, their exact evaluation, and bounds over boxes.

Hidden layer: ``h' = act(W h + b)``, act one of ``activations``; the output is linear. An optional positional encoding
puts fixed features ``[v, sin(F v + g)]`` before the first layer; it is a sine layer whose first rows pass ``v``
through.

Bounds use one relaxation per neuron with the *same* slope on both sides, ``act(z + x) in mean + slope x + [-e, e]``
(a zonotope's; Singh et al., *Fast and Effective Robustness Certification*, 2018), and for the sine a parabola in the
linear part l of x besides, ``bend l^2`` (``activations.sine``). With equal slopes layers compose exactly: only the
half-widths e remain. For the output they, lines and parabolas are carried back through the actual coefficients
(backward substitution, as in CROWN, Zhang et al. 2018): parabolas of many neurons cancel to a large part, so that
what is left in small boxes is of third order in their size. For pre-activations behind the second hidden layer all
that is not linear is taken in absolute value. Any slope and any parabola is sound; tightness alone depends on it.
"""

import numpy as np

from warp_bounding.activations import SINE, activation_of
from warp_bounding.networks.bound_kernel import bound_boxes
from warp_bounding.networks.bound_source import BULK, NetworkSizes
from warp_bounding.networks.box_bounds import BoxBounds
from warp_bounding.networks.charts.base import Chart, PlainChart
from warp_bounding.networks.rounding import Layer, measure

__all__ = ["Network"]


class Network:
    """Exact twin of a stored network; weights are float32 numbers held in float64.

    Args:
        layers: ``[(weight (H, K), bias (H,)), ...]``, the last one the scalar output.
        activation: A name in ``ACTIVATIONS``, of the hidden layers.
        encoding: ``(weight (F, n), bias (F,))`` of the positional encoding, or ``None``.
        limit: ``(n,)``, largest ``|v|`` that is ever asked for.

    Attributes:
        rounding: E, error of any float32 evaluation.
        largest: Bound of ``|f|``.

    Raises:
        BounderError: If an argument can leave the range in which the kernels' activation is certified.
    """

    def __init__(self, layers, activation: str, encoding, limit: np.ndarray):
        self.limit = np.asarray(limit, dtype=np.float64)
        stack = []
        if encoding is not None:
            n = len(self.limit)
            weight = np.concatenate([np.eye(n), np.asarray(encoding[0], dtype=np.float64)])
            bias = np.concatenate([np.zeros(n), np.asarray(encoding[1], dtype=np.float64)])
            stack.append(Layer(weight, bias, SINE, linear=n))
        for weight, bias in layers[:-1]:
            stack.append(Layer(weight.astype(np.float64), bias.astype(np.float64), activation_of(activation)))
        self.hidden = stack
        self.output = Layer(layers[-1][0].astype(np.float64), layers[-1][1].astype(np.float64), None)
        self.padding, self.rounding, self.largest = measure([*self.hidden, self.output], self.limit)
        parts = [part for x in self.hidden for part in (x.bias, x.weight.reshape(-1), np.abs(x.weight).reshape(-1))]
        self._packed = np.concatenate([*parts, self.output.bias, self.output.weight[0]])

    @property
    def packed(self) -> np.ndarray:
        """Weights as ``bound_boxes`` reads them."""
        return self._packed

    def sizes(self, chart: Chart | None = None) -> NetworkSizes:
        """What the kernels of bounds depend on; boxes of the inputs themselves if there is no chart."""
        layers = tuple((x.weight.shape[1], x.weight.shape[0], x.activation.name, x.linear) for x in self.hidden)
        return NetworkSizes(len(self.limit), layers, chart or PlainChart(len(self.limit)))

    def __call__(self, v: np.ndarray) -> np.ndarray:
        """``f`` of ``(N, n)`` float64 coordinates, ``(N,)`` float64."""
        h = np.asarray(v, dtype=np.float64)
        for layer in self.hidden:
            z = h @ layer.weight.T + layer.bias
            h = layer.activation.value(z)
            h[:, : layer.linear] = z[:, : layer.linear]
        return (h @ self.output.weight.T + self.output.bias)[:, 0]

    def padding_for(self, limit: np.ndarray) -> np.ndarray:
        """The float64 rounding of bounds, per layer, over inputs of this size ``(n,)``.

        Raises:
            BounderError: See class.
        """
        return np.array(measure([*self.hidden, self.output], limit).padding)

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """Lower bounds of f over boxes of its inputs, by the fused kernel (``bound_plain`` is its twin).

        Args:
            lower: ``(N, n)`` float64.
            upper: ``(N, n)`` float64.

        Returns:
            See ``BoxBounds``; ``f >= level + slope . (v - center)`` on the box.
        """
        return bound_boxes(self.sizes(), self._packed, np.array(self.padding), lower, upper)

    def bound_plain(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Lower bounds of f over boxes, in NumPy.

        Args:
            lower: ``(N, n)`` float64.
            upper: ``(N, n)`` float64.

        Returns:
            ``(N,)`` certified lower bounds (float64 rounding subtracted), ``(N,)`` axis whose halving should help most, and
            ``(N, n)`` the corner where the linear part is least.
        """
        center, radius = (lower + upper) / 2, (upper - lower) / 2
        mean, slope, noise = center, None, 0.0
        trace = []  # per hidden layer: generators g of z, near, width of z, slope, bend, spread
        for index, layer in enumerate(self.hidden):
            # h = mean + slope * (sum_k g_k zeta_k) + bend * (near'^2 - near^2 / 2) + noise; what is not linear is
            # bounded entry by entry
            z = mean @ layer.weight.T + layer.bias
            if index == 0:
                parts = [column * radius[:, k, None] for k, column in enumerate(layer.weight.T)]
                noise = np.zeros_like(z)
            else:
                parts = [(part * slope) @ layer.weight.T for part in parts]
                noise = noise @ np.abs(layer.weight).T
            near, pad = sum(np.abs(part) for part in parts), self.padding[index]
            slope, mean, bend, spread = layer.activation.relax(z, near, noise + pad)
            k = layer.linear
            slope[:, :k], mean[:, :k], bend[:, :k], spread[:, :k] = 1.0, z[:, :k], 0.0, 0.0
            spread, half = spread + pad, near * near / 2
            trace.append((parts, near, near + noise + pad, slope, bend, spread))
            mean, noise = mean + bend * half, np.abs(slope) * noise + np.abs(bend) * half + spread
        least = mean @ self.output.weight[0] + self.output.bias[0] - self.padding[-1]
        # Backwards: lines and parabolas weighed by the output's coefficients, and what each neuron's rest costs and
        # whose fault it is.
        n = center.shape[1]
        coefficient = np.broadcast_to(self.output.weight[0], slope.shape)
        score, square = np.zeros_like(center), np.zeros((len(center), n, n))
        for index, (parts, near, width, slope, bend, spread) in reversed(list(enumerate(trace))):
            loss, bow = np.abs(coefficient) * spread, coefficient * bend
            least -= loss.sum(axis=1) + (bow * near * near / 2).sum(axis=1)
            least -= BULK * (np.abs(bow) * near * near).sum(axis=1)
            for k in range(n):
                score[:, k] += (loss / width * np.abs(parts[k])).sum(axis=1)
                for m in range(n):
                    square[:, k, m] += (bow * parts[k] * parts[m]).sum(axis=1)
            coefficient = (coefficient * slope) @ self.hidden[index].weight
        corner = np.where(coefficient > 0, lower, upper)
        slope, size = np.abs(coefficient * radius), np.abs(square)
        diagonal = np.einsum("nkk->nk", square)
        score += size.sum(axis=2)
        least -= size.sum(axis=(1, 2)) - np.maximum(diagonal, 0).sum(axis=1)
        up = np.maximum(diagonal, 0)
        inner = -(slope**2) / (4 * np.where(up > 0, up, 1.0))
        least += np.where(slope < 2 * up, inner, up - slope).sum(axis=1)
        return least, np.argmax(score, axis=1), corner
