"""Bounds of a network over boxes by one fused native kernel in float64, one box per SIMD lane: text and kernel.

A parametrization turns a box of numbers into the network's inputs, an affine function of ``zeta`` in [-1,
1]^columns and noise. A thread takes a block of boxes through all layers and back without leaving its cache. In the
forward pass each neuron is a cubic or a line (``activations``) in the linear part of its argument, plus a quadratic
form of zeta, plus noise. The backward pass weighs these relaxations by the output's actual coefficients and adds them
to one cubic polynomial of zeta, in which those of many neurons may cancel; only the bands around them count in absolute
value. For two layers of H neurons and C columns the arithmetic is ``(C (C + 1) / 2 + C + 5) H^2`` multiply-adds a box:
entries of the forms, their middle and half-range, centre, noise and columns forwards, one coefficient backwards; and
fewer than ``C^3 H`` of the polynomial. Sums may be taken in any order and fused: ``Network.padding`` and
``SQUARES_ROUNDING`` bound the float64 rounding of all of them. The relaxations include the error of the kernel's sine.

The C texts are in ``native/bounds.h``; ``body`` puts them together for the shape of a network and its parametrization.
K is the number of the network's inputs, Z that of a box's numbers, C that of the columns, the entries of zeta
(``Parametrization``).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from itertools import pairwise
from typing import ClassVar, NamedTuple

import numpy as np
import warp as wp

from warp_bounding.activations import activation_of
from warp_bounding.runtime.launch import launch_blocks
from warp_bounding.runtime.native import constant, constants, fill, named, native_text, unique_name

text = native_text("bounds.h")


class BoxBounds(NamedTuple):
    """Bounds of ``f`` over N boxes of m numbers: a query's coordinates, or entries of a plane's normal.

    Attributes:
        lower: ``(N,)`` float64, certified lower bounds.
        axis: ``(N,)`` int, the axis along which halving the box helps the bound most.
        point: ``(N, m)`` float64, a point of the box where ``f`` is likely to be least.
        value: ``(N,)`` float64, ``f`` there.
        next_axis: ``(N,)`` int, the axis to halve after ``axis``; this and the attributes below may be ``None``.
        slope: ``(N, m)``, networks only: ``f >= level + slope . (v - center)`` on the box. It bounds this very ``f``:
            bounds of another function that are derived from these must leave out ``slope`` and ``level``.
        level: ``(N,)``, networks only.
    """

    lower: np.ndarray
    axis: np.ndarray
    point: np.ndarray
    value: np.ndarray
    next_axis: np.ndarray | None = None
    slope: np.ndarray | None = None
    level: np.ndarray | None = None

    def part(self, rows: np.ndarray) -> "BoxBounds":
        """The bounds of some of the boxes."""
        return BoxBounds(*(each if each is None else each[rows] for each in self))


# How a box of numbers z becomes inputs of a network: ``center + generators zeta + noise``, ``|zeta| <= 1``.
#
# The boxes of a proof are of the inputs themselves, those of a walk along a segment of its parameter. A parametrization
# writes this down as C text over a type V (a box a SIMD lane on a CPU, a double on CUDA):
#
# * ``expand``: from ``V low[Z], high[Z]`` to ``V center[K]``, ``V gen[K]`` (of each input the one generator that is not
#   always zero) and ``V noise[K]`` (all that is left over, float64 rounding included);
# * ``project``: from numbers ``of[K]`` to ``V columns[C]``, the sums of each column's generators times them;
# * ``realize``: from the signs of ``V slope[C]`` to ``V z[Z]``, the corner where f looks lowest, and its inputs ``V
#   h[K]``.
#
# K, C and Z are constants: the numbers of inputs, of columns of generators, and of entries of z. ``absolute`` is a
# function of V.


@dataclass(frozen=True)
class Parametrization:
    """What the kernels need to know of a parametrization, by default that of the inputs themselves.

    Attributes:
        inputs: Inputs K of the network.
        noisy: Whether ``expand`` sets ``noise``; else it is 0.
        expand: C text, explained above.
        project: C text, explained above.
        realize: C text, explained above.
    """

    inputs: int

    noisy: ClassVar[bool] = False
    expand: ClassVar[str] = """
