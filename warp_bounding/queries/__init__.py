"""Queries: what is asked of an object, how it is sampled, and the exact truth. One file a kind."""

from warp_bounding.queries.base import Query
from warp_bounding.queries.registry import (
    QUERIES,
    QUERY_KINDS,
    SampledOracle,
    check_query,
    decision,
    described,
    oracle,
    sample,
)

__all__ = [
    "QUERIES",
    "QUERY_KINDS",
    "Query",
    "SampledOracle",
    "check_query",
    "decision",
    "described",
    "oracle",
    "sample",
]
