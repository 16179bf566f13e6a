"""Networks of regions with random weights, monotone ones too; what they bound is of no account."""

import numpy as np
from bounding_shapes import random_mlp

from warp_bounding.bounders.mlp import Mlp, MonotoneMlp
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.shapes import Grid


def random_network(query: str, grid: Grid, seed=0, activation="sin", hidden=(9, 7), gain=2.0) -> Mlp:
    """Its first layer's weights are larger by ``gain``; of planes it has two outputs."""
    return random_mlp(grid, hidden, activation, seed=seed, gain=gain, domain=domain_of(grid, query))


def random_supports(grid, seed=0, activation="sin", hidden=(9, 7)) -> Mlp:
    """Of planes."""
    return random_network("plane", grid, seed, activation, hidden, gain=1.5)


def signs_of(ndim: int, hidden, falling: float, rng) -> list[np.ndarray]:
    """``(out, in)`` signs of each layer's weights; a share of the neurons falls."""
    below, signs = np.repeat([-1.0, 1.0], ndim), []
    for width in hidden:
        way = np.where(rng.random(width) < falling, -1.0, 1.0)
        signs.append(way[:, None] * below)
        below = way
    return [*signs, below[None]]


def random_monotone(grid, hidden=(9, 7), activation="tanh", falling=0.4, seed=0, gain=3.0, dense=False) -> MonotoneMlp:
    """Steep enough to be hard to bound; unless it is dense, a third of the weights is 0; not proven."""
    rng, tensors = np.random.default_rng(seed), {}
    for index, sign in enumerate(signs_of(grid.ndim, hidden, falling, rng)):
        scale = (gain if index == 0 else 1.5) / np.sqrt(sign.shape[1])
        size = np.abs(rng.normal(size=sign.shape)) + 0.1 if dense else np.maximum(rng.normal(size=sign.shape) + 0.4, 0)
        tensors[f"layers.{index}.weight"] = (size * scale * sign).astype(np.float32)
        tensors[f"layers.{index}.bias"] = rng.normal(size=len(sign)).astype(np.float32)
    sizes = {"hidden": list(hidden), "activation": activation, "octaves": 0}
    return MonotoneMlp(domain_of(grid, "box"), tensors, sizes, "cpu")
