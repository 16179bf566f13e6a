"""``oriented-ellipsoid``: the ellipsoid of least volume (the paper's OElli), by Khachiyan's problem."""

from warp_bounding.bounders.ellipsoids.base import QuadricBounder

__all__ = ["OrientedEllipsoid"]


class OrientedEllipsoid(QuadricBounder):
    """Ellipsoid of least volume."""

    method = "oriented-ellipsoid"
    family = "determinant"
    diagonal = False
