"""``ellipsoid``: the axis-aligned ellipsoid of least volume (the paper's AAElli)."""

from warp_bounding.bounders.ellipsoids.base import QuadricBounder

__all__ = ["Ellipsoid"]


class Ellipsoid(QuadricBounder):
    """Axis-aligned ellipsoid of least volume."""

    method = "ellipsoid"
    family = "diagonal"
