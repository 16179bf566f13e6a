"""Networks of regions with random weights, monotone ones too; what they bound is of no account."""

from itertools import pairwise

import numpy as np

from warp_bounding.bounders.mlp import Mlp, MonotoneMlp
from warp_bounding.indicators import IndicatorGrid
from warp_bounding.queries.region_domain import domain_of


def random_network(query: str, grid: IndicatorGrid, seed=0, activation="sin", hidden=(9, 7), gain=2.0) -> Mlp:
    """Of one output, its first layer's weights larger by ``gain``."""
    domain = domain_of(grid, query)
    return _network(domain, (domain.ndim, *hidden, 1), gain, seed, activation)


def random_supports(grid, seed=0, activation="sin", hidden=(9, 7)) -> Mlp:
    """Of planes: two outputs."""
    return _network(domain_of(grid, "plane"), (grid.ndim, *hidden, 2), 1.5, seed, activation)


def _network(domain, widths: tuple[int, ...], gain: float, seed: int, activation: str) -> Mlp:
    rng, tensors = np.random.default_rng(seed), {}
    for i, (k, h) in enumerate(pairwise(widths)):
        scale = gain if i == 0 else 1.5
        tensors[f"layers.{i}.weight"] = (rng.normal(size=(h, k)) * scale / np.sqrt(k)).astype(np.float32)
        tensors[f"layers.{i}.bias"] = rng.normal(size=h).astype(np.float32)
    return Mlp(domain, tensors, {"hidden": list(widths[1:-1]), "activation": activation, "octaves": 0}, "cpu")


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
