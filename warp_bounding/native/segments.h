// Walks along segments a + t w of a network's inputs, for proof/segments.py: a segment a lane.

/// WALK:
/// Each lane takes one segment after another and goes along it, piece by piece from first to last. A piece is clear
/// where the bound of -f lies above what is needed there: base, less the least of the values of the lattice's parts
/// that the piece may meet. The next one is then twice as long. Of a piece that is not clear the walk goes as far as
/// the linear bound level + slope zeta tells, and goes on with a shorter one; it ends at one of 2^-depth of the way, and
/// in a quick walk at every point that cannot be clear. A row is a, w, first and last.
const double* rows = segments.data; const double* values = lattice.data + edges;
auto least_value = [&](const double* row, double begin, double end) {
    int from[K], to[K], now[K]; const double* edge = lattice.data;
    for (int k = 0; k < K; ++k) {
        const double x = row[k] + begin * row[K + k], y = row[k] + end * row[K + k];
        const double low = (x < y ? x : y) - AROUND, high = (x < y ? y : x) + AROUND; int at = 0;
        while (at < counts.data[k] - 1 && edge[at] <= low) ++at;
        from[k] = now[k] = at;
        while (at < counts.data[k] - 1 && edge[at] < high) ++at;
        to[k] = at; edge += counts.data[k] - 1;
    }
    double least = INFINITY;
    for (int k = K - 1; k >= 0;) {
        int place = 0;
        for (int i = 0; i < K; ++i) place = place * counts.data[i] + now[i];
        least = values[place] < least ? values[place] : least;
        for (k = K - 1; k >= 0 && ++now[k] > to[k]; --k) now[k] = from[k];
    }
    return least;
};
auto needed = [&](double least) {  // rounded up; nothing where all is denied
    const double exact = base - least;
    return least == INFINITY ? -INFINITY : exact + absolute_of(exact) * 0x1p-51 + 0x1p-1000;
};
V low[BOX], high[BOX]; int next = BEGIN, own[L]; double at[L], step[L];
auto take = [&](int l) {
    own[l] = next < END ? next++ : -1;
    const double* row = rows + (long long)(own[l] < 0 ? BEGIN : own[l]) * (BOX + 1);
    for (int k = 0; k < 2 * K; ++k) LANE(low[k]) = LANE(high[k]) = row[k];
    at[l] = row[2 * K]; step[l] = row[2 * K + 1] - at[l];
};
for (int l = 0; l < L; ++l) take(l);
for (;;) {
    int busy = 0;
    for (int l = 0; l < L; ++l) {
        busy += own[l] >= 0;
        const double last = rows[(long long)(own[l] < 0 ? BEGIN : own[l]) * (BOX + 1) + 2 * K + 1], end = at[l] + step[l];
        LANE(low[2 * K]) = at[l]; LANE(high[2 * K]) = end < last ? end : last;
    }
    if (!busy) break;
    BODY
    for (int l = 0; l < L; ++l) {
        if (own[l] < 0) continue;
        const double* row = rows + (long long)own[l] * (BOX + 1);
        const double first = row[2 * K], last = row[2 * K + 1], end = LANE(high[2 * K]);
        const double shortest = (last - first) / (double)(1u << depth), need = needed(least_value(row, at[l], end));
        const bool clear = need == -INFINITY || LANE(least) > need;  // NaN is not
        if (clear && end < last) { at[l] = end; step[l] *= 2.0; continue; }
        if (!clear) {
            const double where = LANE(z[2 * K]);
            const bool blocked = !(LANE(value) > needed(least_value(row, where, where)));
            const double rise = LANE(level) - (need + absolute_of(LANE(level)) * 0x1p-51), fall = -LANE(slope[0]);
            const double share = rise > -fall && fall > 0.0 ? (rise < fall ? rise / fall * 0.5 + 0.5 : 1.0) - 0x1p-40 : 0.0;
            const bool over = (blocked && (quick || where == at[l])) || step[l] <= shortest;
            if (share > 0.0) at[l] += share * (end - at[l]);
            step[l] *= blocked ? 0.125 : 0.25;
            step[l] = step[l] < shortest ? shortest : step[l];
            if (!over) continue;
        }
        until.data[own[l]] = clear ? INFINITY : at[l];
        take(l);
    }
}
