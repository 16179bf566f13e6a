"""The text of the kernel in ``bound_kernel``: bounds of a network over a box, one box per SIMD lane.

A chart (``charts``) turns a box of numbers into the network's inputs, an affine function of ``zeta`` in [-1,
1]^columns and noise. A thread takes a block of boxes through all layers and back without leaving its cache. Forwards,
each neuron is a cubic or a line (``activations``) in the linear part of its argument, plus a quadratic form of zeta,
plus noise. Backwards, these curves are weighed by the output's actual coefficients and added to one cubic polynomial of
zeta, in which those of many neurons may cancel; only the bands around them count in absolute value. For two layers of H
neurons and C columns the arithmetic is ``(C (C + 1) / 2 + C + 5) H^2`` multiply-adds a box: entries of the forms, their
middle and half-range, centre, noise and columns forwards, one coefficient backwards; and fewer than ``C^3 H`` of the
polynomial. Sums may be taken in any order and fused: ``Network.padding`` and ``SQUARES_ROUNDING`` bound the float64
rounding of all of them, and the relaxations add what the kernel's own sine and tanh err by. ``Network.bound_plain``
computes the same in NumPy, for boxes of the inputs themselves (``PlainChart``): it knows no other chart and no
constraint.

The C itself stands in ``bound_text``, which is to be read first, and in ``polynomial_text``; here it is put together for the shape of a network and
its chart. K are the network's inputs, Z the numbers of a box, C the columns, the entries of zeta (``charts.base``).
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from warp_bounding.activations import activation_of
from warp_bounding.activations.base import constant, constants
from warp_bounding.networks import bound_text as text
from warp_bounding.networks import polynomial_text
from warp_bounding.networks.charts.base import Chart

__all__ = ["BLOCK", "NetworkShape", "body", "lanes_text", "load_text", "snippet", "stored"]

BLOCK = 64  # boxes that a thread of the kernel works on, on a CPU; on CUDA it is one
# A box's second axis to halve is chosen as if its first were halved already. The score of that number z falls by this
# factor then: a relaxation's cost falls nearly with the square of a box's width, so a little more than 1/4.
HALVED = 0.3
# Relative to the sum of the absolute terms of the polynomial in zeta: above 4000 UNIT64, for up to 4000 neurons.
SQUARES_ROUNDING = 1e-12
# Weight of |rate| of the first layer (``bound_text.LAYER``: the generators of a neuron's argument) in the score by
# which an axis is chosen: it decides only where all layers behind are saturated.
FIRST_LAYER = 1e-9
ROWS = 4  # neurons that share each input as it is loaded
# The largest middle of a quadratic form around which the sine is taken (``bound_text.NEURON``, ``activations.sine``).
ROOM = 1.0
REGISTERS = 28  # sums that are kept at a time, of the 32 vector registers of AVX-512


@dataclass(frozen=True)
class NetworkShape:
    """What a kernel of bounds is compiled for.

    Attributes:
        ndim: Inputs K of the network, as many as the chart has: the length of v, so 2n of rays.
        layers: ``(inputs, neurons, activation's name, leading linear rows)`` of each hidden layer.
        chart: How a box becomes inputs.
    """

    ndim: int
    layers: tuple[tuple[int, int, str, int], ...]
    chart: Chart

    name = "network_bound"


def lanes_text(shape: NetworkShape, inputs: str) -> tuple[str, str]:
    """What stands before the text of ``body``: types, tools and the chart's names, on a CPU and on CUDA.

    Args:
        shape: What the kernel is compiled for.
        inputs: C statements that name the kernel's arrays.
    """
    names = sorted({layer[2] for layer in shape.layers})
    tools = "auto absolute = [&](V x) { return x < zero ? -x : x; };\n"
    tools += "".join(activation_of(name).relaxation() for name in names)
    return tuple(f"{types}{inputs}\n{tools}" for types in (text.CPU, text.CUDA))


def body(shape: NetworkShape, tried: str = "true", *, multilinear: bool = False) -> str:
    """C statements that bound f over one box a lane.

    They read the box ``V low[Z], high[Z]``, which the chart may shrink, the weights ``w`` (``Network.packed``), the
    rounding ``padding`` of each layer and the chart's ``numbers`` and ``table``. They set, each of type ``V``:

    * ``least``, a certified lower bound of f on the box, and ``level``, the constant of the linear bound;
    * ``gradient[K]``, the slopes of the linear bound in the inputs;
    * ``dead``, 1 where the box holds no positive, else 0;
    * ``z[Z]``, a positive of the box, ``value``, f there, and ``valid``, 1 where there is one, else 0;
    * ``score[C]``, how much halving each column should raise the bound, and ``owner[C]``, the number of z to halve for
      it.

    The arrays of a hidden layer are explained at ``bound_text.LAYER``; ``back`` are the output's coefficients of its
    neurons. Of the inputs, ``center``, ``gen``, ``noise`` and ``rest`` are explained in ``charts.base``. ``lost`` is
    what noise takes from the bound; ``tilt``, ``square`` and ``cubes`` are explained at ``bound_text.BACKWARDS``.

    Args:
        shape: What the kernel is compiled for.
        tried: C condition under which f is evaluated where it looks lowest; else ``valid`` is 0.
        multilinear: Leave products of different columns in ``square`` and ``cubes``, for ``polynomial_text.CORNERS``: then
            ``least`` is no bound, and ``level`` the constant of a multilinear one.
    """
    chart, layers, places = shape.chart, list(enumerate(shape.layers)), [0]
    # Where each layer begins in ``w``: its biases, its weights and their absolute values (``Network.packed``).
    for inputs, neurons, _, _ in shape.layers:
        places.append(places[-1] + neurons * (2 * inputs + 1))
    squares = [(k, m) for k in range(chart.columns) for m in range(k, chart.columns)]
    n, bends = chart.columns, any(activation_of(name).bends for _, _, name, _ in shape.layers)
    sizes = constants(K=shape.ndim, C=n, Z=chart.size, NOISY=int(chart.noisy), MULTILINEAR=int(multilinear))
    sizes += constants(SQUARES=len(squares), CUBES=n * (n + 1) * (n + 2) // 6)
    last, at, count = len(layers) - 1, places[-1], shape.layers[-1][1]
    join = "\n".join
    return f"""
{sizes}
constexpr double FIRST_LAYER = {constant(FIRST_LAYER)}, SQUARES_ROUNDING = {constant(SQUARES_ROUNDING)};
constexpr double THIRD = {constant(1 / 3)};
V least = zero, value = zero, valid = zero + 1.0, dead = zero, lost = zero, level = zero, bulk = zero;
V center[K], noise[K], rest[K], gen[{len(chart.pairs)}], h[K], z[Z], gradient[K];
V score[C], slope[C], owner[C], tilt[C], square[SQUARES], cubes[CUBES];
(void)dead; (void)valid; (void)noise; (void)rest; (void)lost; (void)bulk;
const auto entry = [](int k, int m) {{ return k * (2 * C - k + 1) / 2 + m - k; }}; const auto place = entry; (void)place;
const auto triple = [&](int a, int b, int d) {{  // the place of a <= b <= d in cubes
    int before = 0;
    for (int k = 0; k < a; ++k) before += (C - k) * (C - k + 1) / 2;
    return before + place(b, d) - place(a, a);
}}; (void)triple;
{chart.expand}
{chart.owners}
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
    for (int i = 0; i < K; ++i) lost += absolute(gradient[i]) * rest[i];
    least -= lost;
    {chart.blame}
}}
{" ".join(f"square[{i}] *= 2.0;" for i, (k, m) in enumerate(squares) if k != m)}
{{ {chart.bend} }}
{{
    V all = absolute(square[0]);
    for (int i = 1; i < SQUARES; ++i) all += absolute(square[i]);
    bulk += all;
}}
{f"{{ {polynomial_text.STRAIGHTEN} }} {_lean(chart)}" * bends}
{" ".join(f"slope[{k}] = {_product(chart, k, 'gradient[{i}]')} + tilt[{k}];" for k in range(chart.columns))}
{join(_constrain(chart, start, factors) for start, factors in chart.constraints())}
{{ {polynomial_text.CLOSE} }}
if ({tried}) {{
    {chart.realize}
    const V* y = h;
    {join(_values(shape, index, places[index]) for index, _ in layers)}
    value = zero + w[{at}];
    for (int j = 0; j < {count}; ++j) value += y[j] * w[{at + 1} + j];
}} else {{ valid = zero; }}
"""


def _product(chart: Chart, column: int, of: str) -> str:
    """C sum over the inputs i of ``of`` times generators of a column; those that are always 0 are left out."""
    pairs = enumerate(chart.pairs)
    return " + ".join(f"{of.format(i=i)} * gen[{entry}]" for entry, (i, k) in pairs if k == column)


def _lean(chart: Chart) -> str:
    """Where columns are inputs, each its own, C that moves the slopes ``tilt`` into ``gradient``."""
    if chart.pairs != [(k, k) for k in range(chart.inputs)]:
        return ""
    share = "tilt[k] / (gen[k] > zero ? gen[k] : zero + 1.0)"
    return f"for (int k = 0; k < C; ++k) {{ gradient[k] += gen[k] > zero ? {share} : zero; tilt[k] = zero; }}"


def _layer(shape: NetworkShape, index: int, at: int) -> str:
    inputs, neurons, name, linear = shape.layers[index]
    activation, bent = activation_of(name), _bent(shape, index)
    passes = index + 1 < len(shape.layers) and _bent(shape, index + 1)
    flags = {"BENDS": int(activation.bends), "BENT": int(bent), "PASSES": int(passes)}
    own = constants(INPUTS=inputs, NEURONS=neurons, LINEAR=linear, AT=at, **flags)
    room = "INFINITY" if activation.limit == np.inf else constant(ROOM)
    unused = " ".join(f"(void){each};" for each in ("LINEAR", "AT", "ROOM", *flags))
    return f"{own} const double ROOM = {room}; {unused} auto& own = layer{index}; (void)own;"


def _bent(shape: NetworkShape, index: int) -> bool:
    """Whether the arguments of a layer have parabolas in them."""
    return any(activation_of(name).bends for _, _, name, _ in shape.layers[:index])


def _forwards(shape: NetworkShape, index: int, at: int) -> str:
    """One hidden layer's means, slopes, spreads and generators, from those of the layer below or from the chart's."""
    chart, (_, neurons, activation, _) = shape.chart, shape.layers[index]
    if index == 0:
        generators = " ".join(f"g[{k}] = {_product(chart, k, 'x[{i}]')};" for k in range(chart.columns))
        neurons_text = text.FIRST.replace("GENERATORS", generators)
    else:
        bent = _bent(shape, index)
        neurons_text = f"const auto& below = layer{index - 1};"
        if bent:
            neurons_text += "\n".join(_in_blocks(each, neurons) for each in _tiles(chart.columns))
        neurons_text += _in_blocks(text.LATER, neurons, chart.columns + 2 + bent)
    bends = activation_of(activation).bends
    neurons_text = neurons_text.replace("NEURON\n", text.NEURON.replace("RELAX", text.CURVES if bends else text.LINES))
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
    """From the activations ``y`` of the layer below, or the inputs, to those of a hidden layer."""
    _, neurons, activation, _ = shape.layers[index]
    return f"""
