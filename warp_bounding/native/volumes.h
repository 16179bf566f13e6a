// Points, rays, planes and boxes against volumes, for bounders/volumes.py and those that build on it. Names in capitals
// are constants that stand in front of a part; names behind $ are numbers and other parts. A part sets f from v and the
// numbers w, in a scope of its own.

/// SLOW:
/// Slab clipping without a division by zero: a face that may be met is at least ``CLEARANCE / 2`` from a ray that runs
/// along it, so the parameters at which a speed of ``PARALLEL`` meets the faces lie outside [0, 1] as they should. This
/// is one over the speed s.
const V speed = s < none ? -s : s, cross = speed > $parallel ? s : none + $parallel;
const V slow = wb_over(none + 1.0f, cross);

/// CLIP:
/// y + t s lies in [low, high] between two parameters.
const V one = (low - y) * slow, two = (high - y) * slow;
const V near = one < two ? one : two, away = one < two ? two : one;
enter = near > enter ? near : enter;
leave = away < leave ? away : leave;

/// SLABS_ROW:
/// The product of direction i with the vector at v[at].
const float* d = w + 2 * SLABS + i * N;
V along = DIAGONAL ? v[at + i % N] : v[at] * d[0];
#pragma unroll
for (int j = 1; j < N && !DIAGONAL; ++j) along = along + v[at + j] * d[j];

/// SLABS_POINT
const V none = {0.0f};
f = none + 3.0e38f;
#pragma unroll
for (int i = 0; i < SLABS; ++i) {
    const int at = 0;
    $row
    const V a = along - w[i], b = w[SLABS + i] - along, c = a < b ? a : b;
    f = c < f ? c : f;
}

/// SLABS_RAY
const V none = {0.0f};
V enter = none, leave = none + 1.0f;
#pragma unroll
for (int i = 0; i < SLABS; ++i) {
    const float low = w[i], high = w[SLABS + i];
    V y, s;
    {
        const int at = 0;
        $row
        y = along;
    }
    {
        const int at = N;
        $row
        s = along;
    }
    $slow
    $clip
}
f = enter <= leave + $guard ? none : none - 1.0f;

/// SLABS_EDGES:
/// A plane against a parallelepiped, by its edges.
const V none = {0.0f};
V foot = v[0] * w[0];
#pragma unroll
for (int j = 1; j < N; ++j) foot = foot + v[j] * w[j];
V off = v[N] - foot;
off = off < none ? -off : off;
V reach = none;
#pragma unroll
for (int i = 0; i < N; ++i) {
    const float* d = w + N + i * N;
    V y = DIAGONAL ? v[i] * w[N + i] : v[0] * d[0];
#pragma unroll
    for (int j = 1; j < N && !DIAGONAL; ++j) y = y + v[j] * d[j];
    reach = reach + (y < none ? -y : y);
}
f = reach - off;

/// CORNERS:
/// A plane against a polytope, by its vertices.
const V none = {0.0f};
const int corners = (int)w[0];
V most = none - 3.0e38f, least = none + 3.0e38f;
for (int i = 0; i < corners; ++i) {
    const float* at = w + 1 + i * N;
    V y = v[0] * at[0];
#pragma unroll
    for (int j = 1; j < N; ++j) y = y + v[j] * at[j];
    most = y > most ? y : most;
    least = y < least ? y : least;
}
most = most - v[N];
least = v[N] - least;
f = most < least ? most : least;

/// SLABS_BOX
const V none = {0.0f};
f = none + 3.0e38f;
V middle[N], half[N];
#pragma unroll
for (int j = 0; j < N; ++j) {
    middle[j] = (v[j] + v[N + j]) * 0.5f;
    half[j] = (v[N + j] - v[j]) * 0.5f;
}
#pragma unroll
for (int i = 0; i < SLABS; ++i) {
    V a = v[i % N], b = v[N + i % N];
    if (!DIAGONAL) {
        const float* d = w + 2 * SLABS + i * N;
        V y = middle[0] * d[0], r = half[0] * (d[0] < 0.0f ? -d[0] : d[0]);
#pragma unroll
        for (int j = 1; j < N; ++j) {
            y = y + middle[j] * d[j];
            r = r + half[j] * (d[j] < 0.0f ? -d[j] : d[j]);
        }
        a = y - r;
        b = y + r;
    }
    const V c = b - w[i], e = w[SLABS + i] - a, overlap = c < e ? c : e;
    f = overlap < f ? overlap : f;
}

/// HALF_SPACES_POINT
const V none = {0.0f};
f = none + 3.0e38f;
#pragma unroll
for (int i = 0; i < HALF_SPACES; ++i) {
    const float* a = w + HALF_SPACES + i * N;
    V height = v[0] * a[0];
#pragma unroll
    for (int j = 1; j < N; ++j) height = height + v[j] * a[j];
    const V y = w[i] - height;
    f = y < f ? y : f;
}

/// HALF_SPACES_RAY:
/// A face along which a ray may run is ``CLEARANCE`` away, so there is no division by zero.
const V none = {0.0f};
V come = none, gone = none + 1.0f;
#pragma unroll
for (int i = 0; i < HALF_SPACES; ++i) {
    const float* a = w + HALF_SPACES + i * N;
    V y = v[0] * a[0], s = v[N] * a[0];
#pragma unroll
    for (int j = 1; j < N; ++j) {
        y = y + v[j] * a[j];
        s = s + v[N + j] * a[j];
    }
    const V speed = s < none ? -s : s;
    const V cross = speed > $parallel ? s : none + $parallel;
    const V at = wb_over(w[i] - y, cross);
    const V first = cross < none ? at : none, last = cross < none ? none + 1.0f : at;
    come = first > come ? first : come;
    gone = last < gone ? last : gone;
}
f = come <= gone + $guard ? none : none - 1.0f;

