"""The activations of hidden layers, one entry each: all that inference, rounding and bounds ask of one, looked up by its name.

What training asks besides, in torch, stands in ``training.activations`` under the same names. An activation has slopes from
-1 to 1: rounding and bounds are passed on through it undiminished.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from warp_bounding.activations.sine_relaxation import relax_sin, sine_text
from warp_bounding.activations.tanh_relaxation import relax_tanh, tanh_text
from warp_bounding.arithmetic import SINE_LIMIT, sine_error, tanh_error
from warp_bounding.errors import BounderError
from warp_bounding.kernels.source import Lanes

__all__ = ["ACTIVATIONS", "SINE", "Activation", "check_activation"]


@dataclass(frozen=True)
class Activation:
    """What a hidden layer applies to each of its sums.

    Attributes:
        name: As users and files say it.
        value: Of arrays, as exactly as their type allows.
        statement: Called with ``Lanes``, a target and an argument: the C statement of inference, float32.
        error: Of arguments up to a size: bound of ``|computed - true|`` in float32, fused or not.
        relax: ``(z, near, noise) -> slope, mean, bend, spread``, each ``(N, H)``: the activation at ``z + l + y``, ``|l| <= near`` and
            ``|y| <= noise``, is ``mean + slope (l + y) + bend l^2`` to within ``spread``. Float64 rounding is the caller's. Of near and noise
            together one is above 0.
        text: C lambdas ``act_<name>(z)`` and ``relax_<name>(z, near, noise, slope, mean, bend, spread)``, the same in the kernel of bounds.
        monotone: Name of what a monotone network has in its place; its own if it never falls.
        limit: Largest argument up to which ``error`` holds.
        largest: Of the value's size; that of the argument if ``None``.
        bends: Whether ``relax`` may bend.
    """

    name: str
    value: Callable[[np.ndarray], np.ndarray]
    statement: Callable[[Lanes, str, str], str]
    error: Callable[[float], float]
    relax: Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, ...]]
    text: Callable[[], str]
    monotone: str
    limit: float = np.inf
    largest: float | None = None
    bends: bool = False


def _relax_relu(z: np.ndarray, near: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, ...]:
    """The chord, and half of what the corner lies under it."""
    width = near + noise
    low, high = z - width, z + width
    slope = np.clip(high / (2 * width), 0.0, 1.0)
    spread = np.where((low < 0) & (high > 0), -slope * low / 2, 0.0)
    return slope, slope * z + spread, np.zeros_like(z), spread


def _relu_text() -> str:
    return """
auto relax_relu = [&](V z, V near, V noise, V& slope, V& mean, V& bend, V& spread) {
    const V d = near + noise; const V low = z - d; const V high = z + d; V s = high / (d + d);
    s = s < zero ? zero : s; s = s > zero + 1.0 ? zero + 1.0 : s;
    V e = s * low * -0.5; e = low < zero ? e : zero; e = high > zero ? e : zero;
    slope = s; mean = s * z + e; bend = zero; spread = e;
};
auto act_relu = [&](V z) { return z > zero ? z : zero; };
"""


_ALL = (
    Activation(
        name="sin",
        value=np.sin,
        statement=Lanes.sine,
        error=sine_error,
        relax=relax_sin,
        text=sine_text,
        monotone="tanh",
        limit=SINE_LIMIT,
        largest=1.0,
        bends=True,
    ),
    Activation(
        name="relu",
        value=lambda z: np.maximum(z, 0.0),
        statement=Lanes.relu,
        error=lambda _: 0.0,
        relax=_relax_relu,
        text=_relu_text,
        monotone="relu",
    ),
    Activation(
        name="tanh",
        value=np.tanh,
        statement=Lanes.tanh,
        error=lambda _: tanh_error(),
        relax=relax_tanh,
        text=tanh_text,
        monotone="tanh",
        largest=1.0,
    ),
)
ACTIVATIONS = {activation.name: activation for activation in _ALL}
SINE = ACTIVATIONS["sin"]  # of the positional encoding


def check_activation(name) -> str:
    """The name of an activation.

    Raises:
        BounderError: If there is none of this name.
    """
    if not isinstance(name, str) or name not in ACTIVATIONS:
        raise BounderError(f"activation must be one of {', '.join(ACTIVATIONS)}, got {name!r}")
    return name
