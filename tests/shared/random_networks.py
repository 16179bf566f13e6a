"""Networks of regions with random weights; what they bound is of no account."""

from bounding_shapes import random_mlp

from warp_bounding.bounders.mlp import Mlp
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.shapes import Grid


def random_network(query: str, grid: Grid, seed=0, activation="sin", hidden=(9, 7), gain=2.0) -> Mlp:
    """Its first layer's weights are larger by ``gain``; of planes it has two outputs."""
    return random_mlp(grid, hidden, activation, seed=seed, gain=gain, domain=domain_of(grid, query))


def random_supports(grid, seed=0, activation="sin", hidden=(9, 7)) -> Mlp:
    """Of planes."""
    return random_network("plane", grid, seed, activation, hidden, gain=1.5)
