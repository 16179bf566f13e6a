"""The C text of the field's look-up: multilinear interpolation between the 2^M nodes around a point, neighbours in pairs."""

__all__ = ["ALONE", "TEXT", "TOGETHER"]

TEXT = """
{
    constexpr int M = $m;
    constexpr int NODES[M] = {$nodes}, STRIDES[M] = {$strides};
    V share[M], c[1 << M];
    $integer base = {};
#pragma unroll
    for (int k = 0; k < M; ++k) {  // node coordinate t, cut at the grid's ends, and the node below
        const float last = NODES[k] - 1;
        V t = v[k] * w[k] + w[M + k];
        t = t < 0.0f ? t * 0.0f : t;
        t = t > last ? t * 0.0f + last : t;
        const V low = t > last - 1.0f ? t * 0.0f + (last - 1.0f) : t;
        const $integer i = $to_integer;
        share[k] = t - $to_real;
        base += i * STRIDES[k];
    }
#pragma unroll
    for (int corner = 0; corner < 1 << M; ++corner) {  // bit M - 1 - k tells whether it is the upper one along axis k
        int at = 2 * M;
#pragma unroll
        for (int k = 0; k < M; ++k) at += (corner >> (M - 1 - k) & 1) * STRIDES[k];
        $gather
    }
#pragma unroll
    for (int k = M - 1; k >= 0; --k)
#pragma unroll
        for (int pair = 0; pair < 1 << k; ++pair)
            c[pair] = c[2 * pair] + (c[2 * pair + 1] - c[2 * pair]) * share[k];
    f = c[0] < 0.0f ? c[0] * 0.0f : c[0];
    f = f > 1.0f ? f * 0.0f + 1.0f : f;
}
"""

TOGETHER = {
    "integer": "I",
    "to_integer": "__builtin_convertvector(low, I)",
    "to_real": "__builtin_convertvector(i, V)",
    "gather": "for (int l = 0; l < L; ++l) c[corner][l] = w[base[l] + at];",
}
ALONE = {"integer": "int", "to_integer": "(int)low", "to_real": "(float)i", "gather": "c[corner] = w[base + at];"}
