"""A lattice of parts in native code: where v lies among the edges of each axis, and the level, a byte, that stands there.

Comparisons with edges are exact, so every device finds the same part of the domain, and what is proven of a part holds
for each v in it.
"""

from warp_bounding.kernels.source import fill

__all__ = ["PER_WORD", "level_text"]

PER_WORD = 4  # levels, a byte each, in a word

# The index of v's part, in array order: along each axis, how many edges v has reached.
_PLACE = {
    True: "I part_ = {};\n$axes",
    False: "int part_ = 0;\n$axes",
}
_AXIS = {
    True: "{ I i = {}; for (int e = $first; e < $last; ++e) i -= v[$k] >= w[e]; part_ = part_ * $count + i; }",
    False: "{ int i = 0; for (int e = $first; e < $last; ++e) i += v[$k] >= w[e]; part_ = part_ * $count + i; }",
}
_LEVEL = {
    True: """
V level_;
{
    int at_[L]; float found_[L];  // in memory: lanes of a vector are dear one by one
    *(J*)at_ = part_;
    for (int l = 0; l < L; ++l) found_[l] = (float)(words.data[at_[l] >> 2] >> (8 * (at_[l] & 3)) & 255u);
    level_ = *(const V*)found_;
}
""",
    False: "const float level_ = (float)(words.data[part_ >> 2] >> (8 * (part_ & 3)) & 255u);\n",
}


def level_text(shape: tuple[int, ...], first: int, vector: bool) -> str:
    """C statements that compute ``level_`` from ``v``, ``w`` and ``words``.

    Args:
        shape: Parts along each axis of v.
        first: Index in ``w`` of the first edge; those of each axis in turn.
        vector: Whether v has a query in each lane.
    """
    lines = []
    for k, count in enumerate(shape):
        if count > 1:
            lines.append(fill(_AXIS[vector], k=k, first=first, last=first + count - 1, count=count))
        first += count - 1
    return fill(_PLACE[vector], axes="\n".join(lines)) + _LEVEL[vector]
