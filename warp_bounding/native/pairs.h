// A placed mesh against balls that hold another one, from the root of their tree down. Names behind $ are filled in by
// pairs/kernels.py, where it is said what this rounds.

/// CHECK:
/// Whether the data are a pair's own, of this source.
#if !defined(__CUDA_ARCH__)
#pragma clang fp contract(fast)
#endif
auto bits = [](float x) { union { float f; unsigned int i; } u; u.f = x; return u.i; };
const float* label = parameters.data;
const unsigned int numbers = parameters.shape[0], fields = words.shape[0];
if (numbers < $label || parameters.strides[0] != sizeof(float) || words.strides[0] != sizeof(unsigned int)) return -1.0f;
if (bits(label[0]) != ${first}u || bits(label[1]) != ${second}u) return -1.0f;  // another function's data
if (numbers < bits(label[2]) || fields < bits(label[3])) return -1.0f;
const int groups = links.shape[0] / $group;
if (groups < 1 || slots.shape[0] != 4 * $group * groups) return -1.0f;
$parts
$tools

/// ROTATION:
/// The matrix r of a quaternion q.
const float x = q[0], y = q[1], z = q[2], w = q[3];
r[0][0] = 1.0f - 2.0f * (y * y + z * z); r[0][1] = 2.0f * (x * y - w * z); r[0][2] = 2.0f * (x * z + w * y);
r[1][0] = 2.0f * (x * y + w * z); r[1][1] = 1.0f - 2.0f * (x * x + z * z); r[1][2] = 2.0f * (y * z - w * x);
r[2][0] = 2.0f * (x * z - w * y); r[2][1] = 2.0f * (y * z + w * x); r[2][2] = 1.0f - 2.0f * (x * x + y * y);

/// SEARCH:
/// Balls stand in groups of eight; a group of the stack is asked together, on a CPU one ball in each lane.
enum { GROUP = $group, STACK = $stack };
// From the balls' coordinates to the mesh's: y = M c + shift.
const float qa[4] = {$qa}, qb[4] = {$qb};
float na = 0.0f, nb = 0.0f;
for (int k = 0; k < 4; ++k) { na += qa[k] * qa[k]; nb += qb[k] * qb[k]; }
if (!(fabsf(na - 1.0f) <= $off && fabsf(nb - 1.0f) <= $off)) return -1.0f;
typedef float Row[3];
const float turn[4] = {  // conj(qa) qb
    qa[3] * qb[0] - qa[0] * qb[3] - qa[1] * qb[2] + qa[2] * qb[1],
    qa[3] * qb[1] + qa[0] * qb[2] - qa[1] * qb[3] - qa[2] * qb[0],
    qa[3] * qb[2] - qa[0] * qb[1] + qa[1] * qb[0] - qa[2] * qb[3],
    qa[3] * qb[3] + qa[0] * qb[0] + qa[1] * qb[1] + qa[2] * qb[2],
};
Row back[3], M[3], shift, offset;
float apart = 0.0f, least_a = INFINITY, most_b = 0.0f;
{
    const float* q = qa; Row* r = back;
    $rotation
}
{
    const float* q = turn; Row* r = M;
    $rotation
}
for (int k = 0; k < 3; ++k) {
    const float a = fabsf(scale_a[k]), b = fabsf(scale_b[k]);
    if (!(a >= $small && a <= $large && b >= $small && b <= $large)) return -1.0f;
    least_a = wb_least(least_a, a);
    most_b = wb_most(most_b, b);
    offset[k] = $pb[k] - $pa[k];
    apart += fabsf(offset[k]);
}
for (int k = 0; k < 3; ++k) {
    shift[k] = wb_over(back[0][k] * offset[0] + back[1][k] * offset[1] + back[2][k] * offset[2], scale_a[k]);
    for (int j = 0; j < 3; ++j) M[k][j] = wb_over(M[k][j] * scale_b[j], scale_a[k]);
}
const float nearer = least_a * $shorter, larger = most_b * $longer, blur = $room * apart + $least;

int stack[STACK], top = 1;
float lows[STACK], best = INFINITY;  // of a group on the stack: what is known of all that is in it
stack[0] = 0;
lows[0] = -INFINITY;
$types
while (top > 0) {
    $looked
    const int base = top < STACK / 4 ? 0 : top;  // the nearest of all first while few wait, else depth first
    for (int t = 0; t < m; ++t) for (int l = 0; l < GROUP; ++l) {
        float low = found[t * GROUP + l];
        if (low > gap || low >= best) continue;  // NaN goes on
        low = low > known[t] ? low : known[t];
        const int link = links.data[taken[t] * GROUP + l];
        if (link < 0) {
            if (!exact) return low > 0.0f ? low : 0.0f;  // near enough: which ball is nearest does not matter
            if (!(low > 0.0f)) return 0.0f;
            best = low < best ? low : best;
            continue;
        }
        if (link >= groups || top >= STACK) return -1.0f;
        int place = top++;  // sorted, the nearest on top
        for (; place > base && lows[place - 1] < low; --place) { lows[place] = lows[place - 1]; stack[place] = stack[place - 1]; }
        lows[place] = low;
        stack[place] = link;
    }
}
return best;

/// LANES
$lanes
const V zero = {};
constexpr int N = 3, TOGETHER = L / GROUP;

/// TOGETHER
    int taken[TOGETHER], m = 0;
    float known[TOGETHER], found[L];
    while (top > 0 && m < TOGETHER) {
        --top;
        if (lows[top] > gap || lows[top] >= best) continue;
        known[m] = lows[top];
        taken[m++] = stack[top];
    }
    if (m == 0) break;
    float at[4][L];
    for (int t = 0; t < TOGETHER; ++t) for (int k = 0; k < 4; ++k) for (int l = 0; l < GROUP; ++l)
        at[k][t * GROUP + l] = slots.data[(taken[t < m ? t : 0] * 4 + k) * GROUP + l];
    {
        const V cx = *(const V*)at[0], cy = *(const V*)at[1], cz = *(const V*)at[2], cr = *(const V*)at[3];
        V q[N], v[N];
#pragma unroll
        for (int k = 0; k < N; ++k) q[k] = cx * M[k][0] + cy * M[k][1] + cz * M[k][2] + shift[k];
        $locate
        V f;
        $body
        $after
        const V far_ = wb_size_of(cx * scale_b[0]) + wb_size_of(cy * scale_b[1]) + wb_size_of(cz * scale_b[2]);
        *(V*)found = g * nearer - (cr * larger + (far_ * $room + blur));
    }

/// LANE
typedef float V; typedef int Mask;
constexpr int N = 3;
const float zero = 0.0f;

/// ALONE
    --top;
    if (lows[top] > gap || lows[top] >= best) continue;
    const int m = 1, taken[1] = {stack[top]};
    const float known[1] = {lows[top]};
    float found[GROUP];
    for (int l = 0; l < GROUP; ++l) {
        const float* own = slots.data + taken[0] * 4 * GROUP + l;
        const V cx = own[0], cy = own[GROUP], cz = own[2 * GROUP], cr = own[3 * GROUP];
        V q[N], v[N];
#pragma unroll
        for (int k = 0; k < N; ++k) q[k] = cx * M[k][0] + cy * M[k][1] + cz * M[k][2] + shift[k];
        $locate
        V f;
        $scalar_body
        $after
        const V far_ = wb_size_of(cx * scale_b[0]) + wb_size_of(cy * scale_b[1]) + wb_size_of(cz * scale_b[2]);
        found[l] = g * nearer - (cr * larger + (far_ * $room + blur));
    }
