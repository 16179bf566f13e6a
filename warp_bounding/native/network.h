// A network in float32, for networks/inference.py.

/// QUERIES_IN_LANES:
/// In all texts w are the method's numbers, and f is the output. Here are
/// BLOCKS blocks of J neurons, of which USED are real, from the inputs x on: J biases, then J weights of each of K inputs stand together, so
/// that each input that is loaded serves J sums. KEEP their activations in y, or add them up to the output that stands
/// at OUTPUT_AT.
$unroll_blocks
for (int b = 0; b < BLOCKS; ++b) {
    const float* p = w + AT + b * J * (K + 1);
    V s[J];
#pragma unroll
    for (int r = 0; r < J; ++r) s[r] = x[0] * p[J + r] + p[r];
    $unroll_inputs
    for (int k = 1; k < K; ++k) {
        const V input = x[k]; const float* c = p + J + k * J;
#pragma unroll
        for (int r = 0; r < J; ++r) s[r] += input * c[r];
    }
#pragma unroll
    for (int r = 0; r < USED; ++r) {
        const int j = FIRST + b * J + r;
        V h;
        $act
        if (KEEP) y[j] = h;
        else f += h * w[OUTPUT_AT + 1 + j];
    }
}

/// LANES:
/// Lanes of neurons: as many as a register has. Behind the last of NEURONS a row has zeros, so that no register is
/// loaded from two lines of cache.
#if defined(__AVX512F__)
constexpr int L = 16;
#else
constexpr int L = 8;
#endif
constexpr int REGISTERS = (NEURONS + L - 1) / L;
typedef float V __attribute__((vector_size(4 * L), aligned(4), may_alias));
typedef int I __attribute__((vector_size(4 * L)));

/// NEURONS_IN_LANES:
/// One layer of one query: from K inputs x to NEURONS y; a row of biases, then one of weights an input, ROW floats
/// each. Every WAYS-th input is summed apart, so that there are sums enough that need not wait for each other.
constexpr int WAYS = REGISTERS > 3 ? 2 : 4;
V a[WAYS][REGISTERS];
const float* p = w + AT;
#pragma unroll
for (int q = 0; q < REGISTERS; ++q) {
    a[0][q] = *(const V*)(p + q * L);
    for (int r = 1; r < WAYS; ++r) a[r][q] = a[0][q] * 0.0f;
}
p += ROW;
#pragma unroll
for (int k = 0; k < K / WAYS * WAYS; k += WAYS)
    for (int r = 0; r < WAYS; ++r) {
        const float input = x[k + r]; const float* c = p + ROW * (k + r);
        for (int q = 0; q < REGISTERS; ++q) a[r][q] += *(const V*)(c + q * L) * input;
    }
#pragma unroll
for (int k = K / WAYS * WAYS; k < K; ++k) {
    const float input = x[k]; const float* c = p + ROW * k;
    for (int q = 0; q < REGISTERS; ++q) a[k % WAYS][q] += *(const V*)(c + q * L) * input;
}
#pragma unroll
for (int q = 0; q < REGISTERS; ++q) {
    V sum = a[0][q] + a[1][q];
    if (WAYS > 2) sum += a[2 % WAYS][q] + a[3 % WAYS][q];
    V h;
    $act
    *(V*)(y + q * L) = h;
}

/// SUM:
/// The output of one query, from ROW activations x; those behind the last neuron are 0, and so are their weights. The
/// lanes are eight here, and added by halves; the rounding bound holds for every order.
typedef float V __attribute__((vector_size(32), aligned(4), may_alias));
V sum = *(const V*)x * *(const V*)(w + AT + 1);
for (int q = 1; q < ROW / 8; ++q) sum += *(const V*)(x + q * 8) * *(const V*)(w + AT + 1 + q * 8);
f = ((sum[0] + sum[4]) + (sum[2] + sum[6])) + ((sum[1] + sum[5]) + (sum[3] + sum[7])) + w[AT];
