"""The C text of bounds over boxes: from ``V low[], high[]``, a box a lane, to its bound, layer by layer and back.

Names in capitals are constants that are written in front of a text, or other texts. The network's chart has K inputs
and C columns, and Z numbers a box. A layer has INPUTS and NEURONS, of which the LINEAR leading ones are passed through,
and its numbers begin at the index AT of ``w``.
"""

__all__ = [
    "AXIS",
    "BACKWARDS",
    "CLOSE",
    "CONSTRAIN",
    "CPU",
    "CUDA",
    "FIRST",
    "LATER",
    "LAYER",
    "NEURON",
    "STORE",
    "VALUES",
]

CPU = """
#pragma clang fp contract(fast)
#define LANE(x) x[l]
constexpr int L = 8;
typedef double V __attribute__((vector_size(8 * L))); typedef long long I __attribute__((vector_size(8 * L)));
const V zero = {};
auto root = [](V x) { return __builtin_elementwise_sqrt(x); };
"""
CUDA = """
#define LANE(x) x
constexpr int L = 1;
typedef double V;
const V zero = 0.0;
auto root = [](V x) { return sqrt(x); };
"""


# What is known of a layer's neurons. The argument of each is a centre plus l + y: l = rate . zeta is linear, |l| <=
# near, y is all that is not linear in the layers below, and |l + y| <= width, rounding included. The output is     h =
# mean + slope l + bend (l^2 - near^2 / 2) + y', |y'| and the parabola together at most noise; spread is what the
# activation's own relaxation adds to y', and part = slope rate is the linear part of h. The arrays are declared one by
# one, so that the compiler drops those that nobody reads.
LAYER = """
V LAYER_mean[NEURONS], LAYER_noise[NEURONS], LAYER_width[NEURONS], LAYER_slope[NEURONS], LAYER_spread[NEURONS];
V LAYER_near[NEURONS], LAYER_bend[NEURONS], LAYER_rate[C][NEURONS], LAYER_part[C][NEURONS];
const struct {
    V *mean, *noise, *width, *slope, *spread, *near, *bend, (*rate)[NEURONS], (*part)[NEURONS];
} LAYER = {
    LAYER_mean, LAYER_noise, LAYER_width, LAYER_slope, LAYER_spread, LAYER_near, LAYER_bend, LAYER_rate, LAYER_part,
};
"""

# Neuron j from the centre z of its argument, its generators g (rate) and the largest |y|, from: the activation is
# m + s (l + y) + k2 l^2 +- e, and what is passed on has its centre at m + k2 near^2 / 2.
NEURON = """
V near = zero;
for (int k = 0; k < C; ++k) { own.rate[k][j] = g[k]; near += absolute(g[k]); }
V s, m, e, k2 = zero;
relax(z, near, from + pad, s, m, k2, e);
if (j < LINEAR) { s = zero + 1.0; m = z; e = zero; k2 = zero; }
e += pad;
const V half = near * near * 0.5;
own.mean[j] = m + k2 * half; own.slope[j] = s; own.spread[j] = e; own.width[j] = near + from + pad;
own.noise[j] = absolute(s) * from + absolute(k2) * half + e;
own.near[j] = near; own.bend[j] = k2;
for (int k = 0; k < C; ++k) own.part[k][j] = g[k] * s;
"""

# The first hidden layer, of the chart's inputs; GENERATORS fills g, whose entries are sparse.
FIRST = """
for (int j = 0; j < NEURONS; ++j) {
    const double* x = weight + j * INPUTS;
    V z = zero + b[j], from = zero, g[C];
    for (int i = 0; i < INPUTS; ++i) z += center[i] * x[i];
    GENERATORS
    if (NOISY) for (int i = 0; i < INPUTS; ++i) from += noise[i] * x[NEURONS * INPUTS + i];
    NEURON
    for (int k = 0; k < C; ++k) score[k] += absolute(g[k]) * FIRST_LAYER;
}
"""

# A later layer: BLOCKS blocks of R neurons from FIRST on, which share each input as it is loaded.
LATER = """
for (int t = 0; t < BLOCKS; ++t) {
    const double* x = weight + (FIRST + t * R) * INPUTS; const double* ax = x + NEURONS * INPUTS;
    V centers[R], noises[R], generators[R][C];
#pragma unroll
    for (int r = 0; r < R; ++r) {
        centers[r] = zero + b[FIRST + t * R + r]; noises[r] = zero;
#pragma unroll
        for (int k = 0; k < C; ++k) generators[r][k] = zero;
    }
    for (int i = 0; i < INPUTS; ++i) {
        const V m = below.mean[i], e = below.noise[i];
#pragma unroll
        for (int r = 0; r < R; ++r) {
            const double y = x[r * INPUTS + i];
            centers[r] += m * y; noises[r] += e * ax[r * INPUTS + i];
#pragma unroll
            for (int k = 0; k < C; ++k) generators[r][k] += below.part[k][i] * y;
        }
    }
#pragma unroll
    for (int r = 0; r < R; ++r) {
        const int j = FIRST + t * R + r;
        const V z = centers[r], from = noises[r]; const V* g = generators[r];
        NEURON
    }
}
"""

