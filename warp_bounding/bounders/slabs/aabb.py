"""``aabb``: the axis-aligned bounding box (the paper's AABox)."""

from warp_bounding.bounders.slabs.base import SlabBounder
from warp_bounding.coordinates.domain import Domain
from warp_bounding.indicators.grid import IndicatorGrid

__all__ = ["Aabb"]


class Aabb(SlabBounder):
    """Axis-aligned box: n slabs along the coordinates, tested without a product."""

    method = "aabb"
    diagonal = True

    @classmethod
    def fit(cls, grid: IndicatorGrid, domain: Domain, *, device: str | None = None) -> "Aabb":
        """The smallest axis-aligned box around a grid's occupied cells."""
        return cls.of_directions(grid, domain, None, device)
