"""The modules of a trained network as layers that bounds are known for, without importing the library it was made with.

Layers have an activation each and a linear output. What is written otherwise is rewritten so that the exact value stays
the same: a logistic function is a tanh of half the number, ``(1 + tanh(z / 2)) / 2``; between two affine modules, and
before a single one, stands ``z = relu(z) - relu(-z)``; and where an activation has no affine module before or behind
it, there stands the number itself.
"""

import math
from collections.abc import Iterable, Iterator
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from warp_bounding.activations import ACTIVATIONS, SINE, Activation
from warp_bounding.arithmetic import UNIT64
from warp_bounding.errors import IndicatorError
from warp_bounding.networks.rounding import Layer

__all__ = ["MODULES", "Module", "layers_of"]

HALVED = 1e-300  # more than what halving subnormal weights loses: 5e-324 for each input, which are under 1e20


class Module(NamedTuple):
    """What a module that follows an affine one does to each number z: ``shift + outer activation(inner z)``.

    Attributes:
        activation: One of ``ACTIVATIONS``.
        inner: 1 or 1/2.
        outer: 1 or 1/2.
        shift: 0 or 1/2.
        mirrored: Whether ``outer activation(inner (-z))`` is subtracted.
    """

    activation: Activation
    inner: float = 1.0
    outer: float = 1.0
    shift: float = 0.0
    mirrored: bool = False


_RELU, _TANH = ACTIVATIONS["relu"], ACTIVATIONS["tanh"]
_SAME = Module(_RELU, mirrored=True)  # z = relu(z) - relu(-z)
# By the name of the module's class; a class of one's own is added here under its name.
MODULES: dict[str, Module] = {
    "ReLU": Module(_RELU),
    "Tanh": Module(_TANH),
    "Sigmoid": Module(_TANH, inner=0.5, outer=0.5, shift=0.5),
    "Sine": Module(SINE),
    "Sin": Module(SINE),
}
AFFINE, NESTED = frozenset({"Linear"}), frozenset({"Sequential"})


class _Affine(NamedTuple):
    """``(H, K)`` weight and ``(H,)`` bias, float64; of the identity, whose size the layer before it tells, ``None``."""

    weight: np.ndarray | None = None
    bias: np.ndarray | None = None


def layers_of(sequential: Iterable, ndim: int, name: str) -> tuple[list[Layer], Layer, list[float]]:
    """Hidden layers and the output of a ``Sequential`` of modules.

    Args:
        sequential: Modules in their order: affine ones (``Linear``) and those of ``MODULES``; nested ones are unrolled.
        ndim: Number of inputs.
        name: For messages.

    Returns:
        Hidden layers; the output, with one row; and of each, the output last, a bound of what its biases were rounded
        by. Weights are float64 copies.

    Raises:
        IndicatorError: For other modules, sizes that do not fit, several outputs, or weights that are not finite.
    """
    steps, layers, errors, size = _alternating(list(_steps(sequential, name))), [], [], ndim
    for index in range(0, len(steps), 2):
        weight, bias = steps[index] if steps[index].weight is not None else (np.eye(size), np.zeros(size))
        if weight.shape[1] != size:
            raise IndicatorError(f"{name}: expected an affine module of {size} inputs, got {weight.shape[1]}")
        size, error = len(bias), HALVED
        if index:
            weight, bias, error = _behind(steps[index - 1], weight, bias)
        if index + 1 == len(steps):
            layers.append(Layer(weight, bias, None))
        else:
            layers.append(_before(steps[index + 1], weight, bias))
        errors.append(error)
    if size != 1:
        raise IndicatorError(f"{name}: expected a network with one output, got {size}")
    return layers[:-1], layers[-1], errors


def _alternating(steps: list[_Affine | Module]) -> list[_Affine | Module]:
    """The same network, affine at both ends and at each other step between them."""
    found = [] if isinstance(steps[0], _Affine) else [_Affine()]
    for step, after in pairwise([*steps, None]):
        found.append(step)
        if isinstance(step, _Affine) and isinstance(after, _Affine):
            found.append(_SAME)
        elif isinstance(step, Module) and not isinstance(after, _Affine):
            found.append(_Affine())
    return found if len(found) > 1 else [_Affine(), _SAME, *found]


def _before(module: Module, weight: np.ndarray, bias: np.ndarray) -> Layer:
    """The affine map and the activation of a module behind it."""
    weight, bias = weight * module.inner, bias * module.inner
    if module.mirrored:
        weight, bias = np.concatenate([weight, -weight]), np.concatenate([bias, -bias])
    return Layer(weight, bias, module.activation)


def _behind(module: Module, weight: np.ndarray, bias: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """An affine map of an activation's values instead of the module's, and what its biases are rounded by."""
    error = HALVED
    if module.shift:
        exact = [[float(b), *(module.shift * row)] for b, row in zip(bias, weight, strict=True)]
        bias = np.array([math.fsum(terms) for terms in exact])  # the exact sum, rounded once
        error += float(np.abs(bias).max(initial=0.0)) * 2 * UNIT64
    weight = weight * module.outer
    return (np.concatenate([weight, -weight], axis=1) if module.mirrored else weight), bias, error


def _steps(sequential: Iterable, name: str) -> Iterator[_Affine | Module]:
    try:
        modules = list(sequential)
    except TypeError:
        modules = []
    if not modules:
        raise IndicatorError(f"{name}: expected a Sequential of modules, got {type(sequential).__name__}")
    for module in modules:
        kind = type(module).__name__
        if kind in NESTED:
            yield from _steps(module, name)
        elif kind in AFFINE:
            yield _affine(module, name)
        elif kind in MODULES:
            yield MODULES[kind]
        else:
            raise IndicatorError(f"{name}: expected modules {', '.join([*AFFINE, *MODULES])}, got {kind}")


def _affine(module: Any, name: str) -> _Affine:
    weight = _numbers(module.weight)
    bias = np.zeros(len(weight)) if module.bias is None else _numbers(module.bias)
    if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
        raise IndicatorError(f"{name}: expected finite weights, got some that are not")
    return _Affine(weight, bias)


def _numbers(parameter: Any) -> np.ndarray:
    """A copy: training that goes on must not change a shape."""
    return np.array(parameter.detach().cpu().double().numpy(), dtype=np.float64)