for (int k = 0; k < K; ++k) { center[k] = (low[k] + high[k]) * 0.5; gen[k] = (high[k] - low[k]) * 0.5; }
"""
    project: ClassVar[str] = "for (int k = 0; k < K; ++k) columns[k] = of[k] * gen[k];"
    realize: ClassVar[str] = "for (int k = 0; k < K; ++k) h[k] = z[k] = slope[k] > zero ? low[k] : high[k];"

    @property
    def size(self) -> int:
        """Numbers Z of a point z."""
        return self.inputs

    @property
    def columns(self) -> int:
        """Number C of coordinates zeta, and so of columns of the generators."""
        return self.inputs


BLOCK = 64  # boxes that a thread of the kernel works on, on a CPU; on CUDA it is one
# A box's second axis to halve is chosen as if its first were halved already. The score of that number z falls by this
# factor then: a relaxation's cost falls nearly with the square of a box's width, so a little more than 1/4.
HALVED = 0.3
# Relative to the sum of the absolute terms of the polynomial in zeta: above 4000 UNIT64, for up to 4000 neurons.
SQUARES_ROUNDING = 1e-12
# Weight of |rate| of the first layer (``LAYER``: the generators of a neuron's argument) in the score by
# which an axis is chosen: it decides only where all layers behind are saturated.
FIRST_LAYER = 1e-9
ROWS = 4  # neurons that share each input as it is loaded
# The largest middle of a quadratic form around which the sine is taken (``NEURON``, ``SINE_LIMIT``).
LARGEST_MIDDLE = 1.0
MANY, FEW = 28, 12  # sums that are kept at a time, of the 32 vector registers of AVX-512, and of 16


@dataclass(frozen=True)
class NetworkShape:
    """What a kernel of bounds is compiled for: of each hidden layer inputs, neurons, activation.

    ``ndim`` are the inputs K of the network, as many as the parametrization has.
    """

    ndim: int
    layers: tuple[tuple[int, int, str], ...]
    parametrization: Parametrization

    name = "network_bound"


def lanes_text(shape: NetworkShape, inputs: str) -> tuple[str, str]:
    """C text before ``body``, for CPU and for CUDA: types, the arrays' names (``inputs``) and tools."""
    names = sorted({layer[2] for layer in shape.layers})
    tools = "auto absolute = [&](V x) { return x < zero ? -x : x; };\n"
    tools += "".join(activation_of(name).relaxation() for name in names)
    return tuple(f"{types}{inputs}\n{tools}" for types in (text.CPU + text.LANES + text.VECTORS, text.CUDA))


