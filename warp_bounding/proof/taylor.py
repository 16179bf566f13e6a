"""Bounds of networks for ``certify``: Taylor polynomials and the mean value theorem, not the search's mathematics.

Each activation is replaced by its Taylor polynomial at the box's centre, of second degree in the box's coordinates
zeta. What a polynomial leaves out is small of third order; it changes f by as much, times the derivative of all layers
behind it somewhere between polynomial and activation (mean value theorem). That derivative is known at the centre, and
what it gains is followed layer by layer: a linear function, and a bound of the rest. So f is one polynomial of third
degree, in which the terms of all neurons cancel, and a rest of fourth order. The search (``networks.bounds``) fits
curves to intervals instead, and its bands are carried by linear coefficients. Neither text uses any of the other, nor
does this one its rounding (``Network.padding``). A network has its bounds as a field (``Network.bounds``), so they are
the same in every process.

Source: R. E. Moore, *Methods and Applications of Interval Analysis*, 1979, on mean value forms.
"""

import operator
from functools import cache
from typing import Any

import numpy as np
import warp as wp

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.errors import BounderError
from warp_bounding.networks.bounds import BLOCK, BoxBounds, NetworkShape, around, double_array
from warp_bounding.networks.bounds import text as lanes
from warp_bounding.networks.network import Network, SearchBounds
from warp_bounding.rounding import UNIT64, gamma
from warp_bounding.runtime.launch import launch_blocks
from warp_bounding.runtime.native import constants, fill, named, native_text, unique_name
from warp_bounding.shapes.shape import Shape

text = native_text("taylor.h")

# Text, whether it bends, and the least derivative; the largest is 1.
ACTIVATIONS = {"sin": (text.SINE, True, -1), "relu": (text.RELU, False, 0)}
# A polynomial of a bounded activation is kept where what it leaves out is at most 1. So |u| < 3, and its absolute terms
# are less than 1 + 3 + 3^2 / 2 + 1 together.
TERMS = 16.0


