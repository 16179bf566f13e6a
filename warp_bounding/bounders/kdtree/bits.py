"""The bits of a k-d tree over cells: which nodes there are follows from them alone, so a file holds nothing that could contradict them.

A node is a box of cells; one with several may be halved across its longest side, the first of several, the lower half taking
the odd cell. Nodes are numbered level by level: bit i of ``inner`` says whether node i is halved, and the k-th that is has the
nodes ``2 k + 1`` and ``2 k + 2`` below it (the level-order encoding of Jacobson 1989, for binary trees). One bit of ``full`` a
leaf, in the same order, says whether something in it is occupied.
"""

from typing import NamedTuple

import numpy as np

from warp_bounding.errors import BounderError
from warp_bounding.indicators.summed_area import block_counts, summed_area

__all__ = ["BLOCK_BITS", "BLOCK_WORDS", "Nodes", "Tree", "blocks", "build", "nodes_of", "packed", "unpacked"]

BLOCK_WORDS = 4  # of ``blocks``: a count, and bits
BLOCK_BITS = 32 * (BLOCK_WORDS - 1)


class Tree(NamedTuple):
    """What is kept of a tree: for each node whether it is halved, for each leaf whether it is full; bool."""

    inner: np.ndarray  # (M,)
    full: np.ndarray  # (leaves,)


class Nodes(NamedTuple):
    """All nodes of a tree, in order."""

    first: np.ndarray  # (M, n) int64, lowest cell
    last: np.ndarray  # (M, n) int64, highest cell
    child: np.ndarray  # (M,) int64, the lower half; the upper one is next; 0 for leaves
    full: np.ndarray  # (M,) bool, whether it is a full leaf


def halves(first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both halves of boxes of cells ``(N, n)``, in turns: ``(2 N, n)`` lowest and highest cells."""
    row, axis = np.arange(len(first)), np.argmax(last - first, axis=1)
    middle = first[row, axis] + (last - first)[row, axis] // 2
    low, high = np.repeat(first, 2, axis=0), np.repeat(last, 2, axis=0)
    high[2 * row, axis], low[2 * row + 1, axis] = middle, middle + 1
    return low, high


def build(occupancy: np.ndarray, leaves: int | None = None) -> tuple[np.ndarray, Tree]:
    """The tree of a grid's occupied cells.

    Args:
        occupancy: ``(R_0, ...)`` bool; something in it is occupied.
        leaves: At most so many leaves: nodes with the fewest empty cells are not halved, and count as full. ``None`` for
            as many as the cells need, and the tree is exact.

    Returns:
        ``(2, n)`` int64, the lowest and the highest cell of the box that is divided; and the tree.
    """
    table, cells = summed_area(occupancy), np.argwhere(occupancy)
    box = np.stack([cells.min(axis=0), cells.max(axis=0)])
    first, last, empty, children = box[:1], box[1:], [], []
    count = 1  # nodes that are numbered
    while len(first):
        held = block_counts(table, first, last + 1)
        vacant = (last - first + 1).prod(axis=1) - held
        mixed = (held > 0) & (vacant > 0)
        children.append(np.where(mixed, count + 2 * (np.cumsum(mixed) - 1), 0))
        empty.append(np.where(held > 0, vacant, -1))
        count += 2 * int(mixed.sum())
        first, last = halves(first[mixed], last[mixed])
    empty, child = np.concatenate(empty), np.concatenate(children)
    inner, full = child > 0, empty >= 0
    if leaves is None:
        return box, Tree(inner, full[~inner])
    # those above a node have as many empty cells at least, and come before it
    dearest = np.flatnonzero(inner)
    dearest = dearest[np.argsort(-empty[dearest], kind="stable")][: leaves - 1]
    halved = np.zeros(len(inner), dtype=bool)
    halved[dearest] = True
    return box, _kept(halved, full, child)


def _kept(inner: np.ndarray, full: np.ndarray, child: np.ndarray) -> Tree:
    """The tree whose halved nodes are ``inner``, without halves that are both full leaves, and without what lies below no such node."""
    inner = inner.copy()
    for node in np.flatnonzero(inner)[::-1]:
        below = child[node] + np.arange(2)
        inner[node] = inner[below].any() or not full[below].all()
    order, level = [], np.zeros(1, dtype=np.int64)
    while len(level):
        order.append(level)
        level = (child[level[inner[level]], None] + np.arange(2)).reshape(-1)
    order = np.concatenate(order)
    return Tree(inner[order], full[order[~inner[order]]])


def nodes_of(tree: Tree, extent: np.ndarray) -> Nodes:
    """The nodes of a tree over a box of ``(n,)`` cells.

    Raises:
        BounderError: If the bits are no tree's.
    """
    inner, full = tree
    if len(inner) != 2 * int(inner.sum()) + 1 or len(full) != int(inner.sum()) + 1:
        raise BounderError("kd-tree: the bits are no tree's")
    first, last = [np.zeros((1, len(extent)), dtype=np.int64)], [extent[None] - 1]
    begin = 0
    while len(first[-1]):
        here = inner[begin : begin + len(first[-1])]
        if len(here) < len(first[-1]) or (here & (last[-1] == first[-1]).all(axis=1)).any():
            raise BounderError("kd-tree: the bits are no tree's")
        begin += len(here)
        low, high = halves(first[-1][here], last[-1][here])
        first.append(low)
        last.append(high)
    if begin != len(inner):
        raise BounderError("kd-tree: the bits are no tree's")
    leaf = np.zeros(len(inner), dtype=bool)
    leaf[~inner] = full
    child = np.where(inner, 2 * np.cumsum(inner) - 1, 0)
    return Nodes(np.concatenate(first), np.concatenate(last), child, leaf)


def packed(bits: np.ndarray) -> np.ndarray:
    """``(ceil(N / 32),)`` uint32 of ``(N,)`` bool, the first bit lowest."""
    held = np.packbits(bits, bitorder="little")
    return np.pad(held, (0, -len(held) % 4)).view("<u4").astype(np.uint32)


def unpacked(words: np.ndarray, count: int) -> np.ndarray:
    """Inverse of ``packed``: ``(count,)`` bool.

    Raises:
        BounderError: If there are not so many bits, or some behind them.
    """
    bits = np.unpackbits(words.astype("<u4").view(np.uint8), bitorder="little").astype(bool)
    if not len(bits) - 32 < count <= len(bits) or bits[count:].any():
        raise BounderError("kd-tree: the bits are no tree's")
    return bits[:count]


def blocks(inner: np.ndarray) -> np.ndarray:
    """The bits of ``inner`` as kernels read them: before each ``BLOCK_BITS`` of them, how many are set before; uint32."""
    padded = np.pad(inner, (0, -len(inner) % BLOCK_BITS)).reshape(-1, BLOCK_BITS)
    before = np.concatenate([[0], np.cumsum(padded.sum(axis=1))[:-1]]).astype(np.uint32)
    return np.column_stack([before, packed(padded.reshape(-1)).reshape(len(padded), -1)]).reshape(-1)
