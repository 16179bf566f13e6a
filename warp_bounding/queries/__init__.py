"""The kinds of query by name. Each kind has a file, with its sampler and its exact truth.

``locate`` writes the C text that maps a query to v.
"""

from collections.abc import Callable

import numpy as np

from warp_bounding.errors import QueryError
from warp_bounding.queries.base import Query
from warp_bounding.queries.box import BOX
from warp_bounding.queries.distance import DISTANCE, DistanceQuery
from warp_bounding.queries.plane import PLANE
from warp_bounding.queries.point import POINT
from warp_bounding.queries.ray import RAY
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.joints import TEXT
from warp_bounding.shapes.shape import Shape

__all__ = [
    "QUERIES",
    "QUERY_KINDS",
    "Query",
    "check_query",
    "decision",
    "described",
    "locate",
    "oracle",
    "sample",
]

QUERIES: dict[str, Query] = {kind.name: kind for kind in (POINT, RAY, PLANE, BOX)}  # a new kind is one more entry
QUERY_KINDS = QUERIES.keys()


def check_query(query: str, *more: str) -> str:
    """``query`` itself, if it is a kind that is known, or one of ``more``; ``QueryError`` if not."""
    if query not in QUERIES and query not in more:
        raise QueryError(f"query must be one of {', '.join([*QUERIES, *more])}, got {query!r}")
    return query


def described(query: str) -> Query | DistanceQuery:
    """What there is to say of a kind of query, or of distances, by its name."""
    return DISTANCE if query == DISTANCE.name else QUERIES[query]


def sample(query: str, grid: Grid, count: int, rng: np.random.Generator) -> np.ndarray:
    """Random queries ``(count, m)`` float32 of a kind, as in ``Query.sample``; raises ``QueryError`` for no kind."""
    return QUERIES[check_query(query)].sample(grid, count, rng)


def decision(
    query: str, shape: Shape, device: str | None = None, length: float = 1.0
) -> Callable[[np.ndarray], np.ndarray]:
    """``oracle`` of a shape without cells, ``(N,)`` uint8: ``OUT``, ``IN`` or ``UNDECIDED`` (``shapes.shape``)."""
    if isinstance(shape, Grid):
        return oracle(query, shape, device, length)
    return lambda q: QUERIES[query].decide(shape, q, length)


def oracle(
    query: str, grid: Grid, device: str | None = None, length: float = 1.0
) -> Callable[[np.ndarray], np.ndarray]:
    """The exact truth for queries of a kind, as in ``Query.oracle``: called with ``(N, m)`` it gives ``(N,)`` bool."""
    return QUERIES[check_query(query)].oracle(grid, device, length)


_FRAME = """
Mask testable = (q[0] - q[0]) == zero, inside = zero <= zero;  // false for NaN and for infinity
{{
    enum {{ AXES = {n}, FREE = {free}, TIME = FREE > 0, PLACED = {placed} }};
    {no_place}
    for (int k = 1; k < {columns}; ++k) testable = testable & ((q[k] - q[k]) == zero);
    {moving}
    {text}
}}
"""


def locate(query: str, n: int, free: int, placed: bool = False, joints: bool = False) -> str:
    """The C text from a query's numbers to the coordinates ``v``, for a shape of n dimensions.

    Queries outside the domain on one of the first ``free`` axes are answered with maybe: 1 where coordinate 0 is time,
    all n where the object is unbounded (points only). So is a region that lies wholly outside, and maybe one that only
    just reaches into it. ``placed``: ``q`` are in the world, and the text may change them. ``joints``: ``q`` are values
    of joints, with their numbers at ``extra``; points only.
    """
    kind = QUERIES[query]
    text = f"{TEXT} {{ const V* q = turned; {kind.map_text} }}" if joints else kind.map_text
    return _FRAME.format(
        n=n,
        free=int(free),
        placed=int(placed),
        no_place="" if placed else "const float* const place = 0; (void)place;",
        columns=kind.columns(n),
        moving=f"{{ {kind.placed_text} }}" if placed else "",
        text=text,
    )
