"""The twin of ``native_map`` in Warp's own Python: what frames the functions of a kind of query (``Coordinates``)."""

from functools import cache

import warp as wp

from warp_bounding.coordinates.base import Numbers, vector_type
from warp_bounding.coordinates.registry import coordinates_of
from warp_bounding.runtime.native import named

__all__ = ["plain_map", "vector_type"]


@cache
def plain_map(query: str, space: str, n: int, time: bool, placed: bool, front: int) -> wp.Function:
    """The function ``(parameters, place, q) -> (v, testable, inside)``.

    Args:
        query: Kind of query.
        space: ``"geometric"`` or ``"parametric"``.
        n: Dimension of the indicator.
        time: Coordinate 0 is time.
        placed: ``q`` are in the world.
        front: Where ``center scale limit threshold extra`` begin in ``parameters``.
    """
    kind = coordinates_of(query, space)
    locate, move, columns = kind.plain(n, time, placed, front), kind.plain_move(n), kind.columns(n)
    numbers = vector_type(columns)

    @named(f"wb_plain_map_{space}_{query}_{n}_{time:d}{placed:d}").func
    def located(parameters: Numbers, place: Numbers, q: numbers):
        known = wp.bool(True)
        for k in range(columns):
            known = known and wp.isfinite(q[k])
        x = q
        if placed:
            x, sized = move(place, q)
            known = known and sized
        v, testable, inside = locate(parameters, place, x)
        return v, known and testable, inside

    return located
