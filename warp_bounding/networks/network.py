"""A small network as numbers: layers, their exact evaluation, and bounds over boxes.

A hidden layer computes ``h' = act(W h + b)``, act one of ``activations``; the output is linear. An optional positional
encoding puts fixed features ``[v, sin(F v + g)]`` before the first layer: a sine layer whose first rows pass ``v``
through.

Bounds relax the activation of each neuron at ``z + x``, ``x = l + y``, where l is linear in the box's coordinates and y
is all that is not: it lies within ``spread`` of ``mean + slope x + bend l^2`` (``Activation.relax``). The slope is the
same above and below, as in a zonotope (Singh et al., *Fast and Effective Robustness Certification*, 2018), so layers
compose exactly but for the spreads. Forwards, only centres, linear parts and half-widths of the rest are kept.
Backwards, the output's actual coefficients are carried down (CROWN, Zhang et al. 2018): slopes and parabolas of many
neurons cancel, and only spreads are added in absolute value, so that on small boxes the bound is off by the third power
of their width. Any slope and any parabola is sound; they decide only how tight the bound is.
"""

import numpy as np

from warp_bounding.activations import SINE, activation_of
from warp_bounding.networks.bound_kernel import bound_boxes
from warp_bounding.networks.bound_source import SQUARES_ROUNDING, NetworkShape
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
        padding: Bounds of what each layer's float64 arithmetic in ``bound`` rounds, the output's last.
        rounding: E, a bound of the error of any float32 evaluation.
        largest: Bound of ``|f|``.
        packed: As ``bound_boxes`` reads them: of each hidden layer the biases, the weights row by row and their
            absolute values, then the output's bias and weights.

    Raises:
        BounderError: If an argument can leave the range in which the kernels' activation is certified.
    """

    def __init__(self, layers, activation: str, encoding, limit: np.ndarray):
        stack = []
        if encoding is not None:
            n = len(limit)
            weight = np.concatenate([np.eye(n), np.asarray(encoding[0], dtype=np.float64)])
            bias = np.concatenate([np.zeros(n), np.asarray(encoding[1], dtype=np.float64)])
            stack.append(Layer(weight, bias, SINE, linear=n))
        for weight, bias in layers[:-1]:
            stack.append(Layer(weight.astype(np.float64), bias.astype(np.float64), activation_of(activation)))
        output = Layer(layers[-1][0].astype(np.float64), layers[-1][1].astype(np.float64), None)
        self._measure(stack, output, limit)

    @classmethod
    def of_layers(cls, hidden: list[Layer], output: Layer, limit: np.ndarray) -> "Network":
        """A network of any float64 layers, each with its own activation; raises as the class does."""
        network = cls.__new__(cls)
        network._measure(hidden, output, limit)
        return network

    def _measure(self, hidden: list[Layer], output: Layer, limit: np.ndarray) -> None:
        self.hidden, self.output, self.limit = hidden, output, np.asarray(limit, dtype=np.float64)
        self.padding, self.rounding, self.largest = measure([*self.hidden, self.output], self.limit)
        parts = [part for x in self.hidden for part in (x.bias, x.weight.reshape(-1), np.abs(x.weight).reshape(-1))]
        self.packed = np.concatenate([*parts, self.output.bias, self.output.weight[0]])

    def kernel_shape(self, chart: Chart | None = None) -> NetworkShape:
        """What kernels of bounds are compiled for; boxes are of the inputs themselves if there is no chart."""
        layers = tuple((x.weight.shape[1], x.weight.shape[0], x.activation.name, x.linear) for x in self.hidden)
        return NetworkShape(len(self.limit), layers, chart or PlainChart(len(self.limit)))

    def __call__(self, v: np.ndarray) -> np.ndarray:
        """``f`` of ``(N, n)`` float64 coordinates, ``(N,)`` float64."""
        return (self.activations(v) @ self.output.weight.T + self.output.bias)[:, 0]

    def activations(self, v: np.ndarray) -> np.ndarray:
        """``(N, H)`` float64, of the last hidden layer."""
        h = np.asarray(v, dtype=np.float64)
        for layer in self.hidden:
            z = h @ layer.weight.T + layer.bias
            h = layer.activation.value(z)
            h[:, : layer.linear] = z[:, : layer.linear]
        return h

    def padding_for(self, limit: np.ndarray, terms: np.ndarray | None = None) -> np.ndarray:
        """``padding`` of bounds over boxes with centres ``|v| <= limit``, ``(n,)``, of ``terms``; see ``measure``.

        Raises as the class does.
        """
        return np.array(measure([*self.hidden, self.output], limit, terms).padding)

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """Lower bounds of f over boxes of its inputs, ``(N, n)`` float64 corners, by the fused kernel."""
        return bound_boxes(self.kernel_shape(), self.packed, np.array(self.padding), lower, upper)

    def bound_plain(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The plain twin of ``bound`` in NumPy.

        Returns:
            ``(N,)`` certified lower bounds (float64 rounding subtracted), ``(N,)`` the axes whose halving should help
            most, and ``(N, n)`` the corners where the linear part is least.
        """
        center, radius = (lower + upper) / 2, (upper - lower) / 2
        mean, slope, noise = center, None, 0.0
        trace = []  # per hidden layer: parts, near, width of the arguments, slope, bend, spread
        for index, layer in enumerate(self.hidden):
            # With l = sum_k parts[k] zeta_k, |zeta_k| <= 1 and |l| <= near, the layer's output is
            # h = mean + slope l + bend (l^2 - near^2 / 2) + y; y and the parabola together are at most ``noise``, which
            # goes through the next layer in absolute value.
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
        # Backwards: lines and parabolas are weighed by the output's coefficients. What the neurons' spreads cost is
        # charged to the inputs whose width causes it (score).
        n = center.shape[1]
        coefficient = np.broadcast_to(self.output.weight[0], slope.shape)
        score, square = np.zeros_like(center), np.zeros((len(center), n, n))
        for index, (parts, near, width, slope, bend, spread) in reversed(list(enumerate(trace))):
            loss, curved = np.abs(coefficient) * spread, coefficient * bend
            least -= loss.sum(axis=1) + (curved * near * near / 2).sum(axis=1)
            least -= SQUARES_ROUNDING * (np.abs(curved) * near * near).sum(axis=1)
            for k in range(n):
                score[:, k] += (loss / width * np.abs(parts[k])).sum(axis=1)
                for m in range(n):
                    square[:, k, m] += (curved * parts[k] * parts[m]).sum(axis=1)
            coefficient = (coefficient * slope) @ self.hidden[index].weight
        corner = np.where(coefficient > 0, lower, upper)
        # Over |zeta| <= 1, entries of the quadratic form off the diagonal count in absolute value. The least of
        # -tilt |zeta| + up zeta^2 is at zeta = tilt / (2 up) if that is less than 1, else at the end.
        tilt, size = np.abs(coefficient * radius), np.abs(square)
        diagonal = np.einsum("bkk->bk", square)
        score += size.sum(axis=2)
        least -= size.sum(axis=(1, 2)) - np.maximum(diagonal, 0).sum(axis=1)
        up = np.maximum(diagonal, 0)
        inner = -(tilt**2) / (4 * np.where(up > 0, up, 1.0))
        least += np.where(tilt < 2 * up, inner, up - tilt).sum(axis=1)
        return least, np.argmax(score, axis=1), corner
