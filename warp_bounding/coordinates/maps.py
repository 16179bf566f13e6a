"""The coordinates of each kind of query by its name, and what frames the texts and functions of their maps."""

from warp_bounding.coordinates.base import Coordinates
from warp_bounding.coordinates.box import BOX
from warp_bounding.coordinates.plane import PLANE
from warp_bounding.coordinates.point import POINT
from warp_bounding.coordinates.ray import RAY
from warp_bounding.indicators.joints import TEXT

__all__ = ["COORDINATES", "locate"]

COORDINATES: dict[str, Coordinates] = {kind.name: kind for kind in (POINT, RAY, PLANE, BOX)}  # a new kind is one more

_FRAME = """
auto testable = (q[0] - q[0]) == zero, inside = zero <= zero;  // false for NaN and for infinity
{{
    constexpr int AXES = {n}, FREE = {free};
    constexpr bool TIME = FREE > 0, PLACED = {placed};
    (void)TIME;
    {no_place}
    for (int k = 1; k < {columns}; ++k) testable = testable & ((q[k] - q[k]) == zero);
    {moving}
    {text}
}}
"""


def locate(query: str, n: int, free: int, placed: bool = False, joints: bool = False) -> str:
    """The C text from a query's numbers to the coordinates ``v``.

    Args:
        query: Kind of query.
        n: Dimension of the indicator.
        free: Queries outside the domain on one of the first so many axes are answered with maybe: 1 where coordinate 0
            is time, all n where the object is unbounded (points only). So is a region that lies wholly outside, and maybe
            one that only just reaches into it.
        placed: ``q`` are in the world, and the text may change them.
        joints: ``q`` are values of joints, with their numbers at ``extra``; points only.
    """
    kind = COORDINATES[query]
    text = f"{TEXT} {{ const V* q = turned; {kind.text} }}" if joints else kind.text
    return _FRAME.format(
        n=n,
        free=int(free),
        placed=str(placed).lower(),
        no_place="" if placed else "const float* place = nullptr; (void)place;",
        columns=kind.columns(n),
        moving=f"{{ {kind.moving} }}" if placed else "",
        text=text,
    )
