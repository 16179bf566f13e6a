"""A trained network as a shape: where its value reaches a level, with boxes certified by the bounds of networks.

The bounds are those that proofs of bounders use (``ExactNetwork.bound``), of the network and of its negative: a box is
empty where no value reaches the level, and lies in the object where every value does.
"""

import hashlib
from collections.abc import Iterable, Iterator
from functools import cached_property
from typing import Any

import numpy as np

from warp_bounding.activations import RELU, SINE, Activation
from warp_bounding.errors import BounderError, ShapeError
from warp_bounding.networks.network import Layer
from warp_bounding.networks.network import Network as ExactNetwork
from warp_bounding.shapes.formula import Formula
from warp_bounding.shapes.shape import IN, OUT, UNDECIDED, HalfSpaces, checked_corners, checked_number

# The modules of a trained network as layers that bounds are known for, without importing the library it was made with.
#
# Affine modules and activations take turns, from an affine one to another.

# By the name of the module's class; a class of one's own is added here under its name.
MODULES: dict[str, Activation] = {"ReLU": RELU, "Sine": SINE, "Sin": SINE}
AFFINE, NESTED = frozenset({"Linear"}), frozenset({"Sequential"})


def layers_of(sequential: Iterable, ndim: int, name: str) -> tuple[list[Layer], Layer]:
    """Hidden layers and the output of a ``Sequential``: modules of ``MODULES`` and affine ones, nested ones unrolled.

    Weights are float64 copies. Raises ``ShapeError`` for other modules or another order of them, sizes that do not fit,
    several outputs, or weights that are not finite.
    """
    steps, layers, size = list(_steps(sequential, name)), [], ndim
    if len(steps) % 2 == 0 or not all(isinstance(step, tuple) == (i % 2 == 0) for i, step in enumerate(steps)):
        raise ShapeError(f"{name}: expected affine modules with one activation between each two, and affine ends")
    for (weight, bias), activation in zip(steps[::2], [*steps[1::2], None], strict=True):
        if weight.shape[1] != size:
            raise ShapeError(f"{name}: expected an affine module of {size} inputs, got {weight.shape[1]}")
        size = len(bias)
        layers.append(Layer(weight, bias, activation))
    if size != 1:
        raise ShapeError(f"{name}: expected a network with one output, got {size}")
    if len(layers) < 2:
        raise ShapeError(f"{name}: expected a network with an activation at least")
    return layers[:-1], layers[-1]


def _steps(sequential: Iterable, name: str) -> Iterator[tuple[np.ndarray, np.ndarray] | Activation]:
    try:
        modules = list(sequential)
    except TypeError:
        modules = []
    if not modules:
        raise ShapeError(f"{name}: expected a Sequential of modules, got {type(sequential).__name__}")
    for module in modules:
        kind = type(module).__name__
        if kind in NESTED:
            yield from _steps(module, name)
        elif kind in AFFINE:
            yield _affine(module, name)
        elif kind in MODULES:
            yield MODULES[kind]
        else:
            raise ShapeError(f"{name}: expected modules {', '.join([*AFFINE, *MODULES])}, got {kind}")


def _affine(module: Any, name: str) -> tuple[np.ndarray, np.ndarray]:
    """``(H, K)`` weight and ``(H,)`` bias."""
    weight = _numbers(module.weight)
    bias = np.zeros(len(weight)) if module.bias is None else _numbers(module.bias)
    if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
        raise ShapeError(f"{name}: expected finite weights, got some that are not")
    return weight, bias


def _numbers(parameter: Any) -> np.ndarray:
    """A copy: training that goes on must not change a shape."""
    return np.array(parameter.detach().cpu().double().numpy(), dtype=np.float64)


TRIES = 64  # points at which a network must give its own values
# What its own values may differ by, in units of E, which bounds the rounding of float32 and of the kernels' activations
TOLERANCE = 16.0


