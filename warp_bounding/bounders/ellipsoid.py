"""``ellipsoid``: the axis-aligned ellipsoid of least volume (the paper's AAElli)."""

from warp_bounding.bounders.quadric import QuadricBounder

__all__ = ["Ellipsoid"]


class Ellipsoid(QuadricBounder):
    """Axis-aligned ellipsoid of least volume."""

    method = "ellipsoid"
    family = "diagonal"
