"""The text of the kernel in ``network_kernel``: bounds of a network over a box, one box per SIMD lane.

A chart (``charts``) turns a box of numbers into the network's inputs, an affine function of ``zeta`` in [-1, 1]^columns and
noise. A thread takes a block of boxes through all layers and back without leaving its cache. Forwards, each neuron is a
parabola or a line (``activations``) in the linear part of its argument, plus noise; backwards, the actual coefficients of the
output weigh lines and parabolas, which so may cancel, and only the rest counts in absolute value. The arithmetic
is ``(columns + 3) H^2`` multiply-adds a box for two layers of H neurons. Sums may be taken in any order and fused: the rounding
that the network sets aside (``padding``, and ``BULK``) covers all of them, the activations' own slack their
functions. ``Network.bound_plain`` is the plain twin.
"""

from dataclasses import dataclass

from warp_bounding.activations import ACTIVATIONS
from warp_bounding.networks.charts.base import Chart

__all__ = ["BLOCK", "NetworkSizes", "axis_text", "body", "lanes_text", "load_text", "snippet"]

BLOCK = 64  # boxes that one CPU thread of the kernel works on; CUDA: one
HALVED = 0.3  # a relaxation's cost falls with the square of a box's width, or nearly so
BULK = 1e-12  # of all squares: above the rounding of sums of up to 4000 of them
FIRST_LAYER = (
    1e-9  # share of the first layer's rates in the choice of an axis: where all behind it is saturated, they decide
)
ROWS, REGISTERS = 4, 28  # neurons that share each input as it is loaded; sums that are kept at a time


@dataclass(frozen=True)
class NetworkSizes:
    """What the kernel depends on: ``(inputs, neurons, activation, leading linear rows)`` of each hidden layer."""

    ndim: int
    layers: tuple[tuple[int, int, str, int], ...]
    chart: Chart

    name = "network_bound"


def _constant(value: float) -> str:
    return float(value).hex()


def lanes_text(sizes: NetworkSizes, inputs: str) -> tuple[str, str]:
    """What stands before the text of ``body``: types, tools and the chart's names, on a CPU and on CUDA.

    Args:
        sizes: Of the network.
        inputs: C statements that name the kernel's arrays.
    """
    tools = "".join(ACTIVATIONS[name].relaxation() for name in sorted({layer[2] for layer in sizes.layers}))
    cpu = f"""
#pragma clang fp contract(fast)
#define LANE(x) x[l]
constexpr int L = 8;
typedef double V __attribute__((vector_size(8 * L))); typedef long long I __attribute__((vector_size(8 * L)));
const V zero = {{}};
auto root = [](V x) {{ return __builtin_elementwise_sqrt(x); }};
{inputs}
{tools}"""
    cuda = f"""
#define LANE(x) x
constexpr int L = 1;
typedef double V;
const V zero = 0.0;
auto root = [](V x) {{ return sqrt(x); }};
{inputs}
{tools}"""
    return cpu, cuda