# Backwards through a layer: its lines and parabolas are weighed by back, the output's coefficients of its neurons; what
# each neuron's spread costs is taken from least and charged to the columns that caused it (score); to receives the
# output's coefficients of what the layer computes with.
BACKWARDS = """
for (int i = 0; i < INPUTS; ++i) to[i] = zero;
for (int j = 0; j < NEURONS; ++j) {
    V c = back[j];
    const V loss = absolute(c) * own.spread[j]; least -= loss;
    const V share = loss / own.width[j];
#pragma unroll
    for (int k = 0; k < C; ++k) score[k] += share * absolute(own.rate[k][j]);
    if (BENDS) {
        const V bow = c * own.bend[j], n2 = own.near[j] * own.near[j];
        least -= bow * n2 * 0.5; bulk += absolute(bow) * n2;
        int entry = 0;
#pragma unroll
        for (int k = 0; k < C; ++k) {
            const V bent = bow * own.rate[k][j];
#pragma unroll
            for (int m = k; m < C; ++m) square[entry++] += bent * own.rate[m][j];
        }
    }
    c *= own.slope[j];
    const double* x = w + AT + NEURONS + j * INPUTS;
    for (int i = 0; i < INPUTS; ++i) to[i] += c * x[i];
}
"""

# A constraint excess + q . zeta <= 0 on the columns OF, M of them, added to the linear bound with the multiplier that
# serves it best. For any multiplier t >= 0 the bound least - sum |slope + t q| + t excess holds at all points that obey
# the constraint; it is concave in t, and largest where an entry of slope + t q vanishes, or at 0. Relative to the sum
# of the absolute terms, 1e-14 is above the rounding of the few operations here.
CONSTRAIN = """
V best = zero, gain = zero, before = absolute(slope[OF[0]]);
for (int j = 1; j < M; ++j) before += absolute(slope[OF[j]]);
#pragma unroll
for (int k = 0; k < M; ++k) {
    const V own = q[k] == zero ? zero + 1.0 : q[k];
    V t = -slope[OF[k]] / own;
    t = q[k] == zero ? zero : t; t = t > zero ? t : zero;
    V after = t * excess + before;
#pragma unroll
    for (int j = 0; j < M; ++j) after -= absolute(slope[OF[j]] + t * q[j]);
    best = after > gain ? t : best; gain = after > gain ? after : gain;
}
for (int k = 0; k < M; ++k) slope[OF[k]] += best * q[k];
least += best * excess - (best * absolute(excess) + before + 1.0) * 1e-14;
"""

# The least of the quadratic form over |zeta| <= 1, entry by entry. Entries off the diagonal count in absolute value. An
# entry q >= 0 of the diagonal goes with its slope, the least of -s |zeta| + q zeta^2 being at zeta = s / (2 q) if that
# is less than 1, else at the end; a negative one is least at the end.
CLOSE = """
int entry = 0;
#pragma unroll
for (int k = 0; k < C; ++k) {
#pragma unroll
    for (int m = k; m < C; ++m, ++entry) {
        const V q = absolute(square[entry]);
        if (m == k) { score[k] += q; least -= square[entry] < zero ? q : zero; }
        else { least -= q; score[k] += q * 0.5; score[m] += q * 0.5; }
    }
}
least -= bulk * SQUARES_ROUNDING; level = least;
entry = 0;
#pragma unroll
for (int k = 0; k < C; entry += C - k, ++k) {
    const V s = absolute(slope[k]), q = square[entry] > zero ? square[entry] : zero;
    const V end = q - s, inner = s * s * -0.25 / (q > zero ? q : zero + 1.0);
    least += s < q + q ? inner : end;
}
"""

# f itself: a layer's activations y from the inputs x, in blocks as in LATER.
VALUES = """
for (int t = 0; t < BLOCKS; ++t) {
    const double* weight = b + NEURONS + (FIRST + t * R) * INPUTS;
    V sums[R];
#pragma unroll
    for (int r = 0; r < R; ++r) sums[r] = zero + b[FIRST + t * R + r];
    for (int i = 0; i < INPUTS; ++i) {
        const V m = x[i];
#pragma unroll
        for (int r = 0; r < R; ++r) sums[r] += m * weight[r * INPUTS + i];
    }
#pragma unroll
    for (int r = 0; r < R; ++r) { const int j = FIRST + t * R + r; y[j] = j < LINEAR ? sums[r] : act(sums[r]); }
}
"""


# The number of z that is best halved in lane l: the owner of the column with most score.
AXIS = """
int axis; {
    double most = LANE(score[0]); axis = (int)LANE(owner[0]);
    for (int k = 1; k < C; ++k) if (LANE(score[k]) > most) { most = LANE(score[k]); axis = (int)LANE(owner[k]); }
}
"""

STORE = """
const long long o = i + l;
least_out.data[o] = LANE(dead) != 0.0 ? INFINITY : LANE(least);
value_out.data[o] = LANE(valid) != 0.0 && LANE(dead) == 0.0 ? LANE(value) : INFINITY;
level_out.data[o] = LANE(level);
axes.data[o] = axis;
double next = -1.0; int second = axis; // the number to halve next, when the columns that axis owns are halved
for (int k = 0; k < C; ++k) {
    const double s = LANE(score[k]) * ((int)LANE(owner[k]) == axis ? HALVED : 1.0);
    if (s > next) { next = s; second = (int)LANE(owner[k]); }
}
axes.data[count + o] = second;
for (int k = 0; k < Z; ++k) point.data[o * Z + k] = LANE(z[k]);
for (int k = 0; k < K; ++k) gradient_out.data[o * K + k] = LANE(gradient[k]);
for (int k = 0; k < Z; ++k) { rows[o * (2 * Z) + k] = LANE(low[k]); rows[o * (2 * Z) + Z + k] = LANE(high[k]); }
"""
