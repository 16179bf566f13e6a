"""What is to be bounded."""

from dataclasses import dataclass

from warp_bounding.bounders.domain import Domain
from warp_bounding.bounders.regions import RegionDomain
from warp_bounding.indicators import IndicatorGrid

__all__ = ["Problem"]


@dataclass(frozen=True)
class Problem:
    """What is to be bounded, for which queries, where."""

    grid: IndicatorGrid
    domain: Domain | RegionDomain
    query: str
    seed: int
    device: str | None
