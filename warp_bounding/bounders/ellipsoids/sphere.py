"""``sphere``: the smallest enclosing ball, in object space (the paper's Sphere), its radius within 0.005 % of the least."""

from warp_bounding.bounders.ellipsoids.base import QuadricBounder

__all__ = ["Sphere"]


class Sphere(QuadricBounder):
    """Minimal ball."""

    method = "sphere"
    family = "trace"
