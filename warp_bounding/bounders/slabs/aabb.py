"""``aabb``: the axis-aligned bounding box (the paper's AABox)."""

from warp_bounding.bounders.slabs.base import SlabBounder

__all__ = ["Aabb"]


class Aabb(SlabBounder):
    """Axis-aligned box: n slabs along the coordinates, tested without a product."""

    method = "aabb"
    diagonal = True
