"""A small network as numbers: layers, their exact evaluation, the rounding of any float32 evaluation, bounds over boxes.

Hidden layer: ``h' = act(W h + b)``, act the sine, ReLU or tanh; the output is linear. An optional positional encoding puts
fixed features ``[v, sin(F v + g)]`` before the first layer; it is a sine layer whose first rows pass ``v`` through.

Bounds use one linear relaxation per neuron with the *same* slope on both sides, ``act(z) in s (z - m) + [c - e, c + e]``
for ``|z - m| <= d`` (a zonotope's; Singh et al., *Fast and Effective Robustness Certification*, 2018). With equal slopes
layers compose exactly: only the half-widths e remain. For the output they are carried back through the actual
coefficients (backward substitution, as in CROWN, Zhang et al. 2018); for pre-activations behind the second hidden layer
through absolute values. Any slope is sound; tightness alone depends on it.
"""

from dataclasses import dataclass

import numpy as np

from warp_bounding.arithmetic import LARGEST, SINE_LIMIT, TINY, UNIT64, gamma, sine_error, tanh_error
from warp_bounding.bounders.network_kernel import bound_boxes
from warp_bounding.bounders.network_source import SINE_SLACK, NetworkSizes
from warp_bounding.bounders.tanh_relaxation import relax_tanh
from warp_bounding.errors import BounderError

__all__ = ["ACTIVATIONS", "Network"]

ACTIVATIONS = ("sin", "relu", "tanh")
FUNCTIONS = {"sin": np.sin, "relu": lambda z: np.maximum(z, 0.0), "tanh": np.tanh}


@dataclass(frozen=True)
class Layer:
    """``z = W h + b`` in float64, and what is applied to z: per neuron, ``linear`` rows pass through."""

    weight: np.ndarray
    bias: np.ndarray
    activation: str
    linear: int = 0  # this many leading rows are passed through


class Network:
    """Exact twin of a stored network; weights are float32 numbers held in float64.

    Args:
        layers: ``[(weight (H, K), bias (H,)), ...]``, the last one the scalar output.
        activation: ``"sin"``, ``"relu"`` or ``"tanh"``, of the hidden layers.
        encoding: ``(weight (F, n), bias (F,))`` of the positional encoding, or ``None``.
        limit: ``(n,)``, largest ``|v|`` that is ever asked for.
        error: ``(n,)``, what computing an input rounds; 0 if ``None``.

    Attributes:
        rounding: E, error of any float32 evaluation.
        largest: Bound of ``|f|``.

    Raises:
        BounderError: If an argument of a sine can leave the range in which the kernels' sine is certified.
    """

    def __init__(self, layers, activation: str, encoding, limit: np.ndarray, error: np.ndarray | None = None):
        self.limit = np.asarray(limit, dtype=np.float64)
        self._input_error = np.zeros_like(self.limit) if error is None else np.asarray(error, dtype=np.float64)
        stack = []
        if encoding is not None:
            n = len(self.limit)
            weight = np.concatenate([np.eye(n), np.asarray(encoding[0], dtype=np.float64)])
            bias = np.concatenate([np.zeros(n), np.asarray(encoding[1], dtype=np.float64)])
            stack.append(Layer(weight, bias, "sin", linear=n))
        for weight, bias in layers[:-1]:
            stack.append(Layer(weight.astype(np.float64), bias.astype(np.float64), activation))
        self.hidden = stack
        self.output = Layer(layers[-1][0].astype(np.float64), layers[-1][1].astype(np.float64), "none")
        self._measure()
        layers = tuple((x.weight.shape[1], x.weight.shape[0], x.activation, x.linear) for x in self.hidden)
        self._sizes = NetworkSizes(len(self.limit), layers)
        parts = [part for x in self.hidden for part in (x.bias, x.weight.reshape(-1), np.abs(x.weight).reshape(-1))]
        self._packed = np.concatenate([*parts, self.output.bias, self.output.weight[0]])

    def __call__(self, v: np.ndarray) -> np.ndarray:
        """``f`` of ``(N, n)`` float64 coordinates, ``(N,)`` float64."""
        h = np.asarray(v, dtype=np.float64)
        for layer in self.hidden:
            z = h @ layer.weight.T + layer.bias
            h = FUNCTIONS[layer.activation](z)
            h[:, : layer.linear] = z[:, : layer.linear]
        return (h @ self.output.weight.T + self.output.bias)[:, 0]

    def _measure(self) -> None:
        """Walk through the layers once: magnitudes, float32 rounding (E) and float64 rounding of the bounds."""
        size, error = (
            self.limit.copy(),
            self._input_error.copy(),
        )  # of h: largest absolute value; error of the computed h
        self.padding = []  # per layer: float64 rounding of anything that `bound` computes there
        operations, chain = 16, self.limit.copy()  # chain: sums of absolute terms, activations of slope 1 in between
        for index, layer in enumerate([*self.hidden, self.output]):
            terms = len(layer.weight[0])
            weight = np.abs(layer.weight)
            largest = weight @ size + np.abs(layer.bias)
            computed = weight @ (size + error) + np.abs(layer.bias)
            flushed = (
                2 * terms + 2 + (size + error).sum() + weight.sum(axis=1)
            ) * TINY  # a factor or a result set to zero
            rounding = weight @ error + gamma(terms + 2) * computed + flushed
            if not ((computed + rounding) < LARGEST).all():
                raise BounderError(
                    f"values of layer {index} can reach {float(computed.max()):.3g}, float32 sums may overflow"
                )
            operations += 4 * terms + 32
            chain = weight @ chain + largest + 1.0
            self.padding.append(gamma(operations, UNIT64) * (float(chain.max()) + 4.0))
            if layer.activation == "none":
                self.rounding, self.largest = float(rounding[0]) * (1 + 1e-6), float(largest[0]) * (1 + 1e-6)
                break
            argument = float((largest + rounding)[layer.linear :].max(initial=0.0))
            if layer.activation == "sin":
                if not argument <= SINE_LIMIT:
                    where = "encoding" if layer.linear else f"hidden layer {index}"
                    raise BounderError(
                        f"{where}: arguments of the sine reach {argument:.3g}, it is certified up to {SINE_LIMIT}"
                    )
                error = rounding + sine_error(argument)
                size = np.ones_like(largest)
            elif layer.activation == "tanh":
                error, size = rounding + tanh_error(), np.ones_like(largest)
            else:
                error, size = rounding, largest
            error[: layer.linear] = 0.0  # copied, not computed
            size[: layer.linear] = self.limit[: layer.linear]

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, ...]:
        """Lower bounds of f over boxes, by the fused kernel (``bound_plain`` is its twin).

        Args:
            lower: ``(N, n)`` float64.
            upper: ``(N, n)`` float64.

        Returns:
            ``(N,)`` certified lower bounds (float64 rounding subtracted), ``(2, N)`` axes whose halving should help most, now
            and after that, ``(N, n)`` the corner where the linear part is least, ``(N,)`` f there, and ``(N, n)`` the slopes of
            that linear part: ``f >= least + sum_k |slope_k| radius_k + slope . (v - center)`` on the box.
        """
        return bound_boxes(self._sizes, self._packed, np.array(self.padding), lower, upper)

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
        mean, slope, spread, noise = center, None, None, 0.0
        trace = []  # per hidden layer: |d z / d v_k| for each k, half-width of z, slope, spread
        for index, layer in enumerate(self.hidden):
            # h = mean + slope * (sum_k part_k (v_k - center_k) + noise) + e with |e| <= spread; noise is bounded entry by entry
            z = mean @ layer.weight.T + layer.bias
            if index == 0:
                parts = list(layer.weight.T)
            else:
                parts = [(part * slope) @ layer.weight.T for part in parts]
                noise = (np.abs(slope) * noise + spread) @ np.abs(layer.weight).T
            rates = [np.abs(part) for part in parts]
            width = sum(rate * radius[:, k, None] for k, rate in enumerate(rates)) + noise + self.padding[index]
            slope, mean, spread = relax(z, width, layer.activation)
            slope[:, : layer.linear], mean[:, : layer.linear], spread[:, : layer.linear] = (
                1.0,
                z[:, : layer.linear],
                0.0,
            )
            spread += self.padding[index]
            trace.append((rates, width, slope, spread))
        least = mean @ self.output.weight[0] + self.output.bias[0] - self.padding[-1]
        # Backwards: what each neuron's relaxation costs the output, and whose fault it is.
        coefficient = np.broadcast_to(self.output.weight[0], slope.shape)
        score = np.zeros_like(radius)
        for index, (rates, width, slope, spread) in reversed(list(enumerate(trace))):
            loss = np.abs(coefficient) * spread
            least -= loss.sum(axis=1)
            share = loss / width
            for k, rate in enumerate(rates):
                score[:, k] += (share * rate).sum(axis=1)
            coefficient = (coefficient * slope) @ self.hidden[index].weight
        least -= (np.abs(coefficient) * radius).sum(axis=1)
        return least, np.argmax(score * radius, axis=1), np.where(coefficient > 0, lower, upper)


