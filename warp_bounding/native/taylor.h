// Bounds of a network over boxes for certify (proof/taylor.py), a box a lane: Taylor polynomials of second degree at
// the box's centre forwards, and backwards what they leave out, times bounds of f's derivatives. Nothing of it is in
// bounds.h but the types of lanes.
//
// Names in capitals are constants that stand in front of a part. A layer has INPUTS and NEURONS; its numbers begin at the
// index AT of w. C columns of zeta, |zeta| <= 1; SQUARES entries k <= m of a form. The scopes of layers are nested: each
// sees that below it, and is left backwards.

/// SINE:
/// At z: coefficients a0 to a3 of a polynomial, and left, by how much it may be off within u; d, by how much the
/// derivative differs within b from a1 + s2 x; and the constant flat, off by spread within b. The Taylor polynomial of fourth
/// degree is off by |sin z| u^6 / 720 + |cos z| u^5 / 120, and x^4 is within u^4 / 8 of u^2 x^2 - u^4 / 8. Reduced to
/// |r| <= pi / 4 by multiples k of pi / 2, in three parts.
auto act_sin = [&](V z, V* cosine) {
    const V q = z * 0x1.45f306dc9c883p-1 + 6755399441055744.0, n = q - 6755399441055744.0;
    const V r = ((z - n * 0x1.921fb544p+0) - n * 0x1.0b4611a6p-34) - n * 0x1.3198a2e037073p-69, x = r * r;
    const V s = r + r * x * (-1 / 6.0 + x * (1 / 120.0 + x * (-1 / 5040.0 + x * (1 / 362880.0 + x * (-1 / 39916800.0
        + x * (1 / 6227020800.0 - x * (1 / 1307674368000.0)))))));
    const V c = 1.0 + x * (-0.5 + x * (1 / 24.0 + x * (-1 / 720.0 + x * (1 / 40320.0 + x * (-1 / 3628800.0
        + x * (1 / 479001600.0 - x * (1 / 87178291200.0)))))));
#if !defined(__CUDA_ARCH__)
    const I k = (I)q; const auto odd = (k & 1) != 0, minus = (k & 2) != 0, turned = ((k + 1) & 2) != 0;
#else
    const long long k = (long long)n; const bool odd = k & 1, minus = k & 2, turned = (k + 1) & 2;
#endif
    const V a = odd ? c : s, o = odd ? s : c;
    if (cosine) *cosine = turned ? -o : o;
    return minus ? -a : a;
};
auto taylor_sin = [&](V z, V u, V b, V& a0, V& a1, V& a2, V& a3, V& left, V& d, V& s2, V& flat, V& spread) {
    const V sine = act_sin(z, &a1), size = absolute(sine), u2 = u * u, u4 = u2 * u2;
    a0 = sine - sine * u4 * (1 / 192.0); a2 = sine * (u2 * (1 / 24.0) - 0.5); a3 = a1 * (-1 / 6.0);
    left = size * (u4 * (1 / 192.0) + u2 * u4 * (1 / 720.0)) + absolute(a1) * u4 * u * (1 / 120.0);
    s2 = -sine; d = (absolute(a1) * 0.5 + size * (1 / 6.0) * b) * b * b; flat = zero; spread = zero + 1.0;
};

/// RELU:
/// Where the kink is near: the chord of [z - u, z + u], moved down by half of its height.
auto act_relu = [&](V z, V*) { return z > zero ? z : zero; };
auto taylor_relu = [&](V z, V u, V b, V& a0, V& a1, V& a2, V& a3, V& left, V& d, V& s2, V& flat, V& spread) {
    const V size = absolute(z); const auto kink = size < u;
    a1 = kink ? (z + u) / (u + u) : (z > zero ? zero + 1.0 : zero);
    const V height = kink ? (u + z) * (u - z) / (u * 4.0) : zero;
    a0 = a1 * z + height; a2 = a3 = left = zero;
    d = size < b ? zero + 1.0 : zero; s2 = zero;
    spread = height; flat = a0;
};

