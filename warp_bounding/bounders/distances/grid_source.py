"""Native code of ``distance-grid``: the cell of a query, the values at its corners, and what is multilinear between them.

Of a refined grid each cell has a bit that says whether it has a block of finer nodes of its own; the number of bits before it is the block's number.
"""

from dataclasses import dataclass

from warp_bounding.bounders.distances.grid_values import decode_text
from warp_bounding.kernels.distances.source import DistanceSource
from warp_bounding.kernels.source import Lanes, fill

__all__ = ["DistanceGridSource"]

_BODY = """
{
    const float* inverse = w;
    const float* stride = w + N;
    const float* last = w + 2 * N;  // the last cell's number
    const auto value = $decode;
    V share[N], at = zero;
    $begin
#pragma unroll
    for (int k = 0; k < N; ++k) {
        const V t = (v[k] + limit[k]) * inverse[k];
        const V cell = $floor(least(most(t, zero), zero + last[k]));
        share[k] = t - cell;
        at = at + cell * stride[k];
        $place
    }
    V node[1 << N];
    $lanes {
        int first = (int)at$l, step[N];
        float low = w[3 * N], unit = w[3 * N + 1];
#pragma unroll
        for (int k = 0; k < N; ++k) step[k] = (int)stride[k];
        $enter
#pragma unroll
        for (int c = 0; c < 1 << N; ++c) {
            int i = first;
            for (int k = 0; k < N; ++k) i += (c >> k & 1) * step[k];
            node[c]$l = value(i, low, unit);
        }
    }
#pragma unroll
    for (int k = 0; k < N; ++k)
#pragma unroll
        for (int j = 0; j < 1 << (N - 1 - k); ++j) node[j] = node[2 * j] + share[k] * (node[2 * j + 1] - node[2 * j]);
    f = node[0];
}
"""
_BEGIN = """
    const float* fine = w + 3 * N + 2;  // strides of cells; what 8 bits mean; where blocks and bits begin
    V inner[N], sub[N], which = zero;
"""
_PLACE = """
        which = which + cell * fine[k];
        const V s = share[k] * $refine.0f;
        sub[k] = $floor(least(most(s, zero), zero + $last.0f));
        inner[k] = s - sub[k];
"""
_ENTER = """
        const int cell = (int)which$l, bit = cell & 31, word = (int)fine[N + 3] + 2 * (cell >> 5);
        const unsigned int bits = words.data[word];
        if (bits >> bit & 1u) {
            unsigned int x = bits & ((1u << bit) - 1u);
            x -= x >> 1 & 0x55555555u;
            x = (x & 0x33333333u) + (x >> 2 & 0x33333333u);
            x = ((x + (x >> 4)) & 0x0f0f0f0fu) * 0x01010101u >> 24;
            first = (int)fine[N + 2] + (int)(words.data[word + 1] + x) * $size;
            for (int k = N - 1, wide = 1; k >= 0; --k, wide *= $nodes) {
                step[k] = wide;
                first += (int)sub[k]$l * wide;
                share[k]$l = inner[k]$l;
            }
            low = fine[N], unit = fine[N + 1];
        }
"""


@dataclass(frozen=True)
class DistanceGridSource(DistanceSource):
    """Native code of the interpolation.

    Numbers: per axis nodes per local unit, stride and last cell; then what 8 bits mean; where cells are refined per axis the stride of a cell's number, what 8 bits of
    blocks mean, and where blocks (in values) and bits (in words) begin. Words: values, blocks, then for 32 cells each their bits, and how many bits there are before.
    """

    storage: str
    refine: int

    whole = False

    def body(self, lanes: Lanes) -> str:
        floor = "__builtin_elementwise_floor" if lanes.vector else "floorf"
        lane, loop = ("[l]", "for (int l = 0; l < L; ++l)") if lanes.vector else ("", "")
        own = {"begin": "", "place": "", "enter": ""}
        if self.refine > 1:
            nodes = self.refine + 1
            place = fill(_PLACE, refine=self.refine, last=self.refine - 1, floor=floor)
            own = {"begin": _BEGIN, "place": place, "enter": fill(_ENTER, size=nodes**self.ndim, nodes=nodes, l=lane)}
        return fill(_BODY, decode=decode_text(self.storage), floor=floor, lanes=loop, l=lane, **own)