class Network(Formula):
    """The points of a box where a network's value is at least ``level``.

    The object is that of the exact network with the given weights: what float32 rounds in your own evaluation is not a
    part of it. Points whose value is within float64 rounding of the level are undecided, and count as object.

    Args:
        sequential: A ``torch.nn.Sequential`` of ``Linear``, ``ReLU`` and modules of classes named ``Sine`` or
            ``Sin`` (``sin z``) in turns, n inputs and one output, ``Linear`` at both ends. The weights are copied. A
            class of your own is registered in ``warp_bounding.networks.network_shape.MODULES``.
        lower: ``(n,)``, lower corner of the box that bounds the object.
        upper: ``(n,)``, upper corner, above the lower one in each coordinate.
        level: Of the network's value.
        name: For people.
        note: A restriction that a user should know.
        time: Whether coordinate 0 is time.

    Raises:
        ShapeError: For other modules, sizes that do not fit, a network that computes something else than these
            modules do, corners that are none, or arguments of a sine beyond the range in which it is certified.

    Example:
        >>> from torch.nn import Linear, ReLU, Sequential
        >>> network = Sequential(Linear(2, 2), ReLU(), Linear(2, 1)).requires_grad_(False)
        >>> _ = network[0].weight.copy_(network[0].weight.new_tensor([[1, 0], [0, 1]])), network[0].bias.zero_()
        >>> _ = network[2].weight.fill_(1), network[2].bias.fill_(-1)  # relu(x) + relu(y) - 1
        >>> corner = wb.shapes.Network(network, [-1, -1], [1, 1])
        >>> corner.contains(np.array([[0.75, 0.75], [0.25, 0.25]]))
        array([ True, False])
        >>> corner.empty(np.array([[-1.0, -1.0]]), np.array([[0.0, 0.5]]))
        array([ True])
    """

    def __init__(
        self,
        sequential: Iterable,
        lower,
        upper,
        *,
        level: float = 0.0,
        name: str = "network",
        note: str = "",
        time: bool = False,
    ):
        self.name, self.note, self.time = name, note, bool(time)
        self._bounds = np.array(checked_corners(lower, upper, name))
        self.level = checked_number(level, "level", name, least=-np.inf)
        hidden, output = layers_of(sequential, self.ndim, name)
        self.identified = all(layer.activation in (RELU, SINE) for layer in hidden)  # others are code that may change
        minus = Layer(-output.weight, -output.bias, None)
        limit = np.abs(self._bounds).max(axis=0)
        try:
            self._networks = [ExactNetwork([*hidden, each], None, limit) for each in (output, minus)]
        except BounderError as error:
            raise ShapeError(f"{name}: {error}") from error
        self._compare(sequential)

    def _compare(self, sequential: Iterable) -> None:
        """Refuse a network that computes something else than its modules tell."""
        x = np.random.default_rng(0).uniform(*self._bounds, (TRIES, self.ndim))
        try:
            given = next(iter(sequential.parameters())).new_tensor(x.tolist())
            found = sequential(given).detach().cpu().double().numpy()[:, 0]
        except (AttributeError, StopIteration, TypeError):  # modules that are no network that can be asked
            return
        network = self._networks[0]
        apart = np.abs(found - network(given.detach().cpu().double().numpy()))
        if not (apart <= TOLERANCE * network.rounding).all():
            row = int(np.argmax(apart))
            own = network(x[row : row + 1])[0]
            raise ShapeError(
                f"{self.name}: expected a network that computes what its modules tell, {own:g} at {x[row].tolist()}, "
                f"got {found[row]:g}"
            )

    # --- what a shape answers ----------------------------------------------------------------------------------------

    @property
    def lower(self) -> np.ndarray:
        return self._bounds[0].copy()

    @property
    def upper(self) -> np.ndarray:
        return self._bounds[1].copy()

    @property
    def sample_lower(self) -> np.ndarray:
        return self.lower  # the region ends at its box: what lies beyond is told without a bounder

    @property
    def sample_upper(self) -> np.ndarray:
        return self.upper

    @property
    def rounding(self) -> float:
        """By how much any float32 evaluation of the network may differ from its exact value, activations included."""
        return self._networks[0].rounding

    @cached_property
    def geometry(self) -> str:
        """SHA-256 of the box, the level and the weights."""
        sha = hashlib.sha256(b"warp-bounding network 1")
        sha.update(np.append(self._bounds, self.level).astype("<f8").tobytes() + bytes([self.time]))
        network = self._networks[0]
        for layer in (*network.hidden, network.output):
            sha.update(f"{layer.weight.shape} {layer.activation and layer.activation.name};".encode())
            sha.update(layer.weight.astype("<f8").tobytes() + layer.bias.astype("<f8").tobytes())
        return sha.hexdigest()

    def decide(self, x: np.ndarray) -> np.ndarray:
        x = np.asarray(x, dtype=np.float64)
        found = np.full(len(x), OUT, dtype=np.uint8)
        left = np.flatnonzero(((x >= self._bounds[0]) & (x <= self._bounds[1])).all(axis=1))
        low = self._least(0, x[left], x[left]) >= self.level
        found[left[low]] = IN
        left = left[~low]
        found[left[~(self._least(1, x[left], x[left]) > -self.level)]] = UNDECIDED
        return found

    def empty(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        real = (np.isfinite(lower) & np.isfinite(upper) & (lower <= upper)).all(axis=1)
        low, high = self._cut(lower, upper)
        found = real & (low > high).any(axis=1)
        left = real & ~found
        found[left] = self._least(1, low[left], high[left]) > -self.level
        return found

    def half_spaces(self, lower: np.ndarray, upper: np.ndarray) -> HalfSpaces:
        low, high = self._cut(lower, upper)
        outside = (low > high).any(axis=1)
        low[outside], high[outside] = self._bounds
        # The bound of the negative, least + slope . (x - center), is at most -level where the value reaches the level.
        bounds = self._networks[1].bound(low, high)
        loss = bounds.value - bounds.lower
        level = np.nextafter(-bounds.level - self.level, np.inf)
        empty = outside | (bounds.lower > -self.level)
        return HalfSpaces(empty, (low + high) / 2, level, -bounds.slope, bounds.axis, loss)

    def inside(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        within = ((lower >= self._bounds[0]) & (upper <= self._bounds[1]) & (lower <= upper)).all(axis=1)
        within[within] = self._least(0, lower[within], upper[within]) >= self.level
        return within

    def _cut(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The parts of boxes in the box that holds the object, float64."""
        return np.maximum(lower, self._bounds[0]), np.minimum(upper, self._bounds[1])

    def _least(self, which: int, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Certified lower bounds over boxes: of the network (0) or of its negative (1)."""
        return self._networks[which].bound(lower, upper).lower if len(lower) else np.zeros(0)

    def dilated(self, margin: float) -> "Network":
        """Itself for a margin of 0; a network tells no distances.

        Raises:
            ShapeError: For any other margin.
        """
        if self._new_margin(margin) is not None:
            raise ShapeError(
                f"{self.name}: a shape is dilated by its distance, and a network's value is none, got margin={margin}; "
                "give a lower level"
            )
        return self