/// BODY:
/// From a box to the bound and what else is stored; a layer in front of the first holds the box.
V least = zero, level = zero, value = zero, score[C], slope[C], radius[C], h[C], square[SQUARES], cubes[CUBES];
const auto entry = [](int k, int m) { return k * (2 * C - k + 1) / 2 + m - k; }; (void)entry;
const auto cube = [&](int a, int b, int d) {  // the place of a <= b <= d in cubes
    int before = 0;
    for (int k = 0; k < a; ++k) before += (C - k) * (C - k + 1) / 2;
    return before + entry(b, d) - entry(a, a);
};
struct { V top[LINES + SQUARES][C], off[1][C]; } own;
struct { V by[1 + C][C], wide[1][C]; } back;
for (int i = 0; i < C; ++i) {
    radius[i] = (high[i] - low[i]) * 0.5; score[i] = own.off[0][i] = zero;
    for (int e = 0; e < LINES + SQUARES; ++e) own.top[e][i] = zero;
    own.top[0][i] = (low[i] + high[i]) * 0.5; own.top[1 + i][i] = radius[i];
}
for (int e = 0; e < CUBES; ++e) cubes[e] = zero;
$product
$layers
$close
for (int k = 0; k < C; ++k) h[k] = slope[k] > zero ? low[k] : high[k];
{
    const V* y = h;
    $values
}

/// OUTPUT:
/// Behind the last hidden layer, of which LAST neurons are left.
least = zero + (w[AT_OUTPUT] - pads[LAYERS]);
V sums[LINES + SQUARES][1];
product(own.top, w + AT_OUTPUT + 1, sums, 0, 1);
least += sums[0][0];
for (int k = 0; k < C; ++k) slope[k] = sums[1 + k][0];
for (int e = 0; e < SQUARES; ++e) square[e] = sums[LINES + e][0];
for (int j = 0; j < LAST; ++j) {
    for (int k = 0; k <= C; ++k) back.by[k][j] = zero + (k ? 0.0 : w[AT_OUTPUT + 1 + j]);
    back.wide[0][j] = zero;
}

/// OUTPUT_VALUE
value = zero + w[AT_OUTPUT];
for (int j = 0; j < LAST; ++j) value += y[j] * w[AT_OUTPUT + 1 + j];

/// LAYER:
/// Rows of numbers of a layer's neurons. Of the arguments, in of: l and q, linear and quadratic in zeta, |l| <= near,
/// |q| <= bow. Of the polynomials of activations, which the next layer reads, in top: v + g . zeta + the form s. Both
/// begin with the constant and C rows; these LINES rows end where SQUARES others begin. off is how far an activation may
/// be from its polynomial, on the way from any layer below. Of what a polynomial leaves out: 2 a2 l q + a3 l^3, at most
/// turned, and rest. The derivative is within d of slope + s2 l: of the range that it has within LEAST and 1 where that
/// is less.
const auto& below = own;
auto& to = back; (void)to;
struct {
    V of[LINES + BENT * SQUARES][NEURONS], top[LINES + SQUARES][NEURONS], off[1][NEURONS], near[NEURONS];
    V slope[NEURONS], s2[NEURONS], a2[NEURONS], a3[NEURONS], rest[NEURONS], turned[NEURONS], d[NEURONS];
} own;
struct { V by[1 + C][NEURONS], wide[1][NEURONS]; } back;

/// PRODUCT:
/// to[e][j], for all e and j, is the sum over i of from[e][i] times the weight at by_made j + by_summed i. E times R of
/// them share what is loaded; the last ones lap over those before.
const auto product = [&](const auto& from, const double* weights, auto& to, int by_made, int by_summed) {
    constexpr int SUMMED = sizeof(from[0]) / sizeof(V), MADE = sizeof(to[0]) / sizeof(V);
    constexpr int COUNT = sizeof(to) / sizeof(to[0]), E = COUNT < 3 ? COUNT : 3, R = MADE < 6 / E ? MADE : 6 / E;
    for (int e = 0; e < COUNT; e += E)
        for (int j = 0; j < MADE; j += R) {
            const int row = e + E < COUNT ? e : COUNT - E, first = j + R < MADE ? j : MADE - R;
            const double* x = weights + first * by_made;
            V sum[E][R];
#pragma unroll
            for (int a = 0; a < E; ++a)
#pragma unroll
                for (int b = 0; b < R; ++b) sum[a][b] = zero;
            for (int i = 0; i < SUMMED; ++i)
#pragma unroll
                for (int a = 0; a < E; ++a) {
                    const V own = from[row + a][i];
#pragma unroll
                    for (int b = 0; b < R; ++b) sum[a][b] += own * x[b * by_made + i * by_summed];
                }
#pragma unroll
            for (int a = 0; a < E; ++a)
#pragma unroll
                for (int b = 0; b < R; ++b) to[row + a][first + b] = sum[a][b];
        }
};

