// The exact truth of queries about cells, in float64: the bodies of the loop of ``queries/exact.py``. A part begins
// behind a line with three slashes and its name.

/// COORDINATE
struct Coordinate {  // t + rest = cells_per_unit * x - offset, exactly; lo, hi: the first and the last closed cell there
    double t, rest, lo, hi;
    Coordinate() = default;
    Coordinate(float x, double scale, double offset) {
        const double p = (double)x * scale;  // at most 48 bits: exact
        t = p - offset;
        const double back = t - p;
        rest = (p - (t - back)) + (-offset - back);
        lo = ceil(t - 0.5), hi = floor(t + 0.5);
        if (hi > lo && rest > 0.0) lo = hi;  // t was rounded onto a face, from above
        else if (hi > lo && rest < 0.0) hi = lo;
    }
    double to(double face) const { return (face - t) - rest; }  // sign exact, a few roundings
};

/// LOOP:
/// For every query of a block on a CPU, for one query on CUDA; see ``loop_snippet``.
#if defined(__CUDA_ARCH__)
const int begin = block; const int end = block < count ? block + 1 : count;
#else
const int begin = block * BLOCK; const int end = begin + BLOCK < count ? begin + BLOCK : count;
#endif
for (int i = begin; i < end; ++i) {
    const float* q = x.data + (size_t)i * M;
    unsigned char answer = 0;
    bool finite = true;
    for (int k = 0; k < M; ++k) finite &= q[k] - q[k] == 0.0f;
    while (finite) {
        $body
        break;
    }
    out.data[i] = answer;
}

/// POINT
int first[N], last[N], cell[N];  // cells that the point may lie in, two where it lies on a face
bool some = true;
for (int k = 0; k < N; ++k) {
    const double t = (double)q[k] * map.data[k] - map.data[N + k], r = map.data[2 * N + k];
    const double lo = ceil(t - 0.5), hi = floor(t + 0.5);
    some = hi >= 0.0 && lo < r;
    if (!some) break;
    first[k] = cell[k] = lo < 0.0 ? 0 : (int)lo;
    last[k] = hi >= r ? (int)r - 1 : (int)hi;
}
while (some) {
    int c = 0, k = N - 1;
    for (int j = 0; j < N; ++j) c = c * (int)map.data[2 * N + j] + cell[j];
    if (indices.data[c >> 5] >> (c & 31) & 1) { answer = 1; break; }
    for (; k >= 0; --k) {
        if (++cell[k] <= last[k]) break;
        cell[k] = first[k];
    }
    some = k >= 0;
}

/// BOX:
/// ``map`` is cells per unit, offset and number of cells, N of each; ``indices`` is the table of sums, one longer
/// than the grid on every axis.
bool some = true;
long long first[N], last[N];  // in the table of sums: cells first .. last - 1
for (int k = 0; k < N; ++k) {
    const double size = map.data[2 * N + k];
    const double lo = Coordinate(q[k], map.data[k], map.data[N + k]).lo;
    const double hi = Coordinate(q[N + k], map.data[k], map.data[N + k]).hi;
    some &= q[k] <= q[N + k] && hi >= 0.0 && lo < size;
    first[k] = lo > 0.0 ? (lo < size ? (long long)lo : 0) : 0;
    last[k] = hi < size - 1.0 ? (hi < 0.0 ? 0 : (long long)hi + 1) : (long long)size;
}
if (!some) break;
int sum = 0;
for (int corner = 0; corner < (1 << N); ++corner) {
    long long index = 0;
    int sign = 1;
    for (int k = 0; k < N; ++k) {
        const bool low = (corner >> k) & 1;
        index = index * ((long long)map.data[2 * N + k] + 1) + (low ? first[k] : last[k]);
        sign = low ? -sign : sign;
    }
    sum += sign * indices.data[index];
}
answer = sum > 0;

