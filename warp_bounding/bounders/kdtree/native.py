"""The C text of the walk through a k-d tree of bits, one query at a time; a node's box follows from the way to it."""

from warp_bounding.bounders.kdtree.bits import BLOCK_BITS, BLOCK_WORDS

__all__ = ["ALONE", "DEPTH", "TOGETHER"]

DEPTH = 32  # levels of a tree in n dimensions are at most so many and n, since there are at most 2^31 cells

# Numbers: blocks of ``inner``, a plane's room; of each axis the lower border of cell 0, the upper border of the cell before it,
# the step from cell to cell, the number of cells.
_WALK = f"""
    constexpr int N = $n, M = $coordinates, LEVELS = {DEPTH} + N;
    const unsigned int* full = words.data + {BLOCK_WORDS} * (int)w[0];
    auto set_in = [](unsigned int x) {{
#if defined(__CUDA_ARCH__)
        return __popc(x);
#else
        return __builtin_popcount(x);
#endif
    }};
    auto walk = [&](const float* v) -> float {{
        typedef float V;
        const V none = 0.0f;
        $prepare
        int waiting[LEVELS][2 * N + 1], height = 0;
        int node = 0, first[N], last[N];
        for (int k = 0; k < N; ++k) {{
            first[k] = 0;
            last[k] = (int)w[2 + 3 * N + k] - 1;
        }}
        while (true) {{
            float b[2 * N];
#pragma unroll
            for (int k = 0; k < N; ++k) {{
                b[k] = w[2 + k] + (float)first[k] * w[2 + 2 * N + k];
                b[N + k] = w[2 + N + k] + (float)(last[k] + 1) * w[2 + 2 * N + k];
            }}
            $touches
            if (hit) {{
                const unsigned int* block = words.data + {BLOCK_WORDS} * (node / {BLOCK_BITS});
                const int place = node % {BLOCK_BITS}, word = 1 + place / 32;
                int before = (int)block[0];  // inner nodes before this one
                for (int j = 1; j < word; ++j) before += set_in(block[j]);
                before += set_in(block[word] & ((1u << (place & 31)) - 1u));
                if (block[word] >> (place & 31) & 1u) {{
                    int axis = 0;
                    for (int k = 1; k < N; ++k) axis = last[k] - first[k] > last[axis] - first[axis] ? k : axis;
                    const int middle = first[axis] + (last[axis] - first[axis]) / 2;
                    int* other = waiting[height++];
                    for (int k = 0; k < N; ++k) {{
                        other[k] = k == axis ? middle + 1 : first[k];
                        other[N + k] = last[k];
                    }}
                    other[2 * N] = 2 * before + 2;
                    node = 2 * before + 1;
                    last[axis] = middle;
                    continue;
                }}
                const int leaf = node - before;
                if (full[leaf >> 5] >> (leaf & 31) & 1u) return 0.0f;
            }}
            if (!height) return -1.0f;
            const int* next = waiting[--height];
            for (int k = 0; k < N; ++k) {{
                first[k] = next[k];
                last[k] = next[N + k];
            }}
            node = next[2 * N];
        }}
    }};
"""

ALONE = f"""
{{
    {_WALK}
    f = walk(v);
}}
"""

TOGETHER = f"""
{{
    {_WALK}
    for (int l = 0; l < L; ++l) {{
        float own[M];
        for (int k = 0; k < M; ++k) own[k] = v[k][l];
        f[l] = walk(own);
    }}
}}
"""
