"""What is to be bounded."""

from dataclasses import dataclass

import numpy as np

from warp_bounding.bounders.base import Bounder
from warp_bounding.coordinates.domain import Domain
from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.indicators import IndicatorGrid

__all__ = ["Problem"]


@dataclass(frozen=True)
class Problem:
    """What is to be bounded, for which queries, where.

    Attributes:
        grid: The object.
        domain: Of the queries.
        query: Kind of query.
        seed: Of everything random.
        device: Warp device of the bounder.
        front: Bounders that are asked first: only what they let through is asked further, and only that can be a false positive.
        in_front: A network is asked afterwards.
        repeatable: The result is to be the same on every run: no clock may enter.
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
        """``(N,)`` bool: the front lets these queries, in object space, through."""
        left = np.ones(len(x), dtype=bool)
        for bounder in self.front:
            left[left] = bounder.query(np.asarray(x[left], dtype=np.float32)).numpy() != 0
        return left
