"""Networks of regions with random weights; what they bound is of no account."""

from itertools import pairwise

import numpy as np

from warp_bounding.bounders.neural.mlp import Mlp
from warp_bounding.coordinates.region_domain import domain_of
from warp_bounding.indicators import IndicatorGrid


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
