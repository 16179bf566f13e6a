"""Boxes that cover every positive query: one file a kind of query, found by its name."""

from warp_bounding.proof.covers.base import Cover
from warp_bounding.proof.covers.box import BOX
from warp_bounding.proof.covers.plane import PLANE
from warp_bounding.proof.covers.point import POINT
from warp_bounding.proof.covers.ray import RAY

__all__ = ["COVERS"]

COVERS: dict[str, Cover] = {
    cover.name: cover for cover in (POINT, RAY, PLANE, BOX)
}  # a new kind of query is one more entry
