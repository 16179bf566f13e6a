"""Queries: what is asked of an object, how it is sampled, and the exact truth. One file a kind."""

from warp_bounding.queries.base import Query
from warp_bounding.queries.box import BoxOracle, sample_boxes
from warp_bounding.queries.plane import PlaneOracle, sample_planes
from warp_bounding.queries.point import PointOracle, sample_points
from warp_bounding.queries.ray import RayOracle, sample_rays
from warp_bounding.queries.registry import QUERIES, QUERY_KINDS, check_query, oracle, sample
from warp_bounding.queries.sampled import SampledOracle

__all__ = [
    "QUERIES",
    "QUERY_KINDS",
    "BoxOracle",
    "PlaneOracle",
    "PointOracle",
    "Query",
    "RayOracle",
    "SampledOracle",
    "check_query",
    "oracle",
    "sample",
    "sample_boxes",
    "sample_planes",
    "sample_points",
    "sample_rays",
]
