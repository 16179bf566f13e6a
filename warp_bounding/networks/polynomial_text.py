"""The C text of what becomes of the polynomial in zeta that a network is above on a box: its least, or its corners.

Its constant is ``least``, its other entries ``tilt``, ``square`` and ``cubes`` (``bound_text.BACKWARDS``); slopes of the
inputs are ``gradient``, and of the columns, tilt included, ``slope``.
"""

__all__ = ["CLOSE", "CONSTRAIN", "CORNERS", "STRAIGHTEN"]

# The cubic part of the polynomial, by entries: zeta^3 is within 1/4 of 3/4 zeta, and zeta_k^2 zeta_m within 1/2 |zeta_m|
# of 1/2 zeta_m; the lines go to tilt. Of three different ones the product counts in absolute value, or stays where the
# bound may be MULTILINEAR. Losses are shared among the columns of an entry.
STRAIGHTEN = """
int cube = 0;
const auto lose = [&](V loss, int a, int b, int d) {
    least -= loss; loss *= THIRD; score[a] += loss; score[b] += loss; score[d] += loss;
};
#pragma unroll
for (int a = 0; a < C; ++a)
#pragma unroll
    for (int b = a; b < C; ++b)
#pragma unroll
        for (int d = b; d < C; ++d, ++cube) {
            const V q = cubes[cube]; const V size = absolute(q);
            if (a == d) { tilt[a] += q * 0.75; lose(size * 0.25, a, b, d); }
            else if (a == b || b == d) { tilt[a == b ? d : a] += q * 1.5; lose(size * 1.5, a, b, d); }
            else if (!MULTILINEAR) lose(size * 6.0, a, b, d);
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

# The least of slope . zeta and the quadratic form over |zeta| <= 1, entry by entry. Of q zeta_k zeta_m, k != m, only
# -|q| is sure; but where it is +|q| in the corner where slope . zeta is least, it is above the planes
# -|q| + d (a zeta_k + b zeta_m) for all 0 <= d <= |q|, a and b being the signs that lower both slopes (McCormick), so
# that d is gained from either slope, until one is 0. An entry q >= 0 of the diagonal goes with what is left of its
# slope, the least of -s |zeta| + q zeta^2 being at zeta = s / (2 q) if that is less than 1, else at the end; a negative
# one is least at the end. Where the bound may be MULTILINEAR, entries off the diagonal stay. level is the bound's constant.
CLOSE = """
V steep[C];
for (int k = 0; k < C; ++k) steep[k] = absolute(slope[k]);
int entry = 0;
#pragma unroll
for (int k = 0; k < C; ++k) {
#pragma unroll
    for (int m = k; m < C; ++m, ++entry) {
        const V q = absolute(square[entry]);
        if (m == k) { score[k] += q; least -= square[entry] < zero ? q : zero; }
        else if (!MULTILINEAR) {
            least -= q; score[k] += q * 0.5; score[m] += q * 0.5;
            V gained = steep[k] < steep[m] ? steep[k] : steep[m]; gained = q < gained ? q : gained;
            gained = slope[k] * slope[m] * square[entry] > zero ? gained : zero;
            steep[k] -= gained; steep[m] -= gained;
        }
    }
}
least -= bulk * SQUARES_ROUNDING; level = least;
entry = 0;
#pragma unroll
for (int k = 0; k < C; entry += C - k, ++k) {
    const V s = steep[k], q = square[entry] > zero ? square[entry] : zero;
    const V end = q - s, inner = s * s * -0.25 / (q > zero ? q : zero + 1.0);
    least += s < q + q ? inner : end;
}
"""

# The values at the corners of what is left where the bound may be MULTILINEAR: place i is at the upper end of column k
# where bit k of i is set. 1e-13 of all terms is more than float64 rounds here, and in where the corners lie.
CORNERS = """
V corner[1 << C], size = absolute(level);
for (int k = 0; k < C; ++k) {
    size += absolute(slope[k]) + absolute(gradient[k]) * (absolute(low[k]) + absolute(high[k]));
    for (int m = k + 1; m < C; ++m) {
        size += absolute(square[place(k, m)]);
        for (int d = m + 1; d < C; ++d) size += absolute(cubes[triple(k, m, d)]) * 6.0;
    }
}
level -= size * 1e-13;
for (int i = 0; i < 1 << C; ++i) {
    const auto at = [&](int k, V x) { return (i >> k) & 1 ? x : -x; };
    V sum = level;
#pragma unroll
    for (int k = 0; k < C; ++k) {
        V by_k = slope[k];
#pragma unroll
        for (int m = k + 1; m < C; ++m) {
            V by_m = square[place(k, m)];
#pragma unroll
            for (int d = m + 1; d < C; ++d) by_m += at(d, cubes[triple(k, m, d)] * 6.0);
            by_k += at(m, by_m);
        }
        sum += at(k, by_k);
    }
    corner[i] = sum;
}
"""