/// HALF_SPACES_BOX
const V none = {0.0f};
f = none + 3.0e38f;
#pragma unroll
for (int i = 0; i < HALF_SPACES; ++i) {
    const float* a = w + HALF_SPACES + i * N;
    V corner = (a[0] < 0.0f ? v[N] : v[0]) * a[0];
#pragma unroll
    for (int j = 1; j < N; ++j) corner = corner + (a[j] < 0.0f ? v[N + j] : v[j]) * a[j];
    const V y = w[i] - corner;
    f = y < f ? y : f;
}

/// ELLIPSOID_POINT
f = v[0] * 0.0f;
#pragma unroll
for (int i = 0; i < N; ++i) {
    const float* a = w + N + i * N;
    V along = DIAGONAL ? v[i] * w[N + i] : v[0] * a[0];
#pragma unroll
    for (int j = 1; j < N && !DIAGONAL; ++j) along = along + v[j] * a[j];
    const V y = along + w[i];
    f = f - y * y;
}

/// BVH_ALONE:
/// The walk of one query through a hierarchy: $touches sets hit, whether a node is met.
const V none = 0.0f;
(void)none;
$prepare
const int count = (int)w[0];
int i = 0;
f = -1.0f;
while (i < count) {
    const float* b = w + LEADING + i * (2 * N + 1);  // low, high, past
    const int past = (int)b[2 * N];
    $touches
    if (hit && past == i + 1) { f = 0.0f; break; }  // a leaf
    i = hit ? i + 1 : past;
}

/// BVH_TOGETHER:
/// The walk of lanes together. A lane waits until the walk is at its next node; it is done where that is the end.
const V none = {0.0f};
$prepare
const int count = (int)w[0];
int i = 0;
I next = {0}, found = {0};
while (i < count) {
    const float* b = w + LEADING + i * (2 * N + 1);  // low, high, past
    const int past = (int)b[2 * N];
    $touches
    hit = hit & (next <= i);
    if (past == i + 1) {  // a leaf
        found = found | hit;
        next = hit ? (next & 0) + count : next;
        i = past;
        if (__builtin_reduce_and(found)) break;
    } else {
        next = ((next <= i) & ~hit) ? (next & 0) + past : next;
        i = __builtin_reduce_or(hit) ? i + 1 : past;
    }
}
f = found ? none : none - 1.0f;

/// BVH_SIGNS:
/// A plane: what is done before the walk, and at a node.
V plus[N], minus[N];
#pragma unroll
for (int k = 0; k < N; ++k) {
    plus[k] = v[k] > none ? v[k] : none;
    minus[k] = v[k] - plus[k];
}
const V under = v[N] - w[1], above = v[N] + w[1];

/// BVH_PLANE
V most = plus[0] * b[N] + minus[0] * b[0], least = plus[0] * b[0] + minus[0] * b[N];
#pragma unroll
for (int k = 1; k < N; ++k) {
    most = most + (plus[k] * b[N + k]) + (minus[k] * b[k]);
    least = least + (plus[k] * b[k]) + (minus[k] * b[N + k]);
}
Mask hit = (under <= most) & (above >= least);

/// BVH_SPEEDS:
/// A ray, likewise.
V each[N];
#pragma unroll
for (int k = 0; k < N; ++k) {
    const V s = v[N + k];
    $slow
    each[k] = slow;
}

/// BVH_RAY
V enter = none, leave = none + 1.0f;
#pragma unroll
for (int k = 0; k < N; ++k) {
    const float low = b[k], high = b[N + k];
    const V y = v[k], slow = each[k];
    $clip
}
Mask hit = enter <= leave + $guard;

/// BVH_DISTANCE:
/// The distance to the leaves: down to one that is near, then to all nodes that are nearer than what was found.
const int count = (int)w[0];
enum { NODE = 2 * N + 1 };  // low, high, past
V nearest = zero + $farthest;
int i = 0, leaf = 0;
while (!leaf) {  // down to the leaf that is near the first lane
    const int past = (int)w[1 + i * NODE + 2 * N];
    int best = i + 1;
    float nearer = $farthest;
    for (int child = i + 1; child < past; child = (int)w[1 + child * NODE + 2 * N]) {
        const float* b = w + 1 + child * NODE;
        $way
        const float first = $first;
        if (first < nearer) { nearer = first; best = child; }
    }
    leaf = past <= i + 1;
    i = leaf ? i : best;
}
{
    const float* b = w + 1 + i * NODE;
    $way
    nearest = wb_least(nearest, there);
}
i = 0;
while (i < count) {
    const float* b = w + 1 + i * NODE;
    $way
    const int behind = (int)b[2 * N];
    if ($none) {
        i = behind;
    } else {
        if (behind == i + 1) nearest = wb_least(nearest, there);
        ++i;
    }
}
f = wb_root(nearest);

/// BVH_WAY:
/// The squared distance to the box b of a node.
V there = zero;
#pragma unroll
for (int k = 0; k < N; ++k) {
    const V out = wb_most(wb_most(b[k] - v[k], v[k] - b[N + k]), zero);
    there = there + out * out;
}
