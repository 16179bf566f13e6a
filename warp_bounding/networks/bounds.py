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
from warp_bounding.runtime.native import constant, constants, named, native_text, unique_name

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
# * ``expand``: from ``V low[Z], high[Z]`` to ``V center[K]``, ``V gen[P]`` (the generators that are not always zero)
#   and ``V noise[K]`` (all that is left over, float64 rounding included);
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
        realize: C text, explained above.
    """

    inputs: int

    noisy: ClassVar[bool] = False
    expand: ClassVar[str] = """
for (int k = 0; k < K; ++k) { center[k] = (low[k] + high[k]) * 0.5; gen[k] = (high[k] - low[k]) * 0.5; }
"""
    realize: ClassVar[str] = "for (int k = 0; k < K; ++k) h[k] = z[k] = slope[k] > zero ? low[k] : high[k];"

    @property
    def size(self) -> int:
        """Numbers Z of a point z."""
        return self.inputs

    @property
    def columns(self) -> int:
        """Number C of coordinates zeta, and so of columns of the generators."""
        return self.inputs

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """``(input, column)`` of the generators' entries that may differ from 0, in the order of ``gen``."""
        return [(k, k) for k in range(self.inputs)]


# What a layer calls: a line of an activation that does not bend, or a cubic of one that does.
LINES = "relax(at, near, radius + from + pad, s, m, k2, e);"
CURVES = "curve(at, near, radius, from + pad, s, m, lean, k2, k3, k4, e);"

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
ROOM = 1.0
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
    parametrization, layers, places = shape.parametrization, list(enumerate(shape.layers)), [0]
    # Where each layer begins in ``w``: its biases, its weights and their absolute values (``Network.packed``).
    for inputs, neurons, _ in shape.layers:
        places.append(places[-1] + neurons * (2 * inputs + 1))
    squares = [(k, m) for k in range(parametrization.columns) for m in range(k, parametrization.columns)]
    n, bends = parametrization.columns, any(activation_of(name).bends for _, _, name in shape.layers)
    sizes = constants(
        K=shape.ndim, C=n, Z=parametrization.size, NOISY=int(parametrization.noisy), MULTILINEAR=int(multilinear)
    )
    sizes += constants(SQUARES=len(squares), CUBES=n * (n + 1) * (n + 2) // 6)
    last, at, count = len(layers) - 1, places[-1], shape.layers[-1][1]
    join = "\n".join
    return f"""
{sizes}
constexpr double FIRST_LAYER = {constant(FIRST_LAYER)}, SQUARES_ROUNDING = {constant(SQUARES_ROUNDING)};
constexpr double THIRD = {constant(1 / 3)};
V least = zero, value = zero, level = zero, bulk = zero;
V center[K], noise[K], gen[{len(parametrization.pairs)}], h[K], z[Z], gradient[K];
V score[C], slope[C], tilt[C], square[SQUARES], cubes[CUBES];
(void)noise; (void)bulk; (void)h; (void)z; (void)value;
const auto entry = [](int k, int m) {{ return k * (2 * C - k + 1) / 2 + m - k; }}; const auto place = entry; (void)place;
const auto triple = [&](int a, int b, int d) {{  // the place of a <= b <= d in cubes
    int before = 0;
    for (int k = 0; k < a; ++k) before += (C - k) * (C - k + 1) / 2;
    return before + place(b, d) - place(a, a);
}}; (void)triple;
{parametrization.expand}
for (int k = 0; k < C; ++k) score[k] = tilt[k] = zero;
for (int i = 0; i < SQUARES; ++i) square[i] = zero;
for (int i = 0; i < CUBES; ++i) cubes[i] = zero;
{join(_forwards(shape, index, places[index]) for index, _ in layers)}
V back{last}[{count}]; least = zero + (w[{at}] - padding[{last + 1}]);  // f where all neurons are at their means
for (int j = 0; j < {count}; ++j) {{
    const double x = w[{at + 1} + j];
    back{last}[j] = zero + x; least += layer{last}.mean[j] * x;
}}
{join(_backwards(shape, index, places[index]) for index, _ in reversed(layers))}
if (NOISY) {{
    V lost = zero;
    for (int i = 0; i < K; ++i) lost += absolute(gradient[i]) * noise[i];
    least -= lost;
}}
{" ".join(f"square[{i}] *= 2.0;" for i, (k, m) in enumerate(squares) if k != m)}
{{
    V all = absolute(square[0]);
    for (int i = 1; i < SQUARES; ++i) all += absolute(square[i]);
    bulk += all;
}}
{f"{{ {text.STRAIGHTEN} }} {_tilt_to_gradient(parametrization)}" * bends}
{" ".join(f"slope[{k}] = {_product(parametrization, k, 'gradient[{i}]')} + tilt[{k}];" for k in range(parametrization.columns))}
{{ {text.CLOSE} }}
if (!MULTILINEAR) {{
    {parametrization.realize}
    const V* y = h;
    {join(_values(shape, index, places[index]) for index, _ in layers)}
    value = zero + w[{at}];
    for (int j = 0; j < {count}; ++j) value += y[j] * w[{at + 1} + j];
}}
"""  # noqa: E501


def _product(parametrization: Parametrization, column: int, of: str) -> str:
    """C sum over the inputs i of ``of`` times generators of a column; those that are always 0 are left out."""
    pairs = enumerate(parametrization.pairs)
    return " + ".join(f"{of.format(i=i)} * gen[{entry}]" for entry, (i, k) in pairs if k == column)


def _tilt_to_gradient(parametrization: Parametrization) -> str:
    """C that moves the slopes ``tilt`` into ``gradient``, if each column is one input; else nothing."""
    if parametrization.pairs != [(k, k) for k in range(parametrization.inputs)]:
        return ""
    share = "tilt[k] / (gen[k] > zero ? gen[k] : zero + 1.0)"
    return f"for (int k = 0; k < C; ++k) {{ gradient[k] += gen[k] > zero ? {share} : zero; tilt[k] = zero; }}"


def _layer(shape: NetworkShape, index: int, at: int) -> str:
    inputs, neurons, name = shape.layers[index]
    activation, bent = activation_of(name), _bent(shape, index)
    passes = index + 1 < len(shape.layers) and _bent(shape, index + 1)
    flags = {"BENDS": int(activation.bends), "BENT": int(bent), "PASSES": int(passes)}
    own = constants(INPUTS=inputs, NEURONS=neurons, AT=at, **flags)
    room = "INFINITY" if activation.limit == np.inf else constant(ROOM)
    unused = " ".join(f"(void){each};" for each in ("AT", "ROOM", *flags))
    return f"{own} const double ROOM = {room}; {unused} auto& own = layer{index}; (void)own;"


def _bent(shape: NetworkShape, index: int) -> bool:
    """Whether the arguments of a layer have quadratic forms."""
    return any(activation_of(name).bends for _, _, name in shape.layers[:index])


def _forwards(shape: NetworkShape, index: int, at: int) -> str:
    """One hidden layer's means, slopes, bands and generators, from those of the layer below or the parametrization."""
    parametrization, (_, neurons, activation) = shape.parametrization, shape.layers[index]
    if index == 0:
        generators = " ".join(
            f"g[{k}] = {_product(parametrization, k, 'x[{i}]')};" for k in range(parametrization.columns)
        )
        neurons_text = text.FIRST.replace("GENERATORS", generators)
    else:
        bent = _bent(shape, index)
        neurons_text = f"const auto& below = layer{index - 1};"
        if bent:
            neurons_text += _by_registers(partial(_forms, neurons, parametrization.columns))
        neurons_text += _in_blocks(text.LATER, neurons, parametrization.columns + 2 + bent)
    bends = activation_of(activation).bends
    neurons_text = neurons_text.replace("NEURON\n", text.NEURON.replace("RELAX", CURVES if bends else LINES))
    return f"""
{text.LAYER.replace("LAYER", f"layer{index}").replace("NEURONS", str(neurons))} {{
{_layer(shape, index, at)}
auto& {"curve = curve" if bends else "relax = relax"}_{activation};
const double* b = w + AT; const double* weight = b + NEURONS; const double pad = padding[{index}];
{neurons_text}
}}"""


def _backwards(shape: NetworkShape, index: int, at: int) -> str:
    to = f"back{index - 1}" if index else "gradient"
    return f"""
{f"V {to}[{shape.layers[index][0]}];" * (index > 0)} {{
{_layer(shape, index, at)}
V* to = {to}; const V* back = back{index};
{text.BACKWARDS}
}}"""


def _values(shape: NetworkShape, index: int, at: int) -> str:
    """C from the activations ``y`` of the layer below, or the inputs, to those of a hidden layer."""
    _, neurons, activation = shape.layers[index]
    return f"""
V y{index}[{neurons}]; {{
{_layer(shape, index, at)}
const V* x = y; V* y = y{index}; const double* b = w + AT; auto& act = act_{activation};
{_in_blocks(text.VALUES, neurons)}
}}
y = y{index};"""


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


def load_text(source: str, row: str) -> str:
    """C statement that fills ``low[]`` and ``high[]`` of lane ``l`` from 2 Z numbers of ``source`` at row ``row``."""
    return f"""{{
    const double* at = {source} + (long long)({row}) * (2 * BOX);
    for (int k = 0; k < BOX; ++k) {{ LANE(low[k]) = at[k]; LANE(high[k]) = at[BOX + k]; }}
}}"""


def snippet(shape: NetworkShape) -> str:
    """The body of the kernel of ``bound_boxes``: a block of boxes on a CPU, one box on CUDA."""
    return stored(shape, body(shape), text.STORE)


def stored(shape: NetworkShape, bounds: str, store: str) -> str:
    """A kernel's body: C that loads boxes into lanes, runs ``bounds`` for all lanes at once, and ``store`` for each."""
    names = "const double* w = weights.data; const double* padding = paddings.data; double* rows = boxes.data;\n"
    names += constants(BOX=shape.parametrization.size, BLOCK=BLOCK) + f" constexpr double HALVED = {constant(HALVED)};"
    cpu, cuda = lanes_text(shape, names)
    return f"""
#if !defined(__CUDA_ARCH__)
{cpu}
const int begin = block * BLOCK; const int end = begin + BLOCK < count ? begin + BLOCK : count;
for (int i = begin; i < end; i += L) {{
    V low[BOX], high[BOX];
    for (int l = 0; l < L; ++l) {{ const int j = i + l < end ? i + l : end - 1; {load_text("rows", "j")} }}
    {bounds}
    for (int l = 0; l < L && i + l < end; ++l) {{ {store} }}
}}
#else
{cuda}
const int i = block, l = 0; if (i >= count) return;
V low[BOX], high[BOX];
{load_text("rows", "i")}
{bounds}
{{ {store} }}
#endif
#undef LANE
"""


# The bounds of ``Network.bound`` as one fused native kernel: float64, one box per SIMD lane.


@cache
def _kernel(shape: NetworkShape) -> wp.Kernel:
    name = named(unique_name(shape, "boxes"))

    @name.block_kernel(snippet(shape))
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
