// Walks along segments a + t w of a network's inputs, for proof/segments.py: a segment a lane.

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
