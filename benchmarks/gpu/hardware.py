"""What a proof on tensor cores assumes of the hardware, tested on it: the sine of every number, and hard sums."""

import warp as wp

from warp_bounding.kernels.source import fill
from warp_bounding.networks import tensor_cores
from warp_bounding.runtime.native import named

EXPONENTS = 140  # of float32 numbers up to 2^13
SUMS = 64  # of a warp

_SINE = """
#if defined(__CUDA_ARCH__)
double most = 0.0, over = 0.0;
const unsigned int from = (unsigned int)block * 256u;  // sign and exponent, then 23 bits
const unsigned int exponent = from >> 24, sign = from >> 23 & 1u;
for (unsigned int k = 0; k < 256u; ++k) {
    const float z = __uint_as_float(sign << 31 | exponent << 23 | (from + k & 0x7fffffu));
    float h; asm volatile("sin.approx.f32 %0, %1;" : "=f"(h) : "f"(z));
    const double error = fabs((double)h - sin((double)z));
    if (!(error <= most)) most = error == error ? error : 1e9;
    over = fmax(over, error - $slope * fabs((double)z));
}
atomicMax((unsigned long long*)worst.data + 2 * exponent, (unsigned long long)__double_as_longlong(most));
atomicMax((unsigned long long*)worst.data + 2 * exponent + 1, (unsigned long long)__double_as_longlong(over));
#endif
"""

# A warp makes factors and what they are added to, in one of six ways, adds up, and compares with sums in float64, whose
# own errors are 2^-28 of a bound. Worst errors, in units of 2^-23: of the largest term, of the sum of absolute terms,
# and of the largest term after 2^-23 of the sum is taken off.
_SUMS = """
#if defined(__CUDA_ARCH__)
__shared__ float a_[4][16][16], b_[4][16][8], c_[4][16][8];
const int warp = threadIdx.x / 32, lane = threadIdx.x & 31, g = lane / 4, t = lane & 3;
typedef float V;
V (*a)[16] = a_[warp]; V (*b)[8] = b_[warp]; V (*c)[8] = c_[warp];
unsigned long long state = ((unsigned long long)block + 1) * 0x9E3779B97F4A7C15ull + seed;
auto random = [&]() {
    state ^= state << 13; state ^= state >> 7; state ^= state << 17; return (unsigned int)(state >> 32);
};
auto unit = [&]() { return (random() >> 8) * 0x1p-24f; };
auto half_of = [](float x) {
    unsigned short h; float y;
    asm("cvt.rn.f16.f32 %0, %1;" : "=h"(h) : "f"(x)); asm("cvt.f32.f16 %0, %1;" : "=f"(y) : "h"(h));
    return y;
};
auto pair = [](float x, float y) {
    unsigned int u; asm("cvt.rn.f16x2.f32 %0, %1, %2;" : "=r"(u) : "f"(y), "f"(x)); return u;
};
for (int turn = 0; turn < 64; ++turn) {
    const unsigned int whole = __shfl_sync(0xffffffffu, random(), 0);
    const int way = whole % 6, big = whole >> 4 & 15, gap = 18 + (whole >> 8) % 12, signs = whole >> 16 & 3;
    auto wide = [&](int range, int least) {
        const V x = ldexpf(1.0f + unit(), (int)(random() % range) - least); return random() & 1 ? -x : x;
    };
    auto small = [&](int by) {
        return ldexpf(way == 3 ? 2.0f - 0x1p-10f : 1.0f + unit(), -(way == 5 ? (int)(random() % 15) : by));
    };
    __syncwarp();
    for (int e = lane; e < 256; e += 32) {
        const int row = e / 16, k = e % 16;
        float x = 0.0f;
        if (way == 0) x = unit() * 2.0f - 1.0f;
        if (way == 1) x = wide(28, 14);
        if (way >= 2) x = k == big ? 1.0f + unit() : small(gap / 2);
        if (way >= 2 && k != big && (signs == 1 || (signs > 1 && random() & 1))) x = -x;
        a[row][k] = half_of(x);
    }
    for (int e = lane; e < 128; e += 32) {
        const int k = e / 8, col = e % 8;
        float x = 0.0f;
        if (way == 0) x = unit() * 2.0f - 1.0f;
        if (way == 1) x = wide(28, 14);
        if (way >= 2) x = k == big ? 1.0f : small(gap - gap / 2);
        b[k][col] = half_of(x);
    }
    __syncwarp();
    for (int e = lane; e < 128; e += 32) {
        const int row = e / 8, col = e % 8;
        float x = ldexpf(unit() * 2.0f - 1.0f, (int)(random() % 12) - 6);
        if (way == 1) x = ldexpf(unit() * 2.0f - 1.0f, (int)(random() % 60) - 30);
        if (way >= 2) {
            const float most = a[row][big] * b[big][col];
            const int kind = random() % 4;  // nothing, a cancelling one, as large as the small ones, far larger
            x = 0.0f;
            if (kind == 1) x = -most * (1.0f + ldexpf(unit(), -(int)(random() % 24)));
            if (kind == 2) x = ldexpf(1.0f + unit(), -gap);
            if (kind == 3) x = ldexpf(1.0f + unit(), (int)(random() % 24));
        }
        c[row][col] = x;
    }
    __syncwarp();
    float d[2][4];
    const unsigned int a0 = pair(a[g][2 * t], a[g][2 * t + 1]), a2 = pair(a[g][2 * t + 8], a[g][2 * t + 9]);
    const unsigned int a1 = pair(a[g + 8][2 * t], a[g + 8][2 * t + 1]);
    const unsigned int a3 = pair(a[g + 8][2 * t + 8], a[g + 8][2 * t + 9]);
    const unsigned int b0 = pair(b[2 * t][g], b[2 * t + 1][g]), b1 = pair(b[2 * t + 8][g], b[2 * t + 9][g]);
    const float c0 = c[g][2 * t], c1 = c[g][2 * t + 1], c2 = c[g + 8][2 * t], c3 = c[g + 8][2 * t + 1];
    asm volatile("mma.sync.aligned.m16n8k16.row.col.f32.f16.f16.f32 "
        "{%0, %1, %2, %3}, {%4, %5, %6, %7}, {%8, %9}, {%10, %11, %12, %13};"
        : "=f"(d[1][0]), "=f"(d[1][1]), "=f"(d[1][2]), "=f"(d[1][3])
        : "r"(a0), "r"(a1), "r"(a2), "r"(a3), "r"(b0), "r"(b1), "f"(c0), "f"(c1), "f"(c2), "f"(c3));
    asm volatile("mma.sync.aligned.m16n8k8.row.col.f32.f16.f16.f32 "
        "{%0, %1, %2, %3}, {%4, %5}, {%6}, {%7, %8, %9, %10};"
        : "=f"(d[0][0]), "=f"(d[0][1]), "=f"(d[0][2]), "=f"(d[0][3])
        : "r"(a0), "r"(a1), "r"(b0), "f"(c0), "f"(c1), "f"(c2), "f"(c3));
    for (int wide = 0; wide < 2; ++wide)
        for (int e = 0; e < 4; ++e) {
            const int row = g + 8 * (e / 2), col = 2 * t + e % 2;
            double sum = c[row][col], size = fabs(sum), most = size;
            for (int k = 0; k < 8 + 8 * wide; ++k) {
                const double term = (double)a[row][k] * (double)b[k][col];
                sum += term; size += fabs(term); most = fmax(most, fabs(term));
            }
            const double error = fabs((double)d[wide][e] - sum) * 0x1p23;
            double of[3] = {error, error, error};
            if (most > 0) { of[0] /= most; of[1] /= size; of[2] = fmax(error - fabs(sum), 0.0) / most; }
            for (int k = 0; k < 3; ++k) {
                if (!(of[k] >= 0)) of[k] = 1e9;
                const int place = (wide * 6 + way) * 3 + k;
                atomicMax((unsigned long long*)worst.data + place, (unsigned long long)__double_as_longlong(of[k]));
            }
        }
}
#endif
"""