/// RAY:
/// Names that end in _sure are rounded inwards, those in _most outwards.
const auto distance = cells.data;  // empty_distance: 0 in an occupied cell, else cells to the nearest one
const auto larger = [](double a, double b) { return a > b ? a : b; };
const auto smaller = [](double a, double b) { return a < b ? a : b; };
double v[N], inverse[N], ratio[N];
Coordinate o[N];
int size[N], stride[N], first[N], last[N], cell[N];
double square = 0.0, fastest = 0.0, largest = 0.0;
int steepest = 0;
for (int k = N - 1, step = 1; k >= 0; --k) {
    o[k] = Coordinate(q[k], map.data[k], map.data[N + k]);
    v[k] = (double)q[N + k] * map.data[k];
    square += (double)q[N + k] * (double)q[N + k];
    size[k] = (int)map.data[2 * N + k];
    stride[k] = step;
    step *= size[k];
    if (fabs(v[k]) > fastest) fastest = fabs(v[k]), steepest = k;
    if (fabs(o[k].t) + size[k] > largest) largest = fabs(o[k].t) + size[k];
}
if (!(fastest > 0.0)) break;
{   // the steepest axis comes first
    const Coordinate c = o[0]; o[0] = o[steepest]; o[steepest] = c;
    const double e = v[0]; v[0] = v[steepest]; v[steepest] = e;
    int i = size[0]; size[0] = size[steepest]; size[steepest] = i;
    i = stride[0]; stride[0] = stride[steepest]; stride[steepest] = i;
}
// the parameter s is the distance along the steepest axis, in cells
const double s_length = length * fastest / sqrt(square);
double s_first = 0.0, s_last = s_length + s_length * rho;
bool outside = false;
for (int k = 0; k < N; ++k) {
    if (v[k] == 0.0) {
        outside |= !(o[k].hi >= 0.0 && o[k].lo < size[k]);
        first[k] = o[k].lo > 0.0 && o[k].lo < size[k] ? (int)o[k].lo : 0;
        last[k] = o[k].hi >= 0.0 && o[k].hi < size[k] ? (int)o[k].hi : size[k] - 1;
        inverse[k] = ratio[k] = 0.0;
        continue;
    }
    inverse[k] = fastest / v[k];
    ratio[k] = v[k] / fastest;
    const double u0 = o[k].to(-0.5) * inverse[k], u1 = o[k].to(size[k] - 0.5) * inverse[k];
    const double a = v[k] > 0.0 ? u0 : u1, b = v[k] > 0.0 ? u1 : u0;
    s_first = larger(s_first, a - fabs(a) * rho);
    s_last = smaller(s_last, b + fabs(b) * rho);
}
if (outside || !(s_first <= s_last)) break;
if (!(largest < 0x1p36)) { answer = 2; break; }  // position_error would reach 2^-8 of a cell
// positions y = t + s ratio, s in [s_first, s_last], are wrong by under 20 roundings of 2 * largest
const double position_error = 0x1p-44 * (largest + 1.0);
const int sign = v[0] > 0.0 ? 1 : -1;
const double y_first = o[0].t + sign * s_first, y_last = o[0].t + sign * s_last;
const double i_first = sign > 0 ? ceil(y_first - position_error - 0.5) : floor(y_first + position_error + 0.5);
const double i_last = sign > 0 ? floor(y_last + position_error + 0.5) : ceil(y_last - position_error - 0.5);
const int begin_slab = i_first < 0.0 ? 0 : i_first > size[0] - 1 ? size[0] - 1 : (int)i_first;
const int end_slab = i_last < 0.0 ? 0 : i_last > size[0] - 1 ? size[0] - 1 : (int)i_last;
const double certain_length = s_length - s_length * rho;
for (int left = (end_slab - begin_slab) * sign, slab = begin_slab; left >= 0 && answer != 1; ) {
    const double s_middle = ((double)slab - o[0].t) * sign;
    int index = slab * stride[0];
    for (int k = 1; k < N; ++k) {
        const double y = floor(o[k].t + s_middle * ratio[k] + 0.5);
        index += (y < 0.0 ? 0 : y > size[k] - 1 ? size[k] - 1 : (int)y) * stride[k];
    }
    // Until slab j ahead (this one: 0) is left, y moves by at most j + 1/2 cells, so the ray meets cells at most j + 1 from
    // the one at its middle here: distance - 1 slabs hold nothing. A y that is cut off at the border only comes nearer.
    const int jump = distance[index] - 1;
    if (jump > 0) { left -= jump; slab += sign * jump; continue; }
    const double s0 = larger(s_first, s_middle - 0.5), s1 = smaller(s_last, s_middle + 0.5);
    bool none = false;
    for (int k = 1; k < N; ++k) {
        if (v[k] != 0.0) {
            const double y0 = o[k].t + s0 * ratio[k], y1 = o[k].t + s1 * ratio[k];
            const double lo = ceil(smaller(y0, y1) - position_error - 0.5);
            const double hi = floor(larger(y0, y1) + position_error + 0.5);
            none |= !(hi >= 0.0 && lo < size[k]);
            first[k] = lo > 0.0 && lo < size[k] ? (int)lo : 0;
            last[k] = hi >= 0.0 && hi < size[k] ? (int)hi : size[k] - 1;
        }
        cell[k] = first[k];
    }
    cell[0] = slab;
    while (!none) {
        int at = 0;
        for (int k = 0; k < N; ++k) at += cell[k] * stride[k];
        if (distance[at] == 0) {
            double a_sure = 0.0, b_sure = certain_length, a_most = 0.0, b_most = s_length + s_length * rho;
            for (int k = 0; k < N; ++k) {
                if (v[k] == 0.0) continue;
                const double u0 = o[k].to(cell[k] - 0.5) * inverse[k], u1 = o[k].to(cell[k] + 0.5) * inverse[k];
                const double a = v[k] > 0.0 ? u0 : u1, b = v[k] > 0.0 ? u1 : u0;
                a_sure = larger(a_sure, a + fabs(a) * rho), a_most = larger(a_most, a - fabs(a) * rho);
                b_sure = smaller(b_sure, b - fabs(b) * rho), b_most = smaller(b_most, b + fabs(b) * rho);
            }
            if (a_sure <= b_sure) { answer = 1; break; }
            if (a_most <= b_most) answer = 2;
        }
        int k = 1;
        for (; k < N; ++k) {
            if (++cell[k] <= last[k]) break;
            cell[k] = first[k];
        }
        none = k >= N;
    }
    left -= 1; slab += sign;
}

