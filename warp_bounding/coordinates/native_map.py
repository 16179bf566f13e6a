"""The C text from a query's numbers to the coordinates ``v``: what frames the text of its kind (``Coordinates``)."""

from warp_bounding.coordinates.registry import COORDINATES, coordinates_of

__all__ = ["extra_count", "locate"]

_FRAME = """
auto testable = (q[0] - q[0]) == zero, inside = zero <= zero;  // false for NaN and for infinity
{{
    constexpr int AXES = {n};
    constexpr bool TIME = {time}, PLACED = {placed};
    {no_place}
    for (int k = 1; k < {columns}; ++k) testable = testable & ((q[k] - q[k]) == zero);
    {moving}
    {text}
}}
"""


def extra_count(query: str, ndim: int, time: bool) -> int:
    """How many numbers stand behind the threshold in ``parameters``; see ``RegionDomain.extra``."""
    return COORDINATES[query].extra_count(ndim, time)


def locate(query: str, space: str, n: int, time: bool, placed: bool = False) -> str:
    """The C text.

    Args:
        query: Kind of query.
        space: ``"geometric"`` or ``"parametric"``.
        n: Dimension of the indicator.
        time: Coordinate 0 is time: a region that lies wholly outside its range is answered with maybe; so may be one
            that only just reaches into it.
        placed: ``q`` are in the world, and the text may change them.
    """
    kind = coordinates_of(query, space)
    return _FRAME.format(
        n=n,
        time=str(time).lower(),
        placed=str(placed).lower(),
        no_place="" if placed else "const float* place = nullptr; (void)place;",
        columns=kind.columns(n),
        moving=f"{{ {kind.moving} }}" if placed else "",
        text=kind.text,
    )
