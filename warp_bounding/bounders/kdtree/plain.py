"""The plain twin of a k-d tree of bits."""

import warp as wp

from warp_bounding.bounders.bvh.plain import box_touches
from warp_bounding.bounders.kdtree.bits import BLOCK_BITS, BLOCK_WORDS
from warp_bounding.bounders.kdtree.native import DEPTH
from warp_bounding.kernels.plain import Numbers, Words, twin, vector_type
from warp_bounding.kernels.source import Source

__all__ = ["plain_walk"]


@wp.func
def _set_in(x: wp.uint32) -> wp.int32:
    """How many bits are set."""
    pairs = x - ((x >> wp.uint32(1)) & wp.uint32(0x55555555))
    fours = (pairs & wp.uint32(0x33333333)) + ((pairs >> wp.uint32(2)) & wp.uint32(0x33333333))
    bytes_ = (fours + (fours >> wp.uint32(4))) & wp.uint32(0x0F0F0F0F)
    return wp.int32((bytes_ * wp.uint32(0x01010101)) >> wp.uint32(24))


@wp.func
def _before(words: Words, node: wp.int32) -> wp.int32:
    """How many inner nodes come before one."""
    block, place = node / BLOCK_BITS * BLOCK_WORDS, node % BLOCK_BITS
    count = wp.int32(words[block])
    for j in range(place / 32):
        count += _set_in(words[block + 1 + j])
    below = (wp.uint32(1) << wp.uint32(place % 32)) - wp.uint32(1)
    return count + _set_in(words[block + 1 + place / 32] & below)


@wp.func
def _is_inner(words: Words, node: wp.int32) -> wp.bool:
    place = node % BLOCK_BITS
    return (
        words[node / BLOCK_BITS * BLOCK_WORDS + 1 + place / 32] >> wp.uint32(place % 32) & wp.uint32(1)
    ) == wp.uint32(1)


def plain_walk(source: Source) -> wp.Function:
    """0 where a full leaf is met, else -1; halves that wait are held with their cells."""
    n, vector, touches = source.ndim, vector_type(source.coordinates), box_touches(source)
    size, both = 2 * n + 1, vector_type(2 * n)
    cells = wp.types.vector(length=n, dtype=wp.int32)
    held = wp.types.vector(length=(DEPTH + n) * size, dtype=wp.int32)

    @twin(source)
    def f(w: Numbers, words: Words, at: int, v: vector) -> float:
        waiting, first, last, box = held(), cells(), cells(), both()
        height, node, value, going = wp.int32(0), wp.int32(0), wp.float32(-1.0), wp.bool(True)
        full = BLOCK_WORDS * int(w[at])
        for k in range(n):
            last[k] = int(w[at + 2 + 3 * n + k]) - 1
        while going:
            for k in range(n):
                box[k] = w[at + 2 + k] + float(first[k]) * w[at + 2 + 2 * n + k]
                box[n + k] = w[at + 2 + n + k] + float(last[k] + 1) * w[at + 2 + 2 * n + k]
            down = wp.bool(False)
            if touches(w[at + 1], box, v):
                before = _before(words, node)
                if _is_inner(words, node):
                    axis = wp.int32(0)
                    for k in range(n):
                        axis = wp.where(last[k] - first[k] > last[axis] - first[axis], k, axis)
                    middle = first[axis] + (last[axis] - first[axis]) / 2
                    for k in range(n):
                        waiting[height * size + k] = wp.where(k == axis, middle + 1, first[k])
                        waiting[height * size + n + k] = last[k]
                    waiting[height * size + 2 * n] = 2 * before + 2
                    height += 1
                    node = 2 * before + 1
                    last[axis] = middle
                    down = wp.bool(True)
                else:
                    leaf = node - before
                    if (words[full + leaf / 32] >> wp.uint32(leaf % 32) & wp.uint32(1)) == wp.uint32(1):
                        value = wp.float32(0.0)
                        height = wp.int32(0)
            if not down:
                going = height > 0
                if going:
                    height -= 1
                    for k in range(n):
                        first[k] = waiting[height * size + k]
                        last[k] = waiting[height * size + n + k]
                    node = waiting[height * size + 2 * n]
        return value

    return f