def body(shape: NetworkShape, *, multilinear: bool = False) -> str:
    """C statements that bound f over one box a lane.

    They read the box ``V low[Z], high[Z]``, the weights ``w`` (``Network.packed``) and the rounding ``padding`` of each
    layer. They set, each of type ``V``:

    * ``least``, a certified lower bound of f on the box, and ``level``, the constant of the linear bound;
    * ``gradient[K]``, the slopes of the linear bound in the inputs;
    * ``z[Z]``, a point of the box where f looks lowest, and ``value``, f there;
    * ``score[C]``, how much halving each column should raise the bound.

    The arrays of a hidden layer are explained at ``LAYER``; ``back`` are the output's coefficients of its
    neurons. Of the inputs, ``center``, ``gen`` and ``noise`` are explained in ``Parametrization``. ``tilt``,
    ``square`` and ``cubes`` are explained at ``BACKWARDS``.

    Args:
        shape: What the kernel is compiled for.
        multilinear: Leave products of different columns in ``square`` and ``cubes``, for ``CORNERS``: then
            ``least`` is no bound, ``level`` the constant of a multilinear one, and f is not evaluated.
    """
    kind, n = shape.parametrization, shape.parametrization.columns
    places = [0]  # where each layer begins in ``w``: its biases, its weights and their absolute values
    for inputs, neurons, _ in shape.layers:
        places.append(places[-1] + neurons * (2 * inputs + 1))
    sizes = {"K": shape.ndim, "C": n, "Z": kind.size, "NOISY": kind.noisy, "MULTILINEAR": multilinear}
    sizes |= {"SQUARES": n * (n + 1) // 2, "CUBES": n * (n + 1) * (n + 2) // 6}
    sizes |= {"LAYERS": len(shape.layers), "LAST": shape.layers[-1][1], "AT_OUTPUT": places[-1]}
    sizes["CUBIC"] = _bent(shape, len(shape.layers))
    numbers = {"FIRST_LAYER": FIRST_LAYER, "SQUARES_ROUNDING": SQUARES_ROUNDING, "THIRD": 1 / 3}
    layers, values = text.OUTPUT, text.OUTPUT_VALUE
    for index in reversed(range(len(shape.layers))):
        own = _layer(shape, index, places[index])
        below = "const auto& below = own;" * (index > 0)
        layers = f"{{ {own}{below}{text.LAYER}{{{_forwards(shape, index)}}}\n{layers}{{{text.BACKWARDS}}}\n}}\n"
        blocks = _in_blocks(text.VALUES, shape.layers[index][1])
        values = f"{{ {own}{fill(text.LAYER_VALUES, blocks=blocks, then=values)} }}"
    own = f"{constants(**sizes)} constexpr double {', '.join(f'{k} = {constant(x)}' for k, x in numbers.items())};"
    texts = {"expand": kind.expand, "project": kind.project, "realize": kind.realize}
    return own + fill(text.BODY, **texts, layers=layers, straighten=text.STRAIGHTEN, close=text.CLOSE, values=values)


def _layer(shape: NetworkShape, index: int, at: int) -> str:
    """What a layer's texts are about: constants, its activation, and the layer below."""
    inputs, neurons, name = shape.layers[index]
    activation, passes = activation_of(name), index + 1 < len(shape.layers) and _bent(shape, index + 1)
    flags = {"BENDS": activation.bends, "BENT": _bent(shape, index), "PASSES": passes}
    own = constants(INPUTS=inputs, NEURONS=neurons, AT=at, LAYER=index, **flags)
    middle = "INFINITY" if activation.limit == np.inf else constant(LARGEST_MIDDLE)
    unused = " ".join(f"(void){each};" for each in ("AT", "LAYER", "LARGEST_MIDDLE", "line", "act", *flags))
    lambdas = f"auto& line = {'curve' if activation.bends else 'relax'}_{name}; auto& act = act_{name};"
    return f"{own} const double LARGEST_MIDDLE = {middle}; {lambdas} {unused}\n"


def _bent(shape: NetworkShape, index: int) -> bool:
    """Whether the arguments of a layer have quadratic forms."""
    return any(activation_of(name).bends for _, _, name in shape.layers[:index])


def _forwards(shape: NetworkShape, index: int) -> str:
    """One hidden layer's means, slopes, bands and generators, from those of the layer below or the parametrization."""
    columns, (_, neurons, activation) = shape.parametrization.columns, shape.layers[index]
    layer = text.FIRST
    if index:
        forms = _by_registers(partial(_forms, neurons, columns)) * _bent(shape, index)
        layer = forms + _in_blocks(text.LATER, neurons, columns + 2 + _bent(shape, index))
    return text.LAYER_BEGIN + (text.CURVE if activation_of(activation).bends else text.LINE) + text.NEURON + layer


def _by_registers(text_for: Callable[[int], str]) -> str:
    """A text that is made for so many sums, as the registers hold."""
    many, few = text_for(MANY), text_for(FEW)
    if many == few:
        return many
    return f"\n#if defined(__AVX512F__) || defined(__CUDA_ARCH__)\n{many}\n#else\n{few}\n#endif\n"


def _forms(neurons: int, columns: int, registers: int) -> str:
    """A text that sums the entries of the neurons' quadratic forms, as many at a time as fit the registers."""
    entries = columns * (columns + 1) // 2 + 1
    tiles = -(-entries // (registers // ROWS - 1))
    ends = [entries * tile // tiles for tile in range(tiles + 1)]
    texts = (f"{constants(ENTRY=a, ENTRIES=b - a)} {text.SQUARES_OF_ARGUMENTS}" for a, b in pairwise(ends))
    return "\n".join(_blocks(each, neurons, 1, registers) for each in texts)


def _in_blocks(body: str, neurons: int, sums: int = 1) -> str:
    """A text for blocks of R neurons that fit the registers, each with so many ``sums``; and for the rest."""
    return _by_registers(partial(_blocks, body, neurons, sums))


def _blocks(body: str, neurons: int, sums: int, registers: int) -> str:
    rows = max(min(ROWS, registers // sums), 1)
    blocks = [(0, rows, neurons // rows), (neurons // rows * rows, neurons % rows, 1)]
    return "\n".join(f"{{ {constants(FIRST=f, R=r, BLOCKS=n)} {body} }}" for f, r, n in blocks if r and n)


def stored(shape: NetworkShape, bounds: str, store: str) -> str:
    """A kernel's body: C that loads boxes into lanes, runs ``bounds`` for all lanes at once, and ``store`` for each."""
    names = "const double* w = weights.data; const double* padding = paddings.data;\n"
    names += f"constexpr double HALVED = {constant(HALVED)};"
    cpu, cuda = lanes_text(shape, names)
    return around(shape, cpu, cuda, bounds, store)


def around(shape: NetworkShape, cpu: str, cuda: str, bounds: str, store: str) -> str:
    """The same with other texts before it, for CPU and CUDA."""
    sizes = constants(BOX=shape.parametrization.size, BLOCK=BLOCK)
    return fill(text.KERNEL, sizes=sizes, cpu=cpu, cuda=cuda, bounds=bounds, store=store)


# The bounds of ``Network.bound`` as one fused native kernel: float64, one box per SIMD lane.


@cache
def _kernel(shape: NetworkShape) -> wp.Kernel:
    name = named(unique_name(shape, "boxes"))

    @name.block_kernel(stored(shape, body(shape), text.STORE))
    def bound_all(
        boxes: wp.array(dtype=wp.float64),
        count: int,
        block: int,
        weights: wp.array(dtype=wp.float64),
        paddings: wp.array(dtype=wp.float64),
        least_out: wp.array(dtype=wp.float64),
        value_out: wp.array(dtype=wp.float64),
        point: wp.array(dtype=wp.float64),
        gradient_out: wp.array(dtype=wp.float64),
        level_out: wp.array(dtype=wp.float64),
        axes: wp.array(dtype=wp.int32),
    ): ...

    return bound_all


def double_array(values: np.ndarray, device: wp.Device) -> wp.array:
    """Float64 numbers on a device; a CPU's array shares memory with ``values``, which the caller keeps alive."""
    return wp.array(values.reshape(-1), dtype=wp.float64, device=device, copy=not device.is_cpu)


def bound_boxes(
    shape: NetworkShape, weights: np.ndarray, padding: np.ndarray, lower: np.ndarray, upper: np.ndarray, device="cpu"
) -> BoxBounds:
    """Bounds of a network over boxes of its inputs with corners ``(N, K)`` float64.

    ``weights`` and ``padding`` are those of a ``Network`` (``packed``).
    """
    count, size = lower.shape
    device = wp.get_device(device)
    sizes = (count, count, count * size, count * size, count)
    outputs = [wp.empty(each, dtype=wp.float64, device=device) for each in sizes]
    axes = wp.empty(2 * count, dtype=wp.int32, device=device)
    _launch(_kernel, shape, (lower, upper), (weights, padding), [*outputs, axes], device)
    least, value, point, slope, level = (o.numpy() for o in outputs)
    axis, next_axis = axes.numpy().reshape(2, count)
    return BoxBounds(least, axis, point.reshape(count, size), value, next_axis, slope.reshape(count, size), level)


def _launch(kernel_of, shape: NetworkShape, corners, parameters, outputs: list, device) -> None:
    """Bound the boxes between corners."""
    held = [np.ascontiguousarray(a, dtype=np.float64) for a in (np.concatenate(corners, axis=1), *parameters)]
    boxes, *numbers = (double_array(a, device) for a in held)
    if len(held[0]):
        inputs = [boxes, len(held[0]), 0, *numbers]
        launch_blocks(kernel_of(shape), len(held[0]), inputs, outputs, device, first_index=2, block=BLOCK)


# Multilinear bounds of a network over boxes of its inputs, as their values at the corners: one box per SIMD lane.


@cache
def _corner_kernel(shape: NetworkShape) -> wp.Kernel:
    name = named(unique_name(shape, "corners"))
    bounds = body(shape, multilinear=True) + text.CORNERS

    @name.block_kernel(stored(shape, bounds, text.STORE_CORNERS))
    def corners_of_all(
        boxes: wp.array(dtype=wp.float64),
        count: int,
        block: int,
        weights: wp.array(dtype=wp.float64),
        paddings: wp.array(dtype=wp.float64),
        corner_out: wp.array(dtype=wp.float64),
    ): ...

    return corners_of_all


def bound_corners(
    shape: NetworkShape, weights: np.ndarray, padding: np.ndarray, lower: np.ndarray, upper: np.ndarray, device="cpu"
) -> np.ndarray:
    """Values at the corners of boxes, whose multilinear interpolation is a certified lower bound of f.

    Boxes are as in ``bound_boxes``. Returns ``(N, 2^n)`` float64; corner i is the upper
    one on axis k if bit k of i is set.
    """
    count, size = lower.shape
    corner = wp.empty(count << size, dtype=wp.float64, device=device)
    _launch(_corner_kernel, shape, (lower, upper), (weights, padding), [corner], wp.get_device(device))
    return corner.numpy().reshape(count, 1 << size)
