"""The plain twin of the field's look-up."""

import warp as wp

from warp_bounding.kernels.plain import Numbers, Words, twin, vector_type
from warp_bounding.kernels.source import Source

__all__ = ["plain_field"]


def plain_field(source: Source) -> wp.Function:
    """Interpolation between the nodes around a point, axis by axis, the last one first."""
    m = len(source.nodes)
    nodes = wp.types.vector(length=m, dtype=wp.int32)(*source.nodes)
    vector, corners = vector_type(m), vector_type(1 << m)

    @twin(source)
    def f(w: Numbers, words: Words, at: int, v: vector) -> float:
        share, base, c = vector(), wp.int32(0), corners()
        for k in range(m):
            t = wp.clamp(v[k] * w[at + k] + w[at + m + k], 0.0, float(nodes[k] - 1))
            low = int(wp.min(t, float(nodes[k] - 2)))
            share[k] = t - float(low)
            base = base * nodes[k] + low
        for corner in range(1 << m):  # bit m - 1 - k tells whether it is the upper one along axis k
            shift = wp.int32(0)
            for k in range(m):
                shift = shift * nodes[k] + ((corner >> (m - 1 - k)) & 1)
            c[corner] = w[at + 2 * m + base + shift]
        for level in range(m):
            axis = m - 1 - level
            for pair in range(1 << axis):
                c[pair] = c[2 * pair] + (c[2 * pair + 1] - c[2 * pair]) * share[axis]
        return wp.clamp(c[0], 0.0, 1.0)

    return f
