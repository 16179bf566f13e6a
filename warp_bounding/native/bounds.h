// Bounds of a network over boxes, for networks/bounds.py: from V low[], high[], a box a lane, to its bound, layer by
// layer and back, and then what becomes of the polynomial in zeta to which that leads: its least, or its corners. A
// part begins behind a line with three slashes.
//
// Names in capitals are constants that are written in front of a part, behind $ other parts. The network has K inputs; a
// box has Z numbers, and C columns of zeta. A layer has INPUTS and NEURONS, and its numbers begin at the index AT of w.
// The polynomial's constant is least, its other entries tilt, square and cubes (BACKWARDS); slopes of the inputs are
// gradient, and of the columns, tilt included, slope. The scopes of layers are nested: each sees that below it, and is
// left backwards.

/// CPU
#pragma clang fp contract(fast)
#define LANE(x) x[l]

/// LANES:
/// How many boxes are bounded at a time: with 16 registers of half the width, fewer are faster.
#if defined(__AVX512F__)
constexpr int L = 8;
#else
constexpr int L = 4;
#endif

/// VECTORS
typedef double V __attribute__((vector_size(8 * L))); typedef long long I __attribute__((vector_size(8 * L)));
const V zero = {};

/// CUDA
#define LANE(x) x
constexpr int L = 1;
typedef double V;
const V zero = 0.0;