def body(sizes: NetworkSizes, tried: str = "true") -> str:
    """From ``V low[], high[]`` to ``V least, value, valid, dead``, ``score[]``, ``owner[]``, ``z[]``, ``gradient[]``; weights at ``w``.

    Args:
        sizes: Of the network, and the chart.
        tried: C condition under which f is evaluated where it looks lowest; else ``valid`` is 0.
    """
    chart, K = sizes.chart, sizes.ndim
    pairs = list(enumerate(chart.pairs))
    entries = [[(index, i) for index, (i, k) in pairs if k == column] for column in range(chart.columns)]
    each = range(chart.columns)
    squares = _squares(chart.columns)
    lines = [
        f"V least = zero, value = zero, valid = zero + 1.0, dead = zero, lost = zero; V score[{chart.columns}], slope[{chart.columns}];",
        f"V owner[{chart.columns}], gradient[{K}], center[{K}], noise[{K}], rest[{K}], gen[{len(pairs)}], z[{chart.size}], h[{K}];",
        "(void)dead; (void)valid; (void)noise; (void)rest; (void)lost;",
        chart.expand(),
        chart.owners(),
        *(f"score[{k}] = zero;" for k in each),
        f"V level = zero, bulk = zero, square[{len(squares)}]; (void)bulk; {' '.join(f'square[{i}] = zero;' for i in range(len(squares)))}",
    ]
    at, offsets = 0, []
    for index, (inputs, neurons, _, _) in enumerate(sizes.layers):
        offsets.append(at)
        lines += _forward(sizes, index, at, entries)
        at += neurons * (2 * inputs + 1)
    last, count = len(sizes.layers) - 1, sizes.layers[-1][1]
    lines.append(f"V back{last}[{count}]; least = zero + (w[{at}] - padding[{last + 1}]);")
    lines.append(
        f"for (int j = 0; j < {count}; ++j) {{ const double x = w[{at + 1} + j]; back{last}[j] = zero + x; least += mean{last}[j] * x; }}"
    )
    for index in range(last, -1, -1):
        inputs, neurons, _, _ = sizes.layers[index]
        below = f"back{index - 1}" if index else "gradient"
        if index:
            lines.append(f"V {below}[{inputs}];")
        lines.append(f"for (int i = 0; i < {inputs}; ++i) {below}[i] = zero;")
        lines.append(f"for (int j = 0; j < {neurons}; ++j) {{ V c = back{index}[j]; const V a = c < zero ? -c : c;")
        lines.append(f"const V loss = a * spread{index}[j]; least -= loss; const V share = loss / width{index}[j];")
        lines += [f"{{ const V g = rate{index}_{k}[j]; score[{k}] += share * (g < zero ? -g : g); }}" for k in each]
        if ACTIVATIONS[sizes.layers[index][2]].bends:
            lines.append(
                f"{{ const V b = c * bend{index}[j]; const V n2 = near{index}[j] * near{index}[j]; least -= b * n2 * 0.5;"
            )
            lines.append("bulk += (b < zero ? -b : b) * n2;")
            lines += [f"const V g{k} = rate{index}_{k}[j]; const V b{k} = b * g{k};" for k in each]
            lines += [f"square[{i}] += b{k} * g{m};" for i, (k, m) in enumerate(squares)]
            lines.append("}")
        lines.append(f"c *= slope{index}[j]; const double* x = w + {offsets[index] + neurons} + j * {inputs};")
        lines.append(f"for (int i = 0; i < {inputs}; ++i) {below}[i] += c * x[i]; }}")
    if chart.noisy:
        lines += [f"lost += (gradient[{i}] < zero ? -gradient[{i}] : gradient[{i}]) * rest[{i}];" for i in range(K)]
        lines += ["least -= lost;", chart.blame()]
    lines += [f"square[{i}] *= 2.0;" for i, (k, m) in enumerate(squares) if k != m]
    lines += [
        chart.bend(squares),
        f"bulk += {' + '.join(f'(square[{i}] < zero ? -square[{i}] : square[{i}])' for i in range(len(squares)))};",
    ]
    lines += [f"slope[{k}] = {' + '.join(f'gradient[{i}] * gen[{e}]' for e, i in entries[k])};" for k in each]
    for start, factors in chart.constraints():
        lines += _constrain(chart, start, factors)
    for i, (k, m) in enumerate(
        squares
    ):  # the quadratic form over the cube: entry by entry, the diagonal with the slopes
        size = f"const V q = square[{i}] < zero ? -square[{i}] : square[{i}];"
        if k != m:
            lines.append(f"{{ {size} least -= q; score[{k}] += q * 0.5; score[{m}] += q * 0.5; }}")
        else:
            lines.append(f"{{ {size} score[{k}] += q; least -= square[{i}] < zero ? q : zero; }}")
    lines.append(f"least -= bulk * {_constant(BULK)}; level = least;")
    for k in each:  # min of slope zeta + square zeta^2 for square > 0: at the end, or in between
        i = squares.index((k, k))
        lines.append(
            f"{{ const V s = slope[{k}] < zero ? -slope[{k}] : slope[{k}]; const V q = square[{i}] > zero ? square[{i}] : zero;"
            f" const V end = q - s; const V inner = s * s * -0.25 / (q > zero ? q : zero + 1.0); least += s < q + q ? inner : end; }}"
        )
    value = _value(sizes, offsets, at)
    lines.append(f"if ({tried}) {{ {chart.realize()} {value} }} else {{ valid = zero; }}")
    return "\n".join(lines)


