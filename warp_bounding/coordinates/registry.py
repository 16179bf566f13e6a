"""The coordinates of each kind of query, by its name."""

from warp_bounding.coordinates.base import PARAMETRIC, Coordinates
from warp_bounding.coordinates.box import BOX
from warp_bounding.coordinates.plane import PLANE
from warp_bounding.coordinates.point import POINT
from warp_bounding.coordinates.ray import RAY

__all__ = ["COORDINATES", "coordinates_of"]

COORDINATES: dict[str, Coordinates] = {
    kind.name: kind for kind in (POINT, RAY, PLANE, BOX)
}  # a new kind of query is one more entry


def coordinates_of(query: str, space: str) -> Coordinates:
    """The coordinates of a kind of query in one of the two spaces."""
    return COORDINATES[query].parametric if space == PARAMETRIC else COORDINATES[query]