/// KERNEL:
/// A block of boxes on a CPU, one box on CUDA.
#if !defined(__CUDA_ARCH__)
$cpu
$sizes
const int begin = block * BLOCK, end = begin + BLOCK < count ? begin + BLOCK : count;
for (int i = begin; i < end; i += L) {
#else
$cuda
$sizes
const int i = block, end = count;
if (i < count) {
#endif
    V low[BOX], high[BOX];
    for (int l = 0; l < L; ++l) {
        const double* at = boxes.data + (long long)(i + l < end ? i + l : end - 1) * (2 * BOX);
        for (int k = 0; k < BOX; ++k) { LANE(low[k]) = at[k]; LANE(high[k]) = at[BOX + k]; }
    }
    $bounds
    for (int l = 0; l < L && i + l < end; ++l) {
        $store
    }
}
#undef LANE

/// BODY:
/// From a box to all that is explained at ``body``.
V least = zero, value = zero, level = zero, bulk = zero;
V center[K], noise[K], gen[K], h[K], z[Z], gradient[K];
V score[C], slope[C], tilt[C], square[SQUARES], cubes[CUBES];
(void)noise; (void)bulk; (void)h; (void)z; (void)value;
const auto place = [](int k, int m) { return k * (2 * C - k + 1) / 2 + m - k; }; (void)place;
const auto triple = [&](int a, int b, int d) {  // the place of a <= b <= d in cubes
    int before = 0;
    for (int k = 0; k < a; ++k) before += (C - k) * (C - k + 1) / 2;
    return before + place(b, d) - place(a, a);
}; (void)triple;
$expand
const auto project = [&](const auto* of, V* columns) {
    $project
};
for (int k = 0; k < C; ++k) score[k] = tilt[k] = zero;
for (int i = 0; i < SQUARES; ++i) square[i] = zero;
for (int i = 0; i < CUBES; ++i) cubes[i] = zero;
{
    V* const back = gradient;
    $layers
}
if (NOISY) {
    V lost = zero;
    for (int i = 0; i < K; ++i) lost += absolute(gradient[i]) * noise[i];
    least -= lost;
}
for (int k = 0, i = 0; k < C; ++k) for (int m = k; m < C; ++m, ++i) if (m != k) square[i] *= 2.0;
{
    V all = absolute(square[0]);
    for (int i = 1; i < SQUARES; ++i) all += absolute(square[i]);
    bulk += all;
}
if (CUBIC) {
    $straighten
    if (C == K) for (int k = 0; k < C; ++k) {  // each column is one input
        gradient[k] += gen[k] > zero ? tilt[k] / (gen[k] > zero ? gen[k] : zero + 1.0) : zero;
        tilt[k] = zero;
    }
}
project(gradient, slope);
for (int k = 0; k < C; ++k) slope[k] += tilt[k];
{
    $close
}
if (!MULTILINEAR) {
    $realize
    const V* y = h;
    $values
}

/// OUTPUT:
/// Behind the last hidden layer, of which LAST neurons are left: f where all neurons are at their means.
least = zero + (w[AT_OUTPUT] - padding[LAYERS]);
for (int j = 0; j < LAST; ++j) {
    const double x = w[AT_OUTPUT + 1 + j];
    back[j] = zero + x; least += own.mean[j] * x;
}

/// OUTPUT_VALUE
value = zero + w[AT_OUTPUT];
for (int j = 0; j < LAST; ++j) value += y[j] * w[AT_OUTPUT + 1 + j];

/// LAYER:
/// What is known of a layer's neurons. The argument of each is a centre plus l + p + y: l = rate . zeta is linear, |l|
/// <= near; p is the quadratic form in zeta that the parabolas of the layers below make together, within radius of 0,
/// its middle being taken into the centre; y is all the rest, noise. |l + p + y| <= width, rounding included. The
/// output is h = mean + slope (l + p + y) + lean l + bend l^2 + cube l^3 + cross l p to within spread. Behind these
/// stands what a layer above reads, of h = mean + part . zeta + a quadratic form + y', |y'| at most noise: square are
/// that form's entries (those off the diagonal count twice), and behind them the middle of its range; radius is half of
/// it. They are sums of what the parabolas are one by one, while entries of square may cancel. form are the entries of
/// p, before its middle was taken off, and total the sum of their sizes. The arrays are declared one by one, so that
/// the compiler drops those that nobody reads.
V mean_[NEURONS], noise_[NEURONS], width_[NEURONS], slope_[NEURONS], spread_[NEURONS];
V near_[NEURONS], rate_[C][NEURONS], lean_[NEURONS], bend_[NEURONS], cube_[NEURONS];
V cross_[NEURONS], form_[SQUARES + 1][NEURONS], total_[NEURONS];
V part_[C][NEURONS], square_[SQUARES + 1][NEURONS], radius_[NEURONS];
const struct {
    V *mean, *noise, *width, *slope, *spread, *near, (*rate)[NEURONS], *lean, *bend, *cube, *cross, (*form)[NEURONS];
    V *total, (*part)[NEURONS], (*square)[NEURONS], *radius;
} own = {
    mean_, noise_, width_, slope_, spread_, near_, rate_, lean_, bend_, cube_, cross_, form_, total_, part_, square_,
    radius_,
};
V* const to = back;
V back[NEURONS];

/// NEURON:
/// Neuron j from the centre z of its argument, its generators g (rate) and the largest |y|, from, and, where layers
/// below BEND, its quadratic form: entries and middle in own.form, radius in reach. The form's range is taken both from
/// its entries and from the parabolas one by one. LARGEST_MIDDLE is the largest that an activation with a limit takes:
/// beyond it the range is as wide, and nothing is lost. relax sets s, m, e and what else of lean, k2, k3 and k4 is not
/// 0.
const auto neuron = [&](int j, V z, V from, V reach, const V* g) __attribute__((always_inline)) {
    V near = zero, middle = zero, radius = zero;
    for (int k = 0; k < C; ++k) { own.rate[k][j] = g[k]; near += absolute(g[k]); }
    if (BENT) {
        V half = zero, other = zero;
        int entry = 0;
#pragma unroll
        for (int k = 0; k < C; ++k) {
            half += own.form[entry][j] * 0.5; other += absolute(own.form[entry++][j]) * 0.5;
#pragma unroll
            for (int m = k + 1; m < C; ++m) other += absolute(own.form[entry++][j]) * 2.0;
        }
        const V sum = own.form[SQUARES][j];
        V low = half - other, high = half + other;
        low = sum - reach > low ? sum - reach : low; high = sum + reach < high ? sum + reach : high;
        middle = (low + high) * 0.5; radius = (high - low) * 0.5; own.total[j] = other * 2.0;
        const V beyond = absolute(middle);
        radius = beyond > LARGEST_MIDDLE ? radius + beyond : radius; middle = beyond > LARGEST_MIDDLE ? zero : middle;
    }
    V s, m, e, lean = zero, k2 = zero, k3 = zero, k4 = zero;
    const V at = z + middle;
    relax(at, near, radius, from, s, m, lean, k2, k3, k4, e);
    e += pad;
    own.mean[j] = m - s * middle; own.slope[j] = s; own.spread[j] = e; own.width[j] = near + radius + from + pad;
    own.near[j] = near; own.lean[j] = lean - k4 * middle; own.bend[j] = k2; own.cube[j] = k3; own.cross[j] = k4;
    const V near2 = near * near, line = s + lean + k3 * near2 * 0.75;  // l^3 is within near^3 / 4 of 3 near^2 l / 4
    for (int k = 0; k < C; ++k) own.part[k][j] = g[k] * line;
    own.noise[j] = absolute(s) * from + e + (absolute(k3) * near2 * 0.25 + absolute(k4) * radius) * near;
    if (PASSES) {
        const V half = near2 * 0.5; int entry = 0;
#pragma unroll
        for (int k = 0; k < C; ++k) {
            const V bent = k2 * g[k];
#pragma unroll
            for (int m = k; m < C; ++m, ++entry)
                own.square[entry][j] = BENT ? bent * g[m] + s * own.form[entry][j] : bent * g[m];
        }
        own.square[SQUARES][j] = s * middle + k2 * half; own.radius[j] = absolute(s) * radius + absolute(k2) * half;
    }
};

/// LAYER_BEGIN
const double *const b = w + AT, *const weight = b + NEURONS; const double pad = padding[LAYER];

/// LINE:
/// What a neuron calls: a line of an activation that does not bend, or a cubic of one that does.
const auto relax = [&](V at, V near, V radius, V from, V& s, V& m, V&, V& k2, V&, V&, V& e) {
    line(at, near, radius + from + pad, s, m, k2, e);
};

/// CURVE
const auto relax = [&](V at, V near, V radius, V from, V& s, V& m, V& lean, V& k2, V& k3, V& k4, V& e) {
    line(at, near, radius, from + pad, s, m, lean, k2, k3, k4, e);
};

/// FIRST:
/// The first hidden layer, of the network's inputs.
for (int j = 0; j < NEURONS; ++j) {
    const double* x = weight + j * INPUTS;
    V z = zero + b[j], from = zero, g[C];
    for (int i = 0; i < INPUTS; ++i) z += center[i] * x[i];
    project(x, g);
    if (NOISY) for (int i = 0; i < INPUTS; ++i) from += noise[i] * x[NEURONS * INPUTS + i];
    neuron(j, z, from, zero, g);
    for (int k = 0; k < C; ++k) score[k] += absolute(g[k]) * FIRST_LAYER;
}

/// LATER:
/// A later layer: BLOCKS blocks of R neurons from FIRST on, which share each input as it is loaded.
for (int t = 0; t < BLOCKS; ++t) {
    const double* x = weight + (FIRST + t * R) * INPUTS; const double* ax = x + NEURONS * INPUTS;
    V centers[R], noises[R], radii[R], generators[R][C];
#pragma unroll
    for (int r = 0; r < R; ++r) {
        centers[r] = zero + b[FIRST + t * R + r]; noises[r] = zero; radii[r] = zero;
#pragma unroll
        for (int k = 0; k < C; ++k) generators[r][k] = zero;
    }
    for (int i = 0; i < INPUTS; ++i) {
        const V m = below.mean[i], e = below.noise[i];
#pragma unroll
        for (int r = 0; r < R; ++r) {
            const double y = x[r * INPUTS + i];
            centers[r] += m * y; noises[r] += e * ax[r * INPUTS + i];
            if (BENT) radii[r] += below.radius[i] * ax[r * INPUTS + i];
#pragma unroll
            for (int k = 0; k < C; ++k) generators[r][k] += below.part[k][i] * y;
        }
    }
#pragma unroll
    for (int r = 0; r < R; ++r) neuron(FIRST + t * R + r, centers[r], noises[r], radii[r], generators[r]);
}

/// SQUARES_OF_ARGUMENTS:
/// Before it, where layers below bend: the quadratic forms of its arguments, ENTRIES entries from ENTRY on at a time.
for (int t = 0; t < BLOCKS; ++t) {
    const double* x = weight + (FIRST + t * R) * INPUTS;
    V sums[R][ENTRIES];
#pragma unroll
    for (int r = 0; r < R; ++r)
        for (int k = 0; k < ENTRIES; ++k) sums[r][k] = zero;
    for (int i = 0; i < INPUTS; ++i) {
#pragma unroll
        for (int k = 0; k < ENTRIES; ++k) {
            const V q = below.square[ENTRY + k][i];
#pragma unroll
            for (int r = 0; r < R; ++r) sums[r][k] += q * x[r * INPUTS + i];
        }
    }
#pragma unroll
    for (int r = 0; r < R; ++r)
        for (int k = 0; k < ENTRIES; ++k) own.form[ENTRY + k][FIRST + t * R + r] = sums[r][k];
}

/// BACKWARDS:
/// Backwards through a layer: its curves are weighed by back, the output's coefficients of its neurons, and added to
/// one polynomial in zeta, of which the entries are tilt, square and cubes (a <= b <= d of each, as of a symmetric
/// tensor); what each neuron's spread costs is taken from least and charged to the columns that caused it (score); to
/// receives the output's coefficients of what the layer computes with. bulk sums up the absolute terms of square and
/// cubes.
for (int i = 0; i < INPUTS; ++i) to[i] = zero;
for (int j = 0; j < NEURONS; ++j) {
    V c = back[j];
    const V loss = absolute(c) * own.spread[j]; least -= loss;
    const V share = loss / own.width[j];
#pragma unroll
    for (int k = 0; k < C; ++k) score[k] += share * absolute(own.rate[k][j]);
    if (BENDS) {
        const V bow = c * own.bend[j], arch = c * own.cube[j], mix = c * own.cross[j] * THIRD, n = own.near[j];
        bulk += (absolute(bow) + absolute(arch) * n) * n * n;
        if (BENT) bulk += absolute(mix) * n * own.total[j] * 3.0;
        V bent[SQUARES], crossed[SQUARES]; int entry = 0, cube = 0;
#pragma unroll
        for (int k = 0; k < C; ++k) {
            const V rate = own.rate[k][j]; tilt[k] += c * own.lean[j] * rate;
#pragma unroll
            for (int m = k; m < C; ++m, ++entry) {
                const V product = rate * own.rate[m][j];
                square[entry] += bow * product; bent[entry] = arch * product;
                if (BENT) { crossed[entry] = mix * own.form[entry][j]; bent[entry] += crossed[entry]; }
            }
        }
#pragma unroll
        for (int a = 0; a < C; ++a)
#pragma unroll
            for (int b = a; b < C; ++b)
#pragma unroll
                for (int d = b; d < C; ++d, ++cube) {
                    cubes[cube] += own.rate[a][j] * bent[place(b, d)];
                    if (BENT) cubes[cube] += own.rate[b][j] * crossed[place(a, d)] + own.rate[d][j] * crossed[place(a, b)];
                }
    }
    c *= own.slope[j];
    const double* x = w + AT + NEURONS + j * INPUTS;
    for (int i = 0; i < INPUTS; ++i) to[i] += c * x[i];
}

/// LAYER_VALUES:
/// f itself, layer by layer, from the activations or inputs y.
const V* const x = y; const double* const b = w + AT;
V y[NEURONS];
$blocks
$then

/// VALUES:
/// f itself: a layer's activations y from the inputs x, in blocks as in LATER.
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
    for (int r = 0; r < R; ++r) y[FIRST + t * R + r] = act(sums[r]);
}