def _value(sizes: NetworkSizes, offsets: list[int], last: int) -> str:
    """From the inputs ``h`` to ``value``; the output's numbers stand at ``last``, those of hidden layers at ``offsets``."""
    source, lines = "h", []
    for index, (inputs, neurons, activation, linear) in enumerate(sizes.layers):
        lines.append(f"V y{index}[{neurons}]; {{ const double* b = w + {offsets[index]};")
        for first, rows, blocks in _blocks(neurons):
            lines.append(f"for (int t = 0; t < {blocks}; ++t) {{ const int j = {first} + t * {rows};")
            lines.append(
                f"const double* x = b + {neurons} + j * {inputs}; V {', '.join(f'z{r} = zero + b[j + {r}]' for r in range(rows))};"
            )
            lines.append(f"for (int i = 0; i < {inputs}; ++i) {{ const V m = {source}[i];")
            lines.append(" ".join(f"z{r} += m * x[{r * inputs} + i];" for r in range(rows)) + " }")
            lines += [f"y{index}[j + {r}] = j + {r} < {linear} ? z{r} : act_{activation}(z{r});" for r in range(rows)]
            lines.append("}")
        lines.append("}")
        source = f"y{index}"
    neurons = sizes.layers[-1][1]
    lines.append(
        f"value = zero + w[{last}]; for (int j = 0; j < {neurons}; ++j) value += {source}[j] * w[{last + 1} + j];"
    )
    return "\n".join(lines)


def _forward(sizes: NetworkSizes, index: int, at: int, entries: list[list[tuple[int, int]]]) -> list[str]:
    """One hidden layer's means, slopes, spreads and generators, from those of the layer below or from the chart's."""
    chart, (inputs, neurons, _, _), a = sizes.chart, sizes.layers[index], index
    columns = range(chart.columns)
    lines = [
        f"V mean{a}[{neurons}], noise{a}[{neurons}], width{a}[{neurons}], slope{a}[{neurons}], spread{a}[{neurons}];",
        f"V {', '.join(f'rate{a}_{k}[{neurons}], part{a}_{k}[{neurons}]' for k in columns)}, near{a}[{neurons}], bend{a}[{neurons}];",
        f"{{ const double* b = w + {at}; const double* weight = b + {neurons}; const double pad = padding[{a}];",
    ]
    if index == 0:
        lines.append(f"for (int j = 0; j < {neurons}; ++j) {{ const double* x = weight + j * {inputs};")
        lines.append(f"V z = zero + b[j], from = zero; V g[{chart.columns}];")
        lines += [f"z += center[{i}] * x[{i}];" for i in range(inputs)]
        lines += [f"g[{k}] = {' + '.join(f'gen[{e}] * x[{i}]' for e, i in entries[k])};" for k in columns]
        if chart.noisy:
            lines += [f"from += noise[{i}] * x[{neurons * inputs} + {i}];" for i in range(inputs)]
        lines += _neuron(sizes, index, "j")
        lines += [f"score[{k}] += (g[{k}] < zero ? -g[{k}] : g[{k}]) * {_constant(FIRST_LAYER)};" for k in columns] + [
            "}"
        ]
    else:
        for first, rows, blocks in _blocks(neurons, chart.columns):
            lines.append(f"for (int t = 0; t < {blocks}; ++t) {{ const int j = {first} + t * {rows};")
            lines.append(f"const double* x = weight + j * {inputs}; const double* ax = x + {neurons * inputs};")
            for r in range(rows):
                lines.append(
                    f"V z{r} = zero + b[j + {r}], o{r} = zero; V {', '.join(f'g{r}_{k} = zero' for k in columns)};"
                )
            lines.append(f"for (int i = 0; i < {inputs}; ++i) {{ const V m = mean{a - 1}[i], e = noise{a - 1}[i];")
            lines.append(" ".join(f"const V p{k} = part{a - 1}_{k}[i];" for k in columns))
            for r in range(rows):
                lines.append(
                    f"{{ const double y = x[{r * inputs} + i]; z{r} += m * y; o{r} += e * ax[{r * inputs} + i];"
                )
                lines.append(" ".join(f"g{r}_{k} += p{k} * y;" for k in columns) + " }")
            lines.append("}")
            for r in range(rows):
                copied = " ".join(f"g[{k}] = g{r}_{k};" for k in columns)
                lines.append(f"{{ V z = z{r}; const V from = o{r}; V g[{chart.columns}]; {copied}")
                lines += [*_neuron(sizes, index, f"j + {r}"), "}"]
            lines.append("}")
    return [*lines, "}"]