class TaylorBounds:
    """Bounds of networks over boxes; see module."""

    def given_to(self, made: Any) -> Any:
        """A bounder or a shape as a copy whose networks, however deep in it, have these bounds; itself if it has none.

        They keep them wherever they are sent, other processes included.
        """
        if isinstance(made, Network):
            return made.bounded_by(self)
        if isinstance(made, list | tuple):
            held = [self.given_to(each) for each in made]
            return made if all(map(operator.is_, held, made)) else held
        if not isinstance(made, Bounder | Shape):
            return made
        changed = {name: held for name, value in vars(made).items() if (held := self.given_to(value)) is not value}
        if not changed:
            return made
        found = object.__new__(type(made))
        vars(found).update(vars(made) | changed)
        if isinstance(made, Bounder):
            found.network_bounds = self
        return found

    def boxes(self, network: Network, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """Certified lower bounds over boxes ``(N, n)`` of a network's inputs; see ``Network.bound``.

        Raises:
            BounderError: If arguments of an activation can leave the range in which it is certified.
        """
        if not _known(network):
            return SearchBounds().boxes(network, lower, upper)
        count, size = lower.shape
        device = wp.get_device("cpu")
        held = [np.concatenate([lower, upper], axis=1), network.packed, roundings(network)]
        held = [np.ascontiguousarray(each, dtype=np.float64) for each in held]
        boxes, *parameters = (double_array(each, device) for each in held)
        sizes = (count, count, count, count * size, count * size)
        outputs = [wp.empty(each, dtype=wp.float64, device=device) for each in sizes]
        axis = wp.empty(count, dtype=wp.int32, device=device)
        if count:
            inputs = [boxes, count, 0, *parameters]
            launch_blocks(
                _kernel(network.kernel_shape()), count, inputs, [*outputs, axis], device, first_index=2, block=BLOCK
            )
        least, value, level, point, slope = (each.numpy() for each in outputs)
        point, slope = point.reshape(count, size), slope.reshape(count, size)
        return BoxBounds(least, axis.numpy(), point, value, None, slope, level)

    def corners(self, network: Network, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Linear bounds under f, as their values at the corners of boxes; see ``Network.corners``."""
        if not _known(network):
            return SearchBounds().corners(network, lower, upper)
        bounds, n = self.boxes(network, lower, upper), lower.shape[1]
        up = (np.arange(1 << n)[:, None] >> np.arange(n)) & 1
        moved = bounds.slope * ((upper - lower) / 2)
        size = (
            np.abs(bounds.level)
            + np.abs(moved).sum(axis=1)
            + (np.abs(bounds.slope) * np.abs(lower + upper)).sum(axis=1)
        )
        return (bounds.level - size * 1e-12)[:, None] + moved @ (2.0 * up - 1.0).T


def _known(network: Network) -> bool:
    """Whether there are bounds here: activations that users have registered are bounded as the search does it."""
    return all(layer.activation.name in ACTIVATIONS for layer in network.hidden)


def roundings(network: Network) -> np.ndarray:
    """Above what float64 rounds in an argument of each layer, and in the output: of a sum of K products of polynomials.

    Raises ``BounderError`` if arguments of an activation can leave the range in which it is certified.
    """
    limit = network.limit
    pads, size, terms, operations = [], limit, limit, 256
    for layer in [*network.hidden, network.output]:
        weight, kept = np.abs(layer.weight), layer.activation
        total, largest = (weight @ each + np.abs(layer.bias) for each in (terms, size))
        operations += 8 * sum(weight.shape)  # those of all layers below too: each loss is taken from one sum
        pads.append(gamma(operations, UNIT64) * (float(total.max()) + 16.0))
        if kept is None:
            break
        if not (largest <= kept.limit).all():
            raise BounderError(
                f"arguments of {kept.name} reach {largest.max():.3g}, it is certified up to {kept.limit}"
            )
        bounded = kept.largest is not None
        terms, size = (
            (np.full(len(total), TERMS), np.full(len(total), kept.largest)) if bounded else (2 * total, largest)
        )
    return np.array(pads)


# --- the kernel ------------------------------------------------------------------------------------------------------


def _body(shape: NetworkShape) -> str:
    places, n = [0], shape.ndim  # where each layer's numbers begin
    for inputs, neurons, _ in shape.layers:
        places.append(places[-1] + neurons * (2 * inputs + 1))
    layers, values = text.OUTPUT, text.OUTPUT_VALUE
    for index, (inputs, neurons, name) in reversed(list(enumerate(shape.layers))):
        flags = {"BENT": any(ACTIVATIONS[each[2]][1] for each in shape.layers[:index]), "BENDS": ACTIVATIONS[name][1]}
        flags |= {"AT": places[index], "LEAST": ACTIVATIONS[name][2]}
        own = constants(INPUTS=inputs, NEURONS=neurons, **flags) + " ".join(f"(void){each};" for each in flags)
        tools = f"auto& taylor = taylor_{name}; const double pad = pads[{index}];"
        tools += " const double* const x = w + AT + NEURONS; (void)x;"
        forwards, backwards = f"{{{text.FORWARDS}}}\n", f"{{{text.BACKWARDS}}}\n"
        layers = f"{{ {own} {tools}{text.LAYER}{forwards}{layers}{backwards}}}\n"
        values = f"{{ {own} auto& act = act_{name};{fill(text.VALUES, then=values)}}}\n"
    sizes = {"LINES": 1 + n, "SQUARES": n * (n + 1) // 2, "CUBES": n * (n + 1) * (n + 2) // 6}
    sizes |= {"LAYERS": len(shape.layers), "LAST": shape.layers[-1][1], "AT_OUTPUT": places[-1]}
    texts = {"product": text.PRODUCT, "layers": layers, "close": text.CLOSE, "values": values}
    return constants(C=n, **sizes) + fill(text.BODY, **texts)


def _snippet(shape: NetworkShape) -> str:
    tools = "const double* w = weights.data; const double* pads = paddings.data;\n"
    tools += "auto absolute = [&](V x) { return x < zero ? -x : x; };\n"
    tools += "".join(ACTIVATIONS[name][0] for name in sorted({layer[2] for layer in shape.layers}))
    cpu = f"{lanes.CPU}\n{constants(L=8)}{lanes.VECTORS}{tools}"
    return around(shape, cpu, lanes.CUDA + tools, _body(shape), text.STORE)


@cache
def _kernel(shape: NetworkShape) -> wp.Kernel:
    name = named(unique_name(shape, "taylor"))

    @name.block_kernel(_snippet(shape))
    def taylor_all(
        boxes: wp.array(dtype=wp.float64),
        count: int,
        block: int,
        weights: wp.array(dtype=wp.float64),
        paddings: wp.array(dtype=wp.float64),
        least_out: wp.array(dtype=wp.float64),
        value_out: wp.array(dtype=wp.float64),
        level_out: wp.array(dtype=wp.float64),
        point: wp.array(dtype=wp.float64),
        slope_out: wp.array(dtype=wp.float64),
        axes: wp.array(dtype=wp.int32),
    ): ...

    return taylor_all
