// A network on tensor cores, for networks/tensor_cores.py.

/// TOOLS:
/// What the text is written in: numbers (``V``) and pairs of float16 numbers (``U``), one in each lane.
typedef unsigned int U;
const int lane = threadIdx.x & 31;
auto across = [](V x, int mask) { return __shfl_xor_sync(0xffffffffu, x, mask); };
auto pair = [](V first, V second) {
    U both; asm("cvt.rn.f16x2.f32 %0, %1, %2;" : "=r"(both) : "f"(second), "f"(first)); return both;
};
auto first_of = [](U both) {
    V x; asm("{.reg .b16 a, b; mov.b32 {a, b}, %1; cvt.f32.f16 %0, a;}" : "=f"(x) : "r"(both)); return x;
};
auto second_of = [](U both) {
    V x; asm("{.reg .b16 a, b; mov.b32 {a, b}, %1; cvt.f32.f16 %0, b;}" : "=f"(x) : "r"(both)); return x;
};
auto sine = [](V z) { V h; asm("sin.approx.f32 %0, %1;" : "=f"(h) : "f"(z)); return h; };
auto mma16 = [](V* d, U a0, U a1, U a2, U a3, U b0, U b1, const V* c) {
    asm("mma.sync.aligned.m16n8k16.row.col.f32.f16.f16.f32 "
        "{%0, %1, %2, %3}, {%4, %5, %6, %7}, {%8, %9}, {%10, %11, %12, %13};"
        : "=f"(d[0]), "=f"(d[1]), "=f"(d[2]), "=f"(d[3])
        : "r"(a0), "r"(a1), "r"(a2), "r"(a3), "r"(b0), "r"(b1), "f"(c[0]), "f"(c[1]), "f"(c[2]), "f"(c[3]));
};
auto mma8 = [](V* d, U a0, U a1, U b0, const V* c) {
    asm("mma.sync.aligned.m16n8k8.row.col.f32.f16.f16.f32 {%0, %1, %2, %3}, {%4, %5}, {%6}, {%7, %8, %9, %10};"
        : "=f"(d[0]), "=f"(d[1]), "=f"(d[2]), "=f"(d[3])
        : "r"(a0), "r"(a1), "r"(b0), "f"(c[0]), "f"(c[1]), "f"(c[2]), "f"(c[3]));
};
auto words_of = [&](const float* at, int index, U* to) {  // four words of each lane
    const uint4 four = __ldg((const uint4*)at + index * 32 + lane);
    to[0] = four.x; to[1] = four.y; to[2] = four.z; to[3] = four.w;
};
auto number = [](U word) { return __uint_as_float(word); };

/// BEGIN:
/// From the coordinates v of a lane's own query, ``8 t + g`` of 32, to f of that query. ``y[c]`` are four coordinates,
/// the last of all being 1, which the first layer's biases are weights of.
V y[$groups][4]; U p[$groups][4];
#pragma unroll
for (int c = 0; c < $groups; ++c) {
#pragma unroll
    for (int k = 0; k < 4; ++k) y[c][k] = zero;
#pragma unroll
    for (int k = 0; k < 4; ++k) if (4 * c + k < $coordinates) y[c][k] = v[4 * c + k];
#pragma unroll
    for (int k = 0; k < 4; ++k) if (4 * c + k == $coordinates) y[c][k] = zero + 1.0f;
    // a lane has four coordinates of a query, and gets one coordinate of the four queries of its group
#pragma unroll
    for (int k = 0; k < 4; k += 2) {
        const V kept = (lane & 1) ? y[c][k + 1] : y[c][k], got = across((lane & 1) ? y[c][k] : y[c][k + 1], 1);
        y[c][k] = (lane & 1) ? got : kept; y[c][k + 1] = (lane & 1) ? kept : got;
    }
#pragma unroll
    for (int k = 0; k < 2; ++k) {
        const V kept = (lane & 2) ? y[c][k + 2] : y[c][k], got = across((lane & 2) ? y[c][k] : y[c][k + 2], 2);
        y[c][k] = (lane & 2) ? got : kept; y[c][k + 2] = (lane & 2) ? kept : got;
    }
#pragma unroll
    for (int r = 0; r < 4; ++r) p[c][r] = pair(y[c][r], y[c][r] - first_of(pair(y[c][r], zero)));
}
V out_[4];
#pragma unroll
for (int r = 0; r < 4; ++r) out_[r] = zero;

/// FIRST
U b[$words];
#pragma unroll
for (int k = 0; k < $words; k += 4) words_of(tensor + $header, $at + (j * $words + k) / 4, b + k);
V d[2][4];
const V none[4] = {zero, zero, zero, zero};
#pragma unroll
for (int c = 0; c < $groups; ++c)
#pragma unroll
    for (int m = 0; m < 2; ++m)
    {
        const U one = p[c][2 * m], two = p[c][2 * m + 1];
        mma16(d[m], one, two, one, two, b[2 * c], b[2 * c + 1], c ? d[m] : none);
    }

/// NEXT:
/// x, its low parts x_: of the layer before. The small products first.
U b[$words];
#pragma unroll
for (int k = 0; k < $words; k += 4) words_of(tensor + $header, $at + (j * $words + k) / 4, b + k);
V d[2][4];
const V bias[4] = {number(b[0]), number(b[1]), number(b[2]), number(b[3])};
#pragma unroll
for (int part = 0; part < 3; ++part) {
#pragma unroll
    for (int k = 0; k < $inputs; k += 2) {
        const U* w_ = b + 4 + (part == 1 ? $inputs : 0) + k;
#pragma unroll
        for (int m = 0; m < 2; ++m) {
            const U (*a)[2] = part == 0 ? x_low[m] : x_high[m];
            const V* c = part == 0 && k == 0 ? bias : d[m];
            if (k + 1 < $inputs) mma16(d[m], a[k][0], a[k][1], a[k + 1][0], a[k + 1][1], w_[0], w_[1], c);
            else mma8(d[m], a[k][0], a[k][1], w_[0], c);
        }
    }
}

/// KEEP
#pragma unroll
for (int m = 0; m < 2; ++m)
#pragma unroll
    for (int h = 0; h < 2; ++h) {
        const V one = sine(d[m][2 * h]), two = sine(d[m][2 * h + 1]);
        const U high = pair(one, two);
        y_high[m][j][h] = high;
        y_low[m][j][h] = pair(one - first_of(high), two - second_of(high));
    }

/// LAST
#pragma unroll
for (int m = 0; m < 2; ++m)
#pragma unroll
    for (int h = 0; h < 2; ++h) {
        out_[2 * m + h] += sine(d[m][2 * h]) * number(b[$out]);
        out_[2 * m + h] += sine(d[m][2 * h + 1]) * number(b[$out + 1]);
    }

/// END:
/// Each lane has four sums over its neurons, of the queries of its group, and gets the whole sum of its own query.
#pragma unroll
for (int k = 0; k < 4; k += 2) {
    const V kept = (lane & 1) ? out_[k + 1] : out_[k];
    out_[k] = kept + across((lane & 1) ? out_[k] : out_[k + 1], 1);
}
f = ((lane & 2) ? out_[2] : out_[0]) + across((lane & 2) ? out_[0] : out_[2], 2) + tensor[1];
