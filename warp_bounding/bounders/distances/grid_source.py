"""Native code of ``distance-grid``: the cell of a query, the values at its corners, and what is multilinear between them.

Of a refined grid each cell has a bit that says whether it has a block of finer nodes of its own; the number of bits before it is the block's number.
"""

from dataclasses import dataclass

import warp as wp

from warp_bounding.bounders.distances.grid_values import decode_text, plain_decode
from warp_bounding.kernels.distances.source import DistanceSource
from warp_bounding.kernels.plain import Numbers, Words, twin, vector_type
from warp_bounding.kernels.source import LABEL, Lanes, fill

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

    def plain(self) -> wp.Function:
        n, corners, refined = self.ndim, 2**self.ndim, wp.constant(self.refine > 1)
        refine, nodes, size = float(self.refine), self.refine + 1, (self.refine + 1) ** self.ndim
        limit, fine = LABEL + n - self.start, 3 * n + 2  # of the domain, and of blocks, from the method's numbers on
        vector, held, decode = vector_type(n), wp.types.vector(corners, wp.float32), plain_decode(self, self.storage)

        @twin(self, "block")
        def block(w: Numbers, words: Words, at: int, cell: int) -> int:
            """The number of a cell's block; -1 where it has none."""
            word = int(w[at + fine + n + 3]) + 2 * (cell >> 5)
            bits, bit, before = words[word], wp.uint32(cell & 31), wp.int32(words[word + 1])
            if (bits >> bit) & wp.uint32(1) == wp.uint32(0):
                return -1
            for b in range(32):
                if wp.uint32(b) < bit:
                    before += wp.int32((bits >> wp.uint32(b)) & wp.uint32(1))
            return before

        @twin(self)
        def f(w: Numbers, words: Words, at: int, v: vector) -> float:
            share, node = vector(), held()
            first, cell, entered = wp.int32(0), wp.int32(0), wp.int32(-1)
            low, unit = wp.float32(w[at + 3 * n]), wp.float32(w[at + 3 * n + 1])
            for k in range(n):
                t = (v[k] + w[at + limit + k]) * w[at + k]
                c = wp.floor(wp.clamp(t, 0.0, w[at + 2 * n + k]))
                share[k] = t - c
                first += int(c) * int(w[at + n + k])
                if refined:
                    cell += int(c) * int(w[at + fine + k])
            if refined:
                entered = block(w, words, at, cell)
            if entered >= 0:
                first = wp.int32(0)
                low = wp.float32(w[at + fine + n])
                unit = wp.float32(w[at + fine + n + 1])
                for k in range(n):
                    s = share[k] * refine
                    sub = wp.floor(wp.clamp(s, 0.0, refine - 1.0))
                    share[k] = s - sub
                    first = first * nodes + int(sub)
                first += int(w[at + fine + n + 2]) + entered * size
            for c in range(corners):
                i = wp.int32(first)
                wide = wp.int32(1)
                for j in range(n):
                    k = n - 1 - j
                    stride = wp.int32(w[at + n + k])
                    if entered >= 0:
                        stride = wp.int32(wide)
                    i += ((c >> k) & 1) * stride
                    wide *= nodes
                node[c] = decode(w, words, i, low, unit)
            count = wp.int32(corners)
            for k in range(n):
                count = count // 2
                for j in range(count):
                    node[j] = node[2 * j] + share[k] * (node[2 * j + 1] - node[2 * j])
            return node[0]

        return f