/// STORE
const long long o = i + l;
least_out.data[o] = LANE(least); value_out.data[o] = LANE(value); level_out.data[o] = LANE(level);
int axis = 0;
for (int k = 1; k < C; ++k) if (LANE(score[k]) > LANE(score[axis])) axis = k;
double next = -1.0; int second = axis; // the axis to halve next, when this one is halved
for (int k = 0; k < C; ++k) {
    const double s = LANE(score[k]) * (k == axis ? HALVED : 1.0);
    if (s > next) { next = s; second = k; }
}
axes.data[o] = axis; axes.data[count + o] = second;
for (int k = 0; k < K; ++k) { point.data[o * K + k] = LANE(z[k]); gradient_out.data[o * K + k] = LANE(gradient[k]); }

/// STRAIGHTEN:
/// The cubic part of the polynomial, by entries: zeta^3 is within 1/4 of 3/4 zeta, and zeta_k^2 zeta_m within 1/2
/// |zeta_m| of 1/2 zeta_m; the lines go to tilt. Of three different ones the product counts in absolute value, or stays
/// where the bound may be MULTILINEAR. Losses are shared among the columns of an entry.
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

/// CLOSE:
/// The least of slope . zeta and the quadratic form over |zeta| <= 1, entry by entry. Of q zeta_k zeta_m, k != m, only
/// -|q| is sure; but where it is +|q| in the corner where slope . zeta is least, it is above the planes
/// -|q| + d (a zeta_k + b zeta_m) for all 0 <= d <= |q|, a and b being the signs that lower both slopes (McCormick), so
/// that d is gained from either slope, until one is 0. An entry q >= 0 of the diagonal goes with what is left of its
/// slope, the least of -s |zeta| + q zeta^2 being at zeta = s / (2 q) if that is less than 1, else at the end; a
/// negative one is least at the end. Where the bound may be MULTILINEAR, entries off the diagonal stay. level is the
/// bound's constant.
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

