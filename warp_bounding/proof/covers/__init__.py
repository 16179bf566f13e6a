"""Boxes that cover every positive query: one file a kind of query, found by its name."""

from warp_bounding.proof.covers.base import Cover
from warp_bounding.proof.covers.box import BoxCover
from warp_bounding.proof.covers.plane import PlaneCover
from warp_bounding.proof.covers.point import PointCover
from warp_bounding.proof.covers.ray import RayCover

__all__ = ["COVERS"]

# A new kind of query is one more entry.
COVERS: dict[str, Cover] = {"point": PointCover(), "ray": RayCover(), "plane": PlaneCover(), "box": BoxCover()}
