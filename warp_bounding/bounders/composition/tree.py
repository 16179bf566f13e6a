"""How the parts of a composition are put together: a tree, as lists that JSON can hold, and the rows that a kernel follows."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from warp_bounding.bounders.local.lattice import NEAREST_TO_ZERO
from warp_bounding.coordinates.region_domain import AnyDomain

__all__ = ["AND", "OR", "SPLIT", "Tree", "children_of", "parts_of", "rows_of", "steps_of"]

AND, OR, SPLIT = "and", "or", "split"
MOST_NESTED = 32
# The number of a part; or a list, AND or OR first, then trees; or SPLIT, an axis, a place along it, the tree for v below
# the place and the one for others.
Tree = int | list


def rows_of(tree: Tree) -> int:
    """How many parts and splits a tree has."""
    if isinstance(tree, int):
        return 1
    return (tree[0] == SPLIT) + sum(map(rows_of, children_of(tree)))


def children_of(tree: list) -> list[Tree]:
    """The trees behind what stands before them."""
    return tree[3 if tree[0] == SPLIT else 1 :]


def _is_split(tree: list, domain: AnyDomain) -> bool:
    """Whether a tree that calls itself a split is one for points of a domain."""
    if (
        len(tree) != 5
        or not domain.tested_as_point
        or domain.parametric
        or type(tree[1]) is not int
        or not 0 <= tree[1] < domain.ndim
    ):
        return False
    return type(tree[2]) is float and abs(tree[2]) >= NEAREST_TO_ZERO and float(np.float32(tree[2])) == tree[2]


def parts_of(tree: Any, domain: AnyDomain, depth: int = 0) -> Iterator[int]:
    """The numbers of the parts of a tree, in order; -1 where something is no tree."""
    if type(tree) is int:
        yield tree
    elif isinstance(tree, list) and tree and tree[0] == SPLIT and depth < MOST_NESTED and _is_split(tree, domain):
        for child in tree[3:]:
            yield from parts_of(child, domain, depth + 1)
    elif isinstance(tree, list) and len(tree) > 1 and tree[0] in (AND, OR) and depth < MOST_NESTED:
        for child in tree[1:]:
            yield from parts_of(child, domain, depth + 1)
    else:
        yield -1


def steps_of(tree: Tree, at: int, yes: int, no: int) -> Iterator[tuple[int | tuple[int, float], int, int]]:
    """The rows of a tree that begin at row ``at``: a part, or axis and place of a split; and the rows to go to from it."""
    if isinstance(tree, int):
        yield tree, yes, no
    elif tree[0] == SPLIT:
        below = at + 1
        above = below + rows_of(tree[3])
        yield (tree[1], tree[2]), above, below
        yield from steps_of(tree[3], below, yes, no)
        yield from steps_of(tree[4], above, yes, no)
    else:
        for child in tree[1:]:
            then = at + rows_of(child)
            last = child is tree[-1]
            on = (yes if last else then, no) if tree[0] == AND else (yes, no if last else then)
            yield from steps_of(child, at, *on)
            at = then
