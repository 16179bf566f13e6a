"""Queries: what is asked of an object, how it is sampled, and the exact truth. One file a kind."""

from warp_bounding.errors import QueryError
from warp_bounding.queries.point import PointOracle, sample_points

__all__ = ["QUERY_KINDS", "PointOracle", "check_query", "sample_points"]

QUERY_KINDS = ("point",)


def check_query(query: str) -> str:
    """``query`` itself, if it is a kind that is known.

    Raises:
        QueryError: If it is not.
    """
    if query not in QUERY_KINDS:
        raise QueryError(f"query must be one of {', '.join(QUERY_KINDS)}, got {query!r}")
    return query
