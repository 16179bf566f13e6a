"""The text of the kernel in ``network_kernel``: bounds of a network over a box, one box per SIMD lane.

A thread takes a block of boxes through all layers and back without leaving its cache; the arithmetic is
``(n + 3) H^2`` multiply-adds a box for two layers of H neurons. Sums may be taken in any order and fused: the rounding that
the network sets aside (``padding``) covers all of them, and ``SINE_SLACK`` the kernel's own sine and cosine, Taylor
polynomials of degree 19 and 20 after a range reduction in three steps. ``Network.bound_plain`` is the plain twin.
"""

from dataclasses import dataclass

import numpy as np

from warp_bounding.bounders.tanh_relaxation import tanh_text

__all__ = ["BLOCK", "SINE_SLACK", "NetworkSizes", "snippet"]

# |error| of sine and cosine for |z| <= 2^12: Taylor remainders under 3e-16, the reduction under 2^-52 (1 + n 2^-30), about
# 30 roundings of terms under 2; all under 1e-14. Mean, slope and spread carry it at most 4 times.
SINE_SLACK = 1e-13
BLOCK = 64  # boxes that one CPU thread of the kernel works on; CUDA: one
HALVED = 0.3  # a relaxation's cost falls with the square of a box's width, or nearly so
ROWS = 4  # neurons that share each input as it is loaded


@dataclass(frozen=True)
class NetworkSizes:
    """What the kernel depends on: ``(inputs, neurons, activation, leading linear rows)`` of each hidden layer."""

    ndim: int
    layers: tuple[tuple[int, int, str, int], ...]

    name = "network_bound"


def _constant(value: float) -> str:
    return float(value).hex()