/// CORNERS:
/// The values at the corners of what is left where the bound may be MULTILINEAR: place i is at the upper end of column
/// k where bit k of i is set. 1e-13 of all terms is more than float64 rounds here, and in where the corners lie.
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

/// STORE_CORNERS
const long long o = i + l;
for (int k = 0; k < 1 << C; ++k) corner_out.data[o * (1 << C) + k] = LANE(corner[k]);

/// WALK:
/// Each lane takes one segment after another, or a window of one where they are shared. A segment is given by its ends;
/// a + t w is what it is in the network's inputs, and the walk goes along the part of it that may lie within reach. The
/// arrays map holds centre and scale of that map, reach, and the limits of ends beyond which nothing is known. A lane
/// goes piece by piece from first to last. A piece is clear where the bound of -f lies above base. The next one is then
/// twice as long. Of a piece that is not clear the walk goes as far as the linear bound level + slope zeta tells, and goes on
/// with a shorter one; it ends at one of 2^-depth of the way, and in a quick walk at every point that cannot be clear,
/// in all windows of the segment at once. until is then the least place at which a walk along the segment has ended.
/// Where begin is infinite nothing is asked.
const double* map_ = map.data; const double need = base + absolute_of(base) * 0x1p-51 + 0x1p-1000;  // rounded up
V low[BOX], high[BOX]; int own[L]; const int windows = shared ? L : 1; long long next = (long long)BEGIN * windows;
double at[L], step[L], last[L], shortest[L];
for (int i = BEGIN; i < END; ++i) until.data[i] = INFINITY;
auto found = [&](int i, double t) { until.data[i] = t < until.data[i] ? t : until.data[i]; };
auto take = [&](int l) {
    for (own[l] = -1; own[l] < 0 && next < (long long)END * windows; ++next) {
        const int i = (int)(next / windows), window = (int)(next % windows);
        if (begin.data[i] == INFINITY) continue;
        double from = begin.data[i], to = 1.0;
        bool known = true, inside = true;
        for (int k = 0; k < K; ++k) {
            const double x = starts.data[(long long)i * K + k], y = ends.data[(long long)i * K + k];
            const double scale = map_[K + k], reach = map_[2 * K + k], least = map_[3 * K + k], most = map_[4 * K + k];
            const double a = (x - map_[k]) * scale, w = (y - map_[k]) * scale - a;
            known = known && x >= least && x <= most && y >= least && y <= most;  // NaN is not
            known = known && absolute_of(a) <= LARGEST && absolute_of(w) <= LARGEST;
            const double p = (-reach - a) / w, q = (reach - a) / w, enters = p < q ? p : q, leaves = p < q ? q : p;
            inside = inside && (w != 0.0 || absolute_of(a) <= reach);
            if (w != 0.0) { from = enters > from ? enters : from; to = leaves < to ? leaves : to; }
            LANE(low[k]) = LANE(high[k]) = a; LANE(low[K + k]) = LANE(high[K + k]) = w;
        }
        if (!known) found(i, begin.data[i]);
        shortest[l] = to > from ? (to - from) / (double)(1u << depth) : 0.0;
        from = window > from * windows ? (double)window / windows : from;
        to = window + 1 < to * windows ? (window + 1.0) / windows : to;
        if (!known || !inside || from > to + INSIDE) continue;
        from = from < 1.0 ? from : 1.0;
        own[l] = i; at[l] = from; last[l] = to > from ? to : from; step[l] = last[l] - from;
    }
};
for (int l = 0; l < L; ++l) {
    for (int k = 0; k < BOX; ++k) LANE(low[k]) = LANE(high[k]) = 0.0;
    take(l);
}
for (;;) {
    int busy = 0;
    for (int l = 0; l < L; ++l) {
        while (own[l] >= 0 && (quick ? until.data[own[l]] < INFINITY : until.data[own[l]] <= at[l])) {
            found(own[l], at[l]);  // another lane has ended a quick walk: of this window no more is known
            take(l);
        }
        busy += own[l] >= 0;
        const double end = at[l] + step[l];
        LANE(low[2 * K]) = own[l] < 0 ? 0.0 : at[l];
        LANE(high[2 * K]) = own[l] < 0 ? 0.0 : end < last[l] ? end : last[l];
    }
    if (!busy) break;
    $body
    for (int l = 0; l < L; ++l) {
        if (own[l] < 0) continue;
        const double end = LANE(high[2 * K]);
        const bool clear = LANE(least) > need;  // NaN is not
        if (clear && end < last[l]) { at[l] = end; step[l] *= 2.0; continue; }
        if (!clear) {
            const bool blocked = !(LANE(value) > need);
            const double rise = LANE(level) - (need + absolute_of(LANE(level)) * 0x1p-51), fall = -LANE(slope[0]);
            const double share = rise > -fall && fall > 0.0 ? (rise < fall ? rise / fall * 0.5 + 0.5 : 1.0) - 0x1p-40 : 0.0;
            const bool over = (blocked && (quick || LANE(z[2 * K]) == at[l])) || step[l] <= shortest[l];
            if (share > 0.0) at[l] += share * (end - at[l]);
            step[l] *= blocked ? 0.125 : 0.25;
            step[l] = step[l] < shortest[l] ? shortest[l] : step[l];
            if (!over) continue;
            found(own[l], at[l]);
        }
        take(l);
    }
}
