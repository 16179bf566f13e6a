"""What is given to every way of training: the object, its queries, and what the result may depend on."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_bounding.bounders.base import Bounder
from warp_bounding.coordinates.domain import Domain
from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.indicators import IndicatorGrid

__all__ = ["Problem", "Trained"]

Trained = tuple[Bounder, dict[str, Any]]  # the bounder, and a record of the training for ``info["training"]``


@dataclass(frozen=True)
class Problem:
    """What is to be bounded, for which queries, where.

    Attributes:
        grid: The object.
        domain: The domain of the queries.
        query: Kind of query.
        seed: Seed of everything random.
        device: Warp device of the bounder.
        front: Bounders that are asked first. Only queries that they let through are asked further, so only those can be
            false positives.
        in_front: The bounder stands before a network in a cascade.
        repeatable: The result is to be the same on every run, so no clock may enter.
    """

    grid: IndicatorGrid
    domain: Domain | RegionDomain
    query: str
    seed: int
    device: str | None
    front: tuple[Bounder, ...] = ()
    in_front: bool = False
    repeatable: bool = False

    def asked(self, x: np.ndarray) -> np.ndarray:
        """``(N,)`` bool: whether all of ``front`` let these queries, in object space, through."""
        left = np.ones(len(x), dtype=bool)
        for bounder in self.front:
            left[left] = bounder.query(np.asarray(x[left], dtype=np.float32)).numpy() != 0
        return left