V y{index}[{neurons}]; {{
{_layer(shape, index, at)}
const V* x = y; V* y = y{index}; const double* b = w + AT; auto& act = act_{activation};
{_in_blocks(text.VALUES, neurons)}
}}
y = y{index};"""


def _tiles(columns: int) -> list[str]:
    """Texts that sum the entries of quadratic forms, as many at a time as fit the registers."""
    entries = columns * (columns + 1) // 2 + 1
    tiles = -(-entries // (REGISTERS // ROWS - 1))
    ends = [entries * tile // tiles for tile in range(tiles + 1)]
    return [f"{constants(ENTRY=a, ENTRIES=b - a)} {text.SQUARES_OF_ARGUMENTS}" for a, b in pairwise(ends)]


def _in_blocks(body: str, neurons: int, sums: int = 1) -> str:
    """A text for blocks of R neurons, each of which has so many sums, that fit the registers; and for the rest."""
    rows = max(min(ROWS, REGISTERS // sums), 1)
    blocks = [(0, rows, neurons // rows), (neurons // rows * rows, neurons % rows, 1)]
    return "\n".join(f"{{ {constants(FIRST=f, R=r, BLOCKS=n)} {body} }}" for f, r, n in blocks if r and n)


def _constrain(chart: Chart, start: str, factors: list[tuple[int, str]]) -> str:
    """Add a constraint of the chart (``Chart.constraints``) to the bound."""
    terms: dict[int, list[str]] = {}
    for entry, (i, k) in enumerate(chart.pairs):
        terms.setdefault(k, []).extend(f"{factor} * gen[{entry}]" for j, factor in factors if j == i)
    moved = [k for k in sorted(terms) if terms[k]]
    values = ", ".join(" + ".join(terms[k]) for k in moved)
    names = f"constexpr int M = {len(moved)}, OF[M] = {{{', '.join(map(str, moved))}}};"
    return "\n".join(
        [f"{{ {names} const V excess = {start}; const V q[M] = {{{values}}};", polynomial_text.CONSTRAIN, "}"]
    )


def load_text(source: str, row: str) -> str:
    """C statement that fills ``low[]`` and ``high[]`` of lane ``l`` from 2 Z numbers of ``source`` at row ``row``."""
    return f"""{{
    const double* at = {source} + (long long)({row}) * (2 * BOX);
    for (int k = 0; k < BOX; ++k) {{ LANE(low[k]) = at[k]; LANE(high[k]) = at[BOX + k]; }}
}}"""


def snippet(shape: NetworkShape) -> str:
    """The body of the kernel of ``bound_boxes``: a block of boxes on a CPU, one box on CUDA."""
    return stored(shape, body(shape), text.AXIS + text.STORE)


def stored(shape: NetworkShape, bounds: str, store: str) -> str:
    """A kernel's body: C that loads boxes, does what ``bounds`` says for those of all lanes, and ``store`` for each."""
    names = "const double* w = weights.data; const double* padding = paddings.data; double* rows = boxes.data;\n"
    names += constants(BOX=shape.chart.size, BLOCK=BLOCK) + f" constexpr double HALVED = {constant(HALVED)};"
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