/// FORWARDS:
/// taylor is the activation's; BENT tells whether the polynomials of the layer below have quadratic terms.
product(below.top, x, own.of, INPUTS, 1);
product(below.off, x + NEURONS * INPUTS, own.off, INPUTS, 1);
for (int j = 0; j < NEURONS; ++j) {
    V near = zero, bow = zero, off = own.off[0][j];
    const V z = own.of[0][j] + w[AT + j];
#pragma unroll
    for (int k = 1; k <= C; ++k) near += absolute(own.of[k][j]);
    if (BENT) {
#pragma unroll
        for (int e = LINES; e < LINES + SQUARES; ++e) bow += absolute(own.of[e][j]);
    }
    V a0, a1, a2, a3, left, d, s2, flat, spread;
    const V u = near + bow, b = (u + off) * (1 + 1e-9) + pad, near2 = near * near, bow2 = bow * bow;
    const V others = bow * (near2 * 3.0 + bow * (near * 3.0 + bow));  // u^3 - near^3
    taylor(z, u * (1 + 1e-9) + pad, b, a0, a1, a2, a3, left, d, s2, flat, spread);
    const V most = d + absolute(s2) * b;
    V low = a1 - most, high = a1 + most;
    low = low > (double)LEAST ? low : zero + (double)LEAST; high = high < 1.0 ? high : zero + 1.0;
    d += absolute(s2) * (b - near); high = (high - low) * 0.5;
    const auto steady = !(d < high);
    own.slope[j] = steady ? low + high : a1; s2 = steady ? zero : s2;
    own.d[j] = (steady ? high : d) * (1 + 1e-9) + 1e-13;
    V turned = absolute(a2) * near * bow * 2.0 + absolute(a3) * near2 * near;
    V rest = absolute(a2) * bow2 + absolute(a3) * others + left;
    if (BENDS) {
        const auto plain = !(rest + turned + (own.d[j] + absolute(s2) * near) * off <= spread);  // NaN too
        own.slope[j] = plain ? zero : own.slope[j]; own.d[j] = plain ? zero : own.d[j];
        off = plain ? zero : off;
        a0 = plain ? flat : a0; a1 = plain ? zero : a1; a2 = plain ? zero : a2; a3 = plain ? zero : a3;
        s2 = plain ? zero : s2; turned = plain ? zero : turned; rest = plain ? spread : rest;
    } else {
        rest = spread;
    }
    rest = rest * (1 + 1e-9) + pad; turned *= 1 + 1e-9;
    own.near[j] = near; own.s2[j] = s2; own.a2[j] = a2; own.a3[j] = a3; own.rest[j] = rest; own.turned[j] = turned;
    own.off[0][j] = off * (1 + 1e-9) + rest + turned;
    own.top[0][j] = a0;
    for (int k = 1; k < LINES; ++k) own.top[k][j] = a1 * own.of[k][j];
    int e = LINES;
#pragma unroll
    for (int k = 1; k <= C; ++k)
#pragma unroll
        for (int m = k; m <= C; ++m, ++e) {
            const V bent = a2 * own.of[k][j] * own.of[m][j] * (m == k ? 1.0 : 2.0);
            own.top[e][j] = BENT ? a1 * own.of[e][j] + bent : bent;
        }
}

/// BACKWARDS:
/// At any zeta, and on the way between polynomial and activation, the derivative of f by an activation is within wide
/// of by, whose rows are those of a linear function of zeta. What the polynomials leave out is taken from least; what of
/// it is cubic, l times the form a3 l^2 + 2 a2 q, is added to cubes with by[0], where it may cancel.
V by[1 + C][NEURONS], wide[1][NEURONS], forms[BENDS ? SQUARES : 1][NEURONS];
for (int j = 0; j < NEURONS; ++j) {
    const V c = back.by[0][j], r = back.wide[0][j], size = absolute(c), near = own.near[j];
    V lean = zero;
    for (int k = 1; k <= C; ++k) lean += absolute(back.by[k][j]);
    const V loss = (size + lean + r) * own.rest[j] + (lean + r + size * 1e-12) * own.turned[j];
    least -= loss;
    const V share = (loss + size * own.turned[j]) / (near > zero ? near : zero + 1.0);
#pragma unroll
    for (int k = 0; k < C; ++k) score[k] += share * absolute(own.of[k + 1][j]);
    if (BENDS) {
        const V arch = c * own.a3[j], mix = c * own.a2[j] * 2.0; int e = 0;
#pragma unroll
        for (int k = 1; k <= C; ++k)
#pragma unroll
            for (int m = k; m <= C; ++m, ++e) {
                forms[e][j] = arch * own.of[k][j] * own.of[m][j] * (m == k ? 1.0 : 2.0);
                if (BENT) forms[e][j] += mix * own.of[LINES + e][j];
            }
    }
    const V s = own.slope[j], turn = c * own.s2[j], reach = absolute(own.s2[j]) * near + own.d[j];
    by[0][j] = c * s;
    for (int k = 1; k <= C; ++k) by[k][j] = back.by[k][j] * s + turn * own.of[k][j];
    wide[0][j] = r * (absolute(s) + reach) + lean * reach + size * own.d[j] + (size + lean) * (1 + reach) * 1e-12;
}
if (BENDS) {
    int e = 0;
    for (int k = 0; k < C; ++k)
        for (int m = k; m < C; ++m, ++e) {
            V sum[C];
            for (int a = 0; a < C; ++a) sum[a] = zero;
            for (int j = 0; j < NEURONS; ++j)
#pragma unroll
                for (int a = 0; a < C; ++a) sum[a] += own.of[a + 1][j] * forms[e][j];
            for (int a = 0; a < C; ++a) cubes[a < k ? cube(a, k, m) : a < m ? cube(k, a, m) : cube(k, m, a)] += sum[a];
        }
}
if (AT) {
    product(by, x, to.by, 1, INPUTS);
    product(wide, x + NEURONS * INPUTS, to.wide, 1, INPUTS);
}