def _constrain(chart: Chart, start: str, factors: list[tuple[int, str]]) -> list[str]:
    """Add a constraint ``q0 + q . zeta <= 0`` to the linear bound, times the multiplier that serves it best.

    For any multiplier ``t >= 0`` the bound ``least - sum |slope + t q| + t q0`` holds at all points that obey the constraint; it is
    concave in t, and largest where an entry of ``slope + t q`` vanishes, or at 0.
    """
    q = [[] for _ in range(chart.columns)]
    for index, (i, k) in enumerate(chart.pairs):
        q[k] += [f"{factor} * gen[{index}]" for j, factor in factors if j == i]
    moved = [k for k in range(chart.columns) if q[k]]
    lines = [f"{{ const V excess = {start}; V best = zero, gain = zero;"]
    lines += [f"const V q{k} = {' + '.join(q[k])};" for k in moved]
    before = " + ".join(f"(slope[{k}] < zero ? -slope[{k}] : slope[{k}])" for k in moved)
    lines.append(f"const V before = {before};")
    for k in moved:
        lines.append(f"{{ const V own = q{k} == zero ? zero + 1.0 : q{k}; V t = -slope[{k}] / own;")
        lines.append(f"t = q{k} == zero ? zero : t; t = t > zero ? t : zero; V after = t * excess + before;")
        lines += [f"{{ const V s = slope[{j}] + t * q{j}; after -= s < zero ? -s : s; }}" for j in moved]
        lines.append("best = after > gain ? t : best; gain = after > gain ? after : gain; }")
    lines += [f"slope[{k}] += best * q{k};" for k in moved]
    lines.append("least += best * excess - (best * (excess < zero ? -excess : excess) + before + 1.0) * 1e-14; }")
    return lines


