"""What is given to every way of training: the object, its queries, and what the result may depend on."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.coordinates.domain import Domain
from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.indicators.shape import Shape
from warp_bounding.queries import sample
from warp_bounding.training.samples.callers import CALLERS_SHARE, CallersQueries

__all__ = ["Problem", "Trained"]

Trained = tuple[Bounder, dict[str, Any]]  # the bounder, and a record of the training for ``info["training"]``


@dataclass(frozen=True)
class Problem:
    """What is to be bounded, for which queries, where.

    Attributes:
        front: Bounders that are asked first. Only queries that they let through are asked further, so only those can be
            false positives.
    """

    grid: Shape  # the object
    domain: Domain | RegionDomain  # of the queries
    query: str  # kind of query
    seed: int  # of everything random
    device: str | None  # Warp device of the bounder
    front: tuple[Bounder, ...] = ()
    in_front: bool = False  # whether the bounder stands before a network in a cascade
    target: Domain | None = None  # where a network of points is asked, if it is trained in another domain, its own
    callers: CallersQueries | None = None  # queries of the caller's own: where false positives count
    repeatable: bool = False  # whether the result is to be the same on every run, so that no clock may enter

    def sample(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """``(count, m)`` float32, random queries that stand for what will be asked: of the protocol, or for the greater part the caller's own."""
        if self.callers is None:
            return sample(self.query, self.grid, count, rng)
        own = round(CALLERS_SHARE * count)
        usual = sample(self.query, self.grid, count - own, rng)
        return np.concatenate([self.callers.draw(own, rng), np.asarray(usual, dtype=np.float32)])

    def asked(self, x: np.ndarray) -> np.ndarray:
        """``(N,)`` bool: whether all of ``front`` let these queries, in object space, through."""
        left = np.ones(len(x), dtype=bool)
        for bounder in self.front:
            left[left] = bounder.query(np.asarray(x[left], dtype=np.float32)).numpy() != 0
        return left
