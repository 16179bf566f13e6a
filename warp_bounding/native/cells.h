// Look-ups in the cells of a grid, for bounders/voxels.py and bounders/relu_field.py. Names behind $ are filled in there.

/// VOXELS:
/// A bit field: is a cell occupied that the point may lie in?
enum { N = $n };
const int SHAPE[N] = {$shape};
$integer first[N], last[N];  // cells that the point may lie in
#pragma unroll
for (int k = 0; k < N; ++k) {
    const float end = SHAPE[k] - 1;
    const V t = v[k] * w[k] + w[N + k];
    V a = t - w[2 * N + k], b = t + w[2 * N + k];
    a = a < 0.0f ? a * 0.0f : a;
    a = a > end ? a * 0.0f + end : a;
    b = b < 0.0f ? b * 0.0f : b;
    b = b > end ? b * 0.0f + end : b;
    first[k] = $first;
    last[k] = $last;
}
$lanes
{
    unsigned int found = 0;
    $loops {
        const int cell = $index;
        found |= words.data[cell >> 5] >> (cell & 31);
    }
    f$at = (float)(found & 1u);
}

/// FIELD:
/// Multilinear interpolation between the 2^M nodes around a point, neighbours in pairs.
enum { M = $m };
const int NODES[M] = {$nodes}, STRIDES[M] = {$strides};
V share[M], c[1 << M];
$integer base = {0};
#pragma unroll
for (int k = 0; k < M; ++k) {  // node coordinate t, cut at the grid's ends, and the node below
    const float last = NODES[k] - 1;
    V t = v[k] * w[k] + w[M + k];
    t = t < 0.0f ? t * 0.0f : t;
    t = t > last ? t * 0.0f + last : t;
    const V low = t > last - 1.0f ? t * 0.0f + (last - 1.0f) : t;
    const $integer i = $to_integer;
    share[k] = t - $to_real;
    base += i * STRIDES[k];
}
#pragma unroll
for (int corner = 0; corner < 1 << M; ++corner) {  // bit M - 1 - k tells whether it is the upper one along axis k
    int at = 2 * M;
#pragma unroll
    for (int k = 0; k < M; ++k) at += (corner >> (M - 1 - k) & 1) * STRIDES[k];
    $gather
}
#pragma unroll
for (int k = M - 1; k >= 0; --k)
#pragma unroll
    for (int pair = 0; pair < 1 << k; ++pair)
        c[pair] = c[2 * pair] + (c[2 * pair + 1] - c[2 * pair]) * share[k];
f = c[0] < 0.0f ? c[0] * 0.0f : c[0];
f = f > 1.0f ? f * 0.0f + 1.0f : f;