def _sincos() -> str:
    """A lambda ``sincos(z, s, c)``."""
    high = float.fromhex("0x1.921fb544p+1")  # the first 34 bits of pi; times n < 2^12 exact
    middle = float.fromhex("0x1.0b4611a6p-33")  # the next 32
    low = float.fromhex("0x1.3198a2e037073p-68")  # and the rest to double precision
    sine, cosine = "V s_ = ", "V c_ = "
    factorial = [1.0]
    for k in range(1, 21):
        factorial.append(factorial[-1] * k)
    s_terms = [_constant((-1) ** (k // 2) / factorial[k]) for k in range(1, 20, 2)]
    c_terms = [_constant((-1) ** (k // 2) / factorial[k]) for k in range(0, 21, 2)]
    sine += (
        "zero + "
        + s_terms[-1]
        + "; "
        + " ".join(f"s_ = s_ * r2 + {t};" for t in reversed(s_terms[:-1]))
        + " s_ = s_ * r;"
    )
    cosine += "zero + " + c_terms[-1] + "; " + " ".join(f"c_ = c_ * r2 + {t};" for t in reversed(c_terms[:-1]))
    return f"""
auto sincos = [&](V z, V& s, V& c) {{
    const V q = z * {_constant(1 / np.pi)} + 6755399441055744.0; const V n = q - 6755399441055744.0;
    const V r = ((z - n * {_constant(high)}) - n * {_constant(middle)}) - n * {_constant(low)}; const V r2 = r * r;
    {sine}
    {cosine}
    FLIP(s, s_) FLIP(c, c_)
}};
"""


def _relax(activation: str) -> str:
    """A lambda ``relax_<activation>(z, width, slope, mean, spread)``; see ``network.relax``."""
    if activation == "tanh":
        return tanh_text()
    if activation == "relu":
        return """
auto relax_relu = [&](V z, V d, V& slope, V& mean, V& spread) {
    const V low = z - d; const V high = z + d; V s = high / (d + d);
    s = s < zero ? zero : s; s = s > zero + 1.0 ? zero + 1.0 : s;
    V e = s * low * -0.5; e = low < zero ? e : zero; e = high > zero ? e : zero;
    slope = s; mean = s * z + e; spread = e;
};
auto act_relu = [&](V z) { return z > zero ? z : zero; };
"""
    cube = _constant(1 / (9 * np.sqrt(3.0)))
    return f"""
auto relax_sin = [&](V z, V d, V& slope, V& mean, V& spread) {{
    V s, c; sincos(z, s, c); const V d2 = d * d;
    const V as = s < zero ? -s : s; const V ac = c < zero ? -c : c;
    const V e = ac * (d * d2 * ({cube} + d2 * {_constant(1 / 120)})) + as * d2 * 0.25 + {_constant(4 * SINE_SLACK)};
    slope = c - c * d2 * {_constant(1 / 6)}; mean = s - s * d2 * 0.25;
    slope = e > 1.0 ? zero : slope; mean = e > 1.0 ? zero : mean; spread = e > 1.0 ? zero + 1.0 : e;
}};
auto act_sin = [&](V z) {{ V s, c; sincos(z, s, c); return s; }};
"""


def _body(sizes: NetworkSizes) -> str:
    """From ``V low[], high[]`` to ``V least, value, score[]``, ``V gradient[]``; weights at ``w``."""
    n = sizes.ndim
    each = range(n)
    lines = [f"V least = zero, value = zero, score[{n}], gradient[{n}], center[{n}], radius[{n}];"]
    lines += [
        f"center[{k}] = (low[{k}] + high[{k}]) * 0.5; radius[{k}] = (high[{k}] - low[{k}]) * 0.5; score[{k}] = zero;"
        for k in each
    ]
    at = 0
    offsets = []
    for index, (inputs, neurons, _, _) in enumerate(sizes.layers):
        offsets.append(at)
        a = index
        lines.append(
            f"V mean{a}[{neurons}], noise{a}[{neurons}], width{a}[{neurons}], slope{a}[{neurons}], spread{a}[{neurons}];"
        )
        lines.append(f"V {', '.join(f'rate{a}_{k}[{neurons}], part{a}_{k}[{neurons}]' for k in each)};")
        lines.append(
            f"{{ const double* b = w + {at}; const double* weight = b + {neurons}; const double pad = padding[{a}];"
        )
        if index == 0:
            lines.append(f"for (int j = 0; j < {neurons}; ++j) {{ V z = zero + b[j], d = zero + pad, g[{n}];")
            for k in each:
                lines.append(f"{{ const double x = weight[j * {n} + {k}]; g[{k}] = zero + x; z += center[{k}] * x; }}")
            lines.append("const V from = zero;")
            lines += _neuron(sizes, index, "j", n)
            lines.append("}")
        else:
            for first, rows, blocks in _blocks(neurons):
                lines.append(f"for (int t = 0; t < {blocks}; ++t) {{ const int j = {first} + t * {rows};")
                lines.append(f"const double* x = weight + j * {inputs}; const double* ax = x + {neurons * inputs};")
                for r in range(rows):
                    lines.append(
                        f"V z{r} = zero + b[j + {r}], o{r} = zero; V {', '.join(f'g{r}_{k} = zero' for k in each)};"
                    )
                lines.append(f"for (int i = 0; i < {inputs}; ++i) {{ const V m = mean{a - 1}[i], e = noise{a - 1}[i];")
                lines.append(" ".join(f"const V p{k} = part{a - 1}_{k}[i];" for k in each))
                for r in range(rows):
                    lines.append(
                        f"{{ const double y = x[{r * inputs} + i]; z{r} += m * y; o{r} += e * ax[{r * inputs} + i];"
                    )
                    lines.append(" ".join(f"g{r}_{k} += p{k} * y;" for k in each) + " }")
                lines.append("}")
                for r in range(rows):
                    lines.append(
                        f"{{ V z = z{r}, d = o{r} + pad; const V from = o{r}; V g[{n}]; {' '.join(f'g[{k}] = g{r}_{k};' for k in each)}"
                    )
                    lines += _neuron(sizes, index, f"j + {r}", n)
                    lines.append("}")
                lines.append("}")
        lines.append("}")
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
        lines += [f"score[{k}] += share * rate{index}_{k}[j];" for k in each]
        lines.append(f"c *= slope{index}[j]; const double* x = w + {offsets[index] + neurons} + j * {inputs};")
        lines.append(f"for (int i = 0; i < {inputs}; ++i) {below}[i] += c * x[i]; }}")
    lines.append(f"V h[{n}];")
    for k in each:
        lines.append(f"{{ const V a = gradient[{k}] < zero ? -gradient[{k}] : gradient[{k}]; least -= a * radius[{k}];")
        lines.append(f"score[{k}] *= radius[{k}]; h[{k}] = gradient[{k}] > zero ? low[{k}] : high[{k}]; }}")
    source = "h"
    for index, (inputs, neurons, activation, linear) in enumerate(sizes.layers):  # f at the corner that looks lowest
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
    lines.append(f"value = zero + w[{at}]; for (int j = 0; j < {count}; ++j) value += {source}[j] * w[{at + 1} + j];")
    return "\n".join(lines)


def _blocks(neurons: int) -> list[tuple[int, int, int]]:
    """``(first, rows, repetitions)`` of blocks of ``ROWS`` neurons, and the rest."""
    blocks = [(0, ROWS, neurons // ROWS), (neurons // ROWS * ROWS, neurons % ROWS, 1)]
    return [block for block in blocks if block[1] and block[2]]


def _neuron(sizes: NetworkSizes, index: int, j: str, n: int) -> list[str]:
    """From z, d (half-width but for the box's own share), g (gradient) and from (noise of earlier layers) to the layer's arrays."""
    _, _, activation, linear = sizes.layers[index]
    lines = []
    for k in range(n):
        lines.append(
            f"{{ const V a = g[{k}] < zero ? -g[{k}] : g[{k}]; rate{index}_{k}[{j}] = a; d += a * radius[{k}]; }}"
        )
    lines.append(f"V s, m, e; relax_{activation}(z, d, s, m, e);")
    if linear:
        lines.append(f"if ({j} < {linear}) {{ s = zero + 1.0; m = z; e = zero; }}")
    lines.append("e += pad; const V as = s < zero ? -s : s;")
    lines.append(
        f"mean{index}[{j}] = m; slope{index}[{j}] = s; spread{index}[{j}] = e; width{index}[{j}] = d; noise{index}[{j}] = as * from + e;"
    )
    lines += [f"part{index}_{k}[{j}] = g[{k}] * s;" for k in range(n)]
    return lines


def snippet(sizes: NetworkSizes) -> str:
    """The body of the native function ``bound_block`` of ``network_kernel``: one block of boxes on a CPU, one box on CUDA."""
    n = sizes.ndim
    tools = _sincos() + "".join(_relax(a) for a in sorted({layer[2] for layer in sizes.layers}))
    vector_flip = "const I sign = (I)q << 63;"
    scalar_flip = "const bool odd = ((long long)n) & 1;"
    pick = "\n".join(
        f"if (score[{k}]{{at}} > most) {{{{ most = score[{k}]{{at}}; best = {k}; }}}}" for k in range(1, n)
    )
    after = f"(k == best ? {_constant(HALVED)} : 1.0)"  # what halving the best axis leaves of its score
    again = f"double left[{n}]; {' '.join(f'left[{k}] = score[{k}]{{at}};' for k in range(n))}"
    again += (
        f" int second = 0; double next = -1.0; for (int k = 0; k < {n}; ++k) {{{{ const double x = left[k] * {after};"
    )
    again += " if (x > next) {{ next = x; second = k; }} }}"
    write = "\n".join(
        f"point.data[{{o}} * {n} + {k}] = gradient[{k}]{{at}} > 0.0 ? low[{k}]{{at}} : high[{k}]{{at}};"
        for k in range(n)
    )
    store = (
        "{{ int best = 0; double most = score[0]{at}; (void)most;\n"
        + pick
        + "\n"
        + " ".join(f"gradient_out.data[{{o}} * {n} + {k}] = gradient[{k}]{{at}};" for k in range(n))
        + "least_out.data[{o}] = least{at}; value_out.data[{o}] = value{at}; axis.data[{o}] = best; "
        + again
        + " axis.data[count + {o}] = second;\n"
        + write
        + " }}"
    )
    inputs = "const double* w = weights.data; const double* padding = paddings.data;"
    body = _body(sizes)
    cpu_tools = tools.replace("FLIP(s, s_)", vector_flip + " s = (V)((I)s_ ^ sign);").replace(
        "FLIP(c, c_)", "c = (V)((I)c_ ^ sign);"
    )
    cuda_tools = tools.replace("FLIP(s, s_)", scalar_flip + " s = odd ? -s_ : s_;").replace(
        "FLIP(c, c_)", "c = odd ? -c_ : c_;"
    )
    load = "\n".join(
        f"low[{k}]{{at}} = lower.data[(long long){{j}} * {n} + {k}]; high[{k}]{{at}} = upper.data[(long long){{j}} * {n} + {k}];"
        for k in range(n)
    )
    return f"""
#if !defined(__CUDA_ARCH__)
#pragma clang fp contract(fast)
constexpr int L = 8;
typedef double V __attribute__((vector_size(8 * L))); typedef long long I __attribute__((vector_size(8 * L)));
const V zero = {{}};
{inputs}
{cpu_tools}
const int begin = block * {BLOCK}; const int end = begin + {BLOCK} < count ? begin + {BLOCK} : count;
for (int i = begin; i < end; i += L) {{
V low[{n}], high[{n}];
for (int l = 0; l < L; ++l) {{ const int j = i + l < end ? i + l : end - 1; {load.format(at="[l]", j="j")} }}
{body}
for (int l = 0; l < L && i + l < end; ++l) {store.format(at="[l]", o="(long long)(i + l)")}
}}
#else
typedef double V;
const V zero = 0.0;
{inputs}
{cuda_tools}
const int i = block; if (i >= count) return;
V low[{n}], high[{n}];
{load.format(at="", j="i")}
{body}
{store.format(at="", o="(long long)i")}
#endif
"""