def _blocks(neurons: int, columns: int = 1) -> list[tuple[int, int, int]]:
    """``(first, rows, repetitions)`` of blocks of neurons whose sums fit the registers, and the rest."""
    rows = max(min(ROWS, REGISTERS // (columns + 2)), 1)
    blocks = [(0, rows, neurons // rows), (neurons // rows * rows, neurons % rows, 1)]
    return [block for block in blocks if block[1] and block[2]]


def _squares(columns: int) -> list[tuple[int, int]]:
    """Entries of a quadratic form in zeta."""
    return [(k, m) for k in range(columns) for m in range(k, columns)]


def _neuron(sizes: NetworkSizes, index: int, j: str) -> list[str]:
    """From z, g (generators) and from (noise of earlier layers) to the layer's arrays.

    The activation is ``m + s (l + y) + k l^2 +- e``; what is passed on has its centre at ``m + k near^2 / 2``.
    """
    _, _, activation, linear = sizes.layers[index]
    columns = range(sizes.chart.columns)
    lines = ["V near = zero;"]
    lines += [
        f"{{ const V a = g[{k}] < zero ? -g[{k}] : g[{k}]; rate{index}_{k}[{j}] = g[{k}]; near += a; }}"
        for k in columns
    ]
    lines.append("const V d = near + from + pad; V s, m, e, k = zero;")
    lines.append(f"relax_{activation}(z, near, from + pad, s, m, k, e);")
    if linear:
        lines.append(f"if ({j} < {linear}) {{ s = zero + 1.0; m = z; e = zero; k = zero; }}")
    lines.append(
        "e += pad; const V as = s < zero ? -s : s; const V ak = k < zero ? -k : k; const V half = near * near * 0.5;"
    )
    lines.append(
        f"mean{index}[{j}] = m + k * half; slope{index}[{j}] = s; spread{index}[{j}] = e; width{index}[{j}] = d; noise{index}[{j}] = as * from + ak * half + e;"
    )
    lines.append(f"near{index}[{j}] = near; bend{index}[{j}] = k;")
    lines += [f"part{index}_{k}[{j}] = g[{k}] * s;" for k in columns]
    return lines


def load_text(size: int, source: str, row: str) -> str:
    """C statements that fill ``low[]`` and ``high[]`` of lane ``l`` from ``2 size`` numbers of ``source`` at row ``row``."""
    return " ".join(
        f"LANE(low[{k}]) = {source}[(long long)({row}) * {2 * size} + {k}]; LANE(high[{k}]) = {source}[(long long)({row}) * {2 * size} + {size + k}];"
        for k in range(size)
    )


def axis_text(columns: int) -> str:
    """C statements that declare ``int axis``, the number of z that is best halved in lane ``l``."""
    lines = ["int axis; { double most = LANE(score[0]); axis = (int)LANE(owner[0]);"]
    lines += [
        f"if (LANE(score[{k}]) > most) {{ most = LANE(score[{k}]); axis = (int)LANE(owner[{k}]); }}"
        for k in range(1, columns)
    ]
    return " ".join([*lines, "}"])


def snippet(sizes: NetworkSizes) -> str:
    """The body of the native function ``bound_block`` of ``network_kernel``: one block of boxes on a CPU, one box on CUDA."""
    chart = sizes.chart
    size, columns, K = chart.size, chart.columns, sizes.ndim
    cpu, cuda = lanes_text(
        sizes, "const double* w = weights.data; const double* padding = paddings.data; double* rows = boxes.data;"
    )
    store = [
        axis_text(columns),
        "const long long o = i + l; (void)level; least_out.data[o] = LANE(dead) != 0.0 ? INFINITY : LANE(least);",
        "value_out.data[o] = LANE(valid) != 0.0 && LANE(dead) == 0.0 ? LANE(value) : INFINITY; axes.data[o] = axis;",
        f"{{ double next = -1.0; int second = axis; {_second(columns)} axes.data[count + o] = second; }}",
        *(f"point.data[o * {size} + {k}] = LANE(z[{k}]);" for k in range(size)),
        *(f"gradient_out.data[o * {K} + {k}] = LANE(gradient[{k}]);" for k in range(K)),
        "level_out.data[o] = LANE(level);",
        *(
            f"rows[o * {2 * size} + {k}] = LANE(low[{k}]); rows[o * {2 * size} + {size + k}] = LANE(high[{k}]);"
            for k in range(size)
        ),
    ]
    store = "\n".join(store)
    text = body(sizes)
    return f"""
#if !defined(__CUDA_ARCH__)
{cpu}
const int begin = block * {BLOCK}; const int end = begin + {BLOCK} < count ? begin + {BLOCK} : count;
for (int i = begin; i < end; i += L) {{
V low[{size}], high[{size}];
for (int l = 0; l < L; ++l) {{ const int j = i + l < end ? i + l : end - 1; {load_text(size, "rows", "j")} }}
{text}
for (int l = 0; l < L && i + l < end; ++l) {{ {store} }}
}}
#else
{cuda}
const int i = block, l = 0; if (i >= count) return;
V low[{size}], high[{size}];
{load_text(size, "rows", "i")}
{text}
{{ {store} }}
#endif
#undef LANE
"""


def _second(columns: int) -> str:
    """C statements that set ``second``, the number to halve after ``axis``."""
    return " ".join(
        f"{{ const double s = LANE(score[{k}]) * ((int)LANE(owner[{k}]) == axis ? {_constant(HALVED)} : 1.0);"
        f" if (s > next) {{ next = s; second = (int)LANE(owner[{k}]); }} }}"
        for k in range(columns)
    )