/// CLOSE:
/// The least of the cubic polynomial slope, square, cubes over |zeta| <= 1. zeta^3 is within 1/4 of 3/4 zeta, zeta_k^2
/// zeta_m within 1/2 of 1/2 zeta_m; of three different ones nothing is known but the size.
V all = zero;
for (int e = 0; e < SQUARES; ++e) all += absolute(square[e]);
{
    int cube = 0;
#pragma unroll
    for (int a = 0; a < C; ++a)
#pragma unroll
        for (int b = a; b < C; ++b)
#pragma unroll
            for (int e = b; e < C; ++e, ++cube) {
                const V t = cubes[cube], size = absolute(t); all += size;
                V loss = size;
                if (a == e) { slope[a] += t * 0.75; loss = size * 0.25; }
                else if (a == b) { slope[e] += t * 0.5; loss = size * 0.5; }
                else if (b == e) { slope[a] += t * 0.5; loss = size * 0.5; }
                least -= loss; loss *= 1 / 3.0; score[a] += loss; score[b] += loss; score[e] += loss;
            }
}
V steep[C];
for (int k = 0; k < C; ++k) { steep[k] = absolute(slope[k]); all += steep[k]; }
least -= all * 1e-13;
{
    int e = 0;
#pragma unroll
    for (int k = 0; k < C; ++k)
#pragma unroll
        for (int m = k; m < C; ++m, ++e) {
            const V q = absolute(square[e]);
            if (m == k) { score[k] += q; least -= square[e] < zero ? q : zero; continue; }
            // q zeta_k zeta_m is at least -q, and where both slopes pull to the corner at which it is +q also at least
            // -q + a (sign_k zeta_k + sign_m zeta_m) for 0 <= a <= q, with signs that lower both slopes
            V gain = steep[k] < steep[m] ? steep[k] : steep[m]; gain = gain < q ? gain : q;
            gain = slope[k] * slope[m] * square[e] > zero ? gain : zero;
            least -= q; steep[k] -= gain; steep[m] -= gain; score[k] += q * 0.5; score[m] += q * 0.5;
        }
}
level = least;  // of a linear bound, to which a form adds nothing
{
    int e = 0;
#pragma unroll
    for (int k = 0; k < C; e += C - k, ++k) {
        const V s = steep[k], q = square[e] > zero ? square[e] : zero;
        least += s < q * 2.0 ? s * s * -0.25 / (q > zero ? q : zero + 1.0) : q - s;
    }
}

/// VALUES:
/// f itself, a layer: from the activations or inputs y to those above.
const V* const below = y;
V y[NEURONS];
for (int j = 0; j < NEURONS; ++j) {
    const double* x = w + AT + NEURONS + j * INPUTS;
    V z = zero + w[AT + j];
    for (int i = 0; i < INPUTS; ++i) z += below[i] * x[i];
    y[j] = act(z, nullptr);
}
$then

/// STORE
const long long o = i + l;
least_out.data[o] = LANE(least); value_out.data[o] = LANE(value); level_out.data[o] = LANE(level);
int axis = 0;
for (int k = 1; k < C; ++k) if (LANE(score[k]) > LANE(score[axis])) axis = k;
axes.data[o] = axis;
for (int k = 0; k < C; ++k) {
    point.data[o * C + k] = LANE(h[k]);
    slope_out.data[o * C + k] = LANE(radius[k]) > 0.0 ? LANE(slope[k]) / LANE(radius[k]) : 0.0;
}
