"""f of a distance-grid, over boxes of places: coordinates in which its nodes are the whole numbers.

Between its nodes f is minus what is multilinear. So over a box within a cell, f less anything affine is least at a
corner of the box; over others, whose corners are nodes, f is no less than at one of their nodes.
"""

from itertools import product

import numpy as np

CORNERS = np.array(list(product((0, 1), repeat=3)))


def lowest(values: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, ...]:
    """As ``network.lowest``; nothing bends. The room is a hundred times what float64 rounds of so few values."""
    cell, side, room = lower.astype(int), upper - lower, 2.0**-44 * np.abs(values).max()
    nodes = values[tuple((cell + CORNERS[:, None]).transpose(2, 0, 1))]
    place = np.where(CORNERS[:, None], upper, lower) - cell  # of the box's corners; in fractions, which are exact
    share = np.where(CORNERS[:, None, None], place, 1 - place).prod(axis=-1)  # of a node (first axis) in a corner's f
    f = -(share * nodes[:, None]).sum(axis=0)
    for i in np.flatnonzero((upper > cell + 1).any(axis=1)):
        held = [slice(int(low), int(high) + 1) for low, high in zip(np.floor(lower[i]), np.ceil(upper[i]), strict=True)]
        f[:, i] = -values[tuple(held)].max()
    slope = f.T @ (CORNERS - 0.5) / 2 / side  # mean of the upper corners less that of the lower ones
    base = (f - (CORNERS - 0.5) @ (slope * side).T).min(axis=0)
    return f.min(axis=0) - room, base - room, slope, np.zeros(side.shape)