/// PLANE:
/// LANES corners stand side by side; after GROUPS of such groups it is looked whether enough is known.
Coordinate p[N];
double m[N], offset = 0.0, magnitude = 0.0;
int slanted = 0, axis = 0;
for (int k = 0; k < N; ++k) {
    p[k] = Coordinate(q[N + k], map.data[k], map.data[N + k]);
    m[k] = (double)q[k] / map.data[k];
    if (m[k] != 0.0) slanted += 1, axis = k;
    offset += m[k] * p[k].t;
    magnitude += fabs(m[k]) * (fabs(p[k].t) + map.data[2 * N + k] + 1.0);
}
if (slanted == 0) break;
const double error = magnitude * rho;
const int components = indices.shape[0] - 1;  // component c: groups indices[c] to indices[c + 1] - 1 of corners
for (int c = 0; c < components && answer != 1; ++c) {
    const double* lower = map.data + 3 * N + (size_t)c * (2 * N); const double* upper = lower + N;
    if (slanted == 1) {  // the component is connected: its cells leave no gap along an axis
        if (p[axis].to(lower[axis]) <= 0.0 && p[axis].to(upper[axis]) >= 0.0) answer = 1;
        continue;
    }
    double middle = -offset, reach = 0.0;
    for (int k = 0; k < N; ++k) {
        middle += m[k] * (0.5 * (lower[k] + upper[k]));
        reach += fabs(m[k]) * (0.5 * (upper[k] - lower[k]));
    }
    if (fabs(middle) > reach + error) continue;
    double low[LANES], high[LANES], least, greatest;
    for (int j = 0; j < LANES; ++j) low[j] = 1.0e300, high[j] = -1.0e300;
    for (int g = indices.data[c]; g < indices.data[c + 1] && answer != 1; ) {
        const int pause = g + GROUPS < indices.data[c + 1] ? g + GROUPS : indices.data[c + 1];
        for (; g < pause; ++g) {
            const double* corner = numbers.data + (size_t)g * (N * LANES);
            double d[LANES];
            for (int j = 0; j < LANES; ++j) d[j] = -offset;
            for (int k = 0; k < N; ++k) for (int j = 0; j < LANES; ++j) d[j] += m[k] * corner[k * LANES + j];
            for (int j = 0; j < LANES; ++j) {
                low[j] = d[j] < low[j] ? d[j] : low[j];
                high[j] = d[j] > high[j] ? d[j] : high[j];
            }
        }
        least = low[0], greatest = high[0];
        for (int j = 1; j < LANES; ++j) {
            least = low[j] < least ? low[j] : least;
            greatest = high[j] > greatest ? high[j] : greatest;
        }
        if (least <= -error && greatest >= error) answer = 1;
    }
    if (answer == 1) break;
    if (least > error || greatest < -error) continue;
    // again, with an error bound for each corner that vanishes where the corner is the plane's own point
    bool below = false, above = false, perhaps_below = false, perhaps_above = false;
    for (int g = indices.data[c]; g < indices.data[c + 1]; ++g) for (int j = 0; j < LANES; ++j) {
        double d = 0.0, bound = 0.0;
        for (int k = 0; k < N; ++k) {
            const double term = m[k] * p[k].to(numbers.data[((size_t)g * N + k) * LANES + j]);
            d += term;
            bound += fabs(term) * rho;
        }
        below |= d <= -bound, above |= d >= bound, perhaps_below |= d <= bound, perhaps_above |= d >= -bound;
    }
    if (below && above) answer = 1;
    else if (perhaps_below && perhaps_above) answer = 2;
}
