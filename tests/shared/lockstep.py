"""The text of networks for tensor cores, run on a CPU: 32 lanes in lockstep."""

import numpy as np
from asking import run_text

from warp_bounding.networks import tensor_cores
from warp_bounding.networks.inference import MlpSource

# What ``tensor_cores.TOOLS`` says on CUDA, said of 32 lanes at a time: fragments as the PTX manual lays them out, sums
# that are cut as the module's second claim allows, at the worst.
LOCKSTEP = """
typedef int I __attribute__((vector_size(128)));
struct U { V a, b; };
I lane; for (int l = 0; l < 32; ++l) lane[l] = l;
auto across = [](V x, int mask) __attribute__((noinline)) {
    V y; for (int l = 0; l < 32; ++l) y[l] = x[l ^ mask]; return y;
};
auto half = [](V x) __attribute__((noinline)) {
    V y;
    for (int l = 0; l < 32; ++l) {
        double a = x[l], unit = 0x1p-24;
        while (unit * 2048 <= (a < 0 ? -a : a)) unit *= 2;
        y[l] = (float)(__builtin_rint(a / unit) * unit);
    }
    return y;
};
auto pair = [&](V a, V b) { U u; u.a = half(a); u.b = half(b); return u; };
auto first_of = [](U u) { return u.a; };
auto second_of = [](U u) { return u.b; };
auto sine = [](V z) __attribute__((noinline)) {
    V h; for (int l = 0; l < 32; ++l) h[l] = (float)__builtin_sin((double)z[l]); return h;
};
auto size_of = [](double x) { return x < 0 ? -x : x; };
auto mma = [&](V* d, const U* a, const U* b, int ks, const V* c) __attribute__((noinline)) {
    V result[4];
    for (int l = 0; l < 32; ++l)
        for (int e = 0; e < 4; ++e) {
            const int row = l / 4 + 8 * (e / 2), col = 2 * (l % 4) + e % 2;
            double sum = c[e][l], largest = size_of(sum);
            for (int k = 0; k < 8 * ks; ++k) {
                const int from = 4 * (row % 8) + k % 8 / 2, to = 4 * col + k % 8 / 2;
                const U x = a[2 * (k / 8) + row / 8], w = b[k / 8];
                const double term = (double)(k % 2 ? x.b[from] : x.a[from]) * (k % 2 ? w.b[to] : w.a[to]);
                sum += term;
                if (size_of(term) > largest) largest = size_of(term);
            }
            result[e][l] = (float)(sum - CUTS * 0x0.fp-23 * ((8 * ks + 1) * 0.5 * largest + size_of(sum)));
        }
    for (int e = 0; e < 4; ++e) d[e] = result[e];
};
auto mma16 = [&](V* d, U a0, U a1, U a2, U a3, U b0, U b1, const V* c) {
    const U a[4] = {a0, a1, a2, a3}, b[2] = {b0, b1}; mma(d, a, b, 2, c);
};
auto mma8 = [&](V* d, U a0, U a1, U b0, const V* c) { const U a[2] = {a0, a1}, b[1] = {b0}; mma(d, a, b, 1, c); };
struct Word {
    unsigned int bits[32];
    operator U() const {
        U u;
        for (int l = 0; l < 32; ++l)
            for (int k = 0; k < 2; ++k) {
                const unsigned int h = bits[l] >> 16 * k & 0xffffu, e = h >> 10 & 31;
                const unsigned int low = h & 1023;
                const float size = e ? (1024 + low) * __builtin_ldexpf(1.0f, (int)e - 25) : low * 0x1p-24f;
                (k ? u.b : u.a)[l] = h >> 15 ? -size : size;
            }
        return u;
    }
};
auto words_of = [](const float* at, int index, Word* to) __attribute__((noinline)) {
    for (int l = 0; l < 32; ++l)
        for (int k = 0; k < 4; ++k) __builtin_memcpy(&to[k].bits[l], at + (index * 32 + l) * 4 + k, 4);
};
auto number = [](const Word& word) { V x; __builtin_memcpy(&x, word.bits, 128); return x; };
"""


def lockstep(source: MlpSource, numbers: np.ndarray, v: np.ndarray) -> np.ndarray:
    """f of coordinates ``(32, M)``: lane 4 g + t has query 8 t + g, as a kernel gives them out."""
    m = source.coordinates
    text = (
        tensor_cores.text(source)
        .replace(tensor_cores.TOOLS, LOCKSTEP)
        .replace("U b[", "Word b[")
        .replace("const U* w_", "const Word* w_")
    )
    text = text.replace("#pragma unroll\n", "#pragma clang loop unroll(disable)\n")
    snippet = f"""
#if !defined(__CUDA_ARCH__)
#pragma clang fp contract(off)
typedef float V __attribute__((vector_size(128), aligned(4)));
const V zero = {{}};
const float* tensor = numbers.data;
const double CUTS = tensor[7];
V v[{m}], f;
for (int l = 0; l < 32; ++l) for (int k = 0; k < {m}; ++k) v[k][l] = x.data[(8 * (l % 4) + l / 4) * {m} + k];
{text}
for (int l = 0; l < 32; ++l) out.data[8 * (l % 4) + l / 4] = f[l];
#endif
"""
    return run_text("_".join(map(str, ("lockstep", m, *source.hidden))), snippet, 1, v, numbers, 32)
