// The corners of rounded hulls, eight at a time: ``lanes`` holds x, y and z of eight corners, one behind another and
// behind the last corner copies of the first. Those of a body lie from ``begin`` to ``end``. A part begins behind a
// line with three slashes and its name.

/// LANES:
/// Numbers of eight corners.
typedef double V __attribute__((vector_size(64), aligned(8)));
typedef long long I __attribute__((vector_size(64)));

/// FARTHEST:
/// Number of the corner that lies farthest in a direction; the first one of several.
const V *corners = (const V*)(lanes.data + begin), *last = (const V*)(lanes.data + end);
const I eight = {8, 8, 8, 8, 8, 8, 8, 8};
I index = {0, 1, 2, 3, 4, 5, 6, 7}, best = index;
V most = corners[0] * d[0] + corners[1] * d[1] + corners[2] * d[2];
for (corners += 3; corners < last; corners += 3) {
    index += eight;
    const V value = corners[0] * d[0] + corners[1] * d[1] + corners[2] * d[2];
    const I more = value > most;
    most = more ? value : most;
    best = more ? index : best;
}
int found = 0;
for (int k = 1; k < 8; ++k)
    if (most[k] > most[found] || (most[k] == most[found] && best[k] < best[found])) found = k;
return best[found];

/// LEAST:
/// The least of ``d . x + level - sum_i |rates_i . (x, 1)| half_i - sum_ij |h_ij|`` over corners x, ``h_ij =
/// second_ij . (x, 1)`` of each two of the path's joints; of a joint and itself only what is negative counts.
const V *corners = (const V*)(lanes.data + begin), *last = (const V*)(lanes.data + end);
constexpr unsigned joints = sizeof(half.c) / sizeof(half.c[0]);
V least = corners[0] * 0.0 + __builtin_inf();
for (; corners < last; corners += 3) {
    V value = corners[0] * d[0] + corners[1] * d[1] + corners[2] * d[2] + level;
    for (unsigned i = 0; i < joints; ++i) {
        const auto& r = rates.data[i];
        const V rate = corners[0] * r[0] + corners[1] * r[1] + corners[2] * r[2] + r[3];
        value -= __builtin_elementwise_abs(rate) * half[i];
    }
    const auto* r = second.data;
    for (int k = 0; k < joints_of_path; ++k)
        for (int m = k; m < joints_of_path; ++m, ++r) {
            const V bent = corners[0] * (*r)[0] + corners[1] * (*r)[1] + corners[2] * (*r)[2] + (*r)[3];
            const V off = __builtin_elementwise_abs(bent);
            value -= m > k ? off : (off - bent) * 0.5;
        }
    least = value < least ? value : least;
}
double found = least[0];
for (int k = 1; k < 8; ++k) found = least[k] < found ? least[k] : found;
return found;