def _kernel(name: str, snippet: str):
    @named(name).block_kernel(snippet)
    def kernel(seed: int, block: int, worst: wp.array(dtype=wp.float64)): ...

    return kernel


SINE, MMA = _kernel("hardware_sine", fill(_SINE, slope=tensor_cores.SINE_SLOPE.hex())), _kernel("hardware_sums", _SUMS)


def sine_errors(device: str) -> dict:
    """Largest errors of ``sin.approx`` of all float32 up to 2^13, by exponent, and their excess over the slope."""
    worst = wp.zeros(2 * EXPONENTS, dtype=wp.float64, device=device)
    wp.launch(SINE, EXPONENTS << 16, [0, 0], [worst], device=device)
    found = worst.numpy().reshape(-1, 2)
    within = bool(found[:, 1].max() <= tensor_cores.SINE_LEAST)
    return {
        "within": within,
        "over": float(found[:, 1].max()),
        "allowed": tensor_cores.SINE_LEAST,
        "slope": tensor_cores.SINE_SLOPE,
        "worst": found[:, 0].tolist(),
    }


def sum_errors(device: str, warps: int, seed: int) -> dict[str, list]:
    """Largest errors of ``mma`` by how terms are made, in 2^-23 (see ``_SUMS``); each warp makes 64 x 256 sums."""
    worst = wp.zeros(36, dtype=wp.float64, device=device)
    wp.launch(MMA, warps * 32, [seed, 0], [worst], device=device, block_dim=128)
    found = worst.numpy().reshape(2, 6, 3)
    within = all(found[i, :, 2].max() <= (9 + 8 * i) / 2 for i in range(2))
    return {"sums": warps * SUMS * 256, "within": within} | {f"k{8 + 8 * i}": found[i].tolist() for i in range(2)}


__all__ = ["sine_errors", "sum_errors"]