def relax(z: np.ndarray, width: np.ndarray, activation: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Linear relaxation of an activation, one slope on both sides.

    ReLU: the chord. Sine, with ``x = z + t``, ``|t| <= d``: ``sin x = sin z cos t + cos z sin t``. By Taylor, for all t >= 0,
    ``1 - t^2/2 <= cos t <= 1`` and ``t - t^3/6 <= sin t <= t - t^3/6 + t^5/120``. So cos t lies within ``d^2/4`` of ``1 - d^2/4``,
    and sin t within ``d^3 / (9 sqrt 3) + d^5 / 120`` of ``t (1 - d^2/6)``, as ``t (d^2 - t^2) / 6 <= d^3 / (9 sqrt 3)``. Where this is
    worse than ``[-1, 1]``, the latter is taken.

    Tanh: see ``tanh_relaxation``.

    Args:
        z: ``(N, H)``, centres.
        width: ``(N, H)``, half-widths d > 0.
        activation: ``"sin"``, ``"relu"`` or ``"tanh"``.

    Returns:
        slope, mean, spread with ``act(x) in slope (x - z) + mean +- spread``; float64 rounding is the caller's.
    """
    if activation == "relu":
        low, high = z - width, z + width
        slope = np.clip(high / (2 * width), 0.0, 1.0)
        spread = np.where((low < 0) & (high > 0), -slope * low / 2, 0.0)
        return slope, slope * z + spread, spread
    if activation == "tanh":
        return relax_tanh(z, width)
    sine, cosine, square = np.sin(z), np.cos(z), width * width
    spread = (
        np.abs(cosine) * (width * square * (1 / (9 * np.sqrt(3.0)) + square / 120))
        + np.abs(sine) * (square / 4)
        + 4 * SINE_SLACK
    )
    slope, mean = cosine * (1 - square / 6), sine * (1 - square / 4)
    wide = spread > 1
    slope[wide], mean[wide], spread[wide] = 0.0, 0.0, 1.0
    return slope, mean, spread
